"""Claims about the integrators (§5 of the paper, and its abstract)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.claims.calculus import (
    ROUND_OFF,
    ROUND_OFF_WHY,
    SEED,
    canonical,
    contact_equations,
    eta,
    everywhere,
    largest,
    packed,
    points,
    pullback,
)
from contactbench.claims.ledger import Correction, Evidence, at_least, at_most, claim
from contactbench.claims.orders import (
    ABC,
    ORDER_MISS,
    ORDER_WHY,
    PAPER_STEP,
    PARTICLE,
    PRINTED,
    STRANG,
    asymmetry,
    exact_errors,
    local_errors,
    slope,
)
from contactbench.measure.laws import LAWS
from contactbench.measure.stability import SLACK, spectral_radius, true_radius
from contactbench.methods import METHODS, solve
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.step_map import trajectory
from contactbench.scene import Mechanical
from contactbench.scenes import SCENES
from contactbench.splitting.flows import MECHANICAL, Flow
from contactbench.xla import jax, jnp

HERGLOTZ = "herglotz1"


# -- the discrete Herglotz principle ---------------------------------------------------------------
def discrete_lagrangian(scene: Mechanical, q0: Any, q1: Any, s: Any, h: Any) -> Any:
    """L(q_k, q_{k+1}, s_k) = ½‖(q_{k+1} − q_k)/h‖² − V(q_k) − γ s_k."""
    v = [(b - a) / h for a, b in zip(q0, q1, strict=True)]
    return sum(c * c for c in v) / 2 - scene.V(tuple(q0)) - scene.gamma * s


def one_step(method: FixedStep, scene: Mechanical, h: float) -> Any:
    """Φ_h as a JAX map of (q, p, s)."""
    return lambda y: packed(method.advance(scene, canonical(y), h, 1, jnp))


def symplectic_defect(map_: Any, y: Any) -> Any:
    """DΦᵀ Ω DΦ − Ω of the (q, p) part."""
    n = (len(y) - 1) // 2
    derivative = jax.jacfwd(map_)(y)[: 2 * n, : 2 * n]
    omega = jnp.block([[jnp.zeros((n, n)), jnp.eye(n)], [-jnp.eye(n), jnp.zeros((n, n))]])
    return derivative.T @ omega @ derivative - omega


@claim(
    "C23",
    "§5.1, eq. (79)",
    "s_{k+1} = s_k + h L(q_k, q_{k+1}, s_k) with variations of q_k is a variational integrator, and "
    "reduces to the symplectic one when L does not depend on s.",
    kind=Correction.extends,
    correction="The paper leaves L and the order open. L = ½‖v‖² − V(q_k) − γ s_k gives an explicit scheme of "
    "order 1; taking V and γ s as means of both ends gives one of order 2, explicit too (Vermeeren, Bravetti, "
    "Seri 2019).",
    scene=PARTICLE,
    method="herglotz1, L = ½‖v‖² − V(q_k) − γ s_k; herglotz2",
)
def discrete_herglotz(seed: int = SEED, gamma: float = 0.1, h: float = 0.1) -> Evidence:
    scene, steps = SCENES[PARTICLE].with_(gamma=gamma), 20
    method = METHODS[HERGLOTZ]
    start = scene.initial(("s",))
    path = [start, *trajectory(method, scene, start, [(h, 1)] * steps, math)]
    q = jnp.array([x.q for x in path])

    def action(inner):
        """s_N along a discrete curve with the ends q_0 and q_N held."""
        curve, s = [q[0], *inner, q[-1]], scene.s
        for a, b in itertools.pairwise(curve):
            s = s + h * discrete_lagrangian(scene, a, b, s, h)
        return s

    reached, gradient = jax.jit(jax.value_and_grad(action))(q[1:-1])
    free = one_step(method, scene.with_(gamma=0.0), h)
    orders = {name: slope(exact_errors(METHODS[name])) for name in (HERGLOTZ, "herglotz2")}
    return Evidence(
        [
            at_most(
                "max |∂s_N/∂q_k| along a computed curve of 20 steps",
                np.abs(gradient).max(),
                ROUND_OFF,
                ROUND_OFF_WHY,
            ),
            at_most(
                "|s_N − s_N of the recursion| along it",
                abs(float(reached) - path[-1].s),
                ROUND_OFF,
                "round-off of 20 steps",
            ),
            at_most(
                "max |DΦᵀΩDΦ − Ω| at γ = 0",
                largest(lambda y: symplectic_defect(free, y), points(5, seed=seed)),
                ROUND_OFF,
                ROUND_OFF_WHY,
            ),
        ],
        [
            at_most("|order − 1| of herglotz1, 50 digits", abs(orders[HERGLOTZ] - 1), ORDER_MISS, ORDER_WHY),
            at_most(
                "|order − 2| of herglotz2, 50 digits", abs(orders["herglotz2"] - 2), ORDER_MISS, ORDER_WHY
            ),
        ],
    )


# -- subflows and compositions ---------------------------------------------------------------------
def flow_map(flow: Flow, scene: Mechanical) -> Any:
    """(h, y) ↦ φ_h(y)."""
    return lambda h, y: packed(flow.apply(scene, canonical(y), flow.constants(scene, h, jnp), jnp))


def flow_defect(flow: Any, hamiltonian: Any, seed: int) -> float:
    """max |dφ_h/dh − X_H(φ_h)|/(1 + |φ_h|) and |φ_0 − id| at random points and h: 0 for the exact flow."""
    field = contact_equations(hamiltonian)

    def defect(point):
        h, y = point[0], point[1:]
        value, rate = jax.jvp(lambda h: flow(h, y), (h,), (1.0,))
        size = 1 + jnp.abs(value).max()
        return jnp.append((rate - field(value)) / size, flow(0.0, y) - y)

    return largest(defect, points(6, seed=seed))


@claim(
    "C24",
    "§5.2, eqs. (82)–(84)",
    "The three subflows are the exact contact flows of T, V and γ s.",
    kind=Correction.extends,
    scene=PARTICLE,
    method="the subflows of contact-*",
    correction="A's update s += h T(p) needs T homogeneous of degree two; in general s += h (p·∂T/∂p − T).",
)
def subflows(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    scene = SCENES[PARTICLE].with_(gamma=gamma)
    parts = {
        "A (drift)": ("drift", lambda x: scene.kinetic(x.p)),
        "B (kick)": ("kick", lambda x: scene.V(x.q)),
        "C (damp)": ("damp", lambda x: scene.gamma * x.s),
        "A and C together (drift_damp)": ("drift_damp", lambda x: scene.kinetic(x.p) + scene.gamma * x.s),
    }
    exact = [
        at_most(
            f"max |dφ_h/dh − X(φ_h)|/(1 + |φ_h|), |φ_0 − id|: {label}",
            flow_defect(flow_map(MECHANICAL[name], scene), lambda y, H=part: H(canonical(y)), seed),
            ROUND_OFF,
            ROUND_OFF_WHY,
        )
        for label, (name, part) in parts.items()
    ]

    def contact_defect(name, factor):
        flow = flow_map(MECHANICAL[name], scene)
        return largest(
            lambda y: pullback(lambda z: flow(0.7, z), eta, y) - factor * eta(y), points(5, seed=seed)
        )

    decay = math.exp(-scene.gamma * 0.7)
    contact = max(contact_defect(*part) for part in (("kick", 1.0), ("drift", 1.0), ("damp", decay)))

    def quartic(y):
        return jnp.sum(y[2:4] ** 4) / 4

    def drift(general):
        def flow(h, y):
            T, p_T = quartic(y), jnp.sum(y[2:4] ** 4)
            return jnp.concatenate(
                [y[:2] + h * y[2:4] ** 3, y[2:4], jnp.array([y[4] + h * (p_T - T if general else T)])]
            )

        return flow

    return Evidence(
        [*exact, at_most("max |φ_h*η − e^{−γh}η| (A, B: factor 1)", contact, ROUND_OFF, ROUND_OFF_WHY)],
        [
            at_most(
                "A with s += h (p·T_p − T) for T = ¼ Σ p⁴",
                flow_defect(drift(True), quartic, seed),
                10 * ROUND_OFF,
                "round-off of AD on numbers of size up to 100",
            ),
            at_least(
                "A as printed, s += h T, for the same T",
                flow_defect(drift(False), quartic, seed),
                1e-3,
                "far above round-off: it is not the flow",
            ),
        ],
    )


@claim(
    "C25",
    "§5.2, eq. (85)",
    "Φ_h = B½ A C B½ is symmetric and second order.",
    kind=Correction.replaces,
    correction="For γ > 0 it is first order and not time-symmetric, because A and C do not commute. The "
    "palindrome B½ A½ C A½ B½ is symmetric and second order; so is B½ (AC) B½ with the exact "
    "joint flow of A and C.",
    scene=PARTICLE,
    method="contact-printed; corrected: contact-abc, contact-strang",
)
def printed_composition(**changes: Any) -> Evidence:
    """changes : of the particle, e.g. ``gamma``."""
    palindromes = [METHODS[name] for name in (ABC, STRANG)]
    return Evidence(
        [
            at_least(
                "order of contact-printed, 50 digits",
                slope(exact_errors(METHODS[PRINTED], **changes)),
                2 - ORDER_MISS,
                ORDER_WHY,
            ),
            at_most(
                "|Φ_{−h} Φ_h x − x| at h = 1/10, 50 digits",
                asymmetry(PRINTED, **changes),
                1e-40,
                "round-off at 50 digits",
            ),
        ],
        [
            at_least(
                "smallest order of contact-abc and contact-strang",
                min(slope(exact_errors(m, **changes)) for m in palindromes),
                2 - ORDER_MISS,
                ORDER_WHY,
            ),
            at_most(
                "largest |Φ_{−h} Φ_h x − x| of the two",
                max(asymmetry(m.name, **changes) for m in palindromes),
                1e-40,
                "round-off at 50 digits",
            ),
        ],
    )


STEPS_OF_ANY_SIZE = (0.5, 0.1, 0.02)


def step_drift(name: str, h: float, gamma: float, seed: int) -> float:
    """max ‖Φ_h*η − e^{−γh}η‖/‖e^{−γh}η‖ of one step at random points."""
    scene = SCENES[PARTICLE].with_(gamma=gamma)
    decay = math.exp(-scene.gamma * h)
    map_ = one_step(METHODS[name], scene, h)
    return float(
        everywhere(
            lambda y: jnp.linalg.norm(pullback(map_, eta, y) / decay - eta(y)) / jnp.linalg.norm(eta(y)),
            points(5, seed=seed),
        ).max()
    )


@claim(
    "C26",
    "§5.2, after eq. (85)",
    "The integrator preserves the contact structure up to O(h³).",
    kind=Correction.sharpens,
    correction="Every step is an exact conformal contact map, Φ_h*η = e^{−γh}η, at every step size: a "
    "composition of exact contact flows leaves nothing to O(h³).",
    scene=PARTICLE,
    method="contact-printed, contact-abc, contact-strang",
)
def contact_structure(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    drifts = {
        h: max(step_drift(name, h, gamma, seed) for name in (PRINTED, ABC, STRANG)) for h in STEPS_OF_ANY_SIZE
    }
    scene = SCENES[PARTICLE].with_(gamma=gamma)
    long = solve(scene, PRINTED, step=0.5, save_at=[scene.t_end])
    return Evidence(
        [
            at_most(
                f"drift of one step over h³, h = {STEPS_OF_ANY_SIZE}",
                max(d / h**3 for h, d in drifts.items()),
                1.0,
                "a constant of size one in O(h³)",
            )
        ],
        [
            at_most(
                f"drift of one step, h = {STEPS_OF_ANY_SIZE}", max(drifts.values()), ROUND_OFF, ROUND_OFF_WHY
            ),
            at_most(
                "contact_drift of contact-printed over T = 20 at h = ½",
                LAWS["contact_drift"](long),
                ROUND_OFF,
                "round-off of 40 steps",
            ),
        ],
    )


@claim(
    "C27",
    "§5.2, after eq. (85)",
    "Up to O(h³) per step, the integrator has the correct decay of both H0 and s.",
    kind=Correction.repairs,
    correction="The order printed in eq. (85) errs by O(h²) per step in both, because it is of first order (C25). "
    "The palindromes B½ A½ C A½ B½ and B½ (AC) B½ do what is claimed, O(h³). Exact at every step size is the "
    "conformal factor e^{−γh}, hence the decay of J and, for the body, of ‖M‖.",
    scene="particle from random states; J: central, ‖M‖: rigid_body",
    method="contact-printed; corrected: contact-abc, contact-strang",
)
def energy_and_action_decay(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    scene = SCENES[PARTICLE].with_(gamma=gamma)
    starts = points(5, seed=seed)

    def local(name: str) -> list[float]:
        """Powers of h in the errors of H0 and s after one step."""
        return [slope(e) for e in local_errors(name, scene, (scene.energy, lambda x: x.s), starts)]

    printed, palindromes = local(PRINTED), [local(name) for name in (ABC, STRANG)]
    worst = [min(powers) for powers in zip(*palindromes, strict=True)]

    def momentum_law(name):
        other = SCENES[name].with_(gamma=gamma)
        run = solve(other, PRINTED, step=0.5, save_at=np.arange(1, 41) / 2, engine="python")
        return LAWS["momentum_law"](run), run

    central, _ = momentum_law("central")
    body, run = momentum_law("rigid_body")
    size = np.linalg.norm(run.M, axis=1) * np.exp(gamma * run.t) / np.linalg.norm(run.scene.M)
    exact = "round-off of the steps taken"
    least = 3 - ORDER_MISS, ORDER_WHY
    return Evidence(
        [
            at_least("power of h in the error of H0 after one step, contact-printed", printed[0], *least),
            at_least("power of h in the error of s after one step, contact-printed", printed[1], *least),
        ],
        [
            at_least("the same for H0, contact-abc and contact-strang", worst[0], *least),
            at_least("the same for s, contact-abc and contact-strang", worst[1], *least),
            at_least(
                "smaller of the two powers, contact-printed",
                min(printed),
                2 - ORDER_MISS,
                "order 1 (C25): h² per step",
            ),
            at_most("momentum_law on central at h = ½", central, ROUND_OFF, exact),
            at_most("momentum_law on rigid_body at h = ½", body, ROUND_OFF, exact),
            at_most("max |‖M‖ e^{γt}/‖M(0)‖ − 1| there", np.abs(size - 1).max(), ROUND_OFF, exact),
        ],
    )


@claim(
    "C28",
    "§5.3, eq. (87)",
    "As γ → 0 the integrator becomes velocity Verlet.",
    scene="particle, γ = 0 and 10⁻⁸",
    method=PRINTED,
)
def verlet_limit(h: float = PAPER_STEP, steps: int = 2000) -> Evidence:
    def difference(gamma: float) -> float:
        """max |(q, p) − Verlet's| over the steps."""
        scene = SCENES[PARTICLE].with_(gamma=gamma)
        q, p = (np.array(v) for v in (scene.q, scene.p))
        most = 0.0
        for x in trajectory(METHODS[PRINTED], scene, scene.initial(()), [(h, 1)] * steps, math):
            p = p - h / 2 * np.array(scene.dV(tuple(q)))
            q = q + h * p
            p = p - h / 2 * np.array(scene.dV(tuple(q)))
            most = max(most, np.abs(q - np.array(x.q)).max(), np.abs(p - np.array(x.p)).max())
        return most

    return Evidence(
        [
            at_most(
                f"max |difference| from velocity Verlet over {steps} steps at γ = 0",
                difference(0.0),
                0.0,
                "the same numbers, bit for bit",
            ),
            at_most(
                "the same at γ = 10⁻⁸",
                difference(1e-8),
                1e-8 * 5 * h * steps,
                "five times γ t: the amplitude decays by γ t/2, and the phase shifts with it",
            ),
        ]
    )


