"""Claims about the equilibria and relative equilibria of the damped body (§4.3 and §4.5 of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.claims.calculus import IDENTITY, ROUND_OFF, SEED, largest, points
from contactbench.claims.ledger import Evidence, at_least, at_most, claim
from contactbench.claims.linearisation import EIGENVALUES, INERTIA, body, momentum_rate, random_damping
from contactbench.scene import cross
from contactbench.scenes import SCENES
from contactbench.truth import reference
from contactbench.xla import jax, jnp

BODY = "rigid_body"
STARTS = 12


def equation(inertia: Any, D: Any) -> Any:
    """Return M × I⁻¹M − D M for any matrix D, symmetric or not (§4.5, eq. (74))."""
    return lambda M: np.array(cross(M, M / np.asarray(inertia))) - D @ M


def distance_from_set(M: np.ndarray, D: np.ndarray) -> float:
    """Return how far M is from {D M = 0, M ∥ a principal axis}, relative to its size."""
    u = M / np.linalg.norm(M)
    return float(max(np.linalg.norm(D @ u), np.sqrt(max(0.0, 1 - np.max(u * u)))))


def equilibria(D: np.ndarray, inertia: Any, rng: np.random.Generator) -> list[np.ndarray]:
    """Return the nonzero solutions of M × I⁻¹M = D M found from random starts, by least squares on residual/‖M‖²."""
    f = equation(inertia, D)
    found = []
    for _ in range(STARTS):
        start = rng.normal(size=3)
        fit = scipy.optimize.least_squares(
            lambda M: np.append(f(M) / (M @ M), 0.0), start, xtol=1e-15, ftol=1e-15, gtol=1e-15
        )
        size = np.linalg.norm(fit.x)
        if np.linalg.norm(f(fit.x)) < 1e-12 * size * size and 1e-3 < size < 1e3:
            found.append(fit.x)
    return found


def turn_at_random(D: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return D in a random basis, symmetric to the last bit."""
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    D = turn @ D @ turn.T
    return (D + D.T) / 2


def any_damping(rng: np.random.Generator, number: int) -> np.ndarray:
    """Return a symmetric D ≥ 0: in turn diagonal, full with an axis in its kernel, and in any direction."""
    rank = number // 3 % 3 + 1
    if number % 3 == 1:
        return random_damping(rng, min(rank, 2), int(rng.integers(3)))
    D = np.diag(rng.permutation([*rng.uniform(0.1, 1, rank), 0, 0, 0][:3]))
    return D if number % 3 == 0 else turn_at_random(D, rng)


@claim("C18")
def equilibrium_set(seed: int = 3, cases: int = 27, inertia: Sequence[float] = INERTIA) -> Evidence:
    rng = np.random.default_rng(seed)
    distances, count = [0.0], 0
    for number in range(cases):
        D = any_damping(rng, number)
        found = equilibria(D, inertia, rng)
        distances += [distance_from_set(M, D) for M in found]
        count += len(found)
    damped = body(any_damping(rng, 5), inertia)
    u = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    a = -np.array([1.0, -1.0, 0.0]) / np.sqrt(2) / 4
    skew = np.eye(3) - np.outer(u, u) + np.cross(np.eye(3), -a).T  # columns e_i × (−a) = a × e_i

    def power(M):
        damping = damped.damp_matrix_function(tuple(M), lambda rate: rate)
        return M @ momentum_rate(damped)(M) + M @ jnp.stack(damping)

    work, residual = largest(power, points(3, seed=seed)), np.abs(equation(INERTIA, skew)(u)).max()
    lowest = np.linalg.eigvalsh((skew + skew.T) / 2).min()
    solved = 1e-5, "square root of the solver's 10⁻¹², since the residual may vanish quadratically, times 10"
    enough = 10, "the search must find something to be worth anything"
    apart, zero = (1e-2, "far above the residual of the equilibrium"), (-ROUND_OFF, "zero up to round-off")
    farthest = f"farthest of the equilibria found from the set, {cases} symmetric D of rank 1, 2, 3"
    beside = "distance from the set of an equilibrium of a D that is not symmetric"
    statement = [
        at_most(farthest, max(distances), *solved),
        at_least("equilibria found, all M ≠ 0", count, *enough),
        at_most("max |M·M' + M·DM|, which makes M·DM = 0 necessary, a full D", work, *IDENTITY),
    ]
    corrected = [
        at_least(beside, distance_from_set(u, skew), *apart),
        at_most("its residual |M × I⁻¹M − DM|, I = (1, 2, 3)", residual, *IDENTITY),
        at_least("smallest eigenvalue of the symmetric part of that D", lowest, *zero),
    ]
    return Evidence(statement, corrected)


