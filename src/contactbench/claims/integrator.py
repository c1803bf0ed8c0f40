"""Claims about the integrators and the numerical example (§5 and §6 of the paper), and claims beyond the paper."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.claims.geometry import (
    IDENTITY,
    ROUND_OFF,
    SEED,
    Field,
    canonical,
    contact_equations,
    eta,
    everywhere,
    gradient,
    jacobian,
    largest,
    pack,
    points,
    pullback,
)
from contactbench.claims.ledger import CORRECTED, Evidence, at_least, at_most, claim
from contactbench.measure.law import round_off_bound
from contactbench.measure.laws import LAWS
from contactbench.measure.order import fit_order
from contactbench.measure.pullback import growth
from contactbench.measure.stability import SLACK, spectral_radius, true_radius
from contactbench.methods import METHODS, solve
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.loops import trajectory
from contactbench.scene import Mechanical, Scene, State
from contactbench.scenes import SCENES
from contactbench.solution import Solution
from contactbench.splitting.modified import modified_hamiltonian
from contactbench.truth import decimal_context, distance, reference, with_decimals
from contactbench.xla import jax, jnp

if TYPE_CHECKING:
    from jax import Array
    from mpmath import MPContext

PARTICLE = SCENES["particle"]
PRINTED, ABC, STRANG, RK4 = "contact-printed", "contact-abc", "contact-strang", "rk4"
PAPER_STEP = 0.01
#: a fitted order may miss the nominal one by this much at the step sizes used
ORDER_MISS = 0.1
ORDER_WHY = "the next term of the error bends the slope by a few per cent at the steps used"
ORDER = ORDER_MISS, ORDER_WHY


def slope(errors: dict[float, float]) -> float:
    """Return the order, fitted above 10⁻¹²: errors below it are round-off of some 10⁴ steps in double precision."""
    return fit_order(list(errors), list(errors.values()), 1e-12).order


def exact_scene(changes: Mapping[str, object]) -> tuple[MPContext, Scene]:
    """Return a 50-digit number namespace, and the particle, changed, with such numbers."""
    context = decimal_context(50)
    return context, with_decimals(PARTICLE.with_(**changes), context.mpf)


def exact_order(name: str, **changes: object) -> float:
    """Return the order of the error of (q, p) over t = 1, …, 4 in 50 digits; changes : of the particle."""
    context, twin = exact_scene(changes)
    decimals = reference(PARTICLE.with_(**changes), range(1, 5), ()).decimals
    truth = [[context.mpf(x) for x in row] for row in decimals]
    errors = {}
    for n in (32, 64, 128, 256):
        states = trajectory(METHODS[name], twin, twin.initial(()), [(context.mpf(1) / n, n)] * 4, context)
        errors[1 / n] = float(max(distance(twin.pack(x), y) for x, y in zip(states, truth, strict=True)))
    return slope(errors)


def one_step(method: FixedStep, scene: Scene, h: float) -> Field:
    return lambda y: pack(method.advance(scene, canonical(y), h, 1, jnp))


# -- the discrete Herglotz principle ---------------------------------------------------------------
#: (q_k, q_{k+1}, s_k) ↦ s_{k+1}
type Recursion = Callable[[Array, Array, Array], Array]


def action_slope(method: str, scene: Mechanical, h: float, recursion: Recursion) -> float:
    """Return max |∂s_N/∂q_k| along 20 steps of a method, the ends q_0 and q_N held: 0 where it is variational."""
    start = scene.initial(("s",))
    path = [start, *trajectory(METHODS[method], scene, start, [(h, 1)] * 20, math)]
    q = jnp.array([x.q for x in path])

    def action(inner: Array) -> Array:
        s = jnp.asarray(scene.s)
        for a, b in itertools.pairwise([q[0], *inner, q[-1]]):
            s = recursion(a, b, s)
        return s

    return float(np.abs(jax.jit(gradient(action))(q[1:-1])).max())


@claim("C23")
def discrete_herglotz(seed: int = SEED, gamma: float = 0.1, h: float = 0.1) -> Evidence:
    scene = PARTICLE.with_(gamma=gamma)
    method = METHODS["herglotz1"]

    def recursion(a: Array, b: Array, s: Array) -> Array:
        """Return s_{k+1} with L = ½‖Δq/h‖² − V(q_k) − γ s_k."""
        v = (b - a) / h
        return jnp.asarray(s + h * (v @ v / 2 - scene.V(tuple(a)) - scene.gamma * s))

    def symplectic_defect(y: Array) -> Array:
        derivative = jacobian(one_step(method, scene.with_(gamma=0.0), h))(y)[:4, :4]
        omega = jnp.kron(jnp.array([[0.0, 1.0], [-1.0, 0.0]]), jnp.eye(2))
        return derivative.T @ omega @ derivative - omega

    stationary = action_slope("herglotz1", scene, h, recursion)
    defect = largest(symplectic_defect, points(5, seed=seed))
    first, second = exact_order("herglotz1"), exact_order("herglotz2")
    yield at_most("max |∂s_N/∂q_k| along a computed curve of 20 steps", stationary, *IDENTITY)
    yield at_most("max |DΦᵀΩDΦ − Ω| at γ = 0", defect, *IDENTITY)
    yield CORRECTED
    yield at_most("|order − 1| of herglotz1, 50 digits", abs(first - 1), *ORDER)
    yield at_most("|order − 2| of herglotz2, 50 digits", abs(second - 2), *ORDER)


@claim("C48")
def variational_splitting(gamma: float = 0.1, h: float = 0.1) -> Evidence:
    """gamma : > 0."""
    scene = PARTICLE.with_(gamma=gamma)
    decay, span = math.exp(-gamma * h), -math.expm1(-gamma * h) / gamma
    # the kinetic part of s₁ over ‖q₁ − q₀‖²: of A after C, of A½ C A½, of A and C together
    kinetic = {PRINTED: 1 / (2 * h), ABC: decay / (h * (1 + decay)), STRANG: decay / (2 * span)}

    def of(name: str) -> Recursion:
        def recursion(a: Array, b: Array, s: Array) -> Array:
            before, after = (h / 2 * jnp.asarray(scene.V(tuple(q))) for q in (a, b))
            return decay * (s - before) + kinetic[name] * ((b - a) @ (b - a)) - after

        return recursion

    for name in kinetic:
        slope = action_slope(name, scene, h, of(name))
        yield at_most(f"max |∂s_N/∂q_k| along a computed curve of 20 steps, {name}", slope, *IDENTITY)
    yield CORRECTED
    no_map = 1e3 * ROUND_OFF, "a thousand times the bound the splitting keeps"
    yield at_least(
        f"the same of {STRANG}'s action along a curve of rk4",
        action_slope(RK4, scene, h, of(STRANG)),
        *no_map,
    )


# -- subflows and compositions ---------------------------------------------------------------------
def flow_defect(flow: Callable[[float, Array], Array], hamiltonian: Field, seed: int) -> float:
    """Return max |dφ_h/dh − X_H(φ_h)|/(1 + |φ_h|) and |φ_0 − id| at random points and h: 0 for the exact flow."""
    field = contact_equations(hamiltonian)

    def defect(point: Array) -> Array:
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

    def part_defect(name: str, scene: Scene) -> float:
        part, flow = hamiltonians[name], scene.flows[name]
        map_ = lambda h, y: pack(flow.apply(scene, canonical(y), flow.constants(scene, h, jnp), jnp))  # noqa: E731
        return flow_defect(map_, lambda y: part(scene, canonical(y)), seed)

    quartic = lambda y: jnp.sum(y[2:4] ** 4) / 4  # noqa: E731

    def quartic_defect(general: bool) -> float:
        def flow(h: Array | float, y: Array) -> Array:
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
def printed_composition(**changes: object) -> Evidence:
    """changes : of the particle, e.g. ``gamma``."""

    def asymmetry(name: str) -> float:
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

        def at(y: Array) -> Array:
            drift = pullback(map_, eta, y) / decay - eta(y)
            return jnp.asarray(jnp.linalg.norm(drift) / jnp.linalg.norm(eta(y)))

        return float(everywhere(at, points(5, seed=seed)).max())

    sizes = (0.5, 0.1, 0.02)
    drifts = {h: max(drift(name, h) for name in (PRINTED, ABC, STRANG)) for h in sizes}
    third_order = 1.0, "a constant of size one in O(h³)"
    over_cube = max(d / h**3 for h, d in drifts.items())
    yield at_most(f"drift of one step over h³, h = {sizes}", over_cube, *third_order)
    yield CORRECTED
    yield at_most(f"drift of one step, h = {sizes}", max(drifts.values()), *IDENTITY)


def local_orders(name: str, scene: Scene, starts: np.ndarray) -> list[float]:
    """Return the powers of h in the errors of H0 and s after a step from `starts` (k, 5), against DOP853 at 10⁻¹³."""

    def state(y: np.ndarray) -> State:
        q1, q2, p1, p2, s = y.reshape(-1, 5).T
        return State((q1, q2), (p1, p2), s)

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
    scene, starts = PARTICLE.with_(gamma=gamma), points(5, seed=seed)
    printed, abc, strang = (local_orders(name, scene, starts) for name in (PRINTED, ABC, STRANG))

    def momentum_law(name: str) -> float:
        scene, t = SCENES[name].with_(gamma=gamma), np.arange(1, 41) / 2
        return float(LAWS["momentum_law"](solve(scene, PRINTED, step=0.5, save_at=t, engine="python")))

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


def radius(name: str, gamma: float, h: float | np.ndarray) -> np.ndarray:
    """Return the largest |eigenvalue| of one step on the oscillator with ω = 1."""
    return np.asarray(spectral_radius(METHODS[name], gamma, 1.0, h))


def border(name: str, gamma: float) -> float:
    """Return the smallest ωh > 1 at which an eigenvalue of the step leaves the unit circle."""
    over = lambda h: float(radius(name, gamma, h)) - 1 - SLACK  # noqa: E731
    return float(scipy.optimize.brentq(over, 1.0, 4.5, xtol=1e-12))


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
    """gammas : of the undamped method's interval.  weak : for the printed order beyond it, between 0 and 0.4."""
    why = "bounded orbits need no eigenvalue beyond the unit circle; 10⁻⁷ is the square root of round-off"
    inside = np.linspace(0.01, 1.999, 2000)
    bounded = 1 + SLACK, why
    listed = ", ".join(f"{gamma:g}" for gamma in gammas)
    edge = border(PRINTED, weak)
    at_two = max(abs(border(ABC, gamma) - 2) for gamma in gammas)
    by_formula = abs(edge**2 - 2 * (1 + math.exp(weak * edge)))
    start = abs(unconditional_from(PRINTED) - threshold())
    slow = math.log(radius(PRINTED, 1.0, 20.0)) / math.log(true_radius(1.0, 1.0, 20.0))
    near = 1e-5, "the slack 10⁻⁷ of the eigenvalue, magnified where two of them meet on the circle"
    sampled = 1e-5, "the slack 10⁻⁷ of the eigenvalue, over its slope in γ, and the sampling of h"
    vanishing = 1e-2, "about 2 ωh e^{−γh}, which tends to 0"
    printed = f"|(ωh)² − 2(1 + e^{{γh}})| at the border of contact-printed, γ = {weak:g}"
    every_step = f"|γ/ω − {threshold():.5f}| from which contact-printed is stable at every step size"
    for name in (PRINTED, ABC):
        largest_inside = max(float(radius(name, gamma, inside).max()) for gamma in gammas)
        yield at_most(f"largest spectral radius, ωh < 2, {name}, γ = {listed}", largest_inside, *bounded)
    yield CORRECTED
    beyond = max(largest_radius(name, weak) for name in (PRINTED, ABC))
    yield at_least(
        f"the same for ωh to 200, γ = {weak:g}", beyond, 1.1, "unstable: no explicit method reaches so far"
    )
    yield at_most(f"max |border − 2| for contact-abc, γ = {listed}", at_two, *near)
    yield at_most(printed, by_formula, *near)
    yield at_most(every_step, start, *sampled)
    yield at_most("decay rate of its slow mode over the true one, γ/ω = 1, ωh = 20", slow, *vanishing)


