"""The mission: order, laws, errors and costs of its contestants on its three scenes; and the answers to all questions.

It makes results/README.md, and the computed part of the README of the project.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import islice

import numpy as np
import pandas as pd

from contactbench.measure.law import STRUCTURE
from contactbench.measure.statistics import WIDEST
from contactbench.questions import claims, cost, hard, laws, orders, problems, ring, which
from contactbench.questions.answers import evaluate
from contactbench.questions.contest import CONTACT, cost_rows, families, hard_runs
from contactbench.questions.judgement import SAVED, at_cost, law_label, met_cost, structural_laws
from contactbench.report.chapters import (
    PROSE,
    Answer,
    Frames,
    Part,
    Section,
    Text,
    chapter,
    chapters,
    chart,
    every,
    view,
)
from contactbench.report.curves import floats
from contactbench.report.drawing import Axis, Curve, Figure, Panel
from contactbench.report.numbers import DASH, names, power, scientific
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of, matrix

NAME = "README"
#: the mission's scenes and methods; the scene whose costs are drawn
SCENES, METHODS, STEPS = (PROSE[NAME][what] for what in ("scenes", "methods", "printed"))
LABELS: dict[str, str] = PROSE[NAME]["labels"]
#: the picture of each step of the story: a chapter, and how the name of its figure begins
PICTURES: dict[str, str] = PROSE[NAME]["pictures"]
#: rows of a table of the story at most, the errors of its costs, and the error of a hard scene that is solved
MOST, STORY_ERRORS, RIGHT = 10, (1e-3, 1e-6, 1e-9), 1e-3
#: findings in the README of the project
FINDINGS = 4
#: laws of the table in the README of the project, by their columns
KEPT = {"momentum_law": "J decays as e^{−γt}", "contact_drift": "contact form"}
#: errors at which costs stand in its tables; the last decides who is the best contact method, and who the fastest
ERRORS = (1e-3, 1e-6)
#: laws of its tables, the law of the map last; J stands where a method claims it
LAWS = ("energy_law", "momentum_law", "contact_drift")
#: the laws that a reader asks about first
PROMISED = {"momentum_law": "the momentum J", "contact_drift": "the contact form η"}
#: kinds of cost that a reader asks about, in order; the first stands in the README of the project
ASKED = ("compiled", "tolerance", "evaluations", "tolerance_evaluations")
SLOWER = "contests(runs, times).assign(slower=lambda c: c.ratio > 1.25).groupby('scene').slower.all()"


# -- the answers -----------------------------------------------------------------------------------
def slower(frames: Frames) -> Answer | None:
    found = evaluate(SLOWER, frames)
    scenes = [f"`{scene}`" for scene in found.index[found]]
    asked = "Where is every contact method more than 25 % slower than the fastest compiled solver, at every error?"
    text = f"{int(found.sum())} of {len(found)} scenes"
    return Answer(asked, names(scenes) or "nowhere", text, (SLOWER,)) if len(found) else None


def findings(frames: Frames) -> Iterator[tuple[str, Answer]]:
    """Yield the answers that stand in the README of the project, each with its document, the first few there are."""
    law = "contact_drift"
    found = [
        ("laws.md", laws.kept(frames, law, f"Does a method keep {PROMISED[law]} wherever it claims to?"))
    ]
    found += [("random.md", each) for each in list(problems.answers(frames))[-1:]]
    found += [("random.md", each) for each in list(ring.answers(frames))[:1]]
    found += [("claims.md", each) for each in claims.answers(frames)]
    found += [("laws.md", each) for each in orders.answers(frames)]
    yield from islice(((file, answer) for file, answer in found if answer is not None), FINDINGS)


def steps(frames: Frames) -> dict[str, list[Answer]]:
    """Return the answers to the mission's questions, by the step of the story in which they stand."""
    kept = [
        laws.kept(frames, law, f"Does a method keep {label} wherever it claims to?")
        for law, label in PROMISED.items()
    ]
    costs = [cost.answer(frames, kind) for kind in ASKED]
    found: dict[str, Iterable[Answer | None]] = {
        "step": [*orders.answers(frames), *claims.answers(frames)],
        "keeps": kept,
        "costs": [costs[0], slower(frames), *costs[1:]],
        "hard": hard.answers(frames),
        "take": [*reversed(list(problems.answers(frames))), *ring.answers(frames)],
    }
    return {name: list(filter(None, own)) for name, own in found.items()}


def answers(frames: Frames) -> Iterator[Answer]:
    for own in steps(frames).values():
        yield from own


def line(answer: Answer) -> str:
    return f"{answer.question} **{answer.answer}** ({answer.count})"


