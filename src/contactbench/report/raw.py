"""A table as it is: every column that says anything, for a page that sorts; a document names its CSV."""

from __future__ import annotations

import pandas as pd

from contactbench.report.cells import Head, View, number, word
from contactbench.report.numbers import readable, upper
from contactbench.results.schema import Table

#: a table with more cells is left to its CSV
MOST_CELLS = 8_000


def raw(table: Table, frame: pd.DataFrame) -> View:
    """The table's rows; those of a table with too many cells are left to its CSV."""
    shown = [name for name in table.columns if name in frame and frame[name].notna().any()]
    large = len(shown) * len(frame) > MOST_CELLS
    words = {name for name in shown if table.columns[name].type in ("text", "flag", "answer")}
    rows = [] if large else [
        tuple(word(v) if name in words else number(v, readable) for name, v in zip(shown, row, strict=True))
        for row in frame[shown].itertuples(index=False)
    ]  # fmt: skip
    heads = tuple(
        Head(table.columns[name].label or name.replace("_", " "), table.columns[name].meaning, name in words)
        for name in shown
    )
    about = upper(table.about)
    meaning = f"{about}: {len(frame)} rows{', too many to show here' if large else ''}."
    return View(
        f"raw_{table.name}",
        f"All rows: {table.name}",
        meaning,
        heads,
        tuple(rows),
        f"{table.name}.csv",
        detail=True,
    )
