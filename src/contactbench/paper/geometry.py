"""Claims about contact geometry, the contact Hamilton equations, momentum maps and reduction (§2, §3 of the paper).

They are judged by exterior calculus at a point by automatic differentiation, independent of every hand-written formula.
A one-form is a function ``eta(y) -> covector`` on coordinates y ∈ R^N, a two-form a matrix with
``(u, v) -> u·A v``.  Canonical coordinates are y = (q, p, s), η = ds − p·dq.  Parameters gamma are > 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.paper.ledger import Evidence, claim
from contactbench.scene import Mechanical, Scene, State
from contactbench.scenes import SCENES
from contactbench.truth import reference
from contactbench.xla import jax_doubles as jax
from contactbench.xla import jnp_doubles as jnp

if TYPE_CHECKING:
    from jax import Array

#: a function of coordinates: a number, a covector, a vector field, a map
type Map = Callable[[Array], Array]
SEED = 20
#: sums of a few dozen products of numbers of size one, differentiated by AD: a few hundred ulp
ROUND_OFF = 1e-12


class Field:
    """A function of coordinates, with operators at each point: a formula of fields reads as it is written."""

    def __init__(self, function: Map):
        self.function = function

    def __call__(self, y: Any) -> Array:
        return self.function(y)

    def __add__(self, other: Map) -> Field:
        return Field(lambda y: self(y) + other(y))

    def __sub__(self, other: Map) -> Field:
        return Field(lambda y: self(y) - other(y))

    def __mul__(self, other: Map) -> Field:
        return Field(lambda y: self(y) * other(y))

    def __matmul__(self, other: Map) -> Field:
        return Field(lambda y: self(y) @ other(y))

    def __getitem__(self, key: int | slice) -> Field:
        return Field(lambda y: self(y)[key])


def points(dimension: int, count: int = 64, seed: int = SEED) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, dimension))


def once(function: Callable[..., Array]) -> Callable[..., Array]:
    """Compile a function that is called once: to optimise it would take longer than all its calls."""
    options = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}
    compiled: Callable[..., Array] = jax.jit(function, compiler_options=options)
    return compiled


def everywhere(function: Map, at: np.ndarray) -> np.ndarray:
    return np.asarray(once(jax.vmap(function))(jnp.asarray(at)))


def largest(function: Map, at: np.ndarray) -> float:
    return float(np.abs(everywhere(function, at)).max())


def canonical(y: Array) -> State:
    n = (len(y) - 1) // 2
    return State(tuple(y[:n]), tuple(y[n : 2 * n]), y[2 * n])


def pack(x: Iterable[object]) -> Array:
    return jnp.concatenate([jnp.ravel(jnp.asarray(part, dtype=float)) for part in x if part is not None])


def gradient(function: Map) -> Field:
    return Field(jax.grad(function))


def jacobian(map_: Map) -> Field:
    return Field(jax.jacfwd(map_))


@Field
def eta(y: Array) -> Array:
    """Return the suite's own contact form on T*Rⁿ × R, as a covector at y."""
    form = SCENES["particle"].contact_form
    return gradient(lambda v: form(canonical(y), canonical(v)))(jnp.zeros(len(y)))


def exterior(form: Map) -> Field:
    """Return dα as a matrix: dα(u, v) = D(α·v)[u] − D(α·u)[v]."""
    derivative = jacobian(form)  # [i, j] = ∂_j α_i
    return Field(lambda y: derivative(y).T - derivative(y))


def pullback(map_: Map, form: Map) -> Field:
    return Field(lambda y: form(map_(y)) @ jacobian(map_)(y))


def lie_derivative(field: Map, form: Map) -> Field:
    return jacobian(form) @ field + Field(form) @ jacobian(field)


def along(field: Map, function: Map) -> Field:
    return Field(lambda y: jnp.asarray(jax.jvp(function, (y,), (field(y),))[1]))


