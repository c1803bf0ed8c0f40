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
    """Seconds per call of each round."""

    whole: Sequence[float]


class Call:
    """A call to be timed; round_seconds : of a round at least.

    first : the seconds that a first call took; after a long one it needs no other to be warm.
    """

    def __init__(
        self, run: Callable[[], object], round_seconds: float = ROUND_SECONDS, first: float = 0.0
    ) -> None:
        self.run, self.round_seconds = run, round_seconds
        self.once = first if first > LONG else math.nan

    def warm_up(self) -> float:
        """Call it until it is warm: a long one once, a short one for a round more; return how long a round takes."""
        if math.isnan(self.once):
            self.once = seconds(self.run, 1)
            if self.once <= LONG:
                self.once = min(self.once, seconds(self.run, self.calls_a_round()))
        return max(self.round_seconds, self.once)

    def calls_a_round(self) -> int:
        return math.ceil(self.round_seconds / self.once)

    def visit(self, rounds: int = ROUNDS) -> Visit:
        self.warm_up()
        calls, collects = self.calls_a_round(), gc.isenabled()
        gc.disable()
        try:
            turns = [seconds(self.run, calls) for _ in range(1 if self.once > LONG else rounds)]
        finally:
            if collects:
                gc.enable()
        self.once = min(self.once, *turns)
        return Visit(turns)


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


def time_columns(visits: Sequence[Visit]) -> dict[str, float]:
    """Return the estimate of a call, its least round, and by how much odd visits and even ones differ."""
    return {"least_s": least(visits)} | ratio_column("halves", least, visits[::2], visits[1::2])


def ratio_column(
    name: str, cost: Callable[[Sequence[Visit]], float], first: Sequence[Visit], second: Sequence[Visit]
) -> dict[str, float]:
    if not second or min(cost(first), cost(second)) <= 0:
        return {}
    return {name: cost(second) / cost(first)}


def least(visits: Sequence[Visit]) -> float:
    return float(min(min(visit.whole) for visit in visits))
