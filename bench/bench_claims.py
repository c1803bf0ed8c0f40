"""Is it true?  One cell: a claim of the paper, or the data of one of its figures."""

from __future__ import annotations

from cells import cells
from contactbench.claims import CLAIMS
from contactbench.claims.curves import FIGURES, rows
from contactbench.results.tables import CLAIMS_TABLE, PAPER_FIGURES


def some(names, profile):
    """All of them, or every sixth in the smoke profile."""
    return [(name,) for name in names][:: 1 if profile.points > 1 else 6]


@cells(lambda profile: some(CLAIMS, profile))
def test_claim(cell, record):
    row = CLAIMS[cell[0]].row()
    record(CLAIMS_TABLE, **row)
    assert row["status"] == "ok", row["message"]


@cells(lambda profile: some(FIGURES, profile))
def test_paper_figure(cell, record_all):
    record_all(PAPER_FIGURES, rows(cell[0]))
