"""Run experiments: untimed cells on all cores, then timed ones alone on one core."""

from __future__ import annotations

import os
import re
import sys
import traceback
from collections import deque
from collections.abc import Iterable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import groupby
from pathlib import Path

from tqdm import tqdm

from contactbench.errors import BadInput, one_line
from contactbench.measure.isolation import Died, Worker, settle
from contactbench.plugins import OWN, brought
from contactbench.runs.experiment import Cell, Experiment, Profile, Row, experiments
from contactbench.runs.timetable import Entry, Timetable
from contactbench.tables import cells as journal
from contactbench.tables import provenance
from contactbench.tables.declared import TIMES
from contactbench.tables.schema import TABLES, Table
from contactbench.tables.store import OldTable, check, read

#: the selection of all cells with a method or scene of a plug-in
OWN_ALONE = "--own"


@dataclass(frozen=True)
class Task:
    """Name a cell of an experiment; name : unique within the experiment."""

    experiment: Experiment
    cell: Cell
    name: str

    def __str__(self) -> str:
        return f"{self.experiment.name}[{self.name}]"

    @property
    def key(self) -> journal.Cell:
        return self.experiment.question, str(self)

    def matches(self, expression: str) -> bool:
        """Return whether an expression of parts of names, and, or, not and parentheses holds, as pytest's -k."""
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
    """Manage a run of the benchmark by one process or several.

    selection : expression that selects cells, empty for all; rows of other cells are kept.  timed : whether calls are
    timed.  own : whether only cells with a method or scene of a plug-in run.
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
        """Return the cells of an experiment; none if it only adds times and the run is untimed."""
        cells = [] if experiment.timed and not self.timed else experiment.cells(self.profile)
        if self.own:
            own = brought()
            cells = [cell for cell in cells if not own.isdisjoint(cell)]
        named = {
            "-".join(f"{p:.6g}" if isinstance(p, float) else str(p) for p in cell): cell for cell in cells
        }
        return [Task(experiment, cell, name) for name, cell in named.items()]

    # -- its beginning and its end -----------------------------------------------------------------
    def begin(self) -> None:
        """Merge cells of killed runs; raises `BadInput` for a damaged table."""
        try:
            for table in TABLES.values():  # refused now and not after ten minutes
                with suppress(*([] if self.selection else [OldTable])):  # a whole run replaces those
                    read(table, self.results)
            self.cells.begin(provenance.environment(self.profile.name))
        except (BadInput, OSError) as error:
            raise BadInput(f"--results {self.results}: {error}") from None

    def remaining(self, tasks: Iterable[Task], resume: bool) -> list[Task]:
        """Return the tasks that are not done; unless it resumes, the run begins anew."""
        if not resume:
            self.cells.begin_anew()
        done = self.cells.done() if resume else ()
        return [task for task in tasks if task.key not in done]

    def end(self) -> None:
        whole = self.selection == OWN_ALONE * self.own
        self.cells.merge([task.key for task in self.tasks()] if whole else (), OWN if self.own else ())

    # -- one cell ----------------------------------------------------------------------------------
    def measure(self, task: Task, timetable: Timetable | None = None) -> list[Entry]:
        """Measure a cell and save its rows, also those before a failure; calls to time join a timetable."""
        if timetable is not None:
            return self.prepare(task, timetable)
        rows: list[tuple[Table, Row]] = []
        finished = False
        try:
            for table, row in task.experiment.rows(task.cell, self.profile):
                rows.append((table, self.complete(task, table, row)))
            finished = True
        finally:
            if rows or finished:
                self.cells.save(rows, task.key, finished)
        return []

    def complete(self, task: Task, table: Table, row: Row) -> Row:
        """Add the smallest profile that has the cell, unless the row says its own; raise `BadInput` for a bad row."""
        if "profile" in table.columns:
            row = {"profile": task.experiment.profile_of(task.cell), **row}
        check(table, row)
        why = "message" if "message" in table.columns else "note"
        if row.get("status", "ok") != "ok" and why in table.columns and not row.get(why):
            raise BadInput(f"table {table.name!r}: status {row['status']} without a {why}")
        return row

    def prepare(self, task: Task, timetable: Timetable) -> list[Entry]:
        """Return the timetable entries of a cell, one for each row to time."""
        timetable.ahead.discard(task.key)
        timing = task.experiment.timing
        assert timing is not None
        timings = [each for row in self.untimed(task) if (each := timing(row)) is not None]
        rows: list[tuple[Table, Row]] = []

        def record(row: Row) -> None:
            rows.append((TIMES, self.complete(task, TIMES, row)))
            if len(rows) == len(timings):
                self.cells.save(rows, task.key)

        if not timings:
            self.cells.save([], task.key)
        return [timetable.add(each, record) for each in timings]

    def untimed(self, task: Task) -> list[Row]:
        """Return the rows of the cell to time, measured earlier in this run or now."""
        assert task.experiment.of is not None
        own = Task(task.experiment.of, task.cell, task.name)
        if self.cells.rows(own.key) is None:
            self.measure(own)
        return [dict(row) for _, row in self.cells.rows(own.key) or ()]

    def timetable(self, tasks: Iterable[Task]) -> Timetable:
        return Timetable({task.key for task in tasks}, self.profile.visits)


# -- processes ---------------------------------------------------------------------------------------
@cache
def known(run: Run) -> dict[journal.Cell, Task]:
    return {task.key: task for task in run.tasks()}


def attempt(run: Run, cells: Iterable[journal.Cell], timetable: Timetable | None = None) -> list[str]:
    """Measure cells in a worker process; return the failures.  A full disk raises."""
    wrong = []
    for cell in cells:
        try:
            run.measure(known(run)[cell], timetable)
        except journal.DiskFull:
            raise
        except Exception as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{os.path.basename(last.filename)}, line {last.lineno}"
            wrong.append(f"{' '.join(cell)}: {type(error).__name__} in {where}: {one_line(error)}")
    return wrong


def time(run: Run, cells: list[journal.Cell]) -> list[str]:
    """Time the cells of one question in a worker process; return the failures as `attempt` does."""
    with run.timetable(known(run)[cell] for cell in cells) as timetable:
        wrong = attempt(run, tqdm(cells, "preparing", disable=None), timetable)
        timetable.go()
    return wrong


def work(run: Run, keyword: str = "", resume: bool = False) -> int:
    """Do a run in worker processes; return the number of failed cells, each with a line on stderr."""
    settle()
    chosen = [task for task in run.tasks() if task.matches(keyword)]
    if keyword and not chosen:
        raise BadInput(f"-k {keyword!r}: no cell of this run has such a name")
    run.begin()
    tasks = run.remaining(chosen, resume)
    timed, others = (
        [task for task in tasks if (task.experiment.timed and run.timed) is which] for which in (True, False)
    )
    others.sort(key=lambda task: str(task.cell))
    # cells that share compiled programs, one method on one scene, stay in one process
    queue = deque([task.key for task in part] for _, part in groupby(others, lambda task: task.cell[:2]))
    allowed = getattr(os, "sched_getaffinity", lambda _: ())(0)
    cores = [[core] for core in sorted(allowed)] or [[]] * (os.cpu_count() or 1)
    failed: list[str] = []
    calls: dict[Future[list[str]], tuple[Worker, list[journal.Cell]]] = {}
    with ExitStack() as ends, tqdm(total=len(tasks), unit="cell", disable=None) as bar:
        ends.callback(run.end)

        def tell(worker: Worker, call: Future[list[str]], cells: list[journal.Cell]) -> None:
            try:
                wrong = worker.result(call)
            except Died as error:
                wrong = [f"{' '.join(cell)}: {error}" for cell in cells]
            for why in wrong:
                bar.write(f"failed: {why}", file=sys.stderr)
            failed.extend(wrong)
            bar.update(len(cells))

        with ExitStack() as shared:
            idle = [shared.enter_context(Worker(each)) for each in cores]
            while queue or calls:
                while queue and idle:
                    worker, cells = idle.pop(), queue.popleft()
                    calls[worker.submit(attempt, run, cells)] = worker, cells
                for call in wait(calls, return_when=FIRST_COMPLETED).done:
                    worker, cells = calls.pop(call)
                    tell(worker, call, cells)
                    idle.append(worker)
        with Worker(cores[-1]) as alone:
            for _, part in groupby(timed, lambda task: task.experiment.question):
                tell(alone, alone.submit(time, run, cells := [task.key for task in part]), cells)
    return len(failed)
