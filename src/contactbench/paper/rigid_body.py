"""Claims about the damped body: equations, momentum map, energy, equilibria and their stability (§4 of the paper)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.methods import solve
from contactbench.numbers.protocol import Arithmetic
from contactbench.paper import geometry
from contactbench.paper.geometry import ROUND_OFF, SEED, Field, jacobian, largest, pack, points
from contactbench.paper.ledger import Evidence, claim
from contactbench.scene import BodyState, RigidBody, cross, quaternion_product
from contactbench.scenes import SCENES
from contactbench.truth import reference
from contactbench.xla import jax_doubles as jax
from contactbench.xla import jnp_doubles as jnp

if TYPE_CHECKING:
    from jax import Array

#: D, or its diagonal alone; and M
type Matrix = np.ndarray | Sequence[float] | Sequence[Sequence[float]]
type Vector = np.ndarray | Sequence[float]

BODY = SCENES["rigid_body"]
INERTIA = (1.0, 2.0, 3.0)
#: two moments alike: no axis has a smaller one than the first, and none lies between
TIED = (1.0, 1.0, 3.0)


def chart(y: Array) -> BodyState:
    """Return the coordinates (θ, M, s) of T*SO(3) × R: the attitude is the rotation by the vector θ ≠ 0."""
    theta = y[:3]
    angle = jnp.sqrt(theta @ theta)
    axis = jnp.sin(angle / 2) * theta / angle
    return BodyState(tuple(y[3:6]), (jnp.cos(angle / 2), *axis), y[6])


def momentum_rate(scene: RigidBody) -> Field:
    return Field(lambda M: pack(scene.rhs(BodyState(tuple(M)))))


@claim("C15")
def body_equations(seed: int = SEED, **changes: object) -> Evidence:
    scene = BODY.with_(**changes)

    def form(y: Array) -> Array:
        return geometry.gradient(lambda v: scene.contact_form(*jax.jvp(chart, (y,), (v,))))(jnp.zeros(7))

    def defect(y: Array) -> Array:
        """Return X_H from its definition in a chart of T*SO(3) × R, against the equations."""
        X = geometry.contact_field(form, lambda y: scene.hamiltonian_at(chart(y)), y)
        return pack(jax.jvp(chart, (y,), (X,))[1]) - pack(scene.rhs(chart(y)))

    return [largest(defect, points(7, seed=seed))]


@claim("C16")
def body_momentum_map(seed: int = SEED, **changes: object) -> Evidence:
    scene = BODY.with_(**changes)

    def momentum_map(y: Array) -> Array:
        """Return J_ξ = −ι_ξ η for the rotations ξ = e_i in space, which turn the attitude by R' = ½ ξ R."""
        x = chart(y)
        turns = [quaternion_product((0.0, *(axis / 2)), x.R or ()) for axis in np.eye(3)]
        return jnp.stack([-scene.contact_form(x, BodyState((0.0,) * 3, dR, 0.0)) for dR in turns])

    def against(candidate: Callable[[BodyState], tuple[Arithmetic, ...]]) -> float:
        return largest(lambda y: momentum_map(y) - pack(candidate(chart(y))), points(7, seed=seed))

    return against(lambda x: x.M), against(scene.momentum)


@claim("C17")
def body_energy(**changes: object) -> Evidence:
    scene = BODY.with_(**changes)
    run = solve(scene, "scipy-dop853", rtol=1e-13, save_at=np.linspace(0, scene.t_end, 21), carry=())
    return [geometry.off_decay(scene.energy(run.states()), run.t, 2 * scene.gamma)]


# -- equilibria ------------------------------------------------------------------------------------
def random_damping(rng: np.random.Generator, rank: int, axis: int) -> np.ndarray:
    """Draw a symmetric D ≥ 0 of rank 0, 1 or 2 with D e_axis = 0 and a full transverse block."""
    D = np.zeros((3, 3))
    for _ in range(rank):
        column = rng.normal(size=3) * rng.uniform(0.2, 1.0)
        column[axis] = 0.0
        D += np.outer(column, column)
    return D


