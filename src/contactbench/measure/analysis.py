"""What is computed from measured points: fitted orders, equal-error costs, timing statistics."""

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


def cost_at_error(errors: Sequence[float], costs: Sequence[float], target: float) -> float:
    """Cost at which the error reaches `target`, by log–log interpolation; nan outside the data.

    The lower envelope of the points is used: the cheapest setting at least as accurate as each
    error, so that a method is not charged for a poor setting it has no need of.
    """
    loosest = max((e for e in errors if math.isfinite(e)), default=math.nan)
    return cost_to_reach(errors, costs, target) if target <= loosest else math.nan


def cost_to_reach(errors: Sequence[float], costs: Sequence[float], target: float) -> float:
    """The same where the data end before they are as inaccurate as `target`: the cheapest setting then.

    That is no more than a bound, but a fair one: a method that is better than asked for at a lower
    cost is the better choice.  nan where no setting is as accurate.
    """
    points = sorted(
        (e, c) for e, c in zip(errors, costs, strict=True) if e > 0 and math.isfinite(e) and math.isfinite(c)
    )
    front: list[tuple[float, float]] = []
    for error, cost in points:  # errors ascend: drop points that cost no less than a better one
        if front and cost >= front[-1][1]:
            continue
        front.append((error, cost))
    if not front or target < front[0][0]:
        return math.nan
    x, y = np.log([e for e, _ in front]), np.log([c for _, c in front])
    return float(np.exp(np.interp(math.log(target), x, y)))


@dataclass(frozen=True)
class Timing:
    """Seconds per call over rounds: minimum, median and interquartile range."""

    minimum: float
    median: float
    iqr: float
    rounds: int


def timing(samples: Sequence[float]) -> Timing:
    """Statistics of per-call times."""
    lower, middle, upper = np.percentile(samples, [25, 50, 75])
    return Timing(float(min(samples)), float(middle), float(upper - lower), len(samples))


#: resampled medians behind a bootstrap interval
RESAMPLES = 2000


@dataclass(frozen=True)
class PairedRatio:
    """How many times slower one of two is: median over rounds and its 95 % bootstrap interval."""

    ratio: float
    low: float
    high: float
    rounds: int


def paired_ratio(base: Sequence[float], head: Sequence[float]) -> PairedRatio:
    """Ratio head/base of times taken in pairs, the two of a pair next to each other in time.

    A drift of the machine slower than a pair cancels in each log-ratio; their median is resampled
    (Efron, Ann. Stat. 7, 1 (1979), doi:10.1214/aos/1176344552, percentile interval, fixed seed).
    """
    logs = np.log(np.asarray(head, dtype=float)) - np.log(np.asarray(base, dtype=float))
    resampled = np.random.default_rng(0).choice(logs, (RESAMPLES, len(logs)))
    low, high = np.percentile(np.median(resampled, axis=1), [2.5, 97.5])
    return PairedRatio(math.exp(np.median(logs)), math.exp(low), math.exp(high), len(logs))
