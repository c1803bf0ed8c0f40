"""The self-check of the gate's speed part: time and memory planted in one of two trees, and identical code."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from time import perf_counter

from contactbench.gate import judge, revisions
from contactbench.gate.verdict import Line, Verdict
from contactbench.gate.workload import Cell, workload
from contactbench.plugins import VARIABLE
from contactbench.results.schema import TABLES
from contactbench.results.store import read
from planted_faults import plugin
from selfcheck_faults import AS_IT_WAS, LOADED, ROOT, SPENT, Judgement, Spent, Task, load, said

#: methods that are slowed: compiled and plain Python loops
SLOWED = ("contact-strang", "contact-rkn6", "rk4")
#: factors, each planted in one of `SLOWED` at a time, and how many must be found
SLOWDOWNS = {1.3: "the more the better", 1.5: "19 in 20", 2.0: "19 in 20"}
COMPILED = "numba"
#: seconds in which as many calls of identical code are judged as there is time for
BUDGET = 120.0


@contextmanager
def variable(name: str, value: str) -> Iterator[None]:
    """An environment variable, for as long as the block lasts."""
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


def speed_gate(
    cells: Sequence[Cell], scratch: Path, name: str, calls: Sequence[str] = (), budget: float | None = None
) -> Verdict:
    """A worktree of HEAD against another one; ``{tree}`` in what a plug-in calls is the folder of the first."""
    with revisions.checkout(ROOT, revisions.commit_of(ROOT, "HEAD")) as tree:
        call = "; planted_faults.".join(calls).replace("{tree}", str(tree))
        with variable(VARIABLE, str(plugin(scratch / f"{name}.py", call)) if call else ""):
            return judge.slower(tree, cells, "HEAD", budget)


# -- time and memory -------------------------------------------------------------------------------
def of(fault: Spent, cell: Cell) -> bool:
    """Whether a cell is the one that must give a fault away."""
    return (cell.method, cell.scene, cell.saves, cell.engine) == (
        fault.method, fault.scene, fault.saves, COMPILED,
    )  # fmt: skip


def gives_away(line: Line, fault: Spent) -> bool:
    """Whether a line is the one that must."""
    where = (line.measure, line.method, line.scene) == (fault.measure, fault.method, fault.scene)
    return line.red and where and ("saved times" in line.setting) == (fault.saves > 1)


def batches(faults: Sequence[Spent]) -> list[list[Spent]]:
    """Faults that do not meet: each batch has a method once."""
    found: list[list[Spent]] = []
    for fault in faults:
        free = next((batch for batch in found if fault.method not in {one.method for one in batch}), None)
        if free is None:
            found.append([fault])
        else:
            free.append(fault)
    return found


def spent(batch: Sequence[Spent], cells: Sequence[Cell], scratch: Path, name: str) -> list[Judgement]:
    """Time and memory planted in several methods, in the cells that must show it."""
    start = perf_counter()
    mine = [cell for cell in cells if any(of(fault, cell) for fault in batch)]
    found = speed_gate(mine, scratch, name, [fault.planted for fault in batch])
    taken = perf_counter() - start
    judged = []
    for fault in batch:
        lines = [line for line in found.lines if gives_away(line, fault)]
        wanted = "all" if fault.seen else "not seen"
        words = said(lines[0]) if lines else ""
        judged.append(Judgement("speed", fault.what, AS_IT_WAS, wanted, bool(lines), words, taken))
    return judged


def slowed(condition: str, k: int, cells: Sequence[Cell], scratch: Path) -> list[Judgement]:
    """Every method slowed by another factor, which go round from run to run."""
    factors = dict(zip(SLOWED, [*SLOWDOWNS][k % 3 :] + [*SLOWDOWNS][: k % 3], strict=True))
    calls = [f"slower([{method!r}], {factor}, '{{tree}}')" for method, factor in factors.items()]
    mine = [
        cell for cell in cells
        if cell.method in SLOWED and cell.saves == 1
        and (cell.scene, cell.engine) in (("particle_long", COMPILED), ("particle", "python"))
    ]  # fmt: skip
    start = perf_counter()
    with load() if condition == LOADED else nullcontext():
        found = speed_gate(mine, scratch, f"slower-{condition[:2]}-{k}", calls)
    taken = perf_counter() - start
    red = {(x.scene, x.method, x.engine): said(x) for x in found.lines if x.red and x.measure == "time"}
    judged = []
    for cell in mine:
        factor, where = factors[cell.method], (cell.scene, cell.method, cell.engine)
        what = f"a loop {factor} times as slow"
        words = red.get(where, "")
        judged.append(Judgement("speed", what, condition, SLOWDOWNS[factor], where in red, words, taken))
    return judged


# -- identical code --------------------------------------------------------------------------------
def identical(condition: str, k: int, cells: Sequence[Cell], scratch: Path) -> list[Judgement]:
    """As many calls as there is time for, every method and engine first."""
    start = perf_counter()
    with load() if condition == LOADED else nullcontext():
        found = speed_gate(cells, scratch, f"same-{condition[:2]}-{k}", budget=BUDGET)
    red, taken = [said(line) for line in found.lines if line.red], perf_counter() - start
    words = [*red, *[""] * (found.judged - len(red))]
    return [Judgement("speed", "nothing, call by call", condition, "none", bool(w), w, taken) for w in words]


def tasks(runs: int, results: Path, scratch: Path) -> list[Task]:
    cells = workload(read(TABLES["work_precision"], results))
    both = [(k, condition) for k in range(runs) for condition in (AS_IT_WAS, LOADED)]
    return [
        *(
            Task(
                f"time and memory, {k + 1}",
                60,
                partial(spent, batch, cells, scratch, f"spent-{k}"),
                shared=False,
            )
            for k, batch in enumerate(batches(SPENT))
        ),
        *(
            Task(f"slower, {c}, {k + 1}", 45, partial(slowed, c, k, cells, scratch), shared=False)
            for k, c in both
        ),
        *(
            Task(
                f"identical calls, {c}, {k + 1}",
                BUDGET,
                partial(identical, c, k, cells, scratch),
                shared=False,
            )
            for k, c in both
        ),
    ]
