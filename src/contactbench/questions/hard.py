"""Hard scenes: how every method ends, and at what error and cost; limits of steps, and strong damping."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from contactbench.measure.law import STRUCTURE
from contactbench.measure.statistics import ALIKE, ties
from contactbench.questions.answers import share
from contactbench.questions.contest import hard_runs, ranked, with_family
from contactbench.questions.cost import leaders_view
from contactbench.questions.judgement import SAVED
from contactbench.report.chapters import Answer, Frames, Part, chapter, chart, view
from contactbench.report.curves import by_method, choose, highest, only
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.report.numbers import count, exact_power, names, scientific
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of, matrix

#: with which the others are compared under strong damping: a composition without steps against time
BASE = "contact-strang"
#: evaluations up to which rates of creep are compared, and per unit of time those of weak damping
CREEP, WEAK = (300, 1500, 6000), 10


def answers(frames: Frames) -> Iterator[Answer]:
    asked = "Do runs on hard scenes end as the true motion does?"
    fewest = "Does a contact method need the fewest evaluations on hard scenes?"
    won = f"contests(hard_runs(runs), saved={SAVED}).ratio < 1"
    found = (
        share(frames, asked, "runs", "hard_runs(runs).eval('status == truth')"),
        share(frames, fewest, "pairs of scene and error", won),
    )
    yield from filter(None, found)


# -- how runs end ----------------------------------------------------------------------------------
def ending(runs: pd.DataFrame) -> Cell:
    """Return the smallest error of some runs, or how they ended; marked where one does not end as the motion does."""
    ok = runs[runs["status"] == "ok"]
    mark = None if (runs["status"] == runs["truth"]).all() else Mark.exception
    if len(ok):
        return as_cell(ok["error"].min(), lambda error: scientific(error, 0), mark)
    return Cell(names(list(dict.fromkeys(runs["status"]))), mark=mark)


# -- limits of steps -------------------------------------------------------------------------------
def limit_cell(rows: pd.DataFrame) -> Cell:
    row = rows.iloc[0]
    cell, theory = (as_cell(row[name], "{:.4g}".format) for name in ("measured", "true"))
    text = cell.text if theory.value is None else f"{cell.text} ({theory.text})"
    return replace(cell, text=text, mark=Mark.exception if row["note"] else None)


def limits_view(limits: pd.DataFrame) -> View:
    rows = limits[(limits["question"] == "stability") & limits["measured"].notna()]
    rows = rows.sort_values("gamma", kind="stable")
    return view("limit", matrix(rows, "method", "gamma", limit_cell, "γ = {:g} ω".format))


def stability_map(limits: pd.DataFrame) -> Figure | None:
    rows = limits[(limits["question"] == "stability") & (limits["gamma"] > 0)]
    rows = rows.assign(scaled=rows["measured"] / rows["evaluations"]).sort_values("gamma", kind="stable")
    curves = by_method(rows, "gamma", "scaled")
    last = rows[rows["gamma"] == rows["gamma"].max()].set_index("method")["scaled"]
    title, subjects = "First loss of stability", []
    if len(finite := last[np.isfinite(last)]):
        subjects = [str(finite.idxmax())]
        first = f"{subjects[0]} is stable up to steps of {finite.max():.3g}/ω per evaluation"
        title = f"At γ = {rows['gamma'].max():g} ω {first}, the median method up to {last.median():.2g}/ω"
    drawn = only(curves, choose(curves, highest, subjects, by_order=True))
    panel = Panel("", Axis("γ/ω", "log"), Axis("ω × largest stable step / its evaluations", "log"), drawn)
    return chart("stability_map", [panel], title=title) if curves else None


# -- damping ---------------------------------------------------------------------------------------
def rates_view(limits: pd.DataFrame) -> View:
    """Return who has a damping rate right, of all that take no more evaluations than a number."""
    ok = limits[limits["status"] == "ok"]
    rows = [
        (f"slow rate of creep on `{scene}`", count(most), best_cell(own[own["evaluations"] <= most]))
        for scene, own in ok[ok["question"] == "creep"].groupby("scene", sort=False)
        for most in CREEP
    ]
    for (scene, span), own in ok[ok["question"] == "weak"].groupby(["scene", "t_end"]):
        most = WEAK * float(span)
        what = f"rate of weak damping on `{scene}`, T = {exact_power(span)}"
        rows.append((what, count(most), best_cell(own[own["evaluations"] <= most])))
    return view("rates", frame_of(rows, ["rate", "evaluations at most", "most accurate"]), alike=ALIKE)


def best_cell(rows: pd.DataFrame) -> Cell:
    """Return the methods with the least error, all within a factor of it or at round-off."""
    errors = rows.groupby("method", sort=False)["error"].min().astype(float)
    errors = errors[errors < 1].sort_values(kind="stable")
    if not len(errors):
        return Cell("all errors exceed 100 %")
    first = list(errors.index[(errors <= STRUCTURE) | ties(errors, errors.min(), ALIKE)])
    mark = Mark.tie if len(first) > 1 else Mark.best
    return Cell(f"{names(first, 3)} {scientific(errors.min())}", mark=mark)


def usable(rows: pd.DataFrame, base: pd.DataFrame) -> float:
    """Return the largest γh per evaluation up to which a method is never worse than the base; 0 if nowhere."""
    errors, others = (part.set_index("setting")["error"].sort_index() for part in (rows, base))
    worse = (errors > others * 1.001).to_numpy()
    first = int(np.argmax(worse)) if worse.any() else len(worse)
    return float(errors.index[first - 1]) if first else 0.0


def strong_view(limits: pd.DataFrame) -> View:
    frame = limits[limits["question"] == "strong"]
    bases = dict(list(frame[frame["method"] == BASE].groupby("gamma")))
    rows = frame[frame["gamma"].isin(bases) & (frame["method"] != BASE)].sort_values("gamma", kind="stable")

    def cell(rows: pd.DataFrame) -> Cell:
        return as_cell(usable(rows, bases[rows["gamma"].iloc[0]]), "{:.2g}".format)

    return view("strong_usable", matrix(rows, "method", "gamma", cell, "γ = {:g} ω".format), base=BASE)


# -- damping and the rate of steps ------------------------------------------------------------------
#: the damping of the table, per second
DRAG = 5.0


def ticks_view(limits: pd.DataFrame) -> View | None:
    """Return the errors of a damping rate at the rates of steps that game engines run at."""
    rows = limits[(limits["question"] == "tick") & (limits["gamma"] == DRAG)]
    table = matrix(
        rows,
        "method",
        "setting",
        lambda own: as_cell(own["error"].iloc[0], scientific),
        "{:g} steps a second".format,
    )
    return view("ticks", table, gamma=DRAG) if len(rows) else None


def ticks_figure(limits: pd.DataFrame) -> Figure | None:
    rows = limits[(limits["question"] == "tick") & np.isfinite(limits["error"].astype(float))]
    rows = rows.assign(damping=rows["gamma"] / rows["setting"]).drop_duplicates(["method", "damping"])
    curves = by_method(rows.sort_values("damping", kind="stable"), "damping", "error")
    if not curves:
        return None
    exact = rows.groupby("method", sort=False)["error"].max() <= STRUCTURE
    panel = Panel("", Axis("γh", "log"), Axis("relative error of the damping rate", "log"), tuple(curves))
    return chart("ticks", [panel], exact=names(list(exact.index[exact])))


@chapter("hard", answers)
def parts(frames: Frames) -> Iterator[Part | None]:
    limits, hard = frames["limits"], hard_runs(frames["runs"])
    yield view("hard_endings", matrix(hard, "method", "scene", ending))
    yield leaders_view(ranked(hard, saved=SAVED), "evaluations", "hard_leaders")
    yield limits_view(limits)
    yield stability_map(with_family(limits, frames["runs"]))
    yield rates_view(limits)
    yield strong_view(limits)
    yield ticks_view(limits)
    yield ticks_figure(with_family(limits, frames["runs"]))
