"""Hard scenes: how every method ends, and at what error and cost; limits of steps, and strong damping."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pandas as pd

from contactbench.measure.statistics import ALIKE, COUNTED
from contactbench.questions.contest import EVALUATIONS
from contactbench.questions.laws import least_errors
from contactbench.questions.work_precision import Contest, contest, losses_view, tally, winners_view
from contactbench.report.chapters import Answer, Frames, Part, chapter, chart, view
from contactbench.report.curves import by_method, choose, highest, only
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.report.numbers import DASH, count, how_often, names, scientific
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of, matrix

#: with which the others are compared under strong damping: a composition without steps against time
BASE = "contact-strang"


@lru_cache(2)
def hard_contest(frames: Frames) -> Contest:
    return contest(frames["stability"], EVALUATIONS)


def started_runs(hard: pd.DataFrame) -> pd.DataFrame:
    """Return the runs that were started; right : it ends as the true motion does, in time or by diverging."""
    skipped = (hard["status"] == "budget") & hard["end_time"].isna()
    rows = hard[(hard["status"] != "unsupported") & ~skipped]
    wanted = rows["blow_up_time"].isna().map({True: "ok", False: "diverged"})
    return rows.assign(right=rows["status"] == wanted)


def answers(frames: Frames) -> Iterator[Answer]:
    rows, won = started_runs(frames["stability"]), hard_contest(frames).contests
    right = int(rows["right"].sum())
    count = f"{right} of {len(rows)} runs"
    yield Answer("Do runs end as the true motion does?", how_often(right, len(rows)), count)
    if len(won):
        yield Answer("Does a contact method need the fewest evaluations on hard scenes?", *tally(won))


# -- how runs end ----------------------------------------------------------------------------------
def ending(runs: pd.DataFrame) -> Cell:
    """Return the smallest error of some runs, or how they ended; marked where one does not end as the motion does."""
    ok = runs[runs["status"] == "ok"]
    mark = None if runs["right"].all() else Mark.exception
    if len(ok):
        return as_cell(ok["solution_error"].min(), lambda error: scientific(error, 0), mark)
    return Cell(names(list(dict.fromkeys(runs["status"]))), mark=mark)


def endings_view(hard: pd.DataFrame) -> View:
    return view("hard_endings", matrix(started_runs(hard), "method", "scene", ending))


# -- limits of steps -------------------------------------------------------------------------------
def limit_cell(rows: pd.DataFrame) -> Cell:
    row = rows.iloc[0]
    cell, theory = (as_cell(row[name], "{:.4g}".format) for name in ("limit", "theory"))
    text = cell.text if theory.value is None else f"{cell.text} ({theory.text})"
    return replace(cell, text=text, mark=Mark.exception if row["windows"] else None)


def limits_view(frame: pd.DataFrame) -> View:
    one = frame[(frame["omega"] == 1.0) & frame["limit"].notna()].sort_values("gamma", kind="stable")
    return view("limit", matrix(one, "method", "gamma", limit_cell, "γ = {:g}".format))


def stability_map(frame: pd.DataFrame) -> Figure | None:
    rows = frame[frame["gamma"] > 0].assign(ratio=lambda f: f["gamma"] / f["omega"])
    rows = rows.sort_values("ratio", kind="stable").drop_duplicates(["method", "ratio"])
    rows = rows.assign(scaled=rows["per_evaluation"] * rows["omega"])
    curves = by_method(rows, "ratio", "scaled")
    last = rows[rows["ratio"] == rows["ratio"].max()].set_index("method")["scaled"]
    title, subjects = "First loss of stability", []
    if len(finite := last[np.isfinite(last)]):
        subjects = [finite.idxmax()]
        first = f"{subjects[0]} is stable to {finite.max():.3g}/ω an evaluation"
        title = f"At γ = {rows['ratio'].max():g} ω {first}, the median method to {last.median():.2g}/ω"
    drawn = only(curves, choose(curves, highest, by_order=True, subjects=subjects))
    panel = Panel("", Axis("γ/ω", "log"), Axis("ω × first unstable step / evaluations", "log"), drawn)
    return chart("stability_map", [panel], title=title)


# -- damping ---------------------------------------------------------------------------------------
def rates_view(frame: pd.DataFrame) -> View:
    ok = frame[frame["status"] == "ok"]
    creep, weak = ok[ok["experiment"] == "overdamped"], ok[ok["experiment"] == "weak"]
    adaptive = creep[creep["damping_per_step"].isna()]
    rows = [
        (f"slow rate of creep, γh = {damping:g}", *at_equal_cost(fixed, adaptive))
        for damping, fixed in reversed([*creep.groupby("damping_per_step")])
    ]
    for (scene, span), part in weak.groupby(["scene", "t_end"], sort=False):
        steps = part["control"] == "step"
        name = f"rate of weak damping, `{scene}`, T = {span:.0e}"
        rows.append((name, *at_equal_cost(part[steps], part[~steps])))
    return view("rates", frame_of(rows, ["rate", "most accurate", "evaluations allowed"]), alike=ALIKE)


def at_equal_cost(fixed: pd.DataFrame, adaptive: pd.DataFrame) -> tuple[Cell, Cell]:
    budget = COUNTED * float((fixed if len(fixed) else adaptive)["evaluations"].max())
    rows = pd.concat([fixed, adaptive[adaptive["evaluations"] <= budget]])
    errors = rows.groupby("method", sort=False)["rate_error"].min()
    return best_cell(errors.astype(float)), as_cell(budget, count)


def best_cell(errors: pd.Series) -> Cell:
    errors = errors[errors < 1]
    if not len(errors):
        return Cell(DASH)
    first = least_errors(errors)
    return Cell(
        f"{names(first, 3)} {scientific(errors.min())}", mark=Mark.tie if len(first) > 1 else Mark.best
    )


def usable(rows: pd.DataFrame, base: pd.DataFrame) -> float:
    """Return the largest γh per evaluation up to which a method is never worse than the base; 0 if nowhere."""
    errors, others = (part.set_index("damping_per_evaluation")["error"].sort_index() for part in (rows, base))
    worse = (errors > others * 1.001).to_numpy()
    first = int(np.argmax(worse)) if worse.any() else len(worse)
    return float(errors.index[first - 1]) if first else 0.0


def strong_view(frame: pd.DataFrame) -> View:
    bases = dict(list(frame[frame["method"] == BASE].groupby("gamma")))
    rows = frame[frame["gamma"].isin(bases) & (frame["method"] != BASE)].sort_values("gamma", kind="stable")

    def cell(rows: pd.DataFrame) -> Cell:
        return as_cell(usable(rows, bases[rows["gamma"].iloc[0]]), "{:.2g}".format)

    return view("strong_usable", matrix(rows, "method", "gamma", cell, "γ = {:g}".format), base=BASE)


@chapter("stability", answers)
def parts(frames: Frames) -> Iterator[Part | None]:
    limits, own = frames["stability_limits"], hard_contest(frames)
    yield endings_view(frames["stability"])
    if len(own.contests):
        yield winners_view(own, "hard_winners")
        yield losses_view({own.kind.title: own.contests}, "hard_losses")
    yield limits_view(limits)
    yield stability_map(limits)
    yield rates_view(frames["damping_rates"])
    yield strong_view(frames["strong_damping"])
