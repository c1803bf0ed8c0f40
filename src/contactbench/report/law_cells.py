"""How a deviation from a law, and an order, are written."""

from __future__ import annotations

from collections.abc import Callable
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
    f"but vanished. {DOUBLE_DAGGER}: too ill-conditioned to tell. [How to read it](../docs/reading.md#laws)."
)


def law_label(law: str) -> str:
    """Return the short name of a law."""
    return LAWS_TABLE.columns[law].label or law.replace("_", " ")


def with_bounds(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the frame with a column `LAW_bound` for each structural law it has: up to what it is round-off."""
    return frame.assign(**{f"{law}_bound": bound(frame, law) for law in structural_laws() if law in frame})


def drift_cell(row: Any, law: str) -> Cell:
    """Return one deviation of a row that is `with_bounds`, with its error bar where that is a tenth of it or more."""

    def number(name: str) -> float:
        value = row.get(name)
        return 0.0 if value is None or pd.isna(value) else float(value)

    if pd.isna(row.get(law)):
        return Cell(DASH)
    value, error, limit = (number(name) for name in (law, f"{law}_uncertainty", f"{law}_bound"))
    kept, ill = decide(value, limit) if limit else (False, False)
    unsure = error > 0 and value <= UNSURE * error
    bar = f" ± {scientific(error, 0)}" if not unsure and 0 < value / 10 <= error else ""
    signs = (DAGGER if number(f"{law}_clamped") > 0 else "") + (DOUBLE_DAGGER if ill else "")
    return Cell(
        f"{'≤ ' if unsure else ''}{scientific(value)}{bar}{signs}", value, Mark.kept if kept else None
    )


def range_cell(rows: pd.DataFrame, structural: bool, show: Callable[[float], str]) -> Cell:
    """Return the smallest and the largest value of some rows of a law; only this where all are kept."""
    low, high, judged = rows["value"].min(), rows["value"].max(), rows[rows["judged"]]
    kept = structural and len(judged) > 0 and bool(judged["kept"].all())
    ill = structural and (rows["undecided"] & (rows["bound"] > DECIDABLE)).any()
    text = show(high) if kept or low == high else f"{show(low)} … {show(high)}"
    signs = (DAGGER if (rows["clamped"] > 0).any() else "") + (DOUBLE_DAGGER if ill else "")
    at_most = "≤ " if rows["unsure"].any() and not kept else ""
    return Cell(at_most + text + signs, high, Mark.kept if kept else None)


def order_cell(frames: Frames, row: Any) -> Cell:
    """Return the measured order of a row's method on its scene; why not, where there is none."""
    if row["control"] != "step":
        return Cell({"rtol": "adaptive"}.get(row["control"], str(row["control"])))
    orders = frames["convergence"]
    here = orders[(orders["method"] == row["method"]) & (orders["scene"] == row["scene"])]
    return as_cell(here["order"].iloc[0] if len(here) else None, "{:.2f}".format)
