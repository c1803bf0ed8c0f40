"""Figures as data: panels of curves with axes and spans; their renderers know no question."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Axis:
    """One axis of a panel.  within : where it ends at the latest, though curves go on."""

    label: str
    scale: Literal["linear", "log"] = "linear"
    inverted: bool = False
    within: tuple[float, float] = (-math.inf, math.inf)


@dataclass(frozen=True)
class Curve:
    """Points of one curve, in drawing order; nan interrupts the line.

    label : its entry in the legend, equal ones are one; "" for none.  method : gives it that method's look.
    role : of `look.ROLES`, the look of a curve of no method.  family : as declared by a method unknown to look.py.
    """

    x: tuple[float, ...]
    y: tuple[float, ...]
    label: str = ""
    method: str = ""
    role: str = ""
    line: bool = True
    markers: bool = True
    family: str = ""


@dataclass(frozen=True)
class Span:
    """A shaded range of y, behind the curves.  label: written in it."""

    low: float
    high: float
    label: str = ""


@dataclass(frozen=True)
class Field:
    """A rectangle with words in it, in the colour of a method.  x, y : its sides."""

    x: tuple[float, float]
    y: tuple[float, float]
    words: str
    method: str


@dataclass(frozen=True)
class Panel:
    """One pair of axes.  equal : one unit is as long on both.  fields : of a map, in place of curves."""

    title: str
    x: Axis
    y: Axis
    curves: tuple[Curve, ...]
    spans: tuple[Span, ...] = ()
    equal: bool = False
    fields: tuple[Field, ...] = ()


@dataclass(frozen=True)
class Figure:
    """Panels side by side, `across` in a row, saved as figures/NAME.svg.

    Names of curves stand in the margin of a single panel, or below several.

    title : its message.  caption : one or two sentences on the comparison, and which side is better.
    """

    name: str
    title: str
    panels: tuple[Panel, ...]
    caption: str = ""
    across: int = 2
