"""Measured orders: extrapolated, with the last pairwise slope beside it."""

from __future__ import annotations

from collections.abc import Callable

import pandas as pd

from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part, summary
from contactbench.report.figures import convergence as figures
from contactbench.report.numbers import DASH, how_often
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of

SOURCE = "convergence.csv"
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
    right = len(known) - int(known["off"].sum())
    count = f"{right} of {len(known)} pairs of method and scene, within {AGREES:g}"
    return summary(("Do the methods have the order they claim?", how_often(right, len(known)), count))


def order_cell(row: pd.Series) -> Cell:
    """Return the extrapolated order and the spread of the extrapolation, or why there is none."""
    if row["status"] == "unsupported":
        return Cell("unsupported", mark=Mark.none)
    if pd.isna(row["order"]):
        return Cell("no asymptotic range")
    spread = "" if pd.isna(row["order_uncertainty"]) else f" ± {row['order_uncertainty']:.2f}"
    mark = Mark.exception if row["off"] else None
    return Cell(f"{row['order']:.2f}{spread}", float(row["order"]), mark)


def matrix(fit: pd.DataFrame, cell: Callable[[pd.Series], Cell]) -> pd.DataFrame:
    """Return methods × scenes."""
    scenes = list(dict.fromkeys(fit["scene"]))
    rows = []
    for method, own in fit.groupby("method", sort=False):
        by_scene = {row["scene"]: row for _, row in own.iterrows()}
        cells = (cell(by_scene[scene]) if scene in by_scene else Cell(DASH) for scene in scenes)
        rows.append((method, own["order_nominal"].max(), *cells))
    return frame_of(rows, ["method", "claimed", *scenes])


def exceptions_view(fit: pd.DataFrame) -> View:
    """Return the orders that are not the claimed ones."""
    frame = fit[fit["off"]][["scene", "method", "order_nominal", "order", "order_uncertainty", "last_slope"]]
    frame.columns = pd.Index(["scene", "method", "claimed", "order", "spread", "last slope"])
    show = {"claimed": "{:.0f}".format, "": "{:.2f}".format}
    return View("order_exceptions", "Exceptions", frame, "", SOURCE, show)


def parts(frames: Frames) -> list[Part]:
    fit = fits(frames["convergence"])
    legend = f"±: spread of the extrapolation. Marked: further from the claimed order than that and than {AGREES:g}."
    drawn = figures.figure(frames["convergence"])
    slopes = matrix(fit, lambda row: as_cell(row["last_slope"], "{:.3f}".format))
    return [
        View("orders", "Extrapolated order", matrix(fit, order_cell), legend, SOURCE),
        exceptions_view(fit),
        *([drawn] if drawn else []),
        View("last_slopes", "Last pairwise slope", slopes, "Before any extrapolation.", SOURCE),
    ]


CHAPTERS.add(
    Chapter(
        "convergence",
        "Order of convergence",
        "Do the methods have the order they claim?",
        30,
        ("convergence",),
        parts,
        answers,
    )
)
