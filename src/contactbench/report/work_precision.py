"""Cost at equal error: who is cheapest where, and scene by scene what each error costs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part, Section, Text, once, summary
from contactbench.report.figures import work_precision as figures
from contactbench.report.numbers import DASH, count, duration, how_often, power, scientific, times
from contactbench.report.views import Cell, Mark, Show, View, matrix, pick
from contactbench.results import contest as judge
from contactbench.results.contest import CONTACT, KINDS, LIMIT, OTHER, Kind, contestants

SOURCE = "work_precision.csv"
LEGEND = (
    f"Bold: the cheapest; italic: it ties or is undecided. ≤: every setting is more accurate than asked. {DASH}: no "
    "setting is as accurate; budget, timeout: our own limit. °: most of the time is spent however short the run. "
    "[How to read it](../docs/reading.md#cost-at-an-error)."
)
QUESTIONS = {
    "evaluations": "Does a contact method need the fewest evaluations at equal error?",
    "compiled": "Is a contact method the fastest at equal error, compiled?",
    "marginal": "Is it for one more unit of time, without what every call takes?",
    "callbacks": "Is it with Python callbacks?",
}
MARKS = {"win": Mark.best, CONTACT: Mark.best, "tie": Mark.tie, "undecided": Mark.tie}


@dataclass(frozen=True)
class Contest:
    """All costs of one kind, with their standings and the contests between contact methods and others."""

    kind: Kind
    standings: pd.DataFrame
    contests: pd.DataFrame


def contest(work: pd.DataFrame, kind: Kind) -> Contest:
    """Return the contest of one kind over the scenes of a table."""
    found = judge.costs(contestants(work), kind)
    return Contest(kind, judge.standings(found), judge.contests(found))


def all_contests(frames: Frames) -> dict[str, Contest]:
    """Return the contests of every kind, by its name."""
    return {kind.name: contest(frames["work_precision"], kind) for kind in KINDS}


def tally(won: pd.DataFrame) -> tuple[str, str]:
    """Return how often a contact method wins, and the counts: wins, ties, and who wins the rest."""
    judged = won[won["winner"] != ""]
    counted = judged["winner"].value_counts()
    others = judged[judged["winner"] == OTHER]["other"].value_counts()
    counts = [f"{counted.get(CONTACT, 0)} of {len(judged)} pairs of scene and error"]
    counts += [
        f"{counted[w]} {word}" for w, word in (("tie", "tied"), ("undecided", "undecided")) if w in counted
    ]
    rest = ", ".join(f"{method} {n}" for method, n in others.items())
    return how_often(counted.get(CONTACT, 0), len(judged)), ", ".join(counts) + (
        f"; others: {rest}" if rest else ""
    )


def answers(frames: Frames) -> pd.DataFrame:
    found = {name: own.contests for name, own in once(all_contests, frames).items() if len(own.contests)}
    return summary(*((QUESTIONS[name], *tally(won)) for name, won in found.items()))


# -- who is cheapest -------------------------------------------------------------------------------
def error_label(error: float) -> str:
    return f"error {power(error)}"


def cost_text(row: Any, show: Callable[[float], str]) -> str:
    """Return a cost of `standings`; its reason where the error is not reached."""
    if math.isnan(row.cost):
        return row.reason or DASH
    return f"{'≤ ' if row.bound else ''}{show(row.cost)}{' °' if row.fixed > 0.5 else ''}"


def cost_cell(rows: pd.DataFrame, show: Callable[[float], str] = duration) -> Cell:
    """Return the cost of one method, with its mark."""
    row = next(rows.itertuples())
    return Cell(cost_text(row, show), None if math.isnan(row.cost) else row.cost, MARKS.get(row.verdict))


def winners_view(own: Contest, name: str, source: str = SOURCE) -> View:
    """Return the cheapest method at each error, with the best contact method's factor where it is another."""
    winner = own.contests.set_index(["scene", "error"])["winner"]
    reached = own.standings[own.standings["scene"].isin(own.contests["scene"])]
    reached = reached[reached.groupby("scene")["cost"].transform("min").notna()]

    def cell(ranked: pd.DataFrame) -> Cell:
        first = next(ranked.itertuples())
        text = cost_text(first, duration if own.kind.timed else count)
        behind = ranked[ranked["family"] == CONTACT]["ratio"].min()
        factor = f" (contact {times(behind)})" if behind > 1 else ""
        named = text if math.isnan(first.cost) else f"{first.method} {text}{factor}"
        return Cell(named, mark=MARKS.get(winner[first.scene, first.error]))

    legend = (
        f"{own.kind.about} In brackets the best contact method, where it is not the cheapest. "
        "Bold: a contact method is the cheapest; italic: it ties with another, or is undecided."
    )
    return View(name, own.kind.title, matrix(reached, "scene", "error", cell, error_label), legend, source)


