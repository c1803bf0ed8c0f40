"""Judge a working tree: compare its tables, documents, tests and speed with the base revision.

The base's own code judges, so that no change can loosen the rules by which it is judged.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePath
from typing import TextIO

import pandas as pd

from contactbench.errors import BadInput
from contactbench.gate import revisions, speed
from contactbench.gate.compare import (
    Findings,
    Frames,
    Row,
    Runs,
    between,
    compare,
    compare_runs,
    keys,
    locate,
    readable,
    rows_of,
    worst,
)
from contactbench.plugins import brought
from contactbench.tables import provenance
from contactbench.tables.declared import TIMES
from contactbench.tables.schema import TABLES, Table
from contactbench.tables.store import read

PARTS = ("accuracy", "speed")
#: lines of commit messages that announce changed tables (or "all") and removed tests
TABLES_CHANGED = re.compile(r"^Tables-changed:(.*)$", re.MULTILINE | re.IGNORECASE)
TESTS_REMOVED = re.compile(r"^Tests-removed:(.*)$", re.MULTILINE | re.IGNORECASE)
TEST_FUNCTION = re.compile(r"^ *(?:async )?def (test_\w+)", re.MULTILINE)
ALL = "all"


def by_base(folder: Path, base: str | None, line: Sequence[str], stdout: TextIO) -> int | None:
    """Run the base's own gate with the same command line; return its status, or None if this code has to judge."""
    root = revisions.project(folder)
    if revisions.JUDGED in os.environ or not revisions.ours(root):  # other projects do not contain the gate
        return None
    base = revisions.base(root, base)
    with revisions.checkout(root, base) as tree:
        if not (tree / "src/contactbench/gate").is_dir():
            why = f"the base {base[:12]} has no gate that could judge; give a later --base"
            raise BadInput(f"inconclusive: {why}")
        command = [sys.executable, "-P", "-m", "contactbench", *line, "--base", base]
        variables = revisions.environment(tree) | {revisions.JUDGED: "1"}
        with subprocess.Popen(command, env=variables, stdout=subprocess.PIPE, text=True) as run:
            try:
                findings = run.communicate()[0]
            except BaseException:
                run.terminate()  # it removes its temporary folders and ends
                raise
    print(findings, end="", file=stdout)
    return run.returncode if findings else 2


def gate(
    folder: Path,
    results: Path = Path("results"),
    fresh: Path | None = None,
    base: str | None = None,
    parts: Sequence[str] = PARTS,
    changed: Sequence[str] = (),
) -> Findings:
    """Compare the project around `folder` with its base revision.

    results : folder of its tables.  fresh : tables of a finished run; without it the smoke profile runs now.
    changed : names of tables that are meant to change; commit messages may announce more.
    """
    root, where, results = revisions.project(folder), results, (folder / results).resolve()
    if not revisions.ours(root) and not brought():
        raise BadInput(f"{root}: no method or scene of your own; name their file with --plugin FILE")
    if not results.is_relative_to(revisions.repository(root).resolve()):
        raise BadInput(f"--results {where}: must be in the repository, whose older tables are compared")
    base = revisions.base(root, base)
    with (
        tempfile.TemporaryDirectory(prefix="contactbench-gate-") as scratch,
        revisions.checkout(root, base) as tree,
    ):
        old = revisions.inside(tree, root, results)
        if not any(old.glob("*.csv")):
            raise BadInput(f"--base {base[:12]}: no tables in {where}/ at that revision")
        (before, others), found = readable(old), Findings()
        if "accuracy" in parts:
            if fresh is None:
                fresh = Path(scratch)
                found += run_benchmark(root, fresh)
            messages = revisions.git(root, "log", "--format=%B", f"{base}..HEAD")
            named = changed_tables(messages, changed, {path.stem for path in old.glob("*.csv")})
            found += compare_tables(root, results, before, fresh, named | {*others})
            rows = check_tests(tree, root, messages)
            if revisions.ours(root) and any((side / "README.md").exists() for side in (old, results)):
                rows += check_report(root, results)
            found += Findings(rows_of(*rows))
        if "speed" in parts:
            times = before[TIMES.name] if len(before[TIMES.name]) else read(TIMES, results)
            cells = speed.workload(times, everywhere=not revisions.ours(root))
            if not cells:
                raise BadInput(f"--base {base[:12]}: no timed rows to choose from in {where}/")
            found += speed.compare_speed(root, tree, cells, revisions.pinned(root, base))
    return found


def names_in(trailer: re.Pattern[str], messages: str, option: Iterable[str] = ()) -> set[str]:
    return {name for part in (*trailer.findall(messages), *option) for name in re.findall(r"[^\s,]+", part)}


def changed_tables(messages: str, option: Iterable[str], old: set[str]) -> set[str]:
    """Return the names of the tables that are meant to change; old : names of the base's tables, also allowed."""
    named = names_in(TABLES_CHANGED, messages, option)
    if unknown := sorted(named - {ALL, *TABLES} - old):
        raise BadInput(f"tables changed: {', '.join(unknown)}: no such table; {', '.join(TABLES)} or {ALL}")
    return {*TABLES} if ALL in named else named


