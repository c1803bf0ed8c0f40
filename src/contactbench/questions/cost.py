"""Cost: what an error costs every method to the end alone, who is near the least, and what a tolerance gives."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
import pandas as pd

from contactbench.measure.statistics import WIDEST
from contactbench.questions.answers import share
from contactbench.questions.contest import (
    CONTACT,
    Cost,
    by_pilots,
    comparable,
    cost_rows,
    ranked,
    sides,
)
from contactbench.questions.judgement import CURVE
from contactbench.report.chapters import PROSE, Answer, Frames, Part, Section, Text, chapter, chart, view
from contactbench.report.curves import by_method, cheapest, choose, contest_end, lowest, only
from contactbench.report.drawing import Axis, Curve, Figure, Panel
from contactbench.report.numbers import DASH, count, duration, exact_power, names, power, scientific, times
from contactbench.report.views import Cell, Mark, View, frame_of, matrix
from contactbench.scenes import SCENES

#: the kinds of contest: whether times are compared, and what takes part, as in `comparable`
KINDS: dict[str, tuple[bool, dict[str, Any]]] = {
    "compiled": (True, {}),
    "evaluations": (False, {}),
    "callbacks": (True, {"callbacks": True}),
    "tolerance": (True, {"tolerance": True}),
    "tolerance_evaluations": (False, {"tolerance": True}),
    "saved_evaluations": (False, {"saved": CURVE}),
}
ENTRIES: dict[str, dict[str, str]] = PROSE["cost"]["kinds"]
#: what the contests by tolerance are judged by: looser tolerances are no wish, tighter ones are round-off
ASKED = (1e-10, 1e-3)


def which(frames: Frames, kind: str) -> tuple[tuple[pd.DataFrame, ...], dict[str, Any]]:
    timed, given = KINDS[kind]
    return ((frames["runs"], frames["times"]) if timed else (frames["runs"],)), given


@lru_cache(16)
def standings(frames: Frames, kind: str) -> pd.DataFrame:
    tables, given = which(frames, kind)
    return ranked(*tables, **given)


def answer(frames: Frames, kind: str) -> Answer | None:
    """Return how often a contact method is near the least time, and alone there; or needs the fewest evaluations."""
    timed, given = KINDS[kind]
    arguments = ", ".join(["runs", *["times"] * timed, *(f"{name}={value}" for name, value in given.items())])
    query, asked, what = f"contests({arguments})", ENTRIES[kind]["question"], "pairs of scene and error"
    if not timed:
        return share(frames, asked, what, f"{query}.ratio < 1")
    beside = {"alone": f"{query}.eval('ratio * margin < 1')"}
    if not given:  # the headline
        beside["credited"] = "contests(runs, credited(times, runs)).ratio <= 1.25"
    return share(frames, asked, what, f"{query}.ratio <= 1.25", **beside)


def answers(frames: Frames) -> Iterator[Answer]:
    yield from filter(None, (answer(frames, kind) for kind in KINDS))


# -- who is cheapest -------------------------------------------------------------------------------
def cost_text(row: Cost, timed: bool) -> str:
    if math.isnan(row.cost):
        return row.reason or DASH
    return f"{'≤ ' if row.bound else ''}{duration(row.cost) if timed else count(row.cost)}"


def leaders(rows: pd.DataFrame, timed: bool) -> Cell:
    """Return all that are within a quarter of the least time, or who needs the fewest evaluations."""
    first = cost_rows(rows.head(1))[0]
    if math.isnan(first.cost):
        return Cell(cost_text(first, timed))
    near = rows[rows["ratio"] <= (WIDEST if timed else 1.0)]
    named = names(list(near["method"]))
    contact = rows[rows["family"] == CONTACT]["ratio"].min()
    ours = (near["family"] == CONTACT).any()
    behind = f" (contact {times(contact)})" if contact > 1 and not ours else ""
    mark = (Mark.best if (near["family"] == CONTACT).all() else Mark.tie) if ours else None
    return Cell(f"{named} {cost_text(first, timed)}{behind}", mark=mark)


def leaders_view(rows: pd.DataFrame, kind: str, name: str = "") -> View | None:
    timed, title = KINDS[kind][0], ENTRIES[kind]["title"]
    both = (rows["family"] == CONTACT).groupby(rows["scene"]).transform("nunique") == 2
    reached = rows[both & (rows.groupby("scene")["cost"].transform("count") > 0)]
    if not len(reached):
        return None
    table = matrix(reached, "scene", "error", lambda own: leaders(own, timed), lambda e: f"error {power(e)}")
    return View(name or f"leaders_{kind}", title, table, ENTRIES[kind]["about"])


# -- what a tolerance gives ------------------------------------------------------------------------
def asked_for(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the runs that were given a tolerance, by pilots first; over : error over tolerance, inf if it failed."""
    own = runs[(runs["control"] == "rtol") & (runs["saved"] == 1) & (runs["status"] == "ok")]
    own = own[own["setting"].between(*ASKED)]
    over = (own["error"] / own["setting"]).fillna(math.inf)
    own = own.assign(over=over, pilots=by_pilots(runs)[own.index])
    return own.sort_values("pilots", ascending=False, kind="stable")


def spread(over: pd.Series) -> Cell:
    """Return the median of errors over tolerances, and their quantiles of 10 % and 90 %."""
    if not len(over):
        return Cell(DASH)
    low, middle, high = (scientific(q) for q in np.quantile(over, [0.1, 0.5, 0.9], method="nearest"))
    return Cell(f"{middle} [{low}, {high}]")


