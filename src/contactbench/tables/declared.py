"""The tables of the benchmark, one per question: tables.toml says what their columns are."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from contactbench.errors import BadInput
from contactbench.measure.law import JUDGEMENT
from contactbench.measure.laws import LAWS
from contactbench.tables.schema import TABLES, Column, Rule, Table

if TYPE_CHECKING:
    import pandas as pd

type Data = Mapping[str, Any]  #: what is read from tables.toml
DECLARED: Data = tomllib.loads(Path(__file__).with_name("tables.toml").read_text(encoding="utf-8"))
#: why a column has no rule
FOLLOWS = "it follows from the deviation, which is compared, and what round-off may amount to"


def column(entry: Data) -> Column:
    rule = {"rule": Rule[entry["rule"]]} if "rule" in entry else {}
    return Column(**{**entry, **rule})


GROUPS = {
    f"+{group}": {name: column(entry) for name, entry in entries.items()}
    for group, entries in DECLARED["groups"].items()
}
COMMON = GROUPS["+common"]


def law_columns(names: Iterable[str]) -> dict[str, Column]:
    """Return the columns of laws, then those of the judgement of each that is structural."""
    columns, laws = {}, {name: LAWS[name] for name in names}
    for name, law in laws.items():
        kind: Literal["whole", "number"] = "whole" if law.gate.value == "count" else "number"
        label = law.label or name.replace("_", " ")
        columns[name] = Column(law.definition, kind, Rule[law.gate.value], label=label, shown=law.shown)
    for name in [name for name, law in laws.items() if law.structural]:
        about = {what: f"{name}: {meaning}" for what, meaning in JUDGEMENT.items()}
        columns[f"{name}_claimed"] = Column(about["claimed"], "flag", Rule.same)
        for what in ("kept", "undecided"):
            columns[f"{name}_{what}"] = Column(about[what], "answer", ungated=FOLLOWS)
        columns[f"{name}_bound"] = Column(about["bound"], "number", ungated=FOLLOWS)
    return columns


def columns(declared: Data) -> dict[str, Column]:
    found: dict[str, Column] = {}
    for name, entry in declared.items():
        if name.startswith("+laws"):
            found |= law_columns(LAWS if entry is True else entry)
        else:
            found |= GROUPS.get(name) or {name: column(entry)}
    return found


def declare(name: str) -> Table:
    given: Data = DECLARED["tables"][name]
    own = given["columns"]
    more: Data = {k: tuple(v) if isinstance(v, list) else v for k, v in given.items() if k != "columns"}
    by_law = any(entry.startswith("+laws") for entry in own)  # depend on what is registered
    table = Table(name, declared=(lambda: columns(own)) if by_law else columns(own), **more)
    TABLES.add(table)
    return table


CONVERGENCE = declare("convergence")
LAWS_TABLE = declare("laws")
LAWS_TIME = declare("laws_time")
MOTION = declare("motion")
DECAY_LAWS = declare("decay_laws")
WORK_PRECISION = declare("work_precision")
DEFINITIONS = declare("definitions")
CLAIMS_TABLE = declare("claims")
PAPER_FIGURES = declare("paper_figures")
STABILITY = declare("stability")
STABILITY_LIMITS = declare("stability_limits")
DAMPING_RATES = declare("damping_rates")
STRONG_DAMPING = declare("strong_damping")
STRUCTURE_BUYS = declare("structure_buys")
POPULATION = declare("population")
POPULATION_PROBLEMS = declare("population_problems")
POPULATION_HARD = declare("population_hard")
#: what the motion is compared with, and over which time at its end the orbit is drawn
TRUTH, ORBIT = "truth", 14.4


# -- those that come with the package ----------------------------------------------------------------
def shipped_folder() -> Path | None:
    here = Path(__file__).resolve()
    for folder in (here.parents[3] / "results", here.parents[1] / "_results"):
        if any(folder.glob("*.csv")):
            return folder
    return None


def results(name: str, folder: Path | str | None = None) -> pd.DataFrame:
    """Return a result table as the benchmark wrote it: typed columns, times included.

    ``attrs["columns"]`` says what each column means.

    Parameters
    ----------
    name
        Of a table, such as "laws", "work_precision", "stability", "claims".
    folder
        Of a run of your own; by default the tables that came with the package.

    Returns
    -------
    DataFrame
        A row for each cell: scene × method × engine × setting, or what the table is about.

    Raises
    ------
    BadInput
        For an unknown name or absent tables.

    Examples
    --------
    >>> import contactbench as cb
    >>> laws = cb.results("laws")
    >>> laws.attrs["columns"].keys() == set(laws.columns)
    True
    """
    from contactbench.tables.store import read  # takes long to load, as pandas does

    table = TABLES[name]
    where = shipped_folder() if folder is None else Path(folder)
    if where is None:
        raise BadInput("no result tables in this installation; give that of a run, results(name, folder)")
    if not table.path(where).is_file():
        raise BadInput(f"folder = {str(where)!r}: has no table {name!r}")
    frame = read(table, where)
    frame.attrs["columns"] = {key: column.meaning for key, column in table.every_column.items()}
    return frame
