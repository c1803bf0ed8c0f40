"""The self-check of the gate's accuracy part: what is planted in numbers, and identical code."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Lock
from time import perf_counter
from typing import Any

from contactbench.gate.accuracy import accuracy
from contactbench.gate.fresh import environment as variables
from contactbench.gate.rules import moved
from contactbench.gate.verdict import Line
from contactbench.results.schema import TABLES, Rule
from contactbench.results.store import read
from contactbench.splitting.tables import COMPOSITIONS
from planted_faults import PLANTED, faulty, plugin
from selfcheck_faults import (
    AS_IT_WAS,
    ELSEWHERE,
    FAULTS,
    LITTLE,
    LOADED,
    OTHER,
    OTHER_CELLS,
    ROOT,
    UNSEEN,
    Fault,
    Judgement,
    Moved,
    Task,
    load,
    said,
)

#: of every kind of method and engine one or two, with all their tables
IDENTICAL = "particle and not long and (strang or rkn6 or rk4 or scipy or cvode or diffrax-dopri8 or heyoka)"
#: the compiled engines of fixed-step methods, the first of them timed everywhere
COMPILED = ("numba", "jax")
#: processes that share the coefficients
SHARES = 6


# -- runs ------------------------------------------------------------------------------------------
def benchmark(results: Path, keyword: str, call: str = "", workers: tuple[str, ...] = ()) -> Path:
    """A part of the smoke profile, with the fault that a call plants."""
    command = [
        sys.executable, "-m", "pytest", "bench", "--profile", "smoke", "--results", str(results), "-q",
        "--untimed", "-p", "no:cacheprovider", *workers, "-k", keyword,
        *(["--plugin", str(plugin(results.with_suffix(".py"), call))] if call else []),
    ]  # fmt: skip
    done = subprocess.run(command, cwd=ROOT, env=variables(ROOT), capture_output=True, text=True)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    return results


def cells(scratch: Path, name: str, *wanted: tuple[str, list[Any]]) -> list[Path]:
    """The folders of cells that a process of their own has run, for each fault its cells (selfcheck_cells.py)."""
    folders = [scratch / f"{name}-{k}" for k in range(len(wanted))]
    job = [[str(folder), *each] for folder, each in zip(folders, wanted, strict=True)]
    path = scratch / f"{name}.json"
    path.write_text(json.dumps(job), encoding="utf-8")
    command = [sys.executable, str(ROOT / "bench" / "selfcheck_cells.py"), str(path)]
    done = subprocess.run(command, cwd=ROOT, env=variables(ROOT), capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return folders


class Truth:
    """What the code as it is makes, run when it is first asked for."""

    def __init__(self, scratch: Path) -> None:
        self.scratch, self.lock = scratch, Lock()
        self.made: dict[str, Path] = {}

    def of(self, keyword: str, workers: tuple[str, ...] = ()) -> Path:
        """A part of the smoke profile."""
        with self.lock:
            if keyword not in self.made:
                self.made[keyword] = benchmark(self.scratch / f"truth-{len(self.made)}", keyword, "", workers)
            return self.made[keyword]


def red(before: Path, after: Path) -> list[Line]:
    return [line for line in accuracy(before, after).lines if line.red]


# -- faults ----------------------------------------------------------------------------------------
def one_fault(fault: Fault, scratch: Path) -> list[Judgement]:
    """A fault in one method, in the convergence and the laws of two."""
    start = perf_counter()
    methods = sorted({fault.method, PLANTED, "contact-bm4"})
    mine = [(experiment, ("particle", name)) for experiment in ("convergence", "laws") for name in methods]
    before, after = cells(scratch, fault.planted.partition("(")[0], ("", mine), (fault.planted, mine))
    named = [
        line for line in red(before, after)
        if line.scene in ("particle", "") and line.method == fault.method
        and line.measure.split()[0] in fault.measures
    ]  # fmt: skip
    words = said(named[0]) if named else ""
    taken = perf_counter() - start
    return [Judgement("accuracy", fault.what, AS_IT_WAS, "all", bool(named), words, taken)]


def coefficients(share: int, scratch: Path) -> list[Judgement]:
    """A share of all coefficients of all compositions, each by itself in the convergence of its method."""
    every = [(c.name, k) for c in COMPOSITIONS for k in range(len(faulty(c)))][share::SHARES]
    methods = sorted({method for method, _ in every})
    start = perf_counter()

    def mine(method: str) -> list[Any]:
        return [("convergence", ("particle", method))]

    folders = cells(
        scratch, f"coefficients-{share}",
        *(("", mine(method)) for method in methods),
        *((f"wrong_coefficients({{{method!r}: {k}}})", mine(method)) for method, k in every),
    )  # fmt: skip
    before = dict(zip(methods, folders, strict=False))
    judged = []
    for (method, _), folder in zip(every, folders[len(methods) :], strict=True):
        words = [said(line) for line in red(before[method], folder) if line.method == method]
        what = f"each coefficient of {method} in turn, × 1.001"
        judged.append((what, bool(words), words[0] if words else ""))
    each = (perf_counter() - start) / len(every)
    return [
        Judgement("accuracy", what, AS_IT_WAS, "all", found, words, each) for what, found, words in judged
    ]


def found_as(line: Line, fault: Moved) -> bool:
    """Whether a line is the one that must give a fault away."""
    named = (line.scene, line.method, *line.setting.split())
    return (line.table, line.measure) == (fault.table, fault.measure) and fault.subject in named


def others(
    wanted: str, faults: tuple[Moved, ...], factor: float, truth: Truth, scratch: Path
) -> list[Judgement]:
    """What the gate was blind to once, planted all at once; and what it is blind to by its limits."""
    before = truth.of(OTHER_CELLS)
    start = perf_counter()
    fresh = benchmark(scratch / f"other-{wanted[:3]}", OTHER_CELLS, f"other_numbers({factor})")
    lines = red(before, fresh)
    taken = perf_counter() - start
    if wanted == "not seen":
        with on_another_processor(fresh):
            lines += [replace(line, verdict="elsewhere") for line in red(before, fresh)]
        faults = (*faults, ELSEWHERE)
    judged = []
    for fault in faults:
        mine = [line for line in lines if found_as(line, fault)]
        if fault is ELSEWHERE:
            mine = [line for line in mine if line.verdict == "elsewhere"]
        words = said(mine[0]) if mine else ""
        judged.append(Judgement("accuracy", fault.what, AS_IT_WAS, wanted, bool(mine), words, taken))
    return judged


@contextmanager
def on_another_processor(fresh: Path) -> Iterator[None]:
    """The record of a run names another processor, for as long as the block lasts."""
    path = fresh / "environment.json"
    recorded = path.read_text(encoding="utf-8")
    other = json.loads(recorded)
    for run in other["runs"]:
        run["isa"] = "another"
    path.write_text(json.dumps(other), encoding="utf-8")
    try:
        yield
    finally:
        path.write_text(recorded, encoding="utf-8")


# -- identical code --------------------------------------------------------------------------------
def other_rounding(results: Path) -> list[Judgement]:
    """The compiled engines of a method and Python: the same map with other rounding errors, as on another
    processor."""
    work = read(TABLES["work_precision"], results)
    work = work[(work["control"] == "step") & (work["status"] == "ok")]
    compiled, plain = work[work["engine"].isin(COMPILED)], work[work["engine"] == "python"]
    pairs = compiled.merge(plain, on=["scene", "method", "setting"], suffixes=("", " after"))
    start = perf_counter()
    distance = moved(Rule.error, pairs["solution_error"], pairs["solution_error after"], pairs)
    taken = perf_counter() - start
    what = f"nothing but rounding: {' and '.join(COMPILED)} against python, row by row"
    return [
        Judgement(
            "accuracy", what, AS_IT_WAS, "none", bool(d > 1),
            f"{p.scene} {p.method} {p.engine} {p.setting}", taken,
        )
        for d, p in zip(distance, pairs.itertuples(), strict=True)
    ]  # fmt: skip


def identical(condition: str, k: int, truth: Truth, scratch: Path) -> list[Judgement]:
    """A run of the same code by the benchmark itself, with its worker processes."""
    workers = ("-n", "auto")
    before = truth.of(IDENTICAL, workers)
    start = perf_counter()
    with load() if condition == LOADED else nullcontext():
        fresh = benchmark(scratch / f"same-{condition[:2]}-{k}", IDENTICAL, "", workers)
    lines = red(before, fresh)
    words, taken = said(lines[0]) if lines else "", perf_counter() - start
    return [Judgement("accuracy", "nothing", condition, "none", bool(lines), words, taken)]


def tasks(runs: int, results: Path, scratch: Path) -> list[Task]:
    truth = Truth(scratch)
    return [
        Task("other rounding", 1, partial(other_rounding, results)),
        Task("other numbers", 40, partial(others, "all", OTHER, 1.03, truth, scratch)),
        *(Task(f"coefficients, part {k + 1}", 15, partial(coefficients, k, scratch)) for k in range(SHARES)),
        *(Task(fault.what, 6, partial(one_fault, fault, scratch)) for fault in FAULTS),
        Task("other numbers, a little", 40, partial(others, "not seen", UNSEEN, LITTLE, truth, scratch)),
        *(
            Task(f"identical code, {c}, {k + 1}", 40, partial(identical, c, k, truth, scratch), shared=False)
            for k in range(runs)
            for c in (AS_IT_WAS, LOADED)
        ),
    ]
