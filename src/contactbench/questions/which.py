"""Which method?  A decision in a few questions, each branch with what the tables have of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from contactbench.questions import population, stability, structure
from contactbench.questions.contest import CONTACT
from contactbench.questions.regret import COSTS, regrets
from contactbench.report.chapters import PROSE, Frames, Part, Section, Text, chapter, view
from contactbench.report.numbers import DASH, names, power, times
from contactbench.report.views import Cell, View, frame_of

NAME = "which"
#: kinds of problem and the families that are of each, None: all the others; and the questions, in order
KINDS: dict[str, list[str]] = PROSE[NAME]["kinds"]
QUESTIONS: dict[str, dict[str, str]] = PROSE[NAME]["asked"]
#: of a potential with linear damping by the damping over the frequency, above which and up to which
STRENGTHS = {"weak": (0.0, 1e-3), "middling": (1e-3, 1e-1), "strong": (1e-1, np.inf)}
#: so many methods are named for each hard kind
NAMED = 3


def kind_of(structure: str) -> str:
    """Return the kind of a family: that which names it, else the first."""
    return next((kind for kind, own in KINDS.items() if structure in own), next(iter(KINDS)))


def groups(problems: pd.DataFrame) -> dict[str, pd.Series]:
    """Return labels of kinds of problem, and which rows are of each."""
    kinds = problems["structure"].map(kind_of)
    first, *others = KINDS
    strength = problems["damping"].astype(float)
    found = {
        f"{first}, damping {name}": (kinds == first) & (strength > low) & (strength <= high)
        for name, (low, high) in STRENGTHS.items()
    }
    return found | {kind: kinds == kind for kind in others}


def best(table: pd.DataFrame) -> Cell:
    """Return the method with the least mean logarithm of its regrets, of all that run on every problem, and these."""
    whole = table.dropna(axis=1)
    if not len(table) or not len(whole.columns):
        return Cell(DASH)
    first = np.log(whole).mean().sort_values(kind="stable").index[0]
    return Cell(f"{first} {times(whole[first].median())}, {times(whole[first].quantile(0.9))}")


def kinds_view(frames: Frames) -> View:
    seed, rows = population.seeds(frames)[0], frames["population"]
    rows = rows[rows["seed"] == seed]
    contact = {str(name) for name in rows["method"][rows["family"] == CONTACT]}
    problems = population.problems_of(frames).set_index(["seed", "scene"])
    lines = []
    for label, inside in groups(problems).items():
        for error in population.errors(frames):
            tables = [regrets(rows, error, cost) for cost in COSTS]
            tables = [table[inside.reindex(table.index).to_numpy(dtype=bool)] for table in tables]
            cells = [best(own) for each in tables for own in (each, each[[m for m in each if m in contact]])]
            lines.append([f"{label}, {power(error)}", len(tables[0]), *cells])
    labels = [("", "problems, error"), ("", "how many")]
    labels += [(population.LABELS[cost], what) for cost in COSTS for what in ("any", "a contact method")]
    return view("which_kinds", frame_of(lines, labels), strong=f"{STRENGTHS['strong'][0]:g}")


def hard_view(frames: Frames) -> View | None:
    rows = frames["population_hard"]
    if not len(rows):
        return None
    right = rows["right"].fillna(False).astype(bool)
    runs = rows.assign(right=right, cost=rows["evaluations"].where(right)).groupby(
        ["hard", "method"], sort=False
    )
    shares = runs.agg(right=("right", "sum"), runs=("right", "size"), cost=("cost", "median")).reset_index()
    lines = []
    for kind, own in shares.groupby("hard", sort=False):
        first = own.sort_values(["right", "cost"], ascending=[False, True], kind="stable").head(NAMED)
        said = [f"{one.method} {one.right} of {one.runs}" for one in first.itertuples()]
        lines.append((kind, names(said, NAMED)))
    return view("which_hard", frame_of(lines, ["problems", "most often right"]))


def parts_of(name: str, frames: Frames) -> tuple[Part | None, ...]:
    """Return what the tables have of a question."""
    if name == "long" and len(frames["structure_buys"]):
        return (Text(items=tuple(f"{one.answer}: {one.count}" for one in structure.answers(frames))),)
    if name == "stiff":
        rates = frames["damping_rates"]
        return (
            replace(stability.rates_view(rates[rates["experiment"] == "overdamped"]), name="which_rates"),
        )
    if name == "hard":
        return (hard_view(frames),)
    return (kinds_view(frames),) if name == "kind" else ()


@chapter(NAME)
def parts(frames: Frames) -> Iterator[Part | None]:
    if not population.told(frames):
        return
    for number, (name, asked) in enumerate(QUESTIONS.items(), 1):
        text = Text(" ".join(asked["text"].split()))
        yield Section(f"{number}. {asked['question']}", (text, *parts_of(name, frames)))
