"""What structure buys: the energy left in a chaotic ring, its error, the damping rate one would read off, the cost."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from contactbench.measure.statistics import COUNTED, costs_to_reach, ties
from contactbench.questions.contest import CONTACT
from contactbench.report.chapters import Answer, Frames, Part, chapter, chart, view
from contactbench.report.curves import by_method, choose, floats, only
from contactbench.report.drawing import Axis, Curve, Figure, Panel, Span
from contactbench.report.numbers import duration, names, power, scientific, times
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of, matrix

#: how far the energy left may be off
ALLOWED = 0.01
#: the scene, and the damping and number of sites that all methods are run at
SCENE, GAMMA, SITES = "chaotic_ring", 1e-5, 16
#: kinds of cost: the question about the least one, the unit, and how it is written
COSTS = {
    "run_s": ("takes the least time", "", duration),
    "evaluations_per_time": ("needs the fewest evaluations", " per unit of time", "{:.2g}".format),
}
#: the family of methods that keep no contact structure
ESTABLISHED = "established"


def is_main(frame: pd.DataFrame) -> pd.Series:
    return (frame["scene"] == SCENE) & (frame["gamma"] == GAMMA) & (frame["n"] == SITES)


def main_rows(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the scene that all methods are run on; run_s : of the whole run, by its evaluations."""
    own = frame[is_main(frame)]
    timed = own.dropna(subset="time_min_s").set_index(["method", "setting"])
    each = (timed["time_min_s"] / timed["timed_evaluations"]).reindex(own[["method", "setting"]])
    return own.assign(run_s=np.array(floats(each)) * own["evaluations_per_time"] * own["t_end"])


def cost(rows: pd.DataFrame, column: str) -> float:
    """Return what the error allowed costs one method, between its settings; nan where none has it."""
    good = rows[rows["status"] == "ok"]
    return costs_to_reach(floats(good["energy_error"]), floats(good[column]), (ALLOWED,))[0]


def costs(rows: pd.DataFrame) -> pd.DataFrame:
    """Return evaluations and time by method and end, least time first; bound : the cheapest setting exceeds it."""
    found = [
        (m, end, own["family"].iloc[0], own["energy_error"].max() < ALLOWED, *(cost(own, c) for c in COSTS))
        for (m, end), own in rows.groupby(["method", "t_end"], sort=False)
    ]
    frame = pd.DataFrame(found, columns=["method", "t_end", "family", "bound", *COSTS])
    return frame.sort_values(["run_s", "evaluations_per_time"], kind="stable")


def answers(frames: Frames) -> Iterator[Answer]:
    runs = main_rows(frames["structure_buys"])
    found, starts = costs(runs), runs["starts"].max()
    found = found[found["t_end"] == found["t_end"].max()]
    for column, (asked, unit, show) in COSTS.items():
        rows = found.dropna(subset=column).sort_values(column, kind="stable")
        if not len(rows):
            continue
        least = float(rows[column].iloc[0])
        first = ties(rows[column], least, COUNTED)
        others = rows[(rows["family"] != CONTACT) & ~first]
        beside = ", ".join(f"{o['method']} {times(o[column] / least)}" for _, o in others.iterrows())
        after = f"T = {power(rows['t_end'].iloc[0])}, γ = {power(GAMMA)}"
        what = f"the energy left in a chaotic ring of {SITES} after {after}, within 1 % (median of {starts} starts)"
        count = "; ".join(filter(None, [show(least) + unit, beside]))
        yield Answer(f"Which {asked} to have {what}?", names(list(rows["method"][first]), 3), count)


