"""Is it true?  One cell: a claim of the paper, or the data of one of its figures."""

from cells import cells
from contactbench.claims import CLAIMS
from contactbench.claims.curves import FIGURES, rows
from contactbench.results.tables import CLAIMS_TABLE, PAPER_FIGURES

#: claims that take longer than a second, which the smoke profile leaves out
LONG = {f"C{n:02d}" for n in (3, 4, 5, 15, 18, 20, 22, 24, 26, 33, 34, 37, 39, 41)} | {"X02", "X03"}


def some(names, profile):
    return [(name,) for name in names if profile.points > 1 or name not in LONG]


@cells(lambda profile: some(CLAIMS, profile))
def test_claim(cell, record):
    row = CLAIMS[cell[0]].row()
    record(CLAIMS_TABLE, row)
    assert row["status"] == "ok", row["message"]


@cells(lambda profile: some(FIGURES, profile))
def test_paper_figure(cell, record):
    record(PAPER_FIGURES, *rows(cell[0]))
