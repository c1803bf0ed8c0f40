"""How far can the regression gate be trusted?  False alarms on identical code, and planted faults found.

    python bench/gate_selfcheck.py [--runs 6] [--results results] [--only accuracy|speed]

A fault (selfcheck_faults.py) is planted by a plug-in that replaces what is registered (planted_faults.py);
where it is one of an experiment, by a patch in a git worktree of HEAD.  The gate then compares with the code as
it is, in the way it compares a pull request with its base.  Alternate runs of identical code have a busy loop
beside them, as many as there are cores but one.  Accuracy is judged on a part of the smoke profile (`IDENTICAL`,
`KINETIC`): a fault that shows there shows in all of it.  Speed is judged call by call, which is what a false
alarm is one of: with n calls and no alarm the rate is below 3/n, with 95 % confidence.  The table is written
after every row.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import pandas as pd

from contactbench.gate import judge, revisions
from contactbench.gate.accuracy import accuracy
from contactbench.gate.fresh import environment as variables
from contactbench.gate.rules import moved
from contactbench.gate.verdict import Line, Verdict
from contactbench.gate.workload import Cell, workload
from contactbench.plugins import VARIABLE
from contactbench.results.provenance import environment, new_run_id, save_run
from contactbench.results.schema import TABLES, Rule
from contactbench.results.store import merge, read
from contactbench.results.tables import GATE_SELFCHECK
from contactbench.splitting.tables import COMPOSITIONS
from planted_faults import faulty, plugin
from selfcheck_faults import (
    ELSEWHERE,
    FAULTS,
    LITTLE,
    OTHER,
    OTHER_CELLS,
    ROOT,
    SPENT,
    UNSEEN,
    Fault,
    Moved,
    Patch,
    Spent,
    planted,
)

#: of every kind of method and engine one or two, with all their tables
IDENTICAL = "particle and not long and (strang or rkn6 or rk4 or scipy or cvode or diffrax-dopri8 or heyoka)"
#: the contact methods, where a wrong coefficient shows: in errors, slopes, and laws
KINETIC = "particle and not long and not limit and contact and (convergence or laws)"
#: two methods with rows in all tables, for what is planted in one of them
ONE = "particle and not long and not limit and (strang or bm4)"
#: the compiled engines of fixed-step methods, the first of them timed everywhere
COMPILED = ("numba", "jax")
#: methods that are slowed: compiled and plain Python loops
SLOWED = ("contact-strang", "contact-rkn6", "rk4")
SLOWDOWNS = (1.3, 1.5, 2.0)
#: runs of identical code that accuracy takes at most: nothing in it is random
SAME_NUMBERS = 4


# -- runs ------------------------------------------------------------------------------------------
@contextmanager
def load() -> Iterator[None]:
    """Busy loops on all cores but one."""
    busy = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"])
        for _ in range(max(1, (os.cpu_count() or 2) - 1))
    ]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def benchmark(tree: Path, results: Path, keyword: str, call: str = "") -> Path:
    """A part of the smoke profile, run with the sources of a tree and the fault that a call plants."""
    command = [
        sys.executable, "-m", "pytest", "bench", "--profile", "smoke", "--results", str(results), "-q",
        "--benchmark-disable", "-p", "no:cacheprovider", "-n", "auto", "--dist", "loadgroup", "-k", keyword,
        *(["--plugin", str(plugin(results.with_suffix(".py"), call))] if call else []),
    ]  # fmt: skip
    done = subprocess.run(command, cwd=tree, env=variables(tree), capture_output=True, text=True)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    return results


@contextmanager
def variable(**values: str) -> Iterator[None]:
    """Environment variables, for as long as the block lasts."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def speed_gate(tree: Path, cells: Sequence[Cell], plugged: Path | None = None) -> Verdict:
    """The speed part of the gate on a tree against HEAD; both sides' processes load a plug-in."""
    with variable(**{VARIABLE: "" if plugged is None else str(plugged)}):
        return judge.slower(tree, cells, "HEAD")


