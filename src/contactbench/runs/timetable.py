"""The timed part of an experiment: all cells are prepared first, then visited in turns."""

from __future__ import annotations

import os
import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager
from dataclasses import dataclass, field

from tqdm import tqdm

from contactbench.measure.clock import (
    ROUNDS,
    SEED,
    Call,
    Race,
    Visit,
    length_columns,
    process_columns,
    time_columns,
)
from contactbench.measure.isolation import Worker, usable_cores
from contactbench.runs.experiment import Row, Timing
from contactbench.tables.cells import Cell

#: cells of every engine that a second process times too
SAMPLE = 40
#: sweeps from a call's visit to its next, by the seconds that it lasts more than: what lasts so long is rarely
#: interrupted all along
SPARED = {0.1: 4, 0.02: 2}
#: the calls that a second process has prepared
PREPARED: list[Call] = []


def prepare(function: Callable[..., tuple[Row, Call]], *arguments: object) -> tuple[int, Row]:
    row, call = function(*arguments)
    PREPARED.append(call)
    return len(PREPARED) - 1, row


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
    """A call that another process prepares, without being waited for, and times."""

    worker: Worker
    prepared: Future[tuple[int, Row]]
    cores: Sequence[int]
    part = None

    def warm_up(self) -> float:
        return self.worker.submit(warm_up, self.prepared.result()[0], self.cores).result()

    def visit(self, rounds: int = ROUNDS) -> Visit:
        return self.worker.submit(visit, self.prepared.result()[0], rounds).result()


@dataclass
class Entry:
    """A cell to be timed: its call, the same call in a second process, and who takes its time columns.

    told : takes the least time of all visits.
    """

    call: Call
    again: Remote | None
    record: Callable[[Row], None]
    told: Row = field(default_factory=dict)

    def finish(self, visits: list[Visit], again: list[Visit]) -> None:
        columns, part = time_columns(visits), self.call.part
        if part is not None:
            columns |= length_columns(visits, part)
        if self.again is not None:
            columns |= process_columns(visits, again, part)
        self.told["least_s"] = columns["time_min_s"]
        self.record(columns)


class Timetable(AbstractContextManager["Timetable"]):
    """The timed cells of an experiment, in the order in which they were prepared.

    cells : all there will be, and the engine of each; a sample of every engine's is timed in a second process too:
    what processes differ by.  visits : to each.
    """

    def __init__(self, cells: Mapping[Cell, str], visits: int) -> None:
        self.visits = visits
        self.sample: set[Cell] = set()
        for engine in sorted(set(cells.values())):
            own = [cell for cell, its in cells.items() if its == engine]
            self.sample |= set(random.Random(SEED).sample(own, min(SAMPLE, -(-len(own) // 2))))
        #: cells that are yet to be prepared
        self.ahead = set(cells)
        self.entries: list[Entry] = []
        #: the second process
        self.other: Worker | None = None

    def second(self, timing: Timing) -> Remote:
        """Let a second process prepare a call on another core than this one's, and time it on the same."""
        cores = usable_cores()
        mine = sorted(os.sched_getaffinity(0)) if cores else []
        beside = [core for core in cores if core not in mine][:1] or mine
        self.other = self.other or Worker(beside)
        return Remote(self.other, self.other.submit(prepare, timing.prepare, *timing.arguments), mine)

    def go(self) -> None:
        """Visit all of them in turns, slow ones less often; each is recorded with its last visit."""
        pairs = [(entry, call) for entry in self.entries for call in (entry.call, entry.again) if call]
        between = [sweeps_between(call.warm_up()) for _, call in pairs]
        race = Race([call for _, call in pairs])
        visits = {id(call): made for (_, call), made in zip(pairs, race.visits, strict=True)}
        wanted = {id(call): -(-self.visits // apart) for (_, call), apart in zip(pairs, between, strict=True)}
        for sweep in tqdm(range(self.visits), "timing", unit="sweep", disable=None):
            for i in race.sweep(some=[i for i, apart in enumerate(between) if sweep % apart == 0]):
                entry = pairs[i][0]
                calls = [call for call in (entry.call, entry.again) if call]
                if all(len(visits[id(call)]) == wanted[id(call)] for call in calls):
                    entry.finish(visits[id(entry.call)], visits.get(id(entry.again), []))

    def __exit__(self, *_: object) -> None:
        if self.other is not None:
            self.other.close()
