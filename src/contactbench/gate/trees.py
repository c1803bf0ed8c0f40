"""The gate: the tables of a fresh run, of the tree and of the base, read through git, compared by the base's code."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
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
    compare_fresh,
    compare_times,
    keys,
    locate,
    rows_of,
    worst,
)
from contactbench.gate.removed import Removed
from contactbench.plugins import brought
from contactbench.questions.write import computed_part
from contactbench.tables import provenance
from contactbench.tables.schema import TABLES, Rule, Table
from contactbench.tables.store import OldTable, read

PARTS = ("accuracy", "speed")
#: in the messages of commits: tables that are meant to change, or all, and tests that are meant to go
TRAILER = re.compile(r"^Tables-changed:(.*)$", re.MULTILINE | re.IGNORECASE)
REMOVED = re.compile(r"^Tests-removed:(.*)$", re.MULTILINE | re.IGNORECASE)
DEFINED = re.compile(r"^ *(?:async )?def (test_\w+)", re.MULTILINE)
ALL = "all"


def by_base(folder: Path, base: str | None, line: Sequence[str], stdout: TextIO) -> int | None:
    """Have the base's own gate judge a tree by the same command line; return its status, None where we are it."""
    if revisions.JUDGED in os.environ:
        return None
    root = revisions.project(folder)
    if not revisions.ours(root):  # the code that judges is no part of it
        return None
    base = revisions.base(root, base)
    with revisions.checkout(root, base) as tree:
        if not (tree / "src/contactbench/gate").is_dir():
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
    print(findings, end="", file=stdout)
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
    root, where, results = revisions.project(folder), results, (folder / results).resolve()
    if not revisions.ours(root) and not brought():
        raise BadInput(f"{root}: no method or scene of your own; name their file with --plugin FILE")
    if not results.is_relative_to(revisions.repository(root).resolve()):
        raise BadInput(f"--results {where}: must be in the repository, whose older tables are compared")
    base = revisions.base(root, base)
    found = Findings()
    with (
        tempfile.TemporaryDirectory(prefix="contactbench-gate-") as scratch,
        revisions.checkout(root, base) as tree,
    ):
        old = revisions.inside(tree, root, results)
        if not any(old.glob("*.csv")):
            raise BadInput(f"--base {base[:12]}: no tables in {where}/ at that revision")
        if "accuracy" in parts:
            if fresh is None:
                fresh = Path(scratch)
                found += run_benchmark(root, fresh)
            messages = revisions.git(root, "log", "--format=%B", f"{base}..HEAD")
            named = changed_tables(messages, changed, results)
            found += compare_tables(root, results, old, fresh, named, base)
            found += Findings(rows_of(*check_tests(tree, root, messages), *check_report(root, results)))
        if "speed" in parts:
            work = TABLES["work_precision"]
            timed = Removed.read(results).take_out(work, read(work, old))
            cells = speed.workload(timed) if revisions.ours(root) else speed.every(timed)
            if not cells:
                raise BadInput(f"--base {base[:12]}: no timed rows to choose from in {where}/")
            found += speed.compare_speed(root, tree, cells, budget, revisions.pinned(root, base))
    return found


def names_in(trailer: re.Pattern[str], messages: str, option: Iterable[str] = ()) -> set[str]:
    return {name for part in (*trailer.findall(messages), *option) for name in re.findall(r"[^\s,]+", part)}


def changed_tables(messages: str, option: Iterable[str], results: Path) -> set[str]:
    named = names_in(TRAILER, messages, option)
    unknown = sorted(named - {ALL, *TABLES} - {path.stem for path in results.glob("*.csv")})
    if unknown:
        raise BadInput(f"tables changed: {', '.join(unknown)}: no such table; {', '.join(TABLES)} or {ALL}")
    return set(TABLES) if ALL in named else named


def run_benchmark(root: Path, results: Path) -> Findings:
    """Run the smoke profile, of all cells of ours or of what is theirs; red if one fails."""
    command = [sys.executable, "-P", "-m", "contactbench", "bench", "--quiet", "--profile", "smoke"]
    command += ["--results", str(results), *["--all"] * revisions.ours(root)]
    # what it prints is no part of the gate's own output
    status = subprocess.run(command, env=revisions.environment(root), cwd=root, stdout=sys.stderr).returncode
    if status > 1:
        raise BadInput(f"the benchmark did not run (exit {status})")
    return Findings(rows_of(*[row("benchmark run", "passed", "failed", "failed")] * status))


def row(measure: str, before: str, after: str, result: str, **where: object) -> Row:
    return {"measure": measure, "before": before, "after": after, "result": result, **where}


