"""Prescribed steps: grids that depend on the time alone, so that every step stays a contact map."""

from __future__ import annotations

import math

import numpy as np

from contactbench.checks import positive, real_array, whole
from contactbench.errors import BadInput, excerpt
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed, time_between

#: how far the difference of two saved times may be off, in units of the last place of the later one: both are
#: rounded, as a product or a sum of two, and so may be the spacing of the grid
GRID_ULPS = 4
#: relative differences of steps that are round-off of the times between them
EQUAL = 1e-9
#: no grid has more steps
MOST = 10**8
#: more steps than any budget allows are counted as this many
UNCOUNTED = 2**50
#: saved times when the caller names none: every k-th step with at most this many for fixed steps,
#: this many equal intervals for adaptive methods
DEFAULT_SAVES = 1000
ADAPTIVE_SAVES = 200
#: numbers in all saved states at most, where the caller names no times: 128 MB
MOST_SAVED = 2**24
#: parts of a shorter run are no longer normal numbers
SHORTEST_RUN = 1e-290


def geometric_steps(t_end: float, count: int, a: float, plateau: int = 1) -> np.ndarray:
    """Return `count` growing steps to t_end, between the times t = a(e^u − 1) for equidistant u.

    They suit motions that slow down as 1/(a + t), as under a damping γ = 2/t.

    Parameters
    ----------
    t_end
        Where the steps end, from 0.
    count
        Number of steps.
    a
        About the time in which the steps double.  The grid is geometric where a is far shorter than `t_end`, and
        equidistant where it is far longer.
    plateau
        Number of equal steps in a row; divides `count`.  A method pays for every change of the step, and for every
        saved time in between.

    Returns
    -------
    numpy.ndarray
        The lengths of the steps, (count,), which add up to `t_end`.

    Raises
    ------
    BadInput
        For a time that is not finite and > 0, a count that is not whole, and a plateau that does not divide it.

    Examples
    --------
    >>> import contactbench as cb
    >>> cb.geometric_steps(7.0, 3, a=1.0).round(12).tolist()
    [1.0, 2.0, 4.0]
    """
    t_end, a, count = positive("t_end", t_end), positive("a", a), whole("count", count, MOST)
    plateau = whole("plateau", plateau, count)
    if count % plateau:
        raise BadInput(f"plateau = {plateau}: must divide count = {count}")
    times = a * np.expm1(np.linspace(0.0, np.log1p(t_end / a), count // plateau + 1))
    times[-1] = t_end
    return np.repeat(np.diff(times) / plateau, plateau)


def steps_in(span: float | np.ndarray, until: float | np.ndarray, step: float) -> np.ndarray:
    """Return the fewest equal steps ≤ `step` that cover each span, up to round-off of its end, the time `until`."""
    longest = np.maximum(step, span / (2 * UNCOUNTED))
    ratio = (span * (1 - 1e-12) - GRID_ULPS * np.spacing(until)) / longest
    return np.minimum(np.maximum(np.ceil(ratio), 1), UNCOUNTED).astype(np.int64)


def default_times(scene: Scene, step: float | np.ndarray | None, budget: int) -> np.ndarray:
    most = max(1, MOST_SAVED // scene.motion)
    if step is None:
        return np.linspace(0.0, scene.t_end, min(ADAPTIVE_SAVES, most) + 1)
    n = len(step) if isinstance(step, np.ndarray) else int(steps_in(scene.t_end, scene.t_end, step))
    if n > budget:  # will end as `budget`; no grid of that size is needed
        return np.array([scene.t_end])
    stride = -(-n // min(DEFAULT_SAVES, most))
    marks = np.arange(0, n + stride, stride)
    marks[-1] = n
    if isinstance(step, np.ndarray):
        return np.concatenate([[0.0], end_times(step)[marks[1:-1] - 1], [scene.t_end]])
    return marks * (scene.t_end / n)


def saved_times(save_at: object, scene: Scene) -> np.ndarray:
    """Return saved times since the start, given as those of the scene's clock or as `Elapsed`; raise `BadInput`."""
    given = save_at.times if isinstance(save_at, Elapsed) else save_at
    times = np.array(real_array("save_at", given, "increasing times"), ndmin=1)  # a copy
    if times.ndim != 1 or not len(times) or not np.isfinite(times).all():
        raise BadInput(f"save_at = {excerpt(save_at)}: must be finite times, at least one")
    if (times[1:] <= times[:-1]).any():
        raise BadInput("save_at: times must be strictly increasing")
    if given is save_at:
        times = since_start(times, scene)
    if times[-1] <= 0:
        raise BadInput(f"save_at: at least one time must be > {scene.begins:g}, the start")
    return times


def since_start(times: np.ndarray, scene: Scene) -> np.ndarray:
    """Return the times since the start for increasing times of the scene's clock, within roundings of the start 0."""
    start = scene.begins
    slack = GRID_ULPS * math.ulp(start) if start else 0.0
    if times[0] < start - slack:
        raise BadInput(
            f"save_at contains {float(times[0])!r}: must be ≥ {start:.10g}, the start of {scene.name!r}"
        )
    if not start:
        return times
    return np.unique(np.maximum([time_between(start, time) for time in times.tolist()], 0.0))


def steps_of(value: object) -> np.ndarray:
    """Return a sequence of steps as an array of its own, or raise `BadInput`."""
    steps = np.array(real_array("step", value, "a number, or a sequence of them"), ndmin=1)
    if steps.ndim != 1 or not len(steps) or not np.all(np.isfinite(steps) & (steps > 0)):
        raise BadInput(f"step = {excerpt(value)}: must be finite steps > 0, at least one")
    return steps


def end_times(steps: np.ndarray) -> np.ndarray:
    """Return the end of each step, summed with more digits where the machine has them."""
    return np.cumsum(steps, dtype=np.longdouble).astype(float)


def steps_until(steps: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the number of steps to each of some increasing times > 0; raise `BadInput` for a time inside a step."""
    ends = end_times(steps)
    nearest = np.searchsorted(ends[:-1] + steps[1:] / 2, times)
    off = np.abs(ends[nearest] - times) > EQUAL * steps[nearest] + GRID_ULPS * np.spacing(times)
    off[1:] |= np.diff(nearest) == 0
    if off.any():
        time = times[np.argmax(off)]
        why = f"step: {len(steps)} steps to t = {ends[-1]:.10g}, none of which ends at t = {time:.10g}"
        raise BadInput(why)
    return nearest + 1


def plateaus(steps: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return runs of n[k] equal steps of size h[k], and the runs that end at the times, as (h, n, saved)."""
    last = steps_until(steps, times) - 1
    changes = np.abs(np.diff(steps)) > EQUAL * steps[1:]
    changes = np.append(changes, True)
    changes[last] = True
    ends = np.flatnonzero(changes) + 1
    n = np.diff(ends, prepend=0)
    spans, saved = np.add.reduceat(steps, ends - n), np.searchsorted(ends, last + 1)
    spans[saved] += np.diff(times, prepend=0.0) - np.add.reduceat(spans, np.append(0, saved[:-1] + 1))
    return spans / n, n, saved


def ends_between(spans: np.ndarray, last: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the ends of spans; the spans with the numbers `last` end at `times`, and sums start anew at each."""
    group, sums = np.searchsorted(last, np.arange(len(spans))), np.cumsum(spans)
    ends: np.ndarray = np.append(0.0, times)[group] + (sums - np.append(0.0, sums[last])[group])
    ends[last] = times
    return ends
