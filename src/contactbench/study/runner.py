"""Runs experiments: on all cores what is measured without a clock, then what is timed, alone on one of them.

A cell that is finished is a file (`results.cells`): a run that is killed loses what it had not finished, and no row.
"""

from __future__ import annotations

import os
import re
import sys
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import groupby
from pathlib import Path
from typing import Any

from tqdm import tqdm

from contactbench.errors import BadInput, one_line
from contactbench.measure.isolation import Died, Worker
from contactbench.methods import METHODS
from contactbench.methods.base import ENGINES
from contactbench.plugins import brought
from contactbench.results import cells as journal
from contactbench.results import provenance
from contactbench.results.schema import TABLES, Table
from contactbench.results.store import OldTable, read
from contactbench.study.experiment import Cell, Experiment, Profile, Row, Timing, experiments
from contactbench.study.timetable import Entry, Remote, Timetable
from contactbench.xla import keep_programs


class DiskFull(BadInput):
    """The disk takes no more; what was finished before is there."""


@contextmanager
def disk() -> Iterator[None]:
    """Say in one line where a disk takes no more."""
    try:
        yield
    except OSError as error:
        where = f"{error.strerror} ({error.filename})" if error.filename else error.strerror
        raise DiskFull(f"{where}: finished cells are kept; make room, then --resume") from None


@dataclass(frozen=True)
class Task:
    """A cell of an experiment; name : of the cell among those of the experiment."""

    experiment: Experiment
    cell: Cell
    name: str

    def __str__(self) -> str:
        return f"{self.experiment.name}[{self.name}]"

    @property
    def key(self) -> journal.Cell:
        return self.experiment.question, str(self)

    @property
    def engine(self) -> str:
        return next((part for part in self.cell if part in ENGINES), "")

    def matches(self, expression: str) -> bool:
        """Whether an expression of parts of names, ``and``, ``or``, ``not`` and parentheses holds, as pytest's -k."""
        timed = " timed" * self.experiment.timed
        known = f"bench/bench_{self.experiment.question}.py test_{self}{timed}".lower()

        def truth(word: re.Match[str]) -> str:
            return word[0] if word[0] in ("and", "or", "not") else str(word[0].lower() in known)

        try:
            return not expression or bool(eval(re.sub(r"[^\s()]+", truth, expression)))
        except (SyntaxError, TypeError):
            raise BadInput(f"-k {expression!r}: must be parts of names, joined by and, or, not") from None


@dataclass(frozen=True)
class Run:
    """One run of the benchmark, by one process or several.

    selection : which part of the experiments was asked for, empty for all of them: the rows of the rest are kept.
    timed : with a clock.  own : only what plug-ins and installed packages bring.
    """

    results: Path
    profile: Profile
    selection: str = ""
    timed: bool = True
    own: bool = False
    name: str = field(default_factory=provenance.new_run_id)

    @cached_property
    def cells(self) -> journal.Cells:
        return journal.Cells(self.results, self.profile.name, self.name, self.selection)

    # -- which cells -------------------------------------------------------------------------------
    def tasks(self) -> list[Task]:
        return [task for each in experiments().values() for task in self.tasks_of(each)]

    def tasks_of(self, experiment: Experiment) -> list[Task]:
        """Return the cells of an experiment; none of what adds times alone in a run without times."""
        cells = [] if experiment.errors and not self.timed else experiment.cells(self.profile)
        if self.own:
            own = brought()
            cells = [cell for cell in cells if not own.isdisjoint(cell)]
        named = {
            "-".join(f"{p:.6g}" if isinstance(p, float) else str(p) for p in cell): cell for cell in cells
        }
        return [Task(experiment, cell, name) for name, cell in named.items()]

    # -- its beginning and its end -----------------------------------------------------------------
    def begin(self) -> None:
        """Merge what killed runs have left; raises `BadInput` for a table that could not be merged into."""
        try:
            for table in TABLES.values():  # refused now rather than after ten minutes
                with suppress(*([] if self.selection else [OldTable])):  # a whole run replaces those
                    read(table, self.results)
            self.cells.begin(provenance.environment(self.profile.name))
        except (BadInput, OSError) as error:
            raise BadInput(f"--results {self.results}: {error}") from None

    def remaining(self, tasks: Iterable[Task], resume: bool) -> list[Task]:
        """Return what is not done; unless it resumes, the run begins anew."""
        if not resume:
            with disk():
                self.cells.begin_anew()
        done = self.cells.done() if resume else ()
        return [task for task in tasks if task.key not in done]

    def end(self) -> None:
        with disk():
            self.cells.merge(() if self.selection else [task.key for task in self.tasks()])

    # -- one cell ----------------------------------------------------------------------------------
    def complete(self, task: Task, table: Table, row: Row) -> Row:
        """Add the family of the method, and the smallest profile that has the cell; raise `BadInput` for a bad row."""
        known = "family" in table.columns and row["method"] in METHODS
        family = {"family": METHODS[row["method"]].family} if known else {}
        row = {**family, **row, "profile": task.experiment.profile_of(task.cell)}
        table.require(row)
        return row

    def measure(self, task: Task) -> None:
        """Measure a cell without a clock and keep its rows, those before a failure too."""
        rows: list[tuple[Table, Row]] = []
        finished = False
        try:
            for table, row in task.experiment.rows(task.cell, self.profile):
                rows.append((table, self.complete(task, table, row)))
            finished = True
        finally:
            if rows or finished:
                with disk():
                    self.cells.save(rows, task.key, finished)

    def prepare(self, task: Task, timetable: Timetable | None) -> Entry | None:
        """Prepare a cell to be timed with the others of its question.

        None where it has no call, came to a bad end or the run is one without a clock: its row is recorded at once.
        """
        timing: Timing = task.experiment.rows(task.cell, self.profile)
        before = self.untimed(task)
        if timing.cores and timetable is not None:
            call: Any = timetable.remote(timing.cores, timing.cores, timing.prepare, *timing.arguments)
            more, again = call.prepared.result()[1], None
        else:
            ends_well = before.get("status", "ok") == "ok"
            more, call = timing.prepare(*timing.arguments) if ends_well else ({}, None)
        row = self.complete(task, timing.table, before | more)

        def keep(columns: Row) -> None:
            times = columns | (timing.derived(row | columns) if columns else {})
            with disk():
                self.cells.save([(timing.table, self.complete(task, timing.table, row | times))], task.key)

        if timetable is not None:
            timetable.ahead.discard(task.key)
        if call is None or timetable is None:
            keep({})
            return None
        if not isinstance(call, Remote):
            call.warm_up()
            sampled = task.key in timetable.sample
            again = timetable.second(timing.prepare, *timing.arguments) if sampled else None
        timetable.entries.append(Entry(call, getattr(call, "part", None), again, keep))
        return timetable.entries[-1]

    def untimed(self, task: Task) -> Row:
        """Return the row that a timed cell adds its times to, as measured in this run or now; empty for none."""
        errors = task.experiment.errors
        if errors is None:
            return {}
        twin = Task(errors, task.cell, task.name)
        rows: Any = self.cells.rows(twin.key) or errors.rows(task.cell, self.profile)
        return dict(next(iter(rows))[1])

    def timetable(self, tasks: Iterable[Task]) -> Timetable:
        return Timetable({task.key: task.engine for task in tasks}, self.profile.visits)


