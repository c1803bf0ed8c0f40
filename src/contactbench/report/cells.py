"""Tables to read, as data: a view has columns and rows of cells; what a number looks like is decided here, once.

A `Cell` holds the text, and the value it is sorted by.  Texts (`View.meaning`, cell texts) are inline Markdown,
see rooms.py.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import pandas as pd

from contactbench.report.numbers import DASH as DASH


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


# -- making cells ----------------------------------------------------------------------------------
def marks(*those: Mark | None) -> frozenset[Mark]:
    return frozenset(mark for mark in those if mark is not None)


def word(text: object, *those: Mark | None, link: str = "") -> Cell:
    """Words; a missing value is an empty cell."""
    missing = text is None or (not isinstance(text, str) and pd.isna(text))
    return Cell("" if missing else str(text), marks=marks(*those), link=link)


def number(value: float | None, show: Callable[[float], str], *those: Mark | None, hint: str = "") -> Cell:
    """A number as `show` writes it, sorted by itself; infinite ones sort beyond all finite ones."""
    if value is None or pd.isna(value):
        return Cell(DASH, hint=hint)
    value = float(value)
    if math.isinf(value):
        text, value = ("∞" if value > 0 else "−∞"), math.copysign(sys.float_info.max, value)
        return Cell(text, value, marks(*those), hint=hint)
    return Cell(show(value), value, marks(*those), hint=hint)
