"""Declare the tables of the benchmark, whose columns tables.toml defines."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from contactbench.errors import BadInput
from contactbench.measure.law import JUDGEMENT
from contactbench.measure.laws import LAWS
from contactbench.tables.schema import TABLES, Column, Rule, Table

if TYPE_CHECKING:
    import pandas as pd

type Data = Mapping[str, Any]  #: parsed TOML
DECLARED: Data = tomllib.loads(Path(__file__).with_name("tables.toml").read_text(encoding="utf-8"))
#: why the verdict on a law has no rule
FOLLOWS = "it follows from the deviation, which is compared, and the bound of round-off"


def law_columns(name: str) -> dict[str, Column]:
    """Return the column of a law; for a structural law also whether it is claimed and kept."""
    law = LAWS[name]
    columns = {name: Column(law.definition, "number", Rule[law.gate.value], label=law.label)}
    if law.structural:
        about = {what: f"{name}: {meaning}" for what, meaning in JUDGEMENT.items()}
        columns[f"{name}_claimed"] = Column(about["claimed"], "flag", Rule.same)
        columns[f"{name}_kept"] = Column(about["kept"], "answer", ungated=FOLLOWS)
    return columns


def columns(declared: Data) -> dict[str, Column]:
    found: dict[str, Column] = {}
    for name, entry in declared.items():
        if entry == "law":
            found |= law_columns(name)
        else:
            found[name] = Column(**{**entry, **({"rule": Rule[entry["rule"]]} if "rule" in entry else {})})
    return found


#: the laws of this package; only the laws in tables.toml have a column
OWN_LAWS = frozenset(LAWS)


def brought() -> dict[str, Column]:
    """Return the columns of the laws that plug-ins bring."""
    return {name: column for law in LAWS if law not in OWN_LAWS for name, column in law_columns(law).items()}


def declare(name: str) -> Table:
    given: Data = DECLARED["tables"][name]
    lists: Data = {part: tuple(given[part]) for part in ("key", "whole") if part in given}
    more = brought if "law" in given["columns"].values() else dict
    table = Table(name, given["about"], columns(given["columns"]), **lists, more=more)
    TABLES.add(table)
    return table


RUNS = declare("runs")
TIMES = declare("times")
ORDERS = declare("orders")
LIMITS = declare("limits")
RING = declare("ring")
PROBLEMS = declare("problems")
POPULATION = declare("population")
CLAIMS_TABLE = declare("claims")
MOTION = declare("motion")


# -- tables shipped with the package -----------------------------------------------------------------
def shipped_folder() -> Path | None:
    here = Path(__file__).resolve()
    for folder in (here.parents[3] / "results", here.parents[1] / "_results"):
        if any(folder.glob("*.csv")):
            return folder
    return None


def results(name: str, folder: Path | str | None = None) -> pd.DataFrame:
    """Return a result table as the benchmark wrote it, with typed columns.

    ``attrs["columns"]`` says what each column means.

    Parameters
    ----------
    name
        "runs", "times", "orders", "limits", "ring", "problems", "population", "claims" or "motion".
    folder
        The results folder of your own run; by default the tables shipped with the package.

    Returns
    -------
    DataFrame
        The rows of the table.

    Raises
    ------
    BadInput
        For an unknown name or absent tables.

    Examples
    --------
    >>> import contactbench as cb
    >>> runs = cb.results("runs")
    >>> runs.attrs["columns"].keys() == set(runs.columns)
    True
    """
    from contactbench.tables.store import read  # slow to import, as pandas is

    table = TABLES[name]
    where = shipped_folder() if folder is None else Path(folder)
    if where is None:
        raise BadInput(
            "no result tables in this installation; give the folder of a run: results(name, folder)"
        )
    if not table.path(where).is_file():
        raise BadInput(f"folder = {str(where)!r}: has no table {name!r}")
    frame = read(table, where)
    frame.attrs["columns"] = {key: column.meaning for key, column in table.columns.items()}
    return frame
