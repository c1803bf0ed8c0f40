"""Claims about the integrators (§5 of the paper, and its abstract)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.claims.calculus import (
    IDENTITY,
    ROUND_OFF,
    SEED,
    canonical,
    contact_equations,
    eta,
    everywhere,
    largest,
    pack,
    points,
    pullback,
)
from contactbench.claims.ledger import CORRECTED, Evidence, at_least, at_most, claim
from contactbench.measure.laws import LAWS
from contactbench.measure.order import fit_order
from contactbench.measure.stability import SLACK, spectral_radius, true_radius
from contactbench.methods import METHODS, solve
from contactbench.methods.fixed_step_run import trajectory
from contactbench.scene import Mechanical
from contactbench.scenes import SCENES
from contactbench.splitting.flows import MECHANICAL
from contactbench.truth import decimal_context, distance, reference, with_decimals
from contactbench.xla import jax, jnp

PARTICLE = SCENES["particle"]
PRINTED, ABC, STRANG, RK4 = "contact-printed", "contact-abc", "contact-strang", "rk4"
PAPER_STEP = 0.01
#: a fitted order may miss the nominal one by this much at the step sizes used
ORDER_MISS = 0.1
ORDER_WHY = "the next term of the error bends the slope by a few per cent at the steps used"
ORDER = ORDER_MISS, ORDER_WHY


def slope(errors: dict[float, float]) -> float:
    """Return the order, fitted over the asymptotic range.

    Errors of H0 in double precision below 10⁻¹² are round-off of some 10⁴ steps; 50-digit errors stay above.
    """
    return fit_order(list(errors), list(errors.values()), 1e-12).order


def exact_scene(changes: dict[str, Any]) -> tuple[Any, Any]:
    """Return a 50-digit number namespace, and the particle, changed, with such numbers."""
    context = decimal_context(50)
    return context, with_decimals(PARTICLE.with_(**changes), context.mpf)


def exact_order(name: str, **changes: Any) -> float:
    """Return the order of the error of (q, p) over t = 1, …, 4, everything in 50 digits.

    changes : of the particle, e.g. ``gamma``; its truth then costs a second or two.
    """
    context, twin = exact_scene(changes)
    decimals = reference(PARTICLE.with_(**changes), range(1, 5), ()).decimals
    truth = [[context.mpf(x) for x in row] for row in decimals]
    errors = {}
    for n in (32, 64, 128, 256):
        states = trajectory(METHODS[name], twin, twin.initial(()), [(context.mpf(1) / n, n)] * 4, context)
        errors[1 / n] = float(max(distance(twin.pack(x), y) for x, y in zip(states, truth, strict=True)))
    return slope(errors)


def one_step(method: Any, scene: Any, h: float) -> Any:
    return lambda y: pack(method.advance(scene, canonical(y), h, 1, jnp))


# -- the discrete Herglotz principle ---------------------------------------------------------------
@claim("C23")
def discrete_herglotz(seed: int = SEED, gamma: float = 0.1, h: float = 0.1) -> Evidence:
    scene = PARTICLE.with_(gamma=gamma)
    method = METHODS["herglotz1"]
    start = scene.initial(("s",))
    path = [start, *trajectory(method, scene, start, [(h, 1)] * 20, math)]
    q = jnp.array([x.q for x in path])

    def action(inner):
        """Return s_N along a discrete curve with the ends q_0 and q_N held; L = ½‖Δq/h‖² − V(q_k) − γ s_k."""
        s = scene.s
        for a, b in itertools.pairwise([q[0], *inner, q[-1]]):
            v = (b - a) / h
            s = s + h * (v @ v / 2 - scene.V(tuple(a)) - scene.gamma * s)
        return s

    def symplectic_defect(y):
        """Return DΦᵀ Ω DΦ − Ω of the (q, p) part without damping."""
        derivative = jax.jacfwd(one_step(method, scene.with_(gamma=0.0), h))(y)[:4, :4]
        omega = jnp.kron(jnp.array([[0.0, 1.0], [-1.0, 0.0]]), jnp.eye(2))
        return derivative.T @ omega @ derivative - omega

    gradient = jax.jit(jax.grad(action))(q[1:-1])
    defect = largest(symplectic_defect, points(5, seed=seed))
    first, second = exact_order("herglotz1"), exact_order("herglotz2")
    yield at_most("max |∂s_N/∂q_k| along a computed curve of 20 steps", np.abs(gradient).max(), *IDENTITY)
    yield at_most("max |DΦᵀΩDΦ − Ω| at γ = 0", defect, *IDENTITY)
    yield CORRECTED
    yield at_most("|order − 1| of herglotz1, 50 digits", abs(first - 1), *ORDER)
    yield at_most("|order − 2| of herglotz2, 50 digits", abs(second - 2), *ORDER)


# -- subflows and compositions ---------------------------------------------------------------------
def flow_defect(flow: Any, hamiltonian: Any, seed: int) -> float:
    """Return max |dφ_h/dh − X_H(φ_h)|/(1 + |φ_h|) and |φ_0 − id| at random points and h: 0 for the exact flow."""
    field = contact_equations(hamiltonian)

    def defect(point):
        h, y = point[0], point[1:]
        value, rate = jax.jvp(lambda h: flow(h, y), (h,), (1.0,))
        size = 1 + jnp.abs(value).max()
        return jnp.append((rate - field(value)) / size, flow(0.0, y) - y)

    return largest(defect, points(6, seed=seed))


@claim("C24")
def subflows(seed: int = SEED, gamma: float = 0.1, kappa: float = 0.05) -> Evidence:
    """kappa : of the quadratic damping that what goes beyond the claim is measured with."""
    scene = PARTICLE.with_(gamma=gamma)
    curved = scene.with_(kappa=kappa)
    hamiltonians = {
        "drift": lambda scene, x: scene.kinetic(x.p),
        "kick": lambda scene, x: scene.V(x.q),
        "damp": lambda scene, x: scene.dissipation(x.s),
        "drift_damp": lambda scene, x: scene.kinetic(x.p) + scene.dissipation(x.s),
    }

    def part_defect(name, scene):
        part, flow = hamiltonians[name], MECHANICAL[name]
        map_ = lambda h, y: pack(flow.apply(scene, canonical(y), flow.constants(scene, h, jnp), jnp))  # noqa: E731
        return flow_defect(map_, lambda y: part(scene, canonical(y)), seed)

    def quartic(y):
        return jnp.sum(y[2:4] ** 4) / 4

    def quartic_defect(general):
        def flow(h, y):
            q, p, s = y[:2], y[2:4], y[4]
            T, p_T = quartic(y), jnp.sum(p**4)
            action = s + h * (p_T - T if general else T)
            return jnp.concatenate([q + h * p**3, p, jnp.array([action])])

        return flow_defect(flow, quartic, seed)

    free = LAWS["solution_error"](solve(SCENES["rigid_body"].with_(gamma=0.0), ABC, step=20.0))
    measure, nonlinear = "max |dφ_h/dh − X(φ_h)|/(1 + |φ_h|), |φ_0 − id|", f"Γ = γs + ½κs², κ = {kappa:g}"
    no_flow = 1e-3, "far above round-off: it is not the flow"
    rounding = 10 * ROUND_OFF, "round-off of AD on numbers of size up to 100"
    for label, name in (("A", "drift"), ("B", "kick"), ("C", "damp"), ("A and C together", "drift_damp")):
        yield at_most(f"{measure}: {label} ({name})", part_defect(name, scene), *IDENTITY)
    yield CORRECTED
    yield at_most("solution_error of A alone on rigid_body, γ = 0, one step of h = 20", free, *IDENTITY)
    for label, name in (("C", "damp"), ("A and C together", "drift_damp")):
        off = part_defect(name, curved)
        yield at_most(f"the defect of a flow with {nonlinear}: {label}", off, *IDENTITY)
    yield at_most("A with s += h (p·T_p − T) for T = ¼ Σ p⁴", quartic_defect(True), *rounding)
    yield at_least("A as printed, s += h T, for the same T", quartic_defect(False), *no_flow)


@claim("C25")
def printed_composition(**changes: Any) -> Evidence:
    """changes : of the particle, e.g. ``gamma``."""

    def asymmetry(name: str) -> float:
        """Return |Φ_{−h} Φ_h x − x| in 50 digits for one step of h = 1/10."""
        context, twin = exact_scene(changes)
        x, h = twin.initial(("s",)), context.mpf(1) / 10
        forth = METHODS[name].advance(twin, x, h, 1, context)
        back = METHODS[name].advance(twin, forth, -h, 1, context)
        return float(distance(twin.pack(back), twin.pack(x)))

    smallest = min(exact_order(name, **changes) for name in (ABC, STRANG))
    second, rounding = (2 - ORDER_MISS, ORDER_WHY), (1e-40, "round-off at 50 digits")
    yield at_least("order of contact-printed, 50 digits", exact_order(PRINTED, **changes), *second)
    yield at_most("|Φ_{−h} Φ_h x − x| at h = 1/10, 50 digits", asymmetry(PRINTED), *rounding)
    yield CORRECTED
    yield at_least("smallest order of contact-abc and contact-strang", smallest, *second)
    yield at_most("largest |Φ_{−h} Φ_h x − x| of the two", max(asymmetry(ABC), asymmetry(STRANG)), *rounding)


@claim("C26")
def contact_structure(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    scene = PARTICLE.with_(gamma=gamma)

    def drift(name: str, h: float) -> float:
        """Return max ‖Φ_h*η − e^{−γh}η‖/‖e^{−γh}η‖ of one step at random points."""
        decay, map_ = math.exp(-gamma * h), one_step(METHODS[name], scene, h)

        def at(y: Any) -> Any:
            return jnp.linalg.norm(pullback(map_, eta, y) / decay - eta(y)) / jnp.linalg.norm(eta(y))

        return float(everywhere(at, points(5, seed=seed)).max())

    sizes = (0.5, 0.1, 0.02)
    drifts = {h: max(drift(name, h) for name in (PRINTED, ABC, STRANG)) for h in sizes}
    third_order = 1.0, "a constant of size one in O(h³)"
    over_cube = max(d / h**3 for h, d in drifts.items())
    yield at_most(f"drift of one step over h³, h = {sizes}", over_cube, *third_order)
    yield CORRECTED
    yield at_most(f"drift of one step, h = {sizes}", max(drifts.values()), *IDENTITY)


def local_orders(name: str, scene: Mechanical, starts: np.ndarray) -> list[float]:
    """Return the powers of h in the errors of H0 and s after one step from `starts` (k, 5).

    The truth is integrated with SciPy's DOP853 at a tolerance of 10⁻¹³, far below these errors.
    """

    def state(y: np.ndarray) -> Any:
        return scene.unpack(tuple(y.reshape(-1, 5).T), ("s",))

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        return np.stack(scene.pack(scene.rhs(state(y)))).T.ravel()

    times, solver = (0.001, 0.002, 0.004, 0.008), {"method": "DOP853", "rtol": 1e-13, "atol": 1e-15}
    run = scipy.integrate.solve_ivp(rate, (0, times[-1]), starts.ravel(), t_eval=times, **solver)
    of_energy, of_action = {}, {}
    for h, y in zip(times, run.y.T, strict=True):
        after, true = METHODS[name].advance(scene, state(starts), h, 1, np), state(y)
        of_energy[h] = float(np.abs(scene.energy(after) - scene.energy(true)).max())
        of_action[h] = float(np.abs(after.s - true.s).max())
    return [slope(of_energy), slope(of_action)]


@claim("C27")
def energy_and_action_decay(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    starts = points(5, seed=seed)
    printed, abc, strang = (
        local_orders(name, PARTICLE.with_(gamma=gamma), starts) for name in (PRINTED, ABC, STRANG)
    )

    def momentum_law(name):
        scene, t = SCENES[name].with_(gamma=gamma), np.arange(1, 41) / 2
        return LAWS["momentum_law"](solve(scene, PRINTED, step=0.5, save_at=t, engine="python"))

    exact = ROUND_OFF, "round-off of the steps taken"
    first, least = (2 - ORDER_MISS, "order 1 (C25): h² per step"), (3 - ORDER_MISS, ORDER_WHY)
    yield at_least("power of h in the error of H0 after one step, contact-printed", printed[0], *least)
    yield at_least("power of h in the error of s after one step, contact-printed", printed[1], *least)
    yield CORRECTED
    yield at_least("the same for H0, contact-abc and contact-strang", min(abc[0], strang[0]), *least)
    yield at_least("the same for s, contact-abc and contact-strang", min(abc[1], strang[1]), *least)
    yield at_least("smaller of the two powers, contact-printed", min(printed), *first)
    yield at_most("momentum_law on central at h = ½", momentum_law("central"), *exact)
    yield at_most("momentum_law on rigid_body at h = ½", momentum_law("rigid_body"), *exact)


@claim("C28")
def verlet_limit(h: float = PAPER_STEP, steps: int = 2000) -> Evidence:
    def difference(gamma: float) -> float:
        """Return max |(q, p) − Verlet's| over the steps."""
        scene = PARTICLE.with_(gamma=gamma)
        q, p = (np.array(v) for v in (scene.q, scene.p))
        most = 0.0
        for x in trajectory(METHODS[PRINTED], scene, scene.initial(()), [(h, 1)] * steps, math):
            p = p - h / 2 * np.array(scene.dV(tuple(q)))
            q = q + h * p
            p = p - h / 2 * np.array(scene.dV(tuple(q)))
            most = max(most, np.abs(q - np.array(x.q)).max(), np.abs(p - np.array(x.p)).max())
        return most

    near = 1e-8 * 5 * h * steps, "five times γ t: the amplitude decays by γ t/2, and the phase shifts with it"
    off = f"max |difference| from velocity Verlet over {steps} steps at γ = 0"
    yield at_most(off, difference(0.0), 0, "the same numbers, bit for bit")
    yield at_most("the same at γ = 10⁻⁸", difference(1e-8), *near)


