"""Hard scenes: how every method ends, and at what error and cost."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from contactbench.report.cells import DASH, Cell, Head, Mark, View, marks, number, word
from contactbench.report.contest import EVALUATIONS, Field, standing
from contactbench.report.escape import blow_up_view
from contactbench.report.figures import hard as figures
from contactbench.report.kept import MEANINGS, bounded, called, drift_cell, laws, numbers
from contactbench.report.numbers import count, many, names, scientific
from contactbench.report.raw import raw
from contactbench.report.rooms import ROOMS, Finding, Frames, Part, Room, Section, Text
from contactbench.results.schema import Rule
from contactbench.results.tables import STABILITY

#: above this condition number the round-off of a solution is more than round-off
WELL_CONDITIONED = 1e3
#: what a head of the ladder says
SETTINGS = (
    "Heads name the settings: h/n, the time that an evaluation of a fixed-step method is worth (its step over the "
    "evaluations of a step, as near as the saved times allow), and the tolerance of an adaptive one (the loosest, "
    "where they differ)"
)


def rungs(here: pd.DataFrame) -> list[str]:
    """What the settings of a scene's ladder are, coarse to fine."""
    tried = here[here["status"] != "unsupported"]
    rung = tried.groupby(["method", "engine"]).cumcount()
    heads = []
    for k in range(int(rung.max()) + 1 if len(tried) else 0):
        part = tried[rung == k]
        steps = part[part["control"] == "step"]
        each, rtols = steps["end_time"] / steps["rhs_equivalents"], part[part["control"] == "rtol"]["value"]
        said = [f"h/n {each.max():.3g}"] if each.notna().any() else []
        said += [f"rtol {scientific(rtols.max(), 0)}"] if len(rtols) else []
        heads.append(", ".join(said) or f"setting {k + 1}")
    return heads


def runs_by(frame: pd.DataFrame, *keys: str) -> dict[Any, list[dict[Any, Any]]]:
    """The rows of a frame by the values of some columns; picking them from the frame takes longer."""
    found = defaultdict(list)
    for row in frame.to_dict("records"):
        found[tuple(row[key] for key in keys)].append(row)
    return found


def ending(row: dict[Any, Any], digits: int = 0) -> Cell:
    """The error of a run, or how it ended; where the true motion reaches infinity, diverging is right."""
    if row["status"] == "ok":
        return number(row["solution_error"], lambda e: scientific(e, digits), hint=str(row["setting"]))
    right = row["status"] == "diverged" and not pd.isna(row["blow_up_time"])
    mark = Mark.right if right else Mark.none if row["status"] == "unsupported" else Mark.bad
    return Cell(str(row["status"]), marks=marks(mark), hint=f"{row['setting']}: {row['message']}")


def map_view(frame: pd.DataFrame) -> View:
    """Every run at a glance: methods × scenes, each with its ladder of settings."""
    scenes = {scene: rungs(here) for scene, here in frame.groupby("scene", sort=False)}
    told = ["status", "solution_error", "setting", "message", "blow_up_time"]
    rows, runs = [], runs_by(frame[["scene", "method", *told]], "scene", "method")
    for method in dict.fromkeys(frame["method"]):
        cells = [word(method)]
        for scene, steps in scenes.items():
            mine = runs[scene, method]
            cells += [*map(ending, mine), *(Cell(DASH) for _ in range(len(steps) - len(mine)))]
        rows.append(tuple(cells))
    heads = (
        Head("method", words=True),
        *(Head(rung, group=str(s)) for s, steps in scenes.items() for rung in steps),
    )
    meaning = f"Solution error at each setting, coarse to fine, or how the run ended. {SETTINGS}."
    return View(
        "how_it_ends", "How it ends", meaning, heads, tuple(rows), "stability.csv", detail=True, map=True
    )


def scene_view(frame: pd.DataFrame, scene: str) -> View:
    """One hard scene: the ladder of errors, the worst of each law, the cost of the finest run."""
    here = frame[frame["scene"] == scene]
    steps = rungs(here)
    part = bounded(here[here["status"] != "unsupported"])
    ok = part[part["status"] == "ok"]
    shown = [law for law in laws(STABILITY, "stability") if law != "solution_error" and ok[law].notna().any()]
    rows = []
    for (method,), mine in runs_by(part, "method").items():
        good = [run for run in mine if run["status"] == "ok"]
        cells = [word(method), *map(ending, mine), *(Cell(DASH) for _ in range(len(steps) - len(mine)))]
        cells += [worst_cell([run for run in good if not pd.isna(run[law])], law) for law in shown]
        spent = [run["rhs_equivalents"] for run in good if not pd.isna(run["rhs_equivalents"])]
        cells.append(number(max(spent, default=None), count))
        whys = dict.fromkeys(run["message"] for run in mine if run["status"] != "ok" and run["message"])
        cells.append(word(shortened("; ".join(whys))))
        rows.append(tuple(cells))
    labels = (Head(called(law), STABILITY.columns[law].meaning, group="worst") for law in shown)
    heads = (
        Head("method", words=True), *(Head(rung, group="solution error") for rung in steps), *labels,
        Head("evaluations", "of the finest run that ended ok"), Head("why not ok", words=True),
    )  # fmt: skip
    meaning = " ".join(filter(None, [condition_note(part), left_out(here[here["status"] == "unsupported"])]))
    return View(f"hard_{scene}", f"Errors and laws on {scene}", meaning, heads, tuple(rows), "stability.csv")


