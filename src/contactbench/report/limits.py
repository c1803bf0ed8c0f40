"""Stability limits of the oscillator, and the spectral radius of the one-step map."""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd

from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part
from contactbench.report.figures import stability as figures
from contactbench.report.numbers import DASH
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of

SOURCE = "stability_limits.csv"


def limit_view(frame: pd.DataFrame, column: str, name: str, title: str) -> View | None:
    """Return one limit at ω = 1, methods × damping; theory in parentheses beside the first loss of stability."""
    one = frame[(frame["omega"] == 1.0) & frame[column].notna()]
    if not len(one):
        return None
    gammas = sorted(one["gamma"].unique())
    rows = []
    for method, own in one.groupby("method", sort=False):
        line = {row["gamma"]: row for _, row in own.iterrows()}
        rows.append((method, *(limit_cell(line[g], column) if g in line else Cell(DASH) for g in gammas)))
    legend = "Largest stable step of q'' + γq' + q = 0."
    if column == "limit":
        legend += " In parentheses: theory. Marked: larger steps are stable again, see the windows."
    return View(name, title, frame_of(rows, ["method", *(f"γ = {g:g}" for g in gammas)]), legend, SOURCE)


def limit_cell(row: pd.Series, column: str) -> Cell:
    """Return one limit, marked where larger steps are stable again."""
    first = column == "limit"
    cell = as_cell(row[column], "{:.4g}".format, Mark.exception if first and row["windows"] else None)
    theory = row["theory"] if first else math.nan
    if pd.isna(theory):
        return cell
    return replace(cell, text=f"{cell.text} ({'∞' if math.isinf(theory) else f'{theory:.4g}'})")


def windows_view(frame: pd.DataFrame) -> View | None:
    """Return the intervals of unstable steps below larger stable ones."""
    rows = frame[(frame["omega"] == 1.0) & (frame["windows"] != "")]
    if not len(rows):
        return None
    table = rows[["method", "gamma", "limit", "windows"]]
    table.columns = pd.Index(["method", "γ", "first loss of stability", "unstable steps"])
    legend = (
        "ω = 1. Intervals of stable steps no longer than 1 % of the step at which they begin are left out."
    )
    return View("windows", "Windows of instability", table, legend, SOURCE)


def parts(frames: Frames) -> list[Part]:
    frame = frames["stability_limits"]
    views = (
        limit_view(frame, "limit", "limits", "First loss of stability"),
        windows_view(frame),
        limit_view(frame, "limit_kernel", "limits_kernel", "Processed methods saved at the end only"),
        limit_view(frame, "limit_saved", "limits_saved", "Processed methods saved at every step"),
    )
    return [*(view for view in views if view is not None), figures.limits(frame)]


CHAPTERS.add(
    Chapter(
        "limits",
        "Stability limits",
        "Up to which step does a bounded motion stay bounded?",
        52,
        ("stability_limits", "one_step"),
        parts,
    )
)
