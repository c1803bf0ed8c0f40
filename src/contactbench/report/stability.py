"""Hard scenes: how every method ends, and at what error and cost."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part, Section, Text, once, summary
from contactbench.report.escape import blow_up_view
from contactbench.report.law_cells import LEGEND, drift_cell, law_label, meanings, with_bounds
from contactbench.report.numbers import DASH, count, how_often, names, scientific
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of
from contactbench.report.work_precision import Contest, contest, losses_view, tally, winners_view
from contactbench.results.contest import EVALUATIONS
from contactbench.results.judgement import laws_in, numbers
from contactbench.results.tables import STABILITY

SOURCE = "stability.csv"
#: above this condition number the round-off of a solution is more than round-off
WELL_CONDITIONED = 1e3
SETTINGS = (
    "Columns are settings, coarse to fine: h/n, the time that an evaluation of a fixed-step method is worth, and the "
    "tolerance of an adaptive one."
)
type Run = dict[Any, Any]


def ends_right(tried: pd.DataFrame) -> np.ndarray:
    """Return which runs end as the true motion does: in time, or where that reaches infinity by diverging."""
    return np.where(tried["blow_up_time"].isna(), tried["status"] == "ok", tried["status"] == "diverged")


def tried_runs(hard: pd.DataFrame) -> pd.DataFrame:
    """Return the runs that were started: supported, and no looser tolerance had spent the budget."""
    skipped = (hard["status"] == "budget") & hard["end_time"].isna()
    return hard[(hard["status"] != "unsupported") & ~skipped]


def hard_contest(frames: Frames) -> Contest:
    """Return who needs the fewest evaluations on the hard scenes."""
    return contest(frames["stability"], EVALUATIONS)


def answers(frames: Frames) -> pd.DataFrame:
    tried = tried_runs(frames["stability"])
    right = int(ends_right(tried).sum())
    won = once(hard_contest, frames).contests
    lines = [
        (
            "Do runs end as the true motion does?",
            how_often(right, len(tried)),
            f"{right} of {len(tried)} runs",
        )
    ]
    if len(won):
        lines.append(("Does a contact method need the fewest evaluations on hard scenes?", *tally(won)))
    return summary(*lines)


# -- views -----------------------------------------------------------------------------------------
def endings_view(hard: pd.DataFrame) -> View:
    """Return how many runs of each method end as the motion does, and how the others end."""
    tried = tried_runs(hard)
    tried = tried.assign(right=ends_right(tried))
    kinds = list(dict.fromkeys(tried[~tried["right"]]["status"]))
    rows = []
    for method, own in tried.groupby("method", sort=False):
        bad = own[~own["right"]]["status"].value_counts()
        mark = None if len(bad) else Mark.best
        share = Cell(f"{int(own['right'].sum())} of {len(own)}", own["right"].mean(), mark)
        rows.append((method, share, *(int(bad.get(kind, 0)) for kind in kinds)))
    rows.sort(key=lambda row: -row[1].value)
    legend = "Runs that end as the true motion does, accurate or not; and the others. Budget: our own limit."
    return View("hard_endings", "How runs end", frame_of(rows, ["method", "right", *kinds]), legend, SOURCE)


def rungs(here: pd.DataFrame) -> list[str]:
    """Return the settings of a scene's ladder, coarse to fine."""
    tried = here[here["status"] != "unsupported"]
    rung = tried.groupby(["method", "engine"]).cumcount()
    heads = []
    for k in range(int(rung.max()) + 1 if len(tried) else 0):
        part = tried[rung == k]
        steps = part[part["control"] == "step"]
        each, rtols = steps["end_time"] / steps["rhs_equivalents"], part[part["control"] == "rtol"]["value"]
        head = [f"h/n {each.max():.3g}"] if each.notna().any() else []
        head += [f"rtol {scientific(rtols.max(), 0)}"] if len(rtols) else []
        heads.append(", ".join(head) or f"setting {k + 1}")
    return heads


def runs_by(frame: pd.DataFrame, *keys: str) -> dict[Any, list[Run]]:
    """Return the rows of a frame by the values of some columns."""
    found = defaultdict(list)
    for row in frame.to_dict("records"):
        found[tuple(row[key] for key in keys)].append(row)
    return found


def ending(run: Run) -> Cell:
    """Return the error of a run, or how it ended."""
    if run["status"] == "ok":
        return as_cell(run["solution_error"], lambda error: scientific(error, 0))
    right = run["status"] == "diverged" and not pd.isna(run["blow_up_time"])
    mark = Mark.right if right else Mark.none if run["status"] == "unsupported" else Mark.bad
    return Cell(str(run["status"]), mark=mark)


