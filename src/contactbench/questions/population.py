"""Random problems: who is the cheapest, how often, by how much, with intervals; hard problems."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache

import numpy as np
import pandas as pd

from contactbench.measure.statistics import COUNTED, quantile_interval, wilson
from contactbench.questions.contest import CONTACT, OTHER, OURS
from contactbench.questions.regret import COSTS, regrets
from contactbench.report.chapters import PROSE, Answer, Frames, Part, chapter, view
from contactbench.report.numbers import DASH, power, times
from contactbench.report.views import Cell, Mark, View, frame_of

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


def wins(own: pd.DataFrame, winner: str = OURS) -> int:
    return int((own["winner"] == winner).sum())


def errors(frames: Frames) -> list[float]:
    return sorted(frames["population"]["error"].unique(), reverse=True)


def heads(frames: Frames) -> list[tuple[str, float]]:
    return [(cost, error) for cost in COSTS for error in errors(frames)]


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
            says.append(f"{power(error)}: {percent(wins(own), len(own))}")
            counts.append(f"{wins(own)} of {len(own)}, {wins(own, 'tie')} tied")
        yield Answer(QUESTIONS[cost].format(drawn), ", ".join(says), "; ".join(counts))


# -- views -----------------------------------------------------------------------------------------
def contests_view(frames: Frames) -> View:
    first, *others = seeds(frames)
    lines = []
    for cost, error in heads(frames):
        own = of(frames, first, cost, error)
        ratio = own["ratio"].astype(float)
        line: list[object] = [f"{LABELS[cost]}, {power(error)}"]
        line += [share(wins(own, name), len(own)) for name in (OURS, "tie", OTHER)]
        line += [quantile(ratio, 0.5), quantile(np.maximum(1.0, 1 / ratio), 0.9)]
        for seed in others:
            again = of(frames, seed, cost, error)
            inside = len(again) and overlap(*(wilson(wins(each), len(each)) for each in (own, again)))
            line.append(Cell(percent(wins(again), len(again)), mark=None if inside else Mark.exception))
        lines.append(line)
    labels = ["cost, error", "a contact method", "tied", "another", "other / contact, median", "regret, 90 %"]
    return view("population_contests", frame_of(lines, [*labels, *(f"seed {seed}" for seed in others)]))


def overlap(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return max(one[0], other[0]) <= min(one[1], other[1])


def methods_view(frames: Frames) -> View:
    """How often each method is the best, and what taking it always costs."""
    rows = frames["population"]
    rows = rows[rows["seed"] == seeds(frames)[0]]
    tables = {(cost, error): regrets(rows, error, cost) for cost, error in heads(frames)}
    best = {head: table.le(1.0).sum() for head, table in tables.items()}
    total = pd.DataFrame(best).sum(axis=1).sort_values(ascending=False, kind="stable")

    def cell(method: str, head: tuple[str, float]) -> Cell:
        own = tables[head].get(method, pd.Series(dtype=float)).dropna()
        if not len(own):
            return Cell(DASH)
        part, whole = int(best[head][method]), len(tables[head])
        spread = f"{times(own.median())}, {times(own.quantile(0.9))}"
        return Cell(f"{percent(part, whole)}; {spread}", part / whole)

    lines = [(method, *(cell(str(method), head) for head in tables)) for method in total.index]
    labels = [("", "method"), *((LABELS[cost], power(error)) for cost, error in tables)]
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
    seed, labels, parts = seeds(frames)[0], [("", "problems")], []
    for cost in COSTS:
        own, lines = of(frames, seed, cost, STRATIFIED), {}
        for label, inside in strata(own).items():
            part = own[inside]
            counted = part["best"].value_counts()
            name = f"{counted.index[0]} {counted.iloc[0]}" if len(counted) else DASH
            lines[label] = [len(part), share(wins(part), len(part)), name]
        parts.append(pd.DataFrame.from_dict(lines, orient="index"))
        labels += [(LABELS[cost], what) for what in ("problems", "a contact method", "most often best")]
    joined = pd.concat(parts, axis=1).reset_index()
    return view("population_strata", frame_of(joined.itertuples(index=False), labels))


def hard_view(frames: Frames) -> View | None:
    rows = frames["population_hard"]
    if not len(rows):
        return None
    right = rows["right"].map({True: "right", False: "wrong"})
    rows, lines = rows.assign(end=rows["status"].where(rows["status"] != "ok", right)), []
    kinds = list(dict.fromkeys(rows["hard"]))
    for method, own in rows.groupby("method", sort=False):
        counts = [own[own["hard"] == kind]["end"].value_counts() for kind in kinds]
        cells = [", ".join(f"{each[end]} {end}" for end in ENDS if end in each) or DASH for each in counts]
        lines.append([method, share(int((own["end"] == "right").sum()), len(own)), *cells])
    return view("population_hard", frame_of(lines, ["method", "ok and right", *kinds]))


@chapter("population", answers)
def parts(frames: Frames) -> Iterable[Part | None]:
    views = (contests_view, methods_view, strata_view, hard_view)
    return [one(frames) for one in views] if told(frames) else []
