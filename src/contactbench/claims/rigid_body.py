"""Claims about the damped body: equations, momentum map, energy, equilibria and their stability (§4 of the paper)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.claims.geometry import (
    IDENTITY,
    ROUND_OFF,
    SEED,
    Field,
    contact_field,
    gradient,
    jacobian,
    largest,
    pack,
    points,
)
from contactbench.claims.ledger import CORRECTED, Evidence, Measurement, at_least, at_most, claim
from contactbench.methods import solve
from contactbench.numbers.protocol import Arithmetic
from contactbench.scene import BodyState, RigidBody, cross, quaternion_product
from contactbench.scenes import SCENES
from contactbench.truth import reference
from contactbench.xla import jax, jnp

if TYPE_CHECKING:
    from jax import Array

#: D, or its diagonal alone; and M
type Matrix = np.ndarray | Sequence[float] | Sequence[Sequence[float]]
type Vector = np.ndarray | Sequence[float]

BODY = SCENES["rigid_body"]
INERTIA = (1.0, 2.0, 3.0)
EIGENVALUES = 1e-12, "round-off of the eigenvalues of a 3×3 matrix of size one"


def chart(y: Array) -> BodyState:
    """Return the coordinates (θ, M, s) of T*SO(3) × R: the attitude is the rotation by the vector θ ≠ 0."""
    theta = y[:3]
    angle = jnp.sqrt(theta @ theta)
    axis = jnp.sin(angle / 2) * theta / angle
    return BodyState(tuple(y[3:6]), (jnp.cos(angle / 2), *axis), y[6])


def momentum_rate(scene: RigidBody) -> Field:
    return lambda M: pack(scene.rhs(BodyState(tuple(M))))


@claim("C15")
def body_equations(seed: int = SEED, **changes: object) -> Evidence:
    scene = BODY.with_(**changes)

    def form(y: Array) -> Array:
        return gradient(lambda v: scene.contact_form(*jax.jvp(chart, (y,), (v,))))(jnp.zeros(7))

    def defect(y: Array) -> Array:
        """Return X_H from its definition in a chart of T*SO(3) × R, against the equations."""
        X = contact_field(form, lambda y: scene.hamiltonian_at(chart(y)), y)
        return pack(jax.jvp(chart, (y,), (X,))[1]) - pack(scene.rhs(chart(y)))

    off = largest(defect, points(7, seed=seed))
    rounding = 10 * ROUND_OFF, "round-off of AD through a chart whose metric is conditioned up to 10"
    yield at_most("max |X_H by definition − equations| at random (R, M, s)", off, *rounding)


@claim("C16")
def body_momentum_map(seed: int = SEED, **changes: object) -> Evidence:
    scene = BODY.with_(**changes)

    def momentum_map(y: Array) -> Array:
        """Return J_ξ = −ι_ξ η for the rotations ξ = e_i in space."""
        x = chart(y)
        attitude = x.R or ()

        def component(axis: np.ndarray) -> Array:
            def rotated(angle: Array | float) -> tuple[Arithmetic, ...]:
                half = angle / 2
                return quaternion_product((jnp.cos(half), *(jnp.sin(half) * c for c in axis)), attitude)

            dR = jax.jvp(rotated, (0.0,), (1.0,))[1]
            return -jnp.asarray(scene.contact_form(x, BodyState((0.0,) * 3, dR, 0.0)))

        return jnp.stack([component(axis) for axis in np.eye(3)])

    def against(candidate: Callable[[BodyState], tuple[Arithmetic, ...]]) -> float:
        return largest(lambda y: momentum_map(y) - pack(candidate(chart(y))), points(7, seed=seed))

    yield at_most("max |J_ξ − M·ξ| at random (R, M), J_ξ = −ι_ξ η", against(lambda x: x.M), *IDENTITY)
    yield CORRECTED
    yield at_most("max |J_ξ − (R M)·ξ|, the suite's momentum map", against(scene.momentum), *IDENTITY)


@claim("C17")
def body_energy(**changes: object) -> Evidence:
    scene = BODY.with_(**changes)
    run = solve(scene, "scipy-dop853", rtol=1e-13, save_at=np.linspace(0, scene.t_end, 21), carry=())
    energy = scene.energy(run.states()) * np.exp(2 * scene.gamma * run.t)
    solved = 1e-10, "10³ times the tolerance 10⁻¹³ of the solver"
    yield at_most("max |H0(t) e^{2γt}/H0(0) − 1|", np.abs(energy / energy[0] - 1).max(), *solved)


# -- equilibria ------------------------------------------------------------------------------------
def random_damping(rng: np.random.Generator, rank: int, axis: int) -> np.ndarray:
    """Draw a symmetric D ≥ 0 of rank 0, 1 or 2 with D e_axis = 0 and a full transverse block."""
    D = np.zeros((3, 3))
    for _ in range(rank):
        column = rng.normal(size=3) * rng.uniform(0.2, 1.0)
        column[axis] = 0.0
        D += np.outer(column, column)
    return D


#: kinds of symmetric D ≥ 0, D ≠ 0, in turn: with … its kernel
KERNELS = "an axis in", "two axes in", "a separatrix plane for", "any line for", "any plane for"
DAMPINGS = ("of full rank", *(f"with {kernel} its kernel" for kernel in KERNELS))
SLOW = 2  #: of these, in which nothing is on an axis: M falls as t^{−1/2}


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
    for start in rng.normal(size=(12, 3)):
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
        D = damping_of_kind(rng, number % len(DAMPINGS), inertia)
        distances += [distance_from_set(M, D) for M in equilibria(D, inertia, rng)]
    u = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    a = -np.array([1.0, -1.0, 0.0]) / np.sqrt(2) / 4
    skew = np.eye(3) - np.outer(u, u) + np.cross(np.eye(3), -a).T  # columns e_i × (−a) = a × e_i
    lowest = np.linalg.eigvalsh((skew + skew.T) / 2).min()
    solved = 1e-5, "square root of the solver's 10⁻¹², since the residual may vanish quadratically, times 10"
    enough = 10, "the search must find something to be worth anything"
    apart, zero = (1e-2, "far above the residual of the equilibrium"), (-ROUND_OFF, "zero up to round-off")
    farthest = f"farthest of the equilibria found from the set, {cases} symmetric D of rank 1, 2, 3"
    beside = "distance from the set of an equilibrium of a D that is not symmetric"
    left = np.abs(residual(u, INERTIA, skew)).max()
    yield at_most(farthest, max(distances, default=0.0), *solved)
    yield at_least("equilibria found, all M ≠ 0", len(distances), *enough)
    yield CORRECTED
    yield at_least(beside, distance_from_set(u, skew), *apart)
    yield at_most("its residual |M × I⁻¹M − DM|, I = (1, 2, 3)", left, *IDENTITY)
    yield at_least("smallest eigenvalue of the symmetric part of that D", lowest, *zero)


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
    truth = reference(scene, np.linspace(0, scene.t_end, 201), ())
    shape = scene.energy(truth.states()) / (truth.y**2).sum(axis=1)
    of_direction = direction_growths(scene)
    a = 1 / np.asarray(inertia)
    free = np.sqrt((a[1] - a[2]) * (a[0] - a[1]))
    euler = 0.99 * free, "√((1/I₂ − 1/I₃)(1/I₁ − 1/I₂)) at ‖M‖ = 1, Euler's equations, less one per cent"
    rounded = 1e-13, "the reference rounded to double precision"
    fastest, turning = (np.linalg.norm(v, axis=1).max() for v in (rates, np.cross(axes, rates)))
    change, outer = np.abs(shape / shape[0] - 1).max(), max(of_direction[0], of_direction[2])
    yield at_most("max ‖M'‖ at the six unit momenta on the axes", fastest, *IDENTITY)
    yield CORRECTED
    yield at_most("max ‖M × M'‖ there: the direction stays", turning, *IDENTITY)
    yield at_most("growth rate of the direction near axes 1 and 3", outer, *EIGENVALUES)
    yield at_least("growth rate of the direction near axis 2", of_direction[1], *euler)
    yield at_most("max |(H0/‖M‖²)(t)/(H0/‖M‖²)(0) − 1| along the true body", change, *rounded)


def motions(
    D: np.ndarray, M: np.ndarray, inertia: Sequence[float], h: float = 0.1
) -> tuple[np.ndarray, np.ndarray]:
    """Return M at t = 2000 and 4000 of many bodies, by RK4: D (k, 3, 3), M (k, 3) → (k, 3) twice."""
    a = 1 / np.asarray(inertia)

    def later(D: Array, M: Array) -> Array:
        f: Field = lambda M: jnp.cross(M, a * M) - D @ M  # noqa: E731

        def step(_: int, M: Array) -> Array:
            k1 = f(M)
            k2 = f(M + h / 2 * k1)
            k3 = f(M + h / 2 * k2)
            return M + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(M + h * k3))

        return jnp.asarray(jax.lax.fori_loop(0, round(2000 / h), step, M))

    advance = jax.jit(jax.vmap(later))
    half = advance(D, M)
    return np.asarray(half), np.asarray(advance(D, half))


def distance_to_equilibria(M: np.ndarray, D: np.ndarray) -> float:
    """Return the distance of M from 0 and from the principal axes in ker D."""
    lines = [np.linalg.norm(np.delete(M, i)) for i in range(3) if np.linalg.norm(D[:, i]) < ROUND_OFF]
    return float(min([np.linalg.norm(M), *lines]))


@claim("C50")
def classical_stability(seed: int = SEED, cases: int = 300) -> Evidence:
    """Measure the undamped body: eigenvalues of many, and motions of one from beside its outer axes."""
    rng = np.random.default_rng(seed)
    inertias = np.cumsum(rng.uniform(0.3, 1.0, (cases, 3)), axis=1)
    sizes = rng.choice([-1.0, 1.0], cases) * rng.uniform(0.2, 2.0, cases)
    drawn = [(np.zeros((3, 3)), tuple(I), m, 1 / I) for I, m in zip(inertias, sizes, strict=True)]
    outer = growths([(D, I, m * np.eye(3)[axis]) for D, I, m, _ in drawn for axis in (0, 2)])
    middle = growths([(D, I, m * np.eye(3)[1]) for D, I, m, _ in drawn])
    euler = np.array([abs(m) * np.sqrt((a[1] - a[2]) * (a[0] - a[1])) for *_, m, a in drawn])
    axes = np.repeat([1.0, -1.0, 1.0, -1.0], 25)[:, None] * np.repeat(np.eye(3)[[0, 0, 2, 2]], 25, axis=0)
    starts = axes + 1e-3 * rng.normal(size=axes.shape)
    away = [
        np.linalg.norm(M - axes, axis=1) / np.linalg.norm(starts - axes, axis=1)
        for M in motions(np.zeros((len(axes), 3, 3)), starts, INERTIA)
    ]
    several = 10, "a constant: H0 is extremal there among the M of one size"
    exact = 1e-9, "round-off of the eigenvalues"
    yield at_most(
        f"largest growth rate across the outer axes of {cases} random bodies, D = 0",
        outer.max(),
        *EIGENVALUES,
    )
    yield at_most(
        "largest ‖M − M*‖ over that at the start, 10⁻³, at t = 2000 and 4000", np.max(away), *several
    )
    off = np.abs(middle / euler - 1).max()
    yield at_most("max |growth rate/(‖M*‖ √((1/I₂ − 1/I₃)(1/I₁ − 1/I₂))) − 1|, the middle axis", off, *exact)


@claim("C41")
def motions_settle(seed: int = SEED, starts: int = 1200, inertia: Sequence[float] = INERTIA) -> Evidence:
    """starts : a multiple of six.  inertia : in ascending order."""
    rng, kinds = np.random.default_rng(seed), len(DAMPINGS)
    D = np.array([damping_of_kind(rng, n % kinds, inertia) for n in range(starts)])
    M = rng.normal(size=(starts, 3))
    M /= np.linalg.norm(M, axis=1)[:, None]
    half, end = motions(D, M, inertia)
    slow = np.arange(starts) % kinds >= kinds - SLOW
    left = [distance_to_equilibria(m, d) for m, d in zip(end[~slow], D[~slow], strict=True)]
    free = [(m**2).sum(axis=1) for m in motions(0 * D[:60], M[:60], inertia)]
    own = abs(1 / free[1] - 1 / free[0]).max()
    growth = (1 / (end[slow] ** 2).sum(axis=1) - 1 / (half[slow] ** 2).sum(axis=1)).min()
    rise = -np.einsum("ki,i,kij,kj->k", M, 1 / np.asarray(inertia), D, M)
    slowest = 0.05, "t^{−1/2} = 0.016, the slowest there is, times a constant of three"
    above_error = 10 * own, "ten times what rk4's own error does without damping"
    farthest = f"farthest from the set at t = 4000 of {len(left)} motions, ‖M(0)‖ = 1"
    falls = f"growth of 1/‖M‖² from t = 2000 to 4000, least of {slow.sum()} motions"
    yield at_most(f"{farthest}, D {', '.join(DAMPINGS[:-SLOW])}", max(left), *slowest)
    yield at_least(f"{falls}, D {' or '.join(DAMPINGS[-SLOW:])}", growth, *above_error)
    yield CORRECTED
    yield at_most("largest M·M' at random M", -np.einsum("ki,kij,kj->k", M, D, M).min(), *IDENTITY)
    yield at_least("largest H0' there", rise.max(), 1e-2, "H0 rises")


# -- stability of the steady rotations -------------------------------------------------------------
# Take a principal axis i in ker D and M* = m e_i, m of either sign, D symmetric ≥ 0.  Let a = 1/I and (i, j, k) be a
# cyclic order of the axes.  M' = M × I⁻¹M − D M has the components
#
#     M_j' = (a_i − a_k) M_k M_i − (D M)_j,    M_k' = (a_j − a_i) M_i M_j − (D M)_k.
#
# D e_i = 0 and D = Dᵀ leave of D the block (d_jj, d_jk; d_jk, d_kk).  At M* the axis i has eigenvalue 0, because m' e_i
# is an equilibrium for every m', and the transverse linearisation is
#
#     A = ( −d_jj                     m (a_i − a_k) − d_jk )
#         ( m (a_j − a_i) − d_jk      −d_kk                ),
#
#     tr A  = −(d_jj + d_kk),
#     det A = d_jj d_kk − d_jk² + m (a_j − a_k) d_jk + m² (a_i − a_j)(a_i − a_k).
#
# tr A ≤ 0, and tr A = 0 only for D = 0.  So, off the border det A = 0: det A < 0 is a saddle; det A > 0 is stable,
# asymptotically across the axis if D ≠ 0.  The last term of det A is positive for an extreme axis and negative for the
# intermediate one: that is all the classical theorem sees.  The third term has either sign and changes it with m: M*
# and −M* may differ.
#: (D, inertia, M*), M* on a principal axis in ker D
type Case = tuple[Matrix, Sequence[float], Vector]
BELOW_ZERO = -EIGENVALUES[0], EIGENVALUES[1]
CASES = 300
GONE = 1e-9, "10³ times the tolerance 10⁻¹² of the solver"
SLOWEST = 0.15, "t^{−1/2}: 0.1, and half as much again for the transient"


def body(D: Matrix, inertia: Sequence[float] = INERTIA) -> RigidBody:
    damping = tuple(map(tuple, D)) if np.ndim(D) == 2 else tuple(D)
    scene: RigidBody = SCENES["rigid_body_anisotropic"]
    return scene.with_(damping=damping, inertia=tuple(inertia))


def transverse(cases: Sequence[Case]) -> np.ndarray:
    """Return the two transverse eigenvalues at each of many equilibria: all but the one nearest 0; (k, 2)."""
    scenes = [body(D, inertia) for D, inertia, _ in cases]
    momenta = np.array([M for *_, M in cases], dtype=float)
    diagonal = np.array([scene.axes is None for scene in scenes])
    matrices = np.empty((len(scenes), 3, 3))
    for kind in np.unique(diagonal):  # two shapes of right-hand side
        mine = np.flatnonzero(diagonal == kind)
        first = scenes[mine[0]]
        linearise = lambda numbers, M: jacobian(momentum_rate(first.with_numbers(list(numbers))))(M)  # noqa: B023, E731
        numbers = np.array([scenes[k].numbers() for k in mine])
        matrices[mine] = jax.jit(jax.vmap(linearise))(numbers, momenta[mine])
    values = np.linalg.eigvals(matrices)
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


def contradicted_cases(cases: Sequence[Case]) -> Measurement:
    drawn = f"{len(cases)} random (I, D, M*), symmetric D ≥ 0 of rank 0, 1, 2 with D M* = 0"
    contradicted = f"cases of {drawn}, whose 3×3 spectrum contradicts the criterion"
    return at_most(contradicted, count_misjudged(cases), 0, "a criterion has none")


#: at e₃, D pushes along the transverse diagonal on which the gyroscopic coupling does not resist
COUNTEREXAMPLE = ((0.5, -0.5, 0.0), (-0.5, 0.5, 0.0), (0.0, 0.0, 0.0))


def momentum_at(D: Matrix, M: Vector, t: float) -> np.ndarray:
    scene = body(D).with_(M=tuple(float(m) for m in M), t_end=t)
    return np.asarray(solve(scene, "scipy-dop853", rtol=1e-12, save_at=[t], carry=()).y[-1])


@claim("C19")
def extreme_axes(seed: int = 4, cases: int = CASES) -> Evidence:
    rate = growth(COUNTEREXAMPLE, [0.0, 0.0, 1.0])
    t = 50 / max(rate, 0.01)
    end = momentum_at(COUNTEREXAMPLE, [1e-6, 1e-6, 1.0], t)
    after = growth(COUNTEREXAMPLE, [0.0, 0.0, end[2]])
    drawn = random_equilibria((0, 2), cases, seed)
    largest = growths([(np.diag(np.diag(D)), inertia, M) for D, inertia, M in drawn if np.any(D)]).max()
    example = "M* = e₃, D = ½ [[1, −1, 0], [−1, 1, 0], [0, 0, 0]], I = (1, 2, 3)"
    reversed_ = 0.0, "the motion has left M* for the other half of the axis"
    yield at_most(f"growth rate at {example}", rate, *BELOW_ZERO)
    yield CORRECTED
    yield contradicted_cases(drawn)
    yield at_most(f"M₃/M₃* at t = {t:.0f}, started 10⁻⁶ from that M*", end[2], *reversed_)
    yield at_most("transverse momentum there", np.hypot(end[0], end[1]), *GONE)
    yield at_most("growth rate at the rotation it ends in", after, *BELOW_ZERO)
    yield at_most("largest transverse growth rate of random diagonal D", largest, *BELOW_ZERO)


def about_axis_2(d3: float, d1: float, d13: float) -> np.ndarray:
    return np.array([[d1, 0.0, d13], [0.0, 0.0, 0.0], [d13, 0.0, d3]])


@claim("C20")
def intermediate_axis(
    seed: int = 5, cases: int = CASES, inertia: Sequence[float] = INERTIA, size: float = 1.0
) -> Evidence:
    """inertia, in ascending order, size = |M*| : of the rotation damped by diag(d, 0, d)."""
    M = size * np.eye(3)[1]
    a = 1 / np.asarray(inertia)
    coupling = size**2 * (a[1] - a[2]) * (a[0] - a[1])

    def rate(square: float) -> float:
        return growth(about_axis_2(np.sqrt(square), np.sqrt(square), 0.0), M, inertia)

    edge = scipy.optimize.brentq(rate, coupling / 10, 10 * coupling, xtol=1e-15)
    # full transverse blocks that the product d₁ d₃ alone would misjudge
    saddle, calm = (growth(about_axis_2(*d), np.eye(3)[1]) for d in ((0.5, 0.5, 0.5), (0.2, 0.29, -0.2)))
    border = "|d² / (|M*|² (1/I₂ − 1/I₃)(1/I₁ − 1/I₂)) − 1| at the border for D = diag(d, 0, d)"
    exact = 1e-10, "round-off of the eigenvalues, over their slope"
    beyond = "growth rate, D = diag(d, 0, d) with d² three times the border"
    yield at_least(beyond, rate(3 * coupling), *EIGENVALUES)
    yield CORRECTED
    yield contradicted_cases(random_equilibria((1,), cases, seed))
    yield at_most(border, abs(edge / coupling - 1), *exact)
    yield at_least("growth rate at d₁ = d₃ = d₁₃ = ½, I = (1, 2, 3), |M*| = 1", saddle, *EIGENVALUES)
    yield at_most("growth rate at d₁ = 0.29, d₃ = 0.2, d₁₃ = −0.2", calm, *BELOW_ZERO)


def along_kernel(kernel: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return M at t = 80 and 8000, damped by 1 − uuᵀ with `kernel` along u; and u."""
    u = np.asarray(kernel) / np.linalg.norm(kernel)
    scene = body(np.eye(3) - np.outer(u, u))
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
    damped_away = 1e-2, "what decays at the damping rates is gone"
    after = "‖M(t)‖/‖M(0)‖ after 80 damping times, D = diag(0, 1, 1), D M(0) ≠ 0"
    slowest = SLOWEST[0], f"along ker D ‖M‖' = −c‖M‖³, hence {SLOWEST[1]}"
    yield at_most(after, np.linalg.norm(left), *damped_away)
    yield CORRECTED
    yield at_least("|M₁|/‖M(0)‖ then", abs(left[0]), 1e-2, "far above what a decaying component leaves")
    yield at_most("what is left across axis 1", np.hypot(left[1], left[2]), *GONE)
    yield at_most("‖M(8000)‖/‖M(80)‖ where ker D holds no principal axis", sizes[1] / sizes[0], *slowest)


