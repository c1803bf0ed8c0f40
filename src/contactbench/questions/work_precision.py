"""Cost at equal error: who is cheapest where, and scene by scene what each error costs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pandas as pd

from contactbench.questions.contest import (
    COMPILED,
    CONTACT,
    EVALUATIONS,
    KINDS,
    OTHER,
    OURS,
    Cost,
    Kind,
    contests,
    cost_rows,
    costs,
    of_this_package,
    standings,
)
from contactbench.report.chapters import PROSE, Answer, Frames, Part, Section, Text, chapter, chart, view
from contactbench.report.curves import by_method, cheapest, choose, contest_end, only
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.report.numbers import DASH, count, duration, how_often, power, times
from contactbench.report.views import Cell, Mark, View, grid, matrix

LEGEND: str = PROSE["work_precision"]["legend"]
#: by kind of cost
QUESTIONS: dict[str, str] = PROSE["work_precision"]["questions"]
#: kinds of cost whose contests stand in results/README.md
FIRST = ("evaluations", "compiled")
MARKS = {"win": Mark.best, OURS: Mark.best, "tie": Mark.tie, "undecided": Mark.tie}


@dataclass(frozen=True)
class Contest:
    kind: Kind
    standings: pd.DataFrame
    contests: pd.DataFrame


def contest(work: pd.DataFrame, kind: Kind) -> Contest:
    found = costs(work, kind)
    return Contest(kind, standings(found), contests(found))


@lru_cache(2)
def all_contests(frames: Frames) -> dict[str, Contest]:
    """Return the contests of contact methods with all others, by kind of cost."""
    return {kind.name: contest(frames["work_precision"], kind) for kind in KINDS}


def tally(won: pd.DataFrame) -> tuple[str, str]:
    judged = won[won["winner"] != ""]
    counted = judged["winner"].value_counts()
    others = judged[judged["winner"] == OTHER]["other"].value_counts()
    won_by_us = int(counted.get(OURS, 0))
    words = {"tie": "tied", "undecided": "undecided"}
    beside = "".join(f", {counted[winner]} {word}" for winner, word in words.items() if winner in counted)
    rest = ", ".join(f"{method} {n}" for method, n in others.items())
    text = f"{won_by_us} of {len(judged)} pairs of scene and error{beside}"
    return how_often(won_by_us, len(judged)), text + (f"; others: {rest}" if rest else "")


@lru_cache(2)
def answers_by_kind(frames: Frames) -> dict[str, Answer]:
    """Return the contests counted, by kind of cost; package: what this package runs beside what the libraries run."""
    found = {name: own.contests for name, own in all_contests(frames).items()}
    own = costs(frames["work_precision"], COMPILED)
    found["package"] = contests(own, of_this_package)
    return {name: Answer(QUESTIONS[name], *tally(won)) for name, won in found.items() if len(won)}


# -- who is cheapest -------------------------------------------------------------------------------
def error_label(error: float) -> str:
    return f"error {power(error)}"


def cost_cell(row: Cost, kind: Kind) -> Cell:
    if math.isnan(row.cost):
        return Cell(row.reason or DASH)
    written = duration(row.cost) if kind.timed else count(row.cost)
    text = f"{'≤ ' if row.bound else ''}{written}{' °' if row.fixed > 0.5 else ''}"
    return Cell(text, row.cost, MARKS.get(row.verdict))


def winners_view(own: Contest, name: str) -> View:
    winner = own.contests.set_index(["scene", "error"])["winner"]
    reached = own.standings[own.standings["scene"].isin(own.contests["scene"])]
    reached = reached[reached.groupby("scene")["cost"].transform("min").notna()]

    def cell(ranked: pd.DataFrame) -> Cell:
        first = cost_rows(ranked.head(1))[0]
        text = cost_cell(first, own.kind).text
        behind = ranked[ranked["family"] == CONTACT]["ratio"].min()
        factor = f" (contact {times(behind)})" if behind > 1 else ""
        named = text if math.isnan(first.cost) else f"{first.method} {text}{factor}"
        return Cell(named, mark=MARKS.get(winner[first.scene, first.error]))

    made = view("winners", matrix(reached, "scene", "error", cell, error_label), about=own.kind.about)
    return replace(made, name=name, title=own.kind.title)


def cheapest_view(own: Contest) -> View:
    return replace(winners_view(own, f"cheapest_{own.kind.name}"), legend="")


def losses_view(won: Mapping[str, pd.DataFrame], name: str) -> View:
    def cell(own: pd.DataFrame) -> Cell:
        lost, judged = own[own["winner"] == OTHER], own[own["winner"] != ""]
        if not len(lost):
            return Cell("" if len(judged) else DASH)
        worst = lost.loc[lost["ratio"].idxmin()]
        by = "alone" if worst["ratio"] == 0 else times(1 / worst["ratio"])
        text = f"{len(lost)} of {len(judged)}: {power(worst['error'])} {worst['other']} {by}"
        return Cell(text, float(len(lost)))

    every = pd.concat([own.assign(kind=title) for title, own in won.items()])
    lost = every[every["scene"].isin(every[every["winner"] == OTHER]["scene"])]
    return replace(view("losses", matrix(lost, "scene", "kind", cell)), name=name)


# -- scene by scene --------------------------------------------------------------------------------
def costs_view(own: Contest, scene: str) -> View:
    here = own.standings[own.standings["scene"] == scene]
    here = here.sort_values(["method", "error"], ascending=[True, False])
    cells = {(row.method, row.error): cost_cell(row, own.kind) for row in cost_rows(here)}
    return View(f"{own.kind.name}_{scene}", own.kind.title, grid("method", cells, error_label))


@chapter("work_precision", lambda frames: answers_by_kind(frames).values())
def parts(frames: Frames) -> list[Part]:
    work, found = frames["work_precision"], all_contests(frames).values()
    by_error = [own for own in found if own.kind.by == "oracle"]
    scenes = [
        Section(scene, (figure(frames, scene), *(costs_view(own, scene) for own in by_error)))
        for scene in dict.fromkeys(work["scene"])
    ]
    cheapest = (cheapest_view(own) for own in found if len(own.contests) and own.kind.name not in FIRST)
    return [
        Text("By evaluations and compiled time, and where the contact methods lose: [README.md](README.md)."),
        Section("Who is cheapest where", tuple(cheapest)),
        Section("Scene by scene", (Text(LEGEND), *scenes)),
    ]


# -- figures ---------------------------------------------------------------------------------------
#: beyond an error of two there is nothing left of the motion, below round-off nothing is known
ERROR = Axis("error of the solution (more accurate to the right)", "log", inverted=True, within=(1e-16, 2.0))
#: the axis of each kind of cost that is drawn, and its scale
AXES = {COMPILED: ("time of a solve, ms", 1e3), EVALUATIONS: ("evaluations", 1.0)}


def compared(work: pd.DataFrame, scene: str, kind: Kind) -> pd.DataFrame:
    rows = work[(work["scene"] == scene) & (work["status"] == "ok")]
    rows = rows[kind.compares(rows) & rows[kind.cost].notna()]
    totals = rows.groupby(["method", "engine"])[kind.cost].transform("median")
    best = rows.assign(total=totals).groupby("method")["total"].transform("min")
    return rows[totals == best].drop_duplicates(["method", "setting"])


def figure(frames: Frames, scene: str) -> Figure | None:
    work, (title, named) = frames["work_precision"], message(frames, scene)
    drawn: list[str] = []
    panels = []
    for kind, (label, size) in AXES.items():
        curves = by_method(compared(work, scene, kind), "solution_error", kind.cost, size)
        if curves:
            drawn = drawn or choose(curves, cheapest, subjects=named)
            cost = contest_end(Axis(label, "log"), curves)
            panels.append(Panel(kind.title, ERROR, cost, only(curves, drawn)))
    return chart("work_precision", panels, f"work_precision_{scene}", title=title)


def message(frames: Frames, scene: str) -> tuple[str, list[str]]:
    """Return the title of a scene's figure, by the contest that the tables have, and the methods that it names."""
    table = all_contests(frames)[COMPILED.name].contests
    table = table[table["scene"] == scene]
    table = table[np.isfinite(table["ratio"].astype(float)) & (table["ratio"] > 0)]
    if not len(table):
        return f"{scene}: cost against error", []
    row = table.iloc[(len(table) - 1) // 2]
    at, both, ratio = f"at {power(row['error'])}", [row["ours"], row["other"]], row["ratio"]
    if row["winner"] not in (OURS, OTHER):
        found = "take about the same time" if row["winner"] == "tie" else "are too near for the clock"
        return f"{scene}: {both[0]} and {both[1]} {found} {at}", both
    if row["winner"] == OTHER:
        both, ratio = both[::-1], 1 / ratio
    return f"{scene}: {both[0]} needs {1 / ratio:.0%} of the time of {both[1]} {at}", both
