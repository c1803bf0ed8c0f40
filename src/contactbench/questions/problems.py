"""Random problems: who is the cheapest, how often, by how much, with intervals; hard problems."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache

import numpy as np
import pandas as pd

from contactbench.measure.statistics import quantile_interval, wilson
from contactbench.questions.answers import count
from contactbench.questions.contest import drawn, random_contests
from contactbench.questions.regret import COSTS, regrets
from contactbench.report.chapters import PROSE, Answer, Frames, Part, chapter, view
from contactbench.report.numbers import DASH, power, times
from contactbench.report.views import Cell, Mark, View, frame_of

#: costs in words, and the questions about them
LABELS = {"evaluations": "evaluations", "time_s": "compiled time"}
QUESTIONS: dict[str, str] = PROSE["problems"]["questions"]
#: how runs end, in order; the largest error of one that is right
ENDS, RIGHT = ("right", "wrong", "diverged", "failed", "budget"), 1e-3


@lru_cache(2)
def usual(frames: Frames) -> pd.DataFrame:
    """Return the costs on the problems that are not hard."""
    return drawn(frames["population"], frames["problems"])


@lru_cache(2)
def seeds(frames: Frames) -> list[int]:
    """Return the seeds, that with the most problems first: the others are replicates."""
    problems = usual(frames).drop_duplicates(["seed", "scene"])
    return [int(seed) for seed in problems["seed"].value_counts(sort=True).index]


@lru_cache(4)
def won(frames: Frames, cost: str) -> pd.DataFrame:
    """Return the best contact method beside the best other, a row for each problem and error."""
    found = random_contests(frames["population"], frames["problems"], frames["runs"], cost)
    ratio, most = found["ratio"], found["margin"]
    near = ratio <= 1.25 if cost == "time_s" else ratio <= 1
    winner = np.select([ratio * most < 1, near, ratio <= most], ["alone", "near", "near"], "other")
    return found.assign(near=near, winner=winner, best=found["ours"].where(ratio <= 1, found["other"]))


def of(frames: Frames, seed: int, cost: str, error: float) -> pd.DataFrame:
    own = won(frames, cost)
    return own[(own["seed"] == seed) & (own["error"] == error)]


@lru_cache(2)
def errors(frames: Frames) -> list[float]:
    return sorted(usual(frames)["error"].unique(), reverse=True)


def heads(frames: Frames) -> list[tuple[str, float]]:
    return [(cost, error) for cost in COSTS for error in errors(frames)]


# -- cells -----------------------------------------------------------------------------------------
def percent(part: int, whole: int) -> str:
    """Return a share with its interval."""
    if not whole:
        return DASH
    low, high = wilson(part, whole)
    return f"{100 * part / whole:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"


def share(truths: pd.Series) -> Cell:
    part, whole = int(truths.sum()), len(truths)
    return Cell(percent(part, whole), part / whole if whole else None)


def quantile(values: Sequence[float] | pd.Series, q: float) -> Cell:
    found, low, high = quantile_interval(list(values), q)
    if np.isnan(found):
        return Cell(DASH)
    return Cell(f"{times(found)} [{low:.2g}, {high:.2g}]", found if np.isfinite(found) else None)


# -- answers ---------------------------------------------------------------------------------------
def answers(frames: Frames) -> Iterator[Answer]:
    if not len(usual(frames)):
        return
    seed = seeds(frames)[0]
    for cost in COSTS:
        says, counts, queries = [], [], []
        for error in errors(frames):
            table = f"random_contests(population, problems, runs, '{cost}')"
            table += f".query('seed == {seed} and error == {error:g}')"
            near, alone = f"{table}.ratio <= 1.25", f"{table}.eval('ratio * margin < 1')"
            first, *more = (near, alone) if cost == "time_s" else (f"{table}.ratio < 1",)
            part, whole = count(frames, first)
            says.append(f"{power(error)}: {percent(part, whole)}")
            beside = "".join(f", leading alone on {count(frames, query)[0]}" for query in more)
            counts.append(f"{part} of {whole}{beside}")
            queries += [first, *more]
        yield Answer(QUESTIONS[cost], ", ".join(says), "; ".join(counts), tuple(queries))
    query = f"random_contests(population, problems, runs, 'evaluations', {CREEP!r})"
    query += f".query('seed == {seed}').ratio < 1"
    part, whole = count(frames, query)
    if whole:
        yield Answer(
            QUESTIONS[CREEP], percent(part, whole), f"{part} of {whole} pairs of problem and error", (query,)
        )


# -- views -----------------------------------------------------------------------------------------
def contests_view(frames: Frames) -> View:
    first, *others = seeds(frames)
    lines = []
    for cost, error in heads(frames):
        own = of(frames, first, cost, error)
        ratio = 1 / own["ratio"].astype(float)
        line: list[object] = [f"{LABELS[cost]}, {power(error)}", share(own["near"])]
        line += [share(own["winner"] == name) for name in ("alone", "other")]
        line += [quantile(ratio, 0.5), quantile(np.maximum(1.0, 1 / ratio), 0.9)]
        for seed in others:
            again = of(frames, seed, cost, error)["near"]
            inside = len(again) and overlap(
                *(wilson(int(near.sum()), len(near)) for near in (own["near"], again))
            )
            line.append(Cell(share(again).text, mark=None if inside else Mark.exception))
        lines.append(line)
    labels = [
        "cost, error",
        "contact near the least",
        "alone",
        "another alone",
        "other / contact, median",
        "regret, 90 %",
    ]
    return view("random_contests", frame_of(lines, [*labels, *(f"near, seed {seed}" for seed in others)]))


def overlap(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return max(one[0], other[0]) <= min(one[1], other[1])


def methods_view(frames: Frames) -> View:
    """How often each method is the best, and what taking it always costs."""
    rows = usual(frames)
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
    return view("random_methods", frame_of(lines, labels))


# -- strong damping --------------------------------------------------------------------------------
#: the kind of hard problems whose motions creep under strong damping, a contest as those that are not hard
CREEP = "creep"


def creep_view(frames: Frames) -> View:
    """How often contact methods need the fewest evaluations on motions that creep, against whom, by what factor."""
    tables = [frames[name] for name in ("population", "problems", "runs")]
    rows, lines = random_contests(tables[0], tables[1], tables[2], "evaluations", CREEP), []
    rows = rows[rows["seed"] == seeds(frames)[0]]
    for error in sorted(rows["error"].unique(), reverse=True):
        own = rows[rows["error"] == error]
        leaders = own["ours"].where(own["ratio"] < 1, own["other"]).value_counts()
        ratio = 1 / own["ratio"].astype(float)
        first = ", ".join(f"{name} {number}" for name, number in leaders.items())
        line = [power(error), len(own), share(own["ratio"] < 1), first]
        lines.append([*line, *(quantile(ratio, q) for q in (0.1, 0.5, 0.9))])
    heads = ["error", "problems", "contact needs the fewest", "who does, on how many"]
    parts = [f"other / contact, {part}" for part in ("10 %", "median", "90 %")]
    return view("random_creep", frame_of(lines, [*heads, *parts]))


# -- hard problems ---------------------------------------------------------------------------------
def hard_rows(frames: Frames) -> pd.DataFrame:
    """Return the runs of the hard problems; end : right, wrong, or how the run ended."""
    problems = frames["problems"]
    rows = frames["population"].merge(problems[problems["hard"] != ""][["seed", "scene", "hard"]])
    rows = rows[rows.groupby("hard")["error"].transform("nunique") == 1]  # others are contests
    right = (rows["reached"] <= RIGHT).map({True: "right", False: "wrong"})
    return rows.assign(end=rows["status"].where(rows["status"] != "ok", right))


def hard_view(frames: Frames) -> View:
    rows, lines = hard_rows(frames), []
    kinds = list(dict.fromkeys(rows["hard"]))
    for method, own in rows.groupby("method", sort=False):
        counts = [own[own["hard"] == kind]["end"].value_counts() for kind in kinds]
        cells = [", ".join(f"{each[end]} {end}" for end in ENDS if end in each) or DASH for each in counts]
        lines.append([method, share(own["end"] == "right"), *cells])
    return view("random_hard", frame_of(lines, ["method", "ok and right", *kinds]))


@chapter("problems", answers)
def parts(frames: Frames) -> Iterable[Part | None]:
    if len(usual(frames)):
        yield from (one(frames) for one in (contests_view, methods_view, creep_view, hard_view))
