"""Draws figures as data (`drawing.Figure`) with matplotlib; knows no question, no table and no method."""

from __future__ import annotations

import io
import math
import re
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from contactbench.report.drawing import Axis, Curve, Field, Figure, Panel
from contactbench.report.look import DASHES, LOOK, ROLES, look
from contactbench.report.numbers import SUPERSCRIPTS

#: inches: a figure's width by its panels in a row, the height of a panel
WIDTHS, HEIGHT = {1: 8.0, 2: 9.6, 3: 11.0}, 4.2
#: inches of a character of the title, between names in the margin, and of a line of title or legend
LETTER, APART, LINE = 0.1, 0.2, 0.24
#: a curve of more points than this has markers at some of them; so many points without a line are drawn as a picture
MARKED, MANY = 16, 150
#: the mark of a file that was made here
MADE_HERE = '<style id="contactbench">'
#: numbers with more digits than are seen: of points, hundredths are, of a path of straight lines tenths
DIGITS = re.compile(r"-?\d+\.\d{3,}")
FRACTION, PATH = re.compile(r"-?\d+\.\d+"), re.compile(r'(?<= d=")M [^"]*')
#: what says nothing: dates, comments, indentation, names of groups that nothing refers to, turns by nothing
IDLE = re.compile(
    r"\s*<metadata>.*?</metadata>|\s*<!--.*?-->|(?<=\n) +|(?<=<g) id=\"[\w.]+_\d+\"| transform=\"rotate\(-0 [^)]*\)\"",
    re.DOTALL,
)
RC = LOOK["rc"]


# -- curves ----------------------------------------------------------------------------------------
def properties(curve: Curve) -> dict[str, Any]:
    if curve.method:
        own = look(curve.method, curve.family)
        style: dict[str, Any] = {
            "color": own.color,
            "marker": own.marker,
            "markerfacecolor": own.color if own.family == "contact" else "white" if curve.line else "none",
            "markersize": 6 if curve.line else 7.5,
            "linewidth": 1.5,
            "linestyle": (0, DASHES[own.order]) if own.order in DASHES else "-",
        }
    else:
        style = {"marker": "o", "markersize": 4.5, "linewidth": 1.2, **ROLES[curve.role or "guide"]}
    if not curve.line:
        style["linestyle"] = ""
    if not curve.markers:
        style["marker"] = ""
    return style


def entries(curves: Iterable[Curve]) -> dict[str, Line2D]:
    return {curve.label: Line2D([], [], **properties(curve)) for curve in curves if curve.label}


def name_in_margin(axes: Axes, curves: Sequence[Curve]) -> None:
    ends = []
    for curve in curves:
        points = np.column_stack([curve.x, curve.y])
        places = axes.transLimits.transform(axes.transScale.transform(points))
        inside = np.flatnonzero((places >= 0).all(axis=1) & (places <= 1).all(axis=1))
        if curve.label and len(inside):
            last = inside[np.argmax(places[inside, 0])]
            ends.append((places[last, 1], points[last], curve))
    ends.sort(key=lambda end: end[0])
    for (_, point, curve), height in zip(ends, spread([end[0] for end in ends], APART / HEIGHT), strict=True):
        color = properties(curve)["color"]
        line = {"arrowstyle": "-", "color": color, "linewidth": 0.7, "alpha": 0.6, "shrinkB": 4, "shrinkA": 1}
        place: dict[str, Any] = {"xytext": (1.03, height), "textcoords": "axes fraction", "va": "center"}
        axes.annotate(curve.label, point, **place, color=color, arrowprops=line, gid="name")


def spread(heights: Sequence[float], gap: float) -> np.ndarray:
    """Return rising heights at least `gap` apart and below one, moved as little as a simple rule allows."""
    below = gap * np.arange(len(heights))
    rising = np.maximum.accumulate(np.array(heights) - below) + below
    return np.asarray(np.minimum(rising, 1 - below[::-1]))


# -- panels ----------------------------------------------------------------------------------------
def power(value: float) -> str:
    """Return a tick of a logarithmic axis in words: 0.5, 20, 10⁻⁶, 2·10⁵."""
    k = math.floor(math.log10(value) + 1e-9)
    part = float(f"{value / 10.0**k:.2g}")
    if abs(k) < 2:
        return f"{value:.3g}"
    whole = "10" + str(k).translate(SUPERSCRIPTS)
    return whole if part == 1 else f"{part:g}·{whole}"


def seen(panel: Panel) -> list[tuple[float, float]]:
    def inside(axis: Axis, v: float) -> bool:
        low, high = axis.within
        return math.isfinite(v) and (v > 0 or axis.scale == "linear") and low <= v <= high

    drawn: list[Curve | Field] = [*panel.curves, *panel.fields]
    points = [point for one in drawn for point in zip(one.x, one.y, strict=True)]
    return [(x, y) for x, y in points if inside(panel.x, x) and inside(panel.y, y)]


