"""Tables to read: a DataFrame with labels; how a number is written, and what a cell is marked as, is decided here.

Texts (`View.legend`, texts of cells) are inline Markdown.  An address is a file beside the document, or #anchor
inside it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Any

import pandas as pd

from contactbench.report.numbers import DASH, readable

#: texts that say nothing: a row that has no other is left out
SILENT = ("", DASH, "unsupported")

#: how a number is written
type Show = Callable[[float], str]


class Mark(StrEnum):
    best = "best"  #: the best of its column or row, alone
    tie = "tie"  #: no worse than the best by more than the noise
    kept = "kept"  #: a law kept to round-off
    exception = "exception"  #: contradicts a claim


@dataclass(frozen=True)
class Cell:
    """An entry; value : its number, None where it is words or missing."""

    text: str
    value: float | None = None
    mark: Mark | None = None


@dataclass(frozen=True)
class Head:
    label: str
    words: bool = False
    group: str = ""


@dataclass(frozen=True)
class View:
    """A table to read, without the rows in which nothing is said; name : unique over all chapters.

    frame : its entries are words, numbers or `Cell`s; the first column names the row.  Column names are labels, or
    pairs of a group and a label.  legend : one or two sentences under the title; says what marks and dashes mean.
    show : how the numbers of a column are written, by label; "": of all other columns.
    """

    name: str
    title: str
    frame: pd.DataFrame
    legend: str = ""
    show: Mapping[str, Show] = field(default_factory=dict)

    @cached_property
    def rows(self) -> tuple[tuple[Cell, ...], ...]:
        shows = [self.show.get(label, self.show.get("", readable)) for _, label in self.labels]
        rows = self.frame.itertuples(index=False, name=None)
        cells = (tuple(map(as_cell, row, shows)) for row in rows)
        return tuple(row for row in cells if any(cell.text not in SILENT for cell in row[1:]))

    @cached_property
    def columns(self) -> tuple[Head, ...]:
        columns = list(zip(*self.rows, strict=True)) or [()] * len(self.labels)
        words = (all(cell.value is None for cell in column) for column in columns)
        heads = zip(self.labels, words, strict=True)
        return tuple(Head(label, word, group) for (group, label), word in heads)

    @property
    def labels(self) -> list[tuple[str, str]]:
        """Return group ("" for none) and label of each column."""
        return [name if isinstance(name, tuple) else ("", str(name)) for name in self.frame.columns]


def as_cell(value: object, show: Show = readable, mark: Mark | None = None) -> Cell:
    """Return an entry as a cell: a missing one is a dash."""
    if isinstance(value, Cell):
        return value
    if isinstance(value, str):
        return Cell(value, mark=mark)
    if value is None or pd.isna(value):  # type: ignore[call-overload]
        return Cell(DASH)
    number = float(value)  # type: ignore[arg-type]
    if math.isinf(number):
        return Cell("∞" if number > 0 else "−∞", number, mark)
    return Cell(show(number), number, mark)


def frame_of(
    rows: Iterable[Sequence[object]], labels: Sequence[str] | Sequence[tuple[str, str]]
) -> pd.DataFrame:
    """Return rows of words, numbers or cells as the frame of a view; labels : of the columns, or (group, label)."""
    return pd.DataFrame(list(rows), columns=pd.Index(labels, tupleize_cols=False), dtype=object)


def matrix(
    frame: pd.DataFrame,
    row: str,
    column: str,
    cell: Callable[[pd.DataFrame], object],
    label: Callable[..., str] = str,
) -> pd.DataFrame:
    """Return a row for each value of one column and a column for each of another; cell(rows that have both)."""
    groups = frame.groupby([row, column], sort=False)
    return grid(row, {key: cell(rows) for key, rows in groups}, label)


def grid(row: str, cells: Mapping[tuple[Any, Any], object], label: Callable[..., str] = str) -> pd.DataFrame:
    """Return cells in rows and columns, by their names in both."""
    names, values = (dict.fromkeys(key[side] for key in cells) for side in (0, 1))
    lines = [(name, *(cells.get((name, value), DASH) for value in values)) for name in names]
    return frame_of(lines, [row, *map(label, values)])
