"""Draws figures as data (`model.Figure`) with matplotlib; knows no question, no table and no method."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure as Drawn
from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator

from contactbench.report.drawing import Axis, Curve, Figure, Heat, Panel
from contactbench.report.look import ROLES, look

SHADED = "#f0f4ff"
PANEL = (4.5, 3.9)  #: inches
LEGEND_ROW = 0.22  #: inches
RC: dict[Any, Any] = {
    "figure.dpi": 110,
    "savefig.bbox": "tight",
    "font.size": 10,
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "svg.hashsalt": "contactbench",
    "svg.fonttype": "none",
}


def plain(text: str) -> str:
    """Inline Markdown without its marks: a figure has one face of type."""
    return re.sub(r"[`*]|\[([^]]*)\]\([^)]*\)", lambda found: found[1] or "", text)


# -- curves ----------------------------------------------------------------------------------------
def properties(curve: Curve) -> dict[str, Any]:
    """matplotlib line properties of a curve."""
    if curve.method:
        color, marker, filled = look(curve.method)
        face = color if filled else "white"
        style: dict[str, Any] = {
            "color": color, "marker": marker, "markerfacecolor": face, "markersize": 5.5, "linewidth": 1.3,
        }  # fmt: skip
    else:
        style = {
            "marker": "o",
            "markersize": 4,
            "linewidth": 1.2,
            **ROLES.get(curve.role, ROLES["reference"]),
        }
    if not curve.line:
        style["linestyle"] = ""
    elif curve.dashed:
        style["linestyle"] = "--"
    if not curve.markers:
        style["marker"] = ""
    if curve.emphasis:
        style |= {
            "linewidth": 1.9 * style.get("linewidth", 1.0),
            "markersize": 1.3 * style["markersize"],
            "zorder": 3,
        }
    return style


def add(axes: Axes, curve: Curve, three: bool) -> None:
    style = properties(curve)
    points = [curve.x, curve.y, curve.z] if three else [curve.x, curve.y]
    axes.plot(*points, markevery=curve.every, **style)
    if curve.low and not three:
        axes.vlines(curve.x, curve.low, curve.high, color=style["color"], linewidth=0.9, alpha=0.7)
    if curve.note and len(curve.x):
        axes.annotate(
            plain(curve.note), (curve.x[-1], curve.y[-1]), fontsize=8, color=style["color"],
            xytext=(4, 0), textcoords="offset points", va="center",
        )  # fmt: skip


def entries(curves: Iterable[Curve]) -> dict[str, Any]:
    """A line for the legend for each label, in the order met."""
    from matplotlib.lines import Line2D

    found: dict[str, Any] = {}
    for curve in curves:
        if curve.label and curve.label not in found:
            found[curve.label] = Line2D([], [], **properties(curve))
    return found


# -- panels ----------------------------------------------------------------------------------------
def put(axes: Axes, which: str, axis: Axis) -> None:
    """Label, scale, limits and ticks of one axis."""
    getattr(axes, f"set_{which}label")(plain(axis.label))
    if axis.scale == "log":
        getattr(axes, f"set_{which}scale")("log")
    if axis.limits is not None:
        low, high = axis.limits
        names = {"x": ("left", "right"), "y": ("bottom", "top")}.get(which, (f"{which}min", f"{which}max"))
        given = {name: value for name, value in zip(names, (low, high), strict=True) if value is not None}
        getattr(axes, f"set_{which}lim")(**given)
    if axis.ticks is not None:
        own = getattr(axes, f"{which}axis")
        own.set_major_locator(FixedLocator([value for value, _ in axis.ticks]))
        own.set_major_formatter(FixedFormatter([text for _, text in axis.ticks]))
        own.set_minor_locator(NullLocator())
    if axis.inverted:
        getattr(axes, f"invert_{which}axis")()


def draw_panel(figure: Drawn, axes: Axes, panel: Panel) -> None:
    three = panel.z is not None
    if panel.sphere:
        sphere(axes)
    for span in panel.spans:
        line = span.low == span.high
        shade = getattr(axes, f"ax{'h' if span.axis == 'y' else 'v'}{'line' if line else 'span'}")
        if line:
            shade(span.low, color="#bbbbbb", linewidth=0.9, zorder=0)
        else:
            shade(span.low, span.high, color=SHADED, zorder=0)
        if span.label:
            place = (0.02, span.high) if span.axis == "y" else (span.low, 0.98)
            transform = axes.get_yaxis_transform() if span.axis == "y" else axes.get_xaxis_transform()
            axes.text(*place, plain(span.label), transform=transform, color="#5566aa", fontsize=8, va="top")
    if panel.heat is not None:
        heat(figure, axes, panel.heat)
    for curve in panel.curves:
        add(axes, curve, three)
    put(axes, "x", panel.x)
    put(axes, "y", panel.y)
    if panel.z is not None:
        put(axes, "z", panel.z)
        axes.view_init(*panel.view)  # type: ignore[attr-defined]
        axes.set_box_aspect((1, 1, 1))  # type: ignore[arg-type]
    elif panel.equal:
        axes.set_aspect("equal", adjustable="datalim" if panel.heat is None else "box")
    for note in panel.notes:
        where = (note.x, note.y, note.z) if three else (note.x, note.y)
        axes.text(*where, plain(note.text), ha="center", va="center", fontsize=9)  # type: ignore[call-arg]
    axes.set_title(plain(panel.title))


def sphere(axes: Axes) -> None:
    """A faint wire sphere of radius one."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13))
    x, y, z = np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)
    axes.plot_wireframe(x, y, z, color="#dddddd", linewidth=0.4)  # type: ignore[attr-defined]