def scale(axes: Axes, which: str, axis: Axis, values: Sequence[float]) -> None:
    getattr(axes, f"set_{which}label")(axis.label)
    getattr(axes, f"set_{which}scale")(axis.scale)
    if axis.scale == "log" and values:
        room = 10 ** max(0.04 * math.log10(max(values) / min(values)), 0.1)
        low, high = min(values) / room, max(values) * room
        getattr(axes, f"set_{which}lim")(low, high)
        own = getattr(axes, f"{which}axis")
        own.set_major_locator(LogLocator(10, (1, 2, 5) if high / low < 100 else (1,), numticks=9))
        own.set_major_formatter(FuncFormatter(lambda value, _: power(value)))
        own.set_minor_locator(NullLocator())
    if axis.inverted:
        getattr(axes, f"invert_{which}axis")()


def draw_field(axes: Axes, field: Field) -> None:
    color, (left, right), (low, high) = look(field.method).color, field.x, field.y
    axes.fill([left, right, right, left], [low, low, high, high], color=color, alpha=0.1, linewidth=0)
    axes.plot([left, right, right, left, left], [low, low, high, high, low], color="white", linewidth=2)
    middle = math.sqrt(left * right), math.sqrt(low * high)
    axes.text(*middle, field.words, color=color, fontsize=8, ha="center", va="center")


def draw_panel(axes: Axes, panel: Panel) -> None:
    for curve in panel.curves:
        every = len(curve.x) // 8 if len(curve.x) > MARKED and curve.line else 1
        picture = not curve.line and len(curve.x) > MANY
        axes.plot(curve.x, curve.y, markevery=every, rasterized=picture, **properties(curve))
    for field in panel.fields:
        draw_field(axes, field)
    points = [] if panel.equal else seen(panel)  # the aspect decides
    scale(axes, "x", panel.x, [x for x, _ in points])
    scale(axes, "y", panel.y, [y for _, y in points])
    for span in panel.spans:
        axes.axhspan(span.low, span.high, zorder=0, color="#f0f4ff")
        style: dict[str, Any] = {"color": "#5566aa", "fontsize": 9, "va": "top", "clip_on": True}
        axes.text(0.01, span.high, span.label, transform=axes.get_yaxis_transform(), **style)
    if panel.equal:
        axes.set_aspect("equal", adjustable="datalim")
    axes.set_title(panel.title, loc="left")


# -- figures ---------------------------------------------------------------------------------------
def render(figure: Figure) -> Drawing:
    panels = figure.panels
    across = min(figure.across, len(panels))
    down = -(-len(panels) // across)
    width = WIDTHS[across]
    title = textwrap.fill(figure.title, int(width / LETTER) - 4)  # some renderers have wider letters
    legend = entries(curve for panel in panels for curve in panel.curves)
    margin = len(panels) == 1 and not panels[0].equal and all(curve.line for curve in panels[0].curves)
    columns = max(1, int(width / (0.8 + LETTER * max(map(len, legend), default=1))))
    rows = 0 if margin else -(-len(legend) // columns)
    height = down * min(HEIGHT, 0.8 * width / across) + LINE * (title.count("\n") + 1 + rows)
    with plt.rc_context(RC):
        drawing = plt.figure(figsize=(width, height), layout="constrained")
        drawing.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
        for i, panel in enumerate(panels):
            axes = drawing.add_subplot(down, across, i + 1)
            draw_panel(axes, panel)
            if margin:
                name_in_margin(axes, panel.curves)
        if rows:
            drawing.legend(legend.values(), legend.keys(), loc="outside lower left", ncols=columns)
    return drawing


def short_path(path: re.Match[str]) -> str:
    """Return a path on one line, lines after a move without their letter."""
    text = " ".join(path[0].split())
    if "C" in text or "Q" in text:
        return text
    return FRACTION.sub(lambda digits: f"{float(digits[0]):.1f}".removesuffix(".0"), text.replace(" L ", " "))


def svg(figure: Figure) -> str:
    drawing, file = render(figure), io.StringIO()
    with plt.rc_context(RC):
        drawing.savefig(file, format="svg", metadata={"Date": None})
    plt.close(drawing)
    text = IDLE.sub("", file.getvalue())
    text = PATH.sub(short_path, text)
    text = re.sub(
        "<[^>]*>", lambda tag: DIGITS.sub(lambda digits: f"{round(float(digits[0]), 2):g}", tag[0]), text
    )
    styles: dict[str, str] = {}
    text = re.sub(
        r'style="([^"]*)"', lambda style: f'class="{styles.setdefault(style[1], f"s{len(styles)}")}"', text
    )
    rules = "".join(f".{name}{{{style}}}" for style, name in styles.items())
    return text.replace("<defs>", f"{MADE_HERE}{rules}</style>\n <defs>", 1)
