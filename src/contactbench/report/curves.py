"""Curves of figures from frames: one per method, with a hint at each point."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from contactbench.measure.round_off import STRUCTURE
from contactbench.report.drawing import Axis, Curve, Span

#: errors below this are drawn at it: round-off has no size on a logarithmic axis
FLOOR = 5e-17


def number_axis(label: str, inverted: bool = False) -> Axis:
    """Return a logarithmic axis; the label is short of the conditions after its semicolon."""
    return Axis(label.partition(";")[0], "log", inverted)


#: deviations that are round-off
ROUND_OFF = Span(FLOOR, STRUCTURE, "round-off")


def floats(values: Iterable[Any]) -> tuple[float, ...]:
    """Return values as floats; nan where there is none."""
    series = pd.to_numeric(pd.Series(values), errors="coerce")
    return tuple(series.to_numpy(dtype=float, na_value=np.nan).tolist())


def by_method(rows: pd.DataFrame, x: str, y: str, scale: float = 1.0, **options: Any) -> tuple[Curve, ...]:
    """Return a curve for each method; y in units of 1/scale."""
    curves = []
    for method, line in rows.groupby("method", sort=False):
        family = str(line["family"].iloc[0]) if "family" in line else ""
        hints = tuple(map(str, line["setting"])) if "setting" in line else ()
        points = floats(line[x]), above(line[y], scale)
        curves.append(Curve(*points, str(method), str(method), family=family, hints=hints, **options))
    return tuple(curves)


def above(values: pd.Series, scale: float = 1.0) -> tuple[float, ...]:
    """Return values for a logarithmic axis, none below FLOOR; nan stays nan."""
    return tuple(np.maximum(np.array(floats(values)) * scale, FLOOR).tolist())
