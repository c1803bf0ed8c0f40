"""Time calls: prepare all of them, then visit them in turns, contenders more often."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from math import isqrt

import numpy as np
from tqdm import tqdm

from contactbench.measure.clock import ROUNDS, Call, Race, Timed, Visit, least, ratio_column, time_columns
from contactbench.measure.isolation import Worker, usable_cores
from contactbench.methods.base import ENGINES
from contactbench.runs.experiment import Row, Timing
from contactbench.tables.cells import Cell

#: visits to every call before contenders are chosen, and visits to all other calls
FIRST, OTHERS = 2, 3
#: a contender takes at most this multiple of the fastest call with no larger error
NEAR = 2.0
#: sweeps from a call's visit to its next, by the seconds that it lasts more than: what lasts so long is rarely
#: interrupted all along
SPARED = {0.1: 4, 0.02: 2}
#: the kind of engines whose contests are held in the first process
HERE = "compiled"
#: the calls that a second process has prepared
PREPARED: list[Call] = []


def prepare(function: Callable[..., tuple[Row, Call]], *arguments: object) -> tuple[int, Row]:
    known, call = function(*arguments)
    PREPARED.append(call)
    return len(PREPARED) - 1, known


def warm_up(number: int, cores: Iterable[int]) -> float:
    for thread in os.listdir("/proc/self/task") if cores else ():
        os.sched_setaffinity(int(thread), cores)
    return PREPARED[number].warm_up()


def visit(number: int, rounds: int) -> Visit:
    return PREPARED[number].visit(rounds)


def sweeps_between(lasts: float) -> int:
    return next((sweeps for seconds, sweeps in SPARED.items() if lasts > seconds), 1)


@dataclass(frozen=True)
class Remote:
    """Prepare a call in another process without waiting, and time it there."""

    worker: Worker
    prepared: Future[tuple[int, Row]]
    cores: Sequence[int]

    @property
    def known(self) -> Row:
        return self.prepared.result()[1]

    def warm_up(self) -> float:
        return self.worker.submit(warm_up, self.prepared.result()[0], self.cores).result()

    def visit(self, rounds: int = ROUNDS) -> Visit:
        return self.worker.submit(visit, self.prepared.result()[0], rounds).result()


@dataclass
class Entry:
    """Hold a row to time: its call, perhaps the same call in another process, and the receiver of its columns.

    known : the columns of its row that a call here has given before.  told : takes its columns too.
    """

    timing: Timing
    known: Row
    call: Timed
    again: Timed | None
    records: list[Callable[[Row], None]]
    told: Row = field(default_factory=dict)

    @property
    def beside(self) -> tuple[object, ...]:
        """Return the group of a row: only calls of the same scene, saved times and kind of engine compete."""
        key = self.timing.key
        return key["scene"], key["saved"], ENGINES.get(key["engine"])

    def finish(self, visits: Sequence[Visit], again: Sequence[Visit]) -> None:
        columns = time_columns(visits) | (ratio_column("process", least, visits, again) if again else {})
        known = self.call.known if isinstance(self.call, Remote) else self.known
        self.told |= columns
        for record in self.records:
            record(self.timing.key | known | columns)


@dataclass
class Timetable(AbstractContextManager["Timetable"]):
    """Manage the timed rows of an experiment, in the order of their preparation.

    ahead : the cells that are yet to be prepared.  visits : to each contender.
    """

    ahead: set[Cell]
    visits: int
    entries: list[Entry] = field(default_factory=list)
    #: entries by the key of their row
    known: dict[tuple[object, ...], Entry] = field(default_factory=dict)
    #: how many rows of an engine there are so far
    numbers: Counter[str] = field(default_factory=Counter)
    #: the second process
    other: Worker | None = None

    def add(self, timing: Timing, record: Callable[[Row], None]) -> Entry:
        """Prepare a call, unless another cell has prepared the same.

        The contests of compiled runs to the end alone are held in this process, the others in a second one, which
        prepares them at the same time.  Calls of an engine whose numbers are squares are timed in both.
        """
        if (same := self.known.get(tuple(timing.key.values()))) is not None:
            same.records.append(record)
            return same
        number = self.numbers[timing.key["engine"]]
        self.numbers[timing.key["engine"]] += 1
        here = timing.key["saved"] == 1 and ENGINES.get(timing.key["engine"], HERE) == HERE
        twice = isqrt(number) ** 2 == number
        remote = self.second(timing) if twice or not here else None
        known, call = timing.prepare(*timing.arguments) if twice or here else ({}, None)
        if call is not None:
            call.warm_up()
        first, again = (call, remote) if here else (remote, call)
        assert first is not None
        entry = Entry(timing, known, first, again, [record])
        self.entries.append(entry)
        self.known[tuple(timing.key.values())] = entry
        return entry

    def second(self, timing: Timing) -> Remote:
        """Let a second process prepare a call on another core than this one's, and time it on the same."""
        cores = usable_cores()
        mine = sorted(os.sched_getaffinity(0)) if cores else []
        beside = [core for core in cores if core not in mine][:1] or mine
        self.other = self.other or Worker(beside)
        return Remote(self.other, self.other.submit(prepare, timing.prepare, *timing.arguments), mine)

    def go(self) -> None:
        """Visit all calls in turns, contenders and short ones more often; record each after its last visit."""
        lasts = [entry.call.warm_up() for entry in self.entries]
        between, wanted = [sweeps_between(each) for each in lasts], [self.visits] * len(lasts)
        pairs = [(n, call) for n, e in enumerate(self.entries) for call in (e.call, e.again) if call]
        race = Race([call for _, call in pairs])
        for sweep in tqdm(range(self.visits), "timing", unit="sweep", disable=None):
            if sweep == FIRST:
                shares = self.shared_out([own for own, _ in self.visited(race)])
                # two visits at least, by which they differ is the margin
                wanted = [
                    min(self.visits, max(share, apart + 1))
                    for share, apart in zip(shares, between, strict=True)
                ]
            due = [i for i, (n, _) in enumerate(pairs) if sweep < wanted[n] and sweep % between[n] == 0]
            for _ in race.sweep(some=due):
                pass
            for entry, visits, end in zip(self.entries, self.visited(race), wanted, strict=True):
                if end == sweep + 1:
                    entry.finish(*visits)

    def visited(self, race: Race) -> Iterator[tuple[list[Visit], list[Visit]]]:
        """Yield the visits to each call, and to its twin in the second process."""
        made = iter(race.visits)
        for entry in self.entries:
            yield next(made), next(made) if entry.again else []

    def shared_out(self, visits: Sequence[Sequence[Visit]]) -> list[int]:
        """Return the number of visits to each call; contenders get all of them.

        They are told among those timed beside each other, and those given a tolerance among themselves.
        """
        times = np.array([least(own) for own in visits])
        errors = np.array([entry.timing.error for entry in self.entries])
        by_tolerance = np.array([entry.timing.key["control"] == "rtol" for entry in self.entries])
        wanted = np.full(len(times), min(OTHERS, self.visits))
        fields: dict[object, list[int]] = {}
        for n, entry in enumerate(self.entries):
            fields.setdefault(entry.beside, []).append(n)
        for which in map(np.array, fields.values()):
            rivals = errors[which][None] <= errors[which][:, None]
            rivals &= by_tolerance[which][None] | ~by_tolerance[which][:, None]
            least_of = np.where(rivals, times[which][None], np.inf).min(axis=1)
            wanted[which[times[which] <= NEAR * least_of]] = self.visits
        # what two processes differ by is the margin of every contest
        wanted[[entry.again is not None for entry in self.entries]] = self.visits
        return [int(n) for n in wanted]

    def __exit__(self, *_: object) -> None:
        if self.other is not None:
            self.other.close()
