"""Curves of figures from frames: one per method, with what it is at each point."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Literal

import numpy as np
import pandas as pd

from contactbench.report.drawing import Axis, Curve, Span
from contactbench.results.round_off import STRUCTURE

#: errors below this are drawn at it: round-off has no size on a logarithmic axis
FLOOR = 5e-17


def number_axis(label: str, inverted: bool = False) -> Axis:
    """A logarithmic axis; a definition without the conditions after its semicolon is short enough for one."""
    return Axis(label.partition(";")[0], "log", inverted)


def round_off(axis: Literal["x", "y"]) -> Span:
    return Span(axis, FLOOR, STRUCTURE, "round-off")


def floats(values: Iterable[Any]) -> tuple[float, ...]:
    series = values if isinstance(values, pd.Series) else pd.Series(list(values))
    if not pd.api.types.is_float_dtype(series.dtype):
        series = pd.to_numeric(series, errors="coerce")
    return tuple(series.to_numpy(dtype=float, na_value=np.nan).tolist())


def hints(rows: pd.DataFrame) -> tuple[str, ...]:
    """Setting and engine of each row."""
    known = [map(str, rows[name].tolist()) for name in ("setting", "engine") if name in rows]
    return tuple(map(", ".join, zip(*known, strict=True))) if known else ("",) * len(rows)


def by_method(
    rows: pd.DataFrame,
    x: str,
    y: str,
    apart: tuple[str, ...] = (),
    scale: float = 1.0,
    also: Mapping[str, float] | None = None,
    bars: Callable[[pd.DataFrame], tuple[pd.Series, pd.Series]] | None = None,
    **options: Any,
) -> tuple[Curve, ...]:
    """A curve for each method, and for each value of the columns `apart`; y in units of 1/scale.

    also : columns a page may show instead, with their scales.  bars : low and high ends, in the unit of y.
    """
    keys = ["method", *apart]
    others = {name: size for name, size in (also or {}).items() if name in rows}
    curves = []
    for names, line in rows.groupby(keys, sort=False, dropna=False):
        method = str(names[0])
        low, high = (floats(end * scale) for end in bars(line)) if bars else ((), ())
        curves.append(
            Curve(
                floats(line[x]), above(line[y], scale), method, method, hints=hints(line),
                family=str(line["family"].iloc[0]) if "family" in line else "",
                also=tuple((name, above(line[name], size)) for name, size in others.items()),
                low=low, high=high, **options,
            )
        )  # fmt: skip
    return tuple(curves)


def above(values: pd.Series, scale: float = 1.0) -> tuple[float, ...]:
    """Values for a logarithmic axis; nan stays nan."""
    return tuple(np.maximum(np.array(floats(values)) * scale, FLOOR).tolist())