# -- the numerical example: the 2-DOF damped particle ----------------------------------------------
WIDTH = 1e-2, "one per cent of the energy, a line's width in the paper's figure"


def numerical(scene: Scene, method: str, step: float, count: int) -> Solution:
    """Return a run without s, saved at `count` equal intervals, start included."""
    t = np.linspace(0, scene.t_end, count + 1)
    return solve(scene, method, step=step, save_at=t, carry=(), engine="python")


@claim("C29")
def closeness(**changes: object) -> Evidence:
    printed, rk4 = (numerical(PARTICLE.with_(**changes), name, PAPER_STEP, 200).y for name in (PRINTED, RK4))
    off = np.abs(printed - rk4).max() / np.abs(rk4).max()
    width = 1e-2, "one per cent of the amplitude, a line's width in the paper's figure"
    yield at_most("max |(q, p) − (q, p)_RK4| / max |(q, p)|", off, *width)


def rises(name: str, gamma: float, h: float, **changes: object) -> tuple[int, float]:
    """Return how many steps raise H0, and the largest rise over H0(0); T = 20."""
    run = numerical(PARTICLE.with_(gamma=gamma, **changes), name, h, round(20 / h))
    energy = run.scene.energy(run.states())
    change = np.diff(energy) / energy[0]
    return int(np.count_nonzero(change > 4 * np.finfo(float).eps)), float(change.max())


