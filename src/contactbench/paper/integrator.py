"""Claims about the integrators and the numerical example (§5 and §6 of the paper), and claims beyond the paper."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.measure.law import round_off_bound
from contactbench.measure.laws import LAWS, energies, pulled_deviation
from contactbench.measure.order import fit_order
from contactbench.measure.pullback import growth, pairs, variational
from contactbench.measure.stability import SLACK, spectral_radius, true_radius
from contactbench.methods import METHODS, solve
from contactbench.methods.base import Method
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.loops import trajectory
from contactbench.paper import geometry
from contactbench.paper.geometry import SEED, Field, canonical, eta, jacobian, largest, pack, points
from contactbench.paper.ledger import Evidence, claim
from contactbench.scene import Mechanical, Scene, State
from contactbench.scenes import SCENES
from contactbench.solution import Differential, Solution
from contactbench.splitting.modified import modified_hamiltonian
from contactbench.truth import decimal_context, distance, reference, with_decimals
from contactbench.xla import jax_doubles as jax
from contactbench.xla import jnp_doubles as jnp

if TYPE_CHECKING:
    from jax import Array

PARTICLE = SCENES["particle"]
PRINTED, ABC, STRANG, RK4 = "contact-printed", "contact-abc", "contact-strang", "rk4"
NOMINAL = {PRINTED: 1, ABC: 2, STRANG: 2, RK4: 4}
PAPER_STEP = 0.01
#: a fitted order may miss the nominal one by this much at the step sizes used
ORDER_MISS = 0.1


def slope(errors: Mapping[float, float]) -> float:
    """Return the order, fitted above 10⁻¹²: smaller errors are round-off of some 10⁴ steps in doubles."""
    return fit_order(list(errors), list(errors.values()), 1e-12).order


def exact_order(method: FixedStep, scene: Scene) -> float:
    """Return the order of the error of (q, p) over t = 1, 2, 3, 4, everything in 50 digits."""
    context = decimal_context(50)
    twin = with_decimals(scene, context.mpf)
    decimals = reference(scene, range(1, 5), ()).decimals
    truth, errors = [[context.mpf(x) for x in row] for row in decimals], {}
    for n in (32, 64, 128, 256):
        states = trajectory(method, twin, twin.initial(()), [(context.mpf(1) / n, n)] * 4, context)
        errors[1 / n] = float(max(distance(twin.pack(x), y) for x, y in zip(states, truth, strict=True)))
    return slope(errors)


def one_step(method: FixedStep, scene: Scene, h: float) -> Field:
    return Field(lambda y: pack(method.advance(scene, canonical(y), h, 1, jnp)))


def symplectic_defect(name: str, scene: Scene, h: float, at: np.ndarray) -> float:
    """Return max |DΦᵀΩDΦ − Ω| of one step in (q, p), two degrees of freedom."""
    derivative = jacobian(one_step(METHODS[name], scene, h))
    omega = jnp.kron(jnp.array([[0.0, 1.0], [-1.0, 0.0]]), jnp.eye(2))

    def defect(y: Array) -> Array:
        D = derivative(y)[:4, :4]
        return D.T @ omega @ D - omega

    return largest(defect, at)


# -- the discrete Herglotz principle ---------------------------------------------------------------
def action_slope(method: str, scene: Mechanical, h: float, recursion: Callable[..., Array]) -> float:
    """Return max |∂s_N/∂q_k| along 20 steps, q_0 and q_N held, 0 if variational; s_{k+1} by (q_k, q_{k+1}, s_k)."""
    start = scene.initial(("s",))
    path = [start, *trajectory(METHODS[method], scene, start, [(h, 1)] * 20, math)]
    q = jnp.array([x.q for x in path])

    def action(inner: Array) -> Array:
        s = jnp.asarray(scene.s)
        for a, b in itertools.pairwise([q[0], *inner, q[-1]]):
            s = recursion(a, b, s)
        return s

    return float(np.abs(geometry.once(geometry.gradient(action))(q[1:-1])).max())


@claim("C23")
def discrete_herglotz(seed: int = SEED, gamma: float = 0.1, h: float = 0.1) -> Evidence:
    scene, at = PARTICLE.with_(gamma=gamma), points(5, seed=seed)

    def recursion(a: Array, b: Array, s: Array) -> Array:
        """Return s_{k+1} with L = ½‖Δq/h‖² − V(q_k) − γ s_k."""
        v = (b - a) / h
        return jnp.asarray(s + h * (v @ v / 2 - scene.V(tuple(a)) - scene.gamma * s))

    yield action_slope("herglotz1", scene, h, recursion)
    yield symplectic_defect("herglotz1", scene.with_(gamma=0.0), h, at)
    for name, nominal in (("herglotz1", 1), ("herglotz2", 2)):
        yield abs(exact_order(METHODS[name], PARTICLE) - nominal)


@claim("C48")
def variational_splitting(gamma: float = 0.1, h: float = 0.1) -> Evidence:
    scene = PARTICLE.with_(gamma=gamma)
    decay, span = math.exp(-gamma * h), -math.expm1(-gamma * h) / gamma
    # the kinetic part of s₁ over ‖q₁ − q₀‖²: of A after C, of A½ C A½, of A and C together
    kinetic = {PRINTED: 1 / (2 * h), ABC: decay / (h * (1 + decay)), STRANG: decay / (2 * span)}

    def recursion(name: str, a: Array, b: Array, s: Array) -> Array:
        before, after = (h / 2 * jnp.asarray(scene.V(tuple(q))) for q in (a, b))
        return decay * (s - before) + kinetic[name] * ((b - a) @ (b - a)) - after

    for name, action in ((PRINTED, PRINTED), (ABC, ABC), (STRANG, STRANG), (RK4, STRANG)):
        yield action_slope(name, scene, h, partial(recursion, action))


# -- subflows and compositions ---------------------------------------------------------------------
def flow_defect(flow: Callable[[float, Array], Array], hamiltonian: geometry.Map, seed: int) -> float:
    """Return max |dφ_h/dh − X_H(φ_h)|/(1 + |φ_h|) and |φ_0 − id| at random points and h: 0 for the exact flow."""
    field = geometry.contact_equations(hamiltonian)

    def defect(point: Array) -> Array:
        h, y = point[0], point[1:]
        value, rate = jax.jvp(lambda h: flow(h, y), (h,), (1.0,))
        size = 1 + jnp.abs(value).max()
        return jnp.append((rate - field(value)) / size, flow(0.0, y) - y)

    return largest(defect, points(6, seed=seed))


#: H of the subflows, by the name of the flow
PARTS: dict[str, Callable[[Any, State], Any]] = {
    "drift": lambda scene, x: scene.kinetic(x.p),
    "kick": lambda scene, x: scene.V(x.q),
    "damp": lambda scene, x: scene.dissipation(x.s),
    "drift_damp": lambda scene, x: scene.kinetic(x.p) + scene.dissipation(x.s),
}


@claim("C24")
def subflows(seed: int = SEED, gamma: float = 0.1, kappa: float = 0.05) -> Evidence:
    """kappa : of the quadratic damping that what goes beyond the claim is measured with."""
    scene = PARTICLE.with_(gamma=gamma)

    def part_defect(name: str, scene: Scene) -> float:
        flow = scene.flows[name]
        map_ = lambda h, y: pack(flow.apply(scene, canonical(y), flow.constants(scene, h, jnp), jnp))  # noqa: E731
        return flow_defect(map_, lambda y: PARTS[name](scene, canonical(y)), seed)

    def quartic_defect(general: bool) -> float:
        def flow(h: Array | float, y: Array) -> Array:
            T, p_T = jnp.sum(y[2:4] ** 4) / 4, jnp.sum(y[2:4] ** 4)
            action = y[4:] + h * (p_T - T if general else T)
            return jnp.concatenate([y[:2] + h * y[2:4] ** 3, y[2:4], action])

        return flow_defect(flow, lambda y: jnp.sum(y[2:4] ** 4) / 4, seed)

    yield from (part_defect(name, scene) for name in PARTS)
    yield LAWS["solution_error"](solve(SCENES["rigid_body"].with_(gamma=0.0), ABC, step=20.0))
    yield from (part_defect(name, scene.with_(kappa=kappa)) for name in ("damp", "drift_damp"))
    yield from (quartic_defect(general) for general in (True, False))


@claim("C25")
def printed_composition(**changes: object) -> Evidence:
    """changes : of the particle, e.g. ``gamma``."""
    scene, context = PARTICLE.with_(**changes), decimal_context(50)
    twin, h = with_decimals(scene, context.mpf), context.mpf(1) / 10

    def asymmetry(name: str) -> float:
        x = twin.initial(("s",))
        forth = METHODS[name].advance(twin, x, h, 1, context)
        back = METHODS[name].advance(twin, forth, -h, 1, context)
        return float(distance(twin.pack(back), twin.pack(x)))

    yield exact_order(METHODS[PRINTED], scene)
    yield asymmetry(PRINTED)
    yield min(exact_order(METHODS[name], scene) for name in (ABC, STRANG))
    yield max(asymmetry(ABC), asymmetry(STRANG))


@claim("C26")
def contact_structure(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    scene, at = PARTICLE.with_(gamma=gamma), points(5, seed=seed)

    def drift(name: str, h: float) -> float:
        """Return max ‖Φ_h*η − e^{−γh}η‖/‖e^{−γh}η‖ of one step at random points."""
        pulled = geometry.pullback(one_step(METHODS[name], scene, h), eta)
        scaled = lambda y: pulled(y) / math.exp(-gamma * h) - eta(y)  # noqa: E731
        return largest(lambda y: jnp.linalg.norm(scaled(y)) / jnp.linalg.norm(eta(y)), at)

    drifts = {h: max(drift(name, h) for name in (PRINTED, ABC, STRANG)) for h in (0.5, 0.1, 0.02)}
    yield max(d / h**3 for h, d in drifts.items())
    yield max(drifts.values())


def local_orders(name: str, scene: Scene, starts: np.ndarray) -> list[float]:
    """Return the powers of h in the errors of H0 and s after a step from `starts` (k, 5), against DOP853 at 10⁻¹³."""

    def state(y: Any) -> State:
        return canonical(y.reshape(-1, 5).T)

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
    yield from printed
    yield from map(min, abc, strang)
    yield min(printed)
    for body in (SCENES[name].with_(gamma=gamma) for name in ("central", "rigid_body")):
        yield LAWS["momentum_law"](numerical(body, PRINTED, 0.5, 40, carry=body.optional))


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

    yield difference(0.0)
    yield difference(1e-8), 1e-8 * 5 * h * steps


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
    """Return the γ/ω from which no step size has an eigenvalue outside the unit circle."""
    over = lambda gamma: largest_radius(name, gamma) - 1 - SLACK  # noqa: E731
    return float(scipy.optimize.bisect(over, 0.3, 0.7, xtol=1e-9))


def threshold() -> float:
    """Return the same for the printed order by formula: x² ≤ 2(1 + e^{gx}) for every x = ωh, g = γ/ω.

    Where both sides touch, y = gx has e^y (y − 2) = 2: y = 2 + W(2/e²), g = √(y e^{−y}) = 0.49134.
    """
    y = 2 + float(scipy.special.lambertw(2 / math.e**2).real)
    return math.sqrt(y * math.exp(-y))


@claim("C36")
def conditional_stability(gammas: Sequence[float] = (0.0, 0.1, 1.0), weak: float = 0.1) -> Evidence:
    """gammas : of the undamped method's interval.  weak : for the printed order beyond it, between 0 and 0.4."""
    inside, edge = np.linspace(0.01, 1.999, 2000), border(PRINTED, weak)
    yield {"listed": ", ".join(f"{gamma:g}" for gamma in gammas), "threshold": threshold()}
    for name in (PRINTED, ABC):
        yield max(float(radius(name, gamma, inside).max()) for gamma in gammas)
    yield max(largest_radius(name, weak) for name in (PRINTED, ABC))
    yield max(abs(border(ABC, gamma) - 2) for gamma in gammas)
    yield abs(edge**2 - 2 * (1 + math.exp(weak * edge)))
    yield abs(unconditional_from(PRINTED) - threshold())
    yield math.log(radius(PRINTED, 1.0, 20.0)) / math.log(true_radius(1.0, 1.0, 20.0))


