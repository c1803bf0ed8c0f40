"""A comparison to read: the notes and tables of one frame for the terminal, and its figure."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterable, Iterator

import numpy as np
import pandas as pd

from contactbench.measure.law import OF_THE_STATE
from contactbench.measure.statistics import PROCESSES, WIDEST
from contactbench.questions.judgement import structural_laws
from contactbench.questions.laws import law_label
from contactbench.report.curves import by_method, cheapest, choose, contest_end, only
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.report.numbers import DASH, count, duration, names, scientific, times
from contactbench.report.views import Cell, View, frame_of
from contactbench.tables.declared import LAWS_TABLE, shipped_folder

TITLES = {"compiled": "Compiled", "callbacks": "Calling back into Python"}
#: what a law is about, and what follows from what
SYMBOLS = {"momentum_law": "J", "contact_drift": "η", "distribution_drift": "ker η", "pairing_drift": "pairs"}
SYMBOLS |= {"attitude_drift": "RᵀR = 1", "sphere_drift": "|q| = R"}
IMPLIED = {"η": ("ker η", "pairs")}
#: what stands behind the title of a table of times
LEGEND = "time at each error; kept at round-off: J, η, pairs of singular values"
#: rows of a table, and columns of the terminal
ROWS, WIDTH = 10, 100


# -- notes -----------------------------------------------------------------------------------------
def notes(frame: pd.DataFrame) -> Iterator[str]:
    reference = frame.attrs["reference"]
    second = reference["confirmed"]
    agreed, confirmed = "two precisions of one engine agree", f"{second} of them confirmed by a second engine"
    known = {"given": "not checked", "two solvers": "to which DOP853 and extrapolation agree"}
    checked = known.get(reference["source"], agreed if second is None else confirmed)
    yield (
        f"{'Undamped. ' * frame.attrs.get('undamped', False)}Reference: {reference['source']}, "
        f"{reference['digits']} digits, {checked}; errors below {reference['error']:.1e} are not claimed."
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
    if unknown and laws_of(frame):
        why = "" if not functions else ", or a function takes no arrays"
        yield f"The laws of {', '.join(unknown)} are not measured: no time was left{why}."
    if frame.attrs["interrupted"]:
        yield "Interrupted: this is what there was."


def cuts(frame: pd.DataFrame) -> Iterator[str]:
    found: dict[tuple[str, str, str], list[str]] = {}
    missing = frame[(frame["reason"] != "") & ~frame["method"].isin(frame.attrs["unbegun"])]
    ended = missing["status"].mask(missing["status"] == "ok", "not timed")
    missing = missing.assign(ended=ended.mask(missing["verdict"] == "undecided", "undecided"))
    for (method, status, reason), rows in missing.groupby(["method", "ended", "reason"], sort=False):
        everywhere = len(rows) == frame["error_asked"].nunique()
        at = "" if everywhere else f" at {names([f'{error:g}' for error in rows['error_asked']])}"
        found.setdefault((at, status, reason), []).append(method)
    for (at, status, reason), methods in found.items():
        yield f"{names(methods)}{at}: {status}: {reason}."


# -- tables ----------------------------------------------------------------------------------------
def laws_of(frame: pd.DataFrame) -> list[str]:
    found = list(frame.columns[frame.columns.get_loc("reason") + 1 : -1])
    return [] if found == ["map_growth"] else found


def has_laws(rows: pd.DataFrame) -> pd.Series:
    return rows[laws_of(rows)].notna().any(axis=1)


def symbol(law: str) -> str:
    """Return what a run keeps that keeps a law, never its drift."""
    return SYMBOLS.get(law, law_label(law).removesuffix(" drift"))


def symbols(laws: Iterable[str]) -> list[str]:
    """Return the symbols of laws, without the laws that follow from another."""
    found = [*map(symbol, laws)]
    implied = {each for symbol in found for each in IMPLIED.get(symbol, ())}
    return [symbol for symbol in found if symbol not in implied]


def time_text(row: pd.Series) -> str:
    if row["status"] != "ok":
        return str(row["status"])
    if math.isnan(row["time_s"]):
        return "not timed"
    beside = {"win": "cheapest", "loss": times(row["ratio"])}.get(row["verdict"], row["verdict"])
    return f"{duration(row['time_s'])} {beside}"


def kept_laws(rows: pd.DataFrame) -> str:
    """Return what a method keeps at every setting at which it was measured, and what there was no time for."""
    if not laws_of(rows):
        return DASH
    if not has_laws(rows).any():
        return "not measured"
    kept, unknown = kept_and_unknown(rows)
    hidden = {label for text in rows["laws_undecided"] for label in text.split(", ")}
    unclear = symbols(law for law in laws_of(rows) if symbol(law) in hidden)
    groups = {"": kept, " undecided": unclear, " not measured": unknown}
    return "; ".join(f"{', '.join(some)}{why}" for why, some in groups.items() if some) or "none"


def kept_and_unknown(rows: pd.DataFrame) -> tuple[list[str], list[str]]:
    kept, unknown = [], []
    for law in filter(LAWS_TABLE.columns.__contains__, laws_of(rows)):
        known = rows.loc[rows[law].notna(), "laws_kept"]
        if len(known) and all(symbol(law) in text.split(", ") for text in known):
            kept.append(law)
        elif known.empty and law in structural_laws() and law not in OF_THE_STATE:  # needs the derivative
            unknown.append(law)
    return symbols(kept), symbols(unknown)


def ranked(frame: pd.DataFrame) -> list[str]:
    """Return the methods that can run the scene, soonest done first: by errors reached, then by their mean ratio."""
    able = frame[frame["status"] != "unsupported"]
    ratios = np.log(able["ratio"]).groupby(able["method"], sort=False)
    table = pd.DataFrame({"missed": -ratios.count(), "mean": ratios.mean()})
    return [str(method) for method in table.sort_values(["missed", "mean"], kind="stable").index]


def times_view(frame: pd.DataFrame, kind: str, short: bool) -> View:
    rows, own = [], frame[frame["kind"] == kind]
    for method in ranked(own):
        part = own[own["method"] == method]
        evaluations = [] if short else part["evaluations"]
        rows.append((method, *part.apply(time_text, axis=1), kept_laws(part), *evaluations))
    errors = [f"{error:g}" for error in dict.fromkeys(frame["error_asked"])]
    labels = ["method", *errors, "keeps", *([] if short else errors)]
    legend = LEGEND if short else f"{LEGEND}, then evaluations"
    return View(f"race_{kind}", TITLES[kind], frame_of(rows, labels), legend, {"": count})


def settings_view(frame: pd.DataFrame) -> View:
    errors, done = list(dict.fromkeys(frame["error_asked"])), frame[frame["status"] == "ok"]
    reached = {
        (r.method, r.error_asked): f"{r.setting}, {scientific(r.error_reached)}" for r in done.itertuples()
    }
    rows = [(m, *(reached.get((m, error), DASH) for error in errors)) for m in ranked(done)]
    table = frame_of(rows, ["method", *(f"{error:g}" for error in errors)])
    return View("race_settings", "Setting, and error reached", table, "for each time above")


def views(frame: pd.DataFrame, short: bool) -> list[View]:
    found = [times_view(frame, kind, short) for kind in TITLES if (frame["kind"] == kind).any()]
    return [each for each in [*found, *([] if short else [settings_view(frame)])] if each.rows]


# -- figure ----------------------------------------------------------------------------------------
def figure(frame: pd.DataFrame) -> Figure | None:
    timed = frame[frame["time_s"].notna()]
    timed = timed.assign(error=timed["error_reached"], cost=1e3 * timed["time_s"])
    tried = pd.DataFrame(frame.attrs["runs"], columns=["method", "setting", "status", "error", "evaluations"])
    ok = tried[(tried["status"] == "ok") & tried["evaluations"].notna()]
    ok = ok.assign(error=np.maximum(ok["error"], frame.attrs["reference"]["error"]), cost=ok["evaluations"])
    found = [(title, timed[timed["kind"] == kind], "time per solve, ms") for kind, title in TITLES.items()]
    panels = tuple(panel(*one) for one in (*found, ("Evaluations", ok, "evaluations")) if len(one[1]))
    scene = frame["scene"].iloc[0]
    return Figure(f"compare_{scene}", f"{scene}: cost against error", panels) if panels else None


def panel(title: str, rows: pd.DataFrame, name: str) -> Panel:
    curves = by_method(front(rows), "error", "cost")
    cost = contest_end(Axis(name, "log"), curves)
    return Panel(title, Axis("error", "log", True), cost, only(curves, choose(curves, cheapest)))


def front(tried: pd.DataFrame) -> pd.DataFrame:
    """Return of each method the runs that no cheaper one is as accurate as: too coarse ones are accurate by chance."""
    ordered = tried.sort_values(["cost", "error"], kind="stable")
    errors = ordered.groupby("method")["error"]
    return ordered[ordered["error"] < errors.transform(lambda own: own.cummin().shift(fill_value=np.inf))]


# -- the terminal ----------------------------------------------------------------------------------
def text(frame: pd.DataFrame, every: bool = False, scene: str = "") -> str:
    """Return a race for the terminal, at its end the recommendation, and where to read on.

    every : all rows, columns and notes; else of more than `ROWS` methods the best so many, and their times alone.
    scene : how a command names it, if not by its name.
    """
    short = not every and frame["method"].nunique() > ROWS
    recommended, said, found, hidden = frame.attrs["recommendation"], list(notes(frame)), [], 0
    named = {word for line in recommended for word in re.findall(r"[\w-]+", line)}
    for each in views(frame, short):
        shown = best_rows(each, named) if short else each.rows
        hidden += len(each.rows) - len(shown)
        lines = [[head.label for head in each.columns], *([cell.text for cell in row] for row in shown)]
        found.append("\n".join([f"{each.title}: {each.legend}", *in_width(lines)]))
    if short:
        more = f"{hidden} more rows, evaluations, settings, and why a method got no further: --csv, --all."
        said = [said[0], more]
    late = ", ".join(frame.attrs["unbegun"])
    missing = [f"Not begun, for want of time (--budget): {late}."] if late else []
    blocks = (missing, said, [*recommended, *how_to_run(frame, scene)])
    first, last, end = ("\n".join(map(wrap, block)) for block in blocks)
    folder = shipped_folder()
    where = f"For other problems, which method led on random ones: {folder / 'problems.md'}" if folder else ""
    return "\n\n".join(filter(None, [first, *found, last, end, where]))


def best_rows(view: View, named: set[str]) -> list[tuple[Cell, ...]]:
    """Return so many rows in their order: those of named methods, and of the others the first."""
    others = max(0, ROWS - sum(row[0].text in named for row in view.rows))
    first = [row[0].text for row in view.rows if row[0].text not in named][:others]
    return [row for row in view.rows if row[0].text in named | set(first)]


def how_to_run(frame: pd.DataFrame, scene: str) -> Iterator[str]:
    """Yield what an error is of, and the run at the smallest that something is recommended for."""
    carry, timed = ",".join(frame.attrs["carry"]), frame[frame["time_s"].notna()]
    what = f"the motion{f' and {carry}' if carry else ''} at the ends of five runs, the last to t_end"
    first = timed[timed["kind"] == timed["kind"].max()].sort_values(["error_asked", "time_s"], kind="stable")
    run = ""
    for row in first.head(1).itertuples():
        control, _, value = str(row.setting).partition("=")
        if value and control in ("step", "rtol"):
            name, _, options = (scene or str(row.scene)).partition(" ")
            given = f"{row.method} --{control} {value} --carry '{carry}' {options}".rstrip()
            run = f": contactbench solve {name} {given}"
    yield f"Errors are those of {what}{run}"


def wrap(line: str) -> str:
    return textwrap.fill(line, WIDTH, subsequent_indent="  ", break_on_hyphens=False)


def in_width(lines: list[list[str]]) -> Iterator[str]:
    """Yield the lines of a table; one too wide for the terminal goes on below, with its first column again."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    blocks = [[0]]
    for i, width in enumerate(widths[1:], 1):
        if sum(widths[k] + 2 for k in blocks[-1]) + width > WIDTH and blocks[-1] != [0]:
            blocks.append([0])
        blocks[-1].append(i)
    for block in blocks:
        yield from ("  ".join(line[i].ljust(widths[i]) for i in block).rstrip() for line in lines)