def monotone_from(name: str, h: float) -> float:
    """Return the damping γ from which no step of h raises H0 of the particle, to 2 %; T = 20."""
    low, high = 1e-2 * h * h, 1e2 * h * h
    while high / low > 1.02:
        middle = (low * high) ** 0.5
        low, high = (middle, high) if rises(name, middle, h)[0] else (low, middle)
    return high


#: starts of the particle at rest, at which ‖p‖ comes near 0 again
AT_REST: dict[str, dict[str, object]] = {
    "start (0, 1; 0, 0)": {"q": (0.0, 1.0), "p": (0.0, 0.0)},
    "start (1, 0; 0, 0)": {"q": (1.0, 0.0), "p": (0.0, 0.0)},
}


@claim("C30")
def monotone_methods(gamma: float = 0.1, weak: float = 1e-3, coarse: float = 0.1) -> Evidence:
    """gamma : with the paper's h.  weak, coarse : damping and step where H0 rises."""
    found = 0.15, "the border is found to 2 %, and the printed order approaches the constant as h → 0"
    raising = "steps that raise H0"
    weakly = f"{raising} at γ = {weak:g}, h = {coarse:g}"
    largest_rise = 0.0
    for start, changes in {"our start": {}, **AT_REST}.items():
        for name in (PRINTED, RK4):
            n, rise = rises(name, gamma, PAPER_STEP, **changes)
            largest_rise = max(largest_rise, rise)
            quantity = f"{raising} at γ = {gamma:g}, h = 0.01, {start}, {name}"
            yield at_most(quantity, n, 0, "monotone decay has none")
    yield CORRECTED
    for name in (PRINTED, STRANG):
        yield at_least(f"{weakly}, {name}", rises(name, weak, coarse)[0], 1, "not monotone")
    rk4, _ = rises(RK4, weak, coarse)
    yield at_most(f"the same, {RK4}", rk4, 0, "its own dissipation lowers H0 further")
    for name in (PRINTED, STRANG):
        for h in (0.1, 0.05):
            edge = monotone_from(name, h) / (0.75 * h * h)
            at = f"at the border of monotone decay, {name}, h = {h:g}"
            yield at_most(f"|γ/(¾ h²) − 1| {at}", abs(edge - 1), *found)
    yield at_most("largest rise from these starts over H0(0)", largest_rise, PAPER_STEP**3, "O(h³)")