def compare_tables(
    root: Path, results: Path, old: Path, fresh: Path, changed: set[str], base: str
) -> Findings:
    (before, rows), (head, more), (now, _) = (readable(side, changed) for side in (old, results, fresh))
    rows += more + check_record(results, head) + check_record(fresh, now) + check_commit(root, fresh)
    found, reference, runs, removed = Findings(), {}, Runs.of(results, fresh), Removed.read(results)
    for name, table in TABLES.items():
        one, tree, made = removed.take_out(table, before[name]), head[name], now[name]
        listed = name in changed
        edited = ~compared(table, tree).isin(compared(table, one))
        reference[name] = tree[~edited] if listed else one
        moved = (
            compare(table, one, tree),
            *([compare_times(table, one, tree)] if runs.alike else []),  # of another machine they say nothing
            unmade(table, runs, one, tree, made),
        )
        found += between("base → tree", *moved, listed=listed)
        again = compare(table, runs.expected(table, tree[edited], made), made, runs.alike)
        found += between("tree → fresh", again, *([compare_times(table, tree, made)] if runs.alike else []))
        if removed.remains(table, tree) or removed.remains(table, made):
            rows.append(row("removed.toml", "removed", "present", "named, but still there", table=name))
        if len(tree) or revisions.ours(root):  # of another project's tables some may not be wanted
            rows += check_rows(table, one, tree, made)
    found += Findings(rows_of(*rows)) + compare_oldest(root, results, base, changed, removed, head, now)
    return found + compare_fresh(reference, now, Runs.of(old, fresh), "the base")


def compared(table: Table, rows: pd.DataFrame) -> pd.Series:
    """Return a number for each row that changes with whatever of it is compared, its times apart."""
    names = [name for name in table.every_column if name in (*table.key, *table.rules)]
    return pd.util.hash_pandas_object(
        rows[names].drop(columns=table.timed, errors="ignore").astype(str), index=False
    )


def unmade(
    table: Table, runs: Runs, before: pd.DataFrame, head: pd.DataFrame, fresh: pd.DataFrame
) -> pd.DataFrame:
    """Return the rows that the tree has more than the base and no fresh run of this profile makes."""
    new = head[~keys(table, head).isin(keys(table, before))]
    new = new.drop(index=runs.expected(table, new, fresh).index)
    found = locate(table, new).assign(measure="row", before="none", after="present", distance=0.0)
    return worst(found.assign(result="new, made by no fresh run"))


#: how many revisions of the tables errors are held to; those of a table that was listed since are left out
REVISIONS = 10
ERRORS = (Rule.error, Rule.structure)


def compare_oldest(
    root: Path, results: Path, base: str, changed: set[str], removed: Removed, head: Frames, now: Frames
) -> Findings:
    """Compare errors with those of the oldest of the last revisions of a table: small moves do not add up."""
    walk = (
        "rev-list",
        "--first-parent",
        f"--max-count={REVISIONS}",
        base,
        "--",
        os.path.relpath(results, root),
    )
    wanted, found = TABLES.keys() - changed, Findings()
    for revision in reversed(
        revisions.git(root, "--literal-pathspecs", *walk).split()[1:]
    ):  # the last has the tables of the base
        listed = names_in(TRAILER, revisions.git(root, "log", "--format=%B", f"{revision}..{base}"))
        held = {} if ALL in listed else {n: t for n, t in TABLES.items() if n in wanted - listed}
        with revisions.checkout(root, revision, results) as tree:
            old = revisions.inside(tree, root, results)
            for name, table in held.items():
                with suppress(OldTable):
                    oldest = removed.take_out(table, read(table, old))
                    for side, frames in {"tree": head, "fresh": now}.items():
                        moved = compare(table, oldest, frames[name], only=ERRORS)
                        found += between(f"{revision[:12]} → {side}", moved)
        wanted -= held.keys()
    return found


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


def check_tests(old: Path, root: Path, messages: str) -> list[Row]:
    """Return what tests of the base are gone, under whatever path: red where most of a file, and nobody lists it."""
    before, after = test_names(old), test_names(root)
    gone = sum(before.values(), Counter()) - sum(after.values(), Counter())
    listed, rows = names_in(REMOVED, messages), []
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
        path.relative_to(tree).as_posix(): Counter(DEFINED.findall(path.read_text(encoding="utf-8")))
        for path in paths
    }


def check_report(root: Path, results: Path) -> list[Row]:
    """Return what the tables of the tree do not say of its documents, figures and README, by its own report."""
    if not revisions.ours(root) or computed_part(root / "README.md") is None:
        return []
    command = [sys.executable, "-P", "-m", "contactbench", "report", "--check", "--results", str(results)]
    variables = revisions.environment(root)
    run = subprocess.run(command, capture_output=True, cwd=root, env=variables, text=True)
    lines = (run.stdout or run.stderr).strip().splitlines() if run.returncode else []
    return [row("report", "as the tables", line, "differs") | {"between": "tree"} for line in lines]