# -- the numerical example: the 2-DOF damped particle ----------------------------------------------
def numerical(scene: Scene, method: str, step: float, count: int, **options: Any) -> Solution:
    """Return a run, without s and in Python unless told otherwise, saved at `count` equal intervals and the start."""
    t = np.linspace(0, scene.t_end, count + 1)
    given = {"carry": (), "engine": "python", "dense": False} | options
    return solve(scene, method, step=step, save_at=t, **given)


@claim("C29")
def closeness(**changes: object) -> Evidence:
    printed, rk4 = (numerical(PARTICLE.with_(**changes), name, PAPER_STEP, 200).y for name in (PRINTED, RK4))
    return [np.abs(printed - rk4).max() / np.abs(rk4).max()]


def rises(name: str, gamma: float, h: float, start: Scene = PARTICLE) -> tuple[int, float]:
    """Return how many steps raise H0, and the largest rise over H0(0); T = 20."""
    run = numerical(start.with_(gamma=gamma), name, h, round(20 / h))
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


#: our start of the particle, and two at rest, at which ‖p‖ comes near 0 again
STARTS = PARTICLE, PARTICLE.with_(q=(0.0, 1.0), p=(0.0, 0.0)), PARTICLE.with_(q=(1.0, 0.0), p=(0.0, 0.0))


