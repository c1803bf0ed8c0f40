"""Which method?  By kind of problem, damping, error and number of saved times, each table by a line of pandas."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pandas as pd

from contactbench.measure.statistics import WIDEST
from contactbench.questions import cost, problems
from contactbench.questions.answers import evaluate
from contactbench.questions.contest import CONTACT, costs, drawn, families
from contactbench.questions.contest import standings as stand
from contactbench.questions.regret import COSTS, regrets
from contactbench.report.chapters import PROSE, Frames, Part, chapter, chart, view
from contactbench.report.drawing import Axis, Field, Figure, Panel
from contactbench.report.numbers import DASH, names, power, times
from contactbench.report.views import Cell, View, frame_of
from contactbench.scenes import SCENES

#: kinds of random problems, and the condition of each
KINDS: dict[str, str] = PROSE["which"]["kinds"]
#: the systems of the short table: of random problems the condition, of named scenes their kind
SYSTEMS: dict[str, dict[str, str]] = PROSE["which"]["systems"]
#: the condition of a potential with linear damping, which the map is of
POTENTIAL: str = PROSE["which"]["potential"]
#: the error at which the short table is made
ERROR = 1e-6
#: the edges of the map's columns, in damping over frequency
EDGES = tuple(10.0**k for k in range(-5, 2))
#: so many methods are named for each hard kind
NAMED = 3


def problems_of(frames: Frames, condition: str) -> pd.DataFrame:
    """Return the costs on the random problems of the first seed that meet a condition."""
    rows = drawn(frames["population"], frames["problems"])
    return rows[rows["seed"] == problems.seeds(frames)[0]].query(condition)


def query(frames: Frames, condition: str, error: float = ERROR, of: str = "time_s") -> str:
    """Return the line of pandas that ranks the methods on such problems."""
    chosen = f"seed == {problems.seeds(frames)[0]} and {condition}"
    return f'mean_regrets(drawn(population, problems).query("{chosen}"), {error:g}, "{of}")'


def best(table: pd.DataFrame, ranked: pd.Series, allowed: set[str] | None = None) -> Cell:
    """Return the first of some methods, and its regret, median and 90 %."""
    first = next((m for m in ranked.index if allowed is None or m in allowed), None)
    if first is None:
        return Cell(DASH)
    return Cell(f"{first} {times(table[first].median())}, {times(table[first].quantile(0.9))}")


def contact_methods(frames: Frames) -> set[str]:
    return {method for method, family in families(frames["runs"]).items() if family == CONTACT}


def pair(frames: Frames, condition: str, error: float, of: str) -> tuple[int, list[Cell]]:
    """Return how many problems meet a condition, and the best of all methods and of the contact methods there."""
    table = regrets(problems_of(frames, condition), error, of)
    ranked = evaluate(query(frames, condition, error, of), frames)
    return len(table), [best(table, ranked), best(table, ranked, contact_methods(frames))]


# -- by kind of problem ----------------------------------------------------------------------------
def kinds_view(frames: Frames) -> View:
    lines = []
    for label, condition in KINDS.items():
        for error in problems.errors(frames):
            found = [pair(frames, condition, error, each) for each in COSTS]
            lines.append([f"{label}, {power(error)}", found[0][0], *found[0][1], *found[1][1]])
    labels = [("", "problems, error"), ("", "how many")]
    labels += [(problems.LABELS[each], what) for each in COSTS for what in ("any", "a contact method")]
    return view("which_kinds", frame_of(lines, labels), queries=listed(frames))


def listed(frames: Frames) -> str:
    return f"`{query(frames, next(iter(KINDS.values())))}`"


def damping_map(frames: Frames) -> Figure | None:
    """Return the map of the methods to take: damping over frequency along, error upwards."""
    panels = []
    for title, allowed in (("any method", None), ("contact methods", contact_methods(frames))):
        fields = []
        for low, high in pairwise(EDGES):
            for error in problems.errors(frames):
                condition = f"{POTENTIAL} and {low:g} < damping <= {high:g}"
                rows = problems_of(frames, condition)
                if not len(rows):
                    continue
                table = regrets(rows, error, "time_s")
                cell = best(table, evaluate(query(frames, condition, error), frames), allowed)
                if cell.text != DASH:
                    name, words = cell.text.split(" ", 1)
                    box = (low, high), (error / 30, error * 30)
                    fields.append(Field(*box, f"{name}\n{words}", name))
        axes = Axis("damping over frequency, γ/ω", "log"), Axis("error", "log", inverted=True)
        if fields:
            panels.append(Panel(title, *axes, (), fields=tuple(fields)))
    return chart("which_map", panels, across=1)


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


# -- how many times are saved ----------------------------------------------------------------------
def saved_view(frames: Frames) -> View:
    """Return who is within a quarter of the least time at each number of saved times that was timed."""
    lines: dict[str, list[object]] = {}
    numbers = sorted(int(saved) for saved in frames["times"]["saved"].unique())
    for saved in numbers:
        ranked = stand(costs(frames["runs"], frames["times"], saved=saved), within=WIDEST)
        here = ranked[ranked["error"] == ERROR]
        for scene, rows in here.groupby("scene", sort=False):
            lines.setdefault(str(scene), [scene, *[DASH] * len(numbers)])
            lines[str(scene)][1 + numbers.index(saved)] = cost.leaders(rows, True)
    heads = ["scene", *("the end alone" if saved == 1 else f"{saved} times" for saved in numbers)]
    both = [line for line in lines.values() if DASH not in line]
    return view("which_saved", frame_of(both or lines.values(), heads), error=power(ERROR))


# -- the short table -------------------------------------------------------------------------------
def systems_view(frames: Frames) -> View:
    lines = [[label, *system(frames, **which)] for label, which in SYSTEMS.items()]
    return view("systems", frame_of(lines, ["your system", "measured on", "take", "if J and η must be kept"]))


def system(frames: Frames, condition: str = "", kind: str = "") -> list[object]:
    """Return what a kind of system is measured on, and the best of all methods and of the contact methods."""
    if condition:
        if not len(problems.usual(frames)):
            return [DASH] * 3
        number, cells = pair(frames, condition, ERROR, "time_s")
        return [f"{number} random problems", *cells]
    table = named_regrets(frames, kind)
    ranked = np.log(table.dropna(axis=1)).mean().sort_values(kind="stable")
    cells = [best(table, ranked), best(table, ranked, contact_methods(frames))]
    return [", ".join(f"`{scene}`" for scene in table.index) or DASH, *cells]


def named_regrets(frames: Frames, kind: str) -> pd.DataFrame:
    """Return compiled time over the least by named scene of a kind and method, at one error."""
    ranked = cost.standings(frames, "compiled")
    of_kind = ranked["scene"].map(lambda name: name in SCENES and SCENES[name].kind == kind)
    rows = ranked[of_kind & (ranked["error"] == ERROR)]
    return rows.pivot_table(index="scene", columns="method", values="ratio", sort=False)


@chapter("which")
def parts(frames: Frames) -> Iterator[Part | None]:
    if len(frames["times"]):
        yield saved_view(frames)
    yield systems_view(frames)
    if len(problems.usual(frames)):
        yield damping_map(frames)
        yield kinds_view(frames)
        yield hard_view(frames)