def reeb(form: Map) -> Field:
    """Return the vector with α(R) = 1 and ι_R dα = 0, by least squares on these equations."""

    def field(y: Array) -> Array:
        rows = jnp.vstack([exterior(form)(y).T, form(y)])
        return jnp.linalg.lstsq(rows, jnp.zeros(len(y) + 1).at[-1].set(1.0))[0]

    return Field(field)


def contact_field(form: Map, hamiltonian: Map, y: Array) -> Array:
    """Return X_H solved from its definition ι_X dα = dH − R(H) α, ι_X α = −H  (§2.3, eq. (11))."""
    slope, covector = gradient(hamiltonian)(y), form(y)
    right = jnp.append(slope - (slope @ reeb(form)(y)) * covector, -hamiltonian(y))
    return jnp.linalg.lstsq(jnp.vstack([exterior(form)(y).T, covector]), right)[0]


def contact_equations(hamiltonian: Map) -> Field:
    """Return X_H by the paper's coordinate formula (§2.3, eq. (23))."""

    def field(y: Array) -> Array:
        n = (len(y) - 1) // 2
        slope, p = gradient(hamiltonian)(y), y[n : 2 * n]
        dq, dp, ds = slope[:n], slope[n : 2 * n], slope[2 * n]
        return jnp.concatenate([dp, -dq - p * ds, jnp.array([p @ dp - hamiltonian(y)])])

    return Field(field)


def vector_field(scene: Scene) -> Field:
    return Field(lambda y: pack(scene.rhs(canonical(y))))


def function_of(measure: Callable[[State], Array]) -> Field:
    return Field(lambda y: measure(canonical(y)))


def off_decay(values: np.ndarray, t: np.ndarray, rate: float) -> float:
    """Return max |v(t) e^{λt}/v(0) − 1|, how far values are from a decay at the rate λ."""
    scaled = values * np.exp(rate * t)
    return float(np.abs(scaled / scaled[0] - 1).max())


# -- contact geometry and its equations ------------------------------------------------------------
SOLVER = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14}


def quadratically_damped(gamma: float = 0.1) -> Mechanical:
    scene: Mechanical = SCENES["particle"]
    return scene.with_(name="particle, κ = 0.3", gamma=gamma, kappa=0.3)


def points_by_degree(seed: int) -> list[np.ndarray]:
    return [points(2 * n + 1, seed=seed) for n in (1, 2, 3)]


def random_polynomial(dimension: int, seed: int) -> Field:
    rng = np.random.default_rng(seed)
    a, b, C, D = (jnp.asarray(rng.normal(size=(dimension,) * k)) for k in range(4))
    return Field(lambda y: a + b @ y + y @ C @ y + jnp.einsum("ijk,i,j,k", D, y, y, y))


@claim("C01")
def volume(seed: int = SEED) -> Evidence:
    def density(y: Array) -> Array:
        """Return |η ∧ (dη)ⁿ|/n!: the Pfaffian of dη bordered by η."""
        bordered = jnp.block([[jnp.zeros((1, 1)), eta(y)[None]], [-eta(y)[:, None], exterior(eta)(y)]])
        return jnp.sqrt(jnp.abs(jnp.linalg.det(bordered)))

    return [min(everywhere(density, at).min() for at in points_by_degree(seed))]


@claim("C02")
def reeb_field(seed: int = SEED) -> Evidence:
    def defect(y: Array) -> Array:
        unit = jnp.zeros(len(y)).at[-1].set(1.0)
        return jnp.append(unit @ exterior(eta)(y), eta(y) @ unit - 1)

    def second(y: Array) -> Array:
        """Return the second smallest singular value of dη: not 0, so the kernel is a line."""
        return jnp.linalg.svd(exterior(eta)(y), compute_uv=False)[-2]

    at = points_by_degree(seed)
    return max(largest(defect, some) for some in at), min(everywhere(second, some).min() for some in at)


