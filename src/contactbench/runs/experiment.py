"""What an experiment is: the cells that a profile runs, and the rows of a cell.

A question is a module of this package, found without being listed; it decorates the function that gives a cell's rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

from contactbench.measure.clock import MOST_VISITS, VISITS, Call
from contactbench.registry import import_modules
from contactbench.tables.schema import PROFILES as NAMES
from contactbench.tables.schema import Table

type Cell = tuple[Any, ...]
type Row = dict[str, Any]
type Recorded = Iterator[tuple[Table, Row]]


@dataclass(frozen=True)
class Profile:
    """How much is run: settings of a method, visits to a cell, the budget of a solver that calls back into Python."""

    name: str
    points: int
    visits: int
    callback_evaluations: int

    @property
    def brief(self) -> bool:
        return self.points == 1

    def reaches(self, name: str) -> bool:
        """Whether it runs what another profile does."""
        return NAMES.index(name) <= NAMES.index(self.name)

    def choose(self, ladder: list[float]) -> list[float]:
        """`points` of a ladder, spread over it; a single one is among those of the standard profile."""
        if self.points >= len(ladder):
            return ladder
        if self.brief:
            spread = PROFILES["standard"].choose(ladder)
            return [spread[len(spread) // 3]]
        last = len(ladder) - 1
        return [ladder[round(i * last / (self.points - 1))] for i in range(self.points)]


PROFILES = {
    "smoke": Profile("smoke", 1, VISITS, 40_000),  # the budget of standard: the same rows, the same ends
    "standard": Profile("standard", 6, VISITS, 40_000),
    "full": Profile("full", 99, MOST_VISITS, 1_000_000),
}


@dataclass(frozen=True)
class Timing:
    """What is timed of a cell, and the table its row goes to.

    prepare : gives, of the arguments, what the row says beside its times, and the call;
    another process may be asked for both.
    """

    table: Table
    prepare: Callable[..., tuple[Row, Call]]
    arguments: tuple[object, ...]


@dataclass(frozen=True)
class Experiment:
    """Cells of one kind, and how each is measured.

    question : its module; when all cells of a question are done, other rows of its tables go.  rows : of a cell in a
    profile, each with its table.  timing : instead, what is timed, of a cell and its row without times.  errors : of
    what is timed, the experiment of the same cells that makes those rows; a run without a clock has it alone.
    """

    question: str
    name: str
    cells: Callable[[Profile], list[Cell]]
    rows: Callable[[Cell, Profile], Recorded] = lambda cell, profile: iter(())
    timing: Callable[[Cell, Profile, Row], Timing] | None = None
    errors: Experiment | None = None

    @property
    def timed(self) -> bool:
        return self.timing is not None

    def profile_of(self, cell: Cell) -> str:
        """Return the smallest profile that has a cell."""
        return next(name for name, profile in PROFILES.items() if cell in cells_of(self, profile))


@cache  # asked for once a cell, of thousands, it would cost as much as what is measured
def cells_of(experiment: Experiment, profile: Profile) -> frozenset[Cell]:
    return frozenset(experiment.cells(profile))


EXPERIMENTS: list[Experiment] = []


def experiment(
    cells: Callable[[Profile], list[Cell]],
) -> Callable[[Callable[[Cell, Profile], Recorded]], Experiment]:
    """Make an experiment, of its name, of the function that gives the rows of a cell."""
    return lambda rows: add(rows, cells=cells, rows=rows)


def timed_experiment(
    cells: Callable[[Profile], list[Cell]], errors: Experiment
) -> Callable[[Callable[[Cell, Profile, Row], Timing]], Experiment]:
    """Make an experiment, of its name, of the function that says what is timed of a cell and its row."""
    return lambda timing: add(timing, cells=cells, timing=timing, errors=errors)


def add(function: Callable[..., object], **given: Any) -> Experiment:
    question = function.__module__.rpartition(".")[2]
    EXPERIMENTS.append(Experiment(question, function.__name__, **given))
    return EXPERIMENTS[-1]


@cache
def experiments() -> dict[str, Experiment]:
    """Return all experiments by their names, question by question."""
    import_modules(__package__)
    return {each.name: each for each in sorted(EXPERIMENTS, key=lambda each: each.question)}
