"""Hard scenes: how every method ends, and at what error and cost."""

from __future__ import annotations

import numpy as np
import pandas as pd

from contactbench.report.cells import DASH, Cell, Head, Mark, View, marks, number, word
from contactbench.report.contest import (
    EVALUATIONS,
    Field,
    standing,
)
from contactbench.report.figures import stability as figures
from contactbench.report.kept import (
    bounded,
    called,
    drift_cell,
    laws,
    numbers,
)
from contactbench.report.numbers import (
    count,
    names,
    scientific,
)
from contactbench.report.raw import raw
from contactbench.report.rooms import ROOMS, Finding, Frames, Part, Room, Section, Text
from contactbench.results.schema import Rule
from contactbench.results.tables import (
    STABILITY,
)

#: above this condition number the round-off of a solution is more than round-off
WELL_CONDITIONED = 1e3
RUNGS = ("coarse", "medium", "fine")


def rungs(frame: pd.DataFrame) -> list[str]:
    """Names for the settings of a ladder, coarse to fine."""
    most = int(frame.groupby(["scene", "method", "engine"]).size().max()) if len(frame) else 0
    return list(RUNGS) if most == len(RUNGS) else [f"setting {i + 1}" for i in range(most)]


def ending(row: pd.Series, digits: int = 0) -> Cell:
    """The error of a run, or how it ended; where the true motion reaches infinity, diverging is right."""
    if row["status"] == "ok":
        return number(row["solution_error"], lambda e: scientific(e, digits), hint=str(row["setting"]))
    right = row["status"] == "diverged" and not pd.isna(row["blow_up_time"])
    mark = Mark.right if right else Mark.none if row["status"] == "unsupported" else Mark.bad
    return Cell(str(row["status"]), marks=marks(mark), hint=f"{row['setting']}: {row['message']}")


def map_view(frame: pd.DataFrame) -> View:
    """Every run at a glance: methods × scenes, each with its ladder of settings."""
    scenes, steps = list(dict.fromkeys(frame["scene"])), rungs(frame)
    rows = []
    for method, mine in frame.groupby("method", sort=False):
        cells = [word(method)]
        for scene in scenes:
            runs = [ending(r) for _, r in mine[mine["scene"] == scene].iterrows()]
            cells += [*runs, *(Cell(DASH) for _ in range(len(steps) - len(runs)))]
        rows.append(tuple(cells))
    heads = (Head("method", words=True), *(Head(rung, group=scene) for scene in scenes for rung in steps))
    meaning = "Solution error at each setting of the ladder, coarse to fine, or how the run ended."
    return View(
        "how_it_ends", "How it ends", meaning, heads, tuple(rows), "stability.csv", detail=True, map=True
    )


def scene_view(frame: pd.DataFrame, scene: str) -> View:
    """One hard scene: the ladder of errors, the worst of each law, the cost of the finest run."""
    part, steps = bounded(frame[frame["scene"] == scene]), rungs(frame)
    ok = part[part["status"] == "ok"]
    shown = [law for law in laws(STABILITY, "stability") if law != "solution_error" and ok[law].notna().any()]
    rows = []
    for method, mine in part.groupby("method", sort=False):
        good = mine[mine["status"] == "ok"]
        runs = [ending(r) for _, r in mine.iterrows()]
        cells = [word(method), *runs, *(Cell(DASH) for _ in range(len(steps) - len(runs)))]
        for law in shown:
            values = good[good[law].notna()]
            cells.append(drift_cell(values.loc[values[law].idxmax()], law) if len(values) else Cell(DASH))
        cells.append(number(good["rhs_equivalents"].max() if len(good) else None, count))
        whys = dict.fromkeys(m for m in mine[mine["status"] != "ok"]["message"] if m)
        cells.append(word(shortened("; ".join(whys))))
        rows.append(tuple(cells))
    labels = (Head(called(law), STABILITY.columns[law].meaning, group="worst") for law in shown)
    heads = (
        Head("method", words=True), *(Head(rung, group="solution error") for rung in steps), *labels,
        Head("evaluations", "of the finest run that ended ok"), Head("why not ok", words=True),
    )  # fmt: skip
    return View(f"hard_{scene}", scene, condition_note(part), heads, tuple(rows), "stability.csv")


def shortened(text: str, most: int = 90) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"


