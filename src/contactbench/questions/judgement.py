"""Which runs keep a law, as the columns of the tables say."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from contactbench.measure.law import JUDGEMENT
from contactbench.tables.declared import DECAY_LAWS, LAWS_TABLE
from contactbench.tables.schema import Column, Rule, Table, numbers

#: the tables whose rows are judged
JUDGED_TABLES = ("laws", "stability")
#: the judgement of a run
FLAGS = ("claimed", "kept", "undecided", "judged")
#: the columns of `law_rows` but for `broken`
COLUMNS = ("scene", "method", "family", "setting", "value", "clamped", "bound", *FLAGS)


def laws_in(table: Table, view: str = "laws") -> dict[str, Column]:
    return {name: column for name, column in table.columns.items() if view in column.shown}


def structural_laws() -> dict[str, Column]:
    """Return the laws of the map itself, which a method either keeps or not whatever its error."""
    return {name: column for name, column in laws_in(LAWS_TABLE).items() if column.rule is Rule.structure}


def laws_at_equal_cost() -> list[str]:
    return [n for n in DECAY_LAWS.columns if n in laws_in(LAWS_TABLE) and n != "solution_error"]


def law_rows(frames: Mapping[str, pd.DataFrame], law: str) -> pd.DataFrame:
    """Return all runs of all tables that have a value of a law.

    Columns: scene, method, family, setting; value; clamped (at how many times it is relative to a thousandth of the
    terms that cancel); claimed, kept, undecided, bound; judged (the run follows
    the motion); broken (judged, and neither kept nor undecided).  A law that is not structural is not judged.
    """
    judged = []
    for name in JUDGED_TABLES:
        frame = frames.get(name)
        if frame is not None and len(frame) and law in frame:
            rows = frame[(frame["status"] == "ok") & frame[law].notna()]
            limit = numbers(rows, f"{law}_bound")
            flags = {
                f: rows[f"{law}_{f}"].fillna(False)
                for f in JUDGEMENT
                if f != "bound" and f"{law}_{f}" in rows
            }
            found = {"value": numbers(rows, law), "bound": limit}
            found |= {"clamped": numbers(rows, f"{law}_clamped", 0.0), "judged": limit.notna()}
            judged.append(rows.assign(**found, **dict.fromkeys(FLAGS[:3], False) | flags))
    rows = pd.concat(judged or [pd.DataFrame()], ignore_index=True).reindex(columns=list(COLUMNS))
    rows = rows.astype(dict.fromkeys(FLAGS, bool))
    return rows.assign(broken=rows["judged"] & ~rows["kept"] & ~rows["undecided"])
