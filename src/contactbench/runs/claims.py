"""Check the claims of the paper; a cell is a claim, or the data of one figure."""

from __future__ import annotations

from contactbench.paper import CLAIMS, curves
from contactbench.runs.experiment import Cell, Profile, Recorded, experiment
from contactbench.tables.declared import CLAIMS_TABLE, MOTION


@experiment(lambda profile: [(name,) for name, item in CLAIMS.items() if not (profile.brief and item.dear)])
def claim(cell: Cell, profile: Profile) -> Recorded:
    row = CLAIMS[cell[0]].row()
    yield CLAIMS_TABLE, row
    assert row["status"] == "ok", row["message"]


@experiment(lambda profile: [(name,) for name in curves.FIGURES])
def paper_figure(cell: Cell, profile: Profile) -> Recorded:
    yield from ((MOTION, row) for row in curves.rows(cell[0]))
