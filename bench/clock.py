"""The timed part of an experiment: all cells are prepared first, then visited in turns.

A sample of them is prepared in a second process too and visited in the same turns: what processes differ by.
"""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from contactbench.measure.clock import (
    ROUNDS,
    Part,
    Race,
    Timed,
    Visit,
    length_columns,
    process_columns,
    time_columns,
)

#: cells of every engine that a second process times too
SAMPLE = 20
SEED = 20


class Process:
    """Another process, which prepares cells on some cores when told, and times them on others when asked."""

    def __init__(self, cores: list[int], timed_on: list[int]) -> None:
        self.process = subprocess.Popen(
            [sys.executable, Path(__file__).with_name("other_process.py"), json.dumps([cores, timed_on])],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        self.prepared = 0

    def prepare(self, function: Callable[..., Any], *arguments: Any) -> Remote:
        """Let it call a function of an experiment that returns (row, call); do not wait for it."""
        self.tell("prepare", function.__module__.rpartition(".")[2], function.__name__, *arguments)
        self.prepared += 1
        return Remote(self, self.prepared - 1)

    def tell(self, *command: Any) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(command) + "\n")

    def ask(self, *command: Any) -> Any:
        self.tell(*command)
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"a process that times cells ended with status {self.process.wait()}")
        return json.loads(line)

    def end(self) -> None:
        self.process.kill()
        self.process.communicate()


@dataclass(frozen=True)
class Remote:
    """A call that another process times."""

    process: Process
    number: int

    def row(self) -> dict[str, Any]:
        """Return what its preparation says of it, as soon as it is prepared."""
        return self.process.ask("row", self.number)

    def warm_up(self) -> float:
        return self.process.ask("warm", self.number)

    def visit(self, rounds: int = ROUNDS) -> Visit:
        return Visit(*self.process.ask("visit", self.number, rounds))


@dataclass(frozen=True)
class Entry:
    """A cell to be timed: its call, the same call in a second process, and who takes its time columns.

    part : of the run, with a length of its own.  benchmark : the fixture of pytest-benchmark, which has the rounds.
    """

    call: Timed
    part: Part | None
    again: Timed | None
    record: Callable[[dict[str, Any]], None]
    benchmark: Any = None

    def finish(self, columns: dict[str, Any], visits: list[Visit]) -> None:
        """Record the times; pytest-benchmark has no public way to be given rounds that it has not timed itself."""
        if self.benchmark is not None:
            stats = self.benchmark._make_stats(visits[-1].iterations)
            for visit in visits:
                for once in visit.whole:
                    stats.update(once * stats.iterations)
        self.record(columns)


class Timetable:
    """The timed cells of an experiment, in the order in which they were prepared.

    cells : all there will be, and the engine of each; a sample of every engine's is timed in a second process too.
    visits : to each.
    """

    def __init__(self, cells: Mapping[Any, str], visits: int) -> None:
        self.visits = visits
        self.sample: set[Any] = set()
        for engine in sorted(set(cells.values())):
            own = [cell for cell, its in cells.items() if its == engine]
            self.sample |= set(random.Random(SEED).sample(own, min(SAMPLE, -(-len(own) // 2))))
        #: cells that are yet to be prepared
        self.ahead = set(cells)
        self.entries: list[Entry] = []
        self.processes: dict[str, Process] = {}

    def process(self, name: str, cores: list[int], timed_on: list[int]) -> Process:
        """Return the process of this name, started when it is first asked for."""
        if name not in self.processes:
            self.processes[name] = Process(cores, timed_on)
        return self.processes[name]

    def second(self) -> Process:
        """Return the second process: it prepares cells on another core than this one's, and times on the same."""
        if not hasattr(os, "sched_getaffinity"):
            return self.process("second", [], [])
        mine = sorted(os.sched_getaffinity(0))
        return self.process("second", [core for core in usable_cores() if core not in mine][:1] or mine, mine)

    def go(self) -> None:
        """Visit all cells, and record each with its last visit."""
        calls: list[Timed] = []
        cells: list[Entry] = []
        for entry in self.entries:
            for call in filter(None, (entry.call, entry.again)):
                call.warm_up()
                calls.append(call)
                cells.append(entry)
        race = Race(calls)
        visits = {id(call): made for call, made in zip(calls, race.visits, strict=True)}
        for _ in tqdm(range(self.visits), "timing", unit="sweep", disable=None):
            for i in race.sweep():
                entry, own = cells[i], visits[id(cells[i].call)]
                again = visits[id(entry.again)] if entry.again else own
                if min(len(own), len(again)) == self.visits:
                    entry.finish(self.columns(entry, own, again), own)

    def columns(self, entry: Entry, own: list[Visit], again: list[Visit]) -> dict[str, Any]:
        columns = time_columns(own)
        if entry.part is not None:
            columns |= length_columns(own, entry.part)
        if entry.again is not None:
            columns |= process_columns(own, again, entry.part)
        return columns

    def end(self) -> None:
        for process in self.processes.values():
            process.end()


def usable_cores() -> list[int]:
    """The cores the machine lets us use; this process is bound to one of them."""
    bound = os.sched_getaffinity(0)
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    try:
        return sorted(os.sched_getaffinity(0))
    finally:
        os.sched_setaffinity(0, bound)


@dataclass(frozen=True)
class Clock:
    """The clock of one cell.

    timetable : None in a run without times.  record : a row of a table, now; later : the same with the time columns.
    """

    timetable: Timetable | None
    cell: Any
    record: Callable[..., None]
    later: Callable[..., Callable[[dict[str, Any]], None]]
    benchmark: Any = None

    def time(self, table: Any, row: dict[str, Any], prepare: Callable[..., Any], *arguments: Any) -> None:
        """Time a cell; `prepare` gives what its row says beside `row`, and its call, None where it cannot be run.

        Its arguments go to a second process as JSON.
        """
        more, call = prepare(*arguments)
        row = row | more
        if call is None or self.timetable is None:
            self.record(table, **row)
            return
        call.warm_up()
        again = None
        if self.cell in self.timetable.sample:
            again = self.timetable.second().prepare(prepare, *arguments)
        self.timetable.entries.append(Entry(call, call.part, again, self.later(table, row), self.benchmark))

    def time_on(self, cores: list[int], table: Any, prepare: Callable[..., Any], *arguments: Any) -> None:
        """Time a cell in a process of its own on several cores."""
        if self.timetable is None:
            self.record(table, **prepare(*arguments)[0])
            return
        process = self.timetable.process(f"on {cores}", cores, cores)
        call = process.prepare(prepare, *arguments)
        self.timetable.entries.append(Entry(call, None, None, self.later(table, call.row()), self.benchmark))
