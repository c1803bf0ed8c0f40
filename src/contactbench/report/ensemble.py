"""Ensembles: throughput beside C loops, at equal error, with the number of trajectories and of cores."""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd

from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part, summary
from contactbench.report.figures import ensemble as figures
from contactbench.report.numbers import count, duration, names, power, times
from contactbench.report.views import View, matrix, pick
from contactbench.report.work_precision import LEGEND, cost_cell, error_label
from contactbench.results.contest import COMPILED, LIMIT, MARGINAL, Kind, costs, standings

SOURCE = "ensemble.csv"
#: how the trajectories of a run share their work; the column `variant`
SHAPES = {
    "vmap": "every trajectory has its own steps",
    "shared": "the trajectories of a tile share their steps",
    "batch": "a vector register of trajectories, each with its own steps",
    "loop": "one trajectory after the other in compiled code",
    "passes": "every flow a loop over all trajectories",
    "plain": "drift and kick in one loop",
    "tiled": "all steps of some trajectories before the next",
}
#: time of a whole call per trajectory
WHOLE_CALLS = replace(COMPILED, cost="each")


def with_rates(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the rows that ended ok, with the time of a trajectory and of one evaluation of it."""
    ok = frame[frame["status"] == "ok"]
    ok = ok.assign(trajectories=ok["trajectories"].astype(float), evaluations=ok["evaluations"].astype(float))
    ok = ok.assign(each=ok["time_min_s"] / ok["trajectories"])
    return ok.assign(stage=ok["each"] / ok["evaluations"], rate=1 / ok["each"])


def beside_loops(frame: pd.DataFrame) -> tuple[list[str], pd.DataFrame]:
    """Return the shapes of the C loops, and every method with the time per gradient of each loop of its step in a
    column, nan where there is no such loop."""
    frame = frame[frame["question"] == "arithmetic"]
    loops, own = frame[frame["family"] == LIMIT], frame[frame["family"] != LIMIT].reset_index(drop=True)
    kernels = loops["variant"].str.split(" ", n=1, expand=True).reindex(columns=[0, 1])
    stages = dict(zip(zip(kernels[0], loops["value"], kernels[1], strict=True), loops["stage"], strict=True))
    shapes = [str(shape) for shape in dict.fromkeys(kernels[1])]
    for shape in shapes:
        keys = zip(own["method"], own["value"], strict=True)
        own[shape] = [stages.get((*key, shape), math.nan) for key in keys]
    return shapes, own


def standing(frame: pd.DataFrame, kind: Kind, keys: tuple[str, ...]) -> pd.DataFrame:
    """Return the standings of one cost at equal error."""
    part = frame[(frame["question"] == "error") & (frame["family"] != LIMIT)]
    return standings(costs(part, kind, keys), ("error",))


def answers(frames: Frames) -> pd.DataFrame:
    frame, lines = with_rates(frames["ensemble"]), []
    calls = standing(frame, WHOLE_CALLS, ("method", "variant"))
    for error, own in calls[calls["verdict"].isin(["win", "tie", "undecided"])].groupby("error", sort=False):
        question = f"Who takes the least time per trajectory, error {power(error)}?"
        lines.append((question, names(list(dict.fromkeys(own["method"])), 3), duration(own["cost"].min())))
    return summary(*lines)


# -- views -----------------------------------------------------------------------------------------
def arithmetic_view(frame: pd.DataFrame) -> View:
    """Return every method beside each shape of the C loop of the same method, same step."""
    shapes, own = beside_loops(frame)
    labels = {"method": "method", "engine": "engine", "setting": "setting", "stage": "per gradient"}
    table = pick(own, labels | {shape: f"C loop, {shape}" for shape in shapes})
    table = table.assign(**{f"ratio to {shape}": own["stage"] / own[shape] for shape in shapes})
    show = {"": duration} | {f"ratio to {shape}": times for shape in shapes}
    meant = "; ".join(f"`{shape}`: {SHAPES[shape]}" for shape in shapes if shape in SHAPES)
    legend = f"Time per gradient and trajectory, least round, one core, the same steps. {meant}."
    return View("ensemble_arithmetic", "The same arithmetic as C loops", table, legend, SOURCE, show)


def error_view(frame: pd.DataFrame, kind: Kind, name: str, title: str, legend: str) -> View:
    """Return the time per trajectory at equal error on one core, one row for each way to run a method."""
    found = standing(frame, kind, ("method", "engine", "variant"))
    way = found["method"] + ", " + found["engine"] + found["variant"].map(lambda v: f", {v}" if v else "")
    found = found.assign(way=way).sort_values(["way", "error"], ascending=[True, False])
    return View(
        name, title, matrix(found, "way", "error", cost_cell, error_label), f"{legend} {LEGEND}", SOURCE
    )


def growth_view(frame: pd.DataFrame, question: str, by: str, title: str) -> View:
    """Return throughput against the number of something, and relative to the smallest number."""
    ways = ["method", "engine", "setting"]
    part = frame[frame["question"] == question].sort_values([*ways, by], kind="stable")
    first = part.groupby(ways)["rate"].transform("first")
    table = pick(part, {name: name for name in (*ways, by)} | {"rate": "trajectories/s"})
    table = table.assign(**{"gradients/s": 1 / part["stage"], "relative": part["rate"] / first})
    show = {by: count, "relative": times, "": "{:.3g}".format}
    return View(f"ensemble_{question}", title, table, "Of the whole call, least round.", SOURCE, show)


def parts(frames: Frames) -> list[Part]:
    frame, every = with_rates(frames["ensemble"]), frames["ensemble"]
    called = "Time of a whole call per trajectory, one core."
    more = "Time of one more trajectory, one core: from calls with a quarter of them and all."
    bad = every[every["status"] != "ok"][["method", "engine", "setting", "status", "message"]]
    views = (
        error_view(frame, WHOLE_CALLS, "ensemble_error", "A trajectory at equal error", called),
        error_view(frame, MARGINAL, "ensemble_marginal", "One more trajectory at equal error", more),
        arithmetic_view(frame),
        growth_view(frame, "size", "trajectories", "With the number of trajectories"),
        growth_view(frame, "cores", "cores", "With the number of cores"),
        View("ensemble_endings", "Runs that did not end ok", bad, "", SOURCE),
    )
    drawn = figures.figure(frame)
    return [*(view for view in views if len(view.frame)), *([drawn] if drawn else [])]


TITLE, QUESTION = "Ensembles", "How fast are many trajectories at once?"
CHAPTERS.add(Chapter("ensemble", TITLE, QUESTION, 60, ("ensemble",), parts, answers))
