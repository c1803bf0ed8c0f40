"""How far can the regression gate be trusted?  False alarms on identical code, and planted faults found.

    python bench/gate_selfcheck.py [--runs 20] [--results results] [--only accuracy|speed]

A fault is planted by a plug-in that replaces a registered method (planted_faults.py); where it is one of
an experiment, by a patch in a git worktree of HEAD.  The gate then compares with the code as it is, in the
way it compares a pull request with its base.  Alternate runs of identical code have a busy loop beside
them, as many as there are cores but one.  Accuracy is judged on a part of the smoke profile (`IDENTICAL`,
`KINETIC`): a fault that shows there shows in all of it.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

from contactbench.gate import accuracy as gate
from contactbench.gate import speed
from contactbench.plugins import VARIABLE
from contactbench.results.provenance import environment, new_run_id, save_run
from contactbench.results.schema import TABLES, Rule
from contactbench.results.store import merge, read
from contactbench.results.tables import GATE_SELFCHECK
from contactbench.splitting.tables import COMPOSITIONS
from planted_faults import PLANTED, faulty, plugin

ROOT = Path(__file__).resolve().parents[1]
#: of every kind of method and engine one or two, with all their tables
IDENTICAL = "particle and not long and (strang or rkn6 or rk4 or scipy or cvode or diffrax-dopri8 or heyoka)"
#: the contact methods, where a wrong coefficient shows: in errors, slopes, and laws
KINETIC = (
    "particle and not long and not limit and contact and (convergence or laws or (work_precision and python))"
)
#: two methods with rows in all tables, for what is planted in one of them
ONE = "particle and not long and not limit and (strang or bm4)"
#: the compiled engines of fixed-step methods, the first of them timed everywhere
COMPILED = ("numba", "jax")
#: methods that are slowed: compiled and plain Python loops
SLOWED = ("contact-strang", "contact-rkn6", "rk4")
SLOWDOWNS = (1.3, 1.5, 2.0)


# -- faults ----------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Patch:
    """A change of one source file; `old` must stand in it exactly once."""

    file: Path
    old: str
    new: str

    def apply(self, tree: Path) -> None:
        text = (tree / self.file).read_text(encoding="utf-8")
        assert text.count(self.old) == 1, f"{self.file} has {self.old!r} {text.count(self.old)} times"
        (tree / self.file).write_text(text.replace(self.old, self.new), encoding="utf-8")


@dataclass(frozen=True)
class Fault:
    """Something planted in one place, and the method and measures that must give it away.

    planted : a call of `planted_faults`, or a patch.
    """

    what: str
    planted: str | Patch
    method: str
    measures: frozenset[str]


FAULTS = tuple(
    Fault(what, planted, method, frozenset(measures.split()))
    for what, planted, method, measures in (
        ("order 2 replaced by order 1", "order_one()", PLANTED, "solution_error pairwise_order"),
        ("an extra gradient evaluation per step", "joints_left_apart()", PLANTED, "evaluations"),
        ("a status change: a scene refused", "refusal()", PLANTED, "status"),
        ("dropped rows: a method is gone", "no_bm4()", "contact-bm4", "row"),
        (
            "a dropped row: a setting is gone",
            Patch(Path("bench/bench_convergence.py"), "POINTS = 9", "POINTS = 8"), PLANTED, "row",
        ),
        (
            "a drift that is no longer round-off: damping stronger by 1e-9", "stronger_damping()", PLANTED,
            "contact_drift",
        ),
    )
)  # fmt: skip


@contextmanager
def planted(*patches: Patch) -> Iterator[Path]:
    """A worktree of HEAD with patches."""
    with speed.checkout(ROOT, speed.resolved(ROOT, "HEAD")) as tree:
        for patch in patches:
            patch.apply(tree)
        yield tree


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
        "--benchmark-disable", "-p", "no:cacheprovider", "-k", keyword,
        *(["--plugin", str(plugin(results.with_suffix(".py"), call))] if call else []),
    ]  # fmt: skip
    done = subprocess.run(command, cwd=tree, env=speed.environment(tree), capture_output=True, text=True)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    return results


def speed_gate(tree: Path, baseline: Path, programs: Path, plugged: Path | None = None) -> dict[str, Any]:
    """``contactbench gate --only speed`` of a tree against HEAD; compiled programs are kept in a folder.

    plugged : a plug-in that the timing processes of both load.
    """
    kept = {
        VARIABLE: "" if plugged is None else str(plugged),
        "JAX_COMPILATION_CACHE_DIR": str(programs),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
    command = [
        sys.executable, "-m", "contactbench.cli", "gate", "--only", "speed", "--base", "HEAD", "--json",
        "--baseline", str(baseline),
    ]  # fmt: skip
    done = subprocess.run(
        command, cwd=tree, env={**speed.environment(ROOT), **kept}, capture_output=True, text=True
    )
    assert done.returncode in (0, 1), done.stderr
    return json.loads(done.stdout)


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


def said(line: Any) -> str:
    """A line of the gate in words."""
    line = line if isinstance(line, dict) else asdict(line)
    return " ".join(
        line[name] for name in ("scene", "method", "measure", "before", "after", "change")
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
    """Runs shared between the conditions."""
    return tuple(zip(CONDITIONS, (runs - runs // 2, runs // 2), strict=True))


def other_rounding(results: Path) -> Row:
    """The compiled engines of a method and Python: the same map with other rounding errors, as on another
    processor."""
    work = read(TABLES["work_precision"], results)
    work = work[(work["control"] == "step") & (work["status"] == "ok")]
    compiled, plain = work[work["engine"].isin(COMPILED)], work[work["engine"] == "python"]
    pairs = compiled.merge(plain, on=["scene", "method", "setting"], suffixes=("", " after"))
    start = perf_counter()
    distance = gate.moved(Rule.error, pairs["solution_error"], pairs["solution_error after"], pairs)
    judged = [
        (bool(d > 1), f"{p.scene} {p.method} {p.engine} {p.setting}")
        for d, p in zip(distance, pairs.itertuples(), strict=True)
    ]
    what = f"nothing but rounding: {' and '.join(COMPILED)} against python, row by row"
    return outcome("accuracy", what, CONDITIONS[0], "none", judged, perf_counter() - start)


def accuracy_rows(runs: int, results: Path, scratch: Path) -> Iterator[Row]:
    """Identical code, every coefficient, and what else can go wrong with numbers."""
    yield other_rounding(results)
    truths = {
        keyword: benchmark(ROOT, scratch / f"truth-{k}", keyword)
        for k, keyword in enumerate((IDENTICAL, KINETIC, ONE))
    }
    folders = (scratch / f"fresh-{k}" for k in range(10**6))

    def lines(tree: Path, keyword: str, call: str = "") -> list[gate.Line]:
        fresh = benchmark(tree, next(folders), keyword, call)
        return [line for line in gate.accuracy(truths[keyword], fresh).lines if line.red]

    def identical() -> list[Judgement]:
        red = lines(ROOT, IDENTICAL)
        return [(bool(red), said(red[0]) if red else "")]

    for condition, share in halves(runs):
        yield repeated("accuracy", "nothing", condition, "none", identical, share)

    number = {composition.name: len(faulty(composition)) for composition in COMPOSITIONS}
    found: dict[str, list[Judgement]] = {method: [] for method in number}
    taken = []
    for k in range(max(number.values())):  # the k-th of every method at once: methods are independent
        together = {method: k for method, n in number.items() if k < n}
        start = perf_counter()
        red = lines(ROOT, KINETIC, f"wrong_coefficients({together})")
        taken.append(perf_counter() - start)
        for method in together:
            mine = [said(line) for line in red if line.method == method]
            found[method].append((bool(mine), mine[0] if mine else ""))
        print(f"accuracy, coefficient {k + 1}: {[(m, found[m][-1][0]) for m in together]}", flush=True)
    for method, judged in found.items():
        what = f"each coefficient of {method} in turn, × 1.001"
        yield outcome("accuracy", what, CONDITIONS[0], "all", judged, median(taken))

    for fault in FAULTS:

        def given_away(fault: Fault = fault) -> list[Judgement]:
            if isinstance(fault.planted, Patch):
                with planted(fault.planted) as tree:
                    red = lines(tree, ONE)
            else:
                red = lines(ROOT, ONE, fault.planted)
            named = [
                line for line in red
                if (line.scene, line.method) == ("particle", fault.method)
                and line.measure.split()[0] in fault.measures
            ]  # fmt: skip
            return [(bool(named), said(named[0]) if named else "")]

        yield repeated("accuracy", fault.what, CONDITIONS[0], "all", given_away, 1)


def speed_rows(runs: int, results: Path, scratch: Path) -> Iterator[Row]:
    """Identical code on the whole workload; slowed loops judged cell by cell."""
    work = read(TABLES["work_precision"], results)
    loops = work["method"].isin(SLOWED) & (
        ((work["scene"] == "particle_long") & (work["engine"] == COMPILED[0]))
        | ((work["scene"] == "particle") & (work["engine"] == "python"))
    )
    merge(TABLES["work_precision"], work[loops].to_dict("records"), scratch / "loops")
    cells = speed.workload(read(TABLES["work_precision"], scratch / "loops"))

    def identical(tree: Path) -> list[Judgement]:
        found = speed_gate(tree, results, scratch / "programs")
        return [(found["red"], "; ".join(said(line) for line in found["lines"] if line["red"]))]

    def slowed(tree: Path, plugged: Path) -> list[Judgement]:
        found = speed_gate(tree, scratch / "loops", scratch / "programs", plugged)
        red = {(x["scene"], x["method"], x["engine"]): said(x) for x in found["lines"] if x["red"]}
        names = [(cell.scene, cell.method, cell.engine) for cell in cells]
        return [(name in red, red.get(name, "")) for name in names]

    with planted() as tree:
        identical(tree)  # compiles everything once
        for condition in CONDITIONS:
            yield repeated("speed", "nothing", condition, "none", partial(identical, tree), runs)
    for factor in SLOWDOWNS:
        wanted = "19 in 20" if factor >= 1.5 else "the more the better"
        with planted() as tree:
            plugged = plugin(scratch / f"slower-{factor}.py", f"slower({SLOWED}, {factor}, {str(tree)!r})")
            for condition, share in halves(max(2, runs // 2)):  # several judgements a run
                what = f"loops {factor} times as slow, {len(cells)} judged in each run"
                yield repeated("speed", what, condition, wanted, partial(slowed, tree, plugged), share)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--runs", type=int, default=20, help="runs of identical code; half as many of each slowdown"
    )
    parser.add_argument("--results", type=Path, default=ROOT / "results", help="where the tables are and go")
    parser.add_argument("--only", choices=gate.PARTS, help="one part of the gate; both by default")
    arguments = parser.parse_args()
    if speed.dirty(ROOT):
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
