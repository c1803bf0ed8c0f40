"""The judgements of structural laws, row by row, and how a deviation is written."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from contactbench.measure.round_off import (
    DECIDABLE,
    JUDGEMENT,
    OF_THE_STATE,
    UNSURE,
    decided,
    judge,
    structural_bound,
)
from contactbench.report.cells import DASH, Cell, Mark, marks
from contactbench.report.contest import CONTACT, LIMIT
from contactbench.report.numbers import scientific
from contactbench.report.rooms import Frames
from contactbench.results.schema import Column, Rule, Table
from contactbench.results.tables import DECAY_LAWS, LAWS_TABLE

#: a row of a frame
type Row = pd.Series | Mapping[Any, Any]
FROZEN = "_frozen"
DAGGER = "†"
DOUBLE_DAGGER = "‡"
MEANINGS = {
    "kept": "bold: kept to round-off at every setting tried, however inaccurate the solution",
    "range": f"smallest … largest over the settings tried; {DASH}: the law is not defined there, or not measured",
    "dagger": f"{DAGGER}: where a quantity has all but vanished, its deviation is relative to a "
    "thousandth of the terms that cancel",
    "undecided": f"{DOUBLE_DAGGER}: undecided at this step, because the problem is too ill-conditioned there: "
    f"round-off alone may amount to more than {scientific(DECIDABLE, 0)}",
}


def laws(table: Table, view: str = "laws") -> dict[str, Column]:
    """The laws a table shows in a view, with their columns."""
    return {name: column for name, column in table.columns.items() if view in column.shown}


def structural() -> dict[str, Column]:
    """The laws of the map itself that a method either keeps or does not, whatever its error."""
    return {n: c for n, c in laws(LAWS_TABLE).items() if c.rule is Rule.structure and not n.endswith(FROZEN)}


def at_equal_cost() -> list[str]:
    """The laws of the table at equal cost, in its order."""
    return [
        n
        for n in DECAY_LAWS.columns
        if n in laws(LAWS_TABLE) and n != "solution_error" and not n.endswith(FROZEN)
    ]


def called(law: str) -> str:
    """The short name of a law in plain text."""
    label = LAWS_TABLE.columns[law].label
    return label if label and "$" not in label else law.replace("_", " ")


def numbers(rows: pd.DataFrame, column: str, default: float = np.nan) -> pd.Series:
    """A column as floats, `default` where it is blank or missing."""
    if column not in rows:
        return pd.Series(default, rows.index, dtype=float)
    return pd.to_numeric(rows[column], errors="coerce").astype(float).fillna(default)


def growth(rows: pd.DataFrame, law: str) -> pd.Series:
    """What the round-off of a law grows by: with the map where that was measured, else with the motion."""
    if law in OF_THE_STATE:
        return pd.Series(1.0, rows.index)
    motion = numbers(rows, "condition_number", 1.0)
    return np.maximum(1.0, numbers(rows, "map_growth").fillna(motion))


def bound(rows: pd.DataFrame, law: str) -> pd.Series:
    """Up to what a deviation from a law is round-off, row by row."""
    return structural_bound(growth(rows, law), numbers(rows, "evaluations", 0.0))


MEASURED = [
    "scene", "method", "family", "setting", "solution_error", "value", "growth", "frozen", "uncertainty", "unsure",
    "clamped", "derivative", "claimed", "kept", "undecided", "bound", "judged",
]  # fmt: skip


def measured(frames: Frames, law: str) -> pd.DataFrame:
    """All rows of all tables that have a value of the law.

    Columns beside theirs: value, its uncertainty and growth; frozen: the value with the steps held fixed; unsure: no
    more than an upper bound is known; `JUDGEMENT`, computed here where the table does not have it: of a law that is
    not structural, and of a table older than these columns; judged: whether the run follows the motion; broken: that,
    and neither kept nor undecided.
    """
    parts = []
    for name in ("laws", "stability"):
        frame = frames.get(name, pd.DataFrame())
        if not len(frame) or law not in frame:
            continue
        part = frame[(frame["status"] == "ok") & frame[law].notna() & (frame["family"] != LIMIT)]
        uncertainty, values = numbers(part, f"{law}_uncertainty", 0.0), numbers(part, law)
        clamped = numbers(part, f"{law}_clamped", 0.0)
        if numbers(part, f"{law}_bound").notna().any():
            told = {
                what: part[f"{law}_{what}"].fillna(False) if what != "bound" else part[f"{law}_{what}"]
                for what in JUDGEMENT
            }
            told["judged"] = told["bound"].notna()
        else:
            limit, all_clamped = bound(part, law), clamped >= numbers(part, "saved_times", np.inf)
            judged, kept, undecided = judge(
                values, limit, uncertainty, all_clamped, numbers(part, "solution_error")
            )
            claimed = part["family"] == CONTACT
            told = {
                "claimed": claimed,
                "kept": kept,
                "undecided": undecided,
                "bound": limit,
                "judged": judged,
            }
        parts.append(
            part.assign(
                value=values, uncertainty=uncertainty, growth=growth(part, law), clamped=clamped,
                frozen=numbers(part, law + FROZEN), unsure=(uncertainty > 0) & (values <= UNSURE * uncertainty),
                **told,
            )
        )  # fmt: skip
    if not parts:
        return pd.DataFrame(columns=[*MEASURED, "broken"])
    rows = pd.concat([part.reindex(columns=MEASURED) for part in parts], ignore_index=True)
    flags = ["claimed", "kept", "undecided", "judged"]
    rows = rows.astype(dict.fromkeys(flags, bool))
    return rows.assign(broken=rows["judged"] & ~rows["kept"] & ~rows["undecided"])


def keepers(rows: pd.DataFrame) -> list[str]:
    """The methods that keep the law in every row that decides."""
    by_method = rows.groupby("method", sort=False)
    kept = by_method["kept"].any() & ~by_method["broken"].any()
    return [str(method) for method in kept.index[kept]]


def bounded(frame: pd.DataFrame) -> pd.DataFrame:
    """The frame with a column `LAW_bound` for each structural law it has: up to what it is round-off."""
    return frame.assign(**{f"{law}_bound": bound(frame, law) for law in structural() if law in frame})


def drift_cell(row: Row, law: str) -> Cell:
    """One deviation: with its error bar where that is a tenth of it or more, a dagger
    where clamped and a double one where undecided.

    row : of a frame that is `bounded`.
    """
    value = row.get(law)
    if value is None or pd.isna(value):
        return Cell(DASH, hint=str(row.get("derivative", "")) if law.endswith("drift") else "")
    value = float(value)
    error, limit = (scalar(row, f"{law}_{name}") for name in ("uncertainty", "bound"))
    clamped = scalar(row, f"{law}_clamped") > 0
    kept, ill = decided(value, limit) if law in structural() else (False, False)
    vague = error > 0 and value <= UNSURE * error
    bar = f" ± {scientific(error, 0)}" if not vague and error >= value / 10 and error > 0 else ""
    signs = (DAGGER if clamped else "") + (DOUBLE_DAGGER if ill else "")
    return Cell(
        f"{'≤ ' if vague else ''}{scientific(value)}{bar}{signs}", value,
        marks(Mark.kept if kept else None, Mark.clamped if clamped else None, Mark.bound if vague else None),
    )  # fmt: skip


def scalar(row: Row, name: str) -> float:
    """A number of a row, 0 where it is blank."""
    value = row.get(name)
    return 0.0 if value is None or pd.isna(value) else float(value)
