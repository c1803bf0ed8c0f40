"""Draws figures as data (`drawing.Figure`) with matplotlib; knows no question, no table and no method."""

from __future__ import annotations

import io
import math
import re
import textwrap
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure as Drawing
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedFormatter, FixedLocator, FuncFormatter, LogLocator, NullLocator

from contactbench.report.drawing import Axis, Curve, Figure, Heat, Panel, Span
from contactbench.report.look import MUTED, ROLES, look
from contactbench.report.numbers import SUPERSCRIPTS

#: inches: a figure's width by its panels in a row, the height of a panel
WIDTHS, HEIGHT = {1: 8.0, 2: 9.6, 3: 11.0}, 4.2
#: inches of a character of the title, between names in the margin, and of a line of title or legend
LETTER, APART, LINE = 0.1, 0.2, 0.24
#: a curve of more points than this has markers at some of them
MARKED = 16
OTHERS = "other methods"
#: the mark of a file that was made here
MADE_HERE = '<style id="contactbench">'
#: numbers with more digits than are seen
DIGITS = re.compile(r"-?\d+\.\d{3,}")
RC: dict[Any, Any] = {
    "font.size": 10.5,
    "axes.titlesize": 10.5,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.edgecolor": "#555555",
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 9.5,
    "legend.handlelength": 3,
    "figure.constrained_layout.w_pad": 0.08,
    "lines.scale_dashes": True,
    "svg.hashsalt": "contactbench",
    "svg.fonttype": "none",
}


# -- curves ----------------------------------------------------------------------------------------
def properties(curve: Curve) -> dict[str, Any]:
    """Return the matplotlib line properties of a curve."""
    if curve.muted:
        return {"color": MUTED, "linewidth": 0.8, "zorder": 1.5}
    if curve.method:
        own = look(curve.method, curve.family)
        style: dict[str, Any] = {
            "color": own.color,
            "marker": own.marker,
            "markerfacecolor": own.color if own.filled else "white",
            "markersize": 6,
            "linewidth": 1.5,
            "linestyle": (0, own.dash) if own.dash else "-",
        }
    else:
        style = {"marker": "o", "markersize": 4.5, "linewidth": 1.2, **ROLES[curve.role or "guide"]}
    if not curve.line:
        style["linestyle"] = ""
    if not curve.markers:
        style["marker"] = ""
    return style


def add(axes: Axes, curve: Curve, three: bool) -> None:
    """Draw one curve."""
    place = [curve.x, curve.y, curve.z] if three else [curve.x, curve.y]
    every = len(curve.x) // 8 if len(curve.x) > MARKED and curve.line else 1
    axes.plot(*place, markevery=every, **properties(curve))


def entries(curves: Iterable[Curve]) -> dict[str, Line2D]:
    """Return a line for the legend for each label, in the order met; the muted ones share one."""
    ordered = sorted(curves, key=lambda curve: curve.muted)
    named = {OTHERS if curve.muted else curve.label: curve for curve in ordered}
    return {label: Line2D([], [], **properties(curve)) for label, curve in named.items() if label}


def name_in_margin(axes: Axes, curves: Sequence[Curve]) -> None:
    """Write the name of each curve right of the axes, beside its last point where there is room."""
    ends = []
    for curve in curves:
        points = np.column_stack([curve.x, curve.y])
        places = axes.transLimits.transform(axes.transScale.transform(points))
        inside = np.flatnonzero((places >= 0).all(axis=1) & (places <= 1).all(axis=1))
        if curve.label and not curve.muted and len(inside):
            last = inside[np.argmax(places[inside, 0])]
            ends.append((places[last, 1], points[last], curve))
    heights = spread([height for height, _, _ in ends], APART / HEIGHT)
    for (_, point, curve), height in zip(ends, heights, strict=True):
        color = properties(curve)["color"]
        line = {"arrowstyle": "-", "color": color, "linewidth": 0.7, "alpha": 0.6, "shrinkB": 4, "shrinkA": 1}
        place: dict[str, Any] = {"xytext": (1.03, height), "textcoords": "axes fraction", "va": "center"}
        axes.annotate(curve.label, point, **place, color=color, arrowprops=line, gid="name")
    if any(curve.muted for curve in curves):
        axes.text(1.03, -0.06, f"grey: {OTHERS}", transform=axes.transAxes, fontsize=9, color="#777777")


