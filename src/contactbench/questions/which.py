"""Which method?  For each kind of problem and error the method with the least mean cost, and what it costs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from contactbench.questions import problems
from contactbench.questions.contest import CONTACT, families
from contactbench.questions.regret import COSTS, regrets
from contactbench.report.chapters import PROSE, Frames, Part, chapter, view
from contactbench.report.numbers import DASH, names, power, times
from contactbench.report.views import Cell, View, frame_of

#: kinds of problem and the families that are of each, none: all the others
KINDS: dict[str, list[str]] = PROSE["which"]["kinds"]
#: of a potential with linear damping by the damping over the frequency, above which and up to which
STRENGTHS = {"weak": (0.0, 1e-3), "middling": (1e-3, 1e-1), "strong": (1e-1, np.inf)}
#: so many methods are named for each hard kind
NAMED = 3


def kind_of(structure: str) -> str:
    """Return the kind of a family: that which names it, else the first."""
    return next((kind for kind, own in KINDS.items() if structure in own), next(iter(KINDS)))


def groups(rows: pd.DataFrame) -> dict[str, pd.Series]:
    """Return labels of kinds of problem, and which rows are of each."""
    kinds = rows["structure"].map(kind_of)
    first, *others = KINDS
    strength = rows["damping"].astype(float)
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
    rows, known = problems.usual(frames), families(frames["runs"])
    rows = rows[rows["seed"] == problems.seeds(frames)[0]]
    lines = []
    for label, inside in groups(rows).items():
        for error in problems.errors(frames):
            tables = [regrets(rows[inside], error, cost) for cost in COSTS]
            ours = [each[[m for m in each if known.get(m) == CONTACT]] for each in tables]
            cells = [best(own) for pair in zip(tables, ours, strict=True) for own in pair]
            lines.append([f"{label}, {power(error)}", len(tables[0]), *cells])
    labels = [("", "problems, error"), ("", "how many")]
    labels += [(problems.LABELS[cost], what) for cost in COSTS for what in ("any", "a contact method")]
    return view("which_kinds", frame_of(lines, labels), strong=f"{STRENGTHS['strong'][0]:g}")


def hard_view(frames: Frames) -> View:
    rows = problems.hard_rows(frames)
    right = rows["end"] == "right"
    runs = rows.assign(right=right, spent=rows["evaluations"].where(right)).groupby(
        ["hard", "method"], sort=False
    )
    shares = runs.agg(right=("right", "sum"), runs=("right", "size"), cost=("spent", "median")).reset_index()
    lines = []
    for kind, own in shares.groupby("hard", sort=False):
        first = own.sort_values(["right", "cost"], ascending=[False, True], kind="stable").head(NAMED)
        said = [f"{one.method} {one.right} of {one.runs}" for one in first.itertuples()]
        lines.append((kind, names(said, NAMED)))
    return view("which_hard", frame_of(lines, ["problems", "most often right"]))


@chapter("which")
def parts(frames: Frames) -> Iterator[Part | None]:
    if len(problems.usual(frames)):
        yield kinds_view(frames)
        yield hard_view(frames)
