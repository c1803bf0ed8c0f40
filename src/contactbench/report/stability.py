"""Hard scenes: how every method ends, and at what error and cost; limits of steps, and strong damping."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pandas as pd

from contactbench.measure.statistics import ALIKE, COUNTED
from contactbench.report.chapters import Answer, Frames, Part, Section, Text, chapter, chart, view
from contactbench.report.curves import by_method, choose, highest, only
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.report.laws import LEGEND, drift_cell, law_label, least_errors
from contactbench.report.numbers import DASH, count, how_often, names, scientific
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of, matrix
from contactbench.report.work_precision import Contest, contest, losses_view, tally, winners_view
from contactbench.tables.contest import EVALUATIONS
from contactbench.tables.declared import STABILITY
from contactbench.tables.judgement import laws_in
from contactbench.tables.schema import numbers

#: with which the others are compared under strong damping: a composition without steps against time
BASE = "contact-strang"
#: above this condition number the round-off of a solution is more than round-off
WELL_CONDITIONED = 1e3
LADDER = "Settings from coarse to fine; h/n: the time that an evaluation of a fixed-step method is worth."


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


# -- views -----------------------------------------------------------------------------------------
def rungs(rows: pd.DataFrame) -> list[str]:
    heads = []
    for _, part in rows.groupby(rows.groupby(["method", "engine"]).cumcount()):
        steps, rtol = part[part["control"] == "step"], part[part["control"] == "rtol"]["value"].max()
        each = (steps["end_time"] / steps["rhs_equivalents"]).max()
        known = {f"h/n {each:.3g}": each, f"rtol {scientific(rtol, 0)}": rtol}
        heads.append(", ".join(text for text, value in known.items() if pd.notna(value)))
    return heads


def ending(run: pd.Series) -> Cell:
    if run["status"] == "ok":
        return as_cell(run["solution_error"], lambda error: scientific(error, 0))
    return Cell(str(run["status"]))


def scene_view(here: pd.DataFrame, scene: str) -> View:
    unsupported = here["status"] == "unsupported"
    rows = here[~unsupported]
    steps, ok = rungs(rows), rows[rows["status"] == "ok"]
    laws = [n for n in laws_in(STABILITY, "stability") if n != "solution_error" and ok[n].notna().any()]
    lines = []
    for method, own in rows.groupby("method", sort=False):
        ladder = [ending(run) for _, run in own.iterrows()]
        ladder += [Cell(DASH)] * (len(steps) - len(own))
        good = own[own["status"] == "ok"]
        finest = as_cell(good["rhs_equivalents"].max(), count)
        lines.append((method, *ladder, *(worst_cell(good, law) for law in laws), finest))
    labels = [("", "method"), *(("solution error", step) for step in steps)]
    labels += [*(("worst", law_label(law)) for law in laws), ("", "evaluations")]
    condition, left = numbers(rows, "condition_number").max(), here[unsupported]["method"].unique()
    notes = f"Out of reach of {names(list(left))}. " if len(left) else ""
    if condition > WELL_CONDITIONED:
        round_off = scientific(condition * np.finfo(float).eps)
        notes += f"Condition number {scientific(condition)}: round-off comes to {round_off}."
    return View(f"hard_{scene}", scene, frame_of(lines, labels), notes.strip())


def worst_cell(runs: pd.DataFrame, law: str) -> Cell:
    """Return the largest deviation of a method's runs; bold only where every one of them keeps the law."""
    cells = [drift_cell(run, law) for _, run in runs.dropna(subset=law).iterrows()]
    if not cells:
        return Cell(DASH)
    worst = max(cells, key=lambda cell: cell.value or 0.0)
    return worst if all(cell.mark is Mark.kept for cell in cells) else replace(worst, mark=None)


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
    hard, limits, own = frames["stability"], frames["stability_limits"], hard_contest(frames)
    if len(own.contests):
        yield winners_view(own, "hard_winners")
        yield losses_view({own.kind.title: own.contests}, "hard_losses")
    yield limits_view(limits)
    yield stability_map(limits)
    yield rates_view(frames["damping_rates"])
    yield strong_view(frames["strong_damping"])
    scenes = (scene_view(here, str(scene)) for scene, here in hard.groupby("scene", sort=False))
    yield Section("Scene by scene", (Text(f"{LADDER} {LEGEND}"), *scenes))