@claim("C30")
def monotone_methods(gamma: float = 0.1, weak: float = 1e-3, coarse: float = 0.1) -> Evidence:
    """gamma : with the paper's h.  weak, coarse : damping and step where H0 rises."""
    yield from (rises(name, gamma, PAPER_STEP)[0] for name in (PRINTED, RK4))
    others = [rises(PRINTED, gamma, PAPER_STEP, start) for start in STARTS[1:]]
    yield from (n for n, _ in others)
    yield from (rises(name, weak, coarse)[0] for name in (PRINTED, STRANG, RK4))
    for name, h in itertools.product((PRINTED, STRANG), (0.1, 0.05)):
        yield abs(monotone_from(name, h) / (0.75 * h * h) - 1)
    yield max(rise for _, rise in others)


@claim("C43")
def guaranteed_decay(weak: float = 1e-3, coarse: float = 0.1) -> Evidence:
    """weak, coarse : damping and step, γ below ¾ h²."""
    yield from (rises(PRINTED, weak, coarse, start)[0] for start in STARTS)
    for name, laws in (("particle", ["contact_drift"]), ("central", ["contact_drift", "momentum_law"])):
        run = numerical(SCENES[name], PRINTED, 0.5, 40, carry=("s",))
        yield max(LAWS[law](run) for law in laws)


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
    yield balance_defect(PRINTED, PAPER_STEP, gamma)
    for name in (PRINTED, STRANG):
        yield slope({h: balance_defect(name, h, gamma) for h in ladder})


