"""What is computed from measured points: equal-error costs, timing statistics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


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