@claim("C22")
def relative_equilibria(gamma: float = 0.1, inertia: Sequence[float] = INERTIA) -> Evidence:
    """inertia : in ascending order."""
    scene = SCENES[BODY].with_(gamma=gamma, inertia=tuple(inertia))
    rate = momentum_rate(scene)
    axes = [s * e for e in np.eye(3) for s in (1.0, -1.0)]
    rates = [np.asarray(rate(M)) for M in axes]
    truth = reference(scene, np.linspace(0, scene.t_end, 201), ())
    shape = scene.energy(truth.states()) / (truth.y**2).sum(axis=1)
    turning = max(np.linalg.norm(np.cross(M, f)) for M, f in zip(axes, rates, strict=True))
    of_direction = direction_growths(scene)
    a = 1 / np.asarray(inertia)
    free = np.sqrt((a[1] - a[2]) * (a[0] - a[1]))
    change, outer = np.abs(shape / shape[0] - 1).max(), max(of_direction[0], of_direction[2])
    euler = 0.99 * free, "√((1/I₂ − 1/I₃)(1/I₁ − 1/I₂)) at ‖M‖ = 1, Euler's equations, less one per cent"
    rounded = 1e-13, "the reference rounded to double precision"
    fastest = max(np.linalg.norm(f) for f in rates)
    statement = [at_most("max ‖M'‖ at the six unit momenta on the axes", fastest, *IDENTITY)]
    corrected = [
        at_most("max ‖M × M'‖ there: the direction stays", turning, *IDENTITY),
        at_most("growth rate of the direction near axes 1 and 3", outer, *EIGENVALUES),
        at_least("growth rate of the direction near axis 2", of_direction[1], *euler),
        at_most("max |(H0/‖M‖²)(t)/(H0/‖M‖²)(0) − 1| along the true body", change, *rounded),
    ]
    return Evidence(statement, corrected)


def direction_growths(scene: Any) -> np.ndarray:
    """Return the growth rates of the direction M/‖M‖ across each axis of the isotropic body at ‖M‖ = 1; (3,).

    ‖M‖ decays with γ, so γ is added to the growth rate of M across the axis.
    """
    matrices = [np.asarray(jax.jacfwd(momentum_rate(scene))(jnp.asarray(e))) for e in np.eye(3)]
    transverse = [np.delete(np.delete(A, i, 0), i, 1) for i, A in enumerate(matrices)]
    return np.array([np.linalg.eigvals(A).real.max() for A in transverse]) + scene.gamma


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
    return D if kind < 3 else turn_at_random(D, rng)


def motions(D: np.ndarray, M: np.ndarray, inertia: Any, t: float, saves: int, h: float = 0.1) -> np.ndarray:
    """Return M at `saves` equal times up to t of many bodies, by RK4: D (k, 3, 3), M (k, 3) → (k, saves, 3)."""
    a = 1 / np.asarray(inertia)

    def one(D: Any, M: Any) -> Any:
        f = lambda M: jnp.cross(M, a * M) - D @ M  # noqa: E731

        def step(_: Any, M: Any) -> Any:
            k1 = f(M)
            k2 = f(M + h / 2 * k1)
            k3 = f(M + h / 2 * k2)
            return M + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(M + h * k3))

        def save(M: Any, _: Any) -> Any:
            M = jax.lax.fori_loop(0, round(t / saves / h), step, M)
            return M, M

        return jax.lax.scan(save, M, None, length=saves)[1]

    return np.asarray(jax.jit(jax.vmap(one))(D, M))


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
    run = motions(D, M, inertia, 4000.0, 2)
    kind = np.arange(starts) % kinds
    left = np.array([distance_to_equilibria(end, d) for end, d in zip(run[:, -1], D, strict=True)])
    bare = kind >= kinds - SLOW
    size = (run[bare] ** 2).sum(axis=2)
    free = (motions(0 * D[:60], M[:60], inertia, 4000.0, 2) ** 2).sum(axis=2)
    own = abs(1 / free[:, 1] - 1 / free[:, 0]).max()
    rise = -np.einsum("ki,i,kij,kj->k", M, 1 / np.asarray(inertia), D, M)
    growth = (1 / size[:, 1] - 1 / size[:, 0]).min()
    slowest = 0.05, "t^{−1/2} = 0.016, the slowest there is, times a constant of three"
    above_error = 10 * own, "ten times what rk4's own error does without damping"
    farthest = f"farthest from the set at t = 4000 of {np.count_nonzero(~bare)} motions, ‖M(0)‖ = 1"
    falls = f"growth of 1/‖M‖² from t = 2000 to 4000, least of {len(size)} motions"
    statement = [
        at_most(f"{farthest}, D {', '.join(DAMPINGS[:-SLOW])}", left[~bare].max(), *slowest),
        at_least(f"{falls}, D {' or '.join(DAMPINGS[-SLOW:])}", growth, *above_error),
    ]
    corrected = [
        at_most("largest M·M' at random M", -np.einsum("ki,kij,kj->k", M, D, M).min(), *IDENTITY),
        at_least("largest H0' there", rise.max(), 1e-2, "H0 rises"),
        at_least("least ‖M(4000)‖ without damping", np.sqrt(free[:, 1].min()), 0.99, "it stays 1"),
    ]
    return Evidence(statement, corrected)
