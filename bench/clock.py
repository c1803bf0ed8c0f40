"""Timed rounds, and every timed cell twice: what two measurements of one cell differ by is the noise.

A run comes to a timed cell at two places of its shuffled order.  The first visit prepares the solver, runs
it for its errors and counts, and times it; the second times the same prepared solver again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

from contactbench.measure.clock import VISITS, Samples, calls_a_round, rounds_within, time_columns


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
        iterations = cell.iterations if cell.measured else calls_a_round(once)
        rounds = rounds_within(self.profile.seconds / VISITS, iterations * once)
        self.benchmark.group = group
        self.benchmark.pedantic(run, rounds=rounds, iterations=iterations)
        return list(self.benchmark.stats.stats.data), iterations
