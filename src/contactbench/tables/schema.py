"""Define result tables: typed columns, the rule by which each may differ between two runs, and the registry.

The key columns of a table identify a row of NAME.csv.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from contactbench.errors import BadInput
from contactbench.measure.law import STRUCTURE
from contactbench.registry import Registry

if TYPE_CHECKING:
    import pandas as pd

#: the values of a row by column
type Row = Mapping[str, object]

#: amounts of work, increasing; each profile makes all rows of the smaller ones
PROFILES = ("smoke", "standard", "full")
SEPARATOR = " // "  #: between the measurements in one text
BEYOND = "beyond the paper"  #: the place (`where`) of a claim that the paper does not make


class Rule(Enum):
    """Say how a column may differ between two runs; the regression gate has the numbers."""

    same = "must not change"
    count = (
        "exact for fixed steps; where a solver chooses them, or iterates, exact on the same processor with the same "
        "libraries, else within a tenth, or a twentieth"
    )
    error = "may move by a factor of two above round-off"
    structure = "an error; if it is round-off it must stay round-off"
    order = "a fitted order: within 0.05"
    value = "a quantity that is no error: within a hundredth"
    measured = "what a claim measured: a factor of two or a hundredth, above round-off and far from its bound"
    point = "a coordinate of a curve: within a hundredth of the largest along the curve, above round-off"
    end = "how far a run got: exact where it ended well, else within a tenth"
    profile = "may be of a smaller profile, never only of a larger one"

    @property
    def decades(self) -> bool:
        return self in (Rule.error, Rule.structure)


@dataclass(frozen=True)
class Column:
    """Define a column.

    meaning : a phrase that explains it.  rule : how it may differ between two runs.  ungated : why it has no rule (keys
    and times need no reason).  timed : whether a clock measures it.  exact : whether numbers are written in full, since
    they are inputs; others have six digits.  label : short name for headings.  infinite : whether infinity is a value,
    such as no limit; in other columns it is blank.
    """

    meaning: str
    type: Literal["text", "number", "whole", "flag", "answer"] = "text"
    rule: Rule | None = None
    timed: bool = False
    exact: bool = False
    label: str = ""
    ungated: str = ""
    infinite: bool = False


@dataclass(frozen=True)
class Table:
    """Define a result table.

    own : its columns.  more : returns the columns that plug-ins add.  key : the columns that identify a row.  whole :
    leading key columns; rows that agree in them are made together, and a new run replaces all of them.
    """

    name: str
    about: str
    own: Mapping[str, Column]
    key: tuple[str, ...]
    whole: tuple[str, ...] = ()
    more: Callable[[], Mapping[str, Column]] = dict

    def __post_init__(self) -> None:
        odd = [name for name in self.key if name not in self.columns or self.columns[name].timed]
        if odd:
            raise BadInput(f"table {self.name!r}: key columns {odd} must be columns without a clock")

    @property
    def columns(self) -> Mapping[str, Column]:
        return {**self.own, **self.more()}

    @property
    def rules(self) -> dict[str, Rule]:
        return {name: column.rule for name, column in self.columns.items() if column.rule is not None}

    @property
    def timed(self) -> list[str]:
        return [name for name, column in self.columns.items() if column.timed]

    def path(self, results: Path) -> Path:
        return results / f"{self.name}.csv"


TABLES = Registry("table", Table)


def numbers(rows: pd.DataFrame, column: str, default: float = np.nan) -> pd.Series:
    import pandas as pd  # slow to import; `import contactbench` needs only the names of the tables

    if column not in rows:
        return pd.Series(default, rows.index, dtype=float)
    return pd.to_numeric(rows[column], errors="coerce").astype(float).fillna(default)


def floor(rule: Rule | None, rows: pd.DataFrame) -> np.ndarray:
    """Return for each row the size below which an error is round-off; zero if the rule is not for errors.

    Below it the gate does not judge, and tables show one digit.  It is max(100, √n) ε times the condition number of the
    motion, if the table has one: the rounding errors of n evaluations walk at random.  For rows computed with 50 digits
    it is ten times the uncertainty of the references, which have 40 digits.
    """
    if rule is None or not rule.decades:
        return np.zeros(len(rows))
    least = np.finfo(float).eps * np.maximum(100.0, np.sqrt(numbers(rows, "evaluations", 0.0)))
    least *= np.maximum(1.0, numbers(rows, "condition", 1.0))
    round_off = np.where(rows.get("engine", "") == "mpmath", 1e-39, least)
    return np.maximum(round_off, STRUCTURE) if rule is Rule.structure else round_off
