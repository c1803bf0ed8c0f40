"""Cost at equal error: who is cheapest where, and scene by scene what each error costs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from contactbench.measure.statistics import FLOOR, WIDEST
from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part, Section, Text, once, summary
from contactbench.report.figures import work_precision as figures
from contactbench.report.numbers import DASH, count, duration, how_often, percent, power, scientific, times
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of
from contactbench.results.contest import (
    CONTACT,
    COUNTED,
    KINDS,
    LIMIT,
    OTHER,
    TARGETS,
    Kind,
    contestants,
    contests,
    costs,
    standings,
)

SOURCE = "work_precision.csv"
#: marks a cost that is mostly fixed
FIXED = " °"
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


@dataclass(frozen=True)
class Contest:
    """All costs of one kind, with their standings and the contests between contact methods and others."""

    kind: Kind
    standings: pd.DataFrame
    contests: pd.DataFrame

    @property
    def show(self) -> Callable[[float], str]:
        """How a cost is written."""
        return duration if self.kind.timed else count

    @property
    def scenes(self) -> list[str]:
        """The scenes on which contact methods and others ran."""
        return list(dict.fromkeys(self.contests["scene"]))


def contest(work: pd.DataFrame, kind: Kind) -> Contest:
    """Return the contest of one kind over the scenes of a table."""
    found = costs(contestants(work), kind)
    return Contest(kind, standings(found), contests(found))


def all_contests(frames: Frames) -> Mapping[str, Contest]:
    """Return the contests of every kind, by its name."""
    return {kind.name: contest(frames["work_precision"], kind) for kind in KINDS}


def tally(won: pd.DataFrame) -> tuple[str, str]:
    """Return how often a contact method wins, and the counts: wins, ties, and who wins the rest."""
    judged = won[won["winner"] != ""]
    wins, ties, undecided = (int((judged["winner"] == w).sum()) for w in (CONTACT, "tie", "undecided"))
    others = judged[judged["winner"] == OTHER]["other"].value_counts()
    counts = [f"{wins} of {len(judged)} pairs of scene and error"]
    counts += [f"{ties} ties"] * bool(ties) + [f"{undecided} undecided"] * bool(undecided)
    rest = ", ".join(f"{method} {n}" for method, n in others.items())
    return how_often(wins, len(judged)), ", ".join(counts) + (f"; others: {rest}" if rest else "")


def answers(frames: Frames) -> pd.DataFrame:
    return summary(
        *(
            (QUESTIONS[name], *tally(own.contests))
            for name, own in once(all_contests, frames).items()
            if len(own.contests)
        )
    )


# -- views -----------------------------------------------------------------------------------------
def cost_cell(row: Any, show: Callable[[float], str], name: str = "") -> Cell:
    """Return one cost as `standings` has it, behind a name where one is given; its reason where there is none."""
    if math.isnan(row.cost):
        return Cell(row.reason or DASH)
    mark = {"win": Mark.best, "tie": Mark.tie, "undecided": Mark.tie}.get(row.verdict)
    text = f"{'≤ ' if row.bound else ''}{show(row.cost)}{FIXED if row.fixed > 0.5 else ''}"
    return Cell(f"{name} {text}" if name else text, None if name else row.cost, mark)


def errors() -> list[str]:
    return [f"error {power(target)}" for target in TARGETS]


def winners_view(own: Contest, name: str, title: str, source: str = SOURCE) -> View:
    """Return the cheapest method at each error, with the best contact method's factor where it is another."""
    marks = {CONTACT: Mark.best, "tie": Mark.tie, "undecided": Mark.tie}
    won = own.contests.set_index(["scene", "error"])["winner"]
    rows = []
    for scene, here in own.standings.groupby("scene", sort=False):
        if scene not in own.scenes:
            continue
        cells = []
        for target in TARGETS:
            ranked = here[here["error"] == target]
            first = next(ranked.itertuples())
            cell = cost_cell(first, own.show, "" if math.isnan(first.cost) else first.method)
            ours = ranked[ranked["family"] == CONTACT]["ratio"].min()
            behind = f" (contact {times(ours)})" if ours > 1 else ""
            cells.append(Cell(cell.text + behind, mark=marks.get(won[scene, target])))
        if here["cost"].notna().any():
            rows.append((f"`{scene}`", *cells))
    legend = (
        f"{own.kind.about} In brackets the best contact method, where it is not the cheapest. "
        "Bold: a contact method is the cheapest; italic: it ties with another, or is undecided."
    )
    return View(name, title, frame_of(rows, ["scene", *errors()]), legend, source)


def losses_view(won: Mapping[str, pd.DataFrame], name: str, source: str = SOURCE) -> View:
    """Return at how many errors of each scene another method wins, by kind of cost, and by how much at most.

    won : the contests by title of their kind.
    """
    scenes = list(dict.fromkeys(scene for own in won.values() for scene in own["scene"]))
    rows = []
    for scene in scenes:
        cells = [lost_cell(own[own["scene"] == scene]) for own in won.values()]
        if any(cell.value for cell in cells):
            rows.append((f"`{scene}`", *cells))
    legend = (
        "At how many errors another method is cheaper than every contact method, and where by most: at which error, "
        "which method, how many times cheaper. [Why](../docs/reading.md#where-the-contact-methods-lose)."
    )
    return View(name, "Where the contact methods lose", frame_of(rows, ["scene", *won]), legend, source)


