"""Stability of the anisotropically damped body's steady rotations: spectrum and criterion.

Take a principal axis i in ker D and M* = m e_i, m of either sign, D symmetric ≥ 0.  Let a = 1/I and
(i, j, k) be a cyclic order of the axes.  M' = M × I⁻¹M − D M has the components

    M_j' = (a_i − a_k) M_k M_i − (D M)_j,    M_k' = (a_j − a_i) M_i M_j − (D M)_k.

D e_i = 0 and D = Dᵀ leave of D the block (d_jj, d_jk; d_jk, d_kk).  At M* the axis i has eigenvalue 0,
because m' e_i is an equilibrium for every m', and the transverse linearisation is

    A = ( −d_jj                     m (a_i − a_k) − d_jk )
        ( m (a_j − a_i) − d_jk      −d_kk                ),

    tr A  = −(d_jj + d_kk),
    det A = d_jj d_kk − d_jk² + m (a_j − a_k) d_jk + m² (a_i − a_j)(a_i − a_k).

tr A ≤ 0, and tr A = 0 only for D = 0.  So, off the border det A = 0: det A < 0 is a saddle; det A > 0 is
stable, asymptotically across the axis if D ≠ 0.  The last term of det A is positive for an extreme axis
and negative for the intermediate one: that is all the classical theorem sees.  The third term has
either sign and changes it with m: M* and −M* may differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from contactbench.claims.calculus import pack
from contactbench.scene import BodyState, RigidBody
from contactbench.scenes import SCENES
from contactbench.xla import jax

ANISOTROPIC = "rigid_body_anisotropic"
INERTIA = (1.0, 2.0, 3.0)
SPECTRUM = 1e-12
EIGENVALUES = SPECTRUM, "round-off of the eigenvalues of a 3×3 matrix of size one"
BELOW_ZERO = -SPECTRUM, EIGENVALUES[1]
RANKS = (0, 1, 2)  #: of a symmetric D ≥ 0 on R³ with a kernel
Case = tuple[np.ndarray, Any, np.ndarray]  #: (D, inertia, M*)


def momentum_rate(scene: RigidBody) -> Any:
    """Return M' as a function of M, by the scene's right-hand side."""
    return lambda M: pack(scene.rhs(BodyState(tuple(M))))


def body(D: Any, inertia: Sequence[float] = INERTIA) -> RigidBody:
    """Return the body damped by D: three rates about the principal axes, or a symmetric 3×3 matrix ≥ 0."""
    damping = tuple(map(tuple, D)) if np.ndim(D) == 2 else tuple(D)
    return SCENES[ANISOTROPIC].with_(damping=damping, inertia=tuple(inertia))


def scenes_and_momenta(cases: Sequence[Case]) -> tuple[list[RigidBody], list[np.ndarray]]:
    """Return the damped bodies of some cases, and their M*."""
    return [body(D, inertia) for D, inertia, _ in cases], [M for *_, M in cases]


def spectra(scenes: Sequence[RigidBody], momenta: Any) -> np.ndarray:
    """Return the eigenvalues of the full 3×3 linearisations, by AD of the right-hand side; complex, (k, 3)."""

    def linearisations(some: list[RigidBody], at: np.ndarray) -> np.ndarray:
        rate = lambda numbers, M: jax.jacfwd(momentum_rate(some[0].with_numbers(list(numbers))))(M)  # noqa: E731
        return np.asarray(jax.jit(jax.vmap(rate))(np.array([s.numbers() for s in some]), at))

    momenta = np.array(momenta, dtype=float)
    diagonal = np.array([scene.axes is None for scene in scenes])
    matrices = np.empty((len(scenes), 3, 3))
    for kind in np.unique(diagonal):  # two shapes of right-hand side
        mine = diagonal == kind
        matrices[mine] = linearisations([s for s, m in zip(scenes, mine, strict=True) if m], momenta[mine])
    return np.linalg.eigvals(matrices)


def across(values: np.ndarray) -> np.ndarray:
    """Return the two transverse eigenvalues at each of many equilibria: all but the one nearest 0; (k, 2)."""
    return np.take_along_axis(values, np.argsort(np.abs(values), axis=1)[:, 1:], axis=1)


def growths(scenes: Sequence[RigidBody], momenta: Any) -> np.ndarray:
    """Return the largest real part of the transverse eigenvalues at equilibria M* on a principal axis in ker D."""
    return across(spectra(scenes, momenta)).real.max(axis=1)


def growth(D: Any, M: Any, inertia: Sequence[float] = INERTIA) -> float:
    """Return the growth rate of one case."""
    return float(growths([body(D, inertia)], [M])[0])


def criterion(D: Any, M: Any, inertia: Sequence[float] = INERTIA) -> tuple[float, float]:
    """Return (tr A, det A) at M* = m e_i with D e_i = 0, by the formulas above."""
    D, a = np.asarray(D, dtype=float), 1 / np.asarray(inertia, dtype=float)
    i = int(np.argmax(np.abs(M)))
    j, k, m = (i + 1) % 3, (i + 2) % 3, float(M[i])
    block = D[j, j] * D[k, k] - D[j, k] ** 2
    determinant = block + m * (a[j] - a[k]) * D[j, k] + m * m * (a[i] - a[j]) * (a[i] - a[k])
    return -float(D[j, j] + D[k, k]), float(determinant)


def border(inertia: Sequence[float], axis: int, size: float, common: Any) -> tuple[Any, Any]:
    """Return the two d_jk at which det A = 0, for d_jj = d_kk = `common`."""
    a = 1 / np.asarray(inertia, dtype=float)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    slope = size * (a[j] - a[k])
    constant = common**2 + size * size * (a[axis] - a[j]) * (a[axis] - a[k])
    root = np.sqrt(slope**2 / 4 + constant)
    return slope / 2 - root, slope / 2 + root


def random_damping(rng: np.random.Generator, rank: int, axis: int) -> np.ndarray:
    """Draw a symmetric D ≥ 0 of rank 0, 1 or 2 with D e_axis = 0 and a full transverse block."""
    D = np.zeros((3, 3))
    for _ in range(rank):
        column = rng.normal(size=3) * rng.uniform(0.2, 1.0)
        column[axis] = 0.0
        D += np.outer(column, column)
    return D


def random_inertia(rng: np.random.Generator) -> tuple[float, ...]:
    """Draw three moments in ascending order, those a body can have (I₁ + I₂ ≥ I₃) and others."""
    return tuple(np.sort(rng.uniform(0.5, 3.0, 3)).tolist())


def random_equilibria(axes: Sequence[int], cases: int, seed: int) -> list[Case]:
    """Draw (D, inertia, M*) with M* ≠ 0 on one of `axes` in ker D; every rank of D and both signs of M*."""
    rng, found = np.random.default_rng(seed), []
    for number in range(cases):
        axis = axes[number % len(axes)]
        M = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 2.0) * np.eye(3)[axis]
        found.append((random_damping(rng, RANKS[number // len(axes) % 3], axis), random_inertia(rng), M))
    return found


def count_misjudged(cases: Sequence[Case], slack: float) -> int:
    """Count the cases that the signs of tr A and det A judge otherwise than the full 3×3 spectrum does.

    slack : an eigenvalue or its product this close to 0 counts as 0.
    """
    values = across(spectra(*scenes_and_momenta(cases)))
    wrong = 0
    for (D, inertia, M), pair in zip(cases, values, strict=True):
        trace, determinant = criterion(D, M, inertia)
        says = -1 if determinant < -slack else 0 if determinant < slack or trace > -slack else 1
        rates = np.sort(pair.real)
        is_ = -1 if rates[1] > slack and rates[0] < -slack else 1 if rates[1] < -slack else 0
        wrong += says != is_
    return wrong