def tolerance_view(frames: Frames) -> View:
    population, lines = frames["population"], []
    hard = frames["problems"].query("hard != ''")[["seed", "scene"]]
    drawn = population[population["status"] == "ok"].merge(hard, on=["seed", "scene"])
    drawn = drawn.assign(over=drawn["reached"] / drawn["error"]).dropna(subset="over")
    for method, rows in asked_for(frames["runs"]).groupby("method", sort=False):
        worst = rows.loc[rows["over"].idxmax()]
        where = f"{scientific(worst['over'])}: {worst['scene']}, {exact_power(worst['setting'])}"
        within = f"{int((rows['over'] <= 1).sum())} of {len(rows)}"
        random = spread(drawn["over"][drawn["method"] == method])
        bounds = "the run, by pilots" if worst["pilots"] else "a step"
        lines.append((method, bounds, within, spread(rows["over"]), where, random))
    labels = ["method", "bounds", "runs within", "error/rtol", "worst", "hard random problems"]
    return view("tolerances", frame_of(lines, labels))


def tolerance_scenes(frames: Frames) -> View:
    rows = asked_for(frames["runs"])
    return view("tolerance_scenes", matrix(rows, "method", "scene", lambda own: spread(own["over"])))


def tolerance_figure(frames: Frames) -> Figure | None:
    """Return the median error reached against the tolerance asked for, on the scenes that every solver runs."""
    rows = asked_for(frames["runs"])
    shared = [name for name, scene in SCENES.items() if scene.mission]
    rows = rows[rows["scene"].isin(shared)]
    rows = rows[rows.groupby("method")["scene"].transform("nunique") > 1]
    rows = rows.groupby(["method", "family", "setting"], as_index=False, sort=False)["error"].median()
    curves = by_method(rows, "setting", "error")
    if not curves:
        return None
    asked = Axis("tolerance asked for (tighter to the right)", "log", inverted=True)
    reached = Axis("error reached, median", "log")
    same = Curve(ASKED, ASKED, "error = tolerance", role="guide", markers=False)
    panel = Panel("", asked, reached, (same, *only(curves, choose(curves, lowest))))
    return chart("tolerances", [panel], scenes=names(shared))


@chapter("cost", answers)
def parts(frames: Frames) -> list[Part | None]:
    runs = frames["runs"]
    scenes = runs["scene"][runs["saved"] == 1].unique()
    tables = [leaders_view(standings(frames, kind), kind) for kind in KINDS]
    each = [Section(scene, (figure(frames, scene),)) for scene in scenes]
    return [
        Section("Who is cheapest where", (Text(PROSE["cost"]["legend"]), *tables)),
        tolerance_view(frames),
        tolerance_figure(frames),
        tolerance_scenes(frames),
        Section("Scene by scene", (Text(PROSE["cost"]["scenes"]), *each)),
    ]


# -- figures ---------------------------------------------------------------------------------------
#: beyond an error of two there is nothing left of the motion, below round-off nothing is known
ERROR = Axis("error of the solution (more accurate to the right)", "log", inverted=True, within=(1e-16, 2.0))
#: the axis of each kind of cost that is drawn, and its scale
AXES = {"compiled": ("time of a solve, µs", 1e6), "evaluations": ("evaluations", 1.0)}


def compared(frames: Frames, scene: str, kind: str) -> pd.DataFrame:
    tables, given = which(frames, kind)
    rows = comparable(*tables, **given)
    rows = rows[(rows["scene"] == scene) & (rows["status"] == "ok") & rows["spent"].notna()]
    totals = rows.groupby(["method", "engine"])["spent"].transform("median")
    best = rows.assign(total=totals).groupby("method")["total"].transform("min")
    return rows[totals == best].drop_duplicates(["method", "control", "setting"])


def figure(frames: Frames, scene: str) -> Figure | None:
    title, named = message(frames, scene)
    drawn: list[str] = []
    panels = []
    for kind, (label, size) in AXES.items():
        curves = by_method(compared(frames, scene, kind), "error", "spent", size)
        if curves:
            drawn = drawn or choose(curves, cheapest, named)
            cost = contest_end(Axis(label, "log"), curves)
            panels.append(Panel(ENTRIES[kind]["title"], ERROR, cost, only(curves, drawn)))
    return chart("cost", panels, f"cost_{scene}", title=title)


def message(frames: Frames, scene: str) -> tuple[str, list[str]]:
    """Return the title of a scene's figure, by the contest of compiled times, and the methods that it names."""
    rows = standings(frames, "compiled")
    table = sides(rows[rows["scene"] == scene])
    table = table[np.isfinite(table["ratio"]) & (table["ratio"] > 0)].sort_values("error", ascending=False)
    if not len(table):
        return f"{scene}: cost against error", []
    row = table.iloc[(len(table) - 1) // 2]
    at, both, ratio = f"at an error of {power(row['error'])}", [row["ours"], row["other"]], row["ratio"]
    if 1 / row["margin"] <= ratio <= row["margin"]:
        found = "take the same time within 25 %" if row["margin"] <= 1.25 else "are within the timing margin"
        return f"{scene}: {both[0]} and {both[1]} {found} {at}", both
    if ratio > 1:
        both, ratio = both[::-1], 1 / ratio
    return f"{scene}: {both[0]} needs {100 * ratio:.0f} % of the time of {both[1]} {at}", both
