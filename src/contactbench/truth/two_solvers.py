"""The truth where high precision takes too long: two solvers in double precision.

SciPy's DOP853 and extrapolation share only the right-hand side and run at their tightest tolerances: the truth is known
to the digits on which they agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from time import perf_counter

import numpy as np

from contactbench.errors import BadInput
from contactbench.numbers.protocol import Arithmetic
from contactbench.scene import Scene
from contactbench.scene.scales import errors
from contactbench.truth.engines import (
    BlowUp,
    OutOfTime,
    Slope,
    Stopwatch,
    across_breaks,
    extrapolate,
    initial_value_problem,
    jump_at,
    lost_at_breaks,
    no_reference,
)

#: tightest tolerance, and columns of extrapolation, in double precision
TIGHTEST, COLUMNS = 1e-13, 12
#: a state counts as at least this part of the largest state of the motion
FAINT = 1e-3
#: distance of two times beside a jump relative to the span; relative change of the slope that is no jump
BESIDE, CLEAR = 1e-11, 1e-6
#: pairs of solvers (blank: extrapolation); the implicit pair is used if the motion is too stiff for the first
PAIRS = (("DOP853", ""), ("Radau", "LSODA"))
#: number of solvers; allowed ratio of a solver's time to the foreseen one; allowed ratio of the foreseen time to the
#: budget: no other computation would follow
SOLVERS, UNEVEN, PATIENCE = 2, 1.5, 4.0


def doubles(
    scene: Scene,
    t: np.ndarray,
    carry: tuple[str, ...],
    deadline: float,
    stops: Sequence[float] = (),
    blur: float = 0.0,
) -> tuple[np.ndarray, int]:
    """Return states (k, size) and the digits on which two solvers agree; blur : uncertainty of the slopes."""
    tightest = max(TIGHTEST, blur)
    of_motion, start, origin = initial_value_problem(scene, carry)
    #: both solvers use one scale for all components
    units = scene.scales(scene.initial(carry), float(t[-1]))
    start = start / units

    def slope(time: Arithmetic, y: np.ndarray) -> np.ndarray:
        return np.asarray(of_motion(time, y * units) / units)

    times = sorted({*t.tolist(), *stops})
    saved, breaks = np.searchsorted(times, t), scene.breaks_until(times[-1])
    with np.errstate(all="ignore"):
        slope(0.0, start)  # the first call records the functions and is not timed
    gragg = partial(extrapolate, most=COLUMNS, tolerance=tightest)

    def rows(solve: Callable[..., list[np.ndarray]]) -> np.ndarray:
        with np.errstate(all="ignore"):
            return np.array(across_breaks(solve, slope, start, times, breaks))

    def agreed(pair: tuple[str, str]) -> tuple[np.ndarray, int]:
        found, begun = list[np.ndarray](), perf_counter()
        for name in pair:
            spent, left = perf_counter() - begun, SOLVERS - len(found)
            watch = Stopwatch(scene, float(t[-1]), deadline, PATIENCE)
            solve = partial(
                partial(by_scipy, name=name, rtol=tightest) if name else gragg, slope, watch=watch
            )
            try:
                try:
                    found.append(rows(solve))
                except BlowUp as why:
                    if scene.clock is not None and jumps(slope, start, float(why.time), times[-1]):
                        raise jump_at(scene, float(why.time)) from why
                    if not found:
                        far = f"it cannot be followed to t = {t[-1]:g}"
                        raise BadInput(no_reference(scene, far)) from why
                    # digits of a state near rest may be lost
                    found.append(rows(partial(solve, least=FAINT * np.abs(found[0]).max())))
            except OutOfTime as why:
                raise OutOfTime(str(why), spent + left * UNEVEN * why.needed) from why
        lost = lost_at_breaks(slope, breaks, times, found[0]) / (np.abs(found[0]).max() or 1.0)
        one, other = (scene.insert_clock(every[saved] * units, float(origin), t) for every in found)
        packed = scene.pack(scene.initial(carry))
        gap = min(float(errors(scene, other, one, packed, carry, whole=True).max()) + lost, 1.0)
        return one, math.floor(-math.log10(max(gap, 1e-15)))

    explicit, implicit = PAIRS
    try:
        y, digits = agreed(explicit)
    except OutOfTime as late:
        try:
            y, digits = agreed(implicit)
        except OutOfTime:
            raise late from None
    if not digits:
        raise BadInput(no_reference(scene, f"two solvers agree on no digit at t = {t[-1]:g}"))
    return y, digits


def jumps(slope: Slope, y: np.ndarray, time: float, end: float) -> bool:
    """Return whether the slope at a fixed state jumps at a time."""
    near = BESIDE * end * np.array([-2.0, -1.0, 1.0, 2.0])
    for state in (y, y + 1):
        with np.errstate(all="ignore"):
            far, before, behind, farther = (slope(time + dt, state) for dt in near)
            still = np.abs(before - far) + np.abs(farther - behind)
            if np.any(np.abs(behind - before) > 4 * still + CLEAR * np.abs(before)):
                return True
    return False


def by_scipy(
    slope: Slope, y: np.ndarray, times: list[float], watch: Stopwatch, begin: float, name: str, rtol: float
) -> list[np.ndarray]:
    """Return the states at increasing times by a solver of SciPy that stops at each; may raise `BlowUp`."""
    from scipy.integrate import solve_ivp

    reached = begin

    def checked(time: float, y: np.ndarray) -> np.ndarray:
        nonlocal reached
        watch.check(time)
        reached = time
        return slope(time, y)

    rows, now = [], begin
    for time in times:
        if time > now:
            run = solve_ivp(checked, (now, time), y, name, [time], rtol=rtol, atol=rtol)
            if not run.success or not np.isfinite(run.y).all():
                raise BlowUp(watch.scene, reached)
            y, now = run.y[:, -1], time
        rows.append(y)
    return rows