@claim("C40")
def modes(kernel: Sequence[float] = (1.0, 2.0, 0.0), rate: float = 0.5) -> Evidence:
    """kernel : a direction that is no principal axis.  rate : about axis 3, below twice the frequency at e₁."""
    M, u = along_kernel(kernel)
    along = np.abs(M @ u)
    off = np.linalg.norm(M - np.outer(M @ u, u), axis=1)
    damped = growth(np.diag([0.0, 0.0, rate]), np.eye(3)[0])
    undamped = growth(COUNTEREXAMPLE, np.eye(3)[2])
    fell, slaved = along[1] / along[0], off[1] / off[0]
    second_order = 0.1, "M × Ω, of second order, keeps it: 1/t, up to terms of third order at t = 80"
    yield at_most("growth rate off ker D at e₃, D of C19", undamped, *BELOW_ZERO)
    yield at_most("|damping rate| of δM = e₂ in ker D at e₁, D = diag(0, 0, d)", abs(damped), *EIGENVALUES)
    yield CORRECTED
    yield at_most("|damping rate/(d/2) − 1| of that mode", abs(-damped / (rate / 2) - 1), *EIGENVALUES)
    yield at_most("component of M along ker D at t = 8000 over that at 80", fell, *SLOWEST)
    square = "|the same off ker D over the square of this − 1|"
    yield at_most(square, abs(slaved / fell**2 - 1), *second_order)
