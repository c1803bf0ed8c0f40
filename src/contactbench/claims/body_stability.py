"""Claims about the stability of the damped body's equilibria (§4.6 of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.claims.calculus import SEED
from contactbench.claims.ledger import Correction, Evidence, at_least, at_most, claim
from contactbench.claims.linearisation import (
    EIGENVALUES,
    INERTIA,
    SPECTRUM,
    SPECTRUM_WHY,
    body,
    criterion,
    growth,
    growths,
    misjudged,
    random_damping,
    random_equilibria,
    random_inertia,
    spectra,
)
from contactbench.methods import solve

DOP853 = "scipy-dop853, rtol 10⁻¹²"
COARSER = "scipy-dop853, rtol 10⁻¹² and 10⁻⁹"
#: an eigenvalue of random cases this close to 0 is not judged
SLACK = 1e-9
CASES = 300
NONE_WRONG = "a criterion has none"


def settled(D: Any, M: Any, t: float, inertia: Sequence[float] = INERTIA) -> np.ndarray:
    """M(t) by integration."""
    scene = body(D, inertia).with_(M=tuple(float(m) for m in M), t_end=t)
    return solve(scene, "scipy-dop853", rtol=1e-12, save_at=[t], carry=()).y[-1]


def contradicted(cases: Sequence[tuple[np.ndarray, Any, np.ndarray]], count: int) -> int:
    """Of the first `count` clear cases, those in which the integrated motion contradicts the criterion.

    A start 10⁻⁶ off the axis is followed for six times 1/|growth rate|, in which what is unstable grows by
    a factor of about 400 and what is stable shrinks by as much; ten is asked for.
    """
    rates = growths([body(D, inertia) for D, inertia, _ in cases], [M for *_, M in cases])
    clear = [n for n in range(len(cases)) if abs(rates[n]) > 0.05][:count]
    wrong = count - len(clear)
    for n in clear:
        D, inertia, M = cases[n]
        axis = int(np.argmax(np.abs(M)))
        off = np.full(3, 1e-6)
        off[axis] = 0.0
        end = settled(D, M + off, 6 / abs(rates[n]), inertia)
        factor = np.linalg.norm(np.delete(end, axis)) / np.linalg.norm(off)
        unstable = criterion(D, M, inertia)[1] < 0
        wrong += not (factor > 10 if unstable else factor < 0.1)
    return wrong


def judged(axes: Sequence[int], seed: int, cases: int, integrated: int) -> list[Any]:
    """The criterion against the full spectrum and, for a few, against integration."""
    random = random_equilibria(axes, cases, seed)
    ranks = "symmetric D ≥ 0 of rank 0, 1, 2 with D M* = 0"
    return [
        at_most(
            f"cases of {cases} random (I, D, M*), {ranks}, whose 3×3 spectrum contradicts the criterion",
            misjudged(random, SLACK),
            0,
            NONE_WRONG,
        ),
        at_most(
            f"cases of {integrated} of them whose integrated motion does",
            contradicted(random, integrated),
            0,
            NONE_WRONG,
        ),
    ]


# -- the stability theorem -------------------------------------------------------------------------
#: at e₃, D pushes along the transverse diagonal on which the gyroscopic coupling does not resist
COUNTEREXAMPLE = ((0.5, -0.5, 0.0), (-0.5, 0.5, 0.0), (0.0, 0.0, 0.0))
CRITERION = (
    "With a = 1/I, M* = m e_i and (i, j, k) cyclic, the transverse linearisation has tr = −(d_jj + d_kk) and "
    "det = d_jj d_kk − d_jk² + m (a_j − a_k) d_jk + m² (a_i − a_j)(a_i − a_k): a saddle if det < 0, "
    "asymptotically stable across the axis if det > 0 and D ≠ 0. The eigenvalue along the axis is always 0, "
    "because the whole axis consists of equilibria"
)


def diagonal_cases(axes: Sequence[int], cases: int, seed: int) -> list[tuple[np.ndarray, Any, np.ndarray]]:
    """(D, inertia, M*) with D diagonal, both transverse rates > 0."""
    rng, found = np.random.default_rng(seed), []
    for number in range(cases):
        axis = axes[number % len(axes)]
        rates = rng.uniform(0.05, 1.0, 3)
        rates[axis] = 0.0
        found.append((np.diag(rates), random_inertia(rng), rng.uniform(0.2, 2.0) * np.eye(3)[axis]))
    return found


def spectra_of(cases: Sequence[tuple[np.ndarray, Any, np.ndarray]]) -> np.ndarray:
    """Real parts of the full spectra, ascending; (k, 3)."""
    return np.sort(
        spectra([body(D, inertia) for D, inertia, _ in cases], [M for *_, M in cases]).real, axis=1
    )


@claim(
    "C19",
    "§4.6.1, Stability Theorem, item 1",
    "A rotation about an extreme axis in ker D is linearly asymptotically stable.",
    kind=Correction.replaces,
    correction="Not for every symmetric D ≥ 0. With I = (1, 2, 3) and D = ½ [[1, −1, 0], [−1, 1, 0], [0, 0, 0]] "
    "the rotation M* = e₃ in ker D is a saddle with growth rate +0.1236; started beside it, M ends in the "
    f"opposite rotation, M₃ = −0.679, which is stable. {CRITERION}. For diagonal D and an extreme axis "
    "det > 0: there the theorem is true, transversally.",
    scene="anisotropic body, an extreme axis in ker D",
    method=DOP853,
)
def extreme_axes(
    seed: int = 4,
    cases: int = CASES,
    integrated: int = 8,
    D: Any = COUNTEREXAMPLE,
    M: Sequence[float] = (0.0, 0.0, 1.0),
    inertia: Sequence[float] = INERTIA,
) -> Evidence:
    """D, M, inertia : the counterexample; M on a principal axis with D M = 0."""
    axis = int(np.argmax(np.abs(M)))
    off = 1e-6 * np.ones(3)
    off[axis] = 0.0
    rate = growth(D, M, inertia)
    t = 50 / max(rate, 0.01)
    end = settled(D, np.asarray(M) + off, t, inertia)
    values = spectra_of(diagonal_cases((0, 2), cases // 3, seed))
    undamped = spectra_of(
        [(0 * D_, I_, M_) for D_, I_, M_ in diagonal_cases((0, 2), cases // 3, seed)]
    )  # one D = 0 for each
    statement = [
        at_most(
            "growth rate at M* = e₃, D = ½ [[1, −1, 0], [−1, 1, 0], [0, 0, 0]], I = (1, 2, 3)",
            rate,
            -SPECTRUM,
            SPECTRUM_WHY,
        )
    ]
    corrected = [
        *judged((0, 2), seed, cases, integrated),
        at_most(
            f"M₃/M₃* at t = {t:.0f}, started 10⁻⁶ from that M*",
            end[axis] / M[axis],
            0.0,
            "the motion has left M* for the other half of the axis",
        ),
        at_most(
            "transverse momentum there",
            np.linalg.norm(np.delete(end, axis)),
            1e-9,
            "10³ times the tolerance 10⁻¹² of the solver",
        ),
        at_most(
            "growth rate at the rotation it ends in",
            growth(D, end * (np.arange(3) == axis), inertia),
            -SPECTRUM,
            SPECTRUM_WHY,
        ),
        at_most(
            "largest transverse growth rate of random diagonal D",
            values[:, :2].max(),
            -SPECTRUM,
            SPECTRUM_WHY,
        ),
        at_most(
            "|real part| of the eigenvalue along the axis there", np.abs(values[:, 2]).max(), *EIGENVALUES
        ),
        at_most("max |real part| at D = 0", np.abs(undamped).max(), *EIGENVALUES),
    ]
    return Evidence(statement, corrected)


#: full transverse blocks (d₃₃, d₁₁, d₃₁) at e₂ that the product d₁₁ d₃₃ alone would misjudge
SADDLE, CALM = (0.5, 0.5, 0.5), (0.2, 0.29, -0.2)


def about_axis_2(d3: float, d1: float, d13: float) -> np.ndarray:
    """D with e₂ in its kernel."""
    return np.array([[d1, 0.0, d13], [0.0, 0.0, 0.0], [d13, 0.0, d3]])


@claim(
    "C20",
    "§4.6.1, Stability Theorem, item 2",
    "A rotation about the intermediate axis in ker D is always a saddle.",
    kind=Correction.replaces,
    correction=f"Enough damping stabilises it. {CRITERION}. For diagonal D and I₁ < I₂ < I₃ it is stable if d₁d₃ > "
    "m² (1/I₂ − 1/I₃)(1/I₁ − 1/I₂): with I = (1, 2, 3), m = 1, D = diag(d, 0, d) the border is "
    "d² = 1/12. Off the diagonal the product d₁d₃ does not decide: there d₁ = d₃ = d₁₃ = ½ is a saddle "
    "although d₁d₃ > 1/12, and d₁ = 0.29, d₃ = 0.2, d₁₃ = −0.2 is stable although d₁d₃ < 1/12.",
    scene="anisotropic body, the intermediate axis in ker D",
    method=DOP853,
    figures=("paper_stability",),
)
def intermediate_axis(
    seed: int = 5,
    cases: int = CASES,
    integrated: int = 8,
    inertia: Sequence[float] = INERTIA,
    size: float = 1.0,
) -> Evidence:
    """inertia, in ascending order, size = |M*| : of the rotation damped by diag(d, 0, d)."""
    M = size * np.eye(3)[1]
    a = 1 / np.asarray(inertia)
    coupling = size**2 * (a[1] - a[2]) * (a[0] - a[1])

    def rate(square: float) -> float:
        return growth(about_axis_2(np.sqrt(square), np.sqrt(square), 0.0), M, inertia)

    edge = scipy.optimize.brentq(rate, coupling / 10, 10 * coupling, xtol=1e-15)
    one = np.eye(3)[1]
    statement = [
        at_least(
            "growth rate, D = diag(d, 0, d) with d² three times the border", rate(3 * coupling), *EIGENVALUES
        )
    ]
    corrected = [
        *judged((1,), seed, cases, integrated),
        at_most(
            "|d² / (|M*|² (1/I₂ − 1/I₃)(1/I₁ − 1/I₂)) − 1| at the border for D = diag(d, 0, d)",
            abs(edge / coupling - 1),
            1e-10,
            "round-off of the eigenvalues, over their slope",
        ),
        at_least(
            "growth rate at d₁ = d₃ = d₁₃ = ½, I = (1, 2, 3), |M*| = 1",
            growth(about_axis_2(*SADDLE), one),
            *EIGENVALUES,
        ),
        at_most(
            "growth rate at d₁ = 0.29, d₃ = 0.2, d₁₃ = −0.2",
            growth(about_axis_2(*CALM), one),
            -SPECTRUM,
            SPECTRUM_WHY,
        ),
    ]
    return Evidence(statement, corrected)


def along_kernel(kernel: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """M at t = 80 and 8000, damped by 1 − uuᵀ with `kernel` along u; and u."""
    u = np.asarray(kernel) / np.linalg.norm(kernel)
    scene = body(np.eye(3) - np.outer(u, u))
    return solve(scene, "scipy-dop853", rtol=1e-9, save_at=[80.0, 8000.0], carry=()).y, u


@claim(
    "C21",
    "§4.6.1, Stability Theorem, item 3",
    "If M* is not in ker D there is no steady rotation and all trajectories decay to the origin.",
    kind=Correction.replaces,
    correction="DM* = 0 is a premise of the theorem, so item 3 is read for a direction M* (or a start M(0)) off "
    "ker D. Then M* itself is no equilibrium, but a trajectory may still settle on another axis in ker D: with "
    "D = diag(0, 1, 1) it ends in a steady rotation about axis 1. All trajectories decay to the origin if ker D "
    "contains no principal axis, and where ker D ≠ 0 then only as t^{−1/2}.",
    scene="anisotropic body, D = diag(0, 1, 1); full D with axis 1 in the kernel; D with kernel (1, 2, 0)",
    method=COARSER,
)
def decay_to_the_origin(
    seed: int = SEED, rates: Sequence[float] = (1.0, 1.0), kernel: Sequence[float] = (1.0, 2.0, 0.0)
) -> Evidence:
    """rates : about axes 2 and 3.  kernel : a direction that is no principal axis."""
    scene = body((0.0, *rates))
    end = 80.0 / min(rates)
    left = settled(scene.damping, scene.M, end) / np.linalg.norm(scene.M)
    rng = np.random.default_rng(seed)
    full = random_damping(rng, 2, 0) + np.diag([0.0, 0.5, 0.5])
    start = rng.normal(size=3)
    other = settled(full, start, 80.0) / np.linalg.norm(start)
    sizes = np.linalg.norm(along_kernel(kernel)[0], axis=1)
    gone = 1e-9, "10³ times the tolerance 10⁻¹² of the solver"
    statement = [
        at_most(
            "‖M(t)‖/‖M(0)‖ after 80 damping times, D = diag(0, 1, 1), D M(0) ≠ 0",
            np.linalg.norm(left),
            1e-2,
            "what decays at the damping rates is gone",
        )
    ]
    corrected = [
        at_least("|M₁|/‖M(0)‖ then", abs(left[0]), 1e-2, "far above what a decaying component leaves"),
        at_most("what is left across axis 1", np.hypot(left[1], left[2]), *gone),
        at_least(
            "|M₁(80)|/‖M(0)‖, a random full D with D e₁ = 0 and a random start",
            abs(other[0]),
            1e-2,
            "far above what a decaying component leaves",
        ),
        at_most("what is left across axis 1 there", np.hypot(other[1], other[2]), *gone),
        at_most(
            "‖M(8000)‖/‖M(80)‖ where ker D holds no principal axis",
            sizes[1] / sizes[0],
            0.15,
            "along ker D ‖M‖' = −c‖M‖³, hence t^{−1/2}: 0.1, and half as much again for the transient",
        ),
    ]
    return Evidence(statement, corrected)


@claim(
    "C40",
    "§4.6, after eq. (76)",
    "Damping makes all modes not in ker D decay exponentially; modes in ker D behave as in the undamped body.",
    kind=Correction.replaces,
    correction="The gyroscopic terms couple the two. A mode off ker D may grow (C19), one in ker D may be damped: at "
    "M* = e₁ with D = diag(0, 0, ½), δM = e₂ is in ker D and decays. Where ker D is no principal axis, M along it "
    "falls as t^{−1/2} and what is off it as 1/t, neither as claimed. What decides is trace and determinant of the "
    "transverse linearisation.",
    scene="anisotropic body: linearisation, and D with kernel (1, 2, 0)",
    method=COARSER,
)
def modes(kernel: Sequence[float] = (1.0, 2.0, 0.0), rate: float = 0.5) -> Evidence:
    """kernel : a direction that is no principal axis.  rate : about axis 3, below twice the frequency at e₁."""
    M, u = along_kernel(kernel)
    along = np.abs(M @ u)
    off = np.linalg.norm(M - np.outer(M @ u, u), axis=1)
    damped = growth(np.diag([0.0, 0.0, rate]), np.eye(3)[0])
    statement = [
        at_most(
            "growth rate off ker D at e₃, D of C19",
            growth(COUNTEREXAMPLE, np.eye(3)[2]),
            -SPECTRUM,
            SPECTRUM_WHY,
        ),
        at_most("|damping rate| of δM = e₂ in ker D at e₁, D = diag(0, 0, d)", abs(damped), *EIGENVALUES),
    ]
    fell, slaved = along[1] / along[0], off[1] / off[0]
    corrected = [
        at_most("|damping rate/(d/2) − 1| of that mode", abs(-damped / (rate / 2) - 1), *EIGENVALUES),
        at_most(
            "component of M along ker D at t = 8000 over that at 80",
            fell,
            0.15,
            "t^{−1/2}: 0.1, and half as much again for the transient",
        ),
        at_most(
            "|the same off ker D over the square of this − 1|",
            abs(slaved / fell**2 - 1),
            0.1,
            "M × Ω, of second order, keeps it: 1/t, up to terms of third order at t = 80",
        ),
    ]
    return Evidence(statement, corrected)
