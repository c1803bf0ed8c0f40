"""The truth where high precision takes too long, as of many sites: two solvers in double precision.

SciPy's DOP853 and extrapolation share nothing but the right-hand side, and run at their tightest: the truth is known
as far as they agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from contactbench.errors import BadInput
from contactbench.scene import Scene
from contactbench.truth.engines import OutOfTime, Stopwatch, extrapolate

#: numbers of a state up to which its components are solved to 30 digits
FEW = 128
#: of the two solvers in double precision
TIGHTEST, COLUMNS = 1e-13, 12
#: how many they are, how much longer than foreseen one may take: it is seen at the beginning of the other only,
#: and how many times its budget one may be foreseen to need: there is nobody to go on
SOLVERS, UNEVEN, PATIENCE = 2, 1.5, 4.0

Slope = Callable[[np.ndarray], np.ndarray]


def doubles(scene: Scene, t: np.ndarray, carry: tuple[str, ...], deadline: float) -> tuple[np.ndarray, int]:
    """Return states (k, size) at increasing times, and how many digits of them two solvers agree on."""

    def slope(y: np.ndarray) -> np.ndarray:
        return np.asarray(scene.pack(scene.rhs(scene.unpack(scene.entries(y), carry))))

    start, found = np.array(scene.pack(scene.initial(carry))), list[Any]()
    with np.errstate(all="ignore"):
        slope(start)  # the first records the functions: no part of the pace
    begun = perf_counter()
    for solver in (by_dop853, partial(extrapolate, most=COLUMNS, tolerance=TIGHTEST)):
        spent, left = perf_counter() - begun, SOLVERS - len(found)
        try:
            watch = Stopwatch(scene, float(t[-1]), deadline, PATIENCE)
            with np.errstate(all="ignore"):
                rows = solver(slope, start, t.tolist(), watch=watch)
        except OutOfTime as why:
            raise OutOfTime(str(why), spent + left * UNEVEN * why.needed) from why
        if not np.isfinite(rows[-1]).all():
            raise BadInput(f"no reference for scene {scene.name!r}: it cannot be followed to t = {t[-1]:g}")
        found.append(np.array(rows))
    one, other = found
    gap = np.abs(one - other).max() / np.abs(one).max()
    return one, max(0, math.floor(-math.log10(max(gap, 1e-15))))


def by_dop853(slope: Slope, y: np.ndarray, times: list[float], watch: Stopwatch) -> list[np.ndarray]:
    """Return the states at increasing times by SciPy's DOP853 at its tightest, stopping at each; nan is a failure."""
    from scipy.integrate import solve_ivp

    def checked(time: float, y: np.ndarray) -> np.ndarray:
        watch.check(time)
        return slope(y)

    rows, now = [], 0.0
    for time in times:
        if time > now:
            run = solve_ivp(checked, (now, time), y, "DOP853", [time], rtol=TIGHTEST, atol=TIGHTEST)
            y, now = run.y[:, -1] if run.success else math.nan * y, time
        rows.append(y)
    return rows
