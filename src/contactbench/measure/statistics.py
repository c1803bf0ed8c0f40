"""Compare costs at equal error: interpolated costs, ratios with intervals, margins and verdicts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from contactbench.errors import BadInput
from contactbench.numbers.protocol import Arithmetic, Condition


def costs_to_reach(errors: Sequence[float], costs: Sequence[float], targets: Sequence[float]) -> list[float]:
    """Return the cost to reach each target error; nan if no setting is accurate enough.

    Costs are interpolated log–log on the lower envelope, so that a poor setting does not count against a method.  If
    every setting is more accurate than the target, the cheapest gives the cost, an upper bound.
    """
    return interpolate(errors, costs, envelope(errors, costs), targets)


def envelope(errors: Sequence[float], costs: Sequence[float]) -> list[int]:
    """Return the indices of the settings that cost less than every more accurate one, most accurate first."""
    points = sorted(
        (e, c, i)
        for i, (e, c) in enumerate(zip(errors, costs, strict=True))
        if min(e, c) > 0 and math.isfinite(e) and math.isfinite(c)
    )
    front: list[int] = []
    for _, cost, i in points:
        if not front or cost < costs[front[-1]]:
            front.append(i)
    return front


def interpolate(
    errors: Sequence[float], values: Sequence[float], front: Sequence[int], targets: Sequence[float]
) -> list[float]:
    """Return positive values at target errors, log–log between the settings `front`; nan below their least error."""
    if not front:
        return [math.nan] * len(targets)
    x, y = np.log([[errors[i], values[i]] for i in front]).T
    reached = np.exp(np.interp(np.log(targets), x, y)).tolist()
    return [math.nan if t < errors[front[0]] else value for t, value in zip(targets, reached, strict=True)]


#: number of bootstrap samples for an interval
RESAMPLES = 2000


@dataclass(frozen=True)
class PairedRatio:
    """Hold the ratio of two times: median over rounds and its 95 % bootstrap interval."""

    ratio: float
    low: float
    high: float
    rounds: int


def paired_ratio(base: Sequence[float], head: Sequence[float]) -> PairedRatio:
    """Return the ratio head/base of times measured in pairs; slow drifts of the machine cancel in a pair.

    The interval is the percentile bootstrap of the median log-ratio with a fixed seed (Efron, Ann. Stat. 7, 1 (1979),
    doi:10.1214/aos/1176344552).
    """
    logs = np.log(np.asarray(head, dtype=float)) - np.log(np.asarray(base, dtype=float))
    resampled = np.random.default_rng(0).choice(logs, (RESAMPLES, len(logs)))
    low, high = np.percentile(np.median(resampled, axis=1), [2.5, 97.5])
    return PairedRatio(math.exp(np.median(logs)), math.exp(low), math.exp(high), len(logs))


# -- shares and quantiles of a sample --------------------------------------------------------------
#: quantile of the normal distribution for a 95 % interval
NORMAL = 1.959964


def wilson(part: int, whole: int) -> tuple[float, float]:
    """Return the 95 % interval of the share part/whole (Wilson, J. Am. Stat. Assoc. 22, 209 (1927))."""
    if not whole:
        return 0.0, 1.0
    share, z2 = part / whole, NORMAL**2 / whole
    middle, half = share + z2 / 2, NORMAL * math.sqrt(share * (1 - share) / whole + z2 / (4 * whole))
    return max(0.0, (middle - half) / (1 + z2)), min(1.0, (middle + half) / (1 + z2))


def quantile_interval(values: Sequence[float], q: float) -> tuple[float, float, float]:
    """Return a quantile and its 95 % percentile bootstrap interval (fixed seed); nan if there are no values."""
    own = np.asarray(values, dtype=float)
    if not len(own):
        return math.nan, math.nan, math.nan
    resampled = np.random.default_rng(0).choice(own, (RESAMPLES, len(own)))
    # "nearest" because infinite values cannot be interpolated
    found = np.quantile(resampled, q, axis=1, method="nearest")
    low, high = np.quantile(found, [0.025, 0.975], method="nearest")
    return float(np.quantile(own, q, method="nearest")), float(low), float(high)


# -- wins and ties ---------------------------------------------------------------------------------
#: errors within this factor count as equal
ALIKE = 2.0
#: times within this factor of the least tie, since another processor may reorder them; a wider margin is undecided
WIDEST = 1.25
#: largest ratio between the two halves of the visits of a quiet cell
FLOOR = 1.03
#: factor between the times of a cell in two processes, for 95 % of cells (memory layout); measured over five processes
#: and used for tables without a second process
PROCESSES = 1.04
#: share of cells whose two processes differ by at most the spread
COVERED = 0.95


class Verdict(StrEnum):
    """Rate a cost against another cost."""

    win = "win"
    tie = "tie"
    loss = "loss"
    undecided = "undecided"  #: closer than the margin, and the margin is wider than `WIDEST`


def process_spread(ratios: Iterable[float], halves: Iterable[float]) -> float:
    """Return the factor within which two processes agree on 95 % of the cells.

    ratios : time in the second process over the first, by cell.  halves : ratio of the halves of a cell's visits; cells
    beyond `FLOOR` are noisy by themselves and left out, since their own margins cover that.
    """
    pairs = [(r, h) for r, h in zip(ratios, halves, strict=True) if r > 0 and math.isfinite(r)]
    if not pairs:
        return PROCESSES
    quiet = [r for r, h in pairs if 1 / FLOOR <= h <= FLOOR]
    known = np.array(quiet or [r for r, _ in pairs])
    # "higher" takes a measured factor and does not interpolate towards quieter cells
    return float(np.quantile(np.maximum(known, 1 / known), COVERED, method="higher"))


def margin(halves: Iterable[float], processes: float, within: float = WIDEST) -> float:
    """Return the factor by which one of two costs must be less to lead alone.

    It is `within`, or the uncertainty of the clock if larger: the spread between the halves of each cell's visits
    and between two processes, combined in quadrature of their logarithms.
    """
    logs = [math.log(ratio) if ratio > 0 else math.inf for ratio in (*halves, processes)]
    return max(within, math.exp(math.hypot(*logs)))


def ties(value: Arithmetic, least: Arithmetic, margin: float) -> Condition:
    """Return whether a value, or each of an array, is at most `margin` times the least."""
    return value <= margin * least


def verdict(ratio: float, margin: float) -> Verdict:
    if not ratio > 0:
        raise BadInput(f"ratio = {ratio!r}: must be a ratio of two costs, > 0")
    if not ties(max(ratio, 1 / ratio), 1.0, margin):
        return Verdict.win if ratio < 1 else Verdict.loss
    return Verdict.tie if margin <= WIDEST else Verdict.undecided
