"""How calls are timed: every call is visited again and again, in shuffled order, and its least round counts.

A processor changes its speed in phases of seconds and other work interrupts a call; both only ever make it slower.
"""

from __future__ import annotations

import gc
import math
import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Protocol

import numpy as np

#: visits to every call, however long it takes, and as many as a race makes where there is time
VISITS, MOST_VISITS = 8, 24
#: rounds of a visit, and the seconds a round takes at least, so that the clock's resolution plays no part
ROUNDS, ROUND_SECONDS = 3, 3e-4
#: seconds from which a call has one round a visit, the next would meet the same phase of the machine, and no warm-up:
#: cold caches cost it hardly anything
LONG = 5e-3
SEED = 20


@dataclass(frozen=True)
class Visit:
    """Seconds per call of each round (of so many iterations), and of the same run over a part of its length."""

    whole: Sequence[float]
    part: Sequence[float] = ()
    iterations: int = 1


@dataclass(frozen=True)
class Part:
    run: Callable[[], object]
    share: float
    span: float

    def marginal(self, visits: Sequence[Visit]) -> float:
        short = min(min(visit.part) for visit in visits)
        return float((least(visits) - short) / ((1 - self.share) * self.span))


class Call:
    """A call, and the same over a part of its length, timed in turns; round_seconds : of a round at least."""

    def __init__(
        self, run: Callable[[], object], part: Part | None = None, round_seconds: float = ROUND_SECONDS
    ) -> None:
        self.part, self.round_seconds = part, round_seconds
        self.runs = [run] if part is None else [run, part.run]
        self.once: list[float] = []

    def warm_up(self) -> float:
        """Call each run until it is warm: a long one once, a short one for a round more."""
        if not self.once:
            for run in self.runs:
                once = seconds(run, 1)
                self.once.append(once if once > LONG else min(once, seconds(run, self.calls_a_round(once))))
        return sum(max(self.round_seconds, once) for once in self.once)

    def without_part(self) -> Call:
        """Return the whole alone, as warm as it is."""
        whole = Call(self.runs[0], round_seconds=self.round_seconds)
        whole.once = self.once[:1]
        return whole

    def calls_a_round(self, once: float) -> int:
        return math.ceil(self.round_seconds / once)

    def rounds(self, most: int = ROUNDS) -> int:
        return 1 if self.once[0] > LONG else most

    def visit(self, rounds: int = ROUNDS) -> Visit:
        self.warm_up()
        calls = [self.calls_a_round(once) for once in self.once]
        collects = gc.isenabled()
        gc.disable()
        try:
            turns = [
                [seconds(*each) for each in zip(self.runs, calls, strict=True)]
                for _ in range(self.rounds(rounds))
            ]
        finally:
            if collects:
                gc.enable()
        self.once = [min(times) for times in zip(self.once, *turns, strict=True)]
        whole, *part = zip(*turns, strict=True)
        return Visit(whole, part[0] if part else (), calls[0])


def seconds(run: Callable[[], object], iterations: int) -> float:
    start = perf_counter()
    for _ in range(iterations):
        run()
    return (perf_counter() - start) / iterations


class Timed(Protocol):
    """A call that can be timed, in this process or another one."""

    def warm_up(self) -> float: ...
    def visit(self, rounds: int = ROUNDS) -> Visit: ...


class Race:
    """Calls timed side by side: every sweep visits each of them once, in an order of its own."""

    def __init__(self, calls: Sequence[Timed]) -> None:
        self.calls = list(calls)
        self.visits: list[list[Visit]] = [[] for _ in self.calls]
        self.shuffle = random.Random(SEED)

    def sweep(self, rounds: Sequence[int] | None = None, some: Sequence[int] | None = None) -> Iterator[int]:
        which = range(len(self.calls)) if some is None else some
        for i in self.shuffle.sample(which, len(which)):
            self.visits[i].append(self.calls[i].visit(rounds[i] if rounds else ROUNDS))
            yield i

    def go(self, budget: float, limit: float = math.inf) -> None:
        """Make `VISITS` visits, and more within so many seconds; where time is short a visit has fewer rounds.

        After `limit` seconds it ends as it is.
        """
        start, lengths = perf_counter(), list[float]()
        for call in self.calls:
            lengths.append(call.warm_up())
            if perf_counter() > start + limit:
                return
        share = max(0.0, start + budget - perf_counter()) / VISITS / max(1, len(lengths))
        rounds = [min(ROUNDS, max(1, int(share / length))) for length in lengths]
        sweep = sum(n * length for n, length in zip(rounds, lengths, strict=True))
        for visit in range(MOST_VISITS):
            if visit >= VISITS and perf_counter() + sweep > start + budget:
                break
            for _ in self.sweep(rounds):
                if perf_counter() > start + limit:
                    return


def time_columns(visits: Sequence[Visit]) -> dict[str, object]:
    """Return the time columns of one call: the estimate is the least round, the rest says how it came about."""
    rounds = np.concatenate([visit.whole for visit in visits])
    low, median, high = np.percentile(rounds, (25, 50, 75)).tolist()
    columns = {"time_min_s": least(visits), "time_median_s": median, "time_iqr_s": high - low}
    columns |= {"visits": len(visits), "rounds": len(rounds), "iterations": visits[-1].iterations}
    return columns | ratio_column("time_halves_ratio", least, visits[::2], visits[1::2])


def length_columns(visits: Sequence[Visit], part: Part) -> dict[str, float]:
    """Return fixed and marginal cost: time = fixed + marginal · T; where steps shrink fixed_s may be negative."""
    slope = part.marginal(visits)
    columns = {"fixed_s": least(visits) - slope * part.span, "marginal_s": slope}
    return columns | ratio_column("marginal_halves_ratio", part.marginal, visits[::2], visits[1::2])


def process_columns(
    visits: Sequence[Visit], again: Sequence[Visit], part: Part | None = None
) -> dict[str, float]:
    columns = ratio_column("time_process_ratio", least, visits, again)
    if part is not None and all(visit.part for visit in again):
        columns |= ratio_column("marginal_process_ratio", part.marginal, visits, again)
    return columns


def ratio_column(
    name: str, cost: Callable[[Sequence[Visit]], float], first: Sequence[Visit], second: Sequence[Visit]
) -> dict[str, float]:
    if not second or min(cost(first), cost(second)) <= 0:
        return {}
    return {name: cost(second) / cost(first)}


def least(visits: Sequence[Visit]) -> float:
    return float(min(min(visit.whole) for visit in visits))
