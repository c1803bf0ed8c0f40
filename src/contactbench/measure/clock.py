"""How calls are timed: rounds of about half a millisecond, and every run measured twice.

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
ROUND_SECONDS = 5e-4
#: rounds of one visit of a race, however long they take
FEWEST_ROUNDS, MOST_ROUNDS = 3, 20
#: seconds from which a run that has been called before needs no warm-up: cold caches cost it less than a percent
WARM = 0.02
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


def length_columns(
    whole: Sequence[Samples], part: Sequence[Samples], share: float, span: float
) -> dict[str, float]:
    """Fixed and marginal cost: time = fixed + marginal · T, from two lengths of one run, round by round.

    whole, part : samples of each visit, of the run over `span` and of one over `share` of it, taken in turns.
    The part of a run whose steps grow costs more than its share, which counts as fixed; where they shrink
    fixed_s may be negative.
    """
    long, short = np.concatenate(whole), np.concatenate(part)
    columns: dict[str, float] = {}
    per_time = (long - short) / ((1 - share) * span)
    for name, values in (("fixed", long - per_time * span), ("marginal", per_time)):
        low, median, high = np.percentile(values, (25, 50, 75)).tolist()
        columns |= {f"{name}_s": median, f"{name}_iqr_s": high - low}
    if len(whole) == VISITS:
        first, second = (np.median(a) - np.median(b) for a, b in zip(whole, part, strict=True))
        if min(first, second) > 0:
            columns["marginal_repeat_ratio"] = float(second / first)
    return columns


def calls_a_round(once: float) -> int:
    """How many calls fill a round, where one takes so many seconds."""
    return max(1, round(ROUND_SECONDS / once))


def rounds_within(seconds: float, round_seconds: float, fewest: int = FEWEST_ROUNDS) -> int:
    """How many rounds of one visit fit, within what is sensible."""
    return min(MOST_ROUNDS, max(fewest, round(seconds / round_seconds)))


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

    def warm_up(self) -> list[float]:
        """Seconds that a round of each run takes; a long call is warm after one."""
        rounds = []
        for i, run in enumerate(self.runs):
            once = warm_call(run)
            self.iterations[i] = calls_a_round(once)
            rounds.append(once * self.iterations[i])
        return rounds

    def go(self, seconds: float) -> None:
        """Both visits, within about so many seconds.

        A run that takes longer than its share has fewer rounds than the others, no fewer than `FEWEST_ROUNDS` a visit.
        """
        start, lengths = perf_counter(), self.warm_up()
        if not lengths:
            return
        share = max(0.0, seconds - perf_counter() + start) / VISITS / len(lengths)
        rounds = [rounds_within(share, length) for length in lengths]
        shuffle, order, collects = random.Random(SEED), list(range(len(self.runs))), gc.isenabled()
        gc.disable()
        try:
            for visit in range(VISITS):
                until = perf_counter() + max(0.0, start + seconds - perf_counter()) / (VISITS - visit)
                for turn in range(max(rounds)):
                    if turn >= FEWEST_ROUNDS and perf_counter() > until:
                        break
                    shuffle.shuffle(order)
                    for i in order:
                        if turn < rounds[i]:
                            self._round(i, visit)
        finally:
            if collects:
                gc.enable()

    def _round(self, i: int, visit: int) -> None:
        sample = seconds(self.runs[i], self.iterations[i])
        if len(self.measured[i]) == visit:
            self.measured[i].append([])
        self.measured[i][visit].append(sample)

    def columns(self, i: int) -> dict[str, Any]:
        """The time columns of run i, empty where it was not timed."""
        return time_columns(self.measured[i], self.iterations[i]) if self.measured[i] else {}


def warm_call(run: Callable[[], Any]) -> float:
    """Seconds that a call takes: not the first of a run, which is no measure of the others, unless it is long."""
    once = seconds(run, 1)
    return min(once, seconds(run, 1)) if once < WARM else once


def seconds(run: Callable[[], Any], iterations: int) -> float:
    """Seconds a call, over so many calls."""
    start = perf_counter()
    for _ in range(iterations):
        run()
    return (perf_counter() - start) / iterations
