"""Cost against error: scene by scene, and on the hard scenes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from contactbench.report.curves import by_method
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.report.figures.best import best_of_each, cheapest, contest_ends
from contactbench.results.contest import KINDS, contestants

SOURCE = "work_precision.csv"
#: where errors begin and end: beyond one there is nothing left of the motion, below round-off nothing is known
ERRORS = (1e-16, 2.0)
#: quantities on an axis of cost, the first as the tables compare it: label and scale
TIMES = {
    "time_min_s": ("time per solve (least round), ms", 1e3),
    "time_median_s": ("time per solve (median), ms", 1e3),
    "call_s": ("what `run()` adds to a solve, ms", 1e3),
    "marginal_s": ("time per unit of simulated time, ms", 1e3),
}
COUNTS = {
    "rhs_equivalents": ("evaluations", 1.0),
    "evaluations": ("evaluations as each method counts them", 1.0),
    "steps": ("steps", 1.0),
}
BARS = "Bars: from the least round to the upper quartile; of marginal times, what the halves of the visits differ by. "
COLOURS = "In colour: the method of each family that is cheapest at most errors; thin and grey: the others."


def error_axis(frame: pd.DataFrame) -> Axis:
    """The error, and the deviations a page may show instead, where the table has them."""
    others = {
        "energy_law": "deviation of $H_0$", "hamiltonian_law": "deviation from the law of $H$",
        "momentum_law": "deviation from the law of $J$", "end_error": "error at the end",
    }  # fmt: skip
    there = [n for n in others if n in frame and frame[n].notna().any()]
    return Axis("solution error", "log", inverted=True, within=ERRORS, key="solution_error",
                others=tuple(Axis(others[n], "log", inverted=True, key=n) for n in there))  # fmt: skip


def cost_axis(frame: pd.DataFrame, quantities: dict[str, tuple[str, float]]) -> Axis:
    first, *others = [n for n in quantities if n in frame and frame[n].notna().any()]
    return Axis(quantities[first][0], "log", key=first,
                others=tuple(Axis(quantities[n][0], "log", key=n) for n in others))  # fmt: skip


def rounds(rows: pd.DataFrame) -> tuple[pd.Series, pd.Series]:
    """From the least round to the upper quartile, about."""
    return rows["time_min_s"], rows["time_median_s"] + rows["time_iqr_s"] / 2


def halves(rows: pd.DataFrame) -> tuple[pd.Series, pd.Series]:
    """By as much about the marginal time as the halves of the visits differ."""
    factor = np.exp(np.abs(np.log(rows["marginal_halves_ratio"])))
    return rows["marginal_s"] / factor, rows["marginal_s"] * factor


def panel(part: pd.DataFrame, title: str, quantities: dict[str, tuple[str, float]], **options: Any) -> Panel:
    """Error on x, cost on y; the axis of cost ends where the contest ends.

    A difference of two times that is not positive is noise, and no cost.
    """
    x, y = error_axis(part), cost_axis(part, quantities)
    also = {a.key: 1.0 for a in x.others} | {a.key: quantities[a.key][1] for a in y.others}
    part = part.assign(**{a.key: part[a.key].where(part[a.key] > 0) for a in (y, *y.others)})
    found = by_method(part, x.key, y.key, scale=quantities[y.key][1], also=also, **options)
    y, beyond = contest_ends(y, found)
    return Panel(title, x, y, best_of_each(found, cheapest), remark=beyond)


def figure(work: pd.DataFrame, scene: str) -> Figure | None:
    """Cost against error for one scene, a panel for each kind of comparison."""
    rows = contestants(work)
    rows = rows[(rows["scene"] == scene) & (rows["status"] == "ok")]
    panels = []
    for kind in KINDS:
        part = rows[kind.compares(rows)]
        if not kind.timed:  # the same counts on every engine: one curve
            part = part.drop_duplicates(["method", "setting"])
        part = part[part[kind.cost].notna()]
        if len(part) and kind.timed:
            first = {kind.cost: TIMES[kind.cost], **TIMES}
            bars = halves if kind.cost == "marginal_s" else rounds
            panels.append(panel(part, kind.title, first, apart=("engine",), bars=bars))
        elif len(part):
            panels.append(panel(part, kind.title, COUNTS))
    if not panels:
        return None
    caption = (
        f"More accurate to the right, cheaper below. {COLOURS} {BARS}"
        "Engines of different panels are not compared."
    )
    return Figure(
        f"work_precision_{scene}",
        f"{scene}: cost against error",
        tuple(panels),
        caption,
        2,
        source=SOURCE,
        size=(6.2, 4.4),
    )
