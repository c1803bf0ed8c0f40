"""results/README.md and the computed part of the project's README: the mission, the answers, who is cheapest where."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice

import pandas as pd

from contactbench.questions import claims, convergence, laws, population, structure, work_precision
from contactbench.questions.contest import OTHER
from contactbench.questions.judgement import law_rows
from contactbench.questions.laws import cost_cells, law_label, most_met_cost
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
    view,
)
from contactbench.report.curves import floats
from contactbench.report.drawing import Axis, Curve, Figure, Panel
from contactbench.report.numbers import DASH, duration, how_often, names
from contactbench.report.views import Cell, View, frame_of
from contactbench.tables.declared import ORBIT, TRUTH

NAME = "README"
#: the scene whose work–precision picture stands here
PICTURED = "particle"
#: a column of the result with the laws that a reader asks about first
PROMISED = {"momentum_law": "J", "contact_drift": "the contact form"}
#: kinds of cost that a reader asks about, in order
ASKED = ("compiled", "tolerance", "package", "evaluations", "tolerance_evaluations")
#: the scenes of the mission, its laws (J where a method claims it), and the methods of each table
SHOWN_SCENES, SHOWN_LAWS, SHOWN_METHODS = (PROSE[NAME][what] for what in ("scenes", "laws", "methods"))
#: errors whose cost stands in the README of the project, and what is asked of each law there
SHOWN_ERRORS = (1e-3, 1e-6)
KEPT = {"momentum_law": "J decays as e^{−γt}", "contact_drift": "contact form"}


# -- the answers -----------------------------------------------------------------------------------
def structure_answer(frames: Frames) -> Iterator[Answer]:
    rows = laws.structural_rows(frames)
    promised = rows[rows["claimed"] & rows["law"].isin(PROMISED)]
    found = [(PROMISED[str(law)], own) for law, own in promised.groupby("law", sort=False)]
    if found:
        answer = ", ".join(f"{label} {how_often(*laws.kept_of(own))}" for label, own in found)
        question = "Does it keep J and the contact form where it promises to?"
        yield Answer(question, answer, "; ".join(laws.counts(own) for _, own in found))


def cost_answers(frames: Frames) -> Iterator[Answer]:
    found = work_precision.answers_by_kind(frames)
    yield from (found[kind] for kind in ASKED if kind in found)
    won = work_precision.all_contests(frames)["compiled"].contests
    judged = won[won["winner"] != ""]
    if len(judged):
        lost = judged["winner"] == OTHER
        every = lost.groupby(judged["scene"], sort=False).transform("all")
        scenes = [f"`{scene}`" for scene in judged["scene"][every].unique()]
        there, others, pairs = int(every.sum()), int(lost[~every].sum()), int((~every).sum())
        count = f"{there} of {there} pairs there, {others} of {pairs} elsewhere"
        yield Answer("Where is it slower at every error, compiled?", names(scenes) or "nowhere", count)


def answers(frames: Frames) -> Iterator[Answer]:
    yield from structure_answer(frames)
    if len(frames["convergence"]):
        yield from convergence.answers(frames)
    if len(frames["work_precision"]):
        yield from cost_answers(frames)
    yield from population.answers(frames)
    yield from structure.answers(frames)
    yield from islice(claims.answers(frames), 1)


def findings(frames: Frames) -> Iterator[Answer]:
    """Yield the answers that stand in the README of the project."""
    yield from structure_answer(frames)
    if len(frames["convergence"]):
        yield from convergence.answers(frames)
    if len(frames["work_precision"]):
        yield from [a for kind, a in work_precision.answers_by_kind(frames).items() if kind == "compiled"]
    yield from list(population.answers(frames))[-1:]
    yield from islice(structure.answers(frames), 1)
    yield from islice(claims.answers(frames), 1)


# -- the mission: what an error costs its contestants, and what they keep -------------------------
def overview(frames: Frames) -> View | None:
    """Return the time of a solve on the mission's scenes, compiled, and the laws kept there, by method.

    Above the methods of the table: the fastest of all, and the fastest contact method, of each scene and error.
    """
    ranked = work_precision.all_contests(frames)["compiled"].standings
    ranked = ranked[ranked["scene"].isin(SHOWN_SCENES) & ranked["error"].isin(SHOWN_ERRORS)]
    if not len(ranked):
        return None
    scenes = [scene for scene in SHOWN_SCENES if scene in set(ranked["scene"])]
    pairs = [(scene, error) for scene in scenes for error in SHOWN_ERRORS]

    def line(label: str, rows: pd.DataFrame, named: bool) -> tuple[object, ...]:
        cells, methods = [], set()
        for scene, error in pairs:
            own = rows[(rows["scene"] == scene) & (rows["error"] == error)].dropna(subset="cost").head(1)
            methods |= set(own["method"])
            texts = [f"{one.method} " * named + duration(one.cost) for one in work_precision.cost_rows(own)]
            cells.append(Cell(texts[0] if texts else DASH))
        return (label, *cells, *(kept_word(frames, law, methods) for law in KEPT))

    contact = ranked[ranked["family"] == work_precision.CONTACT]
    lines = [line("the fastest of all", ranked, True), line("the fastest contact method", contact, True)]
    shown = [method for method in SHOWN_METHODS["overview"] if method in set(ranked["method"])]
    lines += [line(method, ranked[ranked["method"] == method], False) for method in shown]
    heads = [(scene, f"to {work_precision.power(error)}") for scene, error in pairs]
    return view(
        "overview", frame_of(lines, [("", "method"), *heads, *(("", word) for word in KEPT.values())])
    )


def kept_word(frames: Frames, law: str, methods: set[str]) -> str:
    """Return whether all runs of some methods on the mission's scenes keep a law to round-off."""
    rows = law_rows(frames, law)
    where = set(rows[rows["claimed"]]["scene"]).intersection(SHOWN_SCENES)
    rows = rows[
        rows["scene"].isin(where) & rows["method"].isin(methods) & rows["judged"] & ~rows["undecided"]
    ]
    if not len(rows):
        return DASH
    return "to round-off" if rows["kept"].all() else "to its error"


