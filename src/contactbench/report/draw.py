"""Draws figures as data (`drawing.Figure`) with matplotlib; knows no question, no table and no method.

The layout is ours (inches around every panel), so that a figure is drawn once for each file and its labels know
where they stand.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import re
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure as Drawn
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedFormatter, FixedLocator, MaxNLocator, NullLocator
from matplotlib.transforms import Bbox

from contactbench.report import labels
from contactbench.report.drawing import Axis, Curve, Figure, Heat, Panel, Span
from contactbench.report.look import MUTED, ROLES, look
from contactbench.report.scales import decades, points, spanned

SHADED = "#f0f4ff"
#: inches around a panel: left, right, below, above; heads of figures, rows of the legend
AROUND = (0.78, 0.16, 0.58, 0.3)
REMARK, TITLE, LEGEND_ROW, HANDLE, LETTER, BAR = 0.17, 0.34, 0.24, 0.7, 0.075, 0.8
#: the height of the label of a span; first digits of the ticks of a linear axis
TAG, STEPS = 0.16, (1, 2, 2.5, 5, 10)
#: figures that are worth starting processes for
FEWEST_FOR_PROCESSES = 8
OTHERS = "other methods"
#: behind a name
BEHIND = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 0.6}
RC: dict[Any, Any] = {
    "figure.dpi": 110,
    "font.size": 10,
    "axes.titlesize": 11,
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "lines.scale_dashes": True,
    "mathtext.fontset": "dejavusans",
    "svg.hashsalt": "contactbench",
    "svg.fonttype": "none",
}


def plain(text: str) -> str:
    """Inline Markdown without its marks, mathtext as it is: a figure has one face of type."""
    parts = text.split("$")
    parts[::2] = [
        re.sub(r"[`*]|\[([^]]*)\]\([^)]*\)", lambda found: found[1] or "", part) for part in parts[::2]
    ]
    return "$".join(parts)


# -- curves ----------------------------------------------------------------------------------------
def properties(curve: Curve) -> dict[str, Any]:
    """matplotlib line properties of a curve."""
    if curve.muted:
        return {"color": MUTED, "linewidth": 0.7, "zorder": 1.5}
    if curve.method:
        own = look(curve.method, curve.family)
        style: dict[str, Any] = {
            "color": own.color, "marker": own.marker, "markerfacecolor": own.color if own.filled else "white",
            "markersize": 5.5, "linewidth": 1.4, "linestyle": (0, own.dash) if own.dash else "-",
        }  # fmt: skip
    else:
        own_role = ROLES.get(curve.role, ROLES["reference"])
        style = {"marker": "o", "markersize": 4, "linewidth": 1.2, **own_role}
    if not curve.line:
        style["linestyle"] = ""
    elif curve.dashed:
        style["linestyle"] = "--"
    if not curve.markers:
        style["marker"] = ""
    if curve.emphasis:
        style |= {"linewidth": 1.9 * style["linewidth"], "markersize": 1.3 * style["markersize"], "zorder": 3}
    return style


def add(axes: Axes, curve: Curve, three: bool) -> None:
    style = properties(curve)
    place = [curve.x, curve.y, curve.z] if three else [curve.x, curve.y]
    axes.plot(*place, markevery=curve.every, **style)
    if curve.low and not three and not curve.muted:
        axes.vlines(curve.x, curve.low, curve.high, color=style["color"], linewidth=1.1, alpha=0.7)


def named(curve: Curve, methods: bool) -> str:
    """What is written at a curve: the name of its method, and its note; below it if in parentheses."""
    name, note = curve.label if curve.method and methods else "", curve.note
    return f"{name}{chr(10) if note.startswith('(') else ' '}{note}".strip()


def written(axes: Axes, panel: Panel, methods: bool) -> set[str]:
    """Write notes, and names where `methods`, at the curves; the labels that found a place."""
    renderer = axes.figure.canvas.get_renderer()  # type: ignore[attr-defined]
    inside = axes.bbox
    frame = labels.Box(inside.x0 + 3, inside.y0 + 3, inside.x1 - 3, inside.y1 - 3)
    lines, faint, words = [], [], []
    for curve in panel.curves:
        line = axes.transData.transform(np.column_stack([curve.x, curve.y]).astype(float))
        out = (line[:, 0] < frame.left - 3) | (line[:, 0] > frame.right + 3)
        line[out | (line[:, 1] < frame.bottom - 3) | (line[:, 1] > frame.top + 3)] = np.nan
        if curve.muted:
            faint.append(line)
        else:
            lines.append(line)
            words.append((curve, plain(named(curve, methods))))
    artists = [
        axes.text(
            0, 0, text, fontsize=8, color=properties(curve)["color"], gid="name", linespacing=1.0, bbox=BEHIND
        )
        if text
        else None
        for curve, text in words
    ]
    taken = [
        labels.Box(*box.extents)
        for text in axes.texts
        if text.get_gid() != "name" and (box := text.get_window_extent(renderer))
    ]
    sizes = [
        (box.width, box.height) if artist and (box := artist.get_window_extent(renderer)) else None
        for artist in artists
    ]
    done = set()
    found = labels.places(frame, lines, sizes, faint, taken)
    for (curve, _), artist, place in zip(words, artists, found, strict=True):
        if artist is None:
            continue
        if place is None:
            artist.remove()
            continue
        at = axes.transAxes.inverted().transform((place.left, place.bottom))
        artist.set(position=at, transform=axes.transAxes, va="bottom", ha="left")
        if methods:
            done.add(curve.label)
    return done


def entries(curves: Iterable[Curve]) -> dict[str, Any]:
    """A line for the legend for each label, in the order met; the muted ones share one."""
    found: dict[str, Any] = {}
    muted = {}
    for curve in curves:
        if curve.muted:
            muted = {OTHERS: Line2D([], [], **properties(curve))}
        elif curve.label and curve.label not in found:
            found[curve.label] = Line2D([], [], **properties(curve))
    return found | muted


# -- panels ----------------------------------------------------------------------------------------
def put(axes: Axes, which: str, axis: Axis, values: Iterable[float], inches: float) -> None:
    """Label, scale, limits and ticks of one axis; no more ticks than its length has room for."""
    getattr(axes, f"set_{which}label")(plain(axis.label))
    own, log = getattr(axes, f"{which}axis"), axis.scale == "log"
    ticks = axis.ticks
    if log:
        getattr(axes, f"set_{which}scale")("log")
    if log or axis.limits or axis.within != (None, None):
        low, high = spanned(axis, values)
        getattr(axes, f"set_{which}lim")(low, high)
        if log and ticks is None:
            ticks = tuple(decades(low, high, inches / (0.45 if which == "x" else 0.3)))
    if ticks is None and not log and which != "z":
        own.set_major_locator(MaxNLocator(max(3, int(inches / (0.62 if which == "x" else 0.3))), steps=STEPS))
        own.get_major_formatter().set_useMathText(True)
    if ticks is not None:
        own.set_major_locator(FixedLocator([value for value, _ in ticks]))
        own.set_major_formatter(FixedFormatter([text for _, text in ticks]))
        own.set_minor_locator(NullLocator())
    if axis.inverted:
        getattr(axes, f"invert_{which}axis")()


def draw_panel(figure: Drawn, axes: Axes, panel: Panel, size: tuple[float, float]) -> None:
    three = panel.z is not None
    if panel.sphere:
        sphere(axes)
    if panel.heat is not None:
        heat(figure, axes, panel.heat)
    for curve in panel.curves:
        add(axes, curve, three)
    put(axes, "x", panel.x, points(panel.curves, "x", panel.y, "y"), size[0])
    put(axes, "y", panel.y, points(panel.curves, "y", panel.x, "x"), size[1])
    for span in panel.spans:
        line = span.low == span.high
        shade = getattr(axes, f"ax{'h' if span.axis == 'y' else 'v'}{'line' if line else 'span'}")
        if line:
            shade(span.low, color="#bbbbbb", linewidth=0.9, zorder=0)
        else:
            shade(span.low, span.high, color=SHADED, zorder=0)
        if span.label:
            tag(axes, span)
    if panel.z is not None:
        put(axes, "z", panel.z, (), size[1])
        axes.view_init(*panel.view)  # type: ignore[attr-defined]
        axes.set_box_aspect((1, 1, 1))  # type: ignore[arg-type]
    elif panel.equal:
        axes.set_aspect("equal", adjustable="datalim" if panel.heat is None else "box")
    for note in panel.notes:
        where = (note.x, note.y, note.z) if three else (note.x, note.y)
        axes.text(*where, plain(note.text), ha="center", va="center", fontsize=9)  # type: ignore[call-arg]
    axes.set_title(plain(panel.title), pad=5 + (72 * REMARK if panel.remark else 0))
    if panel.remark:
        axes.text(0.5, 1.012, plain(panel.remark), transform=axes.transAxes, ha="center", va="bottom",
                  fontsize=8, color="#666666")  # fmt: skip


def tag(axes: Axes, span: Span) -> None:
    """The label of a span, inside it; above it where too little of it is seen, nowhere where nothing is."""
    low, high = sorted(axes.get_ylim() if span.axis == "y" else axes.get_xlim())
    if not low < span.high or not span.low < high:
        return
    if span.axis == "x":
        place, transform, side = (max(low, span.low), 0.98), axes.get_xaxis_transform(), "top"
    else:
        place, transform = (0.02, min(high, span.high)), axes.get_yaxis_transform()
        seen = axes.transData.transform([(1, place[1]), (1, max(low, span.low))])[:, 1]
        side = "top" if seen[0] - seen[1] > TAG * axes.figure.dpi else "bottom"
        place = (0.5 if side == "bottom" else place[0], place[1])  # curves begin and end low
    align = "center" if side == "bottom" else "left"
    axes.text(*place, plain(span.label), transform=transform, color="#5566aa", fontsize=8, va=side, ha=align)


def sphere(axes: Axes) -> None:
    """A faint wire sphere of radius one."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13))
    x, y, z = np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)
    axes.plot_wireframe(x, y, z, color="#dddddd", linewidth=0.4)  # type: ignore[attr-defined]