@claim("C32")
def exponential_energy(**changes: object) -> Evidence:
    scene = PARTICLE.with_(**changes)
    run = numerical(scene, PRINTED, PAPER_STEP, 200, carry=("s",))
    truth = reference(scene, run.t).states()
    energies = scene.hamiltonian_at(truth), scene.hamiltonian_at(run.states()), scene.energy(truth)
    return [geometry.off_decay(energy, run.t, scene.gamma) for energy in energies]


ENERGY_LADDER = (16, 32, 64, 128, 256, 512)  #: steps per unit of time


def energy_errors(name: str, scene: Scene, counts: Sequence[int], E: str = "energy") -> dict[float, float]:
    """Return the paper's measure, max |E − E*| over 20 equal times, against the step; E : which energy."""
    carry, value = ("s",) if E == "hamiltonian" else (), getattr(scene, E)
    truth = value(reference(scene, scene.t_end * np.arange(21) / 20, carry).states())
    errors = {}
    for h in scene.t_end / 20 / np.array(counts):
        run = numerical(scene, name, h, 20, carry=carry)
        errors[h] = float(np.abs(value(run.states()) - truth).max())
    return errors


@claim("C33")
def convergence_orders(**changes: object) -> Evidence:
    scene, orders = PARTICLE.with_(**changes), {}
    # the caption's H is read both ways, as in C32
    for E, name in itertools.product(("energy", "hamiltonian"), NOMINAL):
        orders[f"{name} {E}"] = slope(energy_errors(name, scene, ENERGY_LADDER, E))
    yield orders
    yield from (orders[f"{name} {E}"] for E in ("energy", "hamiltonian") for name in (PRINTED, RK4))
    yield from (abs(order - NOMINAL[name.partition(" ")[0]]) for name, order in orders.items())

    def body(name: str, n: int) -> Solution:
        scene = SCENES["rigid_body"]
        return numerical(scene, name, scene.t_end / n, 5, engine=None)

    yield max(np.abs(np.divide(*energies(body(name, 50))) - 1).max() for name in (PRINTED, ABC))
    for name in (PRINTED, ABC):
        order = slope({1 / n: LAWS["solution_error"](body(name, n)) for n in (20, 40, 80, 160)})
        yield abs(order - NOMINAL[name])


