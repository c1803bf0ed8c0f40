"""Measured orders: extrapolated, with the last pairwise slope beside it."""

from __future__ import annotations

import pandas as pd

from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part, summary
from contactbench.report.figures import convergence as figures
from contactbench.report.numbers import how_often
from contactbench.report.views import Cell, Mark, View, as_cell, matrix, pick

SOURCE = "convergence.csv"
TITLE, QUESTION = "Order of convergence", "Do the methods have the order they claim?"
#: a measured order further than this from the claimed one, and than its own spread, is an exception
AGREES = 0.1


def fits(frame: pd.DataFrame) -> pd.DataFrame:
    """Return one row per method and scene, with a column `off`: the order is not the claimed one."""
    first = frame.drop_duplicates(["scene", "method"])
    spread = first["order_uncertainty"].astype(float).fillna(0.0).clip(lower=AGREES)
    off = (first["order"] - first["order_nominal"]).astype(float).abs() > spread
    return first.assign(off=off & first["order"].notna())


def answers(frames: Frames) -> pd.DataFrame:
    known = fits(frames["convergence"])
    known = known[known["order"].notna()]
    right = int((~known["off"]).sum())
    count = f"{right} of {len(known)} pairs of method and scene, within {AGREES:g}"
    return summary((QUESTION, how_often(right, len(known)), count))


def order_cell(rows: pd.DataFrame) -> Cell:
    """Return the extrapolated order and the spread of the extrapolation, or why there is none."""
    row = rows.iloc[0]
    if row["status"] == "unsupported":
        return Cell("unsupported", mark=Mark.none)
    if pd.isna(row["order"]):
        return Cell("no asymptotic range")
    spread = "" if pd.isna(row["order_uncertainty"]) else f" ± {row['order_uncertainty']:.2f}"
    return Cell(f"{row['order']:.2f}{spread}", float(row["order"]), Mark.exception if row["off"] else None)


def parts(frames: Frames) -> list[Part]:
    fit = fits(frames["convergence"])
    drawn = figures.figure(frames["convergence"])
    orders = matrix(fit, "method", "scene", order_cell)
    slopes = matrix(fit, "method", "scene", lambda rows: as_cell(rows["last_slope"].iloc[0], "{:.3f}".format))
    labels = {
        "order_nominal": "claimed",
        "order": "order",
        "order_uncertainty": "spread",
        "last_slope": "last slope",
    }
    off = pick(fit[fit["off"]], {"scene": "scene", "method": "method"} | labels)
    legend = f"±: spread of the extrapolation. Marked: further from the claimed order than that and than {AGREES:g}."
    return [
        View("orders", "Extrapolated order", orders, legend, SOURCE),
        View("order_exceptions", "Exceptions", off, "", SOURCE, {"": "{:.2f}".format}),
        *([drawn] if drawn else []),
        View("last_slopes", "Last pairwise slope", slopes, "Before any extrapolation.", SOURCE),
    ]


CHAPTERS.add(Chapter("convergence", TITLE, QUESTION, 30, ("convergence",), parts, answers))