@claim("C03")
def contact_hamilton_equations(seed: int = SEED) -> Evidence:
    def defect(X: Field, H: Field, at: np.ndarray) -> float:
        dH = gradient(H)
        two = X @ exterior(eta) - (dH - dH @ reeb(eta) * eta)
        return largest(lambda y: jnp.append(two(y), (eta @ X + H)(y)), at)

    def of_scene(scene: Scene) -> float:
        at = points(2 * len(scene.q) + 1, seed=seed)  # type: ignore[attr-defined]
        return defect(vector_field(scene), function_of(scene.hamiltonian_at), at)

    cubic = [(random_polynomial(at.shape[1], seed), at / 2) for at in points_by_degree(seed)]
    yield max(defect(contact_equations(H), H, at) for H, at in cubic)
    yield max(map(of_scene, (SCENES["particle"], quadratically_damped())))
    yield max(map(of_scene, (SCENES["double_pendulum"], SCENES["thermostat"])))


@claim("C04")
def hamiltonian_evolution(seed: int = SEED) -> Evidence:
    H = random_polynomial(5, seed)
    rate, dissipation = along(contact_equations(H), H), gradient(H) @ reeb(eta)
    at = points(5, seed=seed) / 2
    return [largest(rate + law, at) / largest(law, at) for law in (dissipation, dissipation * H)]


def polar(q: Array) -> Array:
    """Return the metric of the plane in polar coordinates q = (r, θ)."""
    return jnp.diag(jnp.array([1.0, q[0] ** 2]))


def radial(q: Array) -> Array:
    """Return the potential of `central` in polar coordinates, q[0] the radius."""
    return jnp.asarray(SCENES["central"].V((q[0], 0.0 * q[0])))


def metric_equations(metric: Map, gamma: float) -> Field:
    """Return X_H of H = ½ g^{ij}(q) p_i p_j + V + γ s, with the potential V of `central`."""
    return contact_equations(
        lambda y: y[2:4] @ jnp.linalg.solve(metric(y[:2]), y[2:4]) / 2 + radial(y[:2]) + gamma * y[4]
    )


def polar_points(seed: int) -> np.ndarray:
    at = points(5, seed=seed)
    at[:, 0] = 0.5 + np.abs(at[:, 0])  # r > 0
    return at


