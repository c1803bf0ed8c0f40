"""Claims about the stability of the damped body's equilibria (§4.6 of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.claims.calculus import SEED
from contactbench.claims.ledger import Evidence, Measurement, at_least, at_most, claim
from contactbench.claims.linearisation import (
    BELOW_ZERO,
    EIGENVALUES,
    INERTIA,
    Case,
    body,
    count_misjudged,
    criterion,
    growth,
    growths,
    random_damping,
    random_equilibria,
    random_inertia,
    scenes_and_momenta,
    spectra,
)
from contactbench.methods import solve

#: an eigenvalue of random cases this close to 0 is not judged
SLACK = 1e-9
CASES = 300
NONE_WRONG = 0, "a criterion has none"
GONE = 1e-9, "10³ times the tolerance 10⁻¹² of the solver"
STAYS = 1e-2, "far above what a decaying component leaves"
SLOWEST = 0.15, "t^{−1/2}: 0.1, and half as much again for the transient"


def momentum_at(D: Any, M: Any, t: float, inertia: Sequence[float] = INERTIA) -> np.ndarray:
    """Return M(t) by integration."""
    scene = body(D, inertia).with_(M=tuple(float(m) for m in M), t_end=t)
    return solve(scene, "scipy-dop853", rtol=1e-12, save_at=[t], carry=()).y[-1]


def count_contradicted(cases: Sequence[Case], count: int) -> int:
    """Count the cases, of the first `count` clear ones, whose integrated motion contradicts the criterion.

    A start 10⁻⁶ off the axis is followed for six times 1/|growth rate|, in which what is unstable grows by
    a factor of about 400 and what is stable shrinks by as much; ten is asked for.
    """
    rates = growths(*scenes_and_momenta(cases))
    clear = [n for n in range(len(cases)) if abs(rates[n]) > 0.05][:count]
    wrong = count - len(clear)
    for n in clear:
        D, inertia, M = cases[n]
        axis = int(np.argmax(np.abs(M)))
        off = np.full(3, 1e-6)
        off[axis] = 0.0
        end = momentum_at(D, M + off, 6 / abs(rates[n]), inertia)
        factor = np.linalg.norm(np.delete(end, axis)) / np.linalg.norm(off)
        unstable = criterion(D, M, inertia)[1] < 0
        wrong += not (factor > 10 if unstable else factor < 0.1)
    return wrong


def judge_criterion(axes: Sequence[int], seed: int, cases: int, integrated: int) -> list[Measurement]:
    """Compare the criterion with the full spectrum and, for a few cases, with integration."""
    random = random_equilibria(axes, cases, seed)
    drawn = f"{cases} random (I, D, M*), symmetric D ≥ 0 of rank 0, 1, 2 with D M* = 0"
    judged, moved = count_misjudged(random, SLACK), count_contradicted(random, integrated)
    return [
        at_most(f"cases of {drawn}, whose 3×3 spectrum contradicts the criterion", judged, *NONE_WRONG),
        at_most(f"cases of {integrated} of them whose integrated motion does", moved, *NONE_WRONG),
    ]


# -- the stability theorem -------------------------------------------------------------------------
#: at e₃, D pushes along the transverse diagonal on which the gyroscopic coupling does not resist
COUNTEREXAMPLE = ((0.5, -0.5, 0.0), (-0.5, 0.5, 0.0), (0.0, 0.0, 0.0))


def diagonal_cases(axes: Sequence[int], cases: int, seed: int) -> list[Case]:
    """Draw (D, inertia, M*) with D diagonal, both transverse rates > 0."""
    rng, found = np.random.default_rng(seed), []
    for number in range(cases):
        axis = axes[number % len(axes)]
        rates = rng.uniform(0.05, 1.0, 3)
        rates[axis] = 0.0
        found.append((np.diag(rates), random_inertia(rng), rng.uniform(0.2, 2.0) * np.eye(3)[axis]))
    return found


def real_parts(cases: Sequence[Case]) -> np.ndarray:
    """Return the real parts of the full spectra, ascending; (k, 3)."""
    return np.sort(spectra(*scenes_and_momenta(cases)).real, axis=1)


@claim("C19")
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
    end = momentum_at(D, np.asarray(M) + off, t, inertia)
    after = growth(D, end * (np.arange(3) == axis), inertia)
    diagonal = diagonal_cases((0, 2), cases // 3, seed)
    values = real_parts(diagonal)
    undamped = np.abs(real_parts([(0 * D, inertia, M) for D, inertia, M in diagonal])).max()
    on_axis = np.abs(values[:, 2]).max()
    example = "M* = e₃, D = ½ [[1, −1, 0], [−1, 1, 0], [0, 0, 0]], I = (1, 2, 3)"
    reversed_ = 0.0, "the motion has left M* for the other half of the axis"
    statement = [at_most(f"growth rate at {example}", rate, *BELOW_ZERO)]
    corrected = [
        *judge_criterion((0, 2), seed, cases, integrated),
        at_most(f"M₃/M₃* at t = {t:.0f}, started 10⁻⁶ from that M*", end[axis] / M[axis], *reversed_),
        at_most("transverse momentum there", np.linalg.norm(np.delete(end, axis)), *GONE),
        at_most("growth rate at the rotation it ends in", after, *BELOW_ZERO),
        at_most("largest transverse growth rate of random diagonal D", values[:, :2].max(), *BELOW_ZERO),
        at_most("|real part| of the eigenvalue along the axis there", on_axis, *EIGENVALUES),
        at_most("max |real part| at D = 0", undamped, *EIGENVALUES),
    ]
    return Evidence(statement, corrected)


#: full transverse blocks (d₃₃, d₁₁, d₃₁) at e₂ that the product d₁₁ d₃₃ alone would misjudge
SADDLE, CALM = (0.5, 0.5, 0.5), (0.2, 0.29, -0.2)


def about_axis_2(d3: float, d1: float, d13: float) -> np.ndarray:
    """Return D with e₂ in its kernel."""
    return np.array([[d1, 0.0, d13], [0.0, 0.0, 0.0], [d13, 0.0, d3]])


@claim("C20")
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
    saddle, calm = (growth(about_axis_2(*rates), np.eye(3)[1]) for rates in (SADDLE, CALM))
    border = "|d² / (|M*|² (1/I₂ − 1/I₃)(1/I₁ − 1/I₂)) − 1| at the border for D = diag(d, 0, d)"
    exact = 1e-10, "round-off of the eigenvalues, over their slope"
    beyond = "growth rate, D = diag(d, 0, d) with d² three times the border"
    statement = [at_least(beyond, rate(3 * coupling), *EIGENVALUES)]
    corrected = [
        *judge_criterion((1,), seed, cases, integrated),
        at_most(border, abs(edge / coupling - 1), *exact),
        at_least("growth rate at d₁ = d₃ = d₁₃ = ½, I = (1, 2, 3), |M*| = 1", saddle, *EIGENVALUES),
        at_most("growth rate at d₁ = 0.29, d₃ = 0.2, d₁₃ = −0.2", calm, *BELOW_ZERO),
    ]
    return Evidence(statement, corrected)


def along_kernel(kernel: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return M at t = 80 and 8000, damped by 1 − uuᵀ with `kernel` along u; and u."""
    u = np.asarray(kernel) / np.linalg.norm(kernel)
    scene = body(np.eye(3) - np.outer(u, u))
    return solve(scene, "scipy-dop853", rtol=1e-9, save_at=[80.0, 8000.0], carry=()).y, u