@claim("C34")
def contact_drifts(**changes: object) -> Evidence:
    scene, law = PARTICLE.with_(**changes), LAWS["contact_drift"]
    end = {"save_at": [scene.t_end]}
    yield max(law(solve(scene, name, step=0.1, **end)) for name in (PRINTED, ABC, STRANG))
    yield law(solve(scene, RK4, step=0.1, **end))
    yield law(solve(scene, "diffrax-tsit5", rtol=1e-6, **end))


#: contact integrators that others have published, and when
PUBLISHED = {"herglotz2": 2019, ABC: 2020}


@claim("C51")
def published_integrators(scene: str = "kepler_drag", order: int = 2) -> Evidence:
    """order : of the methods in `PUBLISHED`."""
    kepler, found = SCENES[scene], []
    for name in PUBLISHED:
        errors = {}
        for h in kepler.t_end / np.array([64_000, 128_000, 256_000, 512_000]):
            run = solve(kepler, name, step=h, save_at=[kepler.t_end])
            errors[h] = LAWS["solution_error"](run)
        found.append((abs(slope(errors) - order), LAWS["distribution_drift"](run) / map_round_off(run)))
    misses, drifts = zip(*found, strict=True)
    yield sum(miss <= ORDER_MISS and drift <= 1 for miss, drift in found)
    yield max(misses)
    yield max(drifts)


def map_round_off(run: Solution) -> float:
    return round_off_bound(growth(fixed_steps(run)), run.counts.evaluations or 0)


def fixed_steps(run: Solution) -> Differential:
    """Return dΦ with the steps held fixed; of a library's solver by its own run of the variational equations."""
    if run.run is None or not run.run.steps_follow_state:
        return run.differential
    return variational(run)


def nearest_return(curve: np.ndarray) -> float:
    """Return how near a curve (k, d) comes to its start after it has left, relative to the size of the start."""
    start = curve[0]
    left = int(np.argmax(np.linalg.norm(curve - start, axis=1) > np.linalg.norm(start)))
    a, b = curve[left:-1], curve[left + 1 :]
    along = np.clip(((start - a) * (b - a)).sum(axis=1) / ((b - a) ** 2).sum(axis=1), 0, 1)
    return float(np.linalg.norm(a + along[:, None] * (b - a) - start, axis=1).min() / np.linalg.norm(start))