def radius(name: str, gamma: float, h: Any) -> Any:
    """Largest |eigenvalue| of one step on the oscillator with ω = 1."""
    return spectral_radius(METHODS[name], gamma, 1.0, h)


def border(name: str, gamma: float) -> float:
    """The smallest ωh > 1 at which an eigenvalue of the step leaves the unit circle."""
    return scipy.optimize.brentq(lambda h: radius(name, gamma, h) - 1 - SLACK, 1.0, 4.5, xtol=1e-12)


FAR = np.geomspace(0.05, 200.0, 4001)  #: step sizes ωh at which "stable at every step size" is looked at


def largest_radius(name: str, gamma: float) -> float:
    """Largest spectral radius over these step sizes, refined where it is largest."""
    coarse = radius(name, gamma, FAR)
    h = FAR[int(np.argmax(coarse))]
    return float(max(np.max(coarse), np.max(radius(name, gamma, np.linspace(0.97 * h, 1.03 * h, 2001)))))


def unconditional_from(name: str, low: float = 0.3, high: float = 0.7) -> float:
    """The γ/ω from which no step size has an eigenvalue outside the unit circle, by bisection."""
    while high - low > 1e-9:
        middle = (low + high) / 2
        low, high = (middle, high) if largest_radius(name, middle) > 1 + SLACK else (low, middle)
    return (low + high) / 2