#: kinds of symmetric D ≥ 0, D ≠ 0, in turn: of full rank, then with an axis in, two axes in, a separatrix plane for,
#: any line for, any plane for its kernel; of the last two nothing is on an axis, and M falls as t^{−1/2}
KINDS, SLOW = 6, 2


def damping_of_kind(rng: np.random.Generator, kind: int, inertia: Sequence[float]) -> np.ndarray:
    rates, a = rng.uniform(0.5, 1, 3), 1 / np.asarray(inertia)
    if kind == 3:
        normal = np.sqrt([a[0] - a[1], 0.0, a[1] - a[2]]) * [1, 1, rng.choice([-1, 1])]
        return np.asarray(rates[0] * np.outer(normal, normal) / (normal @ normal))
    D = np.diag(rates * (rng.permutation(3) >= kind % 3))
    if kind < 3:
        return D
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turned = turn @ D @ turn.T
    return (turned + turned.T) / 2  # symmetric to the last bit


def residual(M: np.ndarray, inertia: Sequence[float], D: np.ndarray) -> np.ndarray:
    """Return M × I⁻¹M − D M for any matrix D, symmetric or not (§4.5, eq. (74))."""
    return np.asarray(cross(tuple(M), tuple(M / np.asarray(inertia))) - D @ M)


