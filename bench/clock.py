"""Timed rounds, and every timed cell twice: what two measurements of one cell differ by is the noise.

A run comes to a timed cell at two places of its shuffled order.  The first visit prepares the solver, runs
it for its errors and counts, and times it; the second times the same prepared solver again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

VISITS = 2
#: seconds a round takes at least, so that the clock's resolution plays no part
ROUND_SECONDS = 1e-3
#: rounds of one visit
FEWEST_ROUNDS, MOST_ROUNDS = 3, 20

Samples = list[float]  #: seconds per call, one number a round


@dataclass
class Cell:
    """What the first visit leaves to the second: what the cell prepared, and what the clock said."""

    made: Any
    measured: list[Samples] = field(default_factory=list)
    iterations: int = 1


@dataclass
class Clock:
    """The clock of one visit.

    cells : what is left of the cells visited once.  benchmark : the fixture of pytest-benchmark; with
    --benchmark-disable a run is for accuracy alone, on all cores, and has no times.
    """

    cells: dict[Any, Cell]
    key: Any
    profile: Any
    benchmark: Any

    def prepared(self, make: Callable[[], Any]) -> Any:
        """What `make` gives, made by the first visit; anew where that was in a run that was killed."""
        if self.key not in self.cells:
            self.cells[self.key] = Cell(make())
        return self.cells[self.key].made

    def columns(self, run: Callable[[], Any] | None, group: str) -> dict[str, Any]:
        """The time columns, from all visits so far; none where there is nothing to run."""
        if run is None or self.benchmark.disabled:
            self.cells.pop(self.key)
            return {}
        return self.add(*self.rounds(run, group))

    def add(self, samples: Samples, iterations: int) -> dict[str, Any]:
        """The time columns, with the samples of this visit."""
        cell = self.cells[self.key]
        cell.measured.append(samples)
        cell.iterations = iterations
        if len(cell.measured) == VISITS:
            del self.cells[self.key]
        return time_columns(cell.measured, cell.iterations)

    def rounds(self, run: Callable[[], Any], group: str) -> tuple[Samples, int]:
        """Rounds of about a millisecond, as many as the profile fills, after a warm-up."""
        start = perf_counter()
        run()
        once = perf_counter() - start
        cell = self.cells[self.key]
        iterations = cell.iterations if cell.measured else max(1, round(ROUND_SECONDS / once))
        wanted = round(self.profile.seconds / VISITS / (iterations * once))
        rounds = min(MOST_ROUNDS, max(FEWEST_ROUNDS, wanted))
        self.benchmark.group = group
        self.benchmark.pedantic(run, rounds=rounds, iterations=iterations)
        return list(self.benchmark.stats.stats.data), iterations


def time_columns(measured: list[Samples], iterations: int) -> dict[str, Any]:
    """The time columns from the samples of one or two visits."""
    together = np.concatenate(measured)
    low, median, high = np.percentile(together, (25, 50, 75)).tolist()
    times = {
        "time_min_s": float(together.min()), "time_median_s": median, "time_iqr_s": high - low,
        "rounds": len(together), "iterations": iterations,
    }  # fmt: skip
    if len(measured) == VISITS:
        first, second = map(np.median, measured)
        times["time_repeat_ratio"] = float(second / first)
    return times
