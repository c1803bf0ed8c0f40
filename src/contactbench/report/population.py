"""Random problems: who is the cheapest, how often, by how much, with intervals; hard problems."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache

import numpy as np
import pandas as pd

from contactbench.measure.statistics import COUNTED, quantile_interval, wilson
from contactbench.report.chapters import PROSE, Answer, Frames, Part, chapter, view
from contactbench.report.numbers import DASH, power, times
from contactbench.report.views import Cell, Mark, View, frame_of
from contactbench.results.contest import CONTACT, OTHER, OURS
from contactbench.results.regret import COSTS, regrets

#: costs in words, and the questions about them
LABELS = {"evaluations": "evaluations", "time_s": "compiled time"}
QUESTIONS: dict[str, str] = PROSE["population"]["questions"]
#: the error at which strata are shown
STRATIFIED = 1e-6
#: strata: a column, and where it is cut
CUTS = {
    "damping": (1e-3, 1e-1),
    "span": (30.0, 300.0),
    "size": (1.0, 2.0),
    "cost": (50.0, 100.0),
    "spread": (1.2, 2.0),
}
#: how runs end, in order
ENDS = ("right", "wrong", "diverged", "failed", "budget")


@lru_cache(2)
def problems_of(frames: Frames) -> pd.DataFrame:
    problems = frames["population_problems"]
    return problems[problems["hard"] == ""]


def seeds(frames: Frames) -> list[int]:
    """Return the seeds, that with the most problems first: the others are replicates."""
    return [int(seed) for seed in problems_of(frames)["seed"].value_counts(sort=True).index]


def told(frames: Frames) -> bool:
    """Return whether there are costs, and the problems that they are of."""
    return bool(len(frames["population"]) and len(problems_of(frames)))


@lru_cache(2)
def won(frames: Frames) -> pd.DataFrame:
    """Return the best contact method beside the best other, a row for each problem, error and cost."""
    rows, found = frames["population"], []
    contact = rows["family"] == CONTACT
    for cost in COSTS:
        spent = rows.assign(spent=rows[cost].where(rows["status"] == "ok")).dropna(subset="spent")
        spent = spent.sort_values("spent", kind="stable")
        key = ["seed", "scene", "error"]
        ours, other = (
            spent[side[spent.index]].groupby(key)[["method", "spent"]].first() for side in (contact, ~contact)
        )
        both = ours.add_suffix("_ours").join(other.add_suffix("_other"), how="outer")
        ratio = both["spent_other"].fillna(np.inf) / both["spent_ours"].fillna(np.inf)
        ratio = ratio.where(both["spent_ours"].notna(), 0.0)
        winner = np.select([ratio > COUNTED, ratio < 1 / COUNTED], [OURS, OTHER], "tie")
        best = both["method_ours"].where(ratio >= 1, both["method_other"])
        found.append(
            pd.DataFrame({"ratio": ratio, "winner": winner, "best": best}).reset_index().assign(by=cost)
        )
    made = pd.concat(found, ignore_index=True)
    return made.merge(problems_of(frames), on=["seed", "scene"])


def of(frames: Frames, seed: int, cost: str, error: float) -> pd.DataFrame:
    own = won(frames)
    return own[(own["seed"] == seed) & (own["by"] == cost) & (own["error"] == error)]


def errors(frames: Frames) -> list[float]:
    return sorted(frames["population"]["error"].unique(), reverse=True)


# -- cells -----------------------------------------------------------------------------------------
def percent(part: int, whole: int) -> str:
    """Return a share with its interval."""
    if not whole:
        return DASH
    low, high = wilson(part, whole)
    return f"{100 * part / whole:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"


def share(part: int, whole: int) -> Cell:
    return Cell(percent(part, whole), part / whole if whole else None)


def quantile(values: Sequence[float] | pd.Series, q: float) -> Cell:
    found, low, high = quantile_interval(list(values), q)
    if np.isnan(found):
        return Cell(DASH)
    return Cell(f"{times(found)} [{low:.2g}, {high:.2g}]", found if np.isfinite(found) else None)


# -- answers ---------------------------------------------------------------------------------------
def answers(frames: Frames) -> Iterator[Answer]:
    if not told(frames):
        return
    seed = seeds(frames)[0]
    drawn = int((problems_of(frames)["seed"] == seed).sum())
    for cost in COSTS:
        says, counts = [], []
        for error in errors(frames):
            own = of(frames, seed, cost, error)
            part = int((own["winner"] == OURS).sum())
            says.append(f"{power(error)}: {percent(part, len(own))}")
            counts.append(f"{part} of {len(own)}, {int((own['winner'] == 'tie').sum())} tied")
        yield Answer(QUESTIONS[cost].format(drawn), ", ".join(says), "; ".join(counts))


# -- views -----------------------------------------------------------------------------------------
def contests_view(frames: Frames) -> View:
    first, *others = seeds(frames)
    lines = []
    for cost in COSTS:
        for error in errors(frames):
            own = of(frames, first, cost, error)
            part, n = int((own["winner"] == OURS).sum()), len(own)
            low, high = wilson(part, n)
            ours = 1 / own["ratio"].astype(float)
            line: list[object] = [f"{LABELS[cost]}, {power(error)}", share(part, n)]
            line += [share(int((own["winner"] == name).sum()), n) for name in ("tie", OTHER)]
            line += [quantile(own["ratio"].astype(float), 0.5), quantile(np.maximum(1.0, ours), 0.9)]
            for seed in others:
                again = of(frames, seed, cost, error)
                there = int((again["winner"] == OURS).sum())
                inside = bool(len(again)) and overlaps((low, high), wilson(there, len(again)))
                line.append(Cell(percent(there, len(again)), mark=None if inside else Mark.exception))
            lines.append(line)
    labels = ["cost, error", "a contact method", "tied", "another", "other / contact, median", "regret, 90 %"]
    return view("population_contests", frame_of(lines, [*labels, *(f"seed {seed}" for seed in others)]))


def overlaps(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return max(one[0], other[0]) <= min(one[1], other[1])


def methods_view(frames: Frames) -> View:
    """How often each method is the best, and what taking it always costs."""
    rows = frames["population"]
    rows = rows[rows["seed"] == seeds(frames)[0]]
    heads = [(cost, error) for cost in COSTS for error in errors(frames)]
    tables = {head: regrets(rows, head[1], head[0]) for head in heads}
    best = {head: table.le(1.0).sum() for head, table in tables.items()}
    total = pd.DataFrame(best).sum(axis=1).sort_values(ascending=False, kind="stable")

    def cell(method: str, head: tuple[str, float]) -> Cell:
        own = tables[head].get(method, pd.Series(dtype=float)).dropna()
        if not len(own):
            return Cell(DASH)
        part, whole = int(best[head][method]), len(tables[head])
        spread = f"{times(own.median())}, {times(own.quantile(0.9))}"
        return Cell(f"{percent(part, whole)}; {spread}", part / whole)

    lines = [(method, *(cell(str(method), head) for head in heads)) for method in total.index]
    labels = [("", "method"), *((LABELS[cost], power(error)) for cost, error in heads)]
    return view("population_methods", frame_of(lines, labels))


def strata(problems: pd.DataFrame) -> dict[str, pd.Series]:
    """Return labels, and which rows are of each."""
    found = {}
    for name, (low, high) in CUTS.items():
        values = problems[name].astype(float)
        found[f"{name} ≤ {low:g}"] = values <= low
        found[f"{name} {low:g} … {high:g}"] = (values > low) & (values <= high)
        found[f"{name} > {high:g}"] = values > high
    return found | {str(family): problems["structure"] == family for family in problems["structure"].unique()}


def strata_view(frames: Frames) -> View:
    seed, parts = seeds(frames)[0], []
    for cost in COSTS:
        own = of(frames, seed, cost, STRATIFIED)
        lines = {}
        for label, inside in strata(own).items():
            counted = own["best"][inside].value_counts()
            name = f"{counted.index[0]} {counted.iloc[0]}" if len(counted) else DASH
            lines[label] = [
                int(inside.sum()),
                share(int((own["winner"][inside] == OURS).sum()), int(inside.sum())),
                name,
            ]
        parts.append(pd.DataFrame.from_dict(lines, orient="index"))
    joined = pd.concat(parts, axis=1).reset_index()
    heads = [
        (LABELS[cost], what) for cost in COSTS for what in ("problems", "a contact method", "most often best")
    ]
    return view("population_strata", frame_of(joined.itertuples(index=False), [("", "problems"), *heads]))


def ending(rows: pd.DataFrame) -> pd.Series:
    ok = rows["right"].map({True: "right", False: "wrong"})
    return rows["status"].where(rows["status"] != "ok", ok)


def hard_view(frames: Frames) -> View | None:
    rows = frames["population_hard"]
    if not len(rows):
        return None
    rows, lines = rows.assign(end=ending(rows)), []
    kinds = list(dict.fromkeys(rows["hard"]))
    for method, own in rows.groupby("method", sort=False):
        right = int((own["end"] == "right").sum())
        cells = []
        for kind in kinds:
            counted = own[own["hard"] == kind]["end"].value_counts()
            cells.append(", ".join(f"{counted[end]} {end}" for end in ENDS if end in counted) or DASH)
        lines.append([method, share(right, len(own)), *cells])
    return view("population_hard", frame_of(lines, ["method", "ok and right", *kinds]))


@chapter("population", answers)
def parts(frames: Frames) -> Iterable[Part | None]:
    if not told(frames):
        return []
    made = (contests_view, methods_view, strata_view, hard_view)
    return [one(frames) for one in made]
