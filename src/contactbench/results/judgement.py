"""Which runs keep a law: the judgement of every run that has a value of it, as columns."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from contactbench.measure.law import JUDGEMENT, OF_THE_STATE, UNSURE, structural_bound
from contactbench.results.contest import LIMIT
from contactbench.results.schema import Column, Rule, Table, numbers
from contactbench.results.tables import DECAY_LAWS, LAWS_TABLE

#: the same law with the steps held fixed
FROZEN = "_frozen"
#: the tables whose rows are judged
JUDGED_TABLES = ("laws", "stability")
#: the judgement of a run
FLAGS = ("claimed", "kept", "undecided", "judged")
#: the columns of `law_rows` but for `broken`
COLUMNS: tuple[str, ...] = ("scene", "method", "family", "setting", "derivative", "solution_error")
COLUMNS += ("value", "uncertainty", "clamped", "frozen", "unsure", "bound", *FLAGS)


def laws_in(table: Table, view: str = "laws") -> dict[str, Column]:
    return {name: column for name, column in table.columns.items() if view in column.shown}


def structural_laws() -> dict[str, Column]:
    """Return the laws of the map itself, which a method either keeps or not whatever its error."""
    return {name: column for name, column in laws_in(LAWS_TABLE).items() if column.rule is Rule.structure}


def laws_at_equal_cost() -> list[str]:
    return [n for n in DECAY_LAWS.columns if n in laws_in(LAWS_TABLE) and n != "solution_error"]


def bound(rows: pd.DataFrame, law: str) -> pd.Series:
    """Return up to what a deviation is round-off: by the growth of the map where known, else by the motion's."""
    growth = pd.Series(1.0, rows.index)
    if law not in OF_THE_STATE:
        motion = numbers(rows, "condition_number", 1.0)
        growth = np.maximum(1.0, numbers(rows, "map_growth").fillna(motion))
    return structural_bound(growth, numbers(rows, "evaluations", 0.0))


def law_rows(frames: Mapping[str, pd.DataFrame], law: str) -> pd.DataFrame:
    """Return all runs of all tables that have a value of a law.

    Columns: scene, method, family, setting, derivative, solution_error; value, uncertainty, clamped (at how many times
    it is relative to a thousandth of the terms that cancel); frozen (with the steps held fixed); unsure (an upper bound
    only); claimed, kept, undecided, bound; judged (the run follows the motion); broken (judged, and neither kept nor
    undecided).  A law that is not structural is not judged.
    """
    parts = []
    for name in JUDGED_TABLES:
        frame = frames.get(name)
        if frame is not None and len(frame) and law in frame:
            rows = frame[(frame["status"] == "ok") & frame[law].notna() & (frame["family"] != LIMIT)]
            parts.append(_judged(rows, law))
    rows = pd.concat(parts or [pd.DataFrame()], ignore_index=True).reindex(columns=list(COLUMNS))
    rows = rows.astype(dict.fromkeys(FLAGS, bool))
    return rows.assign(broken=rows["judged"] & ~rows["kept"] & ~rows["undecided"])


def _judged(rows: pd.DataFrame, law: str) -> pd.DataFrame:
    value, uncertainty = numbers(rows, law), numbers(rows, f"{law}_uncertainty", 0.0)
    rows = rows.assign(
        value=value,
        uncertainty=uncertainty,
        clamped=numbers(rows, f"{law}_clamped", 0.0),
        frozen=numbers(rows, law + FROZEN),
        unsure=(uncertainty > 0) & (value <= UNSURE * uncertainty),
    )
    if f"{law}_bound" not in rows:
        return rows.assign(bound=bound(rows, law), **dict.fromkeys(FLAGS, False))
    flags = {name: rows[f"{law}_{name}"].fillna(False) for name in JUDGEMENT if name != "bound"}
    return rows.assign(**flags, bound=rows[f"{law}_bound"], judged=rows[f"{law}_bound"].notna())
