"""The chaotic ring: the energy left after a long time of weak damping, its error, and what it costs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import pandas as pd

from contactbench.measure.statistics import WIDEST, costs_to_reach
from contactbench.questions.answers import evaluate
from contactbench.questions.contest import ALLOWED, CONTACT, families, ring_costs, ring_runs, with_family
from contactbench.report.chapters import Answer, Frames, Part, chapter, chart, view
from contactbench.report.curves import by_method, choose, only
from contactbench.report.drawing import Axis, Curve, Figure, Panel
from contactbench.report.numbers import duration, names, power, scientific, times
from contactbench.report.views import Mark, View, as_cell, frame_of, matrix

FEW = "{:.2g}".format
#: so many others are named beside the least
BESIDE = 2
#: the families of the methods that keep no structure
THEIRS = ("established",)
#: the kinds of cost: the question about the least one, the unit, how it is written, and the factor up to which two tie
COSTS = {
    "run_s": ("takes the least time", "", duration, WIDEST),
    "evaluations": ("needs the fewest evaluations", " per unit of time", FEW, 1.0),
}


def main_rows(frames: Frames) -> pd.DataFrame:
    """Return the runs at the damping that has the most of them: all methods are run there."""
    rows = ring_runs(frames["ring"], frames["times"])
    most = rows["gamma"].mode()
    return with_family(rows[rows["gamma"].isin(most.head(1))], frames["runs"])


def answers(frames: Frames) -> Iterator[Answer]:
    rows = main_rows(frames)
    gamma, end = float(rows["gamma"].max()), float(rows["t_end"].max())
    known = families(frames["runs"])
    for column, (asked, unit, show, within) in COSTS.items():
        query = f"ring_costs(ring, times, '{column}').loc[{gamma!r}, {end!r}].dropna().sort_values()"
        if not len(ring_costs(frames["ring"], frames["times"], column).dropna()):
            continue
        found = evaluate(query, frames)
        ratio = found / found.iloc[0]
        others = [m for m in found.index[ratio > within] if known.get(m) != CONTACT]
        beside = names([f"{method} {times(ratio[method])}" for method in others], BESIDE)
        where = f"to {100 * ALLOWED:g} % after T = {power(end)}, γ = {power(gamma)} (median over the starts)"
        text = "; best non-contact methods: ".join(filter(None, [show(found.iloc[0]) + unit, beside]))
        question = f"Which method {asked} to get the energy left in a chaotic ring right {where}?"
        yield Answer(question, names(list(found.index[ratio <= within]), 3), text, (query,))


def at_allowed(own: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of one setting: the cheapest of the longest run with the error allowed in the shortest."""
    spans = sorted(own["t_end"].unique())
    shared = own[own["t_end"] == spans[-1]]["setting"]
    good = own[(own["t_end"] == spans[0]) & (own["energy_error"] <= ALLOWED) & own["setting"].isin(shared)]
    chosen = good.sort_values("evaluations")["setting"].iloc[:1]
    return own[own["setting"].isin(chosen)].sort_values("t_end")


def costs(frames: Frames, gamma: float) -> pd.DataFrame:
    """Return both costs by span and method, at one damping; least time in the longest run first."""
    both = {column: ring_costs(frames["ring"], frames["times"], column) for column in COSTS}
    return pd.DataFrame(both).loc[gamma].sort_values(["t_end", *COSTS], ascending=[False, True, True])


