"""How calls are timed: rounds of about a millisecond, and every run measured twice.

What two measurements of one and the same run differ by (A/A) is the noise of the machine.
"""

from __future__ import annotations

import gc
import random
from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any

import numpy as np

VISITS = 2
#: seconds a round takes at least, so that the clock's resolution plays no part
ROUND_SECONDS = 1e-3
#: rounds of one visit
FEWEST_ROUNDS, MOST_ROUNDS = 3, 20
SEED = 20

Samples = list[float]  #: seconds per call, one number a round


def time_columns(measured: Sequence[Samples], iterations: int) -> dict[str, Any]:
    """The time columns from the samples of one or two visits."""
    together = np.concatenate(measured)
    low, median, high = np.percentile(together, (25, 50, 75)).tolist()
    times = {
        "time_min_s": float(together.min()), "time_median_s": median, "time_iqr_s": high - low,
        "rounds": len(together), "iterations": iterations,
    }  # fmt: skip
    if len(measured) == VISITS:
        first, second = map(np.median, measured)
        times["time_repeat_ratio"] = float(second / first)
    return times


def calls_a_round(once: float) -> int:
    """How many calls fill a round, where one takes so many seconds."""
    return max(1, round(ROUND_SECONDS / once))


def rounds_within(seconds: float, round_seconds: float) -> int:
    """How many rounds of one visit fit, within what is sensible."""
    return min(MOST_ROUNDS, max(FEWEST_ROUNDS, round(seconds / round_seconds)))


class Race:
    """Runs timed in turns: in each round every run once, in shuffled order, so that a slow drift of the
    machine hits all alike; the rounds of the second visit come after all of the first.

    runs : functions without arguments, called until they are warm before.  `columns` can be asked for at any
    moment: an interrupted race has the rounds that it finished.
    """

    def __init__(self, runs: Sequence[Callable[[], Any]]) -> None:
        self.runs = list(runs)
        self.iterations = [1] * len(self.runs)
        self.measured: list[list[Samples]] = [[] for _ in self.runs]

    def warm_up(self) -> float:
        """Seconds that a round of all runs takes."""
        total = 0.0
        for i, run in enumerate(self.runs):
            once = min(_seconds(run, 1) for _ in range(2))
            self.iterations[i] = calls_a_round(once)
            total += once * self.iterations[i]
        return total

    def go(self, seconds: float, tick: Callable[[], Any] = lambda: None) -> None:
        """Both visits, within about so many seconds, but not fewer than `FEWEST_ROUNDS` rounds each."""
        if not self.runs:
            return
        rounds = rounds_within(seconds / VISITS, self.warm_up())
        shuffle, order, collects = random.Random(SEED), list(range(len(self.runs))), gc.isenabled()
        gc.disable()
        try:
            for visit in range(VISITS):
                for _ in range(rounds):
                    shuffle.shuffle(order)
                    for i in order:
                        sample = _seconds(self.runs[i], self.iterations[i])
                        if len(self.measured[i]) == visit:
                            self.measured[i].append([])
                        self.measured[i][visit].append(sample)
                    tick()
        finally:
            if collects:
                gc.enable()

    def columns(self, i: int) -> dict[str, Any]:
        """The time columns of run i, empty where it was not timed."""
        return time_columns(self.measured[i], self.iterations[i]) if self.measured[i] else {}


def _seconds(run: Callable[[], Any], iterations: int) -> float:
    start = perf_counter()
    for _ in range(iterations):
        run()
    return (perf_counter() - start) / iterations
