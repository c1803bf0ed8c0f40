"""Means over long runs, with their standard errors.

What is near in time is correlated.  So a series is cut into blocks much longer than its memory, and the means of the
blocks are taken as independent; with an ensemble every member is a block.  The error of any function of several means
is that of the jackknife: what leaving out one block changes (Efron, Ann. Statist. 7, 1 (1979),
doi:10.1214/aos/1176344552; for one mean it is the standard deviation over √B).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

#: blocks at least: the relative error of an error bar is 1/√(2(B − 1)), here 13 %
BLOCKS = 32


class Average(NamedTuple):
    """A mean, or a function of means, and its standard error; nan where there are fewer than two blocks."""

    value: Any
    error: Any


def blocks(series: np.ndarray) -> np.ndarray:
    """Block means, (B, m), of a series (k, m, n) of m quantities along n independent runs.

    One block for each run; of fewer than `BLOCKS` runs every one is cut into as many equal parts as it takes, what is
    left over at the start not used.
    """
    k, m, n = series.shape
    parts = min(k, -(-BLOCKS // n))
    length = k // parts
    cut = series[k - parts * length :].reshape(parts, length, m, n).mean(axis=1)
    return np.moveaxis(cut, 2, 0).reshape(n * parts, m)


def jackknife(means: np.ndarray, function: Callable[[np.ndarray], Any] = lambda mean: mean) -> Average:
    """Return a function of the mean over blocks (B, m), with its standard error."""
    count = len(means)
    value = np.asarray(function(means.mean(axis=0)))[()]
    if count < 2:
        return Average(value, np.nan * value)
    without = np.array([function(mean) for mean in (means.sum(axis=0) - means) / (count - 1)])
    spread = ((without - without.mean(axis=0)) ** 2).sum(axis=0)
    return Average(value, np.sqrt(spread * (count - 1) / count))
