"""Claims about contact geometry, the contact Hamilton equations, momentum maps and reduction (§2, §3 of the paper).

They are judged by exterior calculus at a point by automatic differentiation, independent of every hand-written formula.
A one-form is a function ``eta(y) -> covector`` on coordinates y ∈ R^N, a two-form a matrix with
``(u, v) -> u·A v``.  Canonical coordinates are y = (q, p, s), η = ds − p·dq.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.claims.ledger import CORRECTED, Evidence, at_least, at_most, claim
from contactbench.scene import Mechanical, Scene, State
from contactbench.scenes import SCENES
from contactbench.truth import reference
from contactbench.xla import jax, jnp

if TYPE_CHECKING:
    from jax import Array

#: a function of coordinates: a number, a covector, a vector field, a map
type Field = Callable[[Array], Array]
SEED = 20
#: sums of a few dozen products of numbers of size one, differentiated by AD: a few hundred ulp
ROUND_OFF = 1e-12
#: bound and reason of what holds identically
IDENTITY = ROUND_OFF, "round-off of automatic differentiation on numbers of size one"


def points(dimension: int, count: int = 64, seed: int = SEED) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, dimension))


def everywhere(function: Field, at: np.ndarray) -> np.ndarray:
    return np.asarray(jax.jit(jax.vmap(function))(jnp.asarray(at)))


def largest(function: Field, at: np.ndarray) -> float:
    return float(np.abs(everywhere(function, at)).max())


def canonical(y: Array) -> State:
    n = (len(y) - 1) // 2
    return State(tuple(y[:n]), tuple(y[n : 2 * n]), y[2 * n])


def pack(x: Iterable[object]) -> Array:
    return jnp.concatenate([jnp.ravel(jnp.asarray(part, dtype=float)) for part in x if part is not None])


def eta(y: Array) -> Array:
    """Return the suite's own contact form on T*Rⁿ × R, as a covector at y."""
    form = SCENES["particle"].contact_form
    return gradient(lambda v: form(canonical(y), canonical(v)))(jnp.zeros(len(y)))


def gradient(function: Field) -> Field:
    return jax.grad(function)


def jacobian(map_: Field) -> Field:
    return jax.jacfwd(map_)


def exterior(form: Field, y: Array) -> Array:
    """Return dα as a matrix: dα(u, v) = D(α·v)[u] − D(α·u)[v]."""
    derivative = jacobian(form)(y)  # [i, j] = ∂_j α_i
    return derivative.T - derivative


def pullback(map_: Field, form: Field, y: Array) -> Array:
    return form(map_(y)) @ jacobian(map_)(y)


def lie_derivative(field: Field, form: Field, y: Array) -> Array:
    return jacobian(form)(y) @ field(y) + form(y) @ jacobian(field)(y)


def along(field: Field, function: Field, y: Array) -> Array:
    return jnp.asarray(jax.jvp(function, (y,), (field(y),))[1])


def reeb(form: Field, y: Array) -> Array:
    """Return the vector with α(R) = 1 and ι_R dα = 0, by least squares on these equations."""
    rows = jnp.vstack([exterior(form, y).T, form(y)])
    return jnp.linalg.lstsq(rows, jnp.zeros(len(y) + 1).at[-1].set(1.0))[0]


def contact_field(form: Field, hamiltonian: Field, y: Array) -> Array:
    """Return X_H solved from its definition ι_X dα = dH − R(H) α, ι_X α = −H  (§2.3, eq. (11))."""
    slope, covector = gradient(hamiltonian)(y), form(y)
    right = jnp.append(slope - (slope @ reeb(form, y)) * covector, -hamiltonian(y))
    return jnp.linalg.lstsq(jnp.vstack([exterior(form, y).T, covector]), right)[0]


def contact_equations(hamiltonian: Field) -> Field:
    """Return X_H by the paper's coordinate formula (§2.3, eq. (23))."""

    def field(y: Array) -> Array:
        n = (len(y) - 1) // 2
        slope, p = gradient(hamiltonian)(y), y[n : 2 * n]
        dq, dp, ds = slope[:n], slope[n : 2 * n], slope[2 * n]
        return jnp.concatenate([dp, -dq - p * ds, jnp.array([p @ dp - hamiltonian(y)])])

    return field


def vector_field(scene: Scene) -> Field:
    return lambda y: pack(scene.rhs(canonical(y)))


def function_of(measure: Callable[[State], Array]) -> Field:
    return lambda y: measure(canonical(y))


