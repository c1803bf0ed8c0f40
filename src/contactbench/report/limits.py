"""Stability limits of the oscillator."""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd

from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part
from contactbench.report.figures import stability as figures
from contactbench.report.views import Cell, Mark, View, as_cell, matrix, pick

SOURCE = "stability_limits.csv"
TITLES = {
    "limit": "First loss of stability",
    "limit_kernel": "Processed methods saved at the end only",
    "limit_saved": "Processed methods saved at every step",
}


def limit_view(frame: pd.DataFrame, column: str) -> View:
    """Return one limit at ω = 1, methods × damping; theory in parentheses beside the first loss of stability."""
    one = frame[(frame["omega"] == 1.0) & frame[column].notna()].sort_values("gamma", kind="stable")
    table = matrix(one, "method", "gamma", lambda rows: limit_cell(rows.iloc[0], column), "γ = {:g}".format)
    legend = "Largest stable step of q'' + γq' + q = 0."
    if column == "limit":
        legend += " In parentheses: theory. Marked: larger steps are stable again, see the windows."
    return View(column, TITLES[column], table, legend, SOURCE)


def limit_cell(row: pd.Series, column: str) -> Cell:
    """Return one limit, marked where larger steps are stable again."""
    if column != "limit":
        return as_cell(row[column], "{:.4g}".format)
    cell = as_cell(row["limit"], "{:.4g}".format, Mark.exception if row["windows"] else None)
    theory = "" if pd.isna(row["theory"]) else "∞" if math.isinf(row["theory"]) else f"{row['theory']:.4g}"
    return replace(cell, text=f"{cell.text} ({theory})" if theory else cell.text)


def windows_view(frame: pd.DataFrame) -> View:
    """Return the intervals of unstable steps below larger stable ones."""
    rows = frame[(frame["omega"] == 1.0) & (frame["windows"] != "")]
    labels = {
        "method": "method",
        "gamma": "γ",
        "limit": "first loss of stability",
        "windows": "unstable steps",
    }
    legend = (
        "ω = 1. Intervals of stable steps no longer than 1 % of the step at which they begin are left out."
    )
    return View("windows", "Windows of instability", pick(rows, labels), legend, SOURCE)


def parts(frames: Frames) -> list[Part]:
    frame = frames["stability_limits"]
    first, *others = (limit_view(frame, column) for column in TITLES)
    views = [first, windows_view(frame), *others]
    return [*(view for view in views if len(view.frame)), figures.limits(frame)]


TITLE, QUESTION = "Stability limits", "Up to which step does a bounded motion stay bounded?"
CHAPTERS.add(Chapter("limits", TITLE, QUESTION, 52, ("stability_limits", "one_step"), parts))