# -- a motion: its orbit after many turns, and its energy, by two methods at equal cost beside the truth --
def motion_figure(rows: pd.DataFrame) -> Figure | None:
    if not len(rows):
        return None
    late = rows[rows["t"] >= rows["t"].max() - ORBIT - 1e-9]
    energy = Panel("energy", Axis("time t"), Axis(r"$H_0$"), tuple(paths(rows, "t", "energy", True)))
    axes = Axis("$q_1$"), Axis("$q_2$")
    orbit = Panel("the orbit at the end", *axes, tuple(paths(late, "q1", "q2", False)), equal=True)
    methods = rows[rows["method"] != TRUTH]
    counts = methods.groupby("method", sort=False)["evaluations"].first()
    other = str(counts.index[-1]).upper()
    return chart("motion", [energy, orbit], evaluations=int(counts.max()), other=other, turns=ORBIT)


def paths(rows: pd.DataFrame, x: str, y: str, line: bool) -> Iterator[Curve]:
    """Yield the truth as a line, below the methods, each a line or points."""
    for name, own in sorted(rows.groupby("method", sort=False), key=lambda each: each[0] != TRUTH):
        truth = name == TRUTH
        points, lined = (floats(own[x]), floats(own[y])), truth or line
        method, role = ("", TRUTH) if truth else (str(name), "")
        yield Curve(*points, str(name), method, role, lined, not lined)


# -- results/README.md -----------------------------------------------------------------------------
def at_equal_cost(frames: Frames, name: str) -> View | None:
    """Return the laws of the mission's scenes at equal cost, of the methods of a table."""
    methods: list[str] = SHOWN_METHODS[name]
    rows = most_met_cost(frames["decay_laws"])
    rows = rows[rows["scene"].isin(SHOWN_SCENES) & rows["method"].isin(methods)]
    if not len(rows):
        return None
    momentum = law_rows(frames, "momentum_law")
    claimed = set(momentum[momentum["claimed"]]["scene"])
    shown = [scene for scene in SHOWN_SCENES if scene in set(rows["scene"])]
    laws_of = {s: [law for law in SHOWN_LAWS if law != "momentum_law" or s in claimed] for s in shown}
    by_pair = {(row["method"], row["scene"]): row for _, row in rows.iterrows()}
    lines = []
    for method in sorted(set(rows["method"]), key=methods.index):
        cells: list[Cell] = []
        for scene, own in laws_of.items():
            row = by_pair.get((method, scene), pd.Series({"status": DASH}))
            cells += cost_cells(frames, row, own)
        lines.append((method, *cells))
    heads = {scene: ("evaluations", "order", *map(law_label, own)) for scene, own in laws_of.items()}
    labels = [("", "method"), *((scene, label) for scene, own in heads.items() for label in own)]
    return view(name, frame_of(lines, labels))


def cheapest_parts(frames: Frames) -> list[Part]:
    """Return the contests that are asked about first, and where the contact methods lose in any."""
    found = [own for own in work_precision.all_contests(frames).values() if len(own.contests)]
    if not found:
        return []
    tables = (work_precision.cheapest_view(own) for own in found if own.kind.name in work_precision.FIRST)
    lost = work_precision.losses_view({own.kind.title: own.contests for own in found}, "lost")
    return [Section("Who is cheapest where", (Text(PROSE[NAME]["legend"]), *tables)), lost]


@chapter(NAME, answers)
def parts(frames: Frames) -> list[Part | None]:
    found: list[Part | None] = [motion_figure(frames["motion"]), at_equal_cost(frames, "mission")]
    if len(frames["work_precision"]):
        drawn = work_precision.figure(frames, PICTURED)
        found.append(drawn and replace(drawn, caption=""))
        found += cheapest_parts(frames)
    questions = {chapter.file: chapter.question for chapter in chapters(frames) if chapter.name != NAME}
    questions["glossary.md"] = "What is each method, scene and column?"
    rows = [(f"[{file}]({file})", question) for file, question in questions.items()]
    return [*found, view("documents", frame_of(rows, ["document", "question"]))]


def machine(runs: Sequence[Mapping[str, object]]) -> Text:
    places = dict.fromkeys(
        f"{run.get('cpu', '')}, {run.get('cores', '')} cores, Python {run.get('python', '')}, "
        f"commit `{str(run.get('commit', ''))[:12] or 'unknown'}`{' with local changes' if run.get('dirty') else ''}"
        for run in runs
    )
    return Text(f"Measured on {'; '.join(places)} ([environment.json](environment.json)). Without units.")
