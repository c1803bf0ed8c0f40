"""Which curves of a panel are seen: the best of each group in colour, the others thin and grey."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from contactbench.measure.statistics import costs_to_reach
from contactbench.report.drawing import Axis, Curve
from contactbench.report.look import look

#: curves in colour in one panel
MOST = 8
#: errors at which costs are compared
TARGETS = tuple(10.0**-k for k in range(1, 15))
#: an axis of cost ends at so many times the least cost at any error that three curves reach
BEYOND, CONTEST = 30.0, 3
#: families whose adaptive solvers differ by their makers more than by what they do to a law
ADAPTIVE = ("scipy", "cyrk", "diffrax")

#: the greater, the better a curve is of its group; nan: it cannot be the best
type Score = Callable[[Curve, Sequence[Curve]], float]


def family(curve: Curve) -> str:
    """Return the family of a curve's method."""
    return look(curve.method, curve.family).family


def family_and_order(curve: Curve) -> tuple[str, int | None]:
    """Return the family and the order of a curve's method."""
    own = look(curve.method, curve.family)
    return own.family, own.order


def structure_class(curve: Curve) -> tuple[str, int]:
    """Return the group of a method for laws: contact methods of order 1, 2 and higher; kinds of other methods."""
    own = look(curve.method, curve.family)
    if own.family == "contact":
        return "contact", min(own.order or 3, 3)
    return "adaptive" if own.family in ADAPTIVE else own.family, 0


def best_of_each(
    curves: Iterable[Curve], score: Score, group: Callable[[Curve], Hashable] = family
) -> tuple[Curve, ...]:
    """Return the curves, all but the best of each group muted; those come first, to be drawn below.

    Of more than MOST groups those seen first are in colour.  Curves of no method stay as they are.
    """
    curves = list(curves)
    groups: dict[Hashable, list[Curve]] = {}
    for curve in curves:
        if curve.method:
            groups.setdefault(group(curve), []).append(curve)
    chosen = []
    for own in groups.values():
        scores = [score(curve, own) for curve in own]
        if not np.isnan(scores).all():
            chosen.append(own[int(np.nanargmax(scores))].method)
    return like(chosen[:MOST], curves)


def like(methods: Iterable[str], curves: Iterable[Curve]) -> tuple[Curve, ...]:
    """Return the curves, those of other methods muted and first."""
    names = {*methods, ""}
    muted = [c if c.method in names else replace(c, muted=True) for c in curves]
    return tuple(sorted(muted, key=lambda c: not c.muted))


def in_colour(curves: Iterable[Curve]) -> list[str]:
    """Return the methods that are not muted."""
    return [c.method for c in curves if c.method and not c.muted]


def cheapest(curve: Curve, own: Sequence[Curve]) -> float:
    """Return at how many errors a curve (x: error, y: cost) is the cheapest of its group; ties go to accuracy."""
    table = np.nan_to_num([costs_to_reach(c.x, c.y, TARGETS) for c in own], nan=np.inf)
    mine = np.nan_to_num(costs_to_reach(curve.x, curve.y, TARGETS), nan=np.inf)
    wins = int(np.sum(np.isfinite(mine) & (mine <= table.min(axis=0))))
    errors = [x for x, y in zip(curve.x, curve.y, strict=True) if x > 0 and math.isfinite(y)]
    return wins - math.log10(min(errors)) / 1e3 if errors else math.nan


def lowest(curve: Curve, own: Sequence[Curve]) -> float:
    """Return how small the values of a curve are (median of their logarithms)."""
    values = [math.log10(y) for y in curve.y if y > 0]
    return -float(np.median(values)) if values else math.nan


def highest(curve: Curve, own: Sequence[Curve]) -> float:
    """Return how large the values of a curve are."""
    return -lowest(curve, own)


def contest_ends(axis: Axis, curves: Sequence[Curve], times: float = BEYOND) -> Axis:
    """Return the axis of cost, ended where the contest ends."""
    table = np.array([costs_to_reach(c.x, c.y, TARGETS) for c in curves]).reshape(-1, len(TARGETS))
    reached = np.isfinite(table).sum(axis=0) >= max(1, min(CONTEST, len(table)))
    if not reached.any():
        return axis
    return replace(axis, within=(None, times * float(np.nanmax(np.nanmin(table[:, reached], axis=0)))))