@claim("C21")
def decay_to_the_origin(
    seed: int = SEED, rates: Sequence[float] = (1.0, 1.0), kernel: Sequence[float] = (1.0, 2.0, 0.0)
) -> Evidence:
    """rates : about axes 2 and 3.  kernel : a direction that is no principal axis."""
    scene = body((0.0, *rates))
    end = 80.0 / min(rates)
    left = momentum_at(scene.damping, scene.M, end) / np.linalg.norm(scene.M)
    rng = np.random.default_rng(seed)
    full = random_damping(rng, 2, 0) + np.diag([0.0, 0.5, 0.5])
    start = rng.normal(size=3)
    other = momentum_at(full, start, 80.0) / np.linalg.norm(start)
    sizes = np.linalg.norm(along_kernel(kernel)[0], axis=1)
    damped_away = 1e-2, "what decays at the damping rates is gone"
    after = "‖M(t)‖/‖M(0)‖ after 80 damping times, D = diag(0, 1, 1), D M(0) ≠ 0"
    statement = [at_most(after, np.linalg.norm(left), *damped_away)]
    slowest = SLOWEST[0], f"along ker D ‖M‖' = −c‖M‖³, hence {SLOWEST[1]}"
    corrected = [
        at_least("|M₁|/‖M(0)‖ then", abs(left[0]), *STAYS),
        at_most("what is left across axis 1", np.hypot(left[1], left[2]), *GONE),
        at_least("|M₁(80)|/‖M(0)‖, a random full D with D e₁ = 0 and a random start", abs(other[0]), *STAYS),
        at_most("what is left across axis 1 there", np.hypot(other[1], other[2]), *GONE),
        at_most("‖M(8000)‖/‖M(80)‖ where ker D holds no principal axis", sizes[1] / sizes[0], *slowest),
    ]
    return Evidence(statement, corrected)


@claim("C40")
def modes(kernel: Sequence[float] = (1.0, 2.0, 0.0), rate: float = 0.5) -> Evidence:
    """kernel : a direction that is no principal axis.  rate : about axis 3, below twice the frequency at e₁."""
    M, u = along_kernel(kernel)
    along = np.abs(M @ u)
    off = np.linalg.norm(M - np.outer(M @ u, u), axis=1)
    damped = growth(np.diag([0.0, 0.0, rate]), np.eye(3)[0])
    undamped = growth(COUNTEREXAMPLE, np.eye(3)[2])
    statement = [
        at_most("growth rate off ker D at e₃, D of C19", undamped, *BELOW_ZERO),
        at_most("|damping rate| of δM = e₂ in ker D at e₁, D = diag(0, 0, d)", abs(damped), *EIGENVALUES),
    ]
    fell, slaved = along[1] / along[0], off[1] / off[0]
    second_order = 0.1, "M × Ω, of second order, keeps it: 1/t, up to terms of third order at t = 80"
    corrected = [
        at_most("|damping rate/(d/2) − 1| of that mode", abs(-damped / (rate / 2) - 1), *EIGENVALUES),
        at_most("component of M along ker D at t = 8000 over that at 80", fell, *SLOWEST),
        at_most("|the same off ker D over the square of this − 1|", abs(slaved / fell**2 - 1), *second_order),
    ]
    return Evidence(statement, corrected)