@claim("C43")
def guaranteed_decay(weak: float = 1e-3, coarse: float = 0.1) -> Evidence:
    """weak, coarse : damping and step, γ below ¾ h²."""
    for start, changes in {"our start": {}, **AT_REST}.items():
        n, _ = rises(PRINTED, weak, coarse, **changes)
        quantity = f"steps that raise H0 at γ = {weak:g}, h = {coarse:g}, {start}"
        yield at_most(quantity, n, 0, "consistent decay has none: H0' = −γ‖p‖²")
    yield CORRECTED
    for name in ("particle", "central"):
        quantity = f"max |J e^{{γt}}/J(0) − 1| or contact_drift, {name}, h = ½"
        scene = SCENES[name]
        laws = ("contact_drift", "momentum_law") if name == "central" else ("contact_drift",)
        run = solve(scene, PRINTED, step=0.5, save_at=np.arange(1, 41) / 2, engine="python")
        yield at_most(
            quantity, max(float(LAWS[law](run)) for law in laws), ROUND_OFF, "round-off of the steps taken"
        )


def balance_defect(name: str, h: float, gamma: float) -> float:
    """Return max |H0(t) − H0(0) + γ ∫‖p‖²| / H0(0), the integral by splines through every step."""
    run = numerical(PARTICLE.with_(gamma=gamma), name, h, round(20 / h))
    power = gamma * (run.y[:, 2:] ** 2).sum(axis=1)
    work = scipy.interpolate.make_interp_spline(run.t, power, k=7).antiderivative()
    energy = run.scene.energy(run.states())
    return float(np.abs(energy - energy[0] + work(run.t) - work(0.0)).max() / energy[0])