Row = dict[str, Any]
#: one judgement: whether it was red, and in what words
Judgement = tuple[bool, str]
CONDITIONS = ("idle", "loaded")


def outcome(
    part: str, planted: str, condition: str, wanted: str, judged: list[Judgement], seconds: float
) -> Row:
    """A row: how many of the judgements were red, and what the first of these said."""
    return {
        "part": part, "planted": planted, "condition": condition, "wanted": wanted, "runs": len(judged),
        "red": sum(red for red, _ in judged), "seconds": seconds,
        "example": next((words for red, words in judged if red), ""),
    }  # fmt: skip


def said(line: Line) -> str:
    """A line of the gate in words."""
    words = asdict(line)
    return " ".join(
        words[name] for name in ("scene", "method", "measure", "before", "after", "change")
    ).strip()


def repeated(
    part: str, what: str, condition: str, wanted: str, judge: Callable[[], list[Judgement]], runs: int
) -> Row:
    """So many runs of a check under a condition; each may be several judgements."""
    judged: list[Judgement] = []
    taken = []
    for k in range(runs):
        with load() if condition == "loaded" else nullcontext():
            start = perf_counter()
            judged += judge()
            taken.append(perf_counter() - start)
        print(
            f"{part}, {what}, {condition}, run {k + 1}: {sum(r for r, _ in judged)} red of {len(judged)}",
            flush=True,
        )
    return outcome(part, what, condition, wanted, judged, median(taken))


