"""The result tables that come with the package."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from contactbench.errors import BadInput

if TYPE_CHECKING:
    import pandas as pd


def shipped_folder() -> Path | None:
    """Where the tables are: beside the sources, or inside the installed package."""
    here = Path(__file__).resolve()
    for folder in (here.parents[3] / "results", here.parents[1] / "_results"):
        if any(folder.glob("*.csv")):
            return folder
    return None


def results(name: str, folder: Path | str | None = None) -> pd.DataFrame:
    """A result table as the benchmark wrote it: typed columns, times included.

    name : of a table, such as "laws", "work_precision", "stability", "claims", "ensemble".
    folder : of a run of your own; by default the tables that came with the package.
    ``attrs["columns"]`` says what each column means.  Raises `BadInput` for an unknown name or absent tables.
    """
    from contactbench.results.schema import TABLES
    from contactbench.results.store import read

    table = TABLES[name]
    where = shipped_folder() if folder is None else Path(folder)
    if where is None:
        raise BadInput(
            "no result tables in this installation; give the folder of a run, results(name, folder)"
        )
    if not table.path(where).is_file():
        raise BadInput(f"folder = {str(where)!r}: has no table {name!r}")
    frame = read(table, where)
    frame.attrs["columns"] = {key: column.meaning for key, column in table.every_column.items()}
    return frame
