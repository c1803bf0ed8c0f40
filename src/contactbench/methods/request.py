"""The registry of methods, and the question that one of them is asked: what to solve, how finely, what to save."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from contactbench.errors import BadInput, Registry, array, excerpt
from contactbench.scene import Scene
from contactbench.solution import EXACT, setting_key

#: name → method, each a `base.Method`
METHODS = Registry("method")
#: Python's way to say inf or nan
NO_NUMBER = (OverflowError, ZeroDivisionError, ValueError)


@dataclass(frozen=True)
class Request:
    """A validated question to a method: what to solve, how finely, and what to save."""

    scene: Scene
    engine: str
    carry: tuple[str, ...]
    save_at: np.ndarray
    step: float | None = None
    rtol: float | None = None
    atol: float | None = None
    max_steps: int = 10**8

    @property
    def control(self) -> str:
        """What is set: "step", "rtol" or nothing, "exact"."""
        return "step" if self.step is not None else "rtol" if self.rtol is not None else EXACT

    @property
    def value(self) -> float:
        """To what it is set; 0 for nothing."""
        return self.step or self.rtol or 0.0

    @cached_property
    def setting(self) -> str:
        """The setting as it is keyed in tables."""
        return setting_key(self.control, self.value)


# -- saved times, and how many equal steps lead from one to the next ---------------------------------
#: saved times when the caller names none: every k-th step with at most this many for fixed steps,
#: this many equal intervals for adaptive methods
DEFAULT_SAVES = 1000
ADAPTIVE_SAVES = 200


def default_times(scene: Scene, step: float | None, budget: int) -> np.ndarray:
    if step is None:
        return np.linspace(0.0, scene.t_end, ADAPTIVE_SAVES + 1)
    n = steps_in(scene.t_end, step)
    if n > budget:  # will end as `budget`; no grid of that size is needed
        return np.array([scene.t_end])
    stride = -(-n // DEFAULT_SAVES)
    marks = np.append(np.arange(0, n, stride), n)
    return marks * (scene.t_end / n)


def saved_times(save_at: Any) -> np.ndarray:
    times = np.array(array("save_at", save_at, "increasing times"), ndmin=1)  # a copy
    if times.ndim != 1 or not len(times) or not np.all(np.isfinite(times)):
        raise BadInput(f"save_at = {excerpt(save_at)}: must be finite times, at least one")
    if times[0] < 0 or np.any(np.diff(times) <= 0):
        raise BadInput("save_at: times must be ≥ 0 and strictly increasing")
    if len(times) == 1 and times[0] == 0:
        raise BadInput("save_at: at least one time must be > 0")
    return long_enough(times)


def long_enough(times: np.ndarray) -> np.ndarray:
    """The times, or `BadInput` where a run is so short that its steps would be zero."""
    if times[-1] < SHORTEST_RUN:
        raise BadInput(f"the run ends at t = {times[-1]:.3g}: must be {SHORTEST_RUN:g} or later")
    return times


#: parts of a shorter run are no longer normal numbers
SHORTEST_RUN = 1e-290
#: more steps than any budget allows are counted as this many
UNCOUNTED = 2**50
#: how far the difference of two saved times may be off, in units of the last place of the later one: both are
#: rounded, as a product or a sum of two, and so may be the spacing of the grid
GRID_ULPS = 4


def steps_in(span: float, step: float, until: float | None = None) -> int:
    """The fewest equal steps that cover `span` without exceeding `step` (up to round-off).

    until : the time at which the interval ends, by default `span`.  The difference of two saved times has
    their round-off, which for short intervals late in a run is far above that of the interval itself.
    """
    round_off = GRID_ULPS * math.ulp(span if until is None else until)
    ratio = (span * (1 - 1e-12) - round_off) / step
    return max(1, math.ceil(ratio)) if ratio < UNCOUNTED else UNCOUNTED