# -- the contestants -------------------------------------------------------------------------------
def able(frames: Frames, scene: str, method: str) -> bool:
    runs = frames["runs"]
    own = runs[(runs["scene"] == scene) & (runs["method"] == method)]
    return bool((own["status"] != "unsupported").any())


@lru_cache(8)
def contestants(frames: Frames, scene: str) -> list[str]:
    """Return the methods of the mission that run on a scene, with its fastest and its fastest contact method."""
    first = [leading(frames, label, scene, ERRORS[-1]) for label in (LABELS["best"], LABELS["fastest"])]
    found = dict.fromkeys(m for m in [*METHODS, *first] if m is not None and able(frames, scene, m))
    known = families(frames["runs"])
    return sorted(found, key=lambda name: known[name] != CONTACT)


@lru_cache(8)
def equal_cost(frames: Frames, scene: str) -> float:
    """Return the number of evaluations at which the contestants are compared on a scene."""
    runs = frames["runs"]
    rows = runs[(runs["scene"] == scene) & (runs["saved"] == SAVED)]
    return met_cost(rows[rows["method"].isin(contestants(frames, scene))])


@lru_cache(64)
def at_equal_cost(frames: Frames, scene: str, method: str) -> pd.Series:
    """Return error and laws of a method at the cost at which the contestants are compared."""
    runs, most = frames["runs"], equal_cost(frames, scene)
    rows = runs[(runs["scene"] == scene) & (runs["method"] == method) & (runs["saved"] == SAVED)]
    found = at_cost(rows, most, ["error", *LAWS])
    nothing = pd.Series({"evaluations": np.nan, "error": np.nan, **dict.fromkeys(LAWS, np.nan)})
    return nothing if found is None else found


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


# -- the tables of the story -----------------------------------------------------------------------
#: a row of the mission's table: its label, and its method on each scene
type Row = tuple[str, dict[str, str]]


def leading(frames: Frames, label: str, scene: str, error: float) -> str | None:
    """Return the fastest method on a scene at an error, of all or of the contact methods."""
    rows = cost.standings(frames, "compiled").dropna(subset="cost")
    rows = rows[(rows["scene"] == scene) & (rows["error"] == error)]
    if label == LABELS["best"]:
        rows = rows[rows["family"] == CONTACT]
    return str(rows["method"].iloc[0]) if len(rows) else None


def rows_of(frames: Frames) -> list[Row]:
    """Return the methods of the mission, the best contact method of each scene, and the fastest of all."""
    ran = set(frames["runs"]["scene"])
    scenes = [scene for scene in SCENES if scene in ran]
    rows = [(LABELS.get(m, m), {s: m for s in scenes if able(frames, s, m)}) for m in METHODS]
    for label in (LABELS["best"], LABELS["fastest"]):
        first = {s: leading(frames, label, s, ERRORS[-1]) for s in scenes}
        rows.append((label, {s: m for s, m in first.items() if m is not None}))
    return [row for row in rows if row[1]]


def time_cell(frames: Frames, row: Row, scene: str, error: float) -> Cell:
    """Return the compiled time of a row; it names the method where the row has others elsewhere."""
    label, methods = row
    if label not in (LABELS["best"], LABELS["fastest"]):
        known = scene in methods
        return cost_cell(frames, "compiled", scene, methods[scene], error) if known else Cell(DASH)
    first = leading(frames, label, scene, error)
    if first is None:
        return Cell(DASH)
    found = cost_cell(frames, "compiled", scene, first, error)
    return replace(found, text=f"{first} {found.text}")


def keeps(frames: Frames, methods: Mapping[str, str], law: str) -> str:
    """Return whether methods promise a law, and keep it in every run that tells, on the scenes that have it."""
    runs = frames["runs"]
    mine = [runs["method"].eq(m) & runs["scene"].eq(s) for s, m in methods.items()]
    rows = runs[np.logical_or.reduce(mine) & runs["status"].eq("ok") & runs[f"{law}_kept"].notna()]
    if not len(rows):
        return DASH
    promised = rows[f"{law}_claimed"].eq(True) & rows[f"{law}_kept"].eq(True)
    return "to round-off" if promised.all() else "to its error"


def overview(frames: Frames) -> View | None:
    """Return the mission in one table: the time of a solve on each scene, and the laws kept."""
    rows = rows_of(frames)
    scenes = [scene for scene in SCENES if any(scene in methods for _, methods in rows)]
    lines = [
        [
            row[0],
            *(time_cell(frames, row, scene, ERRORS[-1]) for scene in scenes),
            *(keeps(frames, row[1], law) for law in KEPT),
        ]
        for row in rows
    ]
    heads = ["method", *scenes, *KEPT.values()]
    return view("overview", frame_of(lines, heads), error=power(ERRORS[-1])) if lines else None