def undamped_energy(name: str, **changes: object) -> tuple[np.ndarray, np.ndarray]:
    """Return times and H0/H0(0) − 1 of the undamped particle over T = 20000 at h = 0.1."""
    free = PARTICLE.with_(gamma=0.0, t_end=20_000.0, **changes)
    run = solve(free, name, step=0.1, save_at=np.arange(1, 40_001) / 2, carry=())
    return run.t, free.energy(run.states()) / free.energy(free.initial(())) - 1


@claim("C35")
def bounded_energy(**changes: object) -> Evidence:
    off = np.abs(undamped_energy(PRINTED, **changes)[1])
    return off.max(), off[20_000:].max() / off[:20_000].max()


@claim("C52")
def conservative_limit(seed: int = SEED, **changes: object) -> Evidence:
    yield symplectic_defect(PRINTED, PARTICLE.with_(gamma=0.0), 0.1, points(5, seed=seed))
    for name in (PRINTED, RK4):
        t, off = undamped_energy(name, **changes)
        yield abs(np.polyfit(t, off, 1)[0] * t[-1])


@claim("C53")
def closed_orbits(**changes: object) -> Evidence:
    def distance(scene: Mechanical, **changes: object) -> float:
        scene = scene.with_(gamma=0.0, t_end=100.0, **changes)
        return nearest_return(numerical(scene, PRINTED, PAPER_STEP, 10_000).y)

    yield distance(PARTICLE, **changes)
    yield from (distance(SCENES["oscillator"]), distance(PARTICLE, q=(0.0, 0.5), p=(0.0, 0.3)))


# -- beyond the paper: what the contact form implies over long times -------------------------------------
def deviations(degree: int, **changes: object) -> dict[float, float]:
    """Return max |H̃e^{γt}/H̃(y₀) − 1| of contact-strang against the step; H̃ has brackets of up to `degree` parts."""
    scene, composition = PARTICLE.with_(**changes), METHODS[STRANG].composition
    found = {}
    for h in 0.4 / np.arange(2, 7):  # steps that divide the time between two saved states
        run = solve(scene, STRANG, step=h, save_at=0.4 * np.arange(1, 51))
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
    for degree in (1, 3, 5):
        yield abs(slope(deviations(degree, gamma=gamma)) - (degree + 1))
    early, late = halves(STRANG, "modified_hamiltonian", weak, steps)
    plain, plain_late = halves(STRANG, "hamiltonian_law", weak, steps)
    drifting, drifted = halves(RK4, "hamiltonian_law", weak, steps)
    yield from (late / early, plain_late / plain, late / plain_late, drifted / drifting)


def pairing(method: str | Method, **setting: float) -> tuple[float, float]:
    """Return pairing_drift of a run of the chaotic scene, its steps held fixed, and the bound of its round-off."""
    scene = SCENES["duffing"]
    run = solve(scene, method, save_at=scene.t_end * np.arange(1, 6) / 5, dense=False, **setting)
    drift = pulled_deviation(run, pairs(fixed_steps(run), len(scene.q)))
    return float(drift.size.max()), map_round_off(run)  # type: ignore[union-attr]


@claim("X02")
def pairs_kept(rough: float = 1e-4, fine: float = 1e-8) -> Evidence:
    """rough, fine : tolerances of the solvers that choose their steps."""
    steps = (0.4, 0.2, 0.1, 0.05, 0.025)
    kept = [pairing(name, step=h) for name in (STRANG, "contact-rkn4", "contact-rkn6") for h in steps]
    herglotz = {h: pairing("herglotz2", step=h)[0] for h in steps}
    peers = {
        rtol: [pairing(m, rtol=rtol)[0] for m in ("cyrk-dop853", "cyrk-vern8")] for rtol in (rough, fine)
    }
    yield max(drift / bound for drift, bound in kept)
    yield from (abs(slope(herglotz) - 2), pairing(RK4, step=min(steps))[0])
    yield from (min(peers[fine]), min(peers[rough]) / max(peers[fine]))
