"""What structure buys: the energy left in a chaotic ring, its error, the damping rate one would read off, the cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from contactbench.measure.statistics import costs_to_reach
from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part, summary
from contactbench.report.curves import best_of_each, by_method, floats
from contactbench.report.drawing import Axis, Curve, Figure, Panel, Span
from contactbench.report.numbers import duration, names, power, scientific, times
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of, matrix
from contactbench.results.contest import CONTACT

SOURCE = "structure_buys.csv"
#: how far the energy left may be off
ALLOWED = 0.01
#: the scene, and the damping and number of sites that all methods are run at
SCENE, GAMMA, SITES = "chaotic_ring", 1e-5, 16
#: the family of methods that keep no structure
ESTABLISHED = "established"
#: what a time is known to, between cells of one run
CLOSE = 1.05


def main_rows(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the scene that all methods are run on; run_s : of the whole run, by its evaluations."""
    own = frame[(frame["scene"] == SCENE) & (frame["gamma"] == GAMMA) & (frame["n"] == SITES)]
    each = own.dropna(subset="evaluation_ns").set_index(["method", "setting"])["evaluation_ns"]
    ways = pd.MultiIndex.from_frame(own[["method", "setting"]])
    run_s = 1e-9 * np.array(floats(each.reindex(ways))) * own["evaluations_per_time"] * own["t_end"]
    return own.assign(run_s=run_s)


def cost(rows: pd.DataFrame, column: str) -> float:
    """Return what the error allowed costs one method, between its settings; nan where none has it."""
    good = rows[rows["status"] == "ok"]
    return costs_to_reach(floats(good["energy_error"]), floats(good[column]), (ALLOWED,))[0]


def is_bound(rows: pd.DataFrame) -> bool:
    """Return whether the cheapest setting that ends well is more accurate than asked for."""
    good = rows[rows["status"] == "ok"].sort_values("evaluations_per_time", kind="stable")
    return bool(len(good)) and bool(good["energy_error"].iloc[0] < ALLOWED)


def costs(rows: pd.DataFrame) -> pd.DataFrame:
    """Return evaluations per unit of time and the time of a run by method and end, the least time first."""
    found = [
        (m, end, own["family"].iloc[0], cost(own, "evaluations_per_time"), cost(own, "run_s"))
        for (m, end), own in rows.groupby(["method", "t_end"], sort=False)
    ]
    frame = pd.DataFrame(found, columns=["method", "t_end", "family", "evaluations", "time"])
    return frame.sort_values(["time", "evaluations"], kind="stable")


def answers(frames: Frames) -> pd.DataFrame:
    rows = main_rows(frames["structure_buys"])
    lines = []
    for column in ("time", "evaluations"):
        found = costs(rows).dropna(subset=column)
        found = found[found["t_end"] == found["t_end"].max()].sort_values(column, kind="stable")
        if not len(found):
            continue
        least = found.iloc[0]
        first = [str(m) for m in found["method"][found[column] <= CLOSE * least[column]]]
        others = found[(found["family"] != CONTACT) & ~found["method"].isin(first)]
        beside = ", ".join(f"{o['method']} {times(o[column] / least[column])}" for _, o in others.iterrows())
        what = {"time": "takes the least time", "evaluations": "needs the fewest evaluations"}[column]
        question = f"Which {what} to have the energy left in {where(rows, least['t_end'])} within 1 %?"
        size = duration(least[column]) if column == "time" else f"{least[column]:.2g} per unit of time"
        lines.append((question, names(first, 3), f"{size}; {beside}" if beside else size))
    return summary(*lines)


def where(rows: pd.DataFrame, end: float) -> str:
    return f"a chaotic ring of {SITES} after T = {power(end)}, γ = {power(GAMMA)},"


def at_allowed(own: pd.DataFrame) -> pd.Series | None:
    """Return the cheapest setting with the error allowed in the shortest run that a longer one repeats."""
    spans = sorted(own["t_end"].unique())
    repeated = own[own["t_end"] == spans[-1]]["setting"] if len(spans) > 1 else own["setting"]
    good = own[(own["t_end"] == spans[0]) & (own["energy_error"] <= ALLOWED) & own["setting"].isin(repeated)]
    return good.sort_values("evaluations_per_time").iloc[0] if len(good) else None


