"""Claims about the integrators (§5 of the paper, and its conclusion)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from contactbench.claims.calculus import (
    ROUND_OFF,
    ROUND_OFF_WHY,
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
from contactbench.measure.laws import LAWS
from contactbench.measure.order import fit_order
from contactbench.measure.stability import SLACK, spectral_radius
from contactbench.methods import METHODS, solve
from contactbench.methods.fixed_step import FixedStep, trajectory
from contactbench.scene import Mechanical, State
from contactbench.scenes import SCENES
from contactbench.splitting.flows import MECHANICAL, Flow
from contactbench.truth.reference import decimal_context, reference, with_decimals

PARTICLE = "particle"
PRINTED, ABC, STRANG, RK4 = "contact-printed", "contact-abc", "contact-strang", "rk4"
DIGITS = 50
#: a fitted order may miss the nominal one by this much at the step sizes used
ORDER_MISS, ORDER_WHY = 0.1, "the next term of the error bends the slope by a few per cent at the steps used"
PAPER_STEP = 0.01
#: errors of H0 in double precision below this are round-off of some 10⁴ steps; 50-digit errors stay above
ENERGY_FLOOR = 1e-12


# -- orders in high precision ----------------------------------------------------------------------
def gap(a: Sequence[Any], b: Sequence[Any]) -> Any:
    """max |a − b|."""
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


def exact_numbers(scene: Mechanical) -> tuple[Any, Any]:
    """A 50-digit number namespace, and the scene with such numbers."""
    context = decimal_context(DIGITS)
    return context, with_decimals(scene, context.mpf)


END, LADDER = 4, (32, 64, 128, 256)


def exact_errors(method: FixedStep) -> dict[float, float]:
    """max ‖(q, p) − true‖ over t = 1, …, 4 against the step, everything in 50 digits."""
    scene = SCENES[PARTICLE]
    context, twin = exact_numbers(scene)
    truth = [[context.mpf(x) for x in row] for row in reference(scene, range(1, END + 1), ()).decimals]
    errors = {}
    for n in LADDER:
        h = context.mpf(1) / n
        states = trajectory(method, twin, twin.initial(()), [(h, n)] * END, context)
        errors[1 / n] = float(max(gap(twin.pack(x), y) for x, y in zip(states, truth, strict=True)))
    return errors


def slope(errors: dict[float, float]) -> float:
    """The order, extrapolated from the pairwise slopes."""
    return fit_order(list(errors), list(errors.values()), ENERGY_FLOOR).order


def asymmetry(name: str) -> float:
    """|Φ_{−h} Φ_h x − x| in 50 digits for one step of h = 1/10."""
    context, twin = exact_numbers(SCENES[PARTICLE])
    x, h = twin.initial(("s",)), context.mpf(1) / 10
    method = METHODS[name]
    back = method.advance(twin, method.advance(twin, x, h, 1, context), -h, 1, context)
    return float(gap(twin.pack(back), twin.pack(x)))


# -- the discrete Herglotz principle ---------------------------------------------------------------
def discrete_lagrangian(scene: Mechanical, q0: Any, q1: Any, s: Any, h: Any) -> Any:
    """L(q_k, q_{k+1}, s_k) = ½‖(q_{k+1} − q_k)/h‖² − V(q_k) − γ s_k."""
    v = [(b - a) / h for a, b in zip(q0, q1, strict=True)]
    return sum(c * c for c in v) / 2 - scene.V(tuple(q0)) - scene.gamma * s


def herglotz_step(scene: Mechanical, x: State, h: Any, xp: Any) -> State:
    """One step of the recursion s_{k+1} = s_k + h L with its discrete Euler–Lagrange equation.

    Stationarity of s_N in q_k reads (1 + h ∂_s L_k) D₂L_{k−1} + D₁L_k = 0 (Vermeeren, Bravetti, Seri,
    J. Phys. A 52, 445206 (2019), doi:10.1088/1751-8121/ab4767); with p_k = h D₂L_{k−1} it is explicit:
    v = (1 − γh) p_k − h ∇V(q_k), q_{k+1} = q_k + h v, p_{k+1} = v.
    """
    v = tuple((1 - scene.gamma * h) * p - h * g for p, g in zip(x.p, scene.dV(x.q), strict=True))
    q = tuple(q + h * c for q, c in zip(x.q, v, strict=True))
    s = None if x.s is None else x.s + h * discrete_lagrangian(scene, x.q, q, x.s, h)
    return State(q, v, s)


HERGLOTZ = FixedStep("discrete Herglotz", 1, herglotz_step)


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
    "eq:disc-Herglotz",
    "s_{k+1} = s_k + h L(q_k, q_{k+1}, s_k) with variations of q_k is a variational integrator, and "
    "reduces to the symplectic one when L does not depend on s.",
    scene=PARTICLE,
    method="discrete Herglotz, L = ½‖v‖² − V(q_k) − γ s_k",
)
def discrete_herglotz() -> Evidence:
    scene, h, steps = SCENES[PARTICLE], 0.1, 20
    path = [scene.initial(("s",))]
    for _ in range(steps):
        path.append(herglotz_step(scene, path[-1], h, math))
    q = jnp.array([x.q for x in path])

    def action(inner):
        """s_N along a discrete curve with the ends q_0 and q_N held."""
        curve, s = [q[0], *inner, q[-1]], scene.s
        for a, b in itertools.pairwise(curve):
            s = s + h * discrete_lagrangian(scene, a, b, s, h)
        return s

    stationary = np.abs(jax.jit(jax.grad(action))(q[1:-1])).max()
    free = one_step(HERGLOTZ, scene.with_(gamma=0.0), h)
    order = slope(exact_errors(HERGLOTZ))
    return Evidence(
        [
            at_most(
                "max |∂s_N/∂q_k| along a computed curve of 20 steps", stationary, ROUND_OFF, ROUND_OFF_WHY
            ),
            at_least("order, 50 digits", order, 1 - ORDER_MISS, ORDER_WHY),
            at_most("order, 50 digits", order, 1 + ORDER_MISS, ORDER_WHY),
            at_most(
                "max |DΦᵀΩDΦ − Ω| at γ = 0",
                largest(lambda y: symplectic_defect(free, y), points(5)),
                ROUND_OFF,
                ROUND_OFF_WHY,
            ),
        ]
    )


# -- subflows and compositions ---------------------------------------------------------------------
def flow_map(flow: Flow, scene: Mechanical) -> Any:
    """(h, y) ↦ φ_h(y)."""
    return lambda h, y: packed(flow.apply(scene, canonical(y), flow.constants(scene, h, jnp), jnp))


def flow_defect(flow: Any, hamiltonian: Any) -> float:
    """max |dφ_h/dh − X_H(φ_h)| and |φ_0 − id| at random points and random h: 0 for the exact flow."""
    field = contact_equations(hamiltonian)

    def defect(point):
        h, y = point[0], point[1:]
        value, rate = jax.jvp(lambda h: flow(h, y), (h,), (1.0,))
        return jnp.append(rate - field(value), flow(0.0, y) - y)

    return largest(defect, points(6))


@claim(
    "C24",
    "eq:A-flow, eq:B-flow, eq:C-flow",
    "The three subflows are the exact contact flows of T, V and γ s.",
    kind=Correction.extends,
    scene=PARTICLE,
    method="the subflows of contact-*",
    correction="A's update s += h T(p) needs T homogeneous of degree two; in general s += h (p·∂T/∂p − T).",
)
def subflows() -> Evidence:
    scene = SCENES[PARTICLE]
    parts = {
        "A (drift)": ("drift", lambda x: scene.kinetic(x.p)),
        "B (kick)": ("kick", lambda x: scene.V(x.q)),
        "C (damp)": ("damp", lambda x: scene.gamma * x.s),
        "A and C together (drift_damp)": ("drift_damp", lambda x: scene.kinetic(x.p) + scene.gamma * x.s),
    }
    exact = [
        at_most(
            f"max |dφ_h/dh − X(φ_h)|, |φ_0 − id|: {label}",
            flow_defect(flow_map(MECHANICAL[name], scene), lambda y, H=part: H(canonical(y))),
            ROUND_OFF,
            ROUND_OFF_WHY,
        )
        for label, (name, part) in parts.items()
    ]

    def contact_defect(name, factor):
        flow = flow_map(MECHANICAL[name], scene)
        return largest(lambda y: pullback(lambda z: flow(0.7, z), eta, y) - factor * eta(y), points(5))

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
                flow_defect(drift(True), quartic),
                10 * ROUND_OFF,
                "round-off of AD on numbers of size up to 100",
            ),
            at_least(
                "A as printed, s += h T, for the same T",
                flow_defect(drift(False), quartic),
                1e-3,
                "far above round-off: it is not the flow",
            ),
        ],
    )


@claim(
    "C25",
    "eq:Strang-Integrator, §5.2",
    "Φ_h = B½ A C B½ is symmetric and second order.",
    kind=Correction.replaces,
    correction="For γ > 0 it is first order and not time-symmetric, because A and C do not commute. The "
    "palindrome B½ A½ C A½ B½ is symmetric and second order; so is B½ (AC) B½ with the exact "
    "joint flow of A and C.",
    scene=PARTICLE,
    method="contact-printed; corrected: contact-abc, contact-strang",
)
def printed_composition() -> Evidence:
    palindromes = [METHODS[name] for name in (ABC, STRANG)]
    return Evidence(
        [
            at_least(
                "order of contact-printed, 50 digits",
                slope(exact_errors(METHODS[PRINTED])),
                2 - ORDER_MISS,
                ORDER_WHY,
            ),
            at_most(
                "|Φ_{−h} Φ_h x − x| at h = 1/10, 50 digits",
                asymmetry(PRINTED),
                1e-40,
                "round-off at 50 digits",
            ),
        ],
        [
            at_least(
                "smallest order of contact-abc and contact-strang",
                min(slope(exact_errors(m)) for m in palindromes),
                2 - ORDER_MISS,
                ORDER_WHY,
            ),
            at_most(
                "largest |Φ_{−h} Φ_h x − x| of the two",
                max(asymmetry(m.name) for m in palindromes),
                1e-40,
                "round-off at 50 digits",
            ),
        ],
    )


STEPS_OF_ANY_SIZE = (0.5, 0.1, 0.02)


def step_drift(name: str, h: float) -> float:
    """max ‖Φ_h*η − e^{−γh}η‖/‖e^{−γh}η‖ of one step at random points."""
    scene = SCENES[PARTICLE]
    decay = math.exp(-scene.gamma * h)
    map_ = one_step(METHODS[name], scene, h)
    return float(
        everywhere(
            lambda y: jnp.linalg.norm(pullback(map_, eta, y) / decay - eta(y)) / jnp.linalg.norm(eta(y)),
            points(5),
        ).max()
    )


@claim(
    "C26",
    "§5.2",
    "The integrator preserves the contact structure up to O(h³).",
    kind=Correction.sharpens,
    correction="Every step is an exact conformal contact map, Φ_h*η = e^{−γh}η, at every step size: a "
    "composition of exact contact flows leaves nothing to O(h³).",
    scene=PARTICLE,
    method="contact-printed, contact-abc, contact-strang",
)
def contact_structure() -> Evidence:
    drifts = {h: max(step_drift(name, h) for name in (PRINTED, ABC, STRANG)) for h in STEPS_OF_ANY_SIZE}
    long = solve(SCENES[PARTICLE], PRINTED, step=0.5, save_at=[SCENES[PARTICLE].t_end])
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


def energy_errors(name: str, scene: Mechanical, counts: Sequence[int]) -> dict[float, float]:
    """The paper's measure, max |H0 − H0*| over 20 equal times, against the step (double precision)."""
    t = scene.t_end * np.arange(1, 21) / 20
    truth = scene.energy(reference(scene, t, ()).states())
    errors = {}
    for n in counts:
        h = scene.t_end / (20 * n)
        run = solve(scene, name, step=h, save_at=t, carry=(), engine="python")
        errors[h] = float(np.abs(scene.energy(run.states()) - truth).max())
    return errors