def heat(figure: Drawn, axes: Axes, data: Heat) -> None:
    values = np.array(data.values)
    limit = float(np.nanmax(np.abs(values))) or 1.0
    norm = TwoSlopeNorm(0.0, -limit, limit)
    image = axes.pcolormesh(
        data.x, data.y, values, cmap="RdBu_r", norm=norm, shading="nearest", rasterized=True
    )
    if data.zero and np.nanmin(values) < 0 < np.nanmax(values):
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
        w, h = figure.size
        left, right, below, above = AROUND
        right += BAR if any(panel.heat for panel in figure.panels) else 0.0
        above += REMARK if any(panel.remark for panel in figure.panels) else 0.0
        width = across * w
        most = entries(c for p in figure.panels for c in p.curves) if figure.legend == "shared" else {}
        columns = max(1, int(width // (HANDLE + LETTER * max(map(len, most), default=1))))
        foot = LEGEND_ROW * -(-len(most) // columns)
        height = down * h + TITLE + foot
        made = plt.figure(figsize=(width, height))
        unnamed: dict[str, Any] = {}
        for i, panel in enumerate(figure.panels):
            row, column = divmod(i, across)
            place = (
                (column * w + left) / width, (height - TITLE - (row + 1) * h + below) / height,
                (w - left - right) / width, (h - below - above) / height,
            )  # fmt: skip
            axes = made.add_axes(place, projection="3d" if panel.z is not None else None)
            draw_panel(made, axes, panel, (w - left - right, h - below - above))
            done = set() if panel.z is not None else written(axes, panel, figure.legend == "shared")
            left_over = {k: v for k, v in entries(panel.curves).items() if k not in done}
            if figure.legend == "shared":
                unnamed |= left_over
                continue
            handles, names = axes.get_legend_handles_labels()
            keyed = {plain(label): handle for label, handle in left_over.items()}
            keyed |= dict(zip(names, handles, strict=True))
            if len(keyed) > 1:
                corner = panel.heat is not None and np.isnan(panel.heat.values[-1][0])
                axes.legend(
                    list(keyed.values()),
                    list(keyed),
                    loc="upper left" if corner else "best",
                    fontsize=8,
                    frameon=True,
                    edgecolor="none",
                )
        made.suptitle(plain(figure.title), y=1 - 0.08 / height, va="top", fontsize=12)
        if unnamed:
            ordered = [name for name in most if name in unnamed]
            made.legend([unnamed[n] for n in ordered], [plain(n) for n in ordered], loc="upper center",
                        bbox_to_anchor=(0.5, foot / height), borderaxespad=0, ncols=min(columns, len(ordered)),
                        fontsize=9, handlelength=3)  # fmt: skip
        rows = -(-len(unnamed) // columns)
        made.set_gid(str(foot - LEGEND_ROW * rows))  # inches below the legend that nothing needs
        return made


def digest(figure: Figure) -> str:
    """Of everything a figure shows, and of how it is drawn: equal digests, equal pictures."""
    sources = b"".join((Path(__file__).parent / f"{name}.py").read_bytes() for name in SOURCES)
    return "".join(hashlib.sha256(part).hexdigest()[:16] for part in (repr(figure).encode(), sources))


SOURCES = ("draw", "labels", "look", "scales")
IDENTIFIER = r"<dc:identifier>(\w+)</dc:identifier>"


def digest_of(path: Path) -> str:
    """The digest a file was drawn with, and the seal on it; "" if it has none."""
    if not path.exists():
        return ""
    found = re.search(IDENTIFIER, path.read_text(encoding="utf-8"))
    return found[1] if found else ""


def files(figure: Figure, folder: Path) -> list[Path]:
    return [folder / f"{figure.name}.{kind}" for kind in ("svg", "png")]


def seal(digest: str, vector: Path, picture: Path) -> str:
    """The digest of a figure, and one of its two files: they are as they were saved."""
    text = re.sub(IDENTIFIER, "", vector.read_text(encoding="utf-8"))
    return digest + hashlib.sha256(text.encode() + picture.read_bytes()).hexdigest()[:16]


def current(figure: Figure, folder: Path) -> bool:
    """Whether the files are there, as they were saved, and show the figure, drawn as it would be now."""
    vector, picture = files(figure, folder)
    return vector.exists() and picture.exists() and digest_of(vector) == seal(digest(figure), vector, picture)


def save(figure: Figure, folder: Path) -> list[Path]:
    """Write FOLDER/NAME.svg and .png.

    Without timestamps, so that equal tables give equal files; the .svg carries the digest of what it shows, sealed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    made = drawn(figure)
    vector, picture = files(figure, folder)
    with plt.rc_context(RC):
        seen = Bbox.from_extents(0, float(made.get_gid() or 0), *made.get_size_inches())
        made.savefig(picture, metadata={"Software": None}, bbox_inches=seen)
        made.savefig(vector, metadata={"Date": None, "Identifier": digest(figure)}, bbox_inches=seen)
    plt.close(made)
    sealed = f"<dc:identifier>{seal(digest(figure), vector, picture)}</dc:identifier>"
    vector.write_text(re.sub(IDENTIFIER, sealed, vector.read_text(encoding="utf-8")), encoding="utf-8")
    return [vector, picture]


@contextmanager
def in_background(folder: Path) -> Iterator[Callable[[Figure], None]]:
    """A function that has a figure saved, unless its files show it already; all are there when the block ends.

    Many are drawn by other processes, one for every core, a few by this one at the end.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    pool = ProcessPoolExecutor(cores, multiprocessing.get_context("spawn"))  # starts none before it must
    few: list[Figure] = []
    saved: list[Future[list[Path]]] = []

    def have_saved(figure: Figure) -> None:
        if current(figure, folder):
            return
        few.append(figure)
        if cores > 1 and len(few) + len(saved) >= FEWEST_FOR_PROCESSES:
            saved.extend(pool.submit(save, each, folder) for each in few)
            few.clear()

    try:
        yield have_saved
        for figure in few:
            save(figure, folder)
        for each in saved:
            each.result()
    finally:
        pool.shutdown(cancel_futures=True)
