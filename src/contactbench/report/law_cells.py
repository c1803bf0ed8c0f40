"""How a deviation from a law, and an order, are written."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from contactbench.measure.round_off import DECIDABLE, UNSURE, decide
from contactbench.report.chapters import Frames
from contactbench.report.numbers import DASH, scientific
from contactbench.report.views import Cell, Mark, as_cell
from contactbench.results.judgement import bound, structural_laws
from contactbench.results.tables import LAWS_TABLE

DAGGER, DOUBLE_DAGGER = "†", "‡"
LEGEND = (
    f"Bold: at round-off. ≤ and ±: by differences of the solver, with their error bar. {DAGGER}: the quantity has all "
    f"but vanished. {DOUBLE_DAGGER}: too ill-conditioned to tell. "
    "[How to read it](../docs/reading.md#laws)."
)
#: written instead of an order, by what sets a method
WITHOUT_ORDER = {"rtol": "adaptive", "exact": "exact"}


def law_label(law: str) -> str:
    """Return the short name of a law."""
    return LAWS_TABLE.columns[law].label or law.replace("_", " ")


def meanings(laws: list[str]) -> dict[str, str]:
    """Return the meanings of laws, by label."""
    return {law_label(law): LAWS_TABLE.columns[law].meaning for law in laws}


def with_bounds(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the frame with a column `LAW_bound` for each structural law it has: up to what it is round-off."""
    return frame.assign(**{f"{law}_bound": bound(frame, law) for law in structural_laws() if law in frame})


def drift_cell(row: Mapping[Any, Any] | pd.Series, law: str) -> Cell:
    """Return one deviation of a row that is `with_bounds`, with its error bar where that is a tenth of it or more."""
    value = scalar(row, law, None)
    if value is None:
        return Cell(DASH)
    error, limit, clamped = (
        scalar(row, f"{law}_{name}", 0.0) for name in ("uncertainty", "bound", "clamped")
    )
    kept, ill = decide(value, limit) if limit else (False, False)
    unsure = error > 0 and value <= UNSURE * error
    bar = f" ± {scientific(error, 0)}" if not unsure and 0 < value / 10 <= error else ""
    signs = (DAGGER if clamped > 0 else "") + (DOUBLE_DAGGER if ill else "")
    text = f"{'≤ ' if unsure else ''}{scientific(value)}{bar}{signs}"
    return Cell(text, value, Mark.kept if kept else None)


def scalar(row: Mapping[Any, Any] | pd.Series, name: str, default: Any) -> Any:
    """Return a number of a row, `default` where it is blank."""
    value = row.get(name)
    return default if value is None or pd.isna(value) else float(value)


def range_cell(rows: pd.DataFrame, structural: bool, show: Any) -> Cell:
    """Return the smallest and the largest value of some rows of a law."""
    low, high, judged = rows["value"].min(), rows["value"].max(), rows[rows["judged"]]
    kept = structural and len(judged) > 0 and bool(judged["kept"].all())
    text = show(high) if kept or low == high else f"{show(low)} … {show(high)}"
    ill = structural and (rows["undecided"] & (rows["bound"] > DECIDABLE)).any()
    signs = (DAGGER if (rows["clamped"] > 0).any() else "") + (DOUBLE_DAGGER if ill else "")
    at_most = "≤ " if rows["unsure"].any() and not kept else ""
    return Cell(at_most + text + signs, high, Mark.kept if kept else None)


def order_cell(frames: Frames, scene: str, method: str, control: str) -> Cell:
    """Return the measured order of a method on a scene; why not, where there is none."""
    if control in WITHOUT_ORDER:
        return Cell(WITHOUT_ORDER[control])
    orders = frames["convergence"]
    here = orders[(orders["method"] == method) & (orders["scene"] == scene)]
    if not len(here):
        return Cell(DASH)
    first = here.iloc[0]
    if pd.isna(first["order"]):
        return Cell(str(first["status"]) if first["status"] != "ok" else "no range")
    return as_cell(first["order"], "{:.2f}".format)
