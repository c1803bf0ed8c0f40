"""results/README.md and the computed part of the project's README: the mission, the answers, who is cheapest where."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pandas as pd

from contactbench.report import claims, convergence, laws, work_precision
from contactbench.report.chapters import (
    CHAPTERS,
    Chapter,
    Frames,
    Part,
    Section,
    Text,
    chapters,
    once,
    summary,
)
from contactbench.report.equal_cost import mission_view
from contactbench.report.figures import work_precision as figures
from contactbench.report.numbers import how_often, names
from contactbench.report.views import Cell, View, frame_of
from contactbench.results.contest import OTHER

NAME = "headline"
#: the scene whose work–precision picture stands here
PICTURED = "particle"
#: a column of the result with the laws that a reader asks about first
PROMISED = {"momentum_law": "J", "contact_drift": "the contact form"}


# -- six answers -----------------------------------------------------------------------------------
def structure_answer(frames: Frames) -> tuple[str, str, str] | None:
    """Return whether J and the contact form are kept where that is promised."""
    rows = once(laws.judged_rows, frames)
    promised = rows[rows["claimed"] & rows["law"].isin(PROMISED)]
    found = [(PROMISED[str(law)], own) for law, own in promised.groupby("law", sort=False)]
    answer = ", ".join(f"{label} {how_often(*laws.kept_of(own))}" for label, own in found)
    count = "; ".join(laws.counts(own) for _, own in found)
    return ("Does it keep J and the contact form where it promises to?", answer, count) if found else None


def loss_answer(frames: Frames) -> tuple[str, str, str] | None:
    """Return on which scenes another method is cheaper at every error, compiled."""
    won = once(work_precision.all_contests, frames)["compiled"].contests
    judged = won[won["winner"] != ""]
    if not len(judged):
        return None
    lost = judged["winner"] == OTHER
    every = lost.groupby(judged["scene"], sort=False).transform("all")
    scenes = [f"`{scene}`" for scene in judged["scene"][every].unique()]
    there, others, pairs = int(every.sum()), int(lost[~every].sum()), int((~every).sum())
    count = f"{there} of {there} pairs there, {others} of {pairs} elsewhere"
    return "Where is it slower at every error, compiled?", names(scenes) or "nowhere", count


def answers(frames: Frames) -> pd.DataFrame:
    """Return the answers that stand in the project's README."""
    asked = [structure_answer(frames)]
    if len(frames["convergence"]):
        asked += rows_of(once(convergence.answers, frames))
    if len(frames["work_precision"]):
        costs = {row[0]: row for row in rows_of(once(work_precision.answers, frames))}
        asked += [costs.get(work_precision.QUESTIONS[kind]) for kind in ("compiled", "evaluations")]
        asked.append(loss_answer(frames))
    if len(frames["claims"]):
        asked += rows_of(once(claims.answers, frames))[:1]
    return summary(*(row for row in asked if row is not None))


def rows_of(frame: pd.DataFrame) -> list[tuple[str, str, str]]:
    return list(frame.itertuples(index=False, name=None))


# -- results/README.md -----------------------------------------------------------------------------
def documents_view(frames: Frames) -> View:
    """Return the documents, and the question each answers."""
    rows: list[tuple[object, ...]] = [
        (Cell(chapter.file, link=chapter.file), chapter.question)
        for chapter in chapters(frames)
        if chapter.name != NAME
    ]
    rows.append((Cell("glossary.md", link="glossary.md"), "What is each method, scene and column?"))
    return View("documents", "All tables", frame_of(rows, ["document", "question"]))


def cheapest_parts(contests: list[work_precision.Contest]) -> list[Part]:
    """Return who is cheapest where, a table for each kind of cost, and where the contact methods lose."""
    if not contests:
        return []
    legend = (
        "In brackets the best contact method, where it is not the cheapest. Bold: a contact method is the cheapest; "
        "italic: it ties. [Scene by scene](work_precision.md); [hard scenes](stability.md)."
    )
    tables = (
        replace(work_precision.winners_view(own, f"cheapest_{own.kind.name}"), legend="") for own in contests
    )
    lost = work_precision.losses_view({own.kind.title: own.contests for own in contests}, "lost")
    return [Section("Who is cheapest where", (Text(legend), *tables)), lost]


def parts(frames: Frames) -> list[Part]:
    mission, work = mission_view(frames), frames["work_precision"]
    found: list[Part] = [mission] if mission else []
    if len(work):
        drawn = figures.figure(work, PICTURED)
        found += [replace(drawn, caption="")] if drawn else []
        contests = once(work_precision.all_contests, frames).values()
        found += cheapest_parts([own for own in contests if len(own.contests)])
    return [*found, documents_view(frames)]


def machine(runs: Sequence[Mapping[str, Any]]) -> Text:
    """Return on what the tables were made, in a line."""
    places = dict.fromkeys(
        f"{run.get('cpu', '')}, {run.get('cores', '')} cores, Python {run.get('python', '')}, "
        f"commit `{str(run.get('commit', ''))[:12] or 'unknown'}`{' with local changes' if run.get('dirty') else ''}"
        for run in runs
    )
    return Text(
        f"Measured on {'; '.join(places)} ([environment.json](environment.json)). Without units: as in the paper."
    )


TABLES = ("laws", "decay_laws", "work_precision", "convergence", "claims")
CHAPTERS.add(Chapter(NAME, "Results", "What was found?", 0, TABLES, parts, answers, "README.md"))