ENERGY_LADDER = (16, 32, 64, 128, 256, 512)  #: steps per unit of time


@claim(
    "C27",
    "§5.2",
    "The integrator has the correct decay of both H0 and s.",
    kind=Correction.repairs,
    correction="To the method's order only. What is exact at every step size is the conformal factor "
    "e^{−γh}, hence J and, for the body, ‖M‖.",
    scene="particle; J: central, ‖M‖: rigid_body",
    method="contact-printed; orders: also contact-abc",
)
def energy_and_action_decay() -> Evidence:
    scene = SCENES[PARTICLE]
    t = scene.t_end * np.arange(1, 21) / 20
    truth = reference(scene, t)
    run = solve(scene, PRINTED, step=0.1, save_at=t, engine="python")
    H0 = scene.energy(truth.states())
    off = np.abs(scene.energy(run.states()) - H0).max() / scene.energy(scene.initial(()))
    s_off = np.abs(run.s - truth.states().s).max() / np.abs(truth.states().s).max()
    orders = [
        slope(energy_errors(name, scene, ENERGY_LADDER)) - nominal
        for name, nominal in ((PRINTED, 1), (ABC, 2))
    ]

    def momentum_law(name):
        other = SCENES[name]
        run = solve(other, PRINTED, step=0.5, save_at=np.arange(1, 41) / 2, engine="python")
        return LAWS["momentum_law"](run), run

    central, _ = momentum_law("central")
    body, run = momentum_law("rigid_body")
    size = np.linalg.norm(run.M, axis=1) * np.exp(run.scene.gamma * run.t) / np.linalg.norm(run.scene.M)
    exact = "round-off of the steps taken"
    return Evidence(
        [
            at_most("max |H0 − H0*|/H0(0) at h = 0.1", off, ROUND_OFF, "exact decay means round-off"),
            at_most("max |s − s*|/max |s*| at h = 0.1", s_off, ROUND_OFF, "exact decay means round-off"),
        ],
        [
            at_most(
                "|order of the H0 error − nominal|, contact-printed (1) and contact-abc (2)",
                max(map(abs, orders)),
                ORDER_MISS,
                ORDER_WHY,
            ),
            at_most("momentum_law on central at h = ½", central, ROUND_OFF, exact),
            at_most("momentum_law on rigid_body at h = ½", body, ROUND_OFF, exact),
            at_most("max |‖M‖ e^{γt}/‖M(0)‖ − 1| there", np.abs(size - 1).max(), ROUND_OFF, exact),
        ],
    )