# -- contact geometry and its equations ------------------------------------------------------------
SOLVER = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14}
SOLVED = 1e-10, "10³ times the tolerance 10⁻¹³ of the solver it is integrated with"
TRUE = 1e-13, "the reference rounded to double precision, times e^{γT} = 7.4"
DERIVED = 100 * ROUND_OFF, "round-off of AD on numbers of size up to 100"
CUBIC = 100 * ROUND_OFF, "round-off of cubic polynomials with 400 terms of size up to 10"


def quadratically_damped(gamma: float = 0.1) -> Mechanical:
    scene: Mechanical = SCENES["particle"]
    return scene.with_(name="particle, κ = 0.3", gamma=gamma, kappa=0.3)


def points_by_degree(seed: int) -> list[np.ndarray]:
    return [points(2 * n + 1, seed=seed) for n in (1, 2, 3)]


def random_polynomial(dimension: int, seed: int) -> Field:
    rng = np.random.default_rng(seed)
    constant, linear, quadratic, cubic = (jnp.asarray(rng.normal(size=(dimension,) * k)) for k in range(4))
    return lambda y: constant + linear @ y + y @ quadratic @ y + jnp.einsum("ijk,i,j,k", cubic, y, y, y)


@claim("C01")
def volume(seed: int = SEED) -> Evidence:
    def density(y: Array) -> Array:
        """Return |η ∧ (dη)ⁿ|/n!: the Pfaffian of dη bordered by η."""
        bordered = jnp.block([[jnp.zeros((1, 1)), eta(y)[None]], [-eta(y)[:, None], exterior(eta, y)]])
        return jnp.sqrt(jnp.abs(jnp.linalg.det(bordered)))

    smallest = min(everywhere(density, at).min() for at in points_by_degree(seed))
    one = 1 - 1e-9, "in canonical coordinates the density is 1; 10⁻⁹ for the determinant of a large p"
    yield at_least("min |η ∧ (dη)ⁿ|/n! at random points", smallest, *one)


@claim("C02")
def reeb_field(seed: int = SEED) -> Evidence:
    def defect(y: Array) -> Array:
        unit = jnp.zeros(len(y)).at[-1].set(1.0)
        return jnp.append(unit @ exterior(eta, y), eta(y) @ unit - 1)

    def second(y: Array) -> Array:
        """Return the second smallest singular value of dη: not 0, so the kernel is a line."""
        return jnp.linalg.svd(exterior(eta, y), compute_uv=False)[-2]

    at = points_by_degree(seed)
    off = max(largest(defect, some) for some in at)
    ones = 1 - 1e-9, "canonical coordinates: all but one are 1"
    smallest = min(everywhere(second, some).min() for some in at)
    yield at_most("max |ι_R dη|, |η(R) − 1| for R = ∂_s", off, *IDENTITY)
    yield at_least("second smallest singular value of dη", smallest, *ones)


@claim("C03")
def contact_hamilton_equations(seed: int = SEED) -> Evidence:
    def defect(field: Field, hamiltonian: Field) -> Field:
        def at(y: Array) -> Array:
            slope, X = gradient(hamiltonian)(y), field(y)
            two = X @ exterior(eta, y) - (slope - slope @ reeb(eta, y) * eta(y))
            return jnp.append(two, eta(y) @ X + hamiltonian(y))

        return at

    def of_polynomial(at: np.ndarray) -> float:
        H = random_polynomial(at.shape[1], seed)
        return largest(defect(contact_equations(H), H), at / 2)

    def of_scene(scene: Scene) -> float:
        at = points(2 * len(scene.q) + 1, seed=seed)  # type: ignore[attr-defined]
        return largest(defect(vector_field(scene), function_of(scene.hamiltonian_at)), at)

    random = max(map(of_polynomial, points_by_degree(seed)))
    ours = max(map(of_scene, (SCENES["particle"], quadratically_damped())))
    yield at_most("max defect of the two defining relations, random H", random, *CUBIC)
    yield at_most("the same for the right-hand side every method here integrates", ours, *IDENTITY)
    general = max(map(of_scene, (SCENES["double_pendulum"], SCENES["thermostat"])))
    yield at_most("the same where it is derived from any H(q, p, s)", general, *DERIVED)


@claim("C04")
def hamiltonian_evolution(seed: int = SEED) -> Evidence:
    H = random_polynomial(5, seed)
    rate = lambda y: along(contact_equations(H), H, y)  # noqa: E731
    dissipation = lambda y: gradient(H)(y) @ reeb(eta, y)  # noqa: E731
    at = points(5, seed=seed) / 2

    def relative(law: Field) -> float:
        return largest(lambda y: rate(y) + law(y), at) / largest(law, at)

    yield at_most("max |H' + R(H)| / max |R(H)|", relative(dissipation), *CUBIC)
    yield CORRECTED
    yield at_most("max |H' + R(H) H| / max |R(H) H|", relative(lambda y: dissipation(y) * H(y)), *CUBIC)