def costs_view(frames: Frames, rows: pd.DataFrame) -> View:
    gamma, spans = rows["gamma"].max(), sorted(rows["t_end"].unique())
    found = costs(frames, gamma)
    least = found.groupby("t_end").min()
    lines = []
    for method in dict.fromkeys(found.index.get_level_values("method")):
        own = rows[rows["method"] == method]
        line: list[object] = [method]
        for end in spans:
            here = found.reindex([(end, method)]).iloc[0]
            worst = own[(own["t_end"] == end) & (own["status"] == "ok")]["energy_error"].max()
            for column, (_, _, show, within) in COSTS.items():
                cell = as_cell(here[column], show)
                mark = Mark.best if here[column] <= within * least.loc[end, column] else None
                bound = "≤ " if worst < ALLOWED and cell.value is not None else ""
                line.append(replace(cell, text=bound + cell.text, mark=mark))
            line.append(as_cell(here["run_s"] / least.loc[end, "run_s"], times))
        at = at_allowed(own)
        last = at[at["t_end"] == spans[-1]]
        line.append(f"{at['control'].iloc[0]}={at['setting'].iloc[0]:.4g}" if len(at) else None)
        line += [*(at[at["t_end"] == end]["energy_error"].max() for end in spans), last["rate_error"].max()]
        interval = last[["low", "high"]]
        lines.append([*line, " to ".join(map(scientific, interval.iloc[0])) if len(last) else None])
    at_spans = [f"T = {power(end)}" for end in spans]
    heads = [(f"to 1 %, {at}", head) for at in at_spans for head in ("time", "evaluations", "ratio")]
    heads += [("one setting", "setting"), *(("its error", at) for at in at_spans)]
    heads += [(what, at_spans[-1]) for what in ("|γ_eff/γ − 1|", "its error, 95 % interval")]
    return view("ring_costs", frame_of(lines, [("", "method"), *heads]), {"": scientific}, gamma=power(gamma))


def others_view(frames: Frames, gamma: float) -> View:
    """Return the evaluations at the other dampings."""
    found = ring_costs(frames["ring"], frames["times"], "evaluations").drop(gamma).reset_index(name="least")
    case = [
        f"γ = {power(g)}, T = {power(end)}" for g, end in zip(found["gamma"], found["t_end"], strict=True)
    ]
    table = matrix(found.assign(case=case), "method", "case", lambda own: as_cell(own["least"].iloc[0], FEW))
    return view("ring_others", table)


def reaching(curve: Curve, own: Sequence[Curve]) -> float:
    """Return how good a curve (x: cost, y: error) is at the error allowed."""
    return -math.log(value) if (value := costs_to_reach(curve.y, curve.x, (ALLOWED,))[0]) > 0 else math.nan


def figure(frames: Frames, rows: pd.DataFrame) -> Figure | None:
    good = rows[(rows["status"] == "ok") & (rows["energy_error"] <= 1)].sort_values("evaluations")
    timed = good.dropna(subset="run_s")
    found, spans = costs(frames, rows["gamma"].max()).dropna(), sorted(timed["t_end"].unique())
    if not spans or spans[-1] not in found.index:
        return None
    seconds, known = found.loc[spans[-1]]["run_s"], families(frames["runs"])
    sides = [seconds[[known.get(m) in some for m in seconds.index]] for some in ((CONTACT,), THEIRS)]
    if not all(map(len, sides)):
        return None
    (own, first), (other, second) = (next(iter(side.items())) for side in sides)
    drawn: list[str] = []
    panels, y = [], Axis("error of the energy left", "log")
    for end in spans:
        part = timed[timed["t_end"] == end]
        curves = by_method(part.assign(ms=1e3 * part["run_s"]), "ms", "energy_error")
        drawn = drawn or choose(curves, reaching, [str(own), str(other)])
        panels.append(Panel(f"T = {power(end)}", Axis("time, ms", "log"), y, only(curves, drawn)))
    grown = pd.concat([at_allowed(own) for m, own in rows.groupby("method", sort=False) if m in drawn])
    panels.append(
        Panel(
            f"setting with 1 % at T = {power(spans[0])}",
            Axis("T", "log"),
            y,
            only(by_method(grown, "t_end", "energy_error"), drawn),
        )
    )
    named = {"method": own, "other": other, "time": duration(first), "ratio": times(second / first)}
    more = {"gamma": power(rows["gamma"].max()), "end": power(spans[-1])}
    return chart("ring", panels, across=3, **named, **more)


@chapter("ring", answers)
def parts(frames: Frames) -> list[Part | None]:
    rows = main_rows(frames)
    return [costs_view(frames, rows), figure(frames, rows), others_view(frames, rows["gamma"].max())]