@claim(
    "C28",
    "eq:VV-limit",
    "At γ = 0 the integrator is velocity Verlet.",
    scene="particle, γ = 0",
    method=PRINTED,
)
def verlet_limit() -> Evidence:
    scene, h = SCENES[PARTICLE].with_(gamma=0.0), PAPER_STEP
    q, p = (np.array(v) for v in (scene.q, scene.p))
    states = trajectory(METHODS[PRINTED], scene, scene.initial(()), [(h, 1)] * 2000, math)
    differ = 0.0
    for x in states:
        p = p - h / 2 * np.array(scene.dV(tuple(q)))
        q = q + h * p
        p = p - h / 2 * np.array(scene.dV(tuple(q)))
        differ = max(differ, np.abs(q - np.array(x.q)).max(), np.abs(p - np.array(x.p)).max())
    return Evidence(
        [
            at_most(
                "max |difference| from velocity Verlet over 2000 steps",
                differ,
                0.0,
                "the same numbers, bit for bit",
            )
        ]
    )


def radius(name: str, gamma: float, h: float) -> float:
    """Largest |eigenvalue| of one step on the oscillator with ω = 1."""
    return spectral_radius(METHODS[name], gamma, 1.0, h)


def border(name: str, gamma: float) -> float:
    """The smallest ωh > 1 at which an eigenvalue of the step leaves the unit circle."""
    from scipy.optimize import brentq

    return brentq(lambda h: radius(name, gamma, h) - 1 - SLACK, 1.0, 2.5, xtol=1e-12)


