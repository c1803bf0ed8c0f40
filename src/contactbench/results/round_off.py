"""Below what an error says nothing: shared by the gate, which does not judge there, and the tables, which
write one digit."""

from __future__ import annotations

import numpy as np
import pandas as pd

from contactbench.measure.round_off import STRUCTURE as STRUCTURE
from contactbench.results.schema import Rule


def numbers(rows: pd.DataFrame, column: str, default: float = np.nan) -> pd.Series:
    """Return a column as floats, `default` where it is blank or missing."""
    if column not in rows:
        return pd.Series(default, rows.index, dtype=float)
    return pd.to_numeric(rows[column], errors="coerce").astype(float).fillna(default)


def round_off(rows: pd.DataFrame) -> np.ndarray:
    """Below what an error, relative to the size of its quantity, is round-off.

    100 ε, and √n ε for n evaluations, whose rounding errors walk at random; times the condition number
    of the motion, where the table has one.  The references' 40 digits are beyond that; they are the
    limit of rows at 50 digits, ten times their uncertainty.
    """

    floor = np.finfo(float).eps * np.maximum(100.0, np.sqrt(numbers(rows, "evaluations", 0.0)))
    floor *= np.maximum(1.0, numbers(rows, "condition_number", 1.0))
    return np.where(rows.get("engine", "") == "mpmath", 1e-39, floor)


def floor(rule: Rule | None, rows: pd.DataFrame) -> np.ndarray:
    """The floor of a column with this rule, for each row: zero for what is no error."""
    if rule is Rule.error:
        return round_off(rows)
    if rule is Rule.structure:
        return np.maximum(round_off(rows), STRUCTURE)
    return np.zeros(len(rows))
