"""Costs at equal error, paired ratios, margins and ties; and means over long runs, with their standard errors."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from contactbench.errors import BadInput
from contactbench.numbers.protocol import Arithmetic, Condition


def costs_to_reach(errors: Sequence[float], costs: Sequence[float], targets: Sequence[float]) -> list[float]:
    """Return the costs of some errors, by log–log interpolation; nan where no setting is as accurate.

    On the lower envelope: no method is charged for a poor setting it has no need of.  Where every setting is more
    accurate than asked for it is the cost of the cheapest, a bound.
    """
    return interpolate(errors, costs, envelope(errors, costs), targets)


def envelope(errors: Sequence[float], costs: Sequence[float]) -> list[int]:
    """Return which settings cost less than every more accurate one, from the most accurate on."""
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
    """Return values > 0 at some errors, log–log between the settings of an envelope; nan below its smallest error."""
    if not front:
        return [math.nan] * len(targets)
    x, y = np.log([[errors[i], values[i]] for i in front]).T
    reached = np.exp(np.interp(np.log(targets), x, y)).tolist()
    return [math.nan if t < errors[front[0]] else value for t, value in zip(targets, reached, strict=True)]


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
    """Return the ratio head/base of times taken in pairs, in which a slower drift of the machine cancels.

    The median of the log-ratios is resampled (Efron, Ann. Stat. 7, 1 (1979), doi:10.1214/aos/1176344552, percentile
    interval, fixed seed).
    """
    logs = np.log(np.asarray(head, dtype=float)) - np.log(np.asarray(base, dtype=float))
    resampled = np.random.default_rng(0).choice(logs, (RESAMPLES, len(logs)))
    low, high = np.percentile(np.median(resampled, axis=1), [2.5, 97.5])
    return PairedRatio(math.exp(np.median(logs)), math.exp(low), math.exp(high), len(logs))


# -- shares and quantiles of a sample --------------------------------------------------------------
#: the normal quantile of an interval of 95 %
NORMAL = 1.959964


def wilson(part: int, whole: int) -> tuple[float, float]:
    """Return the interval of 95 % of a share, `part` of `whole` (Wilson, J. Am. Stat. Assoc. 22, 209 (1927))."""
    if not whole:
        return 0.0, 1.0
    share, z2 = part / whole, NORMAL**2 / whole
    middle, half = share + z2 / 2, NORMAL * math.sqrt(share * (1 - share) / whole + z2 / (4 * whole))
    return max(0.0, (middle - half) / (1 + z2)), min(1.0, (middle + half) / (1 + z2))


def quantile_interval(values: Sequence[float], q: float) -> tuple[float, float, float]:
    """Return a quantile and its interval of 95 %, by resampling (percentiles, fixed seed); nan of no values."""
    own = np.asarray(values, dtype=float)
    if not len(own):
        return math.nan, math.nan, math.nan
    resampled = np.random.default_rng(0).choice(own, (RESAMPLES, len(own)))
    found = np.quantile(
        resampled, q, axis=1, method="nearest"
    )  # infinite values are no numbers to interpolate
    low, high = np.quantile(found, [0.025, 0.975], method="nearest")
    return float(np.quantile(own, q, method="nearest")), float(low), float(high)


# -- wins and ties ---------------------------------------------------------------------------------
#: errors within this factor are alike
ALIKE = 2.0
#: a verdict on time names all within this factor of the least: so much another processor moves.  A margin that is
#: wider decides nothing
WIDEST = 1.25
#: cells whose halves agree within this are quiet
FLOOR = 1.03
#: by what factor a cell's least round differs from process to process, in 95 of 100 cells (the layout of code and data
#: in memory): measured over five processes, for tables in which no second process timed anything
PROCESSES = 1.04
#: the share of cells that what two processes differ by covers
COVERED = 0.95


class Verdict(StrEnum):
    """What a cost is beside another one."""

    win = "win"
    tie = "tie"
    loss = "loss"
    undecided = "undecided"  #: the clock does not tell: within a margin that is wider than `WIDEST`


def process_spread(ratios: Iterable[float], halves: Iterable[float]) -> float:
    """Return by what factor two processes differ on a cell, in 95 of 100; ratios : of a sample, second over first.

    Cells whose halves differ by more than `FLOOR` are noisy themselves, which their margins know already.
    """
    pairs = [(r, h) for r, h in zip(ratios, halves, strict=True) if r > 0 and math.isfinite(r)]
    if not pairs:
        return PROCESSES
    quiet = [r for r, h in pairs if 1 / FLOOR <= h <= FLOOR]
    known = np.array(quiet or [r for r, _ in pairs])
    # the smallest measured factor that covers the share: no interpolation towards quieter cells
    return float(np.quantile(np.maximum(known, 1 / known), COVERED, method="higher"))


def margin(halves: Iterable[float], processes: float, within: float = WIDEST) -> float:
    """Return the factor by which one of two costs must be less to lead alone.

    It is `within`, or what the clock leaves open: the halves of either's visits, and two processes.
    """
    logs = [math.log(ratio) if ratio > 0 else math.inf for ratio in (*halves, processes)]
    return max(within, math.exp(math.hypot(*logs)))


def ties(value: Arithmetic, least: Arithmetic, margin: float) -> Condition:
    """Return whether a cost or an error, or each of a column, is no more than the least but for a margin."""
    return value <= margin * least


def verdict(ratio: float, margin: float) -> Verdict:
    if not ratio > 0:
        raise BadInput(f"ratio = {ratio!r}: must be a ratio of two costs, > 0")
    if not ties(max(ratio, 1 / ratio), 1.0, margin):
        return Verdict.win if ratio < 1 else Verdict.loss
    return Verdict.tie if margin <= WIDEST else Verdict.undecided
