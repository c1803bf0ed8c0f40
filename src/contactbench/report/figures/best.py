"""Which curves of a panel are seen: the best of each family in colour, the others thin and grey."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from contactbench.measure.statistics import costs_to_reach
from contactbench.report.drawing import Axis, Curve
from contactbench.report.look import look

#: curves in colour in one panel
MOST = 8
#: errors at which costs are compared
TARGETS = tuple(10.0**-k for k in range(1, 15))
#: an axis of cost ends at so many times the least cost at any error of the contest
BEYOND = 30.0
#: a contest is on at the errors that so many curves reach
CONTEST = 3


def family(curve: Curve) -> str:
    return look(curve.method, curve.family).family


def family_and_order(curve: Curve) -> tuple[str, int | None]:
    own = look(curve.method, curve.family)
    return own.family, own.order


#: families whose adaptive solvers differ by their makers more than by what they do to a law
ADAPTIVE = ("scipy", "cyrk", "diffrax")


def structure_class(curve: Curve) -> tuple[str, int]:
    """Groups for laws: contact methods of order 1 (the printed scheme), 2 and higher; kinds of other methods."""
    own = look(curve.method, curve.family)
    if own.family == "contact":
        return "contact", min(own.order or 3, 3)
    return "adaptive" if own.family in ADAPTIVE else own.family, 0


def best_of_each(
    curves: Iterable[Curve],
    score: Callable[[Curve, Sequence[Curve]], float],
    group: Callable[[Curve], Any] = family,
) -> tuple[Curve, ...]:
    """The curves, all but the best of each group muted; those come first, to be drawn below.

    score : of a curve within its group, the greatest is the best; nan: cannot be.
    Of more than MOST groups those seen first are in colour.  Curves of no method stay as they are.
    """
    curves = list(curves)
    groups: dict[Any, list[Curve]] = {}
    for curve in curves:
        if curve.method:
            groups.setdefault(group(curve), []).append(curve)
    chosen = []
    for own in groups.values():
        scores = [score(curve, own) for curve in own]
        if any(not math.isnan(s) for s in scores):
            chosen.append(id(own[int(np.nanargmax(scores))]))
    seen = set(chosen[:MOST])
    muted = [c if not c.method or id(c) in seen else replace(c, muted=True) for c in curves]
    return tuple(sorted(muted, key=lambda c: not c.muted))


@lru_cache(maxsize=256)  # of a panel every curve is compared with every other
def costs(curve: Curve) -> np.ndarray:
    """What each error of TARGETS costs (x: error, y: cost); nan where it is not reached."""
    return np.array(costs_to_reach(curve.x, curve.y, TARGETS))


def cheapest(curve: Curve, own: Sequence[Curve]) -> float:
    """At how many errors the curve is the cheapest of its group; the most accurate where that is equal."""
    table = np.array([np.nan_to_num(costs(c), nan=np.inf) for c in own])
    mine = np.nan_to_num(costs(curve), nan=np.inf)
    least = table.min(axis=0)
    wins = int(np.sum(np.isfinite(mine) & (mine <= least)))
    errors = [x for x, y in zip(curve.x, curve.y, strict=True) if x > 0 and math.isfinite(y)]
    return wins - math.log10(min(errors)) / 1e3 if errors else math.nan


def lowest(curve: Curve, own: Sequence[Curve]) -> float:
    """The smaller its values, the better (median of their logarithms)."""
    values = [math.log10(y) for y in curve.y if y > 0]
    return -float(np.median(values)) if values else math.nan


def like(chosen: Iterable[Curve], curves: Iterable[Curve]) -> tuple[Curve, ...]:
    """The curves, all but those of the methods that were chosen muted."""
    names = {curve.method for curve in chosen if not curve.muted}
    muted = [c if c.method in names else replace(c, muted=True) for c in curves]
    return tuple(sorted(muted, key=lambda c: not c.muted))


def highest(curve: Curve, own: Sequence[Curve]) -> float:
    return -lowest(curve, own)


def contest_ends(axis: Axis, curves: Sequence[Curve], times: float = BEYOND) -> tuple[Axis, str]:
    """The axis of cost ended where the contest ends, and which methods are altogether beyond it."""
    table = np.array([costs(curve) for curve in curves if curve.method])
    reached = np.isfinite(table).sum(axis=0) >= min(CONTEST, len(table)) if len(table) else np.array([])
    if not reached.any():
        return axis, ""
    end = times * float(np.nanmax(np.nanmin(table[:, reached], axis=0)))
    out = [c.label for c in curves if c.method and not any(y <= end for y in c.y if math.isfinite(y))]
    said = f"beyond the panel: {', '.join(dict.fromkeys(out))}" if out else ""
    return replace(axis, within=(None, end)), said