def threshold() -> float:
    """The same for the printed order by formula: x² ≤ 2(1 + e^{gx}) for every x = ωh, g = γ/ω.

    Where the two sides touch, x = g e^{gx}; with y = gx, e^y (y − 2) = 2, so y = 2 + W(2/e²) and
    g = √(y e^{−y}) = 0.49134, at ωh = g e^y = 4.514.
    """
    y = 2 + float(scipy.special.lambertw(2 / math.e**2).real)
    return math.sqrt(y * math.exp(-y))


def slow_rate_ratio(name: str, gamma: float, h: float) -> float:
    """Decay rate of the slowest mode under steps of h over the true one; oscillator, ω = 1."""
    return math.log(radius(name, gamma, h)) / math.log(true_radius(gamma, 1.0, h))


@claim(
    "C36",
    "Abstract",
    "“Numerically stable integration.”",
    kind=Correction.repairs,
    correction="Conditionally stable. On the oscillator the palindrome B½ A½ C A½ B½ needs ωh < 2 whatever the "
    "damping. The printed order needs (ωh)² < 2 (1 + e^{γh}): ωh < 2 at γ = 0, a little more with weak damping, "
    "and from γ/ω = 0.4913 on every step size is stable. Stable is not accurate there: as the step grows, the "
    "rate of its slow mode tends to 0. See the stability table for the merged flow AC and for the other methods.",
    scene="oscillator, ω = 1, γ = 0, 0.1, 1",
    method="contact-printed, contact-abc",
)
def conditional_stability(gammas: Sequence[float] = (0.0, 0.1, 1.0), weak: float = 0.1) -> Evidence:
    """gammas : for the palindrome.  weak : for the printed order, between 0 and 0.4."""
    why = "bounded orbits need no eigenvalue beyond the unit circle; 10⁻⁷ is the square root of round-off"
    short = np.linspace(0.05, 1.95, 39)
    calm = max(float(np.max(radius(name, gamma, short))) for name in (PRINTED, ABC) for gamma in gammas)
    shown = ", ".join(f"{gamma:g}" for gamma in gammas)
    edge = border(PRINTED, weak)
    near = "the slack 10⁻⁷ of the eigenvalue, magnified where two of them meet on the circle"
    return Evidence(
        [
            at_most(
                f"largest spectral radius of a step, ωh from 0.05 to 200, {name}, γ = {weak:g}",
                largest_radius(name, weak),
                1 + SLACK,
                why,
            )
            for name in (PRINTED, ABC)
        ],
        [
            at_most(f"the same for ωh ≤ 1.95, both, γ = {shown}", calm, 1 + SLACK, why),
            at_most(
                f"max |border − 2| for contact-abc, γ = {shown}",
                max(abs(border(ABC, gamma) - 2) for gamma in gammas),
                1e-5,
                near,
            ),
            at_most(
                f"|(ωh)² − 2(1 + e^{{γh}})| at the border of contact-printed, γ = {weak:g}",
                abs(edge**2 - 2 * (1 + math.exp(weak * edge))),
                1e-5,
                near,
            ),
            at_most(
                f"|γ/ω − {threshold():.5f}| from which contact-printed is stable at every step size",
                abs(unconditional_from(PRINTED) - threshold()),
                1e-5,
                "the slack 10⁻⁷ of the eigenvalue, over its slope in γ, and the sampling of h",
            ),
            at_most(
                "decay rate of its slow mode over the true one, γ/ω = 1, ωh = 20",
                slow_rate_ratio(PRINTED, 1.0, 20.0),
                1e-2,
                "about 2 ωh e^{−γh}, which tends to 0",
            ),
        ],
    )