@claim("C31")
def dissipation_law(gamma: float = 0.1) -> Evidence:
    ladder = min(1, gamma / 0.1) * np.array([0.025, 0.0125, 0.00625, 0.003125])  # h well below γ
    defect = balance_defect(PRINTED, PAPER_STEP, gamma)
    yield at_most("max |H0(t) − H0(0) + γ∫‖p‖²|/H0(0), h = 0.01", defect, *WIDTH)
    for name, order in ((PRINTED, 1), (STRANG, 2)):
        found = slope({h: balance_defect(name, h, gamma) for h in ladder})
        why = f"its order is {order} (C25)"
        yield at_least(f"order of this defect, {name}", found, order - ORDER_MISS, why)


@claim("C32")
def exponential_energy(**changes: object) -> Evidence:
    scene = PARTICLE.with_(**changes)
    t = np.linspace(0, scene.t_end, 201)
    truth = reference(scene, t).states()
    run = solve(scene, PRINTED, step=PAPER_STEP, save_at=t, carry=("s",), engine="python")

    def deviation(energy: np.ndarray) -> float:
        growing = energy * np.exp(scene.gamma * t)
        return float(np.abs(growing / growing[0] - 1).max())

    of_H0, of_H = deviation(scene.energy(truth)), deviation(scene.hamiltonian_at(truth))
    of_printed = deviation(scene.hamiltonian_at(run.states()))
    rounded = 1e-13, "the reference rounded to double precision; q, p and s decay as H does"
    yield at_most("read for H0: max |H0(t) e^{γt}/H0(0) − 1| of the truth", of_H0, *WIDTH)
    yield CORRECTED
    yield at_most("read for H: max |H(t) e^{γt}/H(0) − 1| of the truth", of_H, *rounded)
    yield at_most("the same of contact-printed, h = 0.01", of_printed, *WIDTH)


NOMINAL = {PRINTED: 1, ABC: 2, STRANG: 2, RK4: 4}
ENERGY_LADDER = (16, 32, 64, 128, 256, 512)  #: steps per unit of time


def energy_errors(
    name: str, scene: Scene, counts: Sequence[int], energy: str = "energy"
) -> dict[float, float]:
    """Return the paper's measure, max |E − E*| over 20 equal times, against the step; energy : which one."""
    carry = ("s",) if energy == "hamiltonian" else ()
    value = getattr(scene, energy)
    t = scene.t_end * np.arange(1, 21) / 20
    truth = value(reference(scene, t, carry).states())
    errors = {}
    for n in counts:
        h = scene.t_end / (20 * n)
        run = solve(scene, name, step=h, save_at=t, carry=carry, engine="python")
        errors[h] = float(np.abs(value(run.states()) - truth).max())
    return errors


