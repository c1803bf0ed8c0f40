"""Cost against error: scene by scene as figures, and every scene and cost as one live plot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from contactbench.report.curves import by_method
from contactbench.report.drawing import Axis, Curve, Figure, Live, Panel
from contactbench.report.figures.best import TARGETS as DECADES
from contactbench.report.figures.best import best_of_each, cheapest, contest_ends
from contactbench.report.numbers import power
from contactbench.results import contest
from contactbench.results.contest import COMPILED, EVALUATIONS, KINDS, Kind, contestants

#: where errors begin and end: beyond one there is nothing left of the motion, below round-off nothing is known
ERRORS = (1e-16, 2.0)
#: the axis of each cost, and its scale
AXES = {
    "rhs_equivalents": ("evaluations", 1.0),
    "time_min_s": ("time of a solve, ms", 1e3),
    "marginal_s": ("time per unit of simulated time, ms", 1e3),
}
COLOURS = "In colour: the method of each family that is cheapest at most errors; thin and grey: the others."


def panel(rows: pd.DataFrame, title: str, column: str, named: Sequence[str] = ()) -> Panel:
    """Return error on x, cost on y; the axis of cost ends where the contest ends.

    named : methods to be in colour, whatever others of their families cost.
    A difference of two times that is not positive is noise, and no cost.
    """
    label, size = AXES[column]
    known = rows[rows[column].notna() & (rows[column] > 0)]
    curves = by_method(known, "solution_error", column, size)
    x = Axis("error of the solution (more accurate to the right)", "log", inverted=True, within=ERRORS)

    def score(curve: Curve, own: Sequence[Curve]) -> float:
        return cheapest(curve, own) + len(DECADES) * (curve.method in named)

    return Panel(title, x, contest_ends(Axis(label, "log"), curves), best_of_each(curves, score))


def compared(work: pd.DataFrame, scene: str, kind: Kind) -> pd.DataFrame:
    """Return the rows of a scene that compete in a kind of cost, each method on its fastest engine."""
    rows = contestants(work)
    rows = rows[(rows["scene"] == scene) & (rows["status"] == "ok")]
    rows = rows[kind.compares(rows) & rows[kind.cost].notna()]
    totals = rows.groupby(["method", "engine"])[kind.cost].transform("median")
    best = rows.assign(total=totals).groupby("method")["total"].transform("min")
    return rows[totals == best].drop_duplicates(["method", "setting"])


def figure(work: pd.DataFrame, scene: str) -> Figure | None:
    """Return cost against error for one scene: time of compiled calls, and evaluations."""
    parts = {kind: compared(work, scene, kind) for kind in (COMPILED, EVALUATIONS)}
    title, named = message(work, scene)
    panels = tuple(panel(rows, kind.title, kind.cost, named) for kind, rows in parts.items() if len(rows))
    if not panels:
        return None
    caption = (
        f"Cheaper below. {COLOURS} Costs beyond 30 times the least of the contest are outside the panels."
    )
    name = f"work_precision_{scene}"
    return Figure(name, title, panels, caption)


def message(work: pd.DataFrame, scene: str) -> tuple[str, list[str]]:
    """Return the title and the methods it names: the best contact method beside the best other, compiled, at the
    middle of the errors that both reach."""
    rows = contestants(work)
    table = contest.contests(contest.costs(rows[rows["scene"] == scene], COMPILED, targets=contest.TARGETS))
    ratios = table["ratio"].astype(float)
    table = table[np.isfinite(ratios) & (ratios > 0)]
    if not len(table):
        return f"{scene}: cost against error", []
    row = table.iloc[(len(table) - 1) // 2]
    at = f"at {power(row['error'])}"
    if row["winner"] not in (contest.CONTACT, contest.OTHER):
        return f"{scene}: {row['contact']} and {row['other']} take about the same time {at}", [
            row["contact"],
            row["other"],
        ]
    first, second, ratio = row["contact"], row["other"], row["ratio"]
    if row["winner"] == contest.OTHER:
        first, second, ratio = second, first, 1 / ratio
    return f"{scene}: {first} needs {1 / ratio:.0%} of the time of {second} {at}", [first, second]


def live(frames: Mapping[str, pd.DataFrame]) -> Live | None:
    """Return every scene and kind of cost, the hard scenes in evaluations, to be chosen from."""
    work, hard = frames["work_precision"], frames["stability"]
    panels = {}
    for scene in dict.fromkeys(work["scene"]):
        for kind in (COMPILED, *(k for k in KINDS if k is not COMPILED)):
            if len(rows := compared(work, str(scene), kind)):
                panels[str(scene), kind.title] = panel(rows, f"{scene}: {kind.title}", kind.cost)
    for scene in dict.fromkeys(hard["scene"]):
        rows = hard[(hard["scene"] == scene) & (hard["status"] == "ok") & hard["rhs_equivalents"].notna()]
        rows = rows[rows["solution_error"].notna()].sort_values("rhs_equivalents", kind="stable")
        if len(rows) and (str(scene), EVALUATIONS.title) not in panels:
            panels[str(scene), EVALUATIONS.title] = panel(
                rows, f"{scene}: {EVALUATIONS.title}", "rhs_equivalents"
            )
    if not panels:
        return None
    return Live("Cost against error", panels, f"Cheaper below. {COLOURS} Click a method to hide it.")
