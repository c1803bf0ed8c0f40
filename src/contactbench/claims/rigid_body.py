"""Claims about the damped rigid body: its equations, momentum map, energy and equilibria (§4 of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.claims.calculus import IDENTITY, ROUND_OFF, SEED, contact_field, largest, pack, points
from contactbench.claims.ledger import CORRECTED, Evidence, at_least, at_most, claim
from contactbench.methods import solve
from contactbench.scene import BodyState, RigidBody, cross, quaternion_product
from contactbench.scenes import SCENES
from contactbench.truth import reference
from contactbench.xla import jax, jnp

BODY = SCENES["rigid_body"]
INERTIA = (1.0, 2.0, 3.0)
EIGENVALUES = 1e-12, "round-off of the eigenvalues of a 3×3 matrix of size one"


def chart(y: Any) -> Any:
    """Return the coordinates (θ, M, s) of T*SO(3) × R: the attitude is the rotation by the vector θ ≠ 0."""
    theta = y[:3]
    angle = jnp.sqrt(theta @ theta)
    axis = jnp.sin(angle / 2) * theta / angle
    return BodyState(tuple(y[3:6]), (jnp.cos(angle / 2), *axis), y[6])


def momentum_rate(scene: RigidBody) -> Any:
    """Return M' as a function of M, by the scene's right-hand side."""
    return lambda M: pack(scene.rhs(BodyState(tuple(M))))


@claim("C15")
def body_equations(seed: int = SEED, **changes: Any) -> Evidence:
    scene = BODY.with_(**changes)

    def form(y):
        def on(v):
            return scene.contact_form(*jax.jvp(chart, (y,), (v,)))

        return jax.grad(on)(jnp.zeros(7))

    def defect(y):
        """Return X_H from its definition in a chart of T*SO(3) × R, against the equations."""
        X = contact_field(form, lambda y: scene.hamiltonian(chart(y)), y)
        return pack(jax.jvp(chart, (y,), (X,))[1]) - pack(scene.rhs(chart(y)))

    off = largest(defect, points(7, seed=seed))
    rounding = 10 * ROUND_OFF, "round-off of AD through a chart whose metric is conditioned up to 10"
    yield at_most("max |X_H by definition − equations| at random (R, M, s)", off, *rounding)


@claim("C16")
def body_momentum_map(seed: int = SEED, **changes: Any) -> Evidence:
    scene = BODY.with_(**changes)

    def momentum_map(y):
        """Return J_ξ = −ι_ξ η for the rotations ξ = e_i in space."""
        x = chart(y)

        def component(axis):
            def rotated(angle):
                half = angle / 2
                return quaternion_product((jnp.cos(half), *(jnp.sin(half) * c for c in axis)), x.R)

            dR = jax.jvp(rotated, (0.0,), (1.0,))[1]
            return -scene.contact_form(x, BodyState((0.0,) * 3, dR, 0.0))

        return jnp.stack([component(axis) for axis in np.eye(3)])

    def against(candidate):
        return largest(lambda y: momentum_map(y) - jnp.stack(candidate(chart(y))), points(7, seed=seed))

    yield at_most("max |J_ξ − M·ξ| at random (R, M), J_ξ = −ι_ξ η", against(lambda x: x.M), *IDENTITY)
    yield CORRECTED
    yield at_most("max |J_ξ − (R M)·ξ|, the suite's momentum map", against(scene.momentum), *IDENTITY)


@claim("C17")
def body_energy(**changes: Any) -> Evidence:
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


#: kinds of symmetric D ≥ 0, D ≠ 0, in turn
DAMPINGS = (
    "of full rank",
    "with an axis in its kernel",
    "with two axes in its kernel",
    "with a separatrix plane for its kernel",
    "with any line for its kernel",
    "with any plane for its kernel",
)
SLOW = 2  #: of these, in which nothing is on an axis: M falls as t^{−1/2}


def damping_of_kind(rng: np.random.Generator, kind: int, inertia: Any) -> np.ndarray:
    """Return a random D of `DAMPINGS`."""
    rates, a = rng.uniform(0.5, 1, 3), 1 / np.asarray(inertia)
    if kind == 3:
        normal = np.sqrt([a[0] - a[1], 0.0, a[1] - a[2]]) * [1, 1, rng.choice([-1, 1])]
        return rates[0] * np.outer(normal, normal) / (normal @ normal)
    D = np.diag(rates * (rng.permutation(3) >= kind % 3))
    if kind < 3:
        return D
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turned = turn @ D @ turn.T
    return (turned + turned.T) / 2  # symmetric to the last bit


def residual(M: Any, inertia: Any, D: Any) -> np.ndarray:
    """Return M × I⁻¹M − D M for any matrix D, symmetric or not (§4.5, eq. (74))."""
    return np.array(cross(M, M / np.asarray(inertia))) - D @ M


def equilibria(D: np.ndarray, inertia: Any, rng: np.random.Generator) -> list[np.ndarray]:
    """Return the nonzero solutions of M × I⁻¹M = D M from random starts, by least squares on residual/‖M‖²."""
    found = []
    for start in rng.normal(size=(12, 3)):
        fit = scipy.optimize.least_squares(
            lambda M: np.append(residual(M, inertia, D) / (M @ M), 0.0),
            start,
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
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


def direction_growths(scene: Any) -> np.ndarray:
    """Return the growth rates of the direction M/‖M‖ across each axis of the isotropic body at ‖M‖ = 1; (3,).

    ‖M‖ decays with γ, so γ is added to the growth rate of M across the axis.
    """
    matrices = [np.asarray(jax.jacfwd(momentum_rate(scene))(jnp.asarray(e))) for e in np.eye(3)]
    transverse = [np.delete(np.delete(A, i, 0), i, 1) for i, A in enumerate(matrices)]
    return np.array([np.linalg.eigvals(A).real.max() for A in transverse]) + scene.gamma


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


def motions(D: np.ndarray, M: np.ndarray, inertia: Any, h: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Return M at t = 2000 and 4000 of many bodies, by RK4: D (k, 3, 3), M (k, 3) → (k, 3) twice."""
    a = 1 / np.asarray(inertia)

    def later(D: Any, M: Any) -> Any:
        f = lambda M: jnp.cross(M, a * M) - D @ M  # noqa: E731

        def step(_: Any, M: Any) -> Any:
            k1 = f(M)
            k2 = f(M + h / 2 * k1)
            k3 = f(M + h / 2 * k2)
            return M + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(M + h * k3))

        return jax.lax.fori_loop(0, round(2000 / h), step, M)

    advance = jax.jit(jax.vmap(later))
    half = advance(D, M)
    return np.asarray(half), np.asarray(advance(D, half))


