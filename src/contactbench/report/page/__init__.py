"""``report.html``: all chapters on one page that needs no network.

A renderer: it knows no question, no table and no method.  Figures are the SVG files beside the page; tables are
embedded as JSON and drawn when they are opened; one plot is live (`drawing.Live`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any

import jinja2
import pandas as pd
from matplotlib.markers import MarkerStyle
from matplotlib.path import Path as Outline

from contactbench.report.chapters import COUNT, QUESTION, Chapter, Contents, Part, Section, Text
from contactbench.report.drawing import Curve, Figure, Live, Panel
from contactbench.report.look import look
from contactbench.report.page.words import inline
from contactbench.report.views import Cell, View

#: where readers go from here: documents beside the page, and the source above it
LINKS = {
    "results as text": "README.md",
    "the paper and its claims": "claims.md",
    "glossary": "glossary.md",
    "source": "../README.md",
}
#: in the order they stand in the page
SCRIPTS = ("tables.js", "live.js")


# -- the live plot as JSON -------------------------------------------------------------------------
def outline(marker: str) -> str:
    """Return a matplotlib marker as an SVG path of size one."""
    style = MarkerStyle(marker)
    path = style.get_path().transformed(style.get_transform())
    letters = {Outline.MOVETO: "M", Outline.LINETO: "L", Outline.CURVE3: "Q", Outline.CURVE4: "C"}
    parts = []
    for points, code in path.iter_segments(simplify=False):
        numbers = (f"{-v if i % 2 else v:.3g}" for i, v in enumerate(points.tolist()))
        parts.append("Z" if code == Outline.CLOSEPOLY else letters[code] + " ".join(numbers))
    return "".join(parts)


def style(curve: Curve) -> dict[str, Any]:
    """Return how a curve of a method is drawn."""
    own = look(curve.method, curve.family)
    dash = " ".join(f"{1.5 * part:g}" for part in own.dash)
    return {"color": own.color, "marker": outline(own.marker), "hollow": not own.filled, "dash": dash}


def decades(values: Iterable[float]) -> list[int | None]:
    """Return logarithms in thousandths, which is what a screen resolves; null where there is none."""
    return [round(1000 * math.log10(v)) if math.isfinite(v) and v > 0 else None for v in values]


def live_panel(panel: Panel, settings: dict[str, int]) -> dict[str, Any]:
    """Return a log–log panel; settings are numbered as they are met."""
    curves = [
        {
            "name": curve.method,
            "muted": int(curve.muted),
            "x": decades(curve.x),
            "y": decades(curve.y),
            "at": [settings.setdefault(hint, len(settings)) for hint in curve.hints],
        }
        for curve in panel.curves
    ]
    ends = [end and round(1000 * math.log10(end)) for end in (panel.x.within[0], panel.y.within[1])]
    return {"title": panel.title, "x": panel.x.label, "y": panel.y.label, "ends": ends, "curves": curves}


def live_plot(live: Live) -> dict[str, Any]:
    """Return the panels by their two words, the looks of their methods, and the settings of their points."""
    settings: dict[str, int] = {}
    panels: dict[str, dict[str, Any]] = {}
    for (first, second), panel in live.panels.items():
        panels.setdefault(first, {})[second] = live_panel(panel, settings)
    curves = [curve for panel in live.panels.values() for curve in panel.curves]
    return {
        "panels": panels,
        "styles": {curve.method: style(curve) for curve in curves},
        "settings": list(settings),
    }


# -- tables as JSON --------------------------------------------------------------------------------
def cell(of: Cell, addresses: Mapping[str, str]) -> str | list[Any]:
    """Return the HTML of an entry; with what it is sorted by, its mark and its address, where it has any."""
    text = str(inline(of.text, addresses))
    try:
        readable = of.value is None or math.isclose(float(of.text), of.value, rel_tol=0.1)
    except ValueError:
        readable = False
    if readable and not of.mark and not of.link:
        return text
    value = None if of.value is None else float(f"{of.value:.6g}")
    more = [text, value, of.mark or "", addresses.get(of.link, of.link)]
    while not more[-1] and len(more) > 1:
        more.pop()
    return more


def table(view: View, addresses: Mapping[str, str]) -> dict[str, Any]:
    """Return a view."""
    heads = [[str(inline(head.label)), int(head.words), head.group] for head in view.columns]
    return {
        "title": view.title,
        "legend": str(inline(view.legend, addresses)),
        "source": view.source,
        "heads": heads,
        "rows": [[cell(entry, addresses) for entry in row] for row in view.rows],
    }


def views(parts: Iterable[Part]) -> Iterable[View]:
    """Yield every view of some parts, nested ones included."""
    for part in parts:
        if isinstance(part, Section):
            yield from views(part.parts)
        elif isinstance(part, View):
            yield part


# -- parts -----------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Choice:
    """Neighbouring sections that are alternatives; one is shown at a time."""

    name: str
    sections: tuple[Section, ...]


KINDS: dict[type, str] = {Text: "text", View: "view", Figure: "figure", Section: "section", Choice: "choice"}


def grouped(parts: Iterable[Part]) -> list[Any]:
    """Return the parts, alternatives next to each other made one `Choice`."""
    out: list[Any] = []
    for part in parts:
        name = part.choice if isinstance(part, Section) else ""
        if name and out and isinstance(out[-1], Choice) and out[-1].name == name:
            out[-1] = Choice(name, (*out[-1].sections, part))  # type: ignore[arg-type]
        else:
            out.append(Choice(name, (part,)) if name else part)  # type: ignore[arg-type]
    return out


def without_repeats(parts: Iterable[Part], known: set[object]) -> Iterable[Part]:
    """Yield the parts whose text or name is not known yet; they are from then on."""
    for part in parts:
        if isinstance(part, Section):
            yield replace(part, parts=tuple(without_repeats(part.parts, known)))
            continue
        key = (part.body, part.items) if isinstance(part, Text) else (type(part), part.name)
        if key not in known:
            known.add(key)
            yield part


def new_answers(summary: pd.DataFrame, known: set[object]) -> list[dict[str, str]]:
    """Return the lines of a summary whose question and count are not known yet; they are from then on."""
    lines = [line for line in summary.to_dict("records") if (line[QUESTION], line[COUNT]) not in known]
    known.update((line[QUESTION], line[COUNT]) for line in lines)
    return lines


# -- the page --------------------------------------------------------------------------------------
def page(
    contents: Sequence[Contents],
    recorded: Sequence[Mapping[str, Any]] = (),
    glossary: Sequence[Part] = (),
    links: Mapping[str, str] | None = None,
    live: Live | None = None,
) -> str:
    """Return the HTML text.

    recorded : the runs that made the tables.  glossary : parts of a last section.  links : name → address.
    """
    known: set[object] = set()
    chapters: list[tuple[Chapter, list[dict[str, str]], list[Part]]] = []
    for one in contents:
        parts = one.parts
        if live and not chapters:  # the live plot stands for the figures of the first chapter
            parts = tuple(part for part in parts if not isinstance(part, Figure))
        answers = new_answers(one.summary, known)
        chapters.append((one.chapter, answers, list(without_repeats(parts, known))))
    addresses = {one.chapter.file: f"#{one.chapter.name}" for one in contents}
    shown = [*(part for _, _, parts in chapters for part in parts), *glossary]
    data = {
        "views": {view.name: table(view, addresses) for view in views(shown)},
        "live": live and live_plot(live),
    }
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("contactbench.report", "page"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["inline"] = lambda text: inline(text, addresses)
    environment.filters["kind"] = lambda part: KINDS[type(part)]
    environment.filters["grouped"] = grouped
    return environment.get_template("page.html").render(
        css=source("page.css"),
        script="".join(map(source, SCRIPTS)),
        data=script_safe(data),
        chapters=chapters,
        live=live,
        runs=recorded,
        glossary=glossary,
        links=links or {},
    )


def source(name: str) -> str:
    """Return the text of a file of the page."""
    return files("contactbench.report.page").joinpath(name).read_text(encoding="utf-8")


def script_safe(data: Any) -> str:
    """Return JSON that may stand inside a script element."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c")
