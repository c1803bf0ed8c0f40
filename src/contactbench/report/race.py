"""A comparison to read: the notes, tables and figure of one frame, for terminal, page and plot alike."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator

import numpy as np
import pandas as pd

from contactbench.measure.law import OF_THE_STATE
from contactbench.measure.statistics import PROCESSES, WIDEST
from contactbench.report.chapters import Answer, Chapter, Contents, Part, Text, shown
from contactbench.report.curves import best_of_each, by_method, cheapest, contest_end
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.report.laws import law_label
from contactbench.report.numbers import DASH, count, duration, names, scientific, times
from contactbench.report.page import page
from contactbench.report.views import Cell, Mark, Show, View, frame_of, pick
from contactbench.results.judgement import structural_laws
from contactbench.results.tables import LAWS_TABLE

TITLES = {"compiled": "Compiled", "callbacks": "Calling back into Python"}
ALIKE = ("tie", "undecided")


# -- answers and notes -----------------------------------------------------------------------------------------
def answers(frame: pd.DataFrame) -> Iterator[Answer]:
    first = frame[frame["verdict"].isin(["win", *ALIKE])]
    for (kind, error), rows in first.groupby(["kind", "error_asked"], sort=False):
        ranked = rows.sort_values("time_s", kind="stable")
        question = f"{TITLES[str(kind)]}, error {error:g}: who is cheapest?"
        yield Answer(question, names(list(ranked["method"]), 4), duration(ranked["time_s"].min()))


def notes(frame: pd.DataFrame) -> Iterator[str]:
    yield from unbegun(frame)
    reference = frame.attrs["reference"]
    second = reference["confirmed"]
    agreed, confirmed = "two precisions of one engine agree", f"{second} of them confirmed by a second engine"
    known = {"given": "not checked", "two solvers": "to which DOP853 and extrapolation agree"}
    checked = known.get(reference["source"], agreed if second is None else confirmed)
    yield (
        f"Reference: {reference['source']}, {reference['digits']} digits, {checked}; errors below "
        f"{reference['error']:.1e} are not claimed."
    )
    yield (
        "Times are least rounds. Two within their margin tie: what the halves of their visits differ by here, and two "
        f"processes elsewhere ({PROCESSES - 1:.0%}); within a margin wider than {WIDEST - 1:.0%} they are undecided."
    )
    if functions := frame.attrs["of_floats"]:
        yield (
            f"Of floats only: {', '.join(functions)}. Methods call back into Python; a cubic spline is C² only, and at "
            "its knots errors cease to fall with the order of a method."
        )
    yield from cuts(frame)
    if unrefined := frame.attrs["unrefined"]:
        yield f"No time was left to look for a cheaper setting of {', '.join(unrefined)}."
    ok = frame[frame["status"] == "ok"]
    unknown = [str(m) for m, rows in ok.groupby("method", sort=False) if not has_laws(rows).any()]
    if unknown:
        why = "" if not functions else ", or a function takes no arrays"
        yield f"The laws of {', '.join(unknown)} are not measured: no time was left{why}."
    if frame.attrs["interrupted"]:
        yield "Interrupted: this is what there was."


def unbegun(frame: pd.DataFrame) -> Iterator[str]:
    if missing := frame.attrs["unbegun"]:
        yield f"Not begun, for want of time (--budget): {', '.join(missing)}."


def cuts(frame: pd.DataFrame) -> Iterator[str]:
    found: dict[tuple[str, str, str], list[str]] = {}
    missing = frame[(frame["reason"] != "") & ~frame["method"].isin(frame.attrs["unbegun"])]
    ended = missing["status"].mask(missing["status"] == "ok", "not timed")
    missing = missing.assign(ended=ended.mask(missing["verdict"] == "undecided", "undecided"))
    for (method, status, reason), rows in missing.groupby(["method", "ended", "reason"], sort=False):
        everywhere = len(rows) == frame["error_asked"].nunique()
        at = "" if everywhere else f" at {names([f'{error:g}' for error in rows['error_asked']])}"
        key = (at, str(status), str(reason))
        found.setdefault(key, []).append(str(method))
    for (at, status, reason), methods in found.items():
        yield f"{names(methods)}{at}: {status}: {reason}."


# -- tables ----------------------------------------------------------------------------------------
def laws_of(frame: pd.DataFrame) -> list[str]:
    return list(frame.columns[frame.columns.get_loc("reason") + 1 : -1])


def has_laws(rows: pd.DataFrame) -> pd.Series:
    return rows[laws_of(rows)].notna().any(axis=1)


def time_cell(row: pd.Series) -> Cell:
    if row["status"] != "ok":
        return Cell(row["status"])
    if math.isnan(row["time_s"]):
        return Cell("not timed")
    mark = Mark.best if row["verdict"] == "win" else Mark.tie if row["verdict"] in ALIKE else None
    beside = {"win": "cheapest", "loss": times(row["ratio"])}.get(row["verdict"], row["verdict"])
    return Cell(f"{duration(row['time_s'])} {beside}", row["time_s"], mark)


def kept_laws(rows: pd.DataFrame) -> str:
    """Return the laws kept at every setting at which they were measured, and those that there was no time for."""
    done = rows[has_laws(rows)]
    if done.empty:
        return "not measured"
    kept, unknown = [], []
    for law in (name for name in laws_of(rows) if name in LAWS_TABLE.columns):
        known = done.loc[done[law].notna(), "laws_kept"]
        needs_derivative = law in structural_laws() and law not in OF_THE_STATE
        if known.empty and needs_derivative:
            unknown.append(law_label(law))
        elif len(known) and all(law_label(law) in text.split(", ") for text in known):
            kept.append(law_label(law))
    if unknown:
        return f"{', '.join(kept)}{'; ' if kept else ''}not measured: {', '.join(unknown)}"
    return ", ".join(kept) or "none"


def times_view(frame: pd.DataFrame, kind: str) -> View:
    rows = []
    for method, part in frame[frame["kind"] == kind].groupby("method", sort=False):
        if not (part["status"] == "unsupported").all():
            cells = [time_cell(row) for _, row in part.iterrows()]
            rows.append((str(method), *cells, *part["evaluations"], kept_laws(part)))
    errors = [f"{error:g}" for error in dict.fromkeys(frame["error_asked"])]
    labels = [("", "method"), *((f"{what} at error", e) for what in ("time", "evaluations") for e in errors)]
    table = frame_of(rows, [*labels, ("", "at round-off")])
    legend = "Least time of a bare call at the coarsest setting that reaches the error; ×: over the cheapest."
    return View(f"race_{kind}", TITLES[kind], table, legend, show={"": count})


def settings_view(frame: pd.DataFrame) -> View:
    errors = list(dict.fromkeys(frame["error_asked"]))
    rows = []
    for method, part in frame[frame["status"] == "ok"].groupby("method", sort=False):
        reached = {r.error_asked: f"{r.setting}, {scientific(r.error_reached)}" for r in part.itertuples()}
        rows.append((str(method), *(reached.get(error, DASH) for error in errors)))
    table = frame_of(rows, ["method", *(f"{error:g}" for error in errors)])
    return View("race_settings", "Setting, and error reached", table, "Of each time above.")


def laws_view(frame: pd.DataFrame) -> View:
    laws = {law: law_label(law) for law in laws_of(frame)}
    table = pick(frame[frame["status"] == "ok"], "method", "setting", error_asked="error", **laws)
    show: dict[str, Show] = {"error": "{:g}".format, "": scientific}
    return View("race_laws", "Laws", table, "Deviations over the run, at five times.", show=show)


def views(frame: pd.DataFrame) -> list[View]:
    found = [times_view(frame, kind) for kind in TITLES if (frame["kind"] == kind).any()]
    return [each for each in [*found, settings_view(frame)] if each.rows]


# -- figure ----------------------------------------------------------------------------------------
def figure(frame: pd.DataFrame) -> Figure | None:
    timed = frame[frame["time_s"].notna()]
    timed = timed.assign(error=timed["error_reached"], cost=1e3 * timed["time_s"])
    tried = pd.DataFrame(frame.attrs["runs"], columns=["method", "setting", "status", "error", "evaluations"])
    ok = tried[(tried["status"] == "ok") & tried["evaluations"].notna()]
    ok = ok.assign(error=np.maximum(ok["error"], frame.attrs["reference"]["error"]), cost=ok["evaluations"])
    found = [(title, timed[timed["kind"] == kind], "time per solve, ms") for kind, title in TITLES.items()]
    panels = tuple(panel(*one) for one in (*found, ("Evaluations", ok, "evaluations")) if len(one[1]))
    if not panels:
        return None
    scene = frame["scene"].iloc[0]
    caption = "More accurate to the right, cheaper below. Engines of different panels are not compared."
    return Figure(f"compare_{scene}", f"{scene}: cost against error", panels, caption)


def panel(title: str, rows: pd.DataFrame, name: str) -> Panel:
    curves = by_method(front(rows), "error", "cost")
    cost = contest_end(Axis(name, "log"), curves)
    return Panel(title, Axis("error", "log", True), cost, best_of_each(curves, cheapest))


def front(tried: pd.DataFrame) -> pd.DataFrame:
    """Return of each method the runs that no cheaper one is as accurate as: too coarse ones are accurate by chance."""
    ordered = tried.sort_values(["cost", "error"], kind="stable")
    errors = ordered.groupby("method")["error"]
    return ordered[ordered["error"] < errors.transform(lambda own: own.cummin().shift(fill_value=np.inf))]


# -- documents -------------------------------------------------------------------------------------
def html(frame: pd.DataFrame) -> str:
    """Return a page of its own: the figure stands in it, not beside it."""
    from contactbench.report.draw import svg  # takes long to load

    scene, drawn = str(frame["scene"].iloc[0]), figure(frame)
    chapter = Chapter("compare", f"Comparison on {scene}", "", 0, (), lambda frames: ())
    parts: list[Part | None] = [drawn, *views(frame), laws_view(frame), Text(items=tuple(notes(frame)))]
    contents, images = Contents(chapter, tuple(answers(frame)), tuple(shown(parts))), {}
    if drawn:
        picture = base64.b64encode(svg(drawn).encode()).decode()
        images[drawn.name] = f"data:image/svg+xml;base64,{picture}"
    return page([contents], images=images)


def text(frame: pd.DataFrame) -> str:
    legends = {f"race_{kind}": "time at each error, then evaluations" for kind in TITLES}
    legends["race_settings"] = "for each time above"
    blocks = []
    for each in views(frame):
        lines = [[head.label for head in each.columns], *([cell.text for cell in row] for row in each.rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        rows = ("  ".join(t.ljust(w) for t, w in zip(line, widths, strict=True)).rstrip() for line in lines)
        blocks.append("\n".join([f"{each.title}: {legends[each.name]}", *rows]))
    first = list(unbegun(frame))
    return "\n\n".join([*first, *blocks, "\n".join(list(notes(frame))[len(first) :])])
