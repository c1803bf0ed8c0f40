"""Measured orders, extrapolated, and error against step size."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from contactbench.questions.answers import share
from contactbench.questions.contest import with_family
from contactbench.report.chapters import PROSE, Answer, Frames, Part, chapter, chart, view
from contactbench.report.curves import by_method, choose, floats, lowest, only
from contactbench.report.drawing import Axis, Curve, Figure, Panel
from contactbench.report.numbers import DASH
from contactbench.report.views import Cell, Mark, as_cell, matrix

#: a measured order further than this from the claimed one, and than its own spread, is an exception
AGREES = 0.1
#: the scene that is drawn; the table has them all
SCENE = "particle"
#: below this an error is rounding, and no guide follows it
ROUNDING = 1e-14
#: and so at fifty digits, which show orders further
FIFTY_DIGITS = 1e-38
#: a guide runs so far below its curve
BELOW = 0.15


def fits(frame: pd.DataFrame) -> pd.DataFrame:
    """Return one row per method and scene, with a column `off`: the order is not the claimed one."""
    first = frame.drop_duplicates(["scene", "method"])
    spread = first["order_uncertainty"].astype(float).fillna(0.0).clip(lower=AGREES)
    off = (first["order"] - first["order_nominal"]).astype(float).abs() > spread
    return first.assign(off=off & first["order"].notna())


RIGHT = (
    "orders.drop_duplicates(['scene', 'method']).dropna(subset='order')"
    f".eval('abs(order - order_nominal) <= order_uncertainty.fillna(0).clip(lower={AGREES})')"
)


def answers(frames: Frames) -> Iterator[Answer]:
    what = f"pairs of method and scene, within {AGREES:g} or the spread of the extrapolation"
    if answer := share(frames, PROSE["orders"]["question"], what, RIGHT):
        yield answer


def order_of(frames: Frames, scene: str, method: str) -> Cell:
    """Return the order of a method on a scene, for a table of other things; or how it chooses its steps."""
    orders, runs = frames["orders"], frames["runs"]
    here = orders[(orders["method"] == method) & (orders["scene"] == scene)]
    if len(here):
        return as_cell(here["order"].iloc[0], "{:.2f}".format)
    controls = set(runs["control"][(runs["method"] == method) & (runs["scene"] == scene)])
    return Cell("adaptive" if controls == {"rtol"} else DASH)


def order_cell(rows: pd.DataFrame) -> Cell:
    row = rows.iloc[0]
    if row["status"] == "unsupported":
        return Cell(DASH)
    if pd.isna(row["order"]):
        return Cell("no asymptotic range")
    spread = "" if pd.isna(row["order_uncertainty"]) else f" ± {row['order_uncertainty']:.2f}"
    return Cell(f"{row['order']:.2f}{spread}", float(row["order"]), Mark.exception if row["off"] else None)


@chapter("orders", answers)
def parts(frames: Frames) -> list[Part | None]:
    orders = matrix(fits(frames["orders"]), "method", "scene", order_cell)
    return [view("orders", orders, agrees=AGREES), figure(with_family(frames["orders"], frames["runs"]))]


def guides(rows: pd.DataFrame, methods: list[str]) -> Iterator[Curve]:
    part = rows[rows["method"].isin(methods) & (rows["error"] > ROUNDING)]
    for order, own in part.groupby("order_nominal"):
        line = own[own["method"] == own["method"].iloc[0]].sort_values("step")
        line = line.iloc[: max(2, len(line) - 2)]  # the coarsest are not asymptotic
        steps = line["step"].to_numpy(dtype=float)
        middle = len(line) // 2
        slope = BELOW * line["error"].iloc[middle] * (steps / steps[middle]) ** float(order)
        yield Curve(floats(steps), floats(slope), role="guide", markers=False)


def figure(frame: pd.DataFrame) -> Figure | None:
    rows = frame[(frame["scene"] == SCENE) & (frame["status"] == "ok") & frame["error"].notna()]
    first = rows.drop_duplicates("method")
    off = (first["order"] - first["order_nominal"]).abs().dropna()
    if not len(off):
        return None
    curves = by_method(rows[rows["error"] > FIFTY_DIGITS], "step", "error", floor=0.0)
    curves = only(curves, choose(curves, lowest, by_order=True))
    x = Axis("step size h (smaller to the right)", "log", inverted=True)
    y = Axis("error of the solution", "log")
    slopes = guides(rows, [curve.method for curve in curves])
    panel = Panel("", x, y, (*slopes, *curves))
    return chart("orders", [panel], scene=SCENE, count=len(off), off=off.max())
