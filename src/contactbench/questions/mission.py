"""The mission: order, laws, errors and costs of its contestants on its three scenes; and the answers to all questions.

It makes results/README.md, and the computed part of the README of the project.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pandas as pd

from contactbench.measure.statistics import WIDEST
from contactbench.questions import claims, cost, hard, laws, orders, problems, ring
from contactbench.questions.answers import evaluate
from contactbench.questions.contest import CONTACT, cost_rows, families
from contactbench.questions.judgement import SAVED, at_cost, law_label, met_cost, structural_laws
from contactbench.report.chapters import PROSE, Answer, Frames, Part, Text, chapter, chapters, chart, view
from contactbench.report.curves import floats
from contactbench.report.drawing import Axis, Curve, Figure, Panel
from contactbench.report.numbers import DASH, count, duration, names, power, scientific
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of

NAME = "README"
#: the mission's scenes and methods; the scene whose costs are drawn
SCENES, METHODS = (PROSE[NAME][what] for what in ("scenes", "methods"))
PICTURED = "particle"
#: errors at which costs stand in its tables; the last decides who is the best contact method, and who the fastest
ERRORS = (1e-3, 1e-6)
#: laws of its tables, that of the map last; J stands where a method claims it
LAWS = ("energy_law", "momentum_law", "contact_drift")
#: the laws that a reader asks about first
PROMISED = {"momentum_law": "J", "contact_drift": "the contact form"}
#: kinds of cost that a reader asks about, in order; the first stands in the README of the project
ASKED = ("compiled", "tolerance", "evaluations", "tolerance_evaluations")
SLOWER = "contests(runs, times).assign(slower=lambda c: c.ratio > 1.25).groupby('scene').slower.all()"


# -- the answers -----------------------------------------------------------------------------------
def slower(frames: Frames) -> Answer | None:
    found = evaluate(SLOWER, frames)
    scenes = [f"`{scene}`" for scene in found.index[found]]
    asked = "Where is every contact method more than 25 % slower at every error, compiled?"
    text = f"{int(found.sum())} of {len(found)} scenes"
    return Answer(asked, names(scenes) or "nowhere", text, (SLOWER,)) if len(found) else None


def findings(frames: Frames) -> Iterator[Answer]:
    """Yield the answers that stand in the README of the project."""
    for law, label in PROMISED.items():
        yield from filter(
            None, [laws.kept(frames, law, f"Does a method keep {label} wherever it claims to?")]
        )
    yield from orders.answers(frames)
    yield from filter(None, [cost.answer(frames, ASKED[0])])
    yield from list(problems.answers(frames))[-1:]
    yield from list(ring.answers(frames))[:1]
    yield from claims.answers(frames)


def answers(frames: Frames) -> Iterator[Answer]:
    first = list(findings(frames))
    more = [slower(frames), *(cost.answer(frames, kind) for kind in ASKED[1:]), *hard.answers(frames)]
    more += [*list(problems.answers(frames))[:-1], *list(ring.answers(frames))[1:]]
    yield from [*first, *filter(None, more)]


# -- the contestants -------------------------------------------------------------------------------
def able(frames: Frames, scene: str, method: str) -> bool:
    runs = frames["runs"]
    own = runs[(runs["scene"] == scene) & (runs["method"] == method)]
    return bool((own["status"] != "unsupported").any())


@lru_cache(8)
def contestants(frames: Frames, scene: str) -> list[str]:
    """Return the methods of the mission that run on a scene, with its fastest and its fastest contact method."""
    ranked = cost.standings(frames, "compiled")
    here = ranked[(ranked["scene"] == scene) & (ranked["error"] == ERRORS[-1])].dropna(subset="cost")
    contact = here[here["family"] == CONTACT]
    runs = frames["runs"]
    able = set(runs["method"][(runs["scene"] == scene) & (runs["status"] != "unsupported")])
    found = dict.fromkeys([*METHODS, *contact["method"].head(1), *here["method"].head(1)])
    known = families(runs)
    return sorted((name for name in found if name in able), key=lambda name: known[name] != CONTACT)


@lru_cache(8)
def equal_cost(frames: Frames, scene: str) -> float:
    """Return the number of evaluations at which the contestants are compared on a scene."""
    runs = frames["runs"]
    rows = runs[(runs["scene"] == scene) & (runs["saved"] == SAVED)]
    return met_cost(rows[rows["method"].isin(contestants(frames, scene))])


@lru_cache(64)
def at_equal_cost(frames: Frames, scene: str, method: str) -> pd.Series:
    """Return error, laws and time of a method at the cost at which the contestants are compared."""
    runs, most = frames["runs"], equal_cost(frames, scene)
    rows = runs[(runs["scene"] == scene) & (runs["method"] == method) & (runs["saved"] == SAVED)]
    found = at_cost(rows, most, ["error", *LAWS])
    nothing = pd.Series({"evaluations": np.nan, "error": np.nan, **dict.fromkeys(LAWS, np.nan)})
    found = nothing if found is None else found
    return pd.concat([found, pd.Series({"time": time_of(frames, scene, method, found["evaluations"])})])


def time_of(frames: Frames, scene: str, method: str, evaluations: float) -> float:
    """Return the time of so many evaluations: log-log between timed runs, in proportion beyond the longest of them."""
    timed = cost.compared(frames, scene, "compiled")
    own = timed[timed["method"] == method].sort_values("evaluations", kind="stable")
    spent, seconds = (np.array(floats(own[name])) for name in ("evaluations", "spent"))
    if not len(own) or np.isnan(evaluations):
        return np.nan
    beyond = max(1.0, evaluations / spent[-1])
    return float(np.exp(np.interp(np.log(evaluations), np.log(spent), np.log(seconds))) * beyond)


def claimed(frames: Frames, scene: str, law: str) -> bool:
    rows = frames["runs"]
    return law not in structural_laws() or bool(rows[f"{law}_claimed"][rows["scene"] == scene].any())


def cost_cell(frames: Frames, kind: str, scene: str, method: str, error: float) -> Cell:
    rows = cost.standings(frames, kind)
    own = rows[(rows["scene"] == scene) & (rows["method"] == method) & (rows["error"] == error)]
    if not len(own):
        return Cell(DASH)
    (row,) = cost_rows(own)
    near = row.ratio <= (WIDEST if kind == "compiled" else 1.0)
    return Cell(cost.cost_text(row, kind == "compiled"), mark=Mark.best if near else None)


def scene_view(frames: Frames, scene: str) -> View | None:
    """Return all that is asked of the contestants on a scene: a row each."""
    runs = frames["runs"]
    if not (runs["status"][(runs["scene"] == scene)] == "ok").any():
        return None
    shown = [law for law in LAWS if claimed(frames, scene, law)]
    lines = []
    for method in contestants(frames, scene):
        found = at_equal_cost(frames, scene, method)
        line: list[object] = [method, orders.order_of(frames, scene, method)]
        line += [as_cell(found["evaluations"], count), as_cell(found["error"], scientific)]
        line += [laws.law_cell(found, law) for law in shown] + [as_cell(found["time"], duration)]
        line += [
            cost_cell(frames, kind, scene, method, e) for e in ERRORS for kind in ("evaluations", "compiled")
        ]
        lines.append(line)
    labels = [
        ("", name) for name in ("method", "order", "evaluations", "error", *map(law_label, shown), "time")
    ]
    labels += [(f"to {power(error)}", what) for error in ERRORS for what in ("evaluations", "time")]
    made = view("mission", frame_of(lines, labels))
    title = f"{scene}, at {count(equal_cost(frames, scene))} evaluations and to an error"
    return replace(
        made, name=f"mission_{scene}", title=title, legend=made.legend if scene == SCENES[0] else ""
    )


def overview(frames: Frames) -> View | None:
    """Return the mission in one table: a row for each contestant."""
    ran = set(frames["runs"]["scene"])
    scenes = [scene for scene in SCENES if scene in ran]
    methods = dict.fromkeys(method for scene in scenes for method in contestants(frames, scene))
    if not methods:
        return None
    lines = []
    for method in [*(m for m in METHODS if m in methods), *(m for m in methods if m not in METHODS)]:
        there = [scene for scene in scenes if able(frames, scene, method)]
        found = {scene: at_equal_cost(frames, scene, method) for scene in there}
        line: list[object] = [
            method,
            next(order for s in there for order in [orders.order_of(frames, s, method)]),
        ]
        line += [as_cell(found[s]["error"] if s in there else None, scientific) for s in scenes]
        line += [worst(frames, found, law) for law in LAWS]
        line += [cost_cell(frames, "compiled", s, method, ERRORS[-1]) for s in scenes]
        lines.append(line)
    labels = [("", "method"), ("", "order")]
    labels += [(f"error at {count(equal_cost(frames, scene))}", scene) for scene in scenes]
    labels += [("largest", law_label(law)) for law in LAWS]
    labels += [(f"time to {power(ERRORS[-1])}", scene) for scene in scenes]
    return view("overview", frame_of(lines, labels))


def worst(frames: Frames, found: Mapping[str, pd.Series], law: str) -> Cell:
    """Return the largest deviation of some scenes from a law, of those where a method claims it."""
    rows = [row for scene, row in found.items() if claimed(frames, scene, law) and not np.isnan(row[law])]
    if not rows:
        return Cell(DASH)
    kept = all(row.get(f"{law}_kept", False) for row in rows)
    return as_cell(max(row[law] for row in rows), scientific, Mark.kept if kept else None)


# -- a motion: its orbit after many turns, and its energy, by two methods at equal cost beside the truth --
def motion_figure(table: pd.DataFrame) -> Figure | None:
    rows = table[table["figure"] == "motion"]
    if not len(rows):
        return None
    first, late = (rows[rows["panel"] == name] for name in ("energy", "orbit"))
    energy = Panel("energy", Axis("time t"), Axis(r"$H_0$"), tuple(paths(first, True)))
    axes = Axis("$q_1$"), Axis("$q_2$")
    orbit = Panel("the orbit at the end", *axes, tuple(paths(late, False)), equal=True)
    counts = rows[rows["kind"] == "method"].groupby("curve", sort=False)["z"].max()
    return chart("motion", [energy, orbit], evaluations=int(counts.max()), methods=names(list(counts.index)))


def paths(rows: pd.DataFrame, line: bool) -> Iterator[Curve]:
    """Yield the truth as a line, below the methods, each a line or points."""
    rows = rows.sort_values("point", kind="stable")
    for (kind, name), own in sorted(
        rows.groupby(["kind", "curve"], sort=False), key=lambda e: e[0][0] != "truth"
    ):
        points, truth = (floats(own["x"]), floats(own["y"])), kind == "truth"
        method, role = ("", "truth") if truth else (str(name), "")
        yield Curve(*points, str(name), method, role, truth or line, not (truth or line))


# -- results/README.md -----------------------------------------------------------------------------
@chapter(NAME, answers)
def parts(frames: Frames) -> list[Part | None]:
    found: list[Part | None] = [motion_figure(frames["motion"])]
    found += [scene_view(frames, scene) for scene in SCENES]
    drawn = cost.figure(frames, PICTURED)
    found.append(drawn and replace(drawn, caption=""))
    for kind in ("compiled", "evaluations"):
        table = cost.leaders_view(cost.standings(frames, kind), kind, f"first_{kind}")
        found.append(table and replace(table, legend=PROSE[NAME]["legend"] if kind == "compiled" else ""))
    questions: dict[str, list[str]] = {}
    for one in chapters(frames):
        questions.setdefault(one.file, []).append(one.question)
    questions["glossary.md"] = ["What is each method, scene and column?"]
    rows = [
        (f"[{file}]({file})", " ".join(asked)) for file, asked in questions.items() if file != f"{NAME}.md"
    ]
    return [*found, view("documents", frame_of(rows, ["document", "question"]))]


def machine(runs: Sequence[Mapping[str, object]]) -> Text:
    places = dict.fromkeys(
        f"{run.get('cpu', '')}, {run.get('cores', '')} cores, Python {run.get('python', '')}, "
        f"commit `{str(run.get('commit', ''))[:12] or 'unknown'}`{' with local changes' if run.get('dirty') else ''}"
        for run in runs
    )
    return Text(f"Measured on {'; '.join(places)} ([environment.json](environment.json)). Without units.")