def step_view(frames: Frames) -> View:
    """Return the orders of the paper's step, as printed and as meant, and of the contestants."""
    fitted = orders.fits(frames["orders"])
    here = fitted[fitted["scene"].isin(SCENES)]
    wanted = dict.fromkeys([*STEPS, *(m for s in SCENES for m in contestants(frames, s))])
    here = here[here["method"].isin(wanted)].sort_values("method", key=lambda own: own.map([*wanted].index))
    table = matrix(here, "method", "scene", orders.order_cell)
    return view("story_step", table.head(MOST))


def keeps_view(frames: Frames) -> View:
    """Return error and laws of the contestants at equal cost, the largest of the scenes."""
    lines = []
    best = [leading(frames, LABELS["best"], scene, ERRORS[-1]) for scene in SCENES]
    for method in dict.fromkeys([*METHODS, *filter(None, best)]):
        there = [s for s in SCENES if method in contestants(frames, s)]
        found = {scene: at_equal_cost(frames, scene, method) for scene in there}
        if there:
            error = max(row["error"] for row in found.values())
            laws_there = [worst(frames, found, law) for law in LAWS]
            lines.append([method, as_cell(error, scientific), *laws_there])
    return view("story_keeps", frame_of(lines[:MOST], ["method", "error", *map(law_label, LAWS)]))


def worst(frames: Frames, found: Mapping[str, pd.Series], law: str) -> Cell:
    """Return the largest deviation of some scenes from a law, of those where a method claims it."""
    rows = [row for scene, row in found.items() if claimed(frames, scene, law) and not np.isnan(row[law])]
    if not rows:
        return Cell(DASH)
    kept = all(row[law] <= STRUCTURE or row.get(f"{law}_kept", False) for row in rows)
    return as_cell(max(row[law] for row in rows), scientific, Mark.kept if kept else None)


def costs_view(frames: Frames) -> View:
    """Return the compiled time of the contestants on each scene, to each error."""
    rows = rows_of(frames)
    heads = [(scene, power(error)) for scene in SCENES for error in STORY_ERRORS]
    lines = [[row[0], *(time_cell(frames, row, s, e) for s in SCENES for e in STORY_ERRORS)] for row in rows]
    return view("story_costs", frame_of(lines, [("", "method"), *heads]))


def hard_view(frames: Frames) -> View:
    """Return how often the contestants end as the true motion does, and how often they are right to 10⁻³."""
    runs = hard_runs(frames["runs"])
    lines = []
    for method in METHODS:
        own = runs[runs["method"] == method]
        right = own[(own["status"] == own["truth"])]
        small = own.groupby("scene")["error"].min() <= RIGHT
        if len(own):
            lines.append(
                (method, f"{len(right)} of {len(own)}", f"{int(small.sum())} of {own['scene'].nunique()}")
            )
    labels = ["method", "runs that end as the true motion does", f"scenes solved to {power(RIGHT)}"]
    return view("story_hard", frame_of(lines, labels))


# -- a motion: its orbit after many turns, and its energy, by two methods at equal cost beside the truth --
def motion_figure(table: pd.DataFrame) -> Figure | None:
    rows = table[table["figure"] == "motion"]
    if not len(rows):
        return None
    first, late = (rows[rows["panel"] == name] for name in ("energy", "orbit"))
    energy = Panel("energy", Axis("time t"), Axis(r"energy $H_0$"), tuple(paths(first, True)))
    axes = Axis("$q_1$"), Axis("$q_2$")
    orbit = Panel("orbit near the end", *axes, tuple(paths(late, False)), equal=True)
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
def picture(frames: Frames, name: str) -> Figure | None:
    """Return the figure of a chapter by its name, which stands in the story too."""
    for one in chapters(frames):
        if one.name == name:
            return next(
                (f for f in every(Figure, one.fill(frames)) if f.name.startswith(PICTURES[name])), None
            )
    return None


@chapter(NAME, answers)
def parts(frames: Frames) -> list[Part | None]:
    tables = (step_view, keeps_view, costs_view, hard_view, which.systems_view)
    found: list[Part | None] = [motion_figure(frames["motion"])]
    for (name, own), figure, table in zip(steps(frames).items(), PICTURES, tables, strict=True):
        prose, drawn = PROSE[NAME]["steps"][name], picture(frames, figure)
        shown = replace(table(frames), name=f"story_{name}", title="")
        lines = Text(" ".join(prose["about"].split()), tuple(map(line, own)))
        found.append(Section(prose["title"], (lines, drawn and replace(drawn, caption=""), shown)))
    questions: dict[str, list[str]] = {}
    for one in chapters(frames):
        questions.setdefault(one.file, []).append(one.question)
    questions["glossary.md"] = ["What does each method, scene and column mean?"]
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
    return Text(
        f"Measured on {'; '.join(places)} ([environment.json](environment.json)). All else is dimensionless."
    )