def distance_to_equilibria(M: np.ndarray, D: np.ndarray) -> float:
    """Return the distance of M from 0 and from the principal axes in ker D."""
    lines = [np.linalg.norm(np.delete(M, i)) for i in range(3) if np.linalg.norm(D[:, i]) < ROUND_OFF]
    return float(min([np.linalg.norm(M), *lines]))


@claim("C41")
def motions_settle(seed: int = SEED, starts: int = 1200, inertia: Sequence[float] = INERTIA) -> Evidence:
    """starts : a multiple of six.  inertia : in ascending order."""
    rng, kinds = np.random.default_rng(seed), len(DAMPINGS)
    D = np.array([damping_of_kind(rng, n % kinds, inertia) for n in range(starts)])
    M = rng.normal(size=(starts, 3))
    M /= np.linalg.norm(M, axis=1)[:, None]
    half, end = motions(D, M, inertia)
    bare = np.arange(starts) % kinds >= kinds - SLOW
    left = [distance_to_equilibria(m, d) for m, d in zip(end[~bare], D[~bare], strict=True)]
    free = [(m**2).sum(axis=1) for m in motions(0 * D[:60], M[:60], inertia)]
    own = abs(1 / free[1] - 1 / free[0]).max()
    growth = (1 / (end[bare] ** 2).sum(axis=1) - 1 / (half[bare] ** 2).sum(axis=1)).min()
    rise = -np.einsum("ki,i,kij,kj->k", M, 1 / np.asarray(inertia), D, M)
    slowest = 0.05, "t^{−1/2} = 0.016, the slowest there is, times a constant of three"
    above_error = 10 * own, "ten times what rk4's own error does without damping"
    farthest = f"farthest from the set at t = 4000 of {len(left)} motions, ‖M(0)‖ = 1"
    falls = f"growth of 1/‖M‖² from t = 2000 to 4000, least of {bare.sum()} motions"
    yield at_most(f"{farthest}, D {', '.join(DAMPINGS[:-SLOW])}", max(left), *slowest)
    yield at_least(f"{falls}, D {' or '.join(DAMPINGS[-SLOW:])}", growth, *above_error)
    yield CORRECTED
    yield at_most("largest M·M' at random M", -np.einsum("ki,kij,kj->k", M, D, M).min(), *IDENTITY)
    yield at_least("largest H0' there", rise.max(), 1e-2, "H0 rises")