# -- stability, by eigenvalues of a step -----------------------------------------------------------
FAR = np.geomspace(0.05, 200.0, 4001)  #: step sizes ωh at which "stable at every step size" is looked at


def radius(name: str, gamma: float, h: Any) -> Any:
    """Return the largest |eigenvalue| of one step on the oscillator with ω = 1."""
    return spectral_radius(METHODS[name], gamma, 1.0, h)


def border(name: str, gamma: float) -> float:
    """Return the smallest ωh > 1 at which an eigenvalue of the step leaves the unit circle."""
    return scipy.optimize.brentq(lambda h: radius(name, gamma, h) - 1 - SLACK, 1.0, 4.5, xtol=1e-12)


def largest_radius(name: str, gamma: float) -> float:
    """Return the largest spectral radius over step sizes, refined where it is largest."""
    coarse = radius(name, gamma, FAR)
    h = FAR[int(np.argmax(coarse))]
    return float(max(np.max(coarse), np.max(radius(name, gamma, np.linspace(0.97 * h, 1.03 * h, 2001)))))


def unconditional_from(name: str) -> float:
    """Return the γ/ω from which no step size has an eigenvalue outside the unit circle, by bisection."""
    low, high = 0.3, 0.7
    while high - low > 1e-9:
        middle = (low + high) / 2
        low, high = (middle, high) if largest_radius(name, middle) > 1 + SLACK else (low, middle)
    return (low + high) / 2