@claim("C05")
def damped_newton(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    root = np.random.default_rng(seed).normal(size=(2, 2))
    constant = jnp.asarray(root @ root.T + np.eye(2))

    def defect(metric: Map, connection: bool) -> float:
        """Return the largest left-hand side of the damped Newton equation along the contact flow of H0 + γ s."""
        velocities = metric_equations(metric, gamma)[:2]

        def newton(y: Array) -> Array:
            q, g, velocity = y[:2], metric(y[:2]), velocities(y)
            acceleration = along(metric_equations(metric, gamma), velocities)(y)
            d = jacobian(metric)(q)  # [i, j, k] = ∂_k g_ij
            christoffel = (d + jnp.einsum("ikj->ijk", d) - jnp.einsum("jki->ijk", d)) / 2
            curved = jnp.einsum("ijk,j,k", christoffel, velocity, velocity) if connection else 0.0
            return g @ acceleration + curved + gamma * g @ velocity + gradient(radial)(q)

        return largest(newton, polar_points(seed))

    return defect(polar, False), defect(lambda q: constant, False), defect(polar, True)


@claim("C44")
def momentum_equation(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    def defect(metric: Map, term: bool) -> float:
        """Return the largest p' + ∂V + Γ' p along the contact flow, with ½ ∂g^{jk} p_j p_k or without it."""
        field = metric_equations(metric, gamma)

        def left(y: Array) -> Array:
            q, p = y[:2], y[2:4]
            kinetic = gradient(lambda q: p @ jnp.linalg.solve(metric(q), p) / 2)
            curved = kinetic(q) if term else 0.0
            return field(y)[2:4] + gradient(radial)(q) + gamma * p + curved

        return largest(left, polar_points(seed))

    return defect(polar, False), defect(lambda q: jnp.eye(2), False), defect(polar, True)


@claim("C06")
def energy_balance(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    def defect(scene: Mechanical) -> float:
        energy, rate = (
            function_of(scene.energy),
            function_of(lambda x: jnp.asarray(scene.dissipation_rate(x.s))),
        )
        power = Field(lambda y: y[2:4]) @ gradient(energy)[2:4]
        return largest(along(vector_field(scene), energy) + rate * power, points(5, seed=seed))

    return defect(SCENES["particle"].with_(gamma=gamma)), defect(quadratically_damped(gamma))


@claim("C07")
def monotone_energy(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    def highest(scene: Mechanical) -> float:
        change = along(vector_field(scene), function_of(scene.energy))
        rate = lambda y: jnp.where(scene.dissipation_rate(y[4]) >= 0, change(y), -jnp.inf)  # noqa: E731
        return float(everywhere(rate, points(5, 2000, seed)).max())

    return [max(highest(SCENES["particle"].with_(gamma=gamma)), highest(quadratically_damped(gamma)))]


@claim("C08")
def oscillator_portrait(
    seed: int = SEED, gamma: float = 0.2, overdamped: float = 2.5, start: tuple[float, float] = (1.0, 0.0)
) -> Evidence:
    """gamma : of the spiral, between 0 and 2.  overdamped : ≥ 2.  start : (q, p)."""
    scene = SCENES["oscillator"].with_(q=start[:1], p=start[1:])
    period = 2 * math.pi / math.sqrt(1 - gamma**2 / 4)

    def orbit(rate: float, times: Sequence[float] | np.ndarray) -> np.ndarray:
        return reference(scene.with_(gamma=rate), times, ()).y

    def half_turns(rate: float) -> int:
        """Return the half turns about the origin in ten periods, by sign changes of q."""
        q = orbit(rate, np.linspace(0, 10 * period, 401))[:, 0]
        return int(np.count_nonzero(np.diff(np.sign(q))))

    def ratios(rate: float) -> np.ndarray:
        sizes = np.linalg.norm(orbit(rate, period * np.arange(1, 11)), axis=1)
        return np.asarray(sizes[1:] / sizes[:-1])

    R_of_H = gradient(function_of(scene.with_(gamma=gamma).hamiltonian))[-1]
    shrinks = math.exp(-gamma * period / 2) * (1 + 1e-12)
    yield {"growing": -gamma}
    yield np.abs(orbit(0.0, [2 * math.pi])[0] - np.array(start)).max() / np.linalg.norm(start)
    yield np.max(ratios(gamma)), shrinks
    yield half_turns(gamma)
    yield largest(lambda y: R_of_H(y) - gamma, points(3, seed=seed))
    yield half_turns(overdamped)
    yield np.min(ratios(-gamma))


@claim("C37")
def vertical_component(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    scene, at = SCENES["particle"].with_(gamma=gamma), points(5, seed=seed)

    def parts(H: Field, X: Field) -> tuple[Field, Field, Field]:
        """Return η(X_H), its derivative along the Reeb field, and R(H)."""
        vertical = eta @ X
        return vertical, gradient(vertical) @ reeb(eta), gradient(H) @ reeb(eta)

    H, cubic = function_of(scene.hamiltonian), random_polynomial(5, seed)
    vertical, slope, rate = parts(H, vector_field(scene))
    yield largest(slope + rate, at)
    yield largest(vertical + H, at)
    _, cubic_slope, cubic_rate = parts(cubic, contact_equations(cubic))
    yield largest(cubic_slope + cubic_rate, at / 2)
    yield largest(vertical - rate, at)


@claim("C54")
def decomposition(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    at, powers = points(5, seed=seed), []
    for scene in (SCENES["particle"].with_(gamma=gamma), quadratically_damped(gamma)):
        X, energy = vector_field(scene), function_of(scene.energy)
        vertical = (eta @ X) * reeb(eta)
        friction = function_of(lambda x, s=scene: jnp.asarray(s.dissipation_rate(x.s)))  # type: ignore[misc]
        work = friction * (Field(lambda y: y[2:4]) @ gradient(energy)[2:4])
        along_both = along(X - vertical, energy), along(vertical, energy)
        powers.append([largest(part, at) for part in (*along_both, along_both[0] + work)])
    tangential, upright, balance = np.max(powers, axis=0)
    yield from (tangential, upright, upright, balance)


@claim("C55")
def without_action(seed: int = SEED, **changes: object) -> Evidence:
    """changes : of the particle, undamped."""
    free = SCENES["particle"].with_(gamma=0.0, **changes)

    def defect(H: Field, X: Field, at: np.ndarray) -> np.ndarray:
        """Return max |(q', p') − (H_p, −H_q)| and max |s' − (p·H_p − H)|."""
        n = at.shape[1] // 2
        velocity, force, p = gradient(H)[n : 2 * n], gradient(H)[:n], Field(lambda y: y[n : 2 * n])
        motion = largest(lambda y: jnp.append((X[:n] - velocity)(y), (X[n : 2 * n] + force)(y)), at)
        return np.array([motion, largest(X[2 * n] - (p @ velocity - H), at)])

    found = []
    for at in points_by_degree(seed):
        cubic = random_polynomial(at.shape[1] - 1, seed)
        H = Field(lambda y, H=cubic: H(y[:-1]))  # type: ignore[misc]
        found.append(defect(H, Field(lambda y, H=H: contact_field(eta, H, y)), at / 2))  # type: ignore[misc]
    yield from np.max(found, axis=0)
    yield defect(function_of(free.hamiltonian_at), vector_field(free), points(5, seed=seed))[0]


@claim("C38")
def memory(gamma: float = 0.1, start: tuple[float, float] = (1.0, 0.0)) -> Evidence:
    """gamma : < 2.  start : (q, p)."""
    end = 10 / gamma
    scene = SCENES["oscillator"].with_(gamma=gamma, q=start[:1], p=start[1:], t_end=end)
    nodes, weights = np.polynomial.legendre.leggauss(600)
    t, weights = end * (nodes + 1) / 2, end * weights / 2
    x = reference(scene, np.append(t, end)).states()
    q, p, s = x.q[0][:-1], x.p[0][:-1], x.s[-1]
    lagrangian = (p**2 - q**2) / 2
    solved, apart = (size * (start[0] ** 2 + start[1] ** 2) for size in (1e-12, 1e-3))
    yield {"end": end}
    yield abs(s - weights @ (lagrangian - gamma * x.s[:-1])), solved
    yield abs(s - weights @ (np.exp(-gamma * (end - t)) * lagrangian)), solved
    yield abs(s - weights @ lagrangian), apart
    yield abs(s - weights @ (gamma * p**2)), apart


@claim("C42")
def oscillator_energy(gamma: float = 0.1) -> Evidence:
    """gamma : < 2."""
    scene = SCENES["oscillator"].with_(gamma=gamma)
    half = math.pi / math.sqrt(1 - gamma**2 / 4)
    t = half * np.arange(0, 10, 1 / 64)
    value = scene.energy(reference(scene, t, ()).states()) * np.exp(gamma * t)
    return np.abs(value / value[0] - 1).max(), np.abs(value[64:] - value[:-64]).max() / value[0]


# -- momentum maps and reduction -----------------------------------------------------------------------
AXIS = np.array([0.48, 0.6, 0.64])  #: a unit vector


def rotate(y: Array, angle: Array | float) -> Array:
    """Return the cotangent lift of a rotation about `AXIS`, on T*R³ × R."""
    hat = jnp.array([[0, -AXIS[2], AXIS[1]], [AXIS[2], 0, -AXIS[0]], [-AXIS[1], AXIS[0], 0.0]])
    matrix = jnp.eye(3) + jnp.sin(angle) * hat + (1 - jnp.cos(angle)) * hat @ hat  # Rodrigues
    return jnp.concatenate([matrix @ y[:3], matrix @ y[3:6], y[6:]])


generator = Field(lambda y: jax.jvp(lambda angle: rotate(y, angle), (0.0,), (1.0,))[1])
#: J_ξ of these rotations
axial = Field(lambda y: jnp.dot(AXIS, jnp.cross(y[:3], y[3:6])))


def rotation_invariant(gamma: float) -> Field:
    return Field(lambda y: y[3:6] @ y[3:6] / 2 + (y[:3] @ y[:3]) ** 2 / 4 + gamma * y[6])


@claim("C09")
def cotangent_lifts(seed: int = SEED) -> Evidence:
    def bend(q: Array) -> Array:
        """Return a diffeomorphism of R² that is no rotation."""
        return jnp.array([q[0] + jnp.tanh(q[1]), q[1] + jnp.sin(q[0] + jnp.tanh(q[1])) / 2])

    def lifted(y: Array) -> Array:
        q, p = y[:2], y[2:4]
        return jnp.concatenate([bend(q), jnp.linalg.solve(jacobian(bend)(q).T, p), y[4:]])

    yield largest(pullback(lambda y: rotate(y, 0.7), eta) - eta, points(7, seed=seed))
    yield largest(pullback(lifted, eta) - eta, points(5, seed=seed))


@claim("C10")
def infinitesimal_strictness(seed: int = SEED) -> Evidence:
    lie, slope = lie_derivative(generator, eta), gradient(axial)
    defects = lie + slope, lie, axial + eta @ generator, slope - generator @ exterior(eta)
    return [largest(defect, points(7, seed=seed)) for defect in defects]


@claim("C39")
def commuting_derivatives(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    invariant, at = rotation_invariant(gamma), points(7, seed=seed)
    form = Field(lambda y: jnp.sin(y[::-1]) + y * y[0])  # neither flow leaves it alone
    X = contact_equations(invariant)
    left = lie_derivative(X, lie_derivative(generator, form))
    right = lie_derivative(generator, lie_derivative(X, form))
    size = largest(left, at)
    # without invariance d L_ξ L_X η = L_ξ L_X dη, and eq. (51) says that this is −L_X L_ξ dη = 0
    other = contact_equations(lambda y: invariant(y) + y[0] * y[6])
    yield largest(left + right, at) / size
    yield largest(exterior(lie_derivative(generator, lie_derivative(other, eta))), at)
    yield largest(left - right, at) / size


@claim("C45")
def lie_derivative_of_the_form(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    scene = quadratically_damped(gamma)
    dH, X = gradient(function_of(scene.hamiltonian)), vector_field(scene)
    scaled, of_form = dH[-1] * eta, lie_derivative(X, eta)
    right = dH - scaled
    defect = partial(largest, at=points(5, seed=seed))
    yield from map(defect, (X @ exterior(of_form) - right, of_form - right))
    yield from map(
        defect, (exterior(of_form) + exterior(scaled), of_form + scaled, X @ exterior(eta) - right)
    )


def momentum_laws(gamma: float) -> tuple[Field, Field, Field, Field]:
    """Return X of a rotation-invariant H, J' along it, the right of eq. (53) on X, on which dJ is J', and R(H) J."""
    H = rotation_invariant(gamma)
    X, rate = contact_equations(H), gradient(H)[-1]
    printed = along(generator, rate) * (eta @ X) - along(generator, H)
    return X, along(X, axial), printed, rate * axial


@claim("C46")
def momentum_step(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    _, change, printed, decay = momentum_laws(gamma)
    at = points(7, seed=seed)
    yield largest(change - printed, at) / largest(change, at)
    yield largest(printed, at)
    yield largest(change + decay, at)


@claim("C47")
def momentum_deduction(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    X, change, printed, decay = momentum_laws(gamma)
    at = points(7, seed=seed)
    inserted = lie_derivative(X, eta) @ generator
    yield largest(printed + decay, at) / largest(decay, at)
    yield largest(jacobian(generator) @ X - jacobian(X) @ generator, at)  # [X, ξ]
    yield largest(change + inserted, at)
    yield largest(inserted - decay, at)


@claim("C49")
def conformal_action(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    ξ = Field(lambda y: jnp.append(y[:-1] / 2, y[-1]))  # of (q, p, s) → (e^{a/2} q, e^{a/2} p, e^a s), σ = a
    X = contact_equations(lambda y: y[:4] @ y[:4] / 2 + gamma * y[4])
    lifted = Field(lambda y: y[2:4] @ ξ(y)[:2])
    corrected, rate = lifted - Field(lambda y: y[4]), Field(lambda y: jnp.asarray(gamma))
    defect = partial(largest, at=points(5, seed=seed))
    yield defect(lie_derivative(ξ, eta) - eta)
    yield defect(corrected + eta @ ξ)
    for J in (corrected, lifted):
        yield defect(along(X, J) + rate * J)


def momenta(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return times, (26,), and J along the truth, (26, m)."""
    t = np.linspace(0, scene.t_end, 26)  # of the frozen references
    return t, np.array(scene.momentum_at(reference(scene, t).states())).T


def radius_and_speed(x: State) -> tuple[np.ndarray, np.ndarray]:
    q, p = np.asarray(x.q), np.asarray(x.p)
    radius = np.hypot(*q)
    return radius, (q * p).sum(axis=0) / radius


@claim("C11")
def momentum_decay(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    coefficients = np.random.default_rng(seed).normal(size=(4, 4))

    def invariant(y: Array) -> Array:
        """Return a contact Hamiltonian that rotations leave alone, not of the form H0(q, p) + Γ(s)."""
        q, p, s = y[:2], y[2:4], y[4]
        u = jnp.array([q @ q, p @ p, q @ p, s])
        return u @ coefficients @ u / 4

    for name in ("central", "rigid_body", "polar"):
        scene = SCENES[name].with_(gamma=gamma)
        t, J = momenta(scene)
        scaled = J * np.exp(scene.conformal_rate * t)[:, None]
        yield np.linalg.norm(scaled - J[0], axis=1).max() / np.linalg.norm(J[0])
    momentum = function_of(lambda x: jnp.asarray(SCENES["central"].momentum_at(x)[0]))
    defect = along(contact_equations(invariant), momentum) + gradient(invariant)[-1] * momentum
    yield largest(defect, points(5, seed=seed) / 2)


@claim("C12")
def level_sets(gamma: float = 0.1) -> Evidence:
    damped = SCENES["central"].with_(gamma=gamma)
    for scene in (damped, damped.with_(gamma=0.0), damped.with_(q=(1.0, 0.0), p=(0.3, 0.0))):
        J = momenta(scene)[1][:, 0]
        yield np.abs(J - J[0]).max() / (abs(J[0]) or 1.0)


def reduction_miss(scene: Mechanical) -> float:
    """Return how far (r, p_r), reduced along the decaying level μ(t), is from the full motion of `central`."""
    t = np.linspace(0, scene.t_end, 26)  # of the frozen references
    radius, speed = radius_and_speed(reference(scene, t, ()).states())
    mu = (scene.momentum_at(scene.initial(())) or ())[0]

    def reduced(t: float, y: np.ndarray) -> list[float]:
        """Return H_μ = ½ (p_r² + μ(t)²/r²) + V(r), with γ s: the contact equations of (r, p_r) alone."""
        (r, p_r), level = y, mu * np.exp(-scene.gamma * t)
        return [p_r, level**2 / r**3 - scene.dV((r, 0.0))[0] - scene.gamma * p_r]

    run = scipy.integrate.solve_ivp(reduced, (0, scene.t_end), [radius[0], speed[0]], t_eval=t, **SOLVER)
    return float(np.hypot(run.y[0] - radius, run.y[1] - speed).max() / np.hypot(radius, speed).max())


@claim("C13")
def time_dependent_reduction(gamma: float = 0.1) -> Evidence:
    return [reduction_miss(SCENES["central"].with_(gamma=gamma))]


@claim("C58")
def published_examples(gamma: float = 0.1) -> Evidence:
    thrown = Mechanical(
        name="projectile", potential=lambda q: q[1], gamma=gamma, q=(0.0, 0.0), p=(1.0, 1.0), t_end=10.0
    )
    t = np.linspace(0, thrown.t_end, 21)
    p = np.asarray(reference(thrown, t, ()).states().p[0])
    kepler = SCENES["kepler_drag"]
    misses = [off_decay(p, t, gamma), off_decay(momenta(kepler)[1][:, 0], momenta(kepler)[0], kepler.gamma)]
    yield sum(miss <= ROUND_OFF for miss in misses)
    yield from misses


@claim("C60")
def published_connections(gamma: float = 0.1) -> Evidence:
    scene = SCENES["central"].with_(gamma=gamma)
    t, J = momenta(scene)
    H = np.asarray(scene.hamiltonian_at(reference(scene, t).states()))
    misses = off_decay(J[:, 0] / H, t, 0.0), reduction_miss(scene)
    yield sum(miss <= 1e-10 for miss in misses)
    yield from misses


@claim("C14")
def symplectification(gamma: float = 0.1) -> Evidence:
    """Project the homogeneous Hamiltonian flow on M × R₊, on which J r is conserved, onto the contact flow."""
    scene = SCENES["central"].with_(gamma=gamma)
    t = np.linspace(0, scene.t_end, 21)

    def lifted(contact: Map) -> Map:
        """Return K(x, P, s, r) = −r H(x, −P/r, s), of degree one in the momenta P = −r p of x and r of s."""

        def K(z: Array) -> Array:
            n, r = len(z) // 2 - 1, z[-1]
            return -r * contact(jnp.concatenate([z[:n], -z[n:-2] / r, z[-2:-1]]))

        return K

    def flow(K: Map, z0: np.ndarray) -> np.ndarray:
        """Return the motion by Hamilton's equations of K for the pairs (x, P) and (s, r)."""
        n = len(z0) // 2 - 1

        @jax.jit
        def rhs(z: Array) -> Array:
            slope = gradient(K)(z)
            return jnp.concatenate([slope[n:-2], -slope[:n], slope[-1:], -slope[-2:-1]])

        run = scipy.integrate.solve_ivp(lambda _, z: np.asarray(rhs(z)), (0, t[-1]), z0, t_eval=t, **SOLVER)
        return np.asarray(run.y)

    q, p, truth = np.array(scene.q), np.array(scene.p), reference(scene, t)
    run = flow(lifted(function_of(scene.hamiltonian_at)), np.array([*q, *-p, scene.s, 1.0]))
    level = run[0] * run[3] - run[1] * run[2]
    projected = np.vstack([run[:2], -run[2:4] / run[5], run[4]]).T

    def reduced(z: Array) -> Array:
        """Return K on (ρ, P_ρ, s, r) at the level P_θ = −r J."""
        ρ, P, s, r = z
        kinetic = ((-P / r) ** 2 + (-level[0] / r / ρ) ** 2) / 2
        return jnp.asarray(-r * (kinetic + radial(z) + gamma * s))

    ρ0 = np.linalg.norm(q)
    down = flow(reduced, np.array([ρ0, -(q @ p) / ρ0, scene.s, 1.0]))
    ρ, speed = radius_and_speed(truth.states())
    yield np.linalg.norm(projected - truth.y, axis=1).max() / np.linalg.norm(truth.y, axis=1).max()
    yield np.abs(level / level[0] - 1).max()
    yield np.abs(np.array([down[0] - ρ, -down[1] / down[3] - speed, down[2] - truth.states().s])).max()
