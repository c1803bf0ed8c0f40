"""Figures as data: panels of curves with axes, spans and notes.  Who draws them knows no question."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Axis:
    """limits, ticks : as they must be, or None for what fits.  ticks are (value, text).

    within : where the axis ends at the latest, though curves go on; None for no end.
    key : the quantity.  others : axes that a page may show instead (`Curve.also` has the values).
    Labels, and all words of a figure, may hold mathtext between dollars.
    """

    label: str
    scale: Literal["linear", "log"] = "linear"
    inverted: bool = False
    limits: tuple[float | None, float | None] | None = None
    ticks: tuple[tuple[float, str], ...] | None = None
    within: tuple[float | None, float | None] = (None, None)
    key: str = ""
    others: tuple[Axis, ...] = ()


@dataclass(frozen=True)
class Curve:
    """Points of one curve, in drawing order; nan interrupts the line.

    method : a name of METHODS gives it that method's colour, dash and marker, everywhere the same.
    family : what a method unknown to look.py declares itself.
    muted : thin and grey, not the best of its family.
    role : the look of what is no method: truth, law, reference (thin, grey), criterion, conservative,
        dissipative, flow, stable, unstable, neutral, or "shade 0" … "shade 4" of an ordered set.
    label : its entry in the legend; "" for none.  Equal labels are one entry.
    line, markers : whether either is drawn; dashed : the line.  every : a marker at every n-th point.
    emphasis : drawn above the others, stronger.
    note : written at the last point (a direct label).
    low, high : error bars in y, absolute values; empty for none.
    hints : a sentence for each point (hover); empty for none.
    also : values of other quantities at the points, (key, values), for the axes a page may choose.
    z : third coordinate, in a panel that has a z axis.
    """

    x: tuple[float, ...]
    y: tuple[float, ...]
    label: str = ""
    method: str = ""
    role: str = ""
    line: bool = True
    markers: bool = True
    dashed: bool = False
    every: int = 1
    emphasis: bool = False
    note: str = ""
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    hints: tuple[str, ...] = ()
    z: tuple[float, ...] = ()
    family: str = ""
    muted: bool = False
    also: tuple[tuple[str, tuple[float, ...]], ...] = ()


@dataclass(frozen=True)
class Span:
    """A shaded range of one axis, behind the curves; low = high: a line.  label: written in it."""

    axis: Literal["x", "y"]
    low: float
    high: float
    label: str = ""


@dataclass(frozen=True)
class Note:
    """Words at a point of a panel, centred there."""

    x: float
    y: float
    text: str
    z: float = 0.0


@dataclass(frozen=True)
class Heat:
    """A colour map of values[j][i] at (x[i], y[j]), centred at zero; zero : label of its zero contour."""

    x: tuple[float, ...]
    y: tuple[float, ...]
    values: tuple[tuple[float, ...], ...]
    label: str
    zero: str = ""


@dataclass(frozen=True)
class Panel:
    """One pair of axes.  With `z` it is three-dimensional; `sphere` draws the unit sphere in it.

    remark : a line below the title.  equal : one unit is as long on both axes.
    view : elevation and azimuth in degrees, 3-D only.
    """

    title: str
    x: Axis
    y: Axis
    curves: tuple[Curve, ...]
    spans: tuple[Span, ...] = ()
    notes: tuple[Note, ...] = ()
    heat: Heat | None = None
    z: Axis | None = None
    sphere: bool = False
    equal: bool = False
    view: tuple[float, float] = (22.0, -50.0)
    remark: str = ""


@dataclass(frozen=True)
class Figure:
    """Panels side by side, `across` in a row.  Saved as figures/NAME.svg and .png.

    size : of a panel, inches.
    legend : one for all panels, below them ("shared"), or one in each ("each").
    caption : one or two sentences: what is compared, what is better.
    """

    name: str
    title: str
    panels: tuple[Panel, ...]
    caption: str = ""
    across: int = 3
    legend: Literal["shared", "each"] = "shared"
    source: str = ""
    size: tuple[float, float] = (4.6, 3.9)
