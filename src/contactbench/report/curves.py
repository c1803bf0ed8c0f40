"""Curves of figures from frames: one per method; at most eight in a panel, all named."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from contactbench.measure.law import STRUCTURE
from contactbench.measure.statistics import costs_to_reach
from contactbench.plugins import OWN
from contactbench.report.drawing import Axis, Curve, Span
from contactbench.report.look import CONTACT, CONTESTANTS, look

#: errors in double precision below this are drawn at it: round-off has no size on a logarithmic axis
FLOOR = 5e-17
#: deviations that are round-off
ROUND_OFF = Span(FLOOR, STRUCTURE, "round-off")
#: curves of methods in one panel
MOST = 8
#: errors at which costs are compared
TARGETS = tuple(10.0**-k for k in range(1, 15))
#: an axis of cost ends at so many times the least cost at any error that three curves reach
BEYOND, CONTEST = 30.0, 3

#: the greater, the better a curve is of its group, beside these; nan: it cannot be the best
type Score = Callable[[Curve, Sequence[Curve]], float]


def floats(values: Iterable[object]) -> tuple[float, ...]:
    series = pd.to_numeric(pd.Series(values), errors="coerce")
    return tuple(series.to_numpy(dtype=float, na_value=np.nan).tolist())


def above(values: pd.Series, scale: float = 1.0, floor: float = FLOOR) -> tuple[float, ...]:
    return tuple(np.maximum(np.array(floats(values)) * scale, floor).tolist())


def by_method(
    rows: pd.DataFrame, x: str, y: str, scale: float = 1.0, floor: float = FLOOR
) -> tuple[Curve, ...]:
    """Return a curve for each method; y in units of 1/scale, drawn at `floor` where it is less."""
    curves = []
    for method, line in rows.groupby("method", sort=False):
        family = str(line["family"].iloc[0]) if "family" in line else ""
        points = floats(line[x]), above(line[y], scale, floor)
        curves.append(Curve(*points, str(method), str(method), family=family))
    return tuple(curves)


def best(curves: Iterable[Curve], score: Score) -> list[str]:
    """Return the method of the best of some curves, or nothing where no curve has a score."""
    own = list(curves)
    scores = [score(curve, own) for curve in own]
    return [] if np.isnan(scores).all() else [own[int(np.nanargmax(scores))].method]


def choose(
    curves: Sequence[Curve], score: Score, subjects: Sequence[str] = (), by_order: bool = False
) -> list[str]:
    """Return the methods that a figure shows, at most MOST.

    First its subjects, or the best of all and the best contact method; then what plug-ins bring, and the contestants
    of the mission.
    by_order : where there is room the best of every family and order, too.
    """
    groups: dict[tuple[str, int | None], list[Curve]] = {}
    for curve in curves:
        own = look(curve.method, curve.family)
        groups.setdefault((own.family, own.order), []).append(curve)
    contact = [curve for (family, _), some in groups.items() if family == CONTACT for curve in some]
    chosen = [*(subjects or [*best(curves, score), *best(contact, score)])]
    chosen += [curve.method for curve in curves if curve.method not in OWN]
    for names in CONTESTANTS:
        chosen += best((curve for curve in curves if curve.method in names), score)
    for group in groups.values() if by_order else ():
        chosen += best(group, score)
    return list(dict.fromkeys(chosen))[:MOST]


def only(curves: Iterable[Curve], methods: Sequence[str]) -> tuple[Curve, ...]:
    return tuple(sorted((c for c in curves if c.method in methods), key=lambda c: methods.index(c.method)))


def cheapest(curve: Curve, own: Sequence[Curve]) -> float:
    """Return at how many errors a curve (x: error, y: cost) is the cheapest of its group; ties go to accuracy."""
    table = np.nan_to_num([costs_to_reach(c.x, c.y, TARGETS) for c in own], nan=np.inf)
    mine = np.nan_to_num(costs_to_reach(curve.x, curve.y, TARGETS), nan=np.inf)
    wins = int(np.sum(np.isfinite(mine) & (mine <= table.min(axis=0))))
    errors = [x for x, y in zip(curve.x, curve.y, strict=True) if x > 0 and math.isfinite(y)]
    return wins - math.log10(min(errors)) / 1e3 if errors else math.nan


def lowest(curve: Curve, own: Sequence[Curve]) -> float:
    values = [math.log10(y) for y in curve.y if y > 0]
    return -float(np.median(values)) if values else math.nan


def highest(curve: Curve, own: Sequence[Curve]) -> float:
    return -lowest(curve, own)


def contest_end(axis: Axis, curves: Sequence[Curve]) -> Axis:
    table = np.array([costs_to_reach(c.x, c.y, TARGETS) for c in curves]).reshape(-1, len(TARGETS))
    reached = np.isfinite(table).sum(axis=0) >= max(1, min(CONTEST, len(table)))
    if not reached.any():
        return axis
    return replace(axis, within=(0.0, BEYOND * float(np.nanmax(np.nanmin(table[:, reached], axis=0)))))
