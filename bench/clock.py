"""Timed rounds, and every timed cell twice: what two measurements of one cell differ by is the noise.

A run comes to a timed cell at two places of its shuffled order.  The first visit prepares the solver, runs
it for its errors and counts, and times it; the second times the same prepared solver again.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

from contactbench.measure.clock import LONG, VISITS, Samples, calls_a_round, rounds_within, time_columns


@dataclass
class Cell:
    """What the first visit leaves to the second: what the cell prepared, and what the clock said.

    once : seconds a call takes, about; nan while nobody knows.
    """

    made: Any
    once: float = math.nan
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

    def columns(
        self, run: Callable[[], Any] | None, group: str, first_call_s: float = math.nan
    ) -> dict[str, Any]:
        """The time columns, from all visits so far; none where there is nothing to run.

        first_call_s : what a call of this run took a moment ago, at the first visit.
        """
        if run is None or self.benchmark.disabled:
            self.cells.pop(self.key)
            return {}
        if math.isnan(self.cells[self.key].once):
            self.cells[self.key].once = first_call_s
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
        """Rounds of about a millisecond, as many as the profile fills, after a warm-up.

        A run that is long warms itself up.
        """
        cell = self.cells[self.key]
        if not cell.once > LONG:
            start = perf_counter()
            run()
            cell.once = perf_counter() - start
        iterations = cell.iterations if cell.measured else calls_a_round(cell.once)
        rounds = rounds_within(self.profile.seconds / VISITS, iterations * cell.once)
        self.benchmark.group = group
        self.benchmark.pedantic(run, rounds=rounds, iterations=iterations)
        return list(self.benchmark.stats.stats.data), iterations
