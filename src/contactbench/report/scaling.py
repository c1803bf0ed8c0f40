"""Cost against the number of degrees of freedom: an evaluation at each of them, and the way to one error."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from contactbench.measure.statistics import PROCESSES, Verdict
from contactbench.report.chapters import Answer, Frames, Part, chapter, chart, view
from contactbench.report.curves import best_of_each, by_method, floats
from contactbench.report.drawing import Axis, Curve, Figure, Panel
from contactbench.report.numbers import count, duration, names, times
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of
from contactbench.results.contest import COMPILED, LIMIT, standings

#: the scene that every method is run on, and the size at which the way to the error is asked for
SCENE, SIZE = "fput", 1024
#: the slope is that from so many degrees of freedom on: below, a call and the ends of loops count
LARGE = 100
EACH, REACH = "site_ns", "reach_s"
ROW = ["scene", "method", "engine", "n", "cores"]
#: how much longer a curve counts over a cheaper one
FAR = 100.0
MARKS = {Verdict.win: Mark.best, Verdict.tie: Mark.tie}
AHEAD = (Verdict.win, Verdict.tie, Verdict.undecided)


def ranked(frame: pd.DataFrame, cost: str) -> pd.DataFrame:
    """Return the compiled rows of one core that compete by a column, with their standing at each size of a scene."""
    rows = frame[COMPILED.compares(frame) & frame[cost].notna() & (frame["cores"] == 1)]
    rows = rows[rows["family"] != LIMIT]
    rows = rows.assign(cost=rows[cost], halves=rows["time_halves_ratio"], processes=PROCESSES)
    return standings(rows, ("scene", "n"))


def slope(rows: pd.DataFrame) -> float:
    """Return the power of n by which the time of an evaluation grows, fitted from `LARGE` on; nan of one size."""
    own = rows[(rows["n"] >= LARGE) & rows[EACH].notna()]
    n, each = (np.log(np.array(floats(own[name]))) for name in ("n", EACH))
    return 1 + float(np.polyfit(n, each, 1)[0]) if len(set(n)) > 1 else np.nan


def lines(frame: pd.DataFrame) -> dict[tuple[str, ...], pd.DataFrame]:
    """Return the rows of each scene, method, engine and number of cores."""
    ways = ["scene", "method", "engine", "cores"]
    return {tuple(map(str, way)): own for way, own in frame.groupby(ways, sort=False)}  # type: ignore[arg-type]


def beside_loop(frame: pd.DataFrame, n: int, each: float) -> str:
    """Return the ratio to the C loop in words, "" without one."""
    loop = frame[(frame["family"] == LIMIT) & (frame["n"] == n) & (frame["cores"] == 1)][EACH].min()
    return f"{times(each / loop)} the C loop" if loop > 0 else ""


def answers(frames: Frames) -> Iterator[Answer]:
    frame = frames["scaling"]
    main = frame[frame["scene"] == SCENE]
    for cost, sizes in ((EACH, main["n"]), (REACH, main["n"][main["n"] <= SIZE])):
        rows = ranked(main, cost)
        rows = rows[rows["n"] == sizes.max()]
        first = rows[rows["verdict"].isin(AHEAD)]
        if not len(first):
            continue
        at = f"on `{SCENE}`, n = {count(sizes.max())}?"
        best, rest = first["cost"].min(), rows[~rows["verdict"].isin(AHEAD)]
        own = names([str(name) for name in first["method"]], 3)
        if cost == EACH:
            asked = f"Which method takes the least time per degree of freedom and evaluation {at}"
            beside = beside_loop(main, int(sizes.max()), float(best))
            yield Answer(asked, own, ", ".join(filter(None, [duration(1e-9 * best), beside])))
        else:
            then = [f"then {rest['method'].iloc[0]} {times(rest['ratio'].iloc[0])}"] if len(rest) else []
            yield Answer(f"Who is first at an error of 10⁻⁶ {at}", own, ", ".join([duration(best), *then]))
    slopes = [s for own in lines(main[main["cores"] == 1]).values() if (s := slope(own)) == s]
    if slopes:
        middle = f"as n to the power {np.median(slopes):.2f}"
        among = f"{len(slopes)} methods and engines, a C loop among them"
        between = f"{min(slopes):.2f} to {max(slopes):.2f}, {among}"
        yield Answer(f"How does the time of an evaluation grow on `{SCENE}`?", middle, between)


def costs_view(frame: pd.DataFrame) -> View:
    sizes = sorted(frame["n"][frame["scene"] == SCENE].unique())
    looks = {
        (cost, *row[:-1]): MARKS.get(row[-1])
        for cost in (EACH, REACH)
        for row in ranked(frame, cost)[[*ROW, "verdict"]].itertuples(index=False, name=None)
    }

    def cell(row: pd.Series, cost: str, unit: float = 1.0) -> Cell:
        return as_cell(unit * row[cost], duration, looks.get((cost, *row[ROW])))

    rows = []
    for (scene, method, engine, cores), own in lines(frame[frame[EACH].notna()]).items():
        by_size = {int(row["n"]): row for _, row in own.sort_values("n").iterrows()}
        each = {n: cell(row, EACH, 1e-9) for n, row in by_size.items()}
        other: list[object] = [f"{c.text}, n = {n}" for n, c in each.items() if n not in sizes]
        largest = by_size[max(by_size)]
        reach = cell(by_size[max(near)], REACH) if (near := [n for n in by_size if n <= SIZE]) else None
        more = (slope(own), reach, largest["compile_s"], largest["memory_MB"])
        at = [each.get(n) for n in sizes]
        rows.append((f"{method}, {engine}", scene, int(cores), *at, (other or [None])[0], *more))
    labels = [("", "method"), ("", "scene"), ("", "cores")]
    group = "an evaluation at a degree of freedom, n ="
    labels += [(group, size) for size in (*map(count, sizes), "another")]
    labels += [("", name) for name in ("power of n", "to 10⁻⁶", "compilation", "memory, MB")]
    show = {"power of n": "{:.2f}".format, "compilation": duration, "memory, MB": "{:.2g}".format}
    return view("scaling_costs", frame_of(rows, labels), show, large=LARGE, size=SIZE)


def at_the_largest(curve: Curve, own: Sequence[Curve]) -> float:
    """Score a curve by how far it goes, and of equals by what it costs there: as the title does."""
    return FAR * math.log10(curve.x[-1]) - math.log10(curve.y[-1])


def figure(frame: pd.DataFrame) -> Figure | None:
    rows = frame[(frame["scene"] == SCENE) & (frame["cores"] == 1) & frame[EACH].notna()]
    rows = rows[COMPILED.compares(rows)].sort_values(["n", EACH], kind="stable")
    loop, own = rows[rows["family"] == LIMIT], rows[rows["family"] != LIMIT]
    own = own.drop_duplicates(["n", "method"])  # the best engine of each
    if own["n"].nunique() < 2:
        return None
    n = int(own["n"].max())
    least = own[own["n"] == n].iloc[0]
    beside = beside_loop(frame[frame["scene"] == SCENE], n, float(least[EACH]))
    limit = [Curve(floats(loop["n"]), floats(loop[EACH]), "C loop", role="criterion")] if len(loop) else []
    curves = (*best_of_each(by_method(own, "n", EACH), at_the_largest), *limit)
    y = Axis("time per degree of freedom and evaluation, ns", "log")
    panel = Panel("", Axis("degrees of freedom n", "log"), y, curves)
    beside = f", {beside}" if beside else ""
    who = {"method": least["method"], "each": least[EACH], "beside": beside}
    return chart("scaling", [panel], scene=SCENE, n=count(n), **who)


@chapter("scaling", answers)
def parts(frames: Frames) -> list[Part | None]:
    return [costs_view(frames["scaling"]), figure(frames["scaling"])]
