"""Claims about the equilibria and relative equilibria of the damped body (§4.3 and §4.5 of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.claims.calculus import IDENTITY, ROUND_OFF, SEED, largest, points
from contactbench.claims.ledger import Correction, Evidence, at_least, at_most, claim
from contactbench.claims.linearisation import EIGENVALUES, INERTIA, body, momentum_rate, random_damping
from contactbench.scene import cross
from contactbench.scenes import SCENES
from contactbench.truth import reference
from contactbench.xla import jax, jnp

BODY = "rigid_body"
STARTS = 12


def equation(inertia: Any, D: Any) -> Any:
    """M × I⁻¹M − D M for any matrix D, symmetric or not (§4.5, eq. (74))."""
    return lambda M: np.array(cross(M, M / np.asarray(inertia))) - D @ M


def distance_from_set(M: np.ndarray, D: np.ndarray) -> float:
    """How far M is from {D M = 0, M ∥ a principal axis}, relative to its size."""
    u = M / np.linalg.norm(M)
    return float(max(np.linalg.norm(D @ u), np.sqrt(max(0.0, 1 - np.max(u * u)))))


def equilibria(D: np.ndarray, inertia: Any, rng: np.random.Generator) -> list[np.ndarray]:
    """Nonzero solutions of M × I⁻¹M = D M found from random starts, by least squares on residual/‖M‖²."""
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


def any_damping(rng: np.random.Generator, number: int) -> np.ndarray:
    """A symmetric D ≥ 0: in turn diagonal, full with an axis in its kernel, and turned anyhow."""
    rank = number // 3 % 3 + 1
    if number % 3 == 1:
        return random_damping(rng, min(rank, 2), int(rng.integers(3)))
    D = np.diag(rng.permutation([*rng.uniform(0.1, 1, rank), 0, 0, 0][:3]))
    turn = np.eye(3) if number % 3 == 0 else np.linalg.qr(rng.normal(size=(3, 3)))[0]
    D = turn @ D @ turn.T
    return (D + D.T) / 2


@claim(
    "C18",
    "§4.5, eq. (75), and §4.6.1, eq. (77)",
    "The equilibria under a positive-semidefinite D are 0 and the M on a principal axis with DM = 0.",
    kind=Correction.extends,
    scene="M' = M × I⁻¹M − DM, I = (1, 2, 3), random D",
    method="none: least squares from random starts",
    correction="Positive-semidefinite has to include symmetric: then M·DM = 0, which every equilibrium obeys, "
    "forces DM = 0. With D = S + Â, S symmetric ≥ 0 and Â antisymmetric, M·DM = M·SM ≥ 0 still, but S M = 0 "
    "leaves M × Ω = Â M to balance off the axes: S = 1 − uuᵀ, u = (1, 1, 0)/√2, Â = a×, a = −(1, −1, "
    "0)/(4√2) has the equilibrium M = u.",
)
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
    work = largest(
        lambda M: (
            M @ momentum_rate(damped)(M)
            + M @ jnp.stack(damped.damp_matrix_function(tuple(M), lambda rate: rate))
        ),
        points(3, seed=seed),
    )
    statement = [
        at_most(
            f"farthest of the equilibria found from the set, {cases} symmetric D of rank 1, 2, 3",
            max(distances),
            1e-5,
            "square root of the solver's 10⁻¹², since the residual may vanish quadratically, times 10",
        ),
        at_least(
            "equilibria found, all M ≠ 0", count, 10, "the search must find something to be worth anything"
        ),
        at_most("max |M·M' + M·DM|, which makes M·DM = 0 necessary, a full D", work, *IDENTITY),
    ]
    corrected = [
        at_least(
            "distance from the set of an equilibrium of a D that is not symmetric",
            distance_from_set(u, skew),
            1e-2,
            "far above the residual of the equilibrium",
        ),
        at_most(
            "its residual |M × I⁻¹M − DM|, I = (1, 2, 3)", np.abs(equation(INERTIA, skew)(u)).max(), *IDENTITY
        ),
        at_least(
            "smallest eigenvalue of the symmetric part of that D",
            np.linalg.eigvalsh((skew + skew.T) / 2).min(),
            -ROUND_OFF,
            "zero up to round-off",
        ),
    ]
    return Evidence(statement, corrected)


@claim(
    "C22",
    "§4.3, Figure 4, and §4.6.1, Figure 5",
    "With isotropic damping the equilibria lie on all principal axes of the momentum sphere, the outer two "
    "stable, the middle one unstable.",
    kind=Correction.repairs,
    correction="With γ > 0 the only equilibrium is M = 0. The axes are relative equilibria: the direction "
    "M/‖M‖ stays while ‖M‖ decays as e^{−γt}. In the damped time τ = (1 − e^{−γt})/γ directions "
    "near axes 1 and 3 turn about them, near axis 2 they leave (until τ runs out at 1/γ). They "
    "do not migrate to a stable axis, contrary to the caption of Figure 4: H0/‖M‖² is constant, so "
    "the direction stays on the polhode of the free body.",
    scene=BODY,
    figures=("paper_4", "paper_5"),
)
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
    statement = [
        at_most(
            "max ‖M'‖ at the six unit momenta on the axes", max(np.linalg.norm(f) for f in rates), *IDENTITY
        )
    ]
    corrected = [
        at_most("max ‖M × M'‖ there: the direction stays", turning, *IDENTITY),
        at_most(
            "growth rate of the direction near axes 1 and 3",
            max(of_direction[0], of_direction[2]),
            *EIGENVALUES,
        ),
        at_least(
            "growth rate of the direction near axis 2",
            of_direction[1],
            0.99 * free,
            "√((1/I₂ − 1/I₃)(1/I₁ − 1/I₂)) at ‖M‖ = 1, Euler's equations, less one per cent",
        ),
        at_most(
            "max |(H0/‖M‖²)(t)/(H0/‖M‖²)(0) − 1| along the true body",
            np.abs(shape / shape[0] - 1).max(),
            1e-13,
            "the reference rounded to double precision",
        ),
    ]
    return Evidence(statement, corrected)


def direction_growths(scene: Any) -> np.ndarray:
    """Growth rates of the direction M/‖M‖ across each axis of the isotropic body at ‖M‖ = 1; (3,).

    ‖M‖ decays with γ, so γ is added to the growth rate of M across the axis.
    """

    matrices = [np.asarray(jax.jacfwd(momentum_rate(scene))(jnp.asarray(e))) for e in np.eye(3)]
    transverse = [np.delete(np.delete(A, i, 0), i, 1) for i, A in enumerate(matrices)]
    return np.array([np.linalg.eigvals(A).real.max() for A in transverse]) + scene.gamma


#: kinds of symmetric D ≥ 0, D ≠ 0, in turn
DAMPINGS = ("of full rank", "with an axis in its kernel", "with two axes in its kernel",
            "with a separatrix plane for its kernel", "with any line for its kernel",
            "with any plane for its kernel")  # fmt: skip
SLOW = 2  #: of these, in which nothing is on an axis: M falls as t^{−1/2}


def damping_of_kind(rng: np.random.Generator, kind: int, inertia: Any) -> np.ndarray:
    """A random D of `DAMPINGS`."""
    rates, a = rng.uniform(0.5, 1, 3), 1 / np.asarray(inertia)
    if kind == 3:
        normal = np.sqrt([a[0] - a[1], 0.0, a[1] - a[2]]) * [1, 1, rng.choice([-1, 1])]
        return rates[0] * np.outer(normal, normal) / (normal @ normal)
    kept = np.diag(rates * (rng.permutation(3) >= (kind if kind < 3 else kind - 3)))
    turn = np.eye(3) if kind < 3 else np.linalg.qr(rng.normal(size=(3, 3)))[0]
    D = turn @ kept @ turn.T
    return (D + D.T) / 2


def motions(D: np.ndarray, M: np.ndarray, inertia: Any, t: float, saves: int, h: float = 0.1) -> np.ndarray:
    """M at `saves` equal times up to t of many bodies, by RK4: D (k, 3, 3), M (k, 3) → (k, saves, 3)."""
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
    """Distance of M from 0 and from the principal axes in ker D."""
    lines = [np.linalg.norm(np.delete(M, i)) for i in range(3) if np.linalg.norm(D[:, i]) < ROUND_OFF]
    return float(min([np.linalg.norm(M), *lines]))


@claim(
    "C41",
    "§4.6.1, after eq. (77)",
    "All motions decay toward the set of 0 and the principal-axis rotations in ker D.",
    kind=Correction.extends,
    correction="For symmetric D ≥ 0 with D ≠ 0 (without damping nothing decays; for D that is not symmetric see "
    "C18). By LaSalle's principle with ‖M‖², whose derivative is −2 M·DM: what stays in ker D is an equilibrium, or, "
    "if ker D is a plane of separatrices, runs into one. H0 is no such function: H0' = −Ω·DM may be positive where D "
    "and I do not commute. The decay need not be exponential: as t^{−1/2} where ker D holds no principal axis (C21).",
    scene="M' = M × I⁻¹M − DM, I = (1, 2, 3), 1200 random starts, six kinds of symmetric D",
    method="rk4, h = 0.1, T = 4000",
)
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
    statement = [
        at_most(
            f"farthest from the set at t = 4000 of {np.count_nonzero(~bare)} motions, ‖M(0)‖ = 1, D "
            + ", ".join(DAMPINGS[:-SLOW]),
            left[~bare].max(), 0.05, "t^{−1/2} = 0.016, the slowest there is, times a constant of three",
        ),
        at_least(
            f"growth of 1/‖M‖² from t = 2000 to 4000, least of {len(size)} motions, D " + " or ".join(DAMPINGS[-SLOW:]),
            (1 / size[:, 1] - 1 / size[:, 0]).min(), 10 * own, "ten times what rk4's own error does without damping",
        ),
    ]  # fmt: skip
    corrected = [
        at_most("largest M·M' at random M", -np.einsum("ki,kij,kj->k", M, D, M).min(), *IDENTITY),
        at_least("largest H0' there", rise.max(), 1e-2, "H0 rises"),
        at_least("least ‖M(4000)‖ without damping", np.sqrt(free[:, 1].min()), 0.99, "it stays 1"),
    ]  # fmt: skip
    return Evidence(statement, corrected)
