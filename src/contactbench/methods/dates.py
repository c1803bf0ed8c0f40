"""The times of a run: its intervals of equal steps, and the times that functions are called with.

The n-th step of an interval begins the time n h after the interval, which is no running sum.  Functions are called with
the time of the scene's start plus the time since then, added once.  Next to a break they are never called with a time
beyond it: the side of a jump on which a stage lies does not depend on the rounding of its time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from contactbench.numbers.control import choose
from contactbench.numbers.dual import value
from contactbench.numbers.protocol import Arithmetic, Namespace
from contactbench.scene import Scene
from contactbench.scene.base import OwnState


def division(scene: Scene, later: np.ndarray) -> tuple[np.ndarray, slice | np.ndarray]:
    """Return the ends of the fewest intervals between saved times > 0 and breaks, and the numbers of the saved ones."""
    end, ends = float(later[-1]), list[float]()
    for time, exact in scene.breaks_until(end):
        if (ends[-1] if ends else 0.0) + exact < time < end - exact:
            ends.append(time)
            later = np.where(np.abs(later - time) <= exact, time, later)
    if not ends:
        return later, slice(None)
    every = np.union1d(later, ends)
    return every, np.searchsorted(every, later)


def dates(scene: Scene, begins: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return the begin of each interval and the bounds of its functions' times, since the start, (k, 3)."""
    breaks = np.array(scene.breaks_until(math.inf, -math.inf)).reshape(-1, 2)
    after = np.searchsorted(breaks[:, 0], (begins + ends) / 2)
    low = np.append(-math.inf, breaks.sum(axis=1))[after]
    high = np.append(breaks[:, 0] - breaks[:, 1], math.inf)[after]
    return np.column_stack([begins, np.minimum(low, ends), np.maximum(high, begins)])


def begin(
    scene: Scene,
    x: OwnState,
    xp: Namespace,
    origin: Arithmetic,
    since: Sequence[Arithmetic],
    bounded: bool = True,
) -> tuple[Any, OwnState]:
    """Return a scene and a state whose time counts from the begin of an interval; since : a row of `dates`."""
    begins, low, high = since

    def dated(t: Arithmetic) -> Arithmetic:
        time = begins + value(t)
        if bounded and scene.layout:
            time = choose(time < low, low, choose(time > high, high, time, xp), xp)
        return origin + time

    return scene.since(dated), x._replace(t=0 * x.t)


def end(x: OwnState, origin: Arithmetic, begins: Arithmetic) -> OwnState:
    """Return a state with its absolute time instead of the time since the begin of its interval."""
    return x._replace(t=origin + (begins + x.t))


def from_origin[Y: (np.ndarray, list[float])](scene: Scene, y: Y, start: Y) -> Y:
    """Return a packed state with the time of the start of the run, from which dates count."""
    if not scene.keeps_dates or scene.clock is None:
        return y
    y = y.copy()
    y[scene.clock] = start[scene.clock]
    return y