def worst_cell(rows: list[dict[Any, Any]], law: str) -> Cell:
    """The largest deviation of a method's runs; bold only where every one of them keeps the law."""
    if not rows:
        return Cell(DASH)
    cells = [drift_cell(row, law) for row in rows]
    worst = cells[int(np.argmax([float(row[law]) for row in rows]))]
    return (
        worst
        if all(Mark.kept in cell.marks for cell in cells)
        else replace(worst, marks=worst.marks - {Mark.kept})
    )


def left_out(rows: pd.DataFrame) -> str:
    """Which methods a scene is out of reach for, and why."""
    why = [
        f"{names(list(dict.fromkeys(part['method'])))} ({message})"
        for message, part in rows.groupby("message", sort=False)
    ]
    return f"Out of reach of {'; '.join(why)}." if why else ""


def shortened(text: str) -> str:
    return text if len(text) <= 90 else text[:89] + "…"


def condition_note(part: pd.DataFrame) -> str:
    condition = numbers(part, "condition_number").max()
    if not condition > WELL_CONDITIONED:
        return ""
    return (
        f"Condition number {scientific(condition)}: round-off alone makes an error of about "
        f"{scientific(condition * np.finfo(float).eps)}."
    )


def findings(frames: Frames) -> list[Finding]:
    hard = frames["stability"]
    found = []
    never = (hard["status"] == "budget") & hard["end_time"].isna()
    tried = hard[(hard["status"] != "unsupported") & ~never]
    if len(tried):
        right = np.where(tried["blow_up_time"].isna(), tried["status"] == "ok", tried["status"] == "diverged")
        bad = tried[~right]
        clean = [m for m in dict.fromkeys(tried["method"]) if m not in set(bad["method"])]
        most = bad.groupby("method", sort=False).size().sort_values(ascending=False, kind="stable")
        sentence = (
            f"{len(tried) - len(bad)} of {len(tried)} runs end as the true motion does, accurate or not. "
            + (f"All runs of {names(clean)} do." if clean else "No method has all of its runs among them.")
        )
        if len(most):
            third = most.iloc[min(2, len(most) - 1)]
            often = [f"{method} {n}" for method, n in most[most >= third].items()]
            sentence += f" Most of the others: {names(often)}"
            kinds = bad["status"].value_counts()
            sentence += (
                f"; by kind {names([f'{kind} {n}' for kind, n in kinds.items()])} (budget: our own limit)."
            )
        if never.any():
            sentence += (
                f" {many(int(never.sum()), 'setting')} not run: a looser tolerance had spent the budget."
            )
        found.append(
            Finding(
                "endings",
                "Hard scenes",
                sentence,
                f"{tried['method'].nunique()} methods on {tried['scene'].nunique()} scenes",
            )
        )
    if said := standing(Field(hard, EVALUATIONS)):
        found.append(Finding("hard_cost", "Evaluations on the hard scenes", *said))
    return found


def sections(frames: Frames) -> list[Part]:
    hard = frames["stability"]
    meanings = tuple(
        f"{called(name)}: {c.meaning}" + (" (a law that is kept or not)" if c.rule is Rule.structure else "")
        for name, c in laws(STABILITY, "stability").items()
    )
    ends = blow_up_view(hard)
    parts: list[Part] = [
        Text(
            "Every method on every hard scene at a ladder of settings, coarse to fine. Runs are isolated and limited "
            "in steps and evaluations; how each ended is part of the result. Which method is cheapest where is in "
            "[README.md](README.md). Of a law that is kept or not, bold: every run keeps it to round-off. "
            f"{MEANINGS['dagger']}. {MEANINGS['undecided']}. {SETTINGS}."
        ),
        *figures.hard(hard),
        *([ends] if ends else []),
        map_view(hard),
    ]
    scenes = tuple(
        Section(scene, (scene_view(hard, scene),), choice="scene") for scene in dict.fromkeys(hard["scene"])
    )
    parts.append(Section("Scene by scene", (Text(items=meanings), *scenes)))
    return [*parts, raw(STABILITY, hard)]


ROOMS.add(
    Room(
        "stability", "Numerical stability on hard scenes", "how every method ends on the hard scenes, at what error",
        50, ("stability",), sections, findings, tab="Hard scenes",
    )
)  # fmt: skip
