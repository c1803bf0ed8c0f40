"""What an experiment is: the cells that a profile runs, the rows of a cell, and what is timed of them.

A module of this package holds experiments, and is found without being listed.  One makes rows::

    @experiment(cells)                     # cells(profile) -> tuples that name what is run
    def ring(cell, profile):
        yield RING, {"scene": …, "method": …, …}

and another times them, in a process alone on its core, after all rows are made::

    @timed(ring)
    def ring_times(row):                   # a row that `ring` has made; None: it is not timed
        key = {"scene": "chaotic_ring", "method": row["method"], …}   # of a row of times.csv
        return Timing(key, beginning, (row["method"], row["setting"]), row["energy_error"])

where ``beginning(method, setting)`` prepares, here or in a second process, and returns what times.csv says of it beside
the clock's numbers (compile_s, first_s; or nothing) and the `Call`.
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
    """How much is run; visits : to what is timed."""

    name: str
    visits: int

    @property
    def brief(self) -> bool:
        return self.name == NAMES[0]

    def reaches(self, name: str) -> bool:
        """Whether it runs what another profile does."""
        return NAMES.index(name) <= NAMES.index(self.name)


PROFILES = {name: Profile(name, MOST_VISITS if name == NAMES[-1] else VISITS) for name in NAMES}


@dataclass(frozen=True)
class Timing:
    """What is timed of a row.

    key : of its row in times.csv.  prepare : gives, of the arguments, more columns of that row and the call; another
    process may be asked for both.  error : of the run, by which contestants are told.
    """

    key: Row
    prepare: Callable[..., tuple[Row, Call]]
    arguments: tuple[object, ...]
    error: float


@dataclass(frozen=True)
class Experiment:
    """Cells of one kind, and how each is measured.

    question : its module.  rows : of a cell in a
    profile, each with its table.  timing : instead, what is timed of a row that the experiment `of` has made.
    """

    question: str
    name: str
    cells: Callable[[Profile], list[Cell]]
    rows: Callable[[Cell, Profile], Recorded] = lambda cell, profile: iter(())
    timing: Callable[[Row], Timing | None] | None = None
    of: Experiment | None = None

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


def timed(of: Experiment) -> Callable[[Callable[[Row], Timing | None]], Experiment]:
    """Make an experiment, of its name, of the function that says what is timed of a row of another one."""
    return lambda timing: add(timing, cells=of.cells, timing=timing, of=of)


def add(function: Callable[..., object], **given: Any) -> Experiment:
    question = function.__module__.rpartition(".")[2]
    EXPERIMENTS.append(Experiment(question, function.__name__, **given))
    return EXPERIMENTS[-1]


@cache
def experiments() -> dict[str, Experiment]:
    """Return all experiments by their names, question by question."""
    import_modules(__package__)
    return {each.name: each for each in sorted(EXPERIMENTS, key=lambda each: each.question)}
