"""Which method?  By kind of problem, damping, error and number of saved times, each table by a line of pandas."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from itertools import pairwise

import pandas as pd

from contactbench.measure.statistics import WIDEST
from contactbench.questions import cost, problems
from contactbench.questions.answers import evaluate, made_by
from contactbench.questions.contest import CONTACT, drawn, families, ranked
from contactbench.questions.judgement import CURVE
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


@lru_cache(256)
def regrets_of(frames: Frames, condition: str, error: float, of: str) -> pd.DataFrame:
    """Return the regrets on the random problems of the first seed that meet a condition."""
    rows = drawn(frames["population"], frames["problems"])
    return regrets(rows[rows["seed"] == problems.seeds(frames)[0]].query(condition), error, of)


def query(frames: Frames, condition: str, error: float = ERROR, of: str = "time_s") -> str:
    """Return the line of pandas that ranks the methods on such problems."""
    chosen = f"seed == {problems.seeds(frames)[0]} and {condition}"
    return f'mean_regrets(drawn(population, problems).query("{chosen}"), {error:g}, "{of}")'


def best(table: pd.DataFrame, order: pd.Series, allowed: set[str] | None = None) -> Cell:
    """Return the first of some methods, and its regret, median and 90 %."""
    first = next((m for m in order.index if allowed is None or m in allowed), None)
    if first is None:
        return Cell(DASH)
    return Cell(f"{first} {times(table[first].median())}, {times(table[first].quantile(0.9))}")


def contact_methods(frames: Frames) -> set[str]:
    return {method for method, family in families(frames["runs"]).items() if family == CONTACT}


def pair(frames: Frames, condition: str, error: float, of: str) -> tuple[int, list[Cell]]:
    """Return how many problems meet a condition, and the best of all methods and of the contact methods there."""
    table = regrets_of(frames, condition, error, of)
    order = evaluate(query(frames, condition, error, of), frames)
    return len(table), [best(table, order), best(table, order, contact_methods(frames))]


# -- by kind of problem ----------------------------------------------------------------------------
def kinds_view(frames: Frames) -> View:
    lines = []
    for label, condition in KINDS.items():
        for error in problems.errors(frames):
            found = [pair(frames, condition, error, each) for each in COSTS]
            lines.append([f"{label}, {power(error)}", found[0][0], *found[0][1], *found[1][1]])
    labels = [("", "problems, error"), ("", "how many")]
    labels += [(problems.LABELS[each], what) for each in COSTS for what in ("any", "a contact method")]
    return view("which_kinds", frame_of(lines, labels))


def damping_map(frames: Frames) -> Figure | None:
    """Return the map of the methods to take: damping over frequency along, error upwards."""
    panels = []
    for title, allowed in (("any method", None), ("contact methods", contact_methods(frames))):
        fields = []
        for low, high in pairwise(EDGES):
            for error in problems.errors(frames):
                condition = f"{POTENTIAL} and {low:g} < damping <= {high:g}"
                table = regrets_of(frames, condition, error, "time_s")
                if not len(table):
                    continue
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


#: how often each method ends right on each kind of hard problem
HARD = (
    """population.merge(problems.query("hard != ''")[["seed", "scene", "hard"]])"""
    f""".query("status == 'ok' and reached <= {problems.RIGHT:g}").groupby(["hard", "method"]).size()"""
)


# -- how many times are saved ----------------------------------------------------------------------
def saved_columns(frames: Frames) -> dict[str, tuple[int, bool]]:
    """Return the columns of the table, each a number of saved times, and whether it is of times or of evaluations."""
    found = [(int(saved), True) for saved in sorted(frames["times"]["saved"].unique())]
    found += [(saved, False) for saved in (1, CURVE) if (frames["runs"]["saved"] == saved).any()]
    return {saved_label(*column): column for column in found}


def near(saved: int, timed: bool) -> str:
    """Return the line of pandas that finds the leaders of a column, by scene."""
    given, most = ("runs, times", WIDEST) if timed else ("runs", 1)
    rows = f'ranked({given}, saved={saved}).query("error == {ERROR:g} and ratio <= {most:g}")'
    return f'{rows}.groupby("scene", sort=False).method.agg(list)'


def saved_view(frames: Frames) -> View:
    """Return who is within a quarter of the least time, and who needs the fewest evaluations, by saved times."""
    lines: dict[str, list[object]] = {}
    columns = saved_columns(frames)
    for number, (saved, timed) in enumerate(columns.values(), 1):
        found = ranked(frames["runs"], frames["times"] if timed else None, saved=saved)
        for scene, rows in found[found["error"] == ERROR].groupby("scene", sort=False):
            lines.setdefault(str(scene), [scene, *[DASH] * len(columns)])
            lines[str(scene)][number] = cost.leaders(rows, timed)
    compiled = [line for line in lines.values() if line[1] != DASH]
    return view("which_saved", frame_of(compiled, ["scene", *columns]), error=power(ERROR))


def saved_label(saved: int, timed: bool) -> str:
    label = "the end alone" if saved == 1 else f"{saved} times"
    return f"{label}: {'compiled time' if timed else 'evaluations'}"


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
    found = ranked(frames["runs"], frames["times"]).query(of_kind(kind))
    table = found.pivot_table(index="scene", columns="method", values="ratio", sort=False)
    order = evaluate(named_query(kind), frames)
    cells = [best(table, order), best(table, order, contact_methods(frames))]
    return [", ".join(f"`{scene}`" for scene in table.index) or DASH, *cells]


def of_kind(kind: str) -> str:
    """Return the condition that takes the named scenes of a kind."""
    return f"error == {ERROR:g} and scene in {[name for name, scene in SCENES.items() if scene.kind == kind]}"


def named_query(kind: str) -> str:
    """Return the line of pandas that ranks the methods on the named scenes of a kind."""
    rows = f'ranked(runs, times).query("{of_kind(kind)}")'
    return f'np.log({rows}.pivot_table("ratio", "scene", "method").dropna(axis=1)).mean().sort_values(kind="stable")'


def system_query(frames: Frames, condition: str = "", kind: str = "") -> str:
    return query(frames, condition) if condition else named_query(kind)


def with_lines(table: View, queries: Mapping[str, str]) -> Iterator[Part | None]:
    """Yield a table that has rows, and the lines that it is made by."""
    if table.rows:
        yield from (table, made_by(queries))


@chapter("which")
def parts(frames: Frames) -> Iterator[Part | None]:
    if len(frames["times"]):
        lines = {label: near(*column) for label, column in saved_columns(frames).items()}
        yield from with_lines(saved_view(frames), lines)
    random = len(problems.usual(frames)) > 0
    shown = {label: one for label, one in SYSTEMS.items() if random or "condition" not in one}
    lines = {label: system_query(frames, **one) for label, one in shown.items()}
    yield from with_lines(systems_view(frames), lines)
    if random:
        yield damping_map(frames)
        lines = {label: query(frames, condition) for label, condition in KINDS.items()}
        yield from with_lines(kinds_view(frames), lines)
        yield from with_lines(hard_view(frames), {"the number of right runs": HARD})
