"""Hard scenes: how every method ends, and at what error and cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part, Section, Text, once, summary
from contactbench.report.law_cells import LEGEND, drift_cell, law_label, with_bounds
from contactbench.report.numbers import DASH, count, how_often, names, scientific
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of
from contactbench.report.work_precision import Contest, contest, losses_view, tally, winners_view
from contactbench.results.contest import EVALUATIONS
from contactbench.results.judgement import laws_in
from contactbench.results.schema import numbers
from contactbench.results.tables import STABILITY

SOURCE = "stability.csv"
#: above this condition number the round-off of a solution is more than round-off
WELL_CONDITIONED = 1e3
LADDER = (
    "Columns are settings, coarse to fine: h/n, the time that an evaluation of a fixed-step method is worth, and the "
    "tolerance of an adaptive one."
)


def hard_contest(frames: Frames) -> Contest:
    """Return who needs the fewest evaluations on the hard scenes."""
    return contest(frames["stability"], EVALUATIONS)


def started_runs(hard: pd.DataFrame) -> pd.DataFrame:
    """Return the runs that were started: supported, and no looser tolerance had spent the budget.

    right : it ends as the true motion does: in time, or where that reaches infinity by diverging.
    """
    skipped = (hard["status"] == "budget") & hard["end_time"].isna()
    rows = hard[(hard["status"] != "unsupported") & ~skipped]
    wanted = rows["blow_up_time"].isna().map({True: "ok", False: "diverged"})
    return rows.assign(right=rows["status"] == wanted)


def answers(frames: Frames) -> pd.DataFrame:
    rows, won = started_runs(frames["stability"]), once(hard_contest, frames).contests
    right = int(rows["right"].sum())
    lines = [
        ("Do runs end as the true motion does?", how_often(right, len(rows)), f"{right} of {len(rows)} runs")
    ]
    if len(won):
        lines.append(("Does a contact method need the fewest evaluations on hard scenes?", *tally(won)))
    return summary(*lines)


# -- views -----------------------------------------------------------------------------------------
def endings_view(rows: pd.DataFrame) -> View:
    """Return how many runs of each method end as the motion does, and how the others end."""
    kinds = list(dict.fromkeys(rows[~rows["right"]]["status"]))
    lines = []
    for method, own in rows.groupby("method", sort=False):
        bad = own[~own["right"]]["status"].value_counts()
        share = f"{int(own['right'].sum())} of {len(own)}"
        right = Cell(share, own["right"].mean(), None if len(bad) else Mark.best)
        lines.append((method, right, *(int(bad.get(kind, 0)) for kind in kinds)))
    lines.sort(key=lambda line: -line[1].value)
    legend = "Runs that end as the true motion does, accurate or not; and the others. Budget: our own limit."
    return View("hard_endings", "How runs end", frame_of(lines, ["method", "right", *kinds]), legend, SOURCE)


def rungs(rows: pd.DataFrame) -> list[str]:
    """Return the settings of a scene's ladder, coarse to fine."""
    rung = rows.groupby(["method", "engine"]).cumcount()
    heads = []
    for _, part in rows.groupby(rung):
        steps, rtols = part[part["control"] == "step"], part[part["control"] == "rtol"]["value"]
        each = (steps["end_time"] / steps["rhs_equivalents"]).max()
        head = [f"h/n {each:.3g}"] * pd.notna(each) + [f"rtol {scientific(rtols.max(), 0)}"] * bool(
            len(rtols)
        )
        heads.append(", ".join(head) or "setting")
    return heads


def ending(run: pd.Series) -> Cell:
    """Return the error of a run, or how it ended."""
    if run["status"] == "ok":
        return as_cell(run["solution_error"], lambda error: scientific(error, 0))
    right = run["status"] == "diverged" and not pd.isna(run["blow_up_time"])
    return Cell(str(run["status"]), mark=Mark.right if right else Mark.bad)


def scene_view(frame: pd.DataFrame, scene: str) -> View:
    """Return one hard scene: the ladder of errors, the worst of each law, the cost of the finest run."""
    here = frame[frame["scene"] == scene]
    rows = with_bounds(here[here["status"] != "unsupported"])
    steps, ok = rungs(rows), rows[rows["status"] == "ok"]
    laws = [
        law for law in laws_in(STABILITY, "stability") if law != "solution_error" and ok[law].notna().any()
    ]
    lines = []
    for method, own in rows.groupby("method", sort=False):
        runs = own.to_dict("records")
        good = [run for run in runs if run["status"] == "ok"]
        ladder = [*map(ending, runs), *[Cell(DASH)] * (len(steps) - len(runs))]
        finest = own[own["status"] == "ok"]["rhs_equivalents"].max()
        lines.append((method, *ladder, *(worst_cell(good, law) for law in laws), as_cell(finest, count)))
    labels = [("", "method"), *(("solution error", step) for step in steps)]
    labels += [*(("worst", law_label(law)) for law in laws), ("", "evaluations")]
    condition, left = numbers(rows, "condition_number").max(), here[here["status"] == "unsupported"]["method"]
    notes = [f"Out of reach of {names(list(dict.fromkeys(left)))}."] * bool(len(left))
    if condition > WELL_CONDITIONED:
        round_off = scientific(condition * np.finfo(float).eps)
        notes.append(f"Condition number {scientific(condition)}: round-off comes to {round_off}.")
    return View(f"hard_{scene}", "Errors and laws", frame_of(lines, labels), " ".join(notes), SOURCE)


def worst_cell(runs: list[dict[str, object]], law: str) -> Cell:
    """Return the largest deviation of a method's runs; bold only where every one of them keeps the law."""
    cells = [drift_cell(run, law) for run in runs if not pd.isna(run[law])]
    if not cells:
        return Cell(DASH)
    worst = max(cells, key=lambda cell: cell.value or 0.0)
    return worst if all(cell.mark is Mark.kept for cell in cells) else replace(worst, mark=None)


def parts(frames: Frames) -> list[Part]:
    hard, own = frames["stability"], once(hard_contest, frames)
    scenes = (Section(s, (scene_view(hard, s),), "scene") for s in dict.fromkeys(hard["scene"]))
    found: list[Part] = [endings_view(started_runs(hard))]
    if len(own.contests):
        lost = {own.kind.title: own.contests}
        found += [winners_view(own, "hard_winners", SOURCE), losses_view(lost, "hard_losses", SOURCE)]
    return [*found, Section("Scene by scene", (Text(f"{LADDER} {LEGEND}"), *scenes))]


TITLE, QUESTION = "Numerical stability on hard scenes", "How does every method end on the hard scenes?"
CHAPTERS.add(Chapter("stability", TITLE, QUESTION, 50, ("stability",), parts, answers))