def heat(figure: Drawn, axes: Axes, data: Heat) -> None:
    values = np.array(data.values)
    limit = float(np.nanmax(np.abs(values))) or 1.0
    norm = TwoSlopeNorm(0.0, -limit, limit)
    image = axes.pcolormesh(data.x, data.y, values, cmap="RdBu_r", norm=norm, shading="nearest")
    if data.zero:
        axes.contour(data.x, data.y, values, [0.0], colors="#DDAA33", linewidths=4)
        axes.plot([], [], color="#DDAA33", linewidth=4, label=plain(data.zero))
    axes.grid(visible=False)
    figure.colorbar(image, ax=axes, label=plain(data.label), shrink=0.9)


# -- figures ---------------------------------------------------------------------------------------
def drawn(figure: Figure) -> Drawn:
    """A matplotlib figure."""
    with plt.rc_context(RC):
        across = max(1, min(figure.across, len(figure.panels)))
        down = -(-len(figure.panels) // across)
        shared = (
            entries(curve for panel in figure.panels for curve in panel.curves)
            if figure.legend == "shared"
            else {}
        )
        width = max(across * PANEL[0], 6.5)
        columns = max(1, int(width // 1.9))
        below = LEGEND_ROW * -(-len(shared) // columns)
        made = plt.figure(figsize=(width, down * PANEL[1] + 0.5 + below), layout="constrained")
        for i, panel in enumerate(figure.panels, start=1):
            kind = {"projection": "3d"} if panel.z is not None else {}
            axes = made.add_subplot(down, across, i, **kind)
            draw_panel(made, axes, panel)
            own = entries(panel.curves) if figure.legend == "each" else {}
            handles, labels = axes.get_legend_handles_labels()
            keyed = {plain(label): handle for label, handle in own.items()} | dict(
                zip(labels, handles, strict=True)
            )
            if keyed:
                axes.legend(list(keyed.values()), list(keyed), loc="best", fontsize=8)
        made.suptitle(plain(figure.title))
        if shared:
            labels = [plain(label) for label in shared]
            made.legend(list(shared.values()), labels, loc="outside lower center", ncols=columns, fontsize=9)
        return made


def save(figure: Figure, folder: Path) -> list[Path]:
    """Write FOLDER/NAME.svg and .png without timestamps, so that equal tables give equal files."""
    folder.mkdir(parents=True, exist_ok=True)
    made = drawn(figure)
    paths = [folder / f"{figure.name}.{kind}" for kind in ("svg", "png")]
    with plt.rc_context(RC):
        made.savefig(paths[0], metadata={"Date": None})
        made.savefig(paths[1], metadata={"Software": None})
    plt.close(made)
    return paths
