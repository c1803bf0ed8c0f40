"""Define experiments: the cells of a profile, the rows of a cell, and the calls to time.

Every module of this package may hold experiments.  One kind makes rows::

    @experiment(cells)                     # cells(profile) -> list of tuples, one per cell
    def ring(cell, profile):
        yield RING, {"scene": …, "method": …, …}

and the other times them after all rows are made, in a process alone on its core::

    @timed(ring)
    def ring_times(row):                   # a row of `ring`; return None if it is not timed
        key = {"scene": "chaotic_ring", "method": row["method"], …}   # of a row of times.csv
        return Timing(key, beginning, (row["method"], row["setting"]), row["energy_error"])

where ``beginning(method, setting)`` prepares the run, here or in a second process, and returns further columns of
times.csv (compile_s, first_s, or none) and the `Call`.
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
    """Set the amount of work; visits : number of visits to each timed call."""

    name: str
    visits: int

    @property
    def brief(self) -> bool:
        return self.name == NAMES[0]

    def reaches(self, name: str) -> bool:
        """Return whether this profile includes another one."""
        return NAMES.index(name) <= NAMES.index(self.name)


PROFILES = {name: Profile(name, MOST_VISITS if name == NAMES[-1] else VISITS) for name in NAMES}


@dataclass(frozen=True)
class Timing:
    """Describe the call to time for a row.

    key : its key in times.csv.  prepare : ``prepare(*arguments)`` returns further columns of that row and the call; a
    second process may call it too.  error : the error of the run, which selects its rivals.
    """

    key: Row
    prepare: Callable[..., tuple[Row, Call]]
    arguments: tuple[object, ...]
    error: float


@dataclass(frozen=True)
class Experiment:
    """Hold cells of one kind and the function that measures them.

    question : its module.  rows : yields the rows of a cell in a profile, each with its table.  timing : instead of
    rows, returns the `Timing` of a row of the experiment `of`.
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


@cache  # called for each of thousands of cells
def cells_of(experiment: Experiment, profile: Profile) -> frozenset[Cell]:
    return frozenset(experiment.cells(profile))


EXPERIMENTS: list[Experiment] = []


def experiment(
    cells: Callable[[Profile], list[Cell]],
) -> Callable[[Callable[[Cell, Profile], Recorded]], Experiment]:
    """Return a decorator that registers a function yielding the rows of a cell, under its name."""
    return lambda rows: add(rows, cells=cells, rows=rows)


def timed(of: Experiment) -> Callable[[Callable[[Row], Timing | None]], Experiment]:
    """Return a decorator that registers a function returning the `Timing` of a row of the experiment `of`."""
    return lambda timing: add(timing, cells=of.cells, timing=timing, of=of)


def add(function: Callable[..., object], **given: Any) -> Experiment:
    question = function.__module__.rpartition(".")[2]
    EXPERIMENTS.append(Experiment(question, function.__name__, **given))
    return EXPERIMENTS[-1]


@cache
def experiments() -> dict[str, Experiment]:
    """Return all experiments by name, sorted by module."""
    import_modules(__package__)
    return {each.name: each for each in sorted(EXPERIMENTS, key=lambda each: each.question)}
