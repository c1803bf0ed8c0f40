"""The gate: which tables and revisions are compared, and that the base's own code and rules judge.

A fresh run and the tables of the tree are compared with the tables of the base revision, read through git, so that no
edit of the tree that is judged can move its own goal.  A change that means to change tables names them in the message
of one of its commits, ``Tables-changed: laws, convergence``, or by ``--tables-changed``; ``all`` names every table.
Those are judged by what the tree has, and what became of them is listed for a reviewer.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from contactbench.errors import BadInput
from contactbench.gate import revisions, speed
from contactbench.gate.compare import Findings, Frames, benchmark_runs, compare, compare_tables, keys, rows_of
from contactbench.plugins import brought
from contactbench.results import provenance
from contactbench.results.schema import TABLES, Table
from contactbench.results.store import OldTable, read

PARTS = ("accuracy", "speed")
TRAILER = re.compile(r"^Tables-changed:(.*)$", re.MULTILINE | re.IGNORECASE)
ALL = "all"
Row = dict[str, Any]


def by_base(folder: Path, base: str | None, line: Sequence[str]) -> int | None:
    """Have the base's own gate judge a tree by the same command line; return its status, None where we are it."""
    if revisions.JUDGED in os.environ:
        return None
    root = revisions.repository(folder)
    if not revisions.ours(root):  # the code that judges is no part of it
        return None
    base = revisions.base(root, base)
    with revisions.checkout(root, base) as tree:
        if not (tree / "src/contactbench/gate/judge.py").exists():
            why = f"the base {base[:12]} has no gate that could judge; give a later --base"
            raise BadInput(f"inconclusive: {why}")
        command = [sys.executable, "-P", "-m", "contactbench", *line, "--base", base]
        variables = revisions.environment(tree) | {revisions.JUDGED: sys.executable}
        with subprocess.Popen(command, env=variables, stdout=subprocess.PIPE, text=True) as run:
            try:
                findings = run.communicate()[0]
            except BaseException:
                run.terminate()  # it removes what it has made, and ends
                raise
    print(findings, end="")
    return run.returncode if findings else 2


def gate(
    folder: Path,
    results: Path = Path("results"),
    fresh: Path | None = None,
    base: str | None = None,
    parts: Sequence[str] = PARTS,
    changed: Sequence[str] = (),
    budget: float | None = None,
) -> Findings:
    root = revisions.repository(folder)
    if not revisions.ours(root) and not brought():
        raise BadInput(f"{root}: no method or scene of your own; name their file with --plugin FILE")
    base = revisions.base(root, base)
    found = Findings()
    with (
        tempfile.TemporaryDirectory(prefix="contactbench-gate-") as scratch,
        revisions.checkout(root, base) as tree,
    ):
        old = tree / (root / results).relative_to(root)
        if not any(old.glob("*.csv")):
            raise BadInput(f"--base {base[:12]}: no tables in {results}/ at that revision")
        if "accuracy" in parts:
            if fresh is None:
                fresh = Path(scratch)
                found += run_benchmark(root, fresh)
            messages = revisions.git(root, "log", "--format=%B", f"{base}..HEAD")
            named = changed_tables(messages, changed, root / results)
            found += judge_tables(root, root / results, old, fresh, named)
        if "speed" in parts:
            timed = read(TABLES["work_precision"], old)
            cells = speed.workload(timed) if revisions.ours(root) else speed.every(timed)
            if not cells:
                raise BadInput(f"--base {base[:12]}: no timed rows to choose from in {results}/")
            found += speed.judge_speed(root, tree, cells, budget)
    return found


def changed_tables(messages: str, option: Iterable[str], results: Path) -> set[str]:
    named = {name for part in (*TRAILER.findall(messages), *option) for name in re.findall(r"[^\s,]+", part)}
    unknown = sorted(named - {ALL, *TABLES} - {path.stem for path in results.glob("*.csv")})
    if unknown:
        raise BadInput(f"tables changed: {', '.join(unknown)}: no such table; {', '.join(TABLES)} or {ALL}")
    return set(TABLES) if ALL in named else named


def run_benchmark(root: Path, results: Path) -> Findings:
    """Run the smoke profile untimed, of all cells of ours or of what is theirs; red if one fails."""
    command = [sys.executable, "-P", "-m", "contactbench", "bench", "--profile", "smoke", "--untimed"]
    command += ["--results", str(results), *["--all"] * revisions.ours(root)]
    # what it prints is no part of the gate's own output
    status = subprocess.run(command, env=revisions.environment(root), cwd=root, stdout=sys.stderr).returncode
    if status > 1:
        raise BadInput(f"the benchmark did not run (exit {status})")
    return Findings(rows_of(*[row("benchmark run", "passed", "failed", "failed")] * status))


def row(measure: str, before: str, after: str, result: str, **where: Any) -> Row:
    return {"measure": measure, "before": before, "after": after, "result": result, **where}


def judge_tables(root: Path, results: Path, old: Path, fresh: Path, changed: set[str]) -> Findings:
    (before, rows), (head, more), (now, _) = (readable(side, changed) for side in (old, results, fresh))
    rows += more + check_record(results, head) + check_record(fresh, now) + check_commit(root, fresh)
    found = Findings()
    for name, table in TABLES.items():
        listed = name in changed
        moved = compare(table, before[name], head[name])
        result = moved["result"] + (", listed" if listed else ", not listed")
        moved = moved.assign(measure="committed " + moved["measure"], result=result, red=not listed)
        found += Findings(moved)
        if len(head[name]) or revisions.ours(root):  # of another project's tables some may not be wanted
            rows += check_rows(table, before[name], head[name], now[name])
    reference = {name: head[name] if name in changed else before[name] for name in TABLES}
    compared = compare_tables(reference, benchmark_runs(old), now, benchmark_runs(fresh), "the base")
    return found + Findings(rows_of(*rows)) + compared


def readable(folder: Path, changed: set[str]) -> tuple[Frames, list[Row]]:
    """Return the tables of a folder, and a red row for each of another version that is not meant to change."""
    frames, rows = {}, []
    for name, table in TABLES.items():
        try:
            frames[name] = read(table, folder)
        except OldTable:
            frames[name] = read(table, folder / "none")
            version = row(f"version of {name}", "another", str(table.version), "not listed", table=name)
            rows += [version] * (name not in changed)
    return frames, rows


def check_rows(table: Table, before: pd.DataFrame, head: pd.DataFrame, fresh: pd.DataFrame) -> list[Row]:
    if len(fresh) and before.empty and head.empty:
        return [row("table", "none", f"{len(fresh)} rows", "not committed", table=table.name)]
    base, tree, made = (keys(table, rows) for rows in (before, head, fresh))
    out = int((base.isin(made) & ~base.isin(tree)).sum())
    return [row("rows", f"{out} rows", "none", "taken out, but still made", table=table.name)] if out else []


def check_record(results: Path, frames: Frames) -> list[Row]:
    made = {name for run in provenance.runs(results) for name in run["tables"]}
    found = [f"no run made {name}" for name, frame in frames.items() if len(frame) and name not in made]
    return [row("record of the runs", "complete", each, "damaged") for each in found[:1]]


def check_commit(root: Path, fresh: Path) -> list[Row]:
    head, measure = revisions.commit(root, "HEAD"), "commit of the fresh run"
    for run in provenance.runs(fresh):
        commit = str(run.get("commit", ""))
        if commit != head:
            return [row(measure, head[:12], commit[:12], "another commit")]
        if run.get("dirty") and not revisions.dirty(root):
            return [row(measure, head[:12], "with local changes", "another tree")]
    return []