def body_error(law: str, name: str, steps: int) -> float:
    """Return the error of a law at five times over the span of the body, which is run without R and s."""
    scene = SCENES["rigid_body"]
    t = scene.t_end * np.arange(1, 6) / 5
    return float(LAWS[law](solve(scene, name, step=scene.t_end / steps, save_at=t, carry=())))


@claim("C33")
def convergence_orders(**changes: object) -> Evidence:
    scene = PARTICLE.with_(**changes)
    # the caption's H is read both ways, as in C32
    readings = {"H0": "energy", "H": "hamiltonian"}
    cases = itertools.product(readings.items(), NOMINAL)
    orders = {(m, label): slope(energy_errors(m, scene, ENERGY_LADDER, E)) for (label, E), m in cases}
    for label in readings:
        quantity, least, most = f"order of the {label} error", 2 - ORDER_MISS, 2 + ORDER_MISS
        yield at_least(f"{quantity}, {PRINTED}", orders[PRINTED, label], least, ORDER_WHY)
        yield at_most(f"{quantity}, {RK4}", orders[RK4, label], most, ORDER_WHY)
    yield CORRECTED
    for (name, label), order in orders.items():
        nominal = NOMINAL[name]
        quantity = f"|order of the {label} error − {nominal}|, {name} (order {order:.2f})"
        yield at_most(quantity, abs(order - nominal), *ORDER)
    energy_error = max(body_error("energy_law_relative", name, 50) for name in (PRINTED, ABC))
    quantity = "max |H0(t) e^{2γt}/H0(0) − 1| of contact-printed and contact-abc on rigid_body, h = 0.4"
    yield at_most(quantity, energy_error, ROUND_OFF, "round-off of 50 steps")
    for name in (PRINTED, ABC):
        order = slope({1 / n: body_error("solution_error", name, n) for n in (20, 40, 80, 160)})
        quantity = f"|order of the solution error − {NOMINAL[name]}| on rigid_body, {name}"
        yield at_most(quantity, abs(order - NOMINAL[name]), *ORDER)


@claim("C34")
def contact_drifts(**changes: object) -> Evidence:
    scene, law = PARTICLE.with_(**changes), LAWS["contact_drift"]
    end = {"save_at": [scene.t_end]}
    ours = max(law(solve(scene, name, step=0.1, **end)) for name in (PRINTED, ABC, STRANG))
    rk4, tsit5 = law(solve(scene, RK4, step=0.1, **end)), law(solve(scene, "diffrax-tsit5", rtol=1e-6, **end))
    rounding = ROUND_OFF, "round-off of 200 steps"
    above = 1e3 * ROUND_OFF, "a thousand times the bound the contact methods keep"
    yield at_most("largest contact_drift of the contact methods, h = 0.1", ours, *rounding)
    yield at_least("contact_drift of rk4, h = 0.1", rk4, *above)
    yield at_least("contact_drift of diffrax-tsit5, rtol 10⁻⁶", tsit5, *above)


#: contact integrators that others have published, and when
PUBLISHED = {"herglotz2": 2019, ABC: 2020}


@claim("C51")
def published_integrators(scene: str = "kepler_drag", order: int = 2) -> Evidence:
    """order : that of `PUBLISHED`."""
    kepler, orders, drifts = SCENES[scene], {}, {}
    for name in PUBLISHED:
        errors = {}
        for h in kepler.t_end / np.array([64_000, 128_000, 256_000, 512_000]):
            run = solve(kepler, name, step=h, save_at=[kepler.t_end])
            errors[h] = float(LAWS["solution_error"](run))
        bound = round_off_bound(growth(run.differential), run.counts.evaluations or 0)
        orders[name], drifts[name] = slope(errors), float(LAWS["distribution_drift"](run)) / bound
    solving = [name for name in PUBLISHED if abs(orders[name] - order) <= ORDER_MISS and drifts[name] <= 1]
    listed = ", ".join(f"{name} ({year})" for name, year in PUBLISHED.items())
    found = f"contact integrators published before that solve {scene}, of {listed}"
    off = max(abs(measured - order) for measured in orders.values())
    rounding = 1, "ε times evaluations and growth of the map"
    yield at_most(found, len(solving), 0, "a gap has none")
    yield CORRECTED
    yield at_most(f"largest |order − {order}| of these on {scene}", off, *ORDER)
    yield at_most(
        "largest distribution_drift over the bound of its round-off", max(drifts.values()), *rounding
    )