def lost_cell(own: pd.DataFrame) -> Cell:
    """Return the losses of one scene."""
    judged, lost = own[own["winner"] != ""], own[own["winner"] == OTHER]
    if not len(lost):
        return Cell("" if len(judged) else DASH)
    worst = lost.loc[lost["ratio"].idxmin()]
    by = "alone" if worst["ratio"] == 0 else times(1 / worst["ratio"])
    text = f"{len(lost)} of {len(judged)}: {power(worst['error'])} {worst['other']} {by}"
    return Cell(text, float(len(lost)))


def costs_view(own: Contest, scene: str) -> View:
    """Return the cost of each error for each method on a scene."""
    here = own.standings[own.standings["scene"] == scene]
    order = dict.fromkeys(here["method"])
    by_pair = {(row.method, row.error): row for row in here.itertuples()}
    rows = [(m, *(cost_cell(by_pair[m, t], own.show) for t in TARGETS)) for m in sorted(order)]
    return View(f"{own.kind.name}_{scene}", own.kind.title, frame_of(rows, ["method", *errors()]), "", SOURCE)


def kernels_view(work: pd.DataFrame) -> View | None:
    """Return the time per gradient of compiled fixed-step methods beside the same arithmetic as a plain C loop."""
    ok = work[work["status"] == "ok"]
    loops = ok[ok["family"] == LIMIT]
    own = contestants(ok)
    own = own[~own["engine"].isin(["python", "c+python"])]
    pairs = loops.merge(
        own,
        left_on=["scene", "variant", "control", "value"],
        right_on=["scene", "method", "control", "value"],
        suffixes=("_c", ""),
    )
    if not len(pairs):
        return None
    c, whole = (1e9 * pairs[f"time_min_s{s}"] / pairs[f"evaluations{s}"] for s in ("_c", ""))
    frame = pairs[["scene", "method", "engine", "setting", "evaluations_c"]].assign(
        c=c, own=whole, ratio=whole / c
    )
    frame.columns = pd.Index(
        ["scene", "method", "engine", "setting", "gradients", "C loop, ns", "whole call, ns", "ratio"]
    )
    show = {"gradients": count, "ratio": times, "": "{:.2f}".format}
    legend = "Nanoseconds per gradient, least round, one thread. Short runs compare the two calls as well."
    return View("kernels", "Compiled kernels beside a C loop", frame, legend, SOURCE, show)


def chosen_view(work: pd.DataFrame) -> View | None:
    """Return the error that a tolerance asked of a fixed-step method gives, pilots included."""
    part = work[(work["variant"] == "chosen") & (work["status"] == "ok")]
    if not len(part):
        return None
    ratios = [
        as_cell(r, times, Mark.exception if r > 1 else None) for r in part["solution_error"] / part["value"]
    ]
    frame = part[["scene", "method", "engine", "value", "solution_error"]].assign(
        ratio=pd.Series(ratios, part.index)
    )
    frame = frame.join(part[["steps", "rhs_equivalents", "time_min_s"]])
    frame.columns = pd.Index(
        ["scene", "method", "engine", "rtol", "error", "error / rtol", "steps", "evaluations", "time"]
    )
    show = {"rtol": lambda v: scientific(v, 0), "error": scientific, "time": duration, "": count}
    legend = "The step is chosen from pilot runs, which count. Marked: less accurate than asked."
    return View("chosen", "A step chosen from a tolerance", frame, legend, SOURCE, show)


def endings_view(work: pd.DataFrame) -> View | None:
    """Return the runs that did not end ok."""
    part = contestants(work)
    part = part[part["status"] != "ok"]
    if not len(part):
        return None
    frame = part[["scene", "method", "engine", "setting", "status", "message"]]
    kinds = ", ".join(f"{status} {n}" for status, n in part["status"].value_counts().items())
    return View("endings", "Runs that did not end ok", frame, f"{kinds}.", SOURCE, detail=True)


def margins_view(found: Mapping[str, Contest]) -> View:
    """Return the margins of the pairs of best methods, kind by kind."""
    rows = []
    for own in found.values():
        margins = own.contests["margin"].dropna()
        if own.kind.timed and len(margins):
            ties = int(own.contests["winner"].isin(["tie", "undecided"]).sum())
            rows.append((own.kind.title, len(margins), *margins.quantile([0.5, 0.95]), ties))
    labels = ["cost", "pairs", "half of the margins", "95 %", "ties and undecided"]
    legend = (
        "Up to which ratio the best contact method and the best other tie: a margin for every pair, from the halves of "
        f"its visits and from two processes, at least {percent(FLOOR)}; wider than {percent(WIDEST)} it is undecided. "
        f"Evaluations tie within {percent(COUNTED)}."
    )
    show = {"half of the margins": percent, "95 %": percent}
    return View("margins", "Margins", frame_of(rows, labels), legend, "work_precision_times.csv", show)


def parts(frames: Frames) -> list[Part]:
    work, found = frames["work_precision"], once(all_contests, frames)
    scenes = [
        Section(
            scene,
            (
                *filter(None, [figures.figure(work, scene)]),
                *(costs_view(own, scene) for own in found.values() if scene in set(own.standings["scene"])),
            ),
            choice="scene",
        )
        for scene in dict.fromkeys(work["scene"])
    ]
    views = [margins_view(found), kernels_view(work), chosen_view(work), endings_view(work)]
    return [
        Text("Who is cheapest where, and where the contact methods lose: [README.md](README.md)."),
        Section("Scene by scene", (Text(LEGEND), *scenes)),
        *(view for view in views if view is not None),
    ]


CHAPTERS.add(
    Chapter(
        "work_precision",
        "Cost at equal error",
        "What does an error cost?",
        40,
        ("work_precision",),
        parts,
        answers,
    )
)
