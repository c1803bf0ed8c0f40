"""Stability limits of the oscillator, and the spectral radius of the one-step map."""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd

from contactbench.report.cells import DASH, Cell, Head, Mark, View, number, word
from contactbench.report.figures import stability as figures
from contactbench.report.numbers import upper
from contactbench.report.raw import raw
from contactbench.report.rooms import ROOMS, Frames, Part, Room
from contactbench.results.tables import ONE_STEP, STABILITY_LIMITS

ISLANDS = "intervals of stable steps no longer than 1 % of the step at which they begin are left out"


def limit_view(frame: pd.DataFrame, column: str, name: str, title: str) -> View | None:
    """Methods × damping of one limit at ω = 1; theory in parentheses beside the first loss of stability."""
    one = frame[(frame["omega"] == 1.0) & frame[column].notna()]
    if not len(one):
        return None
    gammas = sorted(one["gamma"].unique())
    rows = []
    for method, mine in one.groupby("method", sort=False):
        line = mine.set_index("gamma")
        cells = [word(method)]
        for gamma in gammas:
            if gamma not in line.index:
                cells.append(Cell(DASH))
                continue
            row = line.loc[gamma]
            theory = row["theory"] if column == "limit" else math.nan
            known = "" if pd.isna(theory) else f" ({'∞' if math.isinf(theory) else f'{theory:.4g}'})"
            gaps = Mark.exception if column == "limit" and row["windows"] else None
            value = number(row[column], "{:.4g}".format, gaps)
            cells.append(replace(value, text=value.text + known))
        rows.append(tuple(cells))
    heads = (Head("method", words=True), *(Head(f"γ = {g:g}") for g in gammas))
    meaning = f"{upper(STABILITY_LIMITS.columns[column].meaning)}; q'' + γq' + q = 0."
    if column == "limit":
        meaning += (
            " In parentheses what theory gives. Marked: larger steps are stable again, see the windows; "
            f"{ISLANDS}."
        )
    return View(name, title, meaning, heads, tuple(rows), "stability_limits.csv")


def windows_view(frame: pd.DataFrame) -> View | None:
    rows = [
        (
            word(r["method"]),
            number(r["gamma"], "{:g}".format),
            number(r["limit"], "{:.4g}".format),
            word(r["windows"]),
        )
        for _, r in frame[(frame["omega"] == 1.0) & (frame["windows"] != "")].iterrows()
    ]
    if not rows:
        return None
    heads = (
        Head("method", words=True), Head("γ"), Head("first loss of stability"), Head("unstable steps", words=True),
    )  # fmt: skip
    meaning = (
        f"{upper(STABILITY_LIMITS.columns['windows'].meaning)}; ω = 1. {upper(ISLANDS)}: they end no window."
    )
    return View("windows", "Windows of instability", meaning, heads, tuple(rows), "stability_limits.csv")


def sections(frames: Frames) -> list[Part]:
    frame, radius = frames["stability_limits"], frames["one_step"]
    views = (
        limit_view(frame, "limit", "limits", "First loss of stability"),
        windows_view(frame),
        limit_view(frame, "limit_kernel", "limits_kernel", "Processed methods saved at the end only"),
        limit_view(frame, "limit_saved", "limits_saved", "Processed methods saved at every step"),
    )
    return [
        *(view for view in views if view is not None),
        figures.limits(frame),
        *([figures.radius(radius)] if len(radius) else []),
        *(
            raw(table, frames[table.name])
            for table in (STABILITY_LIMITS, ONE_STEP)
            if len(frames[table.name])
        ),
    ]


ROOMS.add(
    Room(
        "limits", "Stability limits", "up to which step a bounded motion stays bounded", 52,
        ("stability_limits", "one_step"), sections,
    )
)  # fmt: skip
