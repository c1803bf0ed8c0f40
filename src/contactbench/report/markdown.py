"""How the documents write numbers and tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import pandas as pd
from tabulate import tabulate

DASH = "—"


def scientific(value: float, digits: int = 1) -> str:
    return DASH if pd.isna(value) else f"{value:.{digits}e}"


def duration(seconds: float) -> str:
    """Seconds as a readable time; a dash for nan."""
    if math.isnan(seconds):
        return DASH
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-9:.3g} ns"


def times(ratio: float) -> str:
    """A ratio: two decimals where they tell who is ahead, two digits above ten."""
    return f"×{ratio:.2f}" if ratio < 9.995 else f"×{ratio:.2g}"


def count(value: float) -> str:
    """A number of evaluations; a dash for nan."""
    return DASH if math.isnan(value) else f"{value:.0f}"


def markdown(header: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A GitHub table; the first column left, the others right aligned."""
    head = list(header)
    align = ["left", *["right"] * (len(head) - 1)]
    return tabulate(
        [list(map(str, row)) for row in rows], head, tablefmt="github", colalign=align, disable_numparse=True
    )


@dataclass(frozen=True)
class Listing:
    """A table as values, for whoever writes it down: (label, how a value is shown) of each column, rows."""

    columns: tuple[tuple[str, Callable[[Any], str]], ...]
    rows: tuple[tuple[Any, ...], ...]

    def markdown(self) -> str:
        labels, shows = zip(*self.columns, strict=True)
        return markdown(labels, ([show(v) for show, v in zip(shows, row, strict=True)] for row in self.rows))
