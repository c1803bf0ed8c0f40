"""Ensembles: throughput beside C loops, at equal error, with the number of trajectories and of cores."""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd

from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part, summary
from contactbench.report.figures import ensemble as figures
from contactbench.report.numbers import DASH, count, duration, names, power, times
from contactbench.report.views import Cell, View, frame_of
from contactbench.report.work_precision import LEGEND, cost_cell, errors
from contactbench.results.contest import COMPILED, LIMIT, MARGINAL, TARGETS, Kind, costs, standings

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
#: times per trajectory: of a whole call, and of one more
WHOLE_CALLS, ONE_MORE = replace(COMPILED, cost="each"), MARGINAL


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
    frame = with_rates(frames["ensemble"])
    lines = []
    calls = standing(frame, WHOLE_CALLS, ("method", "variant"))
    first = calls[calls["verdict"].isin(["win", "tie", "undecided"])]
    if len(first):
        best = [
            f"{power(e)} {names(list(dict.fromkeys(own['method'])), 2)}"
            for e, own in first.groupby("error", sort=False)
        ]
        least = "; ".join(
            f"{power(e)} {duration(own['cost'].min())}" for e, own in first.groupby("error", sort=False)
        )
        lines.append(("Who takes the least time per trajectory at equal error?", "; ".join(best), least))
    shapes, own = beside_loops(frame)
    if len(own) and shapes:
        ratios = (own["stage"] / own[shapes].min(axis=1)).groupby(own["method"]).min().dropna()
        if len(ratios):
            text = f"{times(ratios.min())} to {times(ratios.max())} of the fastest loop"
            lines.append(("How near to a C loop of the same steps?", text, f"{len(ratios)} methods"))
    return summary(*lines)


# -- views -----------------------------------------------------------------------------------------
def arithmetic_view(frame: pd.DataFrame) -> View | None:
    """Return every method beside each shape of the C loop of the same method, same step."""
    shapes, own = beside_loops(frame)
    if not len(own):
        return None
    table = own[["method", "engine", "setting", "stage", *shapes]]
    for shape in shapes:
        table = table.assign(**{f"ratio to {shape}": own["stage"] / own[shape]})
    table = table.rename(columns={"stage": "per gradient"} | {shape: f"C loop, {shape}" for shape in shapes})
    show = {"": duration} | {f"ratio to {shape}": times for shape in shapes}
    legend = f"Time per gradient and trajectory, least round, one core, the same steps. {shapes_of(shapes)}"
    return View("ensemble_arithmetic", "The same arithmetic as C loops", table, legend, SOURCE, show)


def shapes_of(variants: list[str]) -> str:
    """Return the meanings of some shapes."""
    return "; ".join(f"`{v}`: {SHAPES[v]}" for v in variants if v in SHAPES) + "."


def error_view(frame: pd.DataFrame, kind: Kind, name: str, title: str, legend: str) -> View | None:
    """Return the time per trajectory at equal error on one core, one row for each way to run a method."""
    keys = ("method", "engine", "variant")
    found = standing(frame, kind, keys)
    if not found["cost"].notna().any():
        return None
    by_key: dict[tuple[str, ...], dict[float, Cell]] = {}
    for row in found.itertuples():
        by_key.setdefault((row.method, row.engine, row.variant), {})[row.error] = cost_cell(row, duration)
    rows = [(*key, *(cells.get(t, Cell(DASH)) for t in TARGETS)) for key, cells in by_key.items()]
    frame = frame_of(sorted(rows, key=lambda row: row[:3]), ["method", "engine", "shape", *errors()])
    return View(name, title, frame, f"{legend} {LEGEND}", SOURCE)


def growth_view(frame: pd.DataFrame, question: str, by: str, title: str) -> View | None:
    """Return throughput against the number of something, and relative to the smallest number."""
    part = frame[frame["question"] == question].sort_values(
        ["method", "engine", "setting", by], kind="stable"
    )
    if not len(part):
        return None
    first = part.groupby(["method", "engine", "setting"])["rate"].transform("first")
    table = part[["method", "engine", "setting", by, "rate"]].assign(
        g=1 / part["stage"], r=part["rate"] / first
    )
    table.columns = pd.Index(["method", "engine", "setting", by, "trajectories/s", "gradients/s", "relative"])
    show = {by: count, "relative": times, "": "{:.3g}".format}
    return View(f"ensemble_{question}", title, table, "Of the whole call, least round.", SOURCE, show)


def bad_view(frame: pd.DataFrame) -> View | None:
    """Return the runs that did not end ok."""
    bad = frame[frame["status"] != "ok"][["method", "engine", "setting", "status", "message"]]
    return View("ensemble_endings", "Runs that did not end ok", bad, "", SOURCE) if len(bad) else None


def parts(frames: Frames) -> list[Part]:
    frame = with_rates(frames["ensemble"])
    called = "Time of a whole call per trajectory, one core."
    more = "Time of one more trajectory, one core: from calls with a quarter of them and all."
    views = (
        error_view(frame, WHOLE_CALLS, "ensemble_error", "A trajectory at equal error", called),
        error_view(frame, ONE_MORE, "ensemble_marginal", "One more trajectory at equal error", more),
        arithmetic_view(frame),
        growth_view(frame, "size", "trajectories", "With the number of trajectories"),
        growth_view(frame, "cores", "cores", "With the number of cores"),
        bad_view(frames["ensemble"]),
    )
    drawn = figures.figure(frame)
    return [*(view for view in views if view is not None), *([drawn] if drawn else [])]


CHAPTERS.add(
    Chapter(
        "ensemble",
        "Ensembles",
        "How fast are many trajectories at once?",
        60,
        ("ensemble",),
        parts,
        answers,
    )
)