def losses_view(won: Mapping[str, pd.DataFrame], name: str, source: str = SOURCE) -> View:
    """Return at how many errors of each scene another method wins, by kind of cost, and by how much at most.

    won : the contests by title of their kind.
    """

    def cell(own: pd.DataFrame) -> Cell:
        lost, judged = own[own["winner"] == OTHER], own[own["winner"] != ""]
        if not len(lost):
            return Cell("" if len(judged) else DASH)
        worst = lost.loc[lost["ratio"].idxmin()]
        by = "alone" if worst["ratio"] == 0 else times(1 / worst["ratio"])
        return Cell(
            f"{len(lost)} of {len(judged)}: {power(worst['error'])} {worst['other']} {by}", float(len(lost))
        )

    every = pd.concat([own.assign(kind=title) for title, own in won.items()])
    lost = every[every["scene"].isin(every[every["winner"] == OTHER]["scene"])]
    legend = (
        "At how many errors another method is cheaper than every contact method, and where by most: at which error, "
        "which method, how many times cheaper. `contact-exact`, a closed form that costs the same for any span, takes "
        "no part in marginal time. [Why](../docs/reading.md#where-the-contact-methods-lose)."
    )
    title = "Where the contact methods lose"
    return View(name, title, matrix(lost, "scene", "kind", cell), legend, source)


# -- scene by scene --------------------------------------------------------------------------------
def costs_view(own: Contest, scene: str) -> View:
    """Return the cost of each error for each method on a scene."""
    here = own.standings[own.standings["scene"] == scene].sort_values(
        ["method", "error"], ascending=[True, False]
    )
    show = duration if own.kind.timed else count
    frame = matrix(here, "method", "error", lambda rows: cost_cell(rows, show), error_label)
    return View(f"{own.kind.name}_{scene}", own.kind.title, frame, "", SOURCE)


def kernels_view(work: pd.DataFrame) -> View:
    """Return the time per gradient of compiled fixed-step methods beside the same arithmetic as a plain C loop."""
    ok = work[work["status"] == "ok"]
    own = contestants(ok)
    own = own[judge.COMPILED.compares(own)]
    keys = ["scene", "control", "value"]
    pairs = ok[ok["family"] == LIMIT].merge(
        own, left_on=[*keys, "variant"], right_on=[*keys, "method"], suffixes=("_c", "")
    )
    c, whole = (1e9 * pairs[f"time_min_s{s}"] / pairs[f"evaluations{s}"] for s in ("_c", ""))
    labels = {
        "scene": "scene",
        "method": "method",
        "engine": "engine",
        "setting": "setting",
        "evaluations": "gradients",
    }
    frame = pick(pairs, labels).assign(**{"C loop, ns": c, "whole call, ns": whole, "ratio": whole / c})
    show = {"gradients": count, "ratio": times, "": "{:.2f}".format}
    legend = "Nanoseconds per gradient, least round, one thread. Short runs compare the two calls as well."
    return View("kernels", "Compiled kernels beside a C loop", frame, legend, SOURCE, show)


def chosen_view(work: pd.DataFrame) -> View:
    """Return the error that a tolerance asked of a fixed-step method gives, pilots included."""
    part = work[(work["variant"] == "chosen") & (work["status"] == "ok")]
    labels = {
        "scene": "scene",
        "method": "method",
        "engine": "engine",
        "value": "rtol",
        "solution_error": "error",
        "rhs_equivalents": "evaluations",
        "time_min_s": "time",
    }
    frame = pick(part, labels).assign(**{"error / rtol": part["solution_error"] / part["value"]})
    show: dict[str, Show] = dict.fromkeys(("rtol", "error"), scientific)
    show |= {"time": duration, "error / rtol": times, "": count}
    legend = "The step is chosen from pilot runs, which count."
    return View("chosen", "A step chosen from a tolerance", frame, legend, SOURCE, show)


def endings_view(work: pd.DataFrame) -> View:
    """Return how many runs did not end ok, and how."""
    bad = contestants(work)[lambda rows: rows["status"] != "ok"]
    frame = matrix(bad, "method", "scene", lambda rows: ", ".join(dict.fromkeys(rows["status"])))
    return View("endings", "Runs that did not end ok", frame, "Why: column `message`.", SOURCE)


def parts(frames: Frames) -> list[Part]:
    work, found = frames["work_precision"], once(all_contests, frames)
    scenes = []
    for scene in dict.fromkeys(work["scene"]):
        views = [costs_view(own, scene) for own in found.values() if scene in set(own.standings["scene"])]
        drawn = figures.figure(work, scene)
        scenes.append(Section(scene, (*([drawn] if drawn else []), *views), "scene"))
    views = [kernels_view(work), chosen_view(work), endings_view(work)]
    return [
        Text("Who is cheapest where, and where the contact methods lose: [README.md](README.md)."),
        Section("Scene by scene", (Text(LEGEND), *scenes)),
        *(view for view in views if len(view.frame)),
    ]


TITLE, QUESTION = "Cost at equal error", "What does an error cost?"
CHAPTERS.add(Chapter("work_precision", TITLE, QUESTION, 40, ("work_precision",), parts, answers))