def spread(heights: Sequence[float], gap: float) -> list[float]:
    """Return heights that are at least `gap` apart and below one, in the same order, moved as little as is simple."""
    placed = np.array(heights, dtype=float)
    order = np.argsort(placed, kind="stable")
    for below, above in pairwise(order):
        placed[above] = max(placed[above], placed[below] + gap)
    ceiling = 1.0
    for i in order[::-1]:
        placed[i] = min(placed[i], ceiling)
        ceiling = placed[i] - gap
    return placed.tolist()


# -- panels ----------------------------------------------------------------------------------------
def power(value: float) -> str:
    """Return a tick of a logarithmic axis in words: 0.5, 20, 10⁻⁶, 2·10⁵."""
    k = math.floor(math.log10(value) + 1e-9)
    part = float(f"{value / 10.0**k:.2g}")
    if abs(k) < 2:
        return f"{value:.3g}"
    whole = "10" + str(k).translate(SUPERSCRIPTS)
    return whole if part == 1 else f"{part:g}·{whole}"


def seen(panel: Panel, which: str) -> list[float]:
    """Return what a panel has on one axis where both axes allow it."""

    def inside(axis: Axis, v: float) -> bool:
        low, high = axis.within
        finite = math.isfinite(v) and (v > 0 or not axis.log)
        return finite and (low is None or v >= low) and (high is None or v <= high)

    values = list(getattr(panel.heat, which)) if panel.heat else []
    for curve in panel.curves:
        for x, y in zip(curve.x, curve.y, strict=True):
            if inside(panel.x, x) and inside(panel.y, y):
                values.append(x if which == "x" else y)
    return values


def scale(axes: Axes, which: str, axis: Axis, values: Sequence[float]) -> None:
    """Label, scale, limits and ticks of one axis."""
    getattr(axes, f"set_{which}label")(axis.label)
    own = getattr(axes, f"{which}axis")
    if axis.log:
        getattr(axes, f"set_{which}scale")("log")
    if values or axis.limits:
        size, back = (math.log10, lambda v: 10.0**v) if axis.log else (float, float)
        low, high = (size(end(values)) for end in (min, max)) if values else (0.0, 1.0)
        pad = max(0.04 * (high - low), 0.1 if axis.log else 1e-12) or 0.5
        first, last = axis.limits or (None, None)
        ends = back(low - pad) if first is None else first, back(high + pad) if last is None else last
        getattr(axes, f"set_{which}lim")(*ends)
        if axis.log:
            narrow = math.log10(ends[1] / ends[0]) < 2
            own.set_major_locator(LogLocator(10, (1, 2, 5) if narrow else (1,), numticks=9))
            own.set_major_formatter(FuncFormatter(lambda value, _: power(value)))
            own.set_minor_locator(NullLocator())
    if axis.ticks is not None:
        own.set_major_locator(FixedLocator([value for value, _ in axis.ticks]))
        own.set_major_formatter(FixedFormatter([text for _, text in axis.ticks]))
    if axis.inverted:
        getattr(axes, f"invert_{which}axis")()


def draw_panel(axes: Any, panel: Panel) -> None:
    """Draw one panel."""
    three = panel.z is not None
    if panel.sphere:
        sphere(axes)
    if panel.heat is not None:
        heat(axes, panel.heat)
    for curve in panel.curves:
        add(axes, curve, three)
    free = panel.equal and panel.heat is None  # the aspect decides
    scale(axes, "x", panel.x, [] if free else seen(panel, "x"))
    scale(axes, "y", panel.y, [] if free else seen(panel, "y"))
    for span in panel.spans:
        shade(axes, span)
    if panel.z is not None:
        scale(axes, "z", panel.z, ())
        axes.view_init(*panel.view)
        axes.set_box_aspect((1, 1, 1), zoom=0.9)
    elif panel.equal:
        axes.set_aspect("equal", adjustable="datalim" if panel.heat is None else "box")
    axes.set_title(panel.title, loc="left")


