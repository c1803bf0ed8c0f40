"""Orders of convergence, fitted to measured errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

#: points needed for an order
MIN_POINTS = 4
#: how far pairwise slopes may stray from their median in an asymptotic range: strict, else lenient
STRAYS = (0.05, 0.15)


@dataclass(frozen=True)
class OrderFit:
    """Slope of log error against log h with its 95 % interval, and the points it rests on.

    used : mask of the points in the asymptotic range.  pairwise : slope between each point and the
    next larger step, nan for the largest.  order is nan when fewer than four points qualify.
    """

    order: float
    low: float
    high: float
    used: np.ndarray
    pairwise: np.ndarray


def fit_line(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float]:
    """Least-squares slope and its 95 % interval (Student t); at least three points."""
    from scipy.stats import linregress
    from scipy.stats import t as student

    fit = linregress(x, y)
    half = student.ppf(0.975, len(x) - 2) * fit.stderr
    return float(fit.slope), float(fit.slope - half), float(fit.slope + half)


def fit_order(steps: Sequence[float], errors: Sequence[float], floor: float = 0.0) -> OrderFit:
    """Order of convergence from errors at a ladder of step sizes, in any order.

    The asymptotic range is the longest run of at least four neighbouring points, none at or below
    `floor` (round-off), whose pairwise slopes differ by at most 0.05 from their median, or 0.15 if
    there is no such run; of several equally long runs the one with the smallest steps is taken.
    """
    h, e = np.asarray(steps, dtype=float), np.asarray(errors, dtype=float)
    order = np.argsort(h)
    h, e = h[order], e[order]
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = np.diff(np.log(e)) / np.diff(np.log(h))
    sound = np.isfinite(e) & (e > floor)
    best = next(filter(len, (longest_run(slopes, sound, stray) for stray in STRAYS)), range(0))
    used = np.zeros(len(h), dtype=bool)
    used[best.start : best.stop] = True
    pairwise = np.append(slopes, math.nan)
    back = np.argsort(order)
    if not len(best):
        return OrderFit(math.nan, math.nan, math.nan, used[back], pairwise[back])
    fitted = fit_line(np.log(h[used]), np.log(e[used]))
    return OrderFit(*fitted, used[back], pairwise[back])


def longest_run(slopes: np.ndarray, sound: np.ndarray, stray: float) -> range:
    """Indices of the longest run of sound points with slopes within `stray` of their median."""
    best = range(0)
    for i in range(len(sound)):
        for j in range(i + MIN_POINTS, len(sound) + 1):
            inside = slopes[i : j - 1]
            if sound[i:j].all() and np.abs(inside - np.median(inside)).max() <= stray and j - i > len(best):
                best = range(i, j)
    return best
