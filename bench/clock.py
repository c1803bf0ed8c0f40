"""Timed rounds, and every timed cell twice: what two measurements of one cell differ by is the noise.

A run comes to a timed cell at two places of its shuffled order.  The first visit prepares the solver and
times it; the second times the same prepared solver again.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from contactbench.measure.clock import (
    VISITS,
    WARM,
    Samples,
    calls_a_round,
    length_columns,
    rounds_within,
    seconds,
    time_columns,
    warm_call,
)

#: rounds of the first visit and of the second, however long they take: five in all (after a kill between them three)
FEWEST = (3, 2)


@dataclass
class Cell:
    """What the first visit leaves to the second: what the cell prepared, and what the clock said.

    once : seconds a call takes, about; nan while nobody knows.
    """

    made: Any
    once: float = math.nan
    measured: list[Samples] = field(default_factory=list)
    iterations: int = 1
    #: of the same run over a part of its length, in turns with `measured`
    shorter: list[Samples] = field(default_factory=list)


@dataclass
class Part:
    """The same run over a share of its span: what it takes tells fixed from marginal cost."""

    run: Callable[[], Any]
    share: float
    span: float


@dataclass
class Clock:
    """The clock of one visit.

    cells : what is left of the cells visited once.  benchmark : the fixture of pytest-benchmark; with
    --benchmark-disable a run is for accuracy alone, on all cores, and has no times.
    last : whether the run comes to the cell no more; the first visit may have been of a run that was killed.
    """

    cells: dict[Any, Cell]
    key: Any
    profile: Any
    benchmark: Any
    last: bool = True

    def prepared(self, make: Callable[[], Any]) -> Any:
        """What `make` gives, made by the first visit; anew where that was in a run that was killed."""
        if self.key not in self.cells:
            self.cells[self.key] = Cell(make())
        return self.cells[self.key].made

    def columns(self, run: Callable[[], Any] | None, group: str, part: Part | None = None) -> dict[str, Any]:
        """The time columns, from all visits so far; none where there is nothing to run.

        part : timed in turns with it.
        """
        if run is None or self.benchmark.disabled:
            self.cells.pop(self.key)
            return {}
        cell = self.cells[self.key]
        columns = self.add(*self.rounds(run, group, part))
        if part is not None:
            columns |= length_columns(cell.measured, cell.shorter, part.share, part.span)
        return columns

    def add(self, samples: Samples, iterations: int) -> dict[str, Any]:
        """The time columns, with the samples of this visit."""
        cell = self.cells[self.key]
        cell.measured.append(samples)
        cell.iterations = iterations
        if len(cell.measured) == VISITS:
            del self.cells[self.key]
        return time_columns(cell.measured, cell.iterations)

    def rounds(self, run: Callable[[], Any], group: str, part: Part | None = None) -> tuple[Samples, int]:
        """Rounds of about half a millisecond, as many as the profile fills, after a warm-up.

        A run whose part is long is warm once that has been called, a second visit to it finds it warm.
        """
        cell = self.cells[self.key]
        if math.isnan(cell.once) and part is not None:
            cell.once = warm_call(part.run) / part.share
        if not cell.once > WARM:
            cell.once = warm_call(run)
        iterations = cell.iterations if cell.measured else calls_a_round(cell.once)
        fewest = FEWEST[len(cell.measured)]
        rounds = rounds_within(self.profile.seconds / VISITS, iterations * cell.once, fewest)
        self.benchmark.group = group
        shorter: Samples = []

        def between() -> None:
            if part is not None and len(shorter) < rounds:
                shorter.append(seconds(part.run, iterations))

        self.benchmark.pedantic(run, rounds=rounds, iterations=iterations, teardown=between)
        cell.shorter.append(shorter)
        return list(self.benchmark.stats.stats.data), iterations
