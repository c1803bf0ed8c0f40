"""A comparison to read: the sentences, tables and figure of one frame, for terminal, page and plot alike."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from contactbench.measure.laws import LAWS
from contactbench.measure.statistics import PROCESSES, WIDEST, Verdict
from contactbench.report.cells import DASH, Cell, Head, Mark, View, marks, word
from contactbench.report.contest import within
from contactbench.report.curves import by_method, number_axis
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.report.figures.best import best_of_each, cheapest
from contactbench.report.numbers import count, duration, names, percent, scientific, times
from contactbench.report.page import Said, page
from contactbench.report.rooms import Part, Room, Text

TITLES = {"compiled": "Compiled", "callbacks": "Calling back into Python"}
#: of those that tie, so many are named
NAMED = 4
ALIKE = {str(each): each for each in (Verdict.tie, Verdict.undecided)}


def sentences(frame: pd.DataFrame) -> Iterator[str]:
    """Who is cheapest at each error, how the reference is known, what was not compared and why."""
    for kind, part in frame[frame["verdict"] != ""].groupby("kind", sort=False):
        for error, rows in part.groupby("error_asked", sort=False):
            first = rows[rows["verdict"].isin(["win", *ALIKE])].sort_values("time_s")
            said = (
                f"{within(ALIKE[first['verdict'].iloc[0]], first['margin'].max())}: "
                if len(first) > 1
                else ""
            )
            yield (
                f"{TITLES[str(kind)]}, error {error:g}: {said}{names(list(first['method']), NAMED)}, "
                f"{duration(first['time_s'].min())}."
            )
    reference = frame.attrs["reference"]
    second = reference["confirmed"]
    checked = (
        "two precisions of one engine agree"
        if second is None
        else f"{second} of them confirmed by a second engine"
    )
    yield (
        f"Reference: {reference['source']}, {reference['digits']} digits, {checked}; errors below "
        f"{reference['error']:.1e} are not claimed."
    )
    yield (
        "Times are least rounds. Two within their margin tie: what the halves of their visits differ by here, and two "
        f"processes elsewhere ({percent(PROCESSES)}); within a margin wider than {percent(WIDEST)} they are undecided."
    )
    yield from cuts(frame)
    if unrefined := frame.attrs["unrefined"]:
        yield f"No time was left to look for a cheaper setting of {', '.join(unrefined)}."
    unknown = [
        method
        for method, rows in frame[frame["status"] == "ok"].groupby("method", sort=False)
        if not measured(rows).any()
    ]
    if unknown:
        yield f"No time was left to measure the laws of {', '.join(unknown)}."
    if frame.attrs["interrupted"]:
        yield "Interrupted: this is what there was."


def cuts(frame: pd.DataFrame) -> Iterator[str]:
    """Which methods have no time at which errors, and why; those with one and the same reason together."""
    missing = frame[frame["reason"] != ""]
    said: dict[tuple[str, str, str], list[str]] = {}
    for (method, status, reason), rows in missing.groupby(["method", "status", "reason"], sort=False):
        everywhere = len(rows) == frame["error_asked"].nunique()
        at = "" if everywhere else f" at {names([f'{error:g}' for error in rows['error_asked']])}"
        said.setdefault((at, "not timed" if status == "ok" else str(status), str(reason)), []).append(
            str(method)
        )
    for (at, status, reason), methods in said.items():
        yield f"{names(methods)}{at}: {status}: {reason}."


def cell(row: Any) -> Cell:
    """The time at one error and how it compares; or why there is none."""
    if row.status != "ok":
        return word(row.status)
    if math.isnan(row.time_s):
        return Cell("not timed")
    mark = Mark.best if row.verdict == "win" else Mark.tie if row.verdict in ALIKE else None
    hint = f"{row.setting}, error {row.error_reached:.1e}, {count(row.evaluations)} evaluations"
    beside = {"win": "cheapest", "loss": times(row.ratio)}.get(row.verdict, row.verdict)
    return Cell(f"{duration(row.time_s)} {beside}", row.time_s, marks(mark), hint=hint)


def kept_by(rows: pd.DataFrame) -> str:
    """The laws kept at every setting at which they were measured, and those that there was no time for."""
    done = rows[measured(rows)]
    if done.empty:
        return "not measured"
    kept, unknown = [], []
    for law in (LAWS[name] for name in rows.columns if name in LAWS):
        label, known = law.label or law.name, done.loc[done[law.name].notna(), "laws_kept"]
        if known.empty and law.differentiates:
            unknown.append(label)
        elif len(known) and all(label in text.split(", ") for text in known):
            kept.append(label)
    if unknown:
        return f"{', '.join(kept)}{'; ' if kept else ''}not measured: {', '.join(unknown)}"
    return ", ".join(kept) or "none"


def measured(rows: pd.DataFrame) -> pd.Series:
    """Rows where some law was."""
    laws = rows.columns[rows.columns.get_loc("reason") + 1 : -1]
    return rows[list(laws)].notna().any(axis=1)


def view(frame: pd.DataFrame, kind: str) -> View:
    """A row for each method, a column for each error."""
    errors = list(dict.fromkeys(frame["error_asked"]))
    rows = []
    for method, part in frame[frame["kind"] == kind].groupby("method", sort=False):
        if (part["status"] == "unsupported").all():
            continue
        cells = [cell(row) for row in part.itertuples()]
        work = [
            Cell(DASH) if math.isnan(value) else Cell(count(value), value) for value in part["evaluations"]
        ]
        rows.append((word(method), *cells, *work, word(kept_by(part))))
    heads = (
        Head("method", words=True),
        *(Head(f"{error:g}", group="time at error") for error in errors),
        *(Head(f"{error:g}", group="evaluations at error") for error in errors),
        Head("laws kept to round-off", words=True),
    )
    meaning = (
        "Least time of a bare call at the coarsest setting found to reach the error; ×: over the cheapest."
    )
    return View(f"race_{kind}", TITLES[kind], meaning, heads, tuple(rows))


def views(frame: pd.DataFrame) -> list[View]:
    found = [view(frame, kind) for kind in TITLES if (frame["kind"] == kind).any()]
    return [each for each in [*found, settings(frame)] if each.rows]


def settings(frame: pd.DataFrame) -> View:
    """At which setting each method reaches each error, and the error it has there."""
    rows = []
    for method, part in frame[frame["status"] == "ok"].groupby("method", sort=False):
        reached = {
            row.error_asked: f"{row.setting}, {scientific(row.error_reached)}" for row in part.itertuples()
        }
        rows.append(
            (word(str(method)), *(word(reached.get(error, DASH)) for error in frame["error_asked"].unique()))
        )
    heads = (Head("method", words=True), *(Head(f"{e:g}") for e in frame["error_asked"].unique()))
    meaning = "The setting of each time above, and the error reached with it."
    return View("race_settings", "Setting, and error reached", meaning, heads, tuple(rows))


#: an axis of costs ends at so many times the least cost of the smallest error: what is dearer is no contest
CONTEST = 300.0


def ending(label: str, errors: pd.Series, costs: pd.Series) -> Axis:
    """An axis of costs that ends where the contest does."""
    most = CONTEST * float(costs[errors <= errors.min() * 1e3].min())
    return replace(number_axis(label), within=(None, most))


def figure(frame: pd.DataFrame) -> Figure | None:
    """Error against cost: times of what was timed, evaluations of every setting tried."""
    tried = pd.DataFrame(frame.attrs["runs"])
    panels = []
    for kind, title in TITLES.items():
        timed = frame[(frame["kind"] == kind) & frame["time_s"].notna()]
        part = front(timed, "error_reached", "time_s")
        if len(part):
            curves = by_method(part, "error_reached", "time_s", scale=1e3)
            best = best_of_each(curves, cheapest)
            cost = ending("time per solve, ms", part["error_reached"], 1e3 * part["time_s"])
            panels.append(Panel(title, number_axis("error", True), cost, best))
    if len(tried) and (tried["status"] == "ok").any():
        ok = tried[(tried["status"] == "ok") & tried["evaluations"].notna()].copy()
        ok["error"] = np.maximum(ok["error"], frame.attrs["reference"]["error"])
        curves = by_method(front(ok, "error", "evaluations"), "error", "evaluations")
        cost = ending("evaluations", ok["error"], ok["evaluations"])
        panels.append(Panel("Evaluations", number_axis("error", True), cost, best_of_each(curves, cheapest)))
    if not panels:
        return None
    scene = frame["scene"].iloc[0]
    caption = "More accurate to the right, cheaper below. Engines of different panels are not compared."
    return Figure(f"compare_{scene}", f"{scene}: cost against error", tuple(panels), caption)


def front(tried: pd.DataFrame, error: str, cost: str) -> pd.DataFrame:
    """Of each method the runs that no cheaper one is as accurate as, from coarse to fine: what an error costs.

    Settings too coarse for the order to show are accurate by chance, or not; joined by lines they tell nothing.
    """
    ordered = tried.sort_values([cost, error], kind="stable")
    best = ordered.groupby("method")[error].transform(lambda errors: errors.cummin().shift(fill_value=np.inf))
    return ordered[ordered[error] < best]


def parts(frame: pd.DataFrame) -> tuple[Part, ...]:
    drawn = figure(frame)
    return (Text(items=tuple(sentences(frame))), *([drawn] if drawn else []), *views(frame), laws_view(frame))


def laws_view(frame: pd.DataFrame) -> View:
    """How far every method is from every law, at each setting timed."""
    laws = list(frame.columns[frame.columns.get_loc("reason") + 1 : -1])
    rows = [
        (
            word(row["method"]), Cell(f"{row['error_asked']:g}", row["error_asked"]), word(row["setting"]),
            *(Cell(scientific(row[law]), row[law]) if pd.notna(row[law]) else Cell(DASH) for law in laws),
        )
        for _, row in frame[frame["status"] == "ok"].iterrows()
    ]  # fmt: skip
    labels = {law: LAWS[law].label if law in LAWS else law.replace("_", " ") for law in laws}
    heads = (
        Head("method", words=True),
        Head("error"),
        Head("setting", words=True),
        *map(Head, labels.values()),
    )
    return View("race_laws", "Laws", "Deviations over the run, at five times.", heads, tuple(rows))


def html(frame: pd.DataFrame) -> str:
    """One page that needs no network."""
    scene = frame["scene"].iloc[0]
    room = Room("compare", f"Comparison on {scene}", "", 0, (), lambda frames: ())
    return page([Said(room, parts(frame), ())], [])


def text(frame: pd.DataFrame) -> str:
    """For a terminal."""
    blocks = []
    meanings = {f"race_{kind}": "time at each error, then evaluations" for kind in TITLES}
    meanings["race_settings"] = "for each time above"
    for each in views(frame):
        lines = [[*(head.label for head in each.columns)], *([c.text for c in row] for row in each.rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        titled = [f"{each.title}: {meanings[each.name]}"]
        for line in lines:
            titled.append("  ".join(t.ljust(w) for t, w in zip(line, widths, strict=True)).rstrip())
        blocks.append("\n".join(titled))
    return "\n\n".join([*blocks, "\n".join(sentences(frame))])