def shade(axes: Axes, span: Span) -> None:
    """Draw a horizontal band, and its label in its first corner where enough of it is seen."""
    axes.axhspan(span.low, span.high, zorder=0, color="#f0f4ff")
    top = axes.transAxes.inverted().transform(axes.transData.transform((1.0, span.high)))[1]
    if 0.08 < top < 1:
        style: dict[str, Any] = {"color": "#5566aa", "fontsize": 9, "va": "top"}
        axes.text(0.01, span.high, span.label, transform=axes.get_yaxis_transform(), **style)


def sphere(axes: Any) -> None:
    """Draw a faint wire sphere of radius one."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 17), np.linspace(0, np.pi, 9))
    axes.plot_wireframe(
        np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v), color="#dddddd", linewidth=0.4
    )


def heat(axes: Axes, data: Heat) -> None:
    """Draw a colour map, with the contour where its values are zero."""
    values = np.array(data.values)
    limit = float(np.nanmax(np.abs(values))) or 1.0
    style: dict[str, Any] = {"cmap": "RdBu_r", "norm": TwoSlopeNorm(0.0, -limit, limit), "rasterized": True}
    image = axes.pcolormesh(data.x, data.y, values, shading="nearest", **style)
    if np.nanmin(values) < 0 < np.nanmax(values):
        axes.contour(data.x, data.y, values, [0.0], colors="#DDAA33", linewidths=4)
    axes.grid(visible=False)
    axes.figure.colorbar(image, ax=axes, label=data.label, shrink=0.9)


# -- figures ---------------------------------------------------------------------------------------
def render(figure: Figure) -> Drawing:
    """Return a matplotlib figure."""
    panels = figure.panels
    across = min(figure.across, len(panels))
    down = -(-len(panels) // across)
    width = WIDTHS[across]
    title = textwrap.fill(figure.title, int(width / LETTER))
    legend = entries(curve for panel in panels for curve in panel.curves)
    margin = len(panels) == 1 and not panels[0].equal and all(curve.line for curve in panels[0].curves)
    columns = max(1, int(width / (0.8 + LETTER * max(map(len, legend), default=1))))
    rows = 0 if margin or figure.legend == "each" else -(-len(legend) // columns)
    height = down * min(HEIGHT, 0.8 * width / across) + LINE * (title.count("\n") + 1 + rows)
    with plt.rc_context(RC):
        drawing = plt.figure(figsize=(width, height), layout="constrained")
        drawing.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
        for i, panel in enumerate(panels):
            axes = drawing.add_subplot(down, across, i + 1, projection="3d" if panel.z is not None else None)
            draw_panel(axes, panel)
            own = entries(panel.curves)
            if figure.legend == "each":
                axes.legend(own.values(), own.keys(), fontsize=9)
            elif margin:
                name_in_margin(axes, panel.curves)
        if rows:
            drawing.legend(legend.values(), legend.keys(), loc="outside lower left", ncols=columns)
    return drawing


def svg(figure: Figure) -> str:
    """Return a figure as SVG text without dates, comments and digits that nobody sees."""
    drawing, file = render(figure), io.StringIO()
    with plt.rc_context(RC):
        drawing.savefig(file, format="svg", metadata={"Date": None})
    plt.close(drawing)
    text = re.sub(r"\s*<metadata>.*?</metadata>|\s*<!--.*?-->", "", file.getvalue(), flags=re.DOTALL)
    text = re.sub("<[^>]*>", lambda tag: DIGITS.sub(shortened, tag[0]), text)
    styles: dict[str, str] = {}
    text = re.sub(
        r'style="([^"]*)"', lambda style: f'class="{styles.setdefault(style[1], f"s{len(styles)}")}"', text
    )
    rules = "".join(f".{name}{{{style}}}" for style, name in styles.items())
    return text.replace("<defs>", f"{MADE_HERE}{rules}</style>\n <defs>", 1)


def shortened(number: re.Match[str]) -> str:
    """Return a number with two decimals: hundredths of a point."""
    return f"{float(number[0]):.2f}".rstrip("0").rstrip(".")


def save(figure: Figure, folder: Path, png: bool = False) -> list[Path]:
    """Write FOLDER/NAME.svg, and NAME.png where that is wanted; return the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{figure.name}.svg"]
    paths[0].write_text(svg(figure), encoding="utf-8")
    if png:
        paths.append(folder / f"{figure.name}.png")
        drawing = render(figure)
        drawing.savefig(paths[1], dpi=110, metadata={"Software": None})
        plt.close(drawing)
    return paths