@claim(
    "C36",
    "Conclusion",
    "Numerically stable integration.",
    kind=Correction.repairs,
    correction="Conditionally stable. The palindromic B½ A½ C A½ B½ needs ωh < 2 whatever the damping; the "
    "printed order (ωh)² < 2 (1 + e^{γh}), which is 2 at γ = 0 and a little more with damping. "
    "See the stability table for the merged flow AC and for the other methods.",
    scene="oscillator, γ = 0, 0.1, 1",
    method="contact-printed, contact-abc",
)
def conditional_stability() -> Evidence:
    gammas = (0.0, 0.1, 1.0)
    why = "bounded orbits need no eigenvalue beyond the unit circle; 10⁻⁷ is the square root of round-off"
    beyond = max(radius(name, gamma, 2.5) for name in (PRINTED, ABC) for gamma in gammas)
    calm = max(
        radius(name, gamma, h)
        for name in (PRINTED, ABC)
        for gamma in gammas
        for h in np.linspace(0.05, 1.95, 39)
    )
    edges = [border(ABC, gamma) for gamma in gammas]
    edge = border(PRINTED, 0.1)
    near = "the slack 10⁻⁷ of the eigenvalue, magnified where two of them meet on the circle"
    return Evidence(
        [at_most("largest spectral radius of a step at ωh = 2.5", beyond, 1 + SLACK, why)],
        [
            at_most("the same for ωh = 0.05, 0.1, …, 1.95", calm, 1 + SLACK, why),
            at_most(
                "max |border − 2| for contact-abc, γ = 0, 0.1, 1", max(abs(e - 2) for e in edges), 1e-5, near
            ),
            at_most(
                "|(ωh)² − 2(1 + e^{γh})| at the border of contact-printed, γ = 0.1",
                abs(edge**2 - 2 * (1 + math.exp(0.1 * edge))),
                1e-5,
                near,
            ),
        ],
    )
