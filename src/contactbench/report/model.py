"""What a room hands to the renderers: views, figures, texts and findings as data.

A room answers one question (convergence, laws, …): it reads frames of the result tables and hands over
a sequence of parts.  A renderer (markdown.py, draw.py, page/) writes every part down the same way and
knows no question, no table and no method.  What a number looks like is decided here, once: a `Cell` holds
the text, and the value it is sorted by.

Texts (`Text.body`, `View.meaning`, `Figure.caption`, `Finding.sentence`, exceptions, cell texts) are inline
Markdown of four kinds only: `code`, **strong**, *emphasis* and [text](address).  An address is a file name
relative to results/, or #anchor inside the document.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

import pandas as pd

from contactbench.errors import Registry

#: table name → its rows
Frames = Mapping[str, pd.DataFrame]


# -- tables ----------------------------------------------------------------------------------------
class Mark(StrEnum):
    """What a cell wants to be seen as; a renderer gives each its look."""

    best = "best"  #: the best of its column or row, alone
    tie = "tie"  #: no worse than the best by more than the noise
    kept = "kept"  #: a law kept to round-off
    bound = "bound"  #: no more than a bound on the quantity (the text says ≤)
    clamped = "clamped"  #: taken against something else than its own size (the text ends in a dagger)
    exception = "exception"  #: contradicts what is said of its kind
    holds = "holds"  #: verdicts of claims
    corrected = "corrected"
    refuted = "refuted"
    right = "right"  #: a run that ended as the true motion does
    bad = "bad"  #: a run that ended badly
    none = "none"  #: nothing to measure: unsupported


@dataclass(frozen=True)
class Cell:
    """One entry of a view.

    value : what it is sorted by; None: words are sorted by `text`, a missing number is sorted last.
    link : an address the text leads to.
    more : shown on demand, pairs of caption and one text or a tuple of texts (bullets).
    hint : a sentence for a tooltip; nothing that is not said elsewhere.
    """

    text: str
    value: float | None = None
    marks: frozenset[Mark] = frozenset()
    link: str = ""
    more: tuple[tuple[str, str | tuple[str, ...]], ...] = ()
    hint: str = ""


@dataclass(frozen=True)
class Head:
    """A column: its label, its meaning (tooltip, glossary), whether it holds words (left aligned).

    group : a label over neighbouring columns with the same group; "" for none.
    """

    label: str
    meaning: str = ""
    words: bool = False
    group: str = ""


@dataclass(frozen=True)
class View:
    """A table to read.  Every row has as many cells as there are columns; the first cell names the row.

    name : unique over all rooms, [a-z0-9_]; anchors and file names derive from it.
    meaning : the sentence(s) under the title; says what marks and dashes mean.
    source : the CSV it is from.
    detail : rows by the hundred, for a page that sorts and filters; a document names the CSV instead.
    map : cells are to be seen at once, as a map of small marks (stability); else an ordinary table.
    """

    name: str
    title: str
    meaning: str
    columns: tuple[Head, ...]
    rows: tuple[tuple[Cell, ...], ...]
    source: str = ""
    detail: bool = False
    map: bool = False

    def __post_init__(self) -> None:
        wrong = [row[0].text for row in self.rows if len(row) != len(self.columns)]
        if wrong:
            raise ValueError(f"view {self.name!r}: rows {wrong} do not have {len(self.columns)} cells")


# -- text ------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Text:
    """A paragraph, or a list where `items` is given (body: what stands before it, may be empty)."""

    body: str = ""
    items: tuple[str, ...] = ()


@dataclass(frozen=True)
class Finding:
    """A computed sentence: what it says, over what, and its exceptions with their cause.

    title : in a word or two ("Structure").  covers : rows, scenes and methods it was computed over.
    """

    name: str
    title: str
    sentence: str
    covers: str
    exceptions: tuple[str, ...] = ()


def spoken(found: Iterable[Finding]) -> Text:
    """Findings as a list: sentence, exceptions, what it covers."""
    items = []
    for finding in found:
        said = f"**{finding.title}.** {finding.sentence}"
        if finding.exceptions:
            said += f" Exceptions: {'; '.join(finding.exceptions)}."
        items.append(f"{said} *({finding.covers}.)*")
    return Text(items=tuple(items))


# -- figures ---------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Axis:
    """limits, ticks : as they must be, or None for what fits.  ticks are (value, text)."""

    label: str
    scale: Literal["linear", "log"] = "linear"
    inverted: bool = False
    limits: tuple[float | None, float | None] | None = None
    ticks: tuple[tuple[float, str], ...] | None = None


@dataclass(frozen=True)
class Curve:
    """Points of one curve, in drawing order; nan interrupts the line.

    method : a name of METHODS gives it that method's colour and marker, everywhere the same.
    role : the look of what is no method: truth, law, reference (thin, grey), criterion, conservative,
        dissipative, flow, stable, unstable, neutral, or "shade 0" … "shade 4" of an ordered set.
    label : its entry in the legend; "" for none.  Equal labels are one entry.
    line, markers : whether either is drawn; dashed : the line.  every : a marker at every n-th point.
    emphasis : drawn above the others, stronger.
    note : written at the last point (a direct label).
    low, high : error bars in y, absolute values; empty for none.
    hints : a sentence for each point (hover); empty for none.
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

    equal : one unit is as long on both axes.  view : elevation and azimuth in degrees, 3-D only.
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


