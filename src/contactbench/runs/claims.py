"""Is it true?  One cell: a claim of the paper, or the data of one of its figures."""

from __future__ import annotations

from collections.abc import Iterable

from contactbench.paper import CLAIMS, curves
from contactbench.runs.experiment import Cell, Profile, Recorded, experiment
from contactbench.tables.declared import CLAIMS_TABLE, PAPER_FIGURES

#: claims that take longer than a second, which the smoke profile leaves out
NUMBERS = (1, 3, 4, 5, 12, 15, 18, 20, 22, 24, 26, 33, 34, 37, 39, 41, 44, 45, 47, 48, 54, 55, 56, 57, 58)
LONG = {f"C{n:02d}" for n in NUMBERS} | {"X02", "X03"}


def some(names: Iterable[str], profile: Profile) -> list[Cell]:
    return [(name,) for name in names if not profile.brief or name not in LONG]


@experiment(lambda profile: some(CLAIMS, profile))
def claim(cell: Cell, profile: Profile) -> Recorded:
    row = CLAIMS[cell[0]].row()
    yield CLAIMS_TABLE, row
    assert row["status"] == "ok", row["message"]


@experiment(lambda profile: some(curves.FIGURES, profile))
def paper_figure(cell: Cell, profile: Profile) -> Recorded:
    yield from ((PAPER_FIGURES, row) for row in curves.rows(cell[0]))
