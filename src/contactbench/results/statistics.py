"""What reports and the gate compute from rows: costs at equal error, paired ratios, noise and ties."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from contactbench.errors import BadInput


def cost_to_reach(errors: Sequence[float], costs: Sequence[float], target: float) -> float:
    """Cost at which the error reaches `target`, by log–log interpolation; nan where no setting is as accurate.

    The lower envelope of the points is used: the cheapest setting at least as accurate as each
    error, so that a method is not charged for a poor setting it has no need of.  Where every setting is more
    accurate than `target` it is the cost of the cheapest: no more than a bound, but a fair one, because a method
    that is better than asked for at a lower cost is the better choice.
    """
    return costs_to_reach(errors, costs, (target,))[0]


def costs_to_reach(errors: Sequence[float], costs: Sequence[float], targets: Sequence[float]) -> list[float]:
    """`cost_to_reach` for several errors."""
    points = sorted(
        (e, c)
        for e, c in zip(errors, costs, strict=True)
        if min(e, c) > 0 and math.isfinite(e) and math.isfinite(c)
    )
    front: list[tuple[float, float]] = []
    for error, cost in points:  # errors ascend: drop points that cost no less than a better one
        if front and cost >= front[-1][1]:
            continue
        front.append((error, cost))
    if not front:
        return [math.nan] * len(targets)
    x, y = np.log(np.array(front).T)
    reached = np.exp(np.interp(np.log(targets), x, y)).tolist()
    return [math.nan if t < front[0][0] else cost for t, cost in zip(targets, reached, strict=True)]


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


# -- wins and ties ---------------------------------------------------------------------------------
#: two costs whose ratio is below this are a tie, however quiet the machine
TIE = 1.15
#: the share of repeated measurements that the noise covers
COVERED = 0.95
Verdict = Literal["win", "tie", "loss"]


def noise(times: pd.DataFrame, column: str = "time_repeat_ratio") -> float:
    """By what factor two measurements of one and the same cell differ, in 95 of 100 cells.

    times : rows with a column such as `time_repeat_ratio`, the second measurement of a cell over the first (A/A).
    The empirical quantile of max(r, 1/r); 1 where nothing was measured twice.
    """
    ratios = pd.to_numeric(times[column]).to_numpy(dtype=float, na_value=math.nan)
    ratios = ratios[np.isfinite(ratios) & (ratios > 0)]
    if not len(ratios):
        return 1.0
    # the smallest measured factor that covers the share: no interpolation towards quieter cells
    return float(np.quantile(np.maximum(ratios, 1 / ratios), COVERED, method="higher"))


def verdict(ratio: float, noise: float) -> Verdict:
    """What a cost over that of the other means: a win below 1/margin, a loss above the margin, else a tie.

    The margin is the larger of `TIE` and the measured noise.
    """
    if not ratio > 0:
        raise BadInput(f"ratio = {ratio!r}: must be a ratio of two costs, > 0")
    margin = max(TIE, noise)
    return "win" if ratio < 1 / margin else "loss" if ratio > margin else "tie"
