"""``report.html``: the results as one page that needs no network, from the tables alone."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd
from matplotlib.colors import to_hex, to_rgb
from matplotlib.markers import MarkerStyle
from matplotlib.path import Path as Outline

from contactbench.report import documents as report
from contactbench.report.documents import (
    ANY,
    CALLBACKS,
    COMPILED,
    DASH,
    STRUCTURE,
    TARGETS,
    duration,
    figures,
    scientific,
)
from contactbench.report.markdown import times
from contactbench.results.schema import SEPARATOR, TABLES, laws_shown, read, replacing

#: tables with a section of their own; the others are shown as they are
SECTIONS = ("work_precision", "laws", "convergence", "claims")
#: data of figures, not for reading
CURVES = ("laws_time", "paper_figures", "one_step", "strong_damping")
#: a table with more cells is left to its CSV
MOST_CELLS = 15_000
#: of the stability table, what is shown beside its map
STABILITY = (
    "scene", "method", "engine", "setting", "status", "message", "solution_error", "end_error", "hamiltonian_law",
    "momentum_law", "contact_drift", "evaluations", "time_s",
)  # fmt: skip
#: contrast a line must have on the dark page (WCAG 2.2, 1.4.3; graphical objects need 3)
CONTRAST = 4.5
DARK_PAPER = "#101418"
#: a status as one letter, so that a map is read without its colours
LETTERS = {"diverged": "D", "budget": "B", "failed": "F", "timeout": "T", "unsupported": "–"}


# -- sheets: tables as HTML ------------------------------------------------------------------------
@dataclass(frozen=True)
class Cell:
    """What is shown, what it is sorted by (itself when None), and how it looks."""

    text: str
    value: float | None = None
    look: str = ""
    more: tuple[tuple[str, Any], ...] = ()  # behind a disclosure: (caption, text or list of texts)


@dataclass(frozen=True)
class Sheet:
    """A sortable table: head of (label, meaning), rows of cells, columns that hold words."""

    title: str
    head: tuple[tuple[str, str], ...]
    rows: tuple[tuple[Cell, ...], ...]
    words: frozenset[int] = frozenset({0})


def sheet(
    title: str, head: Iterable[Any], rows: Iterable[Iterable[Cell]], words: Iterable[int] = (0,)
) -> Sheet:
    """A sheet; a head entry is a label or a pair of label and meaning."""
    pairs = ((h, "") if isinstance(h, str) else h for h in head)
    return Sheet(title, tuple(pairs), tuple(map(tuple, rows)), frozenset(words))


def word(text: Any, look: str = "") -> Cell:
    return Cell("" if pd.isna(text) else str(text), look=look)


def number(value: Any, show: Callable[[Any], str] = scientific, look: str = "") -> Cell:
    """A number as `show` writes it, sorted by itself; missing ones are last, infinite ones just before."""
    if pd.isna(value):
        return Cell(DASH)
    if math.isinf(value):
        return Cell("∞" if value > 0 else "−∞", math.copysign(sys.float_info.max, value), look)
    return Cell(show(value), float(value), look)


def law_cell(value: Any) -> Cell:
    """A drift: marked where it is round-off."""
    return number(value, look="exact" if not pd.isna(value) and abs(value) <= report.ROUND_OFF else "")


def listing(title: str, made: report.Listing) -> Sheet:
    """A listing of the documents, sorted by its values."""
    rows = [
        [
            word(show(v)) if isinstance(v, str) else number(v, show)
            for (_, show), v in zip(made.columns, row, strict=True)
        ]
        for row in made.rows
    ]
    words = [i for i, cell in enumerate(made.rows[0]) if isinstance(cell, str)] if made.rows else []
    return sheet(title, [label for label, _ in made.columns], rows, words)


def count(value: Any) -> str:
    return DASH if pd.isna(value) else f"{value:,.0f}".replace(",", "\u202f")


def power(value: float) -> str:
    """10⁻³ for 1e-3."""
    return "10" + str(round(math.log10(value))).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


# -- the look of a method --------------------------------------------------------------------------
def luminance(color: str) -> float:
    """Relative luminance, WCAG 2.2."""
    linear = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(color))
    return sum(w * c for w, c in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


def lightened(color: str) -> str:
    """The colour mixed with white until it stands out from the dark page."""
    for parts in range(21):
        red, green, blue = (c + (1 - c) * parts / 20 for c in to_rgb(color))
        mixed = to_hex((red, green, blue))
        if (luminance(mixed) + 0.05) / (luminance(DARK_PAPER) + 0.05) >= CONTRAST:
            return mixed
    return "#ffffff"


def outline(marker: str) -> str:
    """A matplotlib marker as an SVG path of size one."""
    style = MarkerStyle(marker)
    path = style.get_path().transformed(style.get_transform())
    letters = {Outline.MOVETO: "M", Outline.LINETO: "L", Outline.CURVE3: "Q", Outline.CURVE4: "C"}
    parts = []
    for points, code in path.iter_segments(simplify=False):
        if code == Outline.CLOSEPOLY:
            parts.append("Z")
        else:
            numbers = (f"{-v if i % 2 else v:.3g}" for i, v in enumerate(points.tolist()))
            parts.append(letters[code] + " ".join(numbers))
    return "".join(parts)


def look(method: str) -> dict[str, Any]:
    style = figures.style(method)
    return {
        "light": to_hex(style["color"]),
        "dark": lightened(style["color"]),
        "marker": outline(style["marker"]),
        "hollow": style["markerfacecolor"] == "white",
        "own": report.is_ours(method),
    }


# -- work–precision --------------------------------------------------------------------------------
POINT = (
    "method", "engine", "setting", "status", "solution_error", "time_median_s", "time_iqr_s", "rhs_equivalents",
    "evaluations", "evaluation_kind", "steps",
)  # fmt: skip


def points(work: pd.DataFrame) -> dict[str, list[list[Any]]]:
    """The points of the figures, scene by scene, as JSON values in the order of `POINT`."""
    drawn = work[work["track"].isin(["fixed", "adaptive"]) & (work["status"] == "ok")]
    return {
        str(scene): [[plain(v) for v in row] for row in part[list(POINT)].itertuples(index=False)]
        for scene, part in drawn.groupby("scene", sort=False)
    }


def plain(value: Any) -> Any:
    """A JSON value; four digits are more than a figure shows."""
    if pd.isna(value):
        return None
    return float(f"{value:.4g}") if isinstance(value, float) else getattr(value, "item", lambda: value)()


def equal_error_sheet(work: pd.DataFrame, scene: str, cost: str, show: Callable[[float], str]) -> Sheet:
    frame = report.equal_error(work, scene, cost)
    with_engine = cost == "time_median_s"
    best = {target: frame[target].min() for target in TARGETS}
    rows = []
    for _, row in frame.iterrows():
        cells = [word(row["method"]), *([word(row["engine"])] if with_engine else [])]
        for target in TARGETS:
            look = "best" if row[target] == best[target] else ""
            cells.append(number(row[target], report.writer(row, target, show), look))
        rows.append(cells)
    title = "Median time per solve" if with_engine else "Right-hand sides or equivalents"
    head = ["method", *(["engine"] if with_engine else []), *((power(t), f"error {t:.0e}") for t in TARGETS)]
    return sheet(title, head, rows, (0, 1) if with_engine else (0,))


def endings_sheet(work: pd.DataFrame, scene: str) -> Sheet:
    """The runs of a scene that did not end ok."""
    part = work[(work["scene"] == scene) & (work["status"] != "ok")]
    rows = [
        [word(r[name]) for name in ("method", "engine", "setting", "status", "message")]
        for _, r in part.iterrows()
    ]
    return sheet("Runs that did not end ok", ["method", "engine", "setting", "status", "why"], rows, range(5))


# -- the headline ----------------------------------------------------------------------------------
@dataclass(frozen=True)
class Contest:
    """Who is cheapest where: a sheet of winners, and how often each method wins."""

    name: str
    about: str
    cost: str
    engines: tuple[str, ...]
    show: Callable[[Any], str]


CONTESTS = (
    Contest("Time, compiled", "engines jax and llvm", "time_median_s", COMPILED, duration),
    Contest(
        "Time, callbacks",
        "solvers that call back into Python; ours in Python",
        "time_median_s",
        CALLBACKS,
        duration,
    ),
    Contest("Evaluations", "right-hand sides or equivalents, any engine", "rhs_equivalents", ANY, count),
)


def contest(work: pd.DataFrame, which: Contest) -> dict[str, Any]:
    """The sheet of winners by scene and error, and the tally over all of them."""
    rows, tally, fields = [], dict[str, int](), 0
    for scene in dict.fromkeys(work["scene"]):
        cells = [word(scene)]
        for costs in report.ranked(work, scene, which.cost, which.engines).values():
            if not len(costs):
                cells.append(Cell(DASH))
                continue
            fields += 1
            first, least = str(costs.index[0]), costs.iloc[0]
            tally[first] = tally.get(first, 0) + 1
            after = (
                f"{costs.index[1]} {times(costs.iloc[1] / least)}"
                if len(costs) > 1
                else "no other gets there"
            )
            cells.append(Cell(first, float(least), "winner", ((which.show(least), after),)))
        rows.append(cells)
    head = ["scene", *(f"error {power(target)}" for target in TARGETS)]
    ranking = sorted(tally.items(), key=lambda item: -item[1])
    return {"which": which, "sheet": sheet(which.name, head, rows), "tally": ranking, "fields": fields}


def structure_sheet(laws: pd.DataFrame, convergence: pd.DataFrame) -> Sheet:
    """Who keeps the laws: to round-off at every setting, or from … to."""
    rows = []
    for method, ranges in report.structure_ranges(laws).items():
        order = report.headline_order(convergence, method)
        cells = [word(method), Cell("adaptive") if order is None else number(order, lambda v: f"{v:.2f}")]
        for low, high in ranges.values():
            if pd.isna(high) or high <= report.ROUND_OFF:
                cells.append(law_cell(high))
            else:
                cells.append(Cell(f"{scientific(low)} … {scientific(high)}", float(high)))
        rows.append(cells)
    return sheet("Who keeps the laws", ["method", f"order, {report.HEADLINE}", *STRUCTURE], rows)


# -- the other tables ------------------------------------------------------------------------------
def laws_sheet(laws: pd.DataFrame, scene: str) -> Sheet:
    part = laws[laws["scene"] == scene]
    meaning = report.labels("laws")
    shown = [name for name in laws_shown("laws") if part[name].notna().any()]
    rows = []
    for _, row in part.iterrows():
        cells = [number(row[n], count) if n == "energy_increases" else law_cell(row[n]) for n in shown]
        ending = word(row["status"] if row["status"] == "ok" else f"{row['status']}: {row['message']}")
        rows.append([word(row["method"]), word(row["setting"]), *cells, ending])
    head = ["method", "setting", *((n.replace("_", " "), meaning[n]) for n in shown), "status"]
    return sheet(f"Laws on {scene}", head, rows, (0, 1, len(head) - 1))


def convergence_sheet(frame: pd.DataFrame) -> Sheet:
    scenes = list(dict.fromkeys(frame["scene"]))
    rows = []
    for method in dict.fromkeys(frame["method"]):
        mine = frame[frame["method"] == method]
        cells = [word(method), number(mine["order_nominal"].iloc[0], count)]
        for scene in scenes:
            here = mine[mine["scene"] == scene]
            if not len(here) or pd.isna(here["order"].iloc[0]):
                why = DASH if not len(here) else here["status"].iloc[0]
                cells.append(Cell("no range" if why == "ok" else str(why), look="soft"))
                continue
            fit = here.iloc[0]
            half = (fit["order_high"] - fit["order_low"]) / 2
            cells.append(Cell(f"{fit['order']:.3f} ± {half:.3f}", float(fit["order"])))
        rows.append(cells)
    return sheet("Fitted orders", ["method", "claimed", *scenes], rows)


def claims_sheet(frame: pd.DataFrame) -> Sheet:
    text = frame.astype(object).where(frame.notna(), "")
    rows = []
    for (_, row), (_, raw) in zip(text.iterrows(), frame.iterrows(), strict=True):
        more: list[tuple[str, Any]] = [("Measured", [i for i in row["evidence"].split(SEPARATOR) if i])]
        if row["correction"]:
            more.append((report.CAPTIONS.get(row["correction_kind"], "Corrected"), row["correction"]))
        if row["corrected_evidence"]:
            more.append(("Measured", row["corrected_evidence"].split(SEPARATOR)))
        more.append(("On", f"{row['scene']}; {row['method']}"))
        more.append(("Again", row["command"]))
        verdict = row["verdict"] or row["status"]
        bound = (
            Cell(DASH)
            if pd.isna(raw["bound"])
            else Cell(f"{row['relation']} {raw['bound']:.2g}", raw["bound"])
        )
        rows.append([
            word(row["id"]), word(verdict, "verdict " + verdict.replace(", ", "-")),
            Cell(row["claim"], more=tuple(more)), number(raw["measured"], lambda v: f"{v:.2g}"), bound,
            word(row["where"]),
        ])  # fmt: skip
    head = ["id", "verdict", "claim", "measured", "needed", "where in the paper"]
    return sheet("Claims", head, rows, (0, 1, 2, 5))


def whole_sheet(name: str, frame: pd.DataFrame) -> Sheet | None:
    """A table as it is: every column that says anything, with its meaning; None if it is too large."""
    meaning = TABLES[name].columns
    wanted = STABILITY if name == "stability" else tuple(meaning)
    shown = [c for c in frame if c in wanted and frame[c].notna().any()]
    if len(shown) * len(frame) > MOST_CELLS:
        return None
    numeric = [pd.api.types.is_numeric_dtype(frame[c]) and frame[c].dtype != bool for c in shown]
    rows = [
        [readable_number(v) if n else word(v) for v, n in zip(row, numeric, strict=True)]
        for row in frame[shown].itertuples(index=False)
    ]
    words = [i for i, n in enumerate(numeric) if not n]
    return sheet(TABLES[name].about, [(c.replace("_", " "), meaning[c]) for c in shown], rows, words)


def readable_number(value: Any) -> Cell:
    """Whole numbers in full, moderate ones with four digits, the others scientifically."""
    if pd.isna(value) or math.isinf(value):
        return number(value)
    plain_size = value == 0 or 1e-2 <= abs(value) < 1e4
    return number(value, count if value == round(value) and abs(value) < 1e6 else
                  (lambda v: f"{v:.4g}") if plain_size else scientific)  # fmt: skip


# -- the stability map -----------------------------------------------------------------------------
def stability_map(frame: pd.DataFrame) -> dict[str, Any]:
    """Scene × method: one mark per setting in table order, a decade of error or the letter of a bad end."""
    scenes, rows = list(dict.fromkeys(frame["scene"])), []
    for (method, engine), mine in frame.groupby(["method", "engine"], sort=False, dropna=False):
        cells = []
        for scene in scenes:
            here = mine[mine["scene"] == scene]
            marks = [mark(row) for _, row in here.iterrows()]
            errors = here[here["status"] == "ok"]["solution_error"]
            best = errors.min()
            cells.append({"marks": marks, "best": scientific(best, 0) if len(errors) else DASH})
        rows.append({"method": method, "engine": "" if pd.isna(engine) else engine, "cells": cells})
    return {"scenes": scenes, "rows": rows, "letters": LETTERS}


def mark(row: pd.Series) -> dict[str, str]:
    """One run in the map; where the true motion reaches infinity, to say so is right."""
    error, status = row["solution_error"], str(row["status"])
    says = f"{row['method']} on {row['scene']}, {row['setting']}: "
    if status != "ok":
        why = "" if pd.isna(row["message"]) else f" ({row['message']})"
        right = status == "diverged" and not pd.isna(row.get("blow_up_time"))
        look = "right" if right else "none" if status == "unsupported" else "bad"
        truth = f"; so does the true motion, at t = {row['blow_up_time']:.6g}" if right else ""
        return {"look": look, "text": LETTERS.get(status, "?"), "says": f"{says}{status}{why}{truth}"}
    if pd.isna(error):
        return {"look": "unknown", "text": "?", "says": f"{says}ok, error not known"}
    decade = 0 if error >= 1 else min(12, math.floor(-math.log10(max(error, 1e-300))))
    return {"look": f"d{decade // 2}", "text": "", "says": f"{says}error {scientific(error)}"}


# -- the page --------------------------------------------------------------------------------------
def page(tables: dict[str, pd.DataFrame], runs: dict[str, dict]) -> str:
    """The HTML text: every section whose table has rows."""
    work, laws, convergence, claims = (tables[name] for name in SECTIONS)
    keyed = (frame["method"] for name, frame in tables.items() if "method" in TABLES[name].key)
    looks = {method: look(method) for column in keyed for method in dict.fromkeys(column)}
    scenes = list(dict.fromkeys([*work["scene"], *laws["scene"]]))
    stability = tables.get("stability", pd.DataFrame())
    rest = {name: frame for name, frame in tables.items() if name not in (*SECTIONS, *CURVES) and len(frame)}
    meaning = report.labels("work_precision")
    payload = {
        "methods": looks,
        "columns": POINT,
        "points": points(work),
        "tracks": figures.TRACKS,
        "targets": TARGETS,
        "labels": {"solution_error": meaning["solution_error"].partition(" over ")[0]},
    }
    verdicts = {v: int((claims["verdict"] == v).sum()) for v in report.VERDICTS}
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("contactbench", "page"), autoescape=True, trim_blocks=True, lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    environment.filters |= {"duration": duration, "count": count, "scientific": scientific}
    return environment.get_template("page.html").render(
        css=part("page.css"),
        script=part("page.js"),
        payload=script_safe(payload),
        looks=looks,
        numbers={method: i for i, method in enumerate(looks)},
        scenes=scenes,
        first=report.HEADLINE if report.HEADLINE in scenes else next(iter(scenes), ""),
        contests=[contest(work, which) for which in CONTESTS] if len(work) else [],
        structure=structure_sheet(laws, convergence) if len(laws) else None,
        keepers=report.keepers(laws) if len(laws) else None,
        round_off=report.ROUND_OFF,
        times={
            s: equal_error_sheet(work, s, "time_median_s", duration) for s in dict.fromkeys(work["scene"])
        },
        evaluations={
            s: equal_error_sheet(work, s, "rhs_equivalents", count) for s in dict.fromkeys(work["scene"])
        },
        endings={s: endings_sheet(work, s) for s in dict.fromkeys(work["scene"])},
        losses=listing("Where a peer is cheapest", report.losses(work)) if len(work) else None,
        losses_meaning=report.LOSSES,
        reasons=report.REASONS,
        kernels=listing("Compiled kernels beside a C loop", report.kernels(work)),
        kernels_meaning=report.KERNELS,
        chosen=listing("A step chosen from a tolerance", report.chosen(work)),
        error_meaning=meaning["solution_error"],
        laws={s: laws_sheet(laws, s) for s in dict.fromkeys(laws["scene"])},
        law_meaning={name: report.labels("laws")[name] for name in laws_shown("laws")},
        convergence=convergence_sheet(convergence) if len(convergence) else None,
        claims=claims_sheet(claims) if len(claims) else None,
        verdicts=verdicts,
        verdict_meaning=report.MEANINGS,
        stability=stability_map(stability) if len(stability) else None,
        rest={name: whole_sheet(name, frame) for name, frame in rest.items()},
        titles={name: name.replace("_", " ") for name in rest},
        sizes={name: len(f) for name, f in rest.items()},
        runs=runs,
    )


def part(name: str) -> str:
    return files("contactbench.report.page").joinpath(name).read_text(encoding="utf-8")


def script_safe(payload: Any) -> str:
    """JSON that may stand inside a script element."""
    text = json.dumps(payload, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c")


def write(results: Path) -> Path:
    """Write ``report.html`` from the tables in `results`; returns its path."""
    tables = {name: read(table, results) for name, table in TABLES.items()}
    path = results / "environment.json"
    runs = json.loads(path.read_text()) if path.exists() else {}
    with replacing(results / "report.html") as file:
        file.write(page(tables, runs))
    return results / "report.html"
