"""The truth of scenes of many sites: component by component where they are few, else two solvers of arrays.

Few is what high precision can do in seconds.  Beyond, two solvers in double precision that share nothing but the
right-hand side, SciPy's DOP853 and extrapolation, run at their tightest: the truth is known as far as they agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from contactbench.errors import BadInput
from contactbench.scene import Scene
from contactbench.truth.engines import Stopwatch

#: numbers of a state up to which its components are solved to 30 digits
FEW = 128
#: of the two solvers in double precision
TIGHTEST, COLUMNS = 1e-13, 12


def doubles(scene: Scene, t: np.ndarray, carry: tuple[str, ...], deadline: float) -> tuple[np.ndarray, int]:
    """Return states (k, size) at increasing times, and how many digits of them two solvers agree on."""
    start = np.array(scene.pack(scene.initial(carry)))
    found: list[Any] = []
    for solver in (by_dop853, by_extrapolation):
        watch = Stopwatch(scene, float(t[-1]), deadline)

        def slope(time: float, y: np.ndarray, watch: Stopwatch = watch) -> np.ndarray:
            watch.check(time)
            return np.asarray(scene.slopes(time, y, carry))

        with np.errstate(all="ignore"):
            found.append(solver(slope, start, t))
        if found[-1] is None or not np.isfinite(found[-1]).all():
            raise BadInput(f"no reference for scene {scene.name!r}: it cannot be followed to t = {t[-1]:g}")
    one, other = found
    gap = np.abs(one - other).max() / np.abs(one).max()
    return one, max(0, math.floor(-math.log10(max(gap, 1e-15))))


def by_dop853(slope: Callable[..., np.ndarray], start: np.ndarray, t: np.ndarray) -> np.ndarray | None:
    """Return the states at increasing times by SciPy's DOP853 at its tightest, stopping at each of them."""
    from scipy.integrate import solve_ivp

    rows, y, now = [], start, 0.0
    for time in t.tolist():
        if time > now:
            run = solve_ivp(slope, (now, time), y, "DOP853", [time], rtol=TIGHTEST, atol=TIGHTEST)
            if not run.success:
                return None
            y, now = run.y[:, -1], time
        rows.append(y)
    return np.array(rows)


def by_extrapolation(slope: Callable[..., np.ndarray], start: np.ndarray, t: np.ndarray) -> np.ndarray | None:
    """Return the states by the extrapolated midpoint rule (Hairer, Nørsett, Wanner, Solving ODEs I, §II.9)."""
    rows, y, now, trial = [], start, 0.0, float(t[-1])
    for time in t.tolist():
        while now < time:
            step = min(trial, time - now)
            found, columns = extrapolated(slope, now, y, step)
            if found is None:
                trial = step / 2
                if trial < 1e-9 * t[-1]:
                    return None
                continue
            now, y = (time if step == time - now else now + step), found
            if columns < COLUMNS - 3:
                trial = max(trial, 1.5 * step)
        rows.append(y)
    return np.array(rows)


def extrapolated(
    slope: Callable[..., np.ndarray], now: float, y: np.ndarray, step: float
) -> tuple[np.ndarray | None, int]:
    """Return one step and how many columns of the scheme it took; None where they do not suffice."""
    first, size, previous = slope(now, y), np.abs(y).max(), list[Any]()
    for j in range(1, COLUMNS + 1):
        h = step / (2 * j)
        old, mid = y, y + h * first
        for k in range(1, 2 * j):
            old, mid = mid, old + 2 * h * slope(now + k * h, mid)
        row = [mid]
        for k, below in enumerate(previous, start=1):
            row.append(row[-1] + (row[-1] - below) / (j * j / (j - k) ** 2 - 1))
        if j > 2 and np.abs(row[-1] - row[-2]).max() <= TIGHTEST * size:
            return row[-1], j
        previous = row
    return None, COLUMNS