def run_benchmark(root: Path, results: Path) -> Findings:
    """Run the smoke profile, in another project only for its own methods and scenes; red if a cell fails."""
    command = [sys.executable, "-P", "-m", "contactbench", "bench", "--quiet", "--profile", "smoke"]
    command += ["--results", str(results), *["--all"] * revisions.ours(root)]
    # the gate's own output goes to stdout, the benchmark's to stderr
    status = subprocess.run(command, env=revisions.environment(root), cwd=root, stdout=sys.stderr).returncode
    if status > 1:
        raise BadInput(f"the benchmark did not run (exit {status})")
    return Findings(rows_of(*[row("benchmark run", "passed", "failed", "failed")] * status))


def row(measure: str, before: str, after: str, result: str, **where: object) -> Row:
    return {"measure": measure, "before": before, "after": after, "result": result, **where}


def compare_tables(root: Path, results: Path, before: Frames, fresh: Path, changed: set[str]) -> Findings:
    """Compare the tables of the tree with the base, and a fresh run with the tree."""
    (head, others), (now, more) = map(readable, (results, fresh))
    unlisted = [name for name in (*others, *more) if name not in changed]
    rows = [row("layout", "ours", "another", "not listed", table=name) for name in unlisted]
    rows += check_records(root, {results: head, fresh: now}, fresh)
    runs, found = Runs.of(results, fresh), Findings()
    for name, table in TABLES.items():
        one, tree, made, listed = before[name], head[name], now[name], name in changed
        moved = [compare(table, one, tree)]
        if len(one) or not listed:  # every row of a new, announced table is new
            moved.append(unmade(table, runs, one, tree, made))
        found += between("base → tree", *moved, listed=listed)
        if len(tree) or revisions.ours(root):  # another project need not commit every table
            rows += check_rows(table, one, tree, made)
    return found + compare_runs(head, now, runs, "tree → fresh") + Findings(rows_of(*rows))


def unmade(
    table: Table, runs: Runs, before: pd.DataFrame, head: pd.DataFrame, fresh: pd.DataFrame
) -> pd.DataFrame:
    """Return the new rows of the tree that a fresh run of this profile does not make."""
    new = head[~keys(table, head).isin(keys(table, before))]
    new = new.drop(index=runs.expected(table, new, fresh).index)
    found = locate(table, new).assign(measure="row", before="none", after="present", distance=0.0)
    return worst(found.assign(result="new, made by no fresh run"))


def check_rows(table: Table, before: pd.DataFrame, head: pd.DataFrame, fresh: pd.DataFrame) -> list[Row]:
    """Return a red row if the fresh run makes rows, of the base or a new table, that are not committed."""
    base, tree, made = (keys(table, rows) for rows in (before, head, fresh))
    lacks = made[~made.isin(tree)]
    count = len(lacks) if before.empty and head.empty else int(lacks.isin(base).sum())
    made_alone = row("rows", f"{count} made", "none", "made, but not committed", table=table.name)
    return [made_alone] if count else []


def check_records(root: Path, results: Mapping[Path, Frames], fresh: Path) -> list[Row]:
    """Return red rows for tables without a recorded run, and for a fresh run of another commit."""
    rows = []
    for folder, frames in results.items():
        made = {name for run in provenance.runs(folder) for name in run["tables"]}
        if alone := [name for name, frame in frames.items() if len(frame) and name not in made]:
            rows.append(row("record of the runs", "complete", f"no run made {alone[0]}", "damaged"))
    head, measure = revisions.commit(root, "HEAD"), "commit of the fresh run"
    for run in provenance.runs(fresh):
        if (commit := str(run.get("commit", ""))) != head:
            return [*rows, row(measure, head[:12], commit[:12], "another commit")]
        if run.get("dirty") and not revisions.dirty(root):
            return [*rows, row(measure, head[:12], "with local changes", "another tree")]
    return rows


def check_tests(old: Path, root: Path, messages: str) -> list[Row]:
    """Return the test functions removed, not moved, since the base, by file; red if most of a file went unannounced."""
    before, after = test_names(old), test_names(root)
    gone = sum(before.values(), Counter()) - sum(after.values(), Counter())
    listed, rows = names_in(TESTS_REMOVED, messages), []
    for path, names in before.items():
        count = sum((names & gone).values())
        named = any(PurePath(path).is_relative_to(each) for each in listed)
        most, result = 2 * count > sum(names.values()), "listed" if named else "not listed"
        if count:
            one = row("tests", f"{sum(names.values())} in {path}", f"{count} gone", f"removed, {result}")
            rows.append({**one, "between": "base → tree", "red": most and not named})
    return rows


def test_names(tree: Path) -> dict[str, Counter[str]]:
    paths = sorted((tree / "tests").rglob("test_*.py"))
    return {
        path.relative_to(tree).as_posix(): Counter(TEST_FUNCTION.findall(path.read_text(encoding="utf-8")))
        for path in paths
    }


def check_report(root: Path, results: Path) -> list[Row]:
    """Return a red row for each document, figure or README that differs from the tables (`report --check`)."""
    command = [sys.executable, "-P", "-m", "contactbench", "report", "--check", "--results", str(results)]
    variables = revisions.environment(root)
    run = subprocess.run(command, capture_output=True, cwd=root, env=variables, text=True)
    lines = (run.stdout or run.stderr).strip().splitlines() if run.returncode else []
    return [row("report", "as the tables", line, "differs") | {"between": "tree"} for line in lines]
