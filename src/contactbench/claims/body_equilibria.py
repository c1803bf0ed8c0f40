"""Claims about the equilibria and relative equilibria of the damped body (§4.3 and §4.5 of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.claims.calculus import IDENTITY, ROUND_OFF, largest, points
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