# -- processes ---------------------------------------------------------------------------------------
#: one thread for every engine; read when the libraries are first imported
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@cache
def known(run: Run) -> dict[journal.Cell, Task]:
    return {task.key: task for task in run.tasks()}


def attempt(function: Callable[..., Any], task: Task, *arguments: Any) -> str:
    """Return what went wrong, empty for nothing; a full disk raises."""
    try:
        function(task, *arguments)
    except DiskFull:
        raise
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{os.path.basename(last.filename)}, line {last.lineno}"
        return f"{task}: {type(error).__name__} in {where}: {one_line(error)}"
    return ""


def measure(run: Run, cell: journal.Cell) -> str:
    """Measure a cell, in a process on one of all cores; return what went wrong."""
    task = known(run)[cell]
    return attempt(run.prepare, task, None) if task.experiment.timed else attempt(run.measure, task)


def time(run: Run, cells: list[journal.Cell]) -> list[str]:
    """Time cells of a question, in a process alone on its core; return what went wrong."""
    tasks = [known(run)[cell] for cell in cells]
    with run.timetable(tasks) as timetable:
        wrong = [attempt(run.prepare, task, timetable) for task in tqdm(tasks, "preparing", disable=None)]
        timetable.go()
    return list(filter(None, wrong))


def work(run: Run, keyword: str = "", resume: bool = False) -> int:
    """Do a run in processes of its own; return how many cells failed, each with a line on stderr."""
    os.environ.update(THREADS | os.environ)
    keep_programs()
    run.begin()
    tasks = run.remaining([task for task in run.tasks() if task.matches(keyword)], resume)
    timed: list[Task] = []
    others: list[Task] = []
    for task in tasks:
        (timed if task.experiment.timed and run.timed else others).append(task)
    # what shares its compiled programs, one method on one scene, stays together
    others.sort(key=lambda task: str(task.cell))
    queue = deque(list(group) for _, group in groupby(others, lambda task: task.cell[:2]))
    cores: list[list[int]] = [[]] * (os.cpu_count() or 1)
    if hasattr(os, "sched_getaffinity"):
        cores = [[core] for core in sorted(os.sched_getaffinity(0))]
    workers, failed = [Worker(each) for each in cores], 0
    with tqdm(total=len(tasks), unit="cell", disable=None) as bar:

        def tell(tasks: Sequence[Task], wrong: list[str]) -> None:
            nonlocal failed
            failed += len(wrong)
            for why in wrong:
                bar.write(f"failed: {why}", file=sys.stderr)
            bar.update(len(tasks))

        def call(worker: Worker, tasks: Sequence[Task], function: Callable[..., Any], given: Any) -> None:
            try:
                wrong = worker.call(None, function, run, given)
            except Died as error:
                wrong = [f"{task}: {error}" for task in tasks]
            tell(tasks, wrong if isinstance(wrong, list) else [wrong] * bool(wrong))

        def follow(worker: Worker) -> None:
            with worker, suppress(IndexError):
                while True:
                    for task in queue.popleft():
                        call(worker, [task], measure, task.key)

        try:
            with ThreadPoolExecutor(len(workers)) as threads:
                try:
                    list(threads.map(follow, workers))
                except BaseException:  # a full disk, Ctrl-C: no thread begins another cell
                    queue.clear()
                    for worker in workers:
                        worker.close()
                    raise
            with Worker(cores[-1]) as worker:
                for _, group in groupby(timed, lambda task: task.experiment.question):
                    call(worker, part := list(group), time, [task.key for task in part])
        finally:
            run.end()
    return failed
