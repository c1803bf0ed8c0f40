"""Cost at equal error, scene by scene."""

from __future__ import annotations

from collections.abc import Iterable
from statistics import median

import pandas as pd

from contactbench.measure.statistics import COVERED, process_spread
from contactbench.report.cells import Cell, Head, Mark, View, marks, number, word
from contactbench.report.contest import KINDS, LIMIT, Field, contestants, standing
from contactbench.report.contest_views import MARGINS, costs_view, duel_view
from contactbench.report.figures import work_precision as figures
from contactbench.report.numbers import count, duration, many, percent, scientific, times
from contactbench.report.raw import raw
from contactbench.report.rooms import ROOMS, Finding, Frames, Part, Room, Section, Text, once
from contactbench.results.tables import WORK_PRECISION

SOURCE = "work_precision.csv"
CHOSEN = "chosen"
ERROR = WORK_PRECISION.columns["solution_error"].meaning


def fields(frames: Frames) -> list[Field]:
    """The contests of every kind."""
    return [Field(frames["work_precision"], kind) for kind in KINDS]


def findings(frames: Frames) -> list[Finding]:
    found = []
    for field in once(fields, frames):
        if said := standing(field):
            found.append(Finding(f"cost_{field.kind.name}", f"{field.kind.title}, at equal error", *said))
    return found


def endings_view(work: pd.DataFrame) -> View | None:
    """The runs that did not end ok, on all scenes; one row per method and engines where it is unsupported."""
    part = contestants(work)
    part = part[part["status"] != "ok"]
    if not len(part):
        return None
    keys = ["scene", "method", "status", "message"]
    rows = []
    for (scene, method, status, message), runs in part.groupby(keys, sort=False, dropna=False):
        settings = "all" if status == "unsupported" else ", ".join(dict.fromkeys(runs["setting"]))
        engines = ", ".join(dict.fromkeys(runs["engine"]))
        rows.append(tuple(map(word, (scene, method, engines, settings, status, message))))
    heads = tuple(
        Head(label, words=True) for label in ("scene", "method", "engine", "setting", "status", "why")
    )
    kinds = ", ".join(f"{status} {n}" for status, n in part["status"].value_counts().items())
    meaning = f"{many(len(part), 'run')}: {kinds}."
    return View("endings", "Runs that did not end ok", meaning, heads, tuple(rows), SOURCE, detail=True)


def kernels_view(work: pd.DataFrame) -> View | None:
    """Time per gradient of compiled fixed-step methods beside the same arithmetic as a plain C loop."""
    ok = work[work["status"] == "ok"]
    own = contestants(ok)
    rows = []
    for _, loop in ok[ok["family"] == LIMIT].iterrows():
        same = own[
            (own["scene"] == loop["scene"]) & (own["method"] == loop["variant"])
            & (own["control"] == loop["control"]) & (own["value"] == loop["value"])
        ]  # fmt: skip
        for _, row in same[~same["engine"].isin(["python", "c+python"])].iterrows():
            c, mine = (1e9 * r["time_min_s"] / r["evaluations"] for r in (loop, row))
            rows.append((
                word(row["scene"]), word(row["method"]), word(row["engine"]), word(row["setting"]),
                number(loop["evaluations"], count), number(c, "{:.2f}".format), number(mine, "{:.2f}".format),
                number(mine / c, times),
            ))  # fmt: skip
    if not rows:
        return None
    heads = (
        *(Head(label, words=True) for label in ("scene", "method", "engine", "setting")), Head("gradients"),
        Head("C loop, ns"), Head("whole call, ns"), Head("ratio"),
    )  # fmt: skip
    meaning = (
        "Least round, nanoseconds per gradient, one thread. The whole call of a prepared solver, its dispatch "
        "included, beside the same arithmetic as a C loop, compiled by the machine's own compiler and called from "
        "Python. "
        "Short runs compare two calls, of one or two microseconds each, as well: only the long ones the arithmetic."
    )
    return View("kernels", "Compiled kernels beside a C loop", meaning, heads, tuple(rows), SOURCE)


