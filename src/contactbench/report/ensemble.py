"""Ensembles: throughput beside C loops, at equal error, with the number of trajectories and of cores."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pandas as pd

from contactbench.report.chapters import Answer, Frames, Part, chapter, chart, view
from contactbench.report.curves import best_of_each, by_method, cheapest, contest_end
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.report.numbers import count, duration, names, power, times
from contactbench.report.views import View, grid, pick
from contactbench.report.work_precision import ERROR, LEGEND, cost_cell, error_label
from contactbench.results.contest import COMPILED, CONTACT, LIMIT, MARGINAL, Kind, cost_rows, costs, standings

#: time of a whole call per trajectory
WHOLE_CALLS = replace(COMPILED, cost="each")


def with_rates(frame: pd.DataFrame) -> pd.DataFrame:
    ok = frame[frame["status"] == "ok"]
    ok = ok.assign(trajectories=ok["trajectories"].astype(float), evaluations=ok["evaluations"].astype(float))
    ok = ok.assign(each=ok["time_min_s"] / ok["trajectories"])
    return ok.assign(stage=ok["each"] / ok["evaluations"], rate=1 / ok["each"])


def beside_loops(frame: pd.DataFrame) -> tuple[list[str], pd.DataFrame]:
    """Return the shapes of the C loops, and every method with the time per gradient of each of them, nan without."""
    frame = frame[frame["question"] == "arithmetic"]
    loops, own = frame[frame["family"] == LIMIT], frame[frame["family"] != LIMIT]
    loops = loops.assign(**loops["variant"].str.extract(r"(?P<method>\S+) (?P<shape>.+)"))
    stages = loops.pivot_table("stage", ["method", "value"], "shape", aggfunc="first", sort=False)
    return list(map(str, stages.columns)), own.join(stages, ["method", "value"])


def standing(frame: pd.DataFrame, kind: Kind, keys: tuple[str, ...]) -> pd.DataFrame:
    part = frame[(frame["question"] == "error") & (frame["family"] != LIMIT)]
    return standings(costs(part, kind, keys), ("error",))


def answers(frames: Frames) -> Iterator[Answer]:
    calls = standing(with_rates(frames["ensemble"]), WHOLE_CALLS, ("method", "variant"))
    for error, own in calls[calls["verdict"].isin(["win", "tie", "undecided"])].groupby("error", sort=False):
        question = f"Who takes the least time per trajectory, error {power(error)}?"
        yield Answer(question, names(list(own["method"].unique()), 3), duration(own["cost"].min()))


def arithmetic_view(frame: pd.DataFrame) -> View:
    shapes, own = beside_loops(frame)
    loops = {shape: f"C loop, {shape}" for shape in shapes}
    table = pick(own, "method", "engine", "setting", stage="per gradient", **loops)
    table = table.assign(**{f"ratio to {shape}": own["stage"] / own[shape] for shape in shapes})
    show = {"": duration} | {f"ratio to {shape}": times for shape in shapes}
    return view("ensemble_arithmetic", table, show)


def error_view(frame: pd.DataFrame, kind: Kind, name: str) -> View:
    found = standing(frame, kind, ("method", "engine", "variant"))
    way = found["method"] + ", " + found["engine"] + found["variant"].map(lambda v: f", {v}" if v else "")
    found = found.assign(way=way).sort_values(["way", "error"], ascending=[True, False])
    cells = {
        (way, row.error): cost_cell(row) for way, row in zip(found["way"], cost_rows(found), strict=True)
    }
    table = grid("way", cells, error_label)
    return view(name, table, legend=LEGEND)


def figure(frame: pd.DataFrame) -> Figure | None:
    rows = frame[(frame["family"] != LIMIT) & (frame["question"] == "error")]
    if not len(rows):
        return None
    curves = [
        replace(curve, label=", ".join(filter(None, [curve.label, str(variant)])))
        for (_, _, variant), own in rows.groupby(["method", "engine", "variant"], sort=False, dropna=False)
        for curve in by_method(own, "solution_error", "each", 1e6)
    ]
    y = contest_end(Axis("time per trajectory, µs", "log"), curves, 100.0)
    panel = Panel("", ERROR, y, best_of_each(curves, cheapest))
    fine = rows[rows["solution_error"] < 1e-6]
    least = 1e6 * fine.groupby(fine["family"] == CONTACT)["each"].min()
    fast = ""
    if len(least) == 2:
        fast = f", errors below 10⁻⁶: {least[True]:.2g} µs each by a contact method, {least[False]:.2g} µs by another"
    return chart("ensemble", [panel], count=count(float(rows["trajectories"].max())), fast=fast)


@chapter("ensemble", answers)
def parts(frames: Frames) -> list[Part | None]:
    frame = with_rates(frames["ensemble"])
    return [
        error_view(frame, WHOLE_CALLS, "ensemble_error"),
        error_view(frame, MARGINAL, "ensemble_marginal"),
        arithmetic_view(frame),
        figure(frame),
    ]