def nearest_return(curve: np.ndarray) -> float:
    """Return how near a curve (k, d) comes to its start after it has left, relative to the size of the start."""
    start = curve[0]
    left = int(np.argmax(np.linalg.norm(curve - start, axis=1) > np.linalg.norm(start)))
    a, b = curve[left:-1], curve[left + 1 :]
    along = np.clip(((start - a) * (b - a)).sum(axis=1) / ((b - a) ** 2).sum(axis=1), 0, 1)
    return float(np.linalg.norm(a + along[:, None] * (b - a) - start, axis=1).min() / np.linalg.norm(start))


@claim("C35")
def conservative_limit(**changes: object) -> Evidence:
    span, h = 20_000.0, 0.1
    free = PARTICLE.with_(gamma=0.0, t_end=span, **changes)
    run = solve(free, PRINTED, step=h, save_at=np.arange(1, 40_001) * (span / 40_000), carry=())
    off = np.abs(free.energy(run.states()) / free.energy(free.initial(())) - 1)
    early, late = off[:20_000].max(), off[20_000:].max()

    def distance(scene: Mechanical, **changes: object) -> float:
        scene = scene.with_(gamma=0.0, **changes)
        t = np.arange(0, 10001) * PAPER_STEP
        return nearest_return(solve(scene, PRINTED, step=PAPER_STEP, save_at=t, carry=(), engine="python").y)

    oscillates = h * h, "h²: the oscillation of a second-order symplectic method, with a constant of one"
    no_trend = 1.1, "a linear trend would double it"
    bounded = at_most("max |H0/H0(0) − 1| over T = 20000 at h = 0.1", off.max(), *oscillates)
    steady = at_most("the same over the second half of the run, over the first", late / early, *no_trend)
    particle, oscillator = distance(PARTICLE, **changes), distance(SCENES["oscillator"])
    special = distance(PARTICLE, q=(0.0, 0.5), p=(0.0, 0.3))
    closes = 1e-3, "ten times h² = 10⁻⁴ of the step used"
    yield from (bounded, steady)
    yield at_most("nearest return to the start over T = 100, particle", particle, *closes)
    yield CORRECTED
    yield from (bounded, steady)
    yield at_most("nearest return to the start over T = 100, oscillator", oscillator, *closes)
    yield at_most("the same, particle from q₁ = p₁ = 0", special, *closes)


# -- beyond the paper: what the contact form implies over long times -------------------------------------
#: steps that divide the time between two saved states
BETWEEN = 0.4
LADDER = tuple(BETWEEN / n for n in (2, 3, 4, 5, 6))


def deviations(degree: int, **changes: object) -> dict[float, float]:
    """Return max |H̃e^{γt}/H̃(y₀) − 1| of contact-strang against the step; H̃ has brackets of up to `degree` parts."""
    scene, composition = PARTICLE.with_(**changes), METHODS[STRANG].composition
    found = {}
    for h in LADDER:
        run = solve(scene, STRANG, step=h, save_at=BETWEEN * np.arange(1, 51))
        states = run.states(), run.start()
        value, start = (modified_hamiltonian(scene, composition, x, h, degree) for x in states)
        found[h] = float(np.abs(value * np.exp(scene.gamma * run.t) / start - 1).max())
    return found