def chosen_view(work: pd.DataFrame) -> View | None:
    """What a tolerance asked of a fixed-step method gives, pilots included."""
    part = work[(work["variant"] == CHOSEN) & (work["status"] == "ok")]
    rows = []
    for _, row in part.iterrows():
        ratio = row["solution_error"] / row["value"]
        mark = Mark.exception if ratio > 1 else None
        rows.append((
            word(row["scene"]), word(row["method"]), word(row["engine"]), number(row["value"],
            lambda v: scientific(v, 0)),
            number(row["solution_error"], scientific), Cell(times(ratio), ratio, marks(mark)),
            number(row["steps"], count),
            number(row["rhs_equivalents"], count), number(row["time_min_s"], duration),
        ))  # fmt: skip
    if not rows:
        return None
    heads = (
        *(Head(label, words=True) for label in ("scene", "method", "engine")), Head("rtol"), Head("error"),
        Head("error / rtol"), Head("steps"), Head("evaluations with pilots"), Head("time with pilots"),
    )  # fmt: skip
    meaning = (
        "The step is chosen from pilot runs for the tolerance asked for. Marked: less accurate than asked."
    )
    return View("chosen", "A step chosen from a tolerance", meaning, heads, tuple(rows), SOURCE)


def clock_text(work: pd.DataFrame, fields: Iterable[Field]) -> Text:
    """What the times are worth: how often a cell was visited, what processes differ by, the margins of the pairs."""
    visits = work["visits"].dropna()
    if not len(visits):
        return Text("No cell was visited twice in these tables: how well the times repeat is not known.")
    sample = work[work["time_process_ratio"].notna()]
    said = [
        f"Every timed cell is visited {visits.min():.0f} times or more, in shuffled order; its time is the least round."
    ]
    if len(sample):
        spread = process_spread(sample["time_process_ratio"], sample["time_halves_ratio"])
        said.append(
            f"A second process timed {len(sample)} of the cells: 95 % are within "
            f"{percent(spread)} of the first, but for those whose own halves differ."
        )
    for field in fields:
        if field.kind.timed and (known := field.margins):
            wide = known[min(len(known) - 1, int(COVERED * len(known)))]
            said.append(
                f"{field.kind.title}: half of the pairs of best methods have a margin of {percent(median(known))} or "
                f"less, 95 % of {percent(wide)}."
            )
    return Text(" ".join([*said, MARGINS]))


def scene_section(work: pd.DataFrame, scene: str, fields: Iterable[Field]) -> Section:
    parts: list[Part | None] = [figures.figure(work, scene)]
    for field in fields:
        if scene in field.scenes:
            parts.append(costs_view(field, scene, SOURCE))
        if scene in field.contested:
            parts.append(duel_view(field, scene, SOURCE))
    return Section(scene, tuple(part for part in parts if part is not None), choice="scene")


def sections(frames: Frames) -> list[Part]:
    work, contests = frames["work_precision"], once(fields, frames)
    parts: list[Part] = [
        Text(
            "Log–log interpolation between a method's own settings, without those that cost more for less accuracy. "
            f"The error is {ERROR}. Evaluations, times of "
            "compiled calls and times of solvers that call back into Python are three comparisons, never one."
        ),
        clock_text(work, contests),
        Text(
            "Which method is cheapest where, and where the contact methods lose, is in [README.md](README.md)."
        ),
        *(scene_section(work, str(scene), contests) for scene in dict.fromkeys(work["scene"])),
    ]
    parts += [
        view for view in (kernels_view(work), chosen_view(work), endings_view(work)) if view is not None
    ]
    return [*parts, raw(WORK_PRECISION, work)]


ROOMS.add(
    Room(
        "work_precision", "Cost at equal error", "time and evaluations at equal error, scene by scene",
        40, ("work_precision",), sections, findings, tab="Cost",
    )
)  # fmt: skip
