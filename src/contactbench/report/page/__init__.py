"""``report.html``: all rooms on one page that needs no network.

A renderer of `model`: it knows no question, no table and no method.  What a number looks like was decided when
its cell was made; the script draws figures from the same data as matplotlib does, and formats only what it
alone knows (ticks, and the numbers of a point that is pointed at).

Our own drawing code rather than a library: Plotly's basic bundle is 1.07 MB of script beside the data and took
15 s to draw 40 panels with 910 of these curves where this script took 4 s for 65 panels with 991 (one loaded
machine, Chromium).  It neither walks along points by keyboard nor follows the reader's colour scheme without being
drawn anew, and names at curves that avoid each other would be ours to write there too.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from itertools import groupby
from typing import Any

import jinja2
import numpy as np
from matplotlib.colors import to_hex, to_rgb
from matplotlib.markers import MarkerStyle
from matplotlib.path import Path as Outline

from contactbench.report.chapters import Contents, Section, Text, figures, slug
from contactbench.report.drawing import Axis, Curve, Figure, Panel
from contactbench.report.look import DARK_PAPER, METHODS, ROLES, look
from contactbench.report.page.words import breakable, inline, plain, runs
from contactbench.report.views import Cell, View

#: contrast a line must have on the dark page (WCAG 2.2, 1.4.3; graphical objects need 3)
CONTRAST = 4.5
#: rows beyond which a table gets a field to filter it
FILTERED = 8
#: colours of a heat map for −limit … limit, stable to unstable
COLD, HOT = "#2166ac", "#b2182b"


# -- looks -----------------------------------------------------------------------------------------
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


@dataclass(frozen=True)
class Style:
    """How a method or a role is drawn on the page."""

    light: str
    dark: str
    marker: str
    hollow: bool = False
    width: float = 1.5
    dash: str = ""


def style(name: str, family: str = "") -> Style:
    """The style of "method NAME", of a family it declares itself, or of "role NAME"."""
    kind, _, name = name.partition(" ")
    if kind == "method":
        own = look(name, family)
        dash = " ".join(f"{1.5 * part:g}" for part in own.dash)
        return Style(own.color, own.dark, outline(own.marker), not own.filled, dash=dash)
    role = ROLES.get(name, ROLES["reference"])
    color = to_hex(role["color"])
    return Style(color, lightened(color), outline(role.get("marker", "o")), width=role.get("linewidth", 1.2))


def key(curve: Curve) -> str:
    return f"method {curve.method}" if curve.method else f"role {curve.role or 'reference'}"


# -- figures as JSON -------------------------------------------------------------------------------
def rounded(values: Iterable[float]) -> list[float | None]:
    """JSON numbers; five digits are more than a figure shows, nan and infinity are gaps."""
    return [float(f"{v:.5g}") if math.isfinite(v) else None for v in values]


def axis(of: Axis) -> dict[str, Any]:
    out: dict[str, Any] = {"label": plain(of.label), "log": of.scale == "log", "inverted": of.inverted}
    if of.limits:
        out["limits"] = of.limits
    if of.ticks:
        out["ticks"] = of.ticks
    if of.within != (None, None):
        out["within"] = of.within
    if any(level for _, level in runs(of.label)):
        out["runs"] = runs(of.label)
    if of.key:
        out["key"] = of.key
    if of.others:
        out["others"] = [axis(other) for other in of.others]
    return out


def curve(of: Curve) -> dict[str, Any]:
    """What differs from the usual, so that the page stays small."""
    out: dict[str, Any] = {"style": key(of), "x": rounded(of.x), "y": rounded(of.y)}
    texts = {"label": plain(of.label), "method": of.method, "note": plain(of.note), "hints": of.hints}
    switches = {
        "dashed": of.dashed or ROLES.get(of.role, {}).get("linestyle", "-") != "-",
        "emphasis": of.emphasis,
        "muted": of.muted,
        "also": {name: rounded(values) for name, values in of.also},
    }
    out |= {name: value for name, value in (texts | switches).items() if value}
    out |= {name: False for name in ("line", "markers") if not getattr(of, name)}
    if of.every > 1:
        out["every"] = of.every
    if of.low:
        out |= {"low": rounded(of.low), "high": rounded(of.high)}
    return out


def flattened(panel: Panel) -> Panel:
    """A three-dimensional panel seen from its viewpoint, orthographically."""
    e, a = np.radians(panel.view)
    across = np.array([-np.sin(a), np.cos(a), 0.0])
    up = np.array([-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)])

    def seen(*points: Sequence[float]) -> tuple[tuple[float, ...], tuple[float, ...]]:
        return tuple((across @ np.array(points)).tolist()), tuple((up @ np.array(points)).tolist())

    def projected(curve: Curve) -> Curve:
        x, y = seen(curve.x, curve.y, curve.z)
        return replace(curve, x=x, y=y, z=())

    def arrow(i: int, label: str) -> Curve:
        x, y = seen(*((0.0, 1.15 * (i == k)) for k in range(3)))
        return Curve(x, y, note=label, role="reference", markers=False)

    frame = [arrow(i, own.label) for i, own in enumerate((panel.x, panel.y, panel.z)) if own is not None]
    if panel.sphere:
        turn = np.linspace(0, 2 * np.pi, 73)
        frame.append(
            Curve(tuple(np.cos(turn).tolist()), tuple(np.sin(turn).tolist()), role="flow", markers=False)
        )
    places = [seen((n.x,), (n.y,), (n.z,)) for n in panel.notes]
    notes = tuple(replace(n, x=x[0], y=y[0]) for n, (x, y) in zip(panel.notes, places, strict=True))
    curves = (*frame, *map(projected, panel.curves))
    nothing = Axis("", limits=(-1.3, 1.3), ticks=((0.0, ""),))
    return replace(panel, curves=curves, notes=notes, x=nothing, y=nothing, z=None, equal=True)


def panel(of: Panel) -> dict[str, Any]:
    if of.z is not None:
        of = flattened(of)
    out: dict[str, Any] = {
        "title": plain(of.title), "x": axis(of.x), "y": axis(of.y), "curves": [curve(c) for c in of.curves],
    }  # fmt: skip
    if any(level for _, level in runs(of.title)):
        out["runs"] = runs(of.title)
    if of.equal:
        out["equal"] = True
    if of.remark:
        out["remark"] = of.remark
    if of.spans:
        out["spans"] = [[s.axis, *rounded((s.low, s.high)), plain(s.label)] for s in of.spans]
    if of.notes:
        out["notes"] = [[*rounded((n.x, n.y)), plain(n.text)] for n in of.notes]
    if of.heat:
        values = np.array(of.heat.values)
        limit = float(np.nanmax(np.abs(values))) or 1.0
        out["heat"] = {
            "x": rounded(of.heat.x), "y": rounded(of.heat.y), "label": f"{plain(of.heat.label)} (± {limit:.3g})",
            "colors": [[shade(v / limit) for v in row] for row in values.tolist()],
        }  # fmt: skip
        out.setdefault("remark", f"colour: {out['heat']['label']}")
    return out


def shade(value: float) -> str:
    """White at 0, `HOT` at 1, `COLD` at −1."""
    end = to_rgb(HOT if value > 0 else COLD)
    part = min(1.0, abs(value)) if math.isfinite(value) else 0.0
    red, green, blue = (1 + (c - 1) * part for c in end)
    return to_hex((red, green, blue))


def figure(of: Figure) -> dict[str, Any]:
    return {"title": plain(of.title), "panels": [panel(p) for p in of.panels], "own": of.legend == "each"}


# -- parts -----------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Choice:
    """Neighbouring sections that are alternatives; one is shown at a time."""

    name: str
    sections: tuple[Section, ...]


def grouped(parts: Iterable[Any]) -> list[Any]:
    """The parts, alternatives next to each other made one `Choice`."""
    out: list[Any] = []
    for part in parts:
        wanted = part.choice if isinstance(part, Section) else ""
        if wanted and out and isinstance(out[-1], Choice) and out[-1].name == wanted:
            out[-1] = Choice(wanted, (*out[-1].sections, part))
        else:
            out.append(Choice(wanted, (part,)) if wanted else part)
    return out


def kind(part: Any) -> str:
    """What the template calls a part."""
    return {Text: "text", View: "view", Figure: "figure", Section: "section", Choice: "choice"}[type(part)]


def neighbours(columns: Iterable[Any]) -> list[tuple[str, int]]:
    """Labels of neighbouring columns of one group, and how many there are."""
    return [(label, len(list(some))) for label, some in groupby(columns, key=lambda head: head.group)]


def listed(value: Any) -> str:
    """A recorded value in words."""
    return (
        ", ".join(f"{k} {v}".strip() for k, v in value.items()) if isinstance(value, Mapping) else str(value)
    )


def cell_class(cell: Cell) -> str:
    return cell.mark.value if cell.mark else ""


# -- the page --------------------------------------------------------------------------------------
#: where readers go from here: documents beside the page, and the source above it
LINKS = {
    "results as text": "README.md", "the paper and its claims": "claims.md", "glossary": "glossary.md",
    "source": "../README.md",
}  # fmt: skip


def page(
    said: Sequence[Contents], recorded: Sequence[Mapping[str, Any]], glossary: Sequence[Any] = (),
    links: Mapping[str, str] | None = None,
) -> str:  # fmt: skip
    """The HTML text.

    recorded : the runs that made the tables.  glossary : parts of a last section.  links : name → address.
    """
    drawn = {f.name: f for one in said for f in figures(one.parts)}
    styles = {key(c): style(key(c), c.family) for f in drawn.values() for p in f.panels for c in p.curves}
    styles |= {f"method {name}": style(f"method {name}") for name in METHODS}
    styles |= {"role reference": style("role reference"), "role flow": style("role flow")}
    numbers = {name: i for i, name in enumerate(styles)}
    payload = {
        "figures": {name: figure(f) for name, f in drawn.items()},
        "styles": {name: {"n": numbers[name], "marker": s.marker, "hollow": s.hollow, "width": s.width, "dash": s.dash}
                   for name, s in styles.items()},
    }  # fmt: skip
    addresses = {one.chapter.file: f"#{one.chapter.name}" for one in said}
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("contactbench.report", "page"), autoescape=True, trim_blocks=True,
        lstrip_blocks=True, undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    environment.filters |= {
        "inline": lambda text: inline(text, addresses),
        "plain": plain,
        "kind": kind,
        "grouped": grouped,
        "groupby_neighbours": neighbours,
        "look": cell_class,
        "breakable": breakable,
        "listed": listed,
        "slug": slug,
    }
    return environment.get_template("page.html").render(
        css=source("page.css"), script="".join(map(source, SCRIPTS)), payload=script_safe(payload), styles=styles,
        numbers=numbers, said=said, runs=recorded, filtered=FILTERED,
        glossary=glossary, links=links or {},
    )  # fmt: skip


#: in the order they stand in the page
SCRIPTS = ("state.js", "scales.js", "figures.js", "page.js")


def source(name: str) -> str:
    return files("contactbench.report.page").joinpath(name).read_text(encoding="utf-8")


def script_safe(payload: Any) -> str:
    """JSON that may stand inside a script element."""
    text = json.dumps(payload, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c")