def halves(method: str, law: str, gamma: float, steps: int) -> tuple[float, float]:
    """Return the largest deviation from a law in the first half of a run with h = 0.1, and in the second."""
    scene = PARTICLE.with_(gamma=gamma, t_end=0.1 * steps)
    run = solve(scene, method, step=0.1, save_at=scene.t_end * np.arange(1, 4001) / 4000)
    size = LAWS[law].along(run).size  # type: ignore[union-attr]
    return float(size[:2000].max()), float(size[2000:].max())


@claim("X01")
def near_conservation(gamma: float = 0.1, weak: float = 1e-5, steps: int = 1_000_000) -> Evidence:
    """gamma : of the orders.  weak, steps : damping and length of the long run."""
    for what, degree, expected in (("H", 1, 2), ("H + h² H₂", 3, 4), ("H + h² H₂ + h⁴ H₄", 5, 6)):
        quantity = f"|order − {expected}| of the deviation of {what} from e^{{−γt}}, γ = {gamma:g}"
        yield at_most(quantity, abs(slope(deviations(degree, gamma=gamma)) - expected), *ORDER)
    early, late = halves(STRANG, "modified_hamiltonian", weak, steps)
    plain, plain_late = halves(STRANG, "hamiltonian_law", weak, steps)
    drifting, drifted = halves(RK4, "hamiltonian_law", weak, steps)
    no_drift = 1.1, "a linear drift would double it"
    fourth_order = 1e-3, "h⁴ = 10⁻⁴ times a constant of ten"
    halves_of = f"deviation of H̃ up to h⁴ in the second half of {steps:.0e} steps over that in the first"
    yield at_most(halves_of, late / early, *no_drift)
    yield at_most("the same of H", plain_late / plain, *no_drift)
    yield at_most("deviation of H̃ up to h⁴ over that of H", late / plain_late, *fourth_order)
    a_drift = 1.5, "a drift, linear until it bends"
    yield at_least("the same halves of H under rk4", drifted / drifting, *a_drift)


STEPS, PEERS = (0.4, 0.2, 0.1, 0.05, 0.025), ("cyrk-dop853", "cyrk-vern8", "cyrk-tsit5")


def pairing(method: str, **setting: float) -> tuple[float, float]:
    """Return pairing_drift of a run of the chaotic scene, its steps held fixed, and the bound of its round-off."""
    scene = SCENES["duffing"]
    run = solve(scene, method, save_at=scene.t_end * np.arange(1, 6) / 5, **setting)
    drift = float(LAWS["pairing_drift_frozen"](run))
    return drift, round_off_bound(growth(run.frozen_differential), run.counts.evaluations or 0)


@claim("X02")
def pairs_kept(rough: float = 1e-4, fine: float = 1e-8) -> Evidence:
    """rough, fine : tolerances of the solvers that choose their steps."""
    kept = [pairing(name, step=h) for name in (STRANG, "contact-rkn4", "contact-rkn6") for h in STEPS]
    herglotz, rk4 = ({h: pairing(name, step=h)[0] for h in STEPS} for name in ("herglotz2", RK4))
    peers = {rtol: [pairing(name, rtol=rtol)[0] for name in PEERS] for rtol in (rough, fine)}
    worst, ratio = max(drift / bound for drift, bound in kept), min(peers[rough]) / max(peers[fine])
    rounding = 1, "ε times evaluations and growth of the map"
    own_factor = ORDER_MISS, "its own factor is (1 − γh/2)/(1 + γh/2)"
    above = 1e-11, "a hundred times the round-off of the contact methods"
    ours = "pairing_drift over the bound of its round-off, the largest of the contact methods at all steps"
    smallest = "smallest pairing_drift at rtol = "
    yield at_most(ours, worst, *rounding)
    yield at_most("|order of pairing_drift − 2|, herglotz2", abs(slope(herglotz) - 2), *own_factor)
    yield at_least("pairing_drift of rk4 at its finest step", rk4[min(STEPS)], *above)
    yield at_least(f"{smallest}{fine:g}, {', '.join(PEERS)}", min(peers[fine]), *above)
    yield at_least(f"{smallest}{rough:g} over the largest at {fine:g}", ratio, 10, "it follows the tolerance")