def condition_note(part: pd.DataFrame) -> str:
    condition = numbers(part, "condition_number").max()
    if not condition > WELL_CONDITIONED:
        return ""
    return (
        f"Condition number {scientific(condition)}: round-off alone makes an error of about "
        f"{scientific(condition * np.finfo(float).eps)}."
    )


def blow_up_view(frame: pd.DataFrame) -> View | None:
    """When a run is said to have diverged against the true time of blow-up: one line per method."""
    part = frame[frame["blow_up_time"].notna() & (frame["status"] != "unsupported")]
    if not len(part):
        return None
    rows = []
    for method, mine in part.groupby("method", sort=False):
        off = mine["end_time"] / mine["blow_up_time"] - 1
        worst, finest = off.loc[off.abs().idxmax()], off.iloc[-1]
        told = Mark.right if set(mine["status"]) == {"diverged"} else Mark.bad
        rows.append((
            word(method), word(", ".join(dict.fromkeys(mine["status"])), told),
            number(100 * finest, "{:+.3f} %".format), number(100 * worst, "{:+.3f} %".format),
        ))  # fmt: skip
    heads = (
        Head("method", words=True), Head("status", "over all settings", words=True),
        Head("off at the finest", "time told at the finest setting, relative to the true time of blow-up"),
        Head("off at worst", "the same at the setting where it is furthest off"),
    )  # fmt: skip
    scene, time = part["scene"].iloc[0], part["blow_up_time"].iloc[0]
    meaning = f"The motion of `{scene}` reaches infinity at t = {time:.10g}."
    return View("blow_up", "Blow-up", meaning, heads, tuple(rows), "stability.csv")


def findings(frames: Frames) -> list[Finding]:
    hard = frames["stability"]
    found = []
    tried = hard[hard["status"] != "unsupported"]
    if len(tried):
        right = np.where(tried["blow_up_time"].isna(), tried["status"] == "ok", tried["status"] == "diverged")
        bad = tried[~right]
        clean = [m for m in dict.fromkeys(tried["method"]) if m not in set(bad["method"])]
        most = bad.groupby("method", sort=False).size().sort_values(ascending=False, kind="stable")
        sentence = (
            f"{len(tried) - len(bad)} of {len(tried)} runs end as the true motion does, however accurate."
        )
        sentence += (
            f" Without another ending, on the scenes they take: {names(clean)}."
            if clean
            else " No method is without another ending."
        )
        if len(most):
            sentence += f" Most other endings: {names([f'{m} {n}' for m, n in most[:3].items()])}"
            kinds = bad["status"].value_counts()
            sentence += (
                f"; by kind {names([f'{kind} {n}' for kind, n in kinds.items()])} (budget: our own limit)."
            )
        found.append(
            Finding(
                "endings",
                "Hard scenes",
                sentence,
                f"{tried['method'].nunique()} methods on {tried['scene'].nunique()} scenes",
            )
        )
    if said := standing(Field(hard, EVALUATIONS)):
        found.append(Finding("hard_cost", "Evaluations on the hard scenes", *said))
    return found


def sections(frames: Frames) -> list[Part]:
    hard = frames["stability"]
    meanings = tuple(
        f"{called(name)}: {c.meaning}" + (" (a law that is kept or not)" if c.rule is Rule.structure else "")
        for name, c in laws(STABILITY, "stability").items()
    )
    drawn, ends = figures.hard(hard), blow_up_view(hard)
    parts: list[Part] = [
        Text(
            "Every method on every hard scene at a ladder of settings, coarse to fine. Runs are isolated and limited "
            "in steps and evaluations; how each ended is part of the result. Which method is cheapest where is in "
            "[README.md](README.md)."
        ),
        *([drawn] if drawn else []),
        *([ends] if ends else []),
        map_view(hard),
    ]
    scenes = tuple(
        Section(scene, (scene_view(hard, scene),), choice="scene") for scene in dict.fromkeys(hard["scene"])
    )
    parts.append(Section("Scene by scene", (Text(items=meanings), *scenes)))
    return [*parts, raw(STABILITY, hard)]


ROOMS.add(
    Room(
        "stability", "Numerical stability on hard scenes", "how every method ends on the hard scenes, at what error",
        50, ("stability",), sections, findings,
    )
)  # fmt: skip