def at_allowed(own: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of one setting: the cheapest of the longest run with the error allowed in the shortest."""
    spans = sorted(own["t_end"].unique())
    shared = own[own["t_end"] == spans[-1]]["setting"]
    good = own[(own["t_end"] == spans[0]) & (own["energy_error"] <= ALLOWED) & own["setting"].isin(shared)]
    chosen = good.sort_values("evaluations_per_time")["setting"].iloc[:1]
    return own[own["setting"].isin(chosen)].sort_values("t_end")


def costs_view(rows: pd.DataFrame) -> View:
    found, spans = costs(rows), sorted(rows["t_end"].unique())
    by_cell = {(row["method"], row["t_end"]): row for _, row in found.iterrows()}
    not_run = pd.Series({"bound": False} | dict.fromkeys(COSTS, math.nan))
    least = found.groupby("t_end")[[*COSTS]].min()
    lines = []
    for method in dict.fromkeys(found["method"]):
        line: list[object] = [method]
        for end in spans:
            own = by_cell.get((method, end), not_run)
            for column, (*_, show) in COSTS.items():
                mark = Mark.best if own[column] <= COUNTED * least.loc[end, column] else None
                cell = as_cell(own[column], show, mark)
                bound = own["bound"] and cell.value is not None
                line.append(replace(cell, text=f"≤ {cell.text}") if bound else cell)
            line.append(as_cell(own["run_s"] / least.loc[end, "run_s"], times))
        at = at_allowed(rows[rows["method"] == method])
        last = at[at["t_end"] == spans[-1]]
        interval = last[["energy_error_low", "energy_error_high"]]
        line += [at["setting"].iloc[0] if len(at) else None]
        line += [*(at[at["t_end"] == end]["energy_error"].max() for end in spans), last["rate_error"].max()]
        lines.append([*line, " to ".join(map(scientific, interval.iloc[0])) if len(last) else None])
    at_spans = [f"T = {power(end)}" for end in spans]
    heads = [(f"to 1 %, {at}", head) for at in at_spans for head in ("time", "evaluations", "ratio")]
    heads += [("one setting", "setting"), *(("its error", at) for at in at_spans)]
    heads += [(what, at_spans[-1]) for what in ("|γ_eff/γ − 1|", "its error, 95 % interval")]
    main = {"scene": SCENE, "sites": SITES, "gamma": power(GAMMA), "counted": COUNTED}
    return view("structure_costs", frame_of(lines, [("", "method"), *heads]), {"": scientific}, **main)


def others_view(frame: pd.DataFrame) -> View:
    """Return the evaluations at the other dampings, lengths and sizes, and with quadratic damping."""
    rest = frame[~is_main(frame)]
    case = [
        f"{'quadratic damping, ' if scene != SCENE else ''}γ = {power(g)}, T = {power(end)}, n = {n}"
        for scene, g, end, n in rest[["scene", "gamma", "t_end", "n"]].itertuples(index=False)
    ]

    def cell(own: pd.DataFrame) -> Cell:
        return as_cell(cost(own, "evaluations_per_time"), "{:.2g}".format)

    return view("structure_others", matrix(rest.assign(case=case), "method", "case", cell))


def reaching(curve: Curve, own: Sequence[Curve]) -> float:
    """Return how good a curve (x: cost, y: error) is at the error allowed."""
    return -math.log(value) if (value := costs_to_reach(curve.y, curve.x, (ALLOWED,))[0]) > 0 else math.nan


def figure(rows: pd.DataFrame) -> Figure | None:
    good = rows[(rows["status"] == "ok") & (rows["energy_error"] <= 1)].sort_values("evaluations_per_time")
    timed = good.dropna(subset="run_s")
    found, spans = costs(rows).dropna(), sorted(timed["t_end"].unique())
    found = found[found["t_end"] == max(spans, default=0.0)]
    ours, theirs = found[found["family"] == CONTACT], found[found["family"] == ESTABLISHED]
    if not len(ours) or not len(theirs):
        return None
    own, other = ours.iloc[0], theirs.iloc[0]
    drawn: list[str] = []
    panels, y = [], Axis("error of the energy left", "log")
    for end in spans:
        part = timed[timed["t_end"] == end]
        curves = by_method(part.assign(ms=1e3 * part["run_s"]), "ms", "energy_error")
        drawn = drawn or choose(curves, reaching, subjects=[own["method"], other["method"]])
        floor = Span(1e-6, float(part["floor"].max()), "chaos")
        panels.append(Panel(f"T = {power(end)}", Axis("time, ms", "log"), y, only(curves, drawn), (floor,)))
    grown = pd.concat([at_allowed(own) for m, own in rows.groupby("method", sort=False) if m in drawn])
    curves = only(by_method(grown, "t_end", "energy_error"), drawn)
    panels.append(Panel("one setting, with 1 % at first", Axis("T", "log"), y, curves))
    known = {"time": duration(own["run_s"]), "ratio": times(other["run_s"] / own["run_s"])}
    known |= {"method": own["method"], "other": other["method"], "end": power(spans[-1])}
    return chart("structure_buys", panels, across=3, sites=SITES, gamma=power(GAMMA), **known)


@chapter("structure_buys", answers)
def parts(frames: Frames) -> list[Part | None]:
    rows = main_rows(frames["structure_buys"])
    return [costs_view(rows), figure(rows), others_view(frames["structure_buys"])]