def halves(runs: int) -> tuple[tuple[str, int], ...]:
    """Runs shared between the conditions, those that get one."""
    shares = zip(CONDITIONS, (runs - runs // 2, runs // 2), strict=True)
    return tuple((condition, share) for condition, share in shares if share)


def other_rounding(results: Path) -> Row:
    """The compiled engines of a method and Python: the same map with other rounding errors, as on another
    processor."""
    work = read(TABLES["work_precision"], results)
    work = work[(work["control"] == "step") & (work["status"] == "ok")]
    compiled, plain = work[work["engine"].isin(COMPILED)], work[work["engine"] == "python"]
    pairs = compiled.merge(plain, on=["scene", "method", "setting"], suffixes=("", " after"))
    start = perf_counter()
    distance = moved(Rule.error, pairs["solution_error"], pairs["solution_error after"], pairs)
    judged = [
        (bool(d > 1), f"{p.scene} {p.method} {p.engine} {p.setting}")
        for d, p in zip(distance, pairs.itertuples(), strict=True)
    ]
    what = f"nothing but rounding: {' and '.join(COMPILED)} against python, row by row"
    return outcome("accuracy", what, CONDITIONS[0], "none", judged, perf_counter() - start)


def found_as(line: Line, fault: Moved) -> bool:
    """Whether a line is the one that must give a fault away."""
    named = (line.scene, line.method, *line.setting.split())
    return (line.table, line.measure) == (fault.table, fault.measure) and fault.subject in named


def other_rows(scratch: Path) -> Iterator[Row]:
    """What the gate was blind to once, planted all at once; and what it is blind to by its limits."""
    truth = benchmark(ROOT, scratch / "truth-other", OTHER_CELLS)
    for wanted, faults, factor in (("all", OTHER, 1.03), ("not seen", UNSEEN, LITTLE)):
        start = perf_counter()
        fresh = benchmark(ROOT, scratch / f"fresh-{wanted[:3]}", OTHER_CELLS, f"other_numbers({factor})")
        red = [line for line in accuracy(truth, fresh).lines if line.red]
        taken = perf_counter() - start
        if wanted == "not seen":
            red += on_another_processor(truth, fresh)
            faults = (*faults, ELSEWHERE)
        for fault in faults:
            mine = [line for line in red if found_as(line, fault)]
            if fault is ELSEWHERE:
                mine = [line for line in mine if line.verdict == "elsewhere"]
            judged = [(bool(mine), said(mine[0]) if mine else "")]
            print(f"accuracy, {fault.what}: {'red' if mine else 'green'}, wanted {wanted}", flush=True)
            yield outcome("accuracy", fault.what, CONDITIONS[0], wanted, judged, taken)


def on_another_processor(truth: Path, fresh: Path) -> list[Line]:
    """The red lines where the record of the fresh run names another processor; their verdict says so."""
    path = fresh / "environment.json"
    recorded = path.read_text(encoding="utf-8")
    other = json.loads(recorded)
    for run in other["runs"]:
        run["isa"] = "another"
    path.write_text(json.dumps(other), encoding="utf-8")
    lines = [replace(line, verdict="elsewhere") for line in accuracy(truth, fresh).lines if line.red]
    path.write_text(recorded, encoding="utf-8")
    return lines


def accuracy_rows(runs: int, results: Path, scratch: Path) -> Iterator[Row]:
    """Identical code, every coefficient, and what else can go wrong with numbers."""
    yield other_rounding(results)
    yield from other_rows(scratch)
    truths = {
        keyword: benchmark(ROOT, scratch / f"truth-{k}", keyword)
        for k, keyword in enumerate((IDENTICAL, KINETIC, ONE))
    }
    folders = (scratch / f"fresh-{k}" for k in range(10**6))

    def lines(tree: Path, keyword: str, call: str = "") -> list[Line]:
        fresh = benchmark(tree, next(folders), keyword, call)
        return [line for line in accuracy(truths[keyword], fresh).lines if line.red]

    def identical() -> list[Judgement]:
        red = lines(ROOT, IDENTICAL)
        return [(bool(red), said(red[0]) if red else "")]

    for fault in FAULTS:

        def given_away(fault: Fault = fault) -> list[Judgement]:
            if isinstance(fault.planted, Patch):
                with planted(fault.planted) as tree:
                    red = lines(tree, ONE)
            else:
                red = lines(ROOT, ONE, fault.planted)
            named = [
                line for line in red
                if line.scene in ("particle", "") and line.method == fault.method
                and line.measure.split()[0] in fault.measures
            ]  # fmt: skip
            return [(bool(named), said(named[0]) if named else "")]

        yield repeated("accuracy", fault.what, CONDITIONS[0], "all", given_away, 1)

    for condition, share in halves(min(runs, SAME_NUMBERS)):
        yield repeated("accuracy", "nothing", condition, "none", identical, share)
    yield from coefficient_rows(partial(lines, ROOT, KINETIC))


def coefficient_rows(lines: Callable[[str], list[Line]]) -> Iterator[Row]:
    """Every coefficient of every composition, the k-th of every method at once: methods are independent."""
    number = {composition.name: len(faulty(composition)) for composition in COMPOSITIONS}
    found: dict[str, list[Judgement]] = {method: [] for method in number}
    taken: list[float] = []
    for k in range(max(number.values())):
        together = {method: k for method, n in number.items() if k < n}
        start = perf_counter()
        red = lines(f"wrong_coefficients({together})")
        taken.append(perf_counter() - start)
        for method in together:
            mine = [said(line) for line in red if line.method == method]
            found[method].append((bool(mine), mine[0] if mine else ""))
        print(f"accuracy, coefficient {k + 1}: {[(m, found[m][-1][0]) for m in together]}", flush=True)
        for method in together:
            if k + 1 == number[method]:  # the last of it: nothing of it is lost if the rest is cut off
                what = f"each coefficient of {method} in turn, × 1.001"
                yield outcome("accuracy", what, CONDITIONS[0], "all", found[method], median(taken))


def spent_rows(work: pd.DataFrame, scratch: Path) -> Iterator[Row]:
    """Time and memory planted in one tree, those in one method at a time together."""
    cells = [cell for cell in workload(work) if any(of(fault, cell) for fault in SPENT)]
    for k, batch in enumerate(batches(SPENT)):
        with planted() as tree:
            calls = "; planted_faults.".join(fault.planted.format(tree=tree) for fault in batch)
            start = perf_counter()
            found = speed_gate(tree, cells, plugin(scratch / f"spent-{k}.py", calls))
            taken = perf_counter() - start
        for fault in batch:
            mine = [
                line for line in found.lines
                if line.red and line.measure == fault.measure
                and (line.method, line.scene) == (fault.method, fault.scene)
                and ("saved times" in line.setting) == (fault.saves > 1)
            ]  # fmt: skip
            judged = [(bool(mine), said(mine[0]) if mine else "")]
            print(f"speed, {fault.what}: {'red' if mine else 'green'}", flush=True)
            wanted = "all" if fault.seen else "not seen"
            yield outcome("speed", fault.what, CONDITIONS[0], wanted, judged, taken)


def of(fault: Spent, cell: Cell) -> bool:
    """Whether a cell is the one that must give a fault away."""
    return (cell.method, cell.scene, cell.saves, cell.engine) == (
        fault.method, fault.scene, fault.saves, COMPILED[0],
    )  # fmt: skip


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


def speed_rows(runs: int, results: Path, scratch: Path) -> Iterator[Row]:
    """Identical code on the whole workload; slowed loops judged cell by cell."""
    work = read(TABLES["work_precision"], results)
    yield from spent_rows(work, scratch)
    loops = work["method"].isin(SLOWED) & (
        ((work["scene"] == "particle_long") & (work["engine"] == COMPILED[0]))
        | ((work["scene"] == "particle") & (work["engine"] == "python"))
    )
    cells = [cell for cell in workload(work[loops]) if cell.saves == 1]

    def slowed(tree: Path, plugged: Path) -> list[Judgement]:
        found = speed_gate(tree, cells, plugged)
        red = {(x.scene, x.method, x.engine): said(x) for x in found.lines if x.red and x.measure == "time"}
        names = [(cell.scene, cell.method, cell.engine) for cell in cells]
        return [(name in red, red.get(name, "")) for name in names]

    for factor in SLOWDOWNS:
        wanted = "19 in 20" if factor >= 1.5 else "the more the better"
        with planted() as tree:
            plugged = plugin(scratch / f"slower-{factor}.py", f"slower({SLOWED}, {factor}, {str(tree)!r})")
            for condition, share in halves(max(2, runs // 2)):  # several judgements a run
                what = f"loops {factor} times as slow, {len(cells)} judged in each run"
                yield repeated("speed", what, condition, wanted, partial(slowed, tree, plugged), share)

    everything = workload(work)

    def identical(tree: Path) -> list[Judgement]:
        found = speed_gate(tree, everything)
        red = [(True, said(line)) for line in found.lines if line.red]
        return [*red, *[(False, "")] * (len(everything) - len(red))]

    with planted() as tree:
        what = f"nothing, {len(everything)} calls judged in each run"
        for condition, share in halves(runs):
            yield repeated("speed", what, condition, "none", partial(identical, tree), share)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--runs", type=int, default=6, help="runs of identical code; half as many of each slowdown"
    )
    parser.add_argument("--results", type=Path, default=ROOT / "results", help="where the tables are and go")
    parser.add_argument("--only", choices=judge.PARTS, help="one part of the gate; both by default")
    arguments = parser.parse_args()
    if revisions.dirty(ROOT):
        sys.exit(
            "gate_selfcheck: the sources have local changes; faults are planted in HEAD, so commit first"
        )
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended"))  # worktrees are removed on the way out
    save_run(
        new_run_id(), environment("gate_selfcheck", 0), [GATE_SELFCHECK.name], [GATE_SELFCHECK.name],
        arguments.results,
    )  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="contactbench-selfcheck-") as folder:
        scratch, rows = Path(folder), []
        if arguments.only != "speed":
            rows.append(accuracy_rows(arguments.runs, arguments.results, scratch))
        if arguments.only != "accuracy":
            rows.append(speed_rows(arguments.runs, arguments.results, scratch))
        for row in (row for part in rows for row in part):
            merge(GATE_SELFCHECK, [row], arguments.results)


if __name__ == "__main__":
    main()
