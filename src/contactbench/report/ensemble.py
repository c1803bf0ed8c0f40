"""Ensembles: throughput beside C loops, at equal error, with the number of trajectories and of cores."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pandas as pd

from contactbench.measure.statistics import Verdict, margin, verdict
from contactbench.report.cells import Cell, Head, Mark, View, marks, number, word
from contactbench.report.contest import COMPILED, LIMIT, MARGINAL, TARGETS, Kind, Lead, costs, within
from contactbench.report.contest_views import CHEAPEST, DASHES, MARGINS, error_heads
from contactbench.report.figures import ensemble as figures
from contactbench.report.numbers import count, duration, many, names, percent, power, times
from contactbench.report.raw import raw
from contactbench.report.rooms import ROOMS, Finding, Frames, Part, Room, Section, Text
from contactbench.results.tables import ENSEMBLE_TABLE

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
WHOLE_CALLS, MORE = replace(COMPILED, cost="each"), MARGINAL


def timed(frame: pd.DataFrame) -> pd.DataFrame:
    """The rows that ended ok, with the time of a trajectory and of one evaluation of it."""
    ok = frame[frame["status"] == "ok"]
    ok = ok.assign(trajectories=ok["trajectories"].astype(float), evaluations=ok["evaluations"].astype(float))
    ok = ok.assign(each=ok["time_min_s"] / ok["trajectories"])
    return ok.assign(stage=ok["each"] / ok["evaluations"], rate=1 / ok["each"])


def asked(frame: pd.DataFrame, question: str) -> pd.DataFrame:
    return frame[frame["question"] == question]


def beside_loops(frame: pd.DataFrame) -> tuple[list[str], pd.DataFrame]:
    """The shapes of the C loops, and every method with the time per gradient of each loop of its step in a column.

    Least rounds; nan where there is no such loop.
    """
    frame = asked(frame, "arithmetic")
    frame = frame.assign(stage=frame["time_min_s"] / frame["trajectories"] / frame["evaluations"])
    loops = frame[frame["family"] == LIMIT]
    kernels = loops["variant"].str.partition(" ")
    shapes = list(dict.fromkeys(kernels[2])) if len(loops) else []
    own = frame[frame["family"] != LIMIT].reset_index(drop=True)
    for shape in shapes:
        keys = zip(kernels[0], loops["value"], kernels[2], strict=True)
        stage = {
            (method, value): s
            for (method, value, kind), s in zip(keys, loops["stage"], strict=True)
            if kind == shape
        }
        own[shape] = [stage.get(key, math.nan) for key in zip(own["method"], own["value"], strict=True)]
    return shapes, own


def arithmetic_view(frame: pd.DataFrame) -> View | None:
    """Every method beside each shape of the C loop of the same method, same step."""
    shapes, found = beside_loops(frame)
    rows = []
    for _, own in found.iterrows():
        cells = [
            *(word(own[name]) for name in ("method", "engine", "setting")),
            number(own["stage"], duration),
        ]
        for shape in shapes:
            cells += [number(own[shape], duration), number(own["stage"] / own[shape], times)]
        rows.append(tuple(cells))
    if not rows:
        return None
    heads = [*(Head(label, words=True) for label in ("method", "engine", "setting")), Head("per gradient")]
    for shape in shapes:
        heads += [
            Head("time", SHAPES.get(shape, ""), group=f"C loop, {shape}"),
            Head("ratio", group=f"C loop, {shape}"),
        ]
    spoken = "; ".join(f"`{shape}`: {SHAPES[shape]}" for shape in shapes if shape in SHAPES)
    meaning = (
        f"Least round on one core, time per gradient and trajectory, the same steps. {spoken}. A "
        "ratio below one: faster "
        "than the loop."
    )
    return View(
        "ensemble_arithmetic", "The same arithmetic as C loops", meaning, tuple(heads), tuple(rows), SOURCE
    )


def error_view(frame: pd.DataFrame, marginal: bool = False) -> View | None:
    """Time per trajectory at equal error on one core, one row for each way to run a method.

    marginal : of one more trajectory, without what every call takes.
    """
    part = asked(frame, "error")
    kind = MORE if marginal else WHOLE_CALLS
    part = part[part[kind.halves].notna()] if kind.resolved else part
    if not len(part) or part[kind.cost].isna().all():
        return None
    keys = ["method", "engine", "variant"]
    found = {
        key: costs(rows, kind.cost, TARGETS, kind.halves) for key, rows in part.groupby(keys, sort=False)
    }
    leads = leaders(part, kind, keys)
    lines = []
    for key, own in found.items():
        cells = []
        for target, cost in zip(TARGETS, own, strict=True):
            first = leads[target].first if target in leads else []
            mark = (Mark.best if len(first) == 1 else Mark.tie) if " ".join(key).strip() in first else None
            cells.append(Cell(cost.text(duration), cost.value if cost.reached else None, marks(mark)))
        lines.append((*map(word, key), *cells))
    heads = (*(Head(label, words=True) for label in ("method", "engine", "shape")), *error_heads())
    spoken = "; ".join(f"`{v}`: {SHAPES[v]}" for v in dict.fromkeys(part["variant"]) if v in SHAPES)
    timed = "Time per trajectory"
    if marginal:
        timed = (
            "What one more trajectory takes, from calls with a quarter of them and all; a time that either half of the "
            "visits finds no larger than 0 takes no part"
        )
    meaning = f"{timed}, on one core. {spoken}. {MARGINS} {CHEAPEST} {DASHES}"
    name, title = "ensemble_error", "A trajectory at equal error"
    if marginal:
        name, title = "ensemble_marginal", "One more trajectory at equal error"
    return View(name, title, meaning, heads, tuple(lines), SOURCE)


def falls(line: pd.DataFrame, by: str, processes: float) -> str:
    """Where throughput falls although the number of something grows, and whether that is more than the margin."""
    said = []
    for (_, a), (_, b) in pairwise(line.iterrows()):
        if b["rate"] < a["rate"]:
            most = margin((a["time_halves_ratio"], b["time_halves_ratio"]), processes)
            noisy = "more than" if verdict(a["rate"] / b["rate"], most) is Verdict.loss else "within"
            known = f" of {percent(most)}" if math.isfinite(most) else ""
            said.append(
                f"from {count(a[by])} to {count(b[by])} {by} it falls to {times(b['rate'] / a['rate'])}, {noisy} the "
                f"margin{known}"
            )
    return "; ".join(said)


def growth_view(frame: pd.DataFrame, question: str, by: str, title: str) -> View | None:
    """Throughput against the number of something, and relative to the smallest number."""
    part = asked(frame, question).sort_values(by, kind="stable")
    processes, fallen = WHOLE_CALLS.process_spread(frame), []
    rows = []
    for (method, engine, setting), line in part.groupby(["method", "engine", "setting"], sort=False):
        fallen += [f"{method}: {said}" for said in [falls(line, by, processes)] if said]
        for _, row in line.iterrows():
            rows.append((
                word(method), word(engine), word(setting), number(row[by], count), number(row["rate"], "{:.3g}".format),
                number(1 / row["stage"], "{:.3g}".format), number(row["rate"] / line["rate"].iloc[0], times),
            ))  # fmt: skip
    if not rows:
        return None
    heads = (
        *(Head(label, words=True) for label in ("method", "engine", "setting")), Head(by), Head("trajectories/s"),
        Head("gradients/s"), Head("relative", f"to the smallest number of {by}"),
    )  # fmt: skip
    meaning = "Throughput of the whole call (least round)."
    if fallen:
        meaning += f" {'. '.join(fallen)}."
    return View(f"ensemble_{question}", title, meaning, heads, tuple(rows), SOURCE)


def leaders(part: pd.DataFrame, kind: Kind, keys: list[str]) -> dict[float, Lead]:
    """Who is cheapest at each error that somebody reaches, of what `keys` tell apart."""
    found = {
        " ".join(key).strip(): costs(
            rows, kind.cost, TARGETS, kind.halves, kind.process_spread(part, rows["engine"].iloc[0])
        )
        for key, rows in part.groupby(keys, sort=False)
    }
    leads = {}
    for i, target in enumerate(TARGETS):
        reached = sorted((own[i].value, name) for name, own in found.items() if own[i].reached)
        if reached:
            known = {name: found[name][i] for _, name in reached}
            leads[target] = Lead(known, {}, {})
    return leads


def told(leads: dict[float, Lead]) -> str:
    """The cheapest at each error, what it costs, and how much of that is fixed where it was measured."""
    said = []
    for target, lead in leads.items():
        least = lead.costs[lead.first[0]]
        shares = [f"{100 * lead.costs[m].share:.0f} %" for m in lead.first if lead.costs[m].share >= 0]
        fixed = f" ({names(shares)} fixed)" if len(shares) == len(lead.first) else ""
        alike = f"{within(*lead.alike)}: " if len(lead.first) > 1 else ""
        said.append(
            f"{power(target)} {alike}{names(lead.first)} {'≤ ' if least.bound else ''}{duration(least.value)}{fixed}"
        )
    return "; ".join(said)


def limit_finding(frame: pd.DataFrame) -> list[Finding]:
    """The fastest engine of each method beside the C loops of the same steps, and what more cores bring."""
    shapes, found = beside_loops(frame)
    said = []
    for method, rows in found.groupby("method", sort=False):
        own = rows.loc[rows["stage"].idxmin()]
        ratios = [f"{times(own['stage'] / own[s])} ({s})" for s in shapes if own[s] > 0]
        if ratios:
            said.append(f"{method} ({own['engine']}) {duration(own['stage'])}, {names(ratios)}")
    if not said:
        return []
    sentence = (
        f"Time per gradient and trajectory, and its ratio to C loops of the same steps: {'; '.join(said)}."
    )
    for (method, engine, _), line in asked(frame, "cores").groupby(
        ["method", "engine", "setting"], sort=False
    ):
        line = line.sort_values("cores", kind="stable")
        first, last = line.iloc[0], line.iloc[-1]
        if last["cores"] > first["cores"]:
            sentence += (
                f" On {last['cores']:.0f} cores {method} ({engine}) has {times(last['rate'] / first['rate'])} the "
                f"throughput of {first['cores']:.0f}."
            )
    processes = WHOLE_CALLS.process_spread(frame)
    covers = (
        f"beside C: one core, least round; from {times(1 / processes)} to {times(processes)} no more than two "
        "processes differ by, below that less time than C took in this run"
    )
    return [Finding("ensemble_limit", "Ensembles beside C loops", sentence, covers)]


def findings(frames: Frames) -> list[Finding]:
    frame = timed(frames["ensemble"])
    return [*error_finding(frame), *limit_finding(frame)]


def error_finding(frame: pd.DataFrame) -> list[Finding]:
    """Who takes the least time per trajectory at equal error."""
    part = asked(frame, "error")
    part = part[(part["family"] != LIMIT) & COMPILED.engines(part["engine"])]
    if not len(part):
        return []
    ways = ["method", "variant"]
    calls, many_of = leaders(part, WHOLE_CALLS, ways), count(part["trajectories"].max())
    if not calls:
        return []
    sentence = f"Least time per trajectory at equal error, whole calls of {many_of}: {told(calls)}."
    more = leaders(part[part[MORE.halves].notna()], MORE, ways)
    if more and {e: set(lead.first) for e, lead in more.items()} != {
        e: set(lead.first) for e, lead in calls.items()
    }:
        sentence += f" One more trajectory, without what every call takes: {told(more)}."
    covers = f"{many(part['method'].nunique(), 'method')}, one core, {many_of} trajectories"
    fewest = part.groupby("method", sort=False)["trajectories"].max()
    if len(fewer := fewest[fewest < part["trajectories"].max()]):
        covers += f", of {names(fewer.index)} {count(fewer.max())}"
    if " fixed)" in sentence:
        covers += "; fixed: whatever their number, at the cheapest setting that reaches the error"
    return [Finding("ensembles", "Ensembles", sentence, covers)]


def sections(frames: Frames) -> list[Part]:
    frame = timed(frames["ensemble"])
    views = (
        arithmetic_view(frame),
        error_view(frame),
        error_view(frame, marginal=True),
        growth_view(frame, "size", "trajectories", "With the number of trajectories"),
        growth_view(frame, "cores", "cores", "With the number of cores"),
    )
    drawn = figures.figure(frame)
    bad = frames["ensemble"][frames["ensemble"]["status"] != "ok"]
    ends = tuple(f"{r['method']}, {r['setting']}: {r['status']}, {r['message']}" for _, r in bad.iterrows())
    return [
        Text(
            "Many trajectories of a scene at once. Times are of the whole call, from initial to "
            "final states on the host."
        ),
        *(view for view in views if view is not None),
        *([drawn] if drawn else []),
        *([Section("Runs that did not end ok", (Text(items=ends),))] if ends else []),
        raw(ENSEMBLE_TABLE, frames["ensemble"]),
    ]


ROOMS.add(
    Room(
        "ensemble",
        "Ensembles",
        "throughput of many trajectories at once",
        60,
        ("ensemble",),
        sections,
        findings,
    )
)