@dataclass(frozen=True)
class Figure:
    """Panels side by side, `across` in a row.  Saved as figures/NAME.svg and .png.

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


# -- rooms -----------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Section:
    """Parts under a heading.

    choice : neighbouring sections with the same choice ("scene") are alternatives: a page may show one
        at a time; a document writes one after the other.
    anchor : to be linked to; by default made of the title.
    """

    title: str
    parts: tuple[Part, ...]
    choice: str = ""
    anchor: str = ""

    @property
    def address(self) -> str:
        return self.anchor or slug(self.title)


Part = Text | View | Figure | Section


@dataclass(frozen=True)
class Room:
    """One question.

    name : its document is NAME.md (README.md for the headline).  about : a line for the list of documents.
    tables : what it reads; it has something to say when the first has rows.
    order : its place.
    sections(frames) : its parts.  findings(frames) : its computed sentences, for itself and the headline.
    """

    name: str
    title: str
    about: str
    order: int
    tables: tuple[str, ...]
    sections: Callable[[Frames], Sequence[Part]]
    findings: Callable[[Frames], Sequence[Finding]] = field(default=lambda frames: ())
    document: str = ""

    @property
    def file(self) -> str:
        return self.document or f"{self.name}.md"

    def speaks(self, frames: Frames) -> bool:
        """Whether there is anything to say."""
        return bool(len(frames[self.tables[0]]))


ROOMS = Registry("room", Room)


def rooms(frames: Frames) -> list[Room]:
    """The rooms that have something to say, in their order."""
    return sorted((room for room in ROOMS.values() if room.speaks(frames)), key=lambda room: room.order)


def figures(parts: Iterable[Part]) -> Iterable[Figure]:
    """Every figure of some parts, nested ones included."""
    for part in parts:
        if isinstance(part, Section):
            yield from figures(part.parts)
        elif isinstance(part, Figure):
            yield part


# -- making cells ----------------------------------------------------------------------------------
DASH = "—"


def marks(*those: Mark | None) -> frozenset[Mark]:
    return frozenset(mark for mark in those if mark is not None)


def word(text: object, *those: Mark | None, link: str = "", hint: str = "") -> Cell:
    """Words; a missing value is an empty cell."""
    missing = text is None or (not isinstance(text, str) and pd.isna(text))
    return Cell("" if missing else str(text), marks=marks(*those), link=link, hint=hint)


def number(
    value: float | None, show: Callable[[float], str], *those: Mark | None, blank: str = DASH, hint: str = ""
) -> Cell:
    """A number as `show` writes it, sorted by itself; infinite ones sort beyond all finite ones."""
    if value is None or pd.isna(value):
        return Cell(blank, hint=hint)
    value = float(value)
    if math.isinf(value):
        text, value = ("∞" if value > 0 else "−∞"), math.copysign(sys.float_info.max, value)
        return Cell(text, value, marks(*those), hint=hint)
    return Cell(show(value), value, marks(*those), hint=hint)


def slug(title: str) -> str:
    """The anchor GitHub gives a heading."""
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
