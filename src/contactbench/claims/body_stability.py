"""Claims about the stability of the damped body's steady rotations (§4.6 of the paper).

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
import scipy  # its parts are loaded when first used

from contactbench.claims.ledger import CORRECTED, Evidence, Measurement, at_least, at_most, claim
from contactbench.claims.rigid_body import EIGENVALUES, INERTIA, momentum_rate, random_damping
from contactbench.methods import solve
from contactbench.scene import RigidBody
from contactbench.scenes import SCENES
from contactbench.xla import jax

Case = tuple[Any, Sequence[float], Any]  #: (D, inertia, M*), M* on a principal axis in ker D
BELOW_ZERO = -EIGENVALUES[0], EIGENVALUES[1]
CASES = 300
GONE = 1e-9, "10³ times the tolerance 10⁻¹² of the solver"
STAYS = 1e-2, "far above what a decaying component leaves"
SLOWEST = 0.15, "t^{−1/2}: 0.1, and half as much again for the transient"


# -- spectra ---------------------------------------------------------------------------------------
def body(D: Any, inertia: Sequence[float] = INERTIA) -> RigidBody:
    """Return the body damped by D: three rates about the principal axes, or a symmetric 3×3 matrix ≥ 0."""
    damping = tuple(map(tuple, D)) if np.ndim(D) == 2 else tuple(D)
    return SCENES["rigid_body_anisotropic"].with_(damping=damping, inertia=tuple(inertia))


def transverse(cases: Sequence[Case]) -> np.ndarray:
    """Return the two transverse eigenvalues at each of many equilibria: all but the one nearest 0; (k, 2)."""
    scenes = [body(D, inertia) for D, inertia, _ in cases]
    momenta = np.array([M for *_, M in cases], dtype=float)
    diagonal = np.array([scene.axes is None for scene in scenes])
    matrices = np.empty((len(scenes), 3, 3))
    for kind in np.unique(diagonal):  # two shapes of right-hand side
        mine = np.flatnonzero(diagonal == kind)
        first = scenes[mine[0]]
        linearise = lambda numbers, M: jax.jacfwd(momentum_rate(first.with_numbers(list(numbers))))(M)  # noqa: B023, E731
        numbers = np.array([scenes[k].numbers() for k in mine])
        matrices[mine] = jax.jit(jax.vmap(linearise))(numbers, momenta[mine])
    values = np.linalg.eigvals(matrices)
    return np.take_along_axis(values, np.argsort(np.abs(values), axis=1)[:, 1:], axis=1)


def growths(cases: Sequence[Case]) -> np.ndarray:
    return transverse(cases).real.max(axis=1)


def growth(D: Any, M: Any, inertia: Sequence[float] = INERTIA) -> float:
    return float(growths([(D, inertia, M)])[0])


def criterion(D: Any, M: Any, inertia: Sequence[float] = INERTIA) -> tuple[float, float]:
    """Return (tr A, det A) at M* = m e_i with D e_i = 0, by the formulas above."""
    D, a = np.asarray(D, dtype=float), 1 / np.asarray(inertia, dtype=float)
    i = int(np.argmax(np.abs(M)))
    j, k, m = (i + 1) % 3, (i + 2) % 3, float(M[i])
    block = D[j, j] * D[k, k] - D[j, k] ** 2
    determinant = block + m * (a[j] - a[k]) * D[j, k] + m * m * (a[i] - a[j]) * (a[i] - a[k])
    return -float(D[j, j] + D[k, k]), float(determinant)


# -- the criterion against the spectrum ------------------------------------------------------------
def random_equilibria(axes: Sequence[int], cases: int, seed: int) -> list[Case]:
    """Draw cases with M* on one of `axes`; rank 0, 1, 2 of D in turn, both signs of M*."""
    rng = np.random.default_rng(seed)
    found: list[Case] = []
    for number in range(cases):
        axis = axes[number % len(axes)]
        M = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 2.0) * np.eye(3)[axis]
        D = random_damping(rng, number // len(axes) % 3, axis)
        inertia = np.sort(
            rng.uniform(0.5, 3.0, 3)
        ).tolist()  # those a body can have (I₁ + I₂ ≥ I₃) and others
        found.append((D, inertia, M))
    return found


def count_misjudged(cases: Sequence[Case], slack: float = 1e-9) -> int:
    """Count the cases that the signs of tr A and det A judge otherwise than the full 3×3 spectrum does.

    slack : an eigenvalue or its product this close to 0 counts as 0.
    """
    wrong = 0
    for (D, inertia, M), (lower, upper) in zip(cases, np.sort(transverse(cases).real), strict=True):
        trace, determinant = criterion(D, M, inertia)
        says = -1 if determinant < -slack else 0 if determinant < slack or trace > -slack else 1
        is_ = -1 if upper > slack and lower < -slack else 1 if upper < -slack else 0
        wrong += says != is_
    return wrong


def judge_criterion(cases: Sequence[Case]) -> Measurement:
    """Compare the criterion with the full spectrum."""
    drawn = f"{len(cases)} random (I, D, M*), symmetric D ≥ 0 of rank 0, 1, 2 with D M* = 0"
    contradicted = f"cases of {drawn}, whose 3×3 spectrum contradicts the criterion"
    return at_most(contradicted, count_misjudged(cases), 0, "a criterion has none")


# -- the stability theorem -------------------------------------------------------------------------
#: at e₃, D pushes along the transverse diagonal on which the gyroscopic coupling does not resist
COUNTEREXAMPLE = ((0.5, -0.5, 0.0), (-0.5, 0.5, 0.0), (0.0, 0.0, 0.0))


def momentum_at(D: Any, M: Any, t: float, inertia: Sequence[float] = INERTIA) -> np.ndarray:
    scene = body(D, inertia).with_(M=tuple(float(m) for m in M), t_end=t)
    return solve(scene, "scipy-dop853", rtol=1e-12, save_at=[t], carry=()).y[-1]


@claim("C19")
def extreme_axes(seed: int = 4, cases: int = CASES) -> Evidence:
    rate = growth(COUNTEREXAMPLE, [0.0, 0.0, 1.0])
    t = 50 / max(rate, 0.01)
    end = momentum_at(COUNTEREXAMPLE, [1e-6, 1e-6, 1.0], t)
    after = growth(COUNTEREXAMPLE, [0.0, 0.0, end[2]])
    drawn = random_equilibria((0, 2), cases, seed)
    largest = growths([(np.diag(np.diag(D)), inertia, M) for D, inertia, M in drawn if D.any()]).max()
    example = "M* = e₃, D = ½ [[1, −1, 0], [−1, 1, 0], [0, 0, 0]], I = (1, 2, 3)"
    reversed_ = 0.0, "the motion has left M* for the other half of the axis"
    yield at_most(f"growth rate at {example}", rate, *BELOW_ZERO)
    yield CORRECTED
    yield judge_criterion(drawn)
    yield at_most(f"M₃/M₃* at t = {t:.0f}, started 10⁻⁶ from that M*", end[2], *reversed_)
    yield at_most("transverse momentum there", np.hypot(end[0], end[1]), *GONE)
    yield at_most("growth rate at the rotation it ends in", after, *BELOW_ZERO)
    yield at_most("largest transverse growth rate of random diagonal D", largest, *BELOW_ZERO)


def about_axis_2(d3: float, d1: float, d13: float) -> np.ndarray:
    """Return D with e₂ in its kernel."""
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
    yield judge_criterion(random_equilibria((1,), cases, seed))
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
    left = momentum_at(scene.damping, scene.M, 80.0 / min(rates)) / np.linalg.norm(scene.M)
    sizes = np.linalg.norm(along_kernel(kernel)[0], axis=1)
    damped_away = 1e-2, "what decays at the damping rates is gone"
    after = "‖M(t)‖/‖M(0)‖ after 80 damping times, D = diag(0, 1, 1), D M(0) ≠ 0"
    slowest = SLOWEST[0], f"along ker D ‖M‖' = −c‖M‖³, hence {SLOWEST[1]}"
    yield at_most(after, np.linalg.norm(left), *damped_away)
    yield CORRECTED
    yield at_least("|M₁|/‖M(0)‖ then", abs(left[0]), *STAYS)
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
    yield at_most(
        "|the same off ker D over the square of this − 1|", abs(slaved / fell**2 - 1), *second_order
    )