def polar(q: Array) -> Array:
    """Return the metric of the plane in polar coordinates q = (r, θ)."""
    return jnp.diag(jnp.array([1.0, q[0] ** 2]))


def radial(q: Array) -> Array:
    """Return the potential of `central` in polar coordinates."""
    return jnp.asarray(SCENES["central"].V((q[0], 0.0 * q[0])))


def with_metric(metric: Field, gamma: float) -> Field:
    """Return H = ½ g^{ij}(q) p_i p_j + V + γ s, V that of `central`."""
    return lambda y: y[2:4] @ jnp.linalg.solve(metric(y[:2]), y[2:4]) / 2 + radial(y[:2]) + gamma * y[4]


def polar_points(seed: int) -> np.ndarray:
    at = points(5, seed=seed)
    at[:, 0] = 0.5 + np.abs(at[:, 0])  # r > 0
    return at


@claim("C05")
def damped_newton(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    root = np.random.default_rng(seed).normal(size=(2, 2))
    constant = jnp.asarray(root @ root.T + np.eye(2))

    def defect(metric: Field, connection: bool) -> float:
        """Return the largest left-hand side of the damped Newton equation along the contact flow of H0 + γ s."""
        field = contact_equations(with_metric(metric, gamma))

        def newton(y: Array) -> Array:
            q, g = y[:2], metric(y[:2])
            velocity = field(y)[:2]
            acceleration = along(field, lambda z: field(z)[:2], y)
            d = jacobian(metric)(q)  # [i, j, k] = ∂_k g_ij
            christoffel = (d + jnp.einsum("ikj->ijk", d) - jnp.einsum("jki->ijk", d)) / 2
            curved = jnp.einsum("ijk,j,k", christoffel, velocity, velocity) if connection else 0.0
            return g @ acceleration + curved + gamma * g @ velocity + gradient(radial)(q)

        return largest(newton, polar_points(seed))

    bound = 100 * ROUND_OFF, "round-off of AD on accelerations of size up to 100"
    yield at_most("max |g q̈ + Γ' g q̇ + ∇V|, polar coordinates", defect(polar, False), *bound)
    yield at_most("the same, constant metric", defect(lambda q: constant, False), *bound)
    yield CORRECTED
    yield at_most("the same with the Christoffel term, polar coordinates", defect(polar, True), *bound)


@claim("C44")
def momentum_equation(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    def defect(metric: Field, term: bool) -> float:
        """Return the largest p' + ∂V + Γ' p along the contact flow, with ½ ∂g^{jk} p_j p_k or without it."""
        field = contact_equations(with_metric(metric, gamma))

        def left(y: Array) -> Array:
            q, p = y[:2], y[2:4]
            kinetic = lambda q: p @ jnp.linalg.solve(metric(q), p) / 2  # noqa: E731
            curved = gradient(kinetic)(q) if term else 0.0
            return field(y)[2:4] + gradient(radial)(q) + gamma * p + curved

        return largest(left, polar_points(seed))

    flat = lambda q: jnp.eye(2)  # noqa: E731
    bound = 100 * ROUND_OFF, "round-off of AD on forces of size up to 100"
    yield at_most("max |p' + ∂V + Γ' p|, polar coordinates", defect(polar, False), *bound)
    yield at_most("the same, Euclidean metric", defect(flat, False), *bound)
    yield CORRECTED
    yield at_most("max |p' + ½ ∂g^{jk} p_j p_k + ∂V + Γ' p|, polar coordinates", defect(polar, True), *bound)


@claim("C06")
def energy_balance(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    def defect(scene: Mechanical) -> float:
        energy, field = function_of(scene.energy), vector_field(scene)

        def at(y: Array) -> Array:
            power = y[2:4] @ gradient(energy)(y)[2:4]
            return along(field, energy, y) + jnp.asarray(scene.dissipation_rate(y[4])) * power

        return largest(at, points(5, seed=seed))

    linear, quadratic = SCENES["particle"].with_(gamma=gamma), quadratically_damped(gamma)
    yield at_most("max |H0' + Γ' p·∂H0/∂p|, Γ = γ s", defect(linear), *IDENTITY)
    yield at_most("max |H0' + Γ' p·∂H0/∂p|, Γ = γ s + ½ κ s²", defect(quadratic), *IDENTITY)


@claim("C07")
def monotone_energy(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    def rate(scene: Mechanical) -> Field:
        change = lambda y: along(vector_field(scene), function_of(scene.energy), y)  # noqa: E731
        return lambda y: jnp.where(scene.dissipation_rate(y[4]) >= 0, change(y), -jnp.inf)

    scenes = SCENES["particle"].with_(gamma=gamma), quadratically_damped(gamma)
    highest = max(everywhere(rate(scene), points(5, 2000, seed)).max() for scene in scenes)
    yield at_most("largest H0' at 2000 random states with Γ' ≥ 0", highest, *IDENTITY)


@claim("C08")
def oscillator_portrait(
    seed: int = SEED, gamma: float = 0.2, overdamped: float = 2.5, start: tuple[float, float] = (1.0, 0.0)
) -> Evidence:
    """gamma : of the spiral, between 0 and 2.  overdamped : ≥ 2.  start : (q, p)."""
    given = SCENES["oscillator"].with_(q=start[:1], p=start[1:])
    free, damped, slow, driven = (given.with_(gamma=rate) for rate in (0.0, gamma, overdamped, -gamma))
    period = 2 * math.pi / math.sqrt(1 - gamma**2 / 4)

    orbit = lambda scene, times: reference(scene, times, ()).y  # noqa: E731

    def half_turns(scene: Mechanical) -> int:
        """Return the half turns about the origin in ten periods, by sign changes of q."""
        q = orbit(scene, np.linspace(0, 10 * period, 401))[:, 0]
        return int(np.count_nonzero(np.diff(np.sign(q))))

    def ratios(scene: Mechanical) -> np.ndarray:
        sizes = np.linalg.norm(orbit(scene, period * np.arange(1, 11)), axis=1)
        return np.asarray(sizes[1:] / sizes[:-1])

    gap = np.abs(orbit(free, [2 * math.pi])[0] - np.array(start)).max() / np.linalg.norm(start)
    R_of_H = gradient(function_of(damped.hamiltonian))
    reeb_rate = largest(lambda y: R_of_H(y)[-1] - gamma, points(3, seed=seed))
    rounding = 1e-14, "round-off of 2π times a velocity of one, and of y"
    shrinks = math.exp(-gamma * period / 2) * (1 + 1e-12)
    spiral = shrinks, "e^{−λT/2}, T the period of the spiral, up to round-off"
    creeping, grows = (1, "two real eigenvalues: q changes its sign once at most"), (1.0, "it grows")
    yield at_most("‖y(2π) − y(0)‖/‖y(0)‖ at λ = 0", gap, *rounding)
    yield at_most(f"largest ratio of ‖y‖ over a turn at λ = {gamma:g}", np.max(ratios(damped)), *spiral)
    yield at_least(f"half turns in ten periods at λ = {gamma:g}", half_turns(damped), 20, "two a period")
    yield at_most("max |R(H) − λ|", reeb_rate, *IDENTITY)
    yield CORRECTED
    yield at_most(f"half turns in the same time at λ = {overdamped:g}", half_turns(slow), *creeping)
    yield at_least(f"smallest ratio of ‖y‖ over a turn at λ = {-gamma:g}", np.min(ratios(driven)), *grows)


@claim("C37")
def vertical_component(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    scene = SCENES["particle"].with_(gamma=gamma)
    H, field = function_of(scene.hamiltonian), vector_field(scene)
    vertical = lambda y: eta(y) @ field(y)  # noqa: E731
    at = points(5, seed=seed)
    rate = lambda y: gradient(H)(y) @ reeb(eta, y)  # noqa: E731
    encoded = largest(lambda y: gradient(vertical)(y) @ reeb(eta, y) + rate(y), at)
    equal = largest(lambda y: vertical(y) - rate(y), at)
    yield at_most("max |R(η(X_H)) + R(H)|: its derivative along R gives R(H)", encoded, *IDENTITY)
    yield CORRECTED
    yield at_most("max |η(X_H) + H|", largest(lambda y: vertical(y) + H(y), at), *IDENTITY)
    yield at_least("read as “is”: max |η(X_H) − R(H)|", equal, 1e-2, "far above round-off: it is not")


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
    action = weights @ (lagrangian - gamma * x.s[:-1])
    weighed = weights @ (np.exp(-gamma * (end - t)) * lagrangian)
    size = start[0] ** 2 + start[1] ** 2
    solved, apart = (1e-12 * size, "round-off of the quadrature"), (1e-3 * size, "far above it")
    yield at_most(f"|s − ∫L|, L = T − V − γs as in eq. (78), at t = {end:g}", abs(s - action), *solved)
    yield CORRECTED
    yield at_most("|s − ∫e^{−γ(t−τ)} (T − V)|", abs(s - weighed), *solved)
    yield at_least("read for Hamilton's action: |s − ∫(T − V)|", abs(s - weights @ lagrangian), *apart)
    yield at_least("read for the energy dissipated: |s − ∫γp²|", abs(s - weights @ (gamma * p**2)), *apart)


@claim("C42")
def oscillator_energy(gamma: float = 0.1) -> Evidence:
    """gamma : < 2."""
    scene = SCENES["oscillator"].with_(gamma=gamma)
    half = math.pi / math.sqrt(1 - gamma**2 / 4)
    t = half * np.arange(0, 10, 1 / 64)
    value = scene.energy(reference(scene, t, ()).states()) * np.exp(gamma * t)
    off, change = np.abs(value / value[0] - 1).max(), np.abs(value[64:] - value[:-64]).max() / value[0]
    yield at_most("max |H0(t) e^{λt}/H0(0) − 1|", off, 1e-2, "a line's width in the figure")
    yield CORRECTED
    yield at_most("max |change of H0 e^{λt} after a half turn|/H0(0)", change, *TRUE)


# -- momentum maps and reduction -----------------------------------------------------------------------
AXIS = np.array([0.48, 0.6, 0.64])  #: a unit vector


def rotate(y: Array, angle: Array | float) -> Array:
    """Return the cotangent lift of a rotation about `AXIS`, on T*R³ × R."""
    hat = jnp.array([[0, -AXIS[2], AXIS[1]], [AXIS[2], 0, -AXIS[0]], [-AXIS[1], AXIS[0], 0.0]])
    matrix = jnp.eye(3) + jnp.sin(angle) * hat + (1 - jnp.cos(angle)) * hat @ hat  # Rodrigues
    return jnp.concatenate([matrix @ y[:3], matrix @ y[3:6], y[6:]])


def generator(y: Array) -> Array:
    return jnp.asarray(jax.jvp(lambda angle: rotate(y, angle), (0.0,), (1.0,))[1])


def axial(y: Array) -> Array:
    """Return J_ξ of these rotations."""
    return jnp.dot(AXIS, jnp.cross(y[:3], y[3:6]))


def rotation_invariant(gamma: float) -> Field:
    return lambda y: y[3:6] @ y[3:6] / 2 + (y[:3] @ y[:3]) ** 2 / 4 + gamma * y[6]


@claim("C09")
def cotangent_lifts(seed: int = SEED) -> Evidence:
    def bend(q: Array) -> Array:
        """Return a diffeomorphism of R² that is no rotation."""
        return jnp.array([q[0] + jnp.tanh(q[1]), q[1] + jnp.sin(q[0] + jnp.tanh(q[1])) / 2])

    def lifted(y: Array) -> Array:
        q, p = y[:2], y[2:4]
        return jnp.concatenate([bend(q), jnp.linalg.solve(jacobian(bend)(q).T, p), y[4:]])

    def defect(map_: Field, dimension: int) -> float:
        return largest(lambda y: pullback(map_, eta, y) - eta(y), points(dimension, seed=seed))

    yield at_most("max |Φ*η − η|, rotations of space", defect(lambda y: rotate(y, 0.7), 7), *IDENTITY)
    yield at_most("max |Φ*η − η|, a nonlinear change of coordinates", defect(lifted, 5), *IDENTITY)


@claim("C10")
def infinitesimal_strictness(seed: int = SEED) -> Evidence:
    defect = partial(largest, at=points(7, seed=seed))
    lie, slope = lambda y: lie_derivative(generator, eta, y), gradient(axial)
    contraction = lambda y: generator(y) @ exterior(eta, y)  # noqa: E731
    yield at_most("max |L_ξ η + dJ_ξ|", defect(lambda y: lie(y) + slope(y)), *IDENTITY)
    yield CORRECTED
    yield at_most("max |L_ξ η|", defect(lie), *IDENTITY)
    yield at_most("max |J_ξ + ι_ξ η|", defect(lambda y: axial(y) + eta(y) @ generator(y)), *IDENTITY)
    yield at_most("max |dJ_ξ − ι_ξ dη|", defect(lambda y: slope(y) - contraction(y)), *IDENTITY)


AD_ON_QUARTIC = 100 * ROUND_OFF, "round-off of second derivatives by AD on numbers of size up to 100"
NO_IDENTITY = 1e-2, "far above round-off"


@claim("C39")
def commuting_derivatives(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    invariant = rotation_invariant(gamma)
    form = lambda y: jnp.sin(y[::-1]) + y * y[0]  # noqa: E731  # neither flow leaves it alone

    def both(field: Field, form: Field) -> tuple[Field, Field]:
        along_X, along_ξ = partial(lie_derivative, field), partial(lie_derivative, generator)
        return partial(along_X, partial(along_ξ, form)), partial(along_ξ, partial(along_X, form))

    at = points(7, seed=seed)
    X = contact_equations(invariant)
    left, right = both(X, form)
    size = largest(left, at)
    # without invariance d L_ξ L_X η = L_ξ L_X dη, of which eq. (51) says that it is −L_X L_ξ dη = 0
    _, other = both(contact_equations(lambda y: invariant(y) + y[0] * y[6]), eta)
    total = largest(lambda y: left(y) + right(y), at) / size
    difference = largest(lambda y: left(y) - right(y), at) / size
    yield at_most(
        "max |L_X L_ξ β + L_ξ L_X β|/max |L_X L_ξ β|, a one-form β, invariant H", total, *AD_ON_QUARTIC
    )
    yield at_most(
        "max |L_ξ L_X dη|, H not invariant", largest(lambda y: exterior(other, y), at), *AD_ON_QUARTIC
    )
    yield CORRECTED
    yield at_most("max |L_X L_ξ β − L_ξ L_X β|/max |L_X L_ξ β|, invariant H", difference, *AD_ON_QUARTIC)


@claim("C45")
def lie_derivative_of_the_form(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    scene = quadratically_damped(gamma)
    H, X = function_of(scene.hamiltonian), vector_field(scene)
    rate = lambda y: gradient(H)(y)[-1]  # noqa: E731
    right = lambda y: gradient(H)(y) - rate(y) * eta(y)  # noqa: E731
    of_form = lambda y: lie_derivative(X, eta, y)  # noqa: E731
    defect = partial(largest, at=points(5, seed=seed))
    scaled = lambda y: rate(y) * eta(y)  # noqa: E731
    inserted = defect(lambda y: X(y) @ exterior(of_form, y) - right(y))
    two_forms = defect(lambda y: exterior(of_form, y) + exterior(scaled, y))
    yield at_most("max |ι_X L_X dη − (dH − R(H) η)|, X inserted into the two-form", inserted, *IDENTITY)
    yield at_most(
        "read for η: max |L_X η − (dH − R(H) η)|", defect(lambda y: of_form(y) - right(y)), *IDENTITY
    )
    yield CORRECTED
    yield at_most("max |L_X dη + d(R(H) η)|", two_forms, *IDENTITY)
    yield at_most("max |L_X η + R(H) η|", defect(lambda y: of_form(y) + scaled(y)), *IDENTITY)
    contracted = defect(lambda y: X(y) @ exterior(eta, y) - right(y))
    yield at_most("max |ι_X dη − (dH − R(H) η)|", contracted, *IDENTITY)


def momentum_laws(gamma: float) -> tuple[Field, Field, Field, Field]:
    """Return X of a rotation-invariant H, J' along it, and the right-hand sides of eqs. (53) and (55)."""
    H = rotation_invariant(gamma)
    X = contact_equations(H)
    rate = lambda y: gradient(H)(y)[-1]  # noqa: E731

    def printed(y: Array) -> Array:
        """Return −ξ(H) + ξ(R(H)) η, the one-form evaluated on X, on which dJ is."""
        return along(generator, rate, y) * (eta(y) @ X(y)) - along(generator, H, y)

    return X, lambda y: along(X, axial, y), printed, lambda y: -rate(y) * axial(y)


@claim("C46")
def momentum_step(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    """gamma : > 0."""
    _, change, printed, law = momentum_laws(gamma)
    at = points(7, seed=seed)
    off = largest(lambda y: change(y) - printed(y), at) / largest(change, at)
    yield at_most("max |J' − (−ξ(H) + ξ(R(H)) η)|/max |J'|, invariant H", off, *AD_ON_QUARTIC)
    yield CORRECTED
    yield at_most("max |−ξ(H) + ξ(R(H)) η|: both terms vanish", largest(printed, at), *AD_ON_QUARTIC)
    yield at_most("max |J' + R(H) J|", largest(lambda y: change(y) - law(y), at), *AD_ON_QUARTIC)


@claim("C47")
def momentum_deduction(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    """gamma : > 0."""
    X, change, printed, law = momentum_laws(gamma)
    at = points(7, seed=seed)
    bracket = lambda y: jacobian(generator)(y) @ X(y) - jacobian(X)(y) @ generator(y)  # noqa: E731
    step = lambda y: -lie_derivative(X, eta, y) @ generator(y)  # noqa: E731
    off = largest(lambda y: printed(y) - law(y), at) / largest(law, at)
    yield at_most(
        "max |right of eq. (53) − right of eq. (55)|/max |R(H) J|, invariant H", off, *AD_ON_QUARTIC
    )
    yield CORRECTED
    yield at_most("max |[X, ξ]|, invariant H", largest(bracket, at), *AD_ON_QUARTIC)
    yield at_most(
        "max |J' + (L_X η)(ξ)|, from J = −ι_ξ η", largest(lambda y: change(y) - step(y), at), *AD_ON_QUARTIC
    )
    yield at_most("max |(L_X η)(ξ) − R(H) J|", largest(lambda y: step(y) - law(y), at), *AD_ON_QUARTIC)


@claim("C49")
def conformal_action(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    ξ = lambda y: jnp.append(y[:-1] / 2, y[-1])  # noqa: E731  # of (q, p, s) → (e^{a/2} q, e^{a/2} p, e^a s), σ = a
    X = contact_equations(lambda y: y[:4] @ y[:4] / 2 + gamma * y[4])
    lifted = lambda y: y[2:4] @ ξ(y)[:2]  # noqa: E731
    corrected = lambda y: lifted(y) - y[4]  # noqa: E731
    defect = partial(largest, at=points(5, seed=seed))

    def law(J: Field) -> float:
        return defect(lambda y: along(X, J, y) + gamma * J(y))

    conformal = defect(lambda y: lie_derivative(ξ, eta, y) - eta(y))
    yield at_most("max |L_ξ η − σ' η|, σ' = 1", conformal, *IDENTITY)
    yield at_most(
        "max |J_ξ − (p·ξ_Q − σ' s)|, J_ξ = −ι_ξ η", defect(lambda y: corrected(y) + eta(y) @ ξ(y)), *IDENTITY
    )
    yield at_most("max |J' + R(H) J|, H = ½‖p‖² + ½‖q‖² + γs", law(corrected), *IDENTITY)
    yield at_least("the same without the correction, J = p·ξ_Q", law(lifted), *NO_IDENTITY)


def times(scene: Scene) -> np.ndarray:
    return np.linspace(0, scene.t_end, 201)  # the grid of the frozen references


def momenta(scene: Scene) -> np.ndarray:
    """Return J along the truth, shape (201, m)."""
    return np.array(scene.momentum_at(reference(scene, times(scene)).states())).T


def radius_and_speed(x: State) -> tuple[np.ndarray, np.ndarray]:
    q, p = np.asarray(x.q), np.asarray(x.p)
    radius = np.hypot(*q)
    return radius, (q * p).sum(axis=0) / radius


@claim("C11")
def momentum_decay(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    def deviation(name: str) -> float:
        scene = SCENES[name].with_(gamma=gamma)
        J = momenta(scene)
        scaled = J * np.exp(scene.conformal_rate * times(scene))[:, None]
        return float(np.linalg.norm(scaled - J[0], axis=1).max() / np.linalg.norm(J[0]))

    coefficients = np.random.default_rng(seed).normal(size=(4, 4))

    def invariant(y: Array) -> Array:
        """Return a contact Hamiltonian that rotations leave alone, not of the form H0(q, p) + Γ(s)."""
        q, p, s = y[:2], y[2:4], y[4]
        u = jnp.array([q @ q, p @ p, q @ p, s])
        return u @ coefficients @ u / 4

    def defect(y: Array) -> Array:
        momentum = lambda y: jnp.asarray(SCENES["central"].momentum_at(canonical(y))[0])  # noqa: E731
        rate = gradient(invariant)(y)[-1]
        return along(contact_equations(invariant), momentum, y) + rate * momentum(y)

    off = largest(defect, points(5, seed=seed) / 2)
    of_quartic = 10 * ROUND_OFF, "round-off of AD on a quartic"
    yield at_most("max ‖J e^{λt} − J(0)‖/‖J(0)‖ along the true central", deviation("central"), *TRUE)
    yield at_most("the same for the true rigid body, J = R M", deviation("rigid_body"), *TRUE)
    yield at_most("the same in polar coordinates, J = p_θ", deviation("polar"), *TRUE)
    yield at_most("max |J' + R(H) J|, random invariant H(q, p, s)", off, *of_quartic)


@claim("C12")
def level_sets(gamma: float = 0.1) -> Evidence:
    damped = SCENES["central"].with_(gamma=gamma)

    def change(scene: Scene) -> float:
        J = momenta(scene)[:, 0]
        return float(np.abs(J - J[0]).max() / (abs(J[0]) or 1.0))

    straight = damped.with_(q=(1.0, 0.0), p=(0.3, 0.0))
    moves = 1e-3, "far above the uncertainty 10⁻¹³ of the truth"
    yield at_least(f"max |J(t) − J(0)|/|J(0)| at λ = {gamma:g}", change(damped), *moves)
    yield at_most("the same at λ = 0", change(damped.with_(gamma=0.0)), *TRUE)
    yield at_most(f"max |J(t)| at λ = {gamma:g}, J(0) = 0", change(straight), *TRUE)


@claim("C13")
def time_dependent_reduction(gamma: float = 0.1) -> Evidence:
    scene = SCENES["central"].with_(gamma=gamma)
    t = times(scene)
    radius, radial = radius_and_speed(reference(scene, t, ()).states())
    mu = scene.momentum_at(scene.initial(()))[0]

    def reduced(t: float, y: np.ndarray) -> list[float]:
        """Return H_μ = ½ (p_r² + μ(t)²/r²) + V(r), with γ s: the contact equations of (r, p_r) alone."""
        r, p_r = y
        level = mu * np.exp(-scene.gamma * t)
        return [p_r, level**2 / r**3 - scene.dV((r, 0.0))[0] - scene.gamma * p_r]

    run = scipy.integrate.solve_ivp(reduced, (0, scene.t_end), [radius[0], radial[0]], t_eval=t, **SOLVER)
    error = np.hypot(run.y[0] - radius, run.y[1] - radial).max() / np.hypot(radius, radial).max()
    yield at_most("max ‖(r, p_r) reduced − full‖ / max ‖full‖", error, *SOLVED)


@claim("C14")
def symplectification(gamma: float = 0.1) -> Evidence:
    """Project the homogeneous Hamiltonian flow on M × R₊, on which J r is conserved, onto the contact flow."""
    scene = SCENES["central"].with_(gamma=gamma)
    t = np.linspace(0, scene.t_end, 21)

    def lifted(contact: Field) -> Field:
        """Return K(x, P, s, r) = −r H(x, −P/r, s), of degree one in the momenta P = −r p of x and r of s."""

        def K(z: Array) -> Array:
            n = (len(z) - 2) // 2
            x, P, s, r = z[:n], z[n : 2 * n], z[-2], z[-1]
            return -r * contact(jnp.concatenate([x, -P / r, s[None]]))

        return K

    def flow(K: Field, z0: np.ndarray) -> np.ndarray:
        """Return the motion by Hamilton's equations of K for the pairs (x, P) and (s, r)."""
        n = (len(z0) - 2) // 2

        @jax.jit
        def rhs(z: Array) -> Array:
            slope = gradient(K)(z)
            return jnp.concatenate([slope[n : 2 * n], -slope[:n], slope[-1:], -slope[-2:-1]])

        run = scipy.integrate.solve_ivp(lambda _, z: np.asarray(rhs(z)), (0, t[-1]), z0, t_eval=t, **SOLVER)
        return np.asarray(run.y)

    def polar(y: Array) -> Array:
        """Return H on (ρ, p_ρ, s) with p_θ put in for the conserved level, y = (ρ, θ, p_ρ, p_θ, s)."""
        return (y[2] ** 2 + (y[3] / y[0]) ** 2) / 2 + jnp.asarray(scene.V((y[0], 0.0 * y[0]))) + gamma * y[4]

    full = lifted(lambda y: scene.hamiltonian_at(canonical(y)))
    q, p = np.array(scene.q), np.array(scene.p)
    run = flow(full, np.array([*q, *-p, scene.s, 1.0]))
    r, level = run[5], run[0] * run[3] - run[1] * run[2]
    truth = reference(scene, t)
    projected = np.vstack([run[:2], -run[2:4] / r, run[4]]).T
    error = np.linalg.norm(projected - truth.y, axis=1).max() / np.linalg.norm(truth.y, axis=1).max()

    def reduced(z: Array) -> Array:
        """Return K on (ρ, P_ρ, s, r) at the level P_θ = −r J."""
        ρ, P, s, r = z
        return lifted(polar)(jnp.stack([ρ, 0.0 * ρ, P, level[0] + 0.0 * ρ, s, r]))

    ρ0 = np.linalg.norm(q)
    down = flow(reduced, np.array([ρ0, -(q @ p) / ρ0, scene.s, 1.0]))
    ρ, radial = radius_and_speed(truth.states())
    off = np.abs(np.array([down[0] - ρ, -down[1] / down[3] - radial, down[2] - truth.states().s]))

    change = np.abs(level / level[0] - 1).max()
    yield at_most("max ‖projected − true‖ / max ‖true‖", error, *SOLVED)
    yield at_most("max |r J − r(0) J(0)|/|J(0)|: the lifted momentum is conserved", change, *SOLVED)
    yield at_most("max |(ρ, p_ρ, s) reduced, then projected, − true|", off.max(), *SOLVED)