def equilibria(D: np.ndarray, inertia: Sequence[float], rng: np.random.Generator) -> list[np.ndarray]:
    """Return the nonzero solutions of M × I⁻¹M = D M from random starts, by least squares on residual/‖M‖²."""
    found = []
    for start in rng.normal(size=(6, 3)):
        relative = lambda M: np.append(residual(M, inertia, D) / (M @ M), 0.0)  # noqa: E731
        fit = scipy.optimize.least_squares(relative, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        size = np.linalg.norm(fit.x)
        if np.linalg.norm(residual(fit.x, inertia, D)) < 1e-12 * size * size and 1e-3 < size < 1e3:
            found.append(fit.x)
    return found


def distance_from_set(M: np.ndarray, D: np.ndarray) -> float:
    """Return how far M is from {D M = 0, M ∥ a principal axis}, relative to its size."""
    u = M / np.linalg.norm(M)
    return float(max(np.linalg.norm(D @ u), np.sqrt(max(0.0, 1 - np.max(u * u)))))


@claim("C18")
def equilibrium_set(seed: int = 3, cases: int = 27, inertia: Sequence[float] = INERTIA) -> Evidence:
    rng = np.random.default_rng(seed)
    distances = []
    for number in range(cases):
        D = damping_of_kind(rng, number % KINDS, inertia)
        distances += [distance_from_set(M, D) for M in equilibria(D, inertia, rng)]
    u = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    a = -np.array([1.0, -1.0, 0.0]) / np.sqrt(2) / 4
    skew = np.eye(3) - np.outer(u, u) + np.cross(np.eye(3), -a).T  # columns e_i × (−a) = a × e_i
    yield max(distances, default=0.0)
    yield len(distances)
    yield distance_from_set(u, skew)
    yield np.abs(residual(u, INERTIA, skew)).max()
    yield np.linalg.eigvalsh((skew + skew.T) / 2).min()


def direction_growths(scene: RigidBody) -> np.ndarray:
    """Return the growth rates of M/‖M‖ across each axis of the isotropic body at ‖M‖ = 1, (3,): those of M, and γ."""
    matrices = [np.asarray(jacobian(momentum_rate(scene))(jnp.asarray(e))) for e in np.eye(3)]
    transverse = [np.delete(np.delete(A, i, 0), i, 1) for i, A in enumerate(matrices)]
    return np.array([np.linalg.eigvals(A).real.max() + scene.gamma for A in transverse])


@claim("C22")
def relative_equilibria(gamma: float = 0.1, inertia: Sequence[float] = INERTIA) -> Evidence:
    """inertia : in ascending order."""
    scene = BODY.with_(gamma=gamma, inertia=tuple(inertia))
    axes = np.array([s * e for e in np.eye(3) for s in (1.0, -1.0)])
    rates = np.array([momentum_rate(scene)(M) for M in axes])
    truth = reference(scene, np.linspace(0, scene.t_end, 26), ())
    shape = scene.energy(truth.states()) / (truth.y**2).sum(axis=1)
    near = direction_growths(scene)
    yield from (np.linalg.norm(v, axis=1).max() for v in (rates, np.cross(axes, rates)))
    yield max(near[0], near[2])
    yield near[1], 0.99 * np.sqrt(coupling(inertia))
    yield geometry.off_decay(shape, truth.t, 0.0)


def coupling(inertia: Sequence[float]) -> float:
    """Return (1/I₂ − 1/I₃)(1/I₁ − 1/I₂), the square of the growth rate at the middle axis for ‖M‖ = 1, undamped."""
    a = 1 / np.asarray(inertia)
    return float((a[1] - a[2]) * (a[0] - a[1]))


def motions(D: np.ndarray, M: np.ndarray, inertia: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return M at t = 2000 and 4000 of many bodies, by RK4 with h = 0.1: D (k, 3, 3), M (k, 3) → (k, 3) twice."""
    a, h = 1 / np.asarray(inertia), 0.1

    def later(D: Array, M: Array) -> Array:
        def f(M: Array) -> Array:
            return jnp.cross(M, a * M) - D @ M

        def step(_: int, M: Array) -> Array:
            k1 = f(M)
            k2 = f(M + h / 2 * k1)
            k3 = f(M + h / 2 * k2)
            return M + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(M + h * k3))

        return jnp.asarray(jax.lax.fori_loop(0, 20_000, step, M))

    advance = jax.jit(jax.vmap(later))
    half = advance(D, M)
    return np.asarray(half), np.asarray(advance(D, half))


def highest_power(M: np.ndarray, D: np.ndarray, inertia: Sequence[float]) -> float:
    """Return the largest H0' = −Ω·DM of many bodies: D (k, 3, 3), M (k, 3)."""
    return float((-np.einsum("ki,i,kij,kj->k", M, 1 / np.asarray(inertia), D, M)).max())


def distance_to_equilibria(M: np.ndarray, D: np.ndarray) -> float:
    """Return the distance of M from 0 and from the principal axes in ker D."""
    lines = [np.linalg.norm(np.delete(M, i)) for i in range(3) if np.linalg.norm(D[:, i]) < ROUND_OFF]
    return float(min([np.linalg.norm(M), *lines]))


@claim("C50")
def classical_stability(seed: int = SEED, cases: int = 300) -> Evidence:
    """Measure the undamped body: eigenvalues of many, motions from beside the outer axes, and one of equal moments."""
    rng = np.random.default_rng(seed)
    inertias = np.cumsum(rng.uniform(0.3, 1.0, (cases, 3)), axis=1)
    sizes = rng.choice([-1.0, 1.0], cases) * rng.uniform(0.2, 2.0, cases)
    drawn, none, unit = list(zip(inertias, sizes, strict=True)), np.zeros((3, 3)), np.eye(3)
    middle = growths([(none, tuple(I), m * unit[1]) for I, m in drawn])
    euler = np.array([abs(m) * np.sqrt(coupling(I)) for I, m in drawn])
    axes = np.repeat([1.0, -1.0, 1.0, -1.0], 25)[:, None] * np.repeat(unit[[0, 0, 2, 2]], 25, axis=0)
    starts = axes + 1e-3 * rng.normal(size=axes.shape)
    later = motions(np.zeros((len(axes), 3, 3)), starts, INERTIA)
    yield growths([(none, tuple(I), m * unit[axis]) for I, m in drawn for axis in (0, 2)]).max()
    yield np.max([np.linalg.norm(M - axes, axis=1) / np.linalg.norm(starts - axes, axis=1) for M in later])
    yield np.abs(middle / euler - 1).max()
    beside = np.array([1.0, 0.0, 1e-3])
    half_turn = math.pi / (beside[2] * (1 / TIED[0] - 1 / TIED[2]))
    yield np.linalg.norm(momentum_at(none, beside, half_turn, TIED) - beside)


@claim("C41")
def motions_settle(seed: int = SEED, starts: int = 1200, inertia: Sequence[float] = INERTIA) -> Evidence:
    """starts : a multiple of six.  inertia : in ascending order."""
    rng = np.random.default_rng(seed)
    D = np.array([damping_of_kind(rng, n % KINDS, inertia) for n in range(starts)])
    M = rng.normal(size=(starts, 3))
    M /= np.linalg.norm(M, axis=1)[:, None]
    half, end = motions(D, M, inertia)
    slow = np.arange(starts) % KINDS >= KINDS - SLOW
    free = [(m**2).sum(axis=1) for m in motions(0 * D[:60], M[:60], inertia)]
    yield {"fast": (~slow).sum(), "slow": slow.sum()}
    yield max(distance_to_equilibria(m, d) for m, d in zip(end[~slow], D[~slow], strict=True))
    growth = (1 / (end[slow] ** 2).sum(axis=1) - 1 / (half[slow] ** 2).sum(axis=1)).min()
    yield growth, 10 * abs(1 / free[1] - 1 / free[0]).max()
    yield -np.einsum("ki,kij,kj->k", M, D, M).min()
    yield highest_power(M, D, inertia)


# -- stability of the steady rotations -------------------------------------------------------------
# Let D be symmetric ≥ 0, D e_i = 0, M* = m e_i, a = 1/I, and (i, j, k) a cyclic order.  M' = M × I⁻¹M − D M linearised
# across the axis is
#
#     A = ( −d_jj                     m (a_i − a_k) − d_jk )
#         ( m (a_j − a_i) − d_jk      −d_kk                ),
#
#     tr A  = −(d_jj + d_kk),
#     det A = d_jj d_kk − d_jk² + m (a_j − a_k) d_jk + m² (a_i − a_j)(a_i − a_k).
#
# det A < 0 is a saddle; det A > 0 is stable, asymptotically if D ≠ 0.  The classical theorem sees the last term alone,
# positive for an extreme axis; the sign of the third is that of m.
#: (D, inertia, M*), M* on a principal axis in ker D
type Case = tuple[Matrix, Sequence[float], Vector]


def body(D: Matrix, inertia: Sequence[float] = INERTIA) -> RigidBody:
    scene: RigidBody = SCENES["rigid_body_anisotropic"]
    return scene.with_(damping=np.asarray(D).tolist(), inertia=tuple(inertia))


def transverse(cases: Sequence[Case]) -> np.ndarray:
    """Return the two transverse eigenvalues at each of many equilibria: all but the one nearest 0; (k, 2)."""

    def linearise(scene: RigidBody) -> Callable[[Array, Array], Array]:
        return jax.jit(lambda numbers, M: jacobian(momentum_rate(scene.with_numbers(list(numbers))))(M))

    compiled, matrices = {}, []
    for D, inertia, M in cases:
        scene = body(D, inertia)
        shape = scene.axes is None  # one of two of the right-hand side
        if shape not in compiled:
            compiled[shape] = linearise(scene)
        matrices.append(compiled[shape](jnp.array(scene.numbers()), jnp.array(M, dtype=float)))
    values = np.linalg.eigvals(np.array(matrices))
    return np.take_along_axis(values, np.argsort(np.abs(values), axis=1)[:, 1:], axis=1)


def growths(cases: Sequence[Case]) -> np.ndarray:
    return transverse(cases).real.max(axis=1)


def growth(D: Matrix, M: Vector, inertia: Sequence[float] = INERTIA) -> float:
    return float(growths([(D, inertia, M)])[0])


def criterion(D: Matrix, M: Vector, inertia: Sequence[float] = INERTIA) -> tuple[float, float]:
    """Return (tr A, det A) at M* = m e_i with D e_i = 0, by the formulas above."""
    D, a = np.asarray(D, dtype=float), 1 / np.asarray(inertia, dtype=float)
    i = int(np.argmax(np.abs(M)))
    j, k, m = (i + 1) % 3, (i + 2) % 3, float(M[i])
    block = D[j, j] * D[k, k] - D[j, k] ** 2
    determinant = block + m * (a[j] - a[k]) * D[j, k] + m * m * (a[i] - a[j]) * (a[i] - a[k])
    return -float(D[j, j] + D[k, k]), float(determinant)


def random_equilibria(axes: Sequence[int], cases: int, seed: int) -> list[Case]:
    """Draw cases with M* on one of `axes`; rank 0, 1, 2 of D in turn, both signs of M*."""
    rng = np.random.default_rng(seed)
    found: list[Case] = []
    for number in range(cases):
        axis = axes[number % len(axes)]
        M = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 2.0) * np.eye(3)[axis]
        D = random_damping(rng, number // len(axes) % 3, axis)
        # those a body can have (I₁ + I₂ ≥ I₃) and others
        found.append((D, np.sort(rng.uniform(0.5, 3.0, 3)).tolist(), M))
    return found


def count_misjudged(cases: Sequence[Case], slack: float = 1e-9) -> int:
    """Count the cases that tr A and det A judge otherwise than the 3×3 spectrum does; slack : what counts as 0."""
    wrong = 0
    for (D, inertia, M), (lower, upper) in zip(cases, np.sort(transverse(cases).real), strict=True):
        trace, determinant = criterion(D, M, inertia)
        says = -1 if determinant < -slack else 0 if determinant < slack or trace > -slack else 1
        is_ = -1 if upper > slack and lower < -slack else 1 if upper < -slack else 0
        wrong += says != is_
    return wrong


#: at e₃, D pushes along the transverse diagonal on which the gyroscopic coupling does not resist
COUNTEREXAMPLE = ((0.5, -0.5, 0.0), (-0.5, 0.5, 0.0), (0.0, 0.0, 0.0))


def momentum_at(D: Matrix, M: Vector, t: float, inertia: Sequence[float] = INERTIA) -> np.ndarray:
    scene = body(D, inertia).with_(M=np.asarray(M).tolist(), t_end=t)
    return np.asarray(solve(scene, "scipy-dop853", rtol=1e-12, save_at=[t], carry=()).y[-1])


@claim("C19")
def extreme_axes(seed: int = 4, cases: int = 300) -> Evidence:
    rate = growth(COUNTEREXAMPLE, [0.0, 0.0, 1.0])
    end = momentum_at(COUNTEREXAMPLE, [1e-6, 1e-6, 1.0], 50 / max(rate, 0.01))
    drawn = random_equilibria((0, 2), cases, seed)
    yield from (rate, count_misjudged(drawn), end[2], np.hypot(end[0], end[1]))
    yield growth(COUNTEREXAMPLE, [0.0, 0.0, end[2]])
    yield growths([(np.diag(np.diag(D)), inertia, M) for D, inertia, M in drawn if np.any(D)]).max()
    tied = transverse([(np.diag([0.0, 0.0, 0.5]), TIED, np.eye(3)[0])])
    yield np.abs(np.sort(tied.real) - [-0.5, 0.0]).max()


@claim("C20")
def intermediate_axis(
    seed: int = 5, cases: int = 300, inertia: Sequence[float] = INERTIA, size: float = 1.0
) -> Evidence:
    """inertia, in ascending order, size = |M*| : of the rotation damped by diag(d, 0, d)."""
    square = size**2 * coupling(inertia)

    def rate(square: float) -> float:
        return growth(np.sqrt(square) * np.diag([1.0, 0.0, 1.0]), size * np.eye(3)[1], inertia)

    edge = scipy.optimize.brentq(rate, square / 10, 10 * square, xtol=1e-15)
    yield rate(3 * square)
    yield count_misjudged(random_equilibria((1,), cases, seed))
    yield abs(edge / square - 1)
    # full transverse blocks that the product d₁ d₃ alone would misjudge
    for d1, d3, d13 in ((0.5, 0.5, 0.5), (0.29, 0.2, -0.2)):
        yield growth([[d1, 0.0, d13], [0.0, 0.0, 0.0], [d13, 0.0, d3]], np.eye(3)[1])
    yield abs(growth(np.zeros((3, 3)), np.eye(3)[1], TIED))


def along_kernel(kernel: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return M at t = 80 and 8000, damped by 1 − uuᵀ with `kernel` along u; and u."""
    u = np.asarray(kernel) / np.linalg.norm(kernel)
    scene = body(np.eye(3) - np.outer(u, u)).with_(t_end=8000.0)
    return solve(scene, "scipy-dop853", rtol=1e-9, save_at=[80.0, 8000.0], carry=()).y, u


@claim("C21")
def decay_to_the_origin(
    rates: Sequence[float] = (1.0, 1.0), kernel: Sequence[float] = (1.0, 2.0, 0.0)
) -> Evidence:
    """rates : about axes 2 and 3.  kernel : a direction that is no principal axis."""
    scene = body((0.0, *rates))
    start = np.array(scene.M)
    left = momentum_at(scene.damping, start, 80.0 / min(rates)) / np.linalg.norm(start)
    sizes = np.linalg.norm(along_kernel(kernel)[0], axis=1)
    return np.linalg.norm(left), abs(left[0]), np.hypot(left[1], left[2]), sizes[1] / sizes[0]


@claim("C40")
def modes(kernel: Sequence[float] = (1.0, 2.0, 0.0), rate: float = 0.5) -> Evidence:
    """kernel : a direction that is no principal axis.  rate : about axis 3, below twice the frequency at e₁."""
    M, u = along_kernel(kernel)
    along = np.abs(M @ u)
    off = np.linalg.norm(M - np.outer(M @ u, u), axis=1)
    damped = growth(np.diag([0.0, 0.0, rate]), np.eye(3)[0])
    fell, slaved = along[1] / along[0], off[1] / off[0]
    yield growth(COUNTEREXAMPLE, np.eye(3)[2])
    yield from (abs(damped), abs(-damped / (rate / 2) - 1), fell, abs(slaved / fell**2 - 1))


@claim("C56")
def linearisation(seed: int = SEED, cases: int = 60) -> Evidence:
    misses = []
    rng = np.random.default_rng(seed)
    for D, inertia, M in random_equilibria((0, 1, 2), cases, seed):
        change, a = rng.normal(size=3), 1 / np.asarray(inertia)
        derived = np.asarray(jacobian(momentum_rate(body(D, inertia)))(jnp.asarray(M))) @ change
        misses.append(derived - (np.cross(change, a * M) + np.cross(M, a * change) - D @ change))
    yield {"cases": cases}
    yield np.abs(misses).max()


def beside_axis(axis: int) -> np.ndarray:
    """Return where the motions of Figure 4 start: a unit M, 0.08 off the axis in both directions across it."""
    M = np.full(3, 0.08)
    M[axis] = math.sqrt(1 - 2 * 0.08 * 0.08)
    return M


@claim("C57")
def rotational_energy(seed: int = SEED, gamma: float = 0.1, inertia: Sequence[float] = INERTIA) -> Evidence:
    scene = BODY.with_(gamma=gamma, inertia=tuple(inertia), t_end=3 / gamma)
    energy = Field(lambda M: jnp.asarray(scene.energy(BodyState(tuple(M)))))
    change, M = geometry.along(momentum_rate(scene), energy), points(3, seed=seed)
    steps = []
    for axis in range(3):
        start = scene.with_(M=tuple(beside_axis(axis)))
        along = scene.energy(reference(start, np.linspace(0, scene.t_end, 26), ()).states())
        steps.append(np.diff(along) / along[0])
    rng = np.random.default_rng(seed)
    D = np.array([damping_of_kind(rng, KINDS - 1, inertia) for _ in M])
    yield largest(lambda M: change(M) / (2 * gamma * energy(M)) + 1, M)
    yield np.max(steps)
    yield highest_power(M, D, inertia)


@claim("C59")
def published_classifications(seed: int = SEED, inertia: Sequence[float] = INERTIA) -> Evidence:
    M, rng = points(3, seed=seed), np.random.default_rng(seed)
    bracket = np.cross(M, np.cross(M, M / np.asarray(inertia)))
    linear = np.array([damping_of_kind(rng, 0, inertia) @ m for m in M])
    along = [np.einsum("ki,ki->k", M, damping) / (M**2).sum(axis=1) for damping in (bracket, linear)]
    yield int(np.abs(along[0]).max() > ROUND_OFF)
    yield np.abs((M * bracket).sum(axis=1)).max()
    yield along[1].min()