def threshold() -> float:
    """Return the same for the printed order by formula: x² ≤ 2(1 + e^{gx}) for every x = ωh, g = γ/ω.

    Where the two sides touch, x = g e^{gx}; with y = gx, e^y (y − 2) = 2, so y = 2 + W(2/e²) and
    g = √(y e^{−y}) = 0.49134, at ωh = g e^y = 4.514.
    """
    y = 2 + float(scipy.special.lambertw(2 / math.e**2).real)
    return math.sqrt(y * math.exp(-y))


@claim("C36")
def conditional_stability(gammas: Sequence[float] = (0.0, 0.1, 1.0), weak: float = 0.1) -> Evidence:
    """gammas : for the palindrome.  weak : for the printed order, between 0 and 0.4."""
    on_circle = (
        "bounded orbits need no eigenvalue beyond the unit circle; 10⁻⁷ is the square root of round-off"
    )
    bounded = 1 + SLACK, on_circle
    listed = ", ".join(f"{gamma:g}" for gamma in gammas)
    edge = border(PRINTED, weak)
    at_two = max(abs(border(ABC, gamma) - 2) for gamma in gammas)
    by_formula = abs(edge**2 - 2 * (1 + math.exp(weak * edge)))
    start = abs(unconditional_from(PRINTED) - threshold())
    slow = math.log(radius(PRINTED, 1.0, 20.0)) / math.log(true_radius(1.0, 1.0, 20.0))
    near = 1e-5, "the slack 10⁻⁷ of the eigenvalue, magnified where two of them meet on the circle"
    sampled = 1e-5, "the slack 10⁻⁷ of the eigenvalue, over its slope in γ, and the sampling of h"
    vanishing = 1e-2, "about 2 ωh e^{−γh}, which tends to 0"
    all_steps = "largest spectral radius of a step, ωh from 0.05 to 200"
    printed = f"|(ωh)² − 2(1 + e^{{γh}})| at the border of contact-printed, γ = {weak:g}"
    every_step = f"|γ/ω − {threshold():.5f}| from which contact-printed is stable at every step size"
    for name in (PRINTED, ABC):
        yield at_most(f"{all_steps}, {name}, γ = {weak:g}", largest_radius(name, weak), *bounded)
    yield CORRECTED
    yield at_most(f"max |border − 2| for contact-abc, γ = {listed}", at_two, *near)
    yield at_most(printed, by_formula, *near)
    yield at_most(every_step, start, *sampled)
    yield at_most("decay rate of its slow mode over the true one, γ/ω = 1, ωh = 20", slow, *vanishing)