def costs_view(rows: pd.DataFrame) -> View:
    found, lines = costs(rows), []
    spans = sorted(rows["t_end"].unique())
    least = {
        (end, c): found[found["t_end"] == end][c].min() for end in spans for c in ("evaluations", "time")
    }
    show = {"evaluations": "{:.2g}".format, "time": duration}

    def cell(method: str, end: float, column: str) -> Cell:
        value = found[(found["method"] == method) & (found["t_end"] == end)][column]
        number = float(value.iloc[0]) if len(value) else math.nan
        best = number <= CLOSE * least[end, column]
        shown = as_cell(number, show[column], Mark.best if best else None)
        bound = is_bound(rows[(rows["method"] == method) & (rows["t_end"] == end)])
        return replace(shown, text=f"≤ {shown.text}") if bound and shown.value is not None else shown

    for method in dict.fromkeys(found["method"]):
        own = rows[rows["method"] == method]
        line: list[object] = [method]
        for end in spans:
            time = cell(method, end, "time")
            line += [cell(method, end, "evaluations"), time]
            line.append(as_cell((time.value or math.nan) / least[end, "time"], times))
        chosen = at_allowed(own)
        at = own[own["setting"] == chosen["setting"]] if chosen is not None else own.iloc[:0]
        line.append(chosen["setting"] if chosen is not None else None)
        for column in ("energy_error", "rate_error"):
            line += [at[at["t_end"] == end][column].max() for end in spans]
        lines.append(line)
    heads = [
        (f"to {ALLOWED:.0%}, T = {power(e)}", h) for e in spans for h in ("evaluations", "time", "ratio")
    ]
    heads += [("one setting at both lengths", "setting")]
    heads += [(what, f"T = {power(e)}") for what in ("its error", "|γ_eff/γ − 1|") for e in spans]
    legend = (
        f"{SCENE}, n = {SITES}, γ = {power(GAMMA)}. Evaluations per unit of time, time of the whole run, its ratio "
        "to the least. Setting: the cheapest with 1 % in the shorter run. γ_eff: from the energy left. Bold: "
        "the least, to 5 %. Every method in the shape that it is faster in. ≤: at the cheapest setting. "
        "—: not reached, or not run. "
        "[Why](../docs/mathematics.md#what-keeping-the-structure-buys)."
    )
    numbers = {"": scientific}
    return View(
        "structure_costs",
        "The least that has the energy right",
        frame_of(lines, [("", "method"), *heads]),
        legend,
        SOURCE,
        numbers,
    )


def others_view(frame: pd.DataFrame) -> View:
    """Return the evaluations at the other dampings, lengths and sizes, and with quadratic damping."""
    main = (frame["scene"] == SCENE) & (frame["gamma"] == GAMMA) & (frame["n"] == SITES)
    rest = frame[~main]
    case = [
        f"{'quadratic damping, ' if scene != SCENE else ''}γ = {power(g)}, T = {power(end)}, n = {n}"
        for scene, g, end, n in rest[["scene", "gamma", "t_end", "n"]].itertuples(index=False)
    ]
    made = matrix(
        rest.assign(case=case),
        "method",
        "case",
        lambda r: as_cell(cost(r, "evaluations_per_time"), "{:.2g}".format),
    )
    legend = "Evaluations per unit of time that the energy left within 1 % takes. —: not reached."
    return View("structure_others", "Other dampings and sizes", made, legend, SOURCE)


# -- the figure ------------------------------------------------------------------------------------
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
    title = (
        f"The energy left after T = {power(spans[-1])} within 1 %: {own['method']} takes {duration(own['time'])}, "
        f"{other['method']}, the best that keeps no structure, {times(other['time'] / own['time'])} that"
    )
    panels = []
    for end in spans:
        part = timed[timed["t_end"] == end]
        curves = best_of_each(by_method(part.assign(ms=1e3 * part["run_s"]), "ms", "energy_error"), reaching)
        floor = Span(1e-6, float(part["floor"].max()), "chaos")
        y = Axis("error of the energy left", "log")
        panels.append(Panel(f"T = {power(end)}", Axis("time, ms", "log"), y, curves, (floor,)))
    names_ = {c.method for panel in panels for c in panel.curves if not c.muted}
    grown = [
        rows[(rows["method"] == m) & (rows["setting"] == chosen["setting"])].sort_values("t_end")
        for m in found["method"]
        if m in names_ and (chosen := at_allowed(rows[rows["method"] == m])) is not None
    ]
    if grown:
        curves = by_method(pd.concat(grown), "t_end", "energy_error")
        at = "at the cheapest setting with 1 % at first"
        panels.append(Panel(at, Axis("T", "log"), Axis("error of the energy left", "log"), curves))
    caption = (
        f"A ring of {SITES} with quartic bonds, chaotic, γ = {power(GAMMA)}. In colour the best of each family at 1 %. "
        "Shaded: what chaos leaves undecided."
    )
    return Figure("structure_buys", title, tuple(panels), caption, across=3)


def parts(frames: Frames) -> list[Part | None]:
    frame = frames["structure_buys"]
    rows = main_rows(frame)
    return [costs_view(rows), figure(rows), others_view(frame)]


TITLE, QUESTION = (
    "What structure buys",
    "What does keeping the contact structure buy on a long chaotic motion?",
)
CHAPTERS.add(Chapter("structure_buys", TITLE, QUESTION, 57, ("structure_buys",), parts, answers))