def ladder(runs: Sequence[Run], length: int) -> list[Cell]:
    """Return the endings of a method's runs, filled up with dashes."""
    return [*map(ending, runs), *[Cell(DASH)] * (length - len(runs))]


def map_view(frame: pd.DataFrame) -> View:
    """Return every run at a glance: methods × scenes, each with its ladder of settings."""
    scenes = {str(scene): rungs(here) for scene, here in frame.groupby("scene", sort=False)}
    runs = runs_by(frame, "scene", "method")
    rows = []
    for method in dict.fromkeys(frame["method"]):
        cells = [cell for scene, steps in scenes.items() for cell in ladder(runs[scene, method], len(steps))]
        rows.append((method, *cells))
    labels = [("", "method"), *((scene, step) for scene, steps in scenes.items() for step in steps)]
    legend = f"Solution error at each setting, or how the run ended. {SETTINGS}"
    return View("how_it_ends", "Run by run", frame_of(rows, labels), legend, SOURCE, detail=True, map=True)


def scene_view(frame: pd.DataFrame, scene: str) -> View:
    """Return one hard scene: the ladder of errors, the worst of each law, the cost of the finest run."""
    here = frame[frame["scene"] == scene]
    steps = rungs(here)
    part = with_bounds(here[here["status"] != "unsupported"])
    ok = part[part["status"] == "ok"]
    laws = [
        law for law in laws_in(STABILITY, "stability") if law != "solution_error" and ok[law].notna().any()
    ]
    rows = []
    for (method,), runs in runs_by(part, "method").items():
        good = [run for run in runs if run["status"] == "ok"]
        worst = (worst_cell([run for run in good if not pd.isna(run[law])], law) for law in laws)
        spent = [run["rhs_equivalents"] for run in good if not pd.isna(run["rhs_equivalents"])]
        why = dict.fromkeys(run["message"] for run in runs if run["status"] != "ok" and run["message"])
        finest = as_cell(max(spent, default=None), count)
        rows.append((method, *ladder(runs, len(steps)), *worst, finest, "; ".join(why)[:90]))
    labels = [("", "method"), *(("solution error", step) for step in steps)]
    labels += [("worst", law_label(law)) for law in laws] + [("", "evaluations"), ("", "why not ok")]
    legend = " ".join(filter(None, [condition_note(part), left_out(here[here["status"] == "unsupported"])]))
    return View(f"hard_{scene}", "", frame_of(rows, labels), legend, SOURCE, meanings=meanings(laws))


def worst_cell(runs: list[Run], law: str) -> Cell:
    """Return the largest deviation of a method's runs; bold only where every one of them keeps the law."""
    if not runs:
        return Cell(DASH)
    cells = [drift_cell(run, law) for run in runs]
    worst = cells[int(np.argmax([float(run[law]) for run in runs]))]
    return worst if all(cell.mark is Mark.kept for cell in cells) else replace(worst, mark=None)


def left_out(rows: pd.DataFrame) -> str:
    """Return for which methods a scene is out of reach."""
    return f"Out of reach of {names(list(dict.fromkeys(rows['method'])))}." if len(rows) else ""


def condition_note(part: pd.DataFrame) -> str:
    """Return how much round-off the motion itself magnifies, where that is much."""
    condition = numbers(part, "condition_number").max()
    if not condition > WELL_CONDITIONED:
        return ""
    round_off = scientific(condition * np.finfo(float).eps)
    return f"Condition number {scientific(condition)}: round-off comes to {round_off}."


def parts(frames: Frames) -> list[Part]:
    hard = frames["stability"]
    own, ends = once(hard_contest, frames), blow_up_view(hard)
    scenes = (Section(s, (scene_view(hard, s),), choice="scene") for s in dict.fromkeys(hard["scene"]))
    contests: list[Part] = []
    if len(own.contests):
        contests = [
            winners_view(own, "hard_winners", "Fewest evaluations", SOURCE),
            losses_view({own.kind.title: own.contests}, "hard_losses", SOURCE),
        ]
    return [
        endings_view(hard),
        *contests,
        *([ends] if ends else []),
        map_view(hard),
        Section("Scene by scene", (Text(f"{SETTINGS} {LEGEND}"), *scenes)),
    ]


CHAPTERS.add(
    Chapter(
        "stability",
        "Numerical stability on hard scenes",
        "How does every method end on the hard scenes?",
        50,
        ("stability",),
        parts,
        answers,
    )
)
