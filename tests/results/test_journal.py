"""Runs that are killed, at any moment, and runs at the same time: no row lost, doubled or half-written."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time

import pytest

import contactbench as cb
from cases import bench, finished, most_slow
from contactbench.results.journal import FOLDER, Journal, begin_anew, done, entries, fold_dead_runs
from contactbench.results.provenance import runs
from contactbench.results.schema import TABLES
from contactbench.results.store import read
from contactbench.results.tables import CONVERGENCE, LAWS_TABLE, WORK_PRECISION

RECORD = {"profile": "smoke"}
LARGE = "particle and not long and not limit and (strang or cvode-adams)"
#: without what is compiled by JAX and numba: a kill is one whatever it interrupts
SMALL = f"{LARGE} and not weak and not jax and not numba"
LARGE_TIMED = 5  # contact-strang on its three engines, cvode-adams on its two
TIMED = 3
#: convergence of one, decay and laws of both; errors and times
CELLS = 5 + 2 * TIMED


def row(method="rk4", setting="step=0.1", **more):
    return {
        "scene": "particle", "method": method, "engine": "jax", "setting": setting, "status": "ok",
        "message": "", "profile": "smoke", **more,
    }  # fmt: skip


def test_a_run_ends_in_the_tables(tmp_path):
    journal = Journal(tmp_path, "one")
    journal.open(RECORD)
    journal.append([(CONVERGENCE, row()), (LAWS_TABLE, row())], ("bench.py", "a"))
    journal.append([(CONVERGENCE, row("contact-abc", status="failed"))])  # the cell itself failed
    journal.close()
    assert list(read(CONVERGENCE, tmp_path)["method"]) == ["contact-abc", "rk4"]
    ((run),) = runs(tmp_path)
    assert (run["run"], run["tables"]) == ("one", {"convergence": "part", "laws": "part"})
    assert done(tmp_path, "smoke") == {("bench.py", "a")}
    assert done(tmp_path, "standard") == set()
    begin_anew(tmp_path, "smoke", [("bench.py", "a")])
    assert done(tmp_path, "smoke") == set()
    assert sorted(os.listdir(tmp_path / FOLDER)) == ["done.json", "folding"]


def test_a_line_cut_short_is_no_cell(tmp_path):
    journal = Journal(tmp_path, "one")
    journal.open(RECORD)
    journal.append([(CONVERGENCE, row())], ("bench.py", "a"))
    with next(journal.folder.glob("*.jsonl")).open("a") as file:
        file.write('{"cell": ["bench.py", "b"], "rows": [["conv')
    journal.close()
    assert done(tmp_path, "smoke") == {("bench.py", "a")}
    assert len(read(CONVERGENCE, tmp_path)) == 1


def test_a_living_run_is_left_alone(tmp_path):
    living = Journal(tmp_path, "living")
    living.open(RECORD)
    living.append([(CONVERGENCE, row())], ("bench.py", "a"))
    fold_dead_runs(tmp_path)
    assert living.folder.exists()
    assert read(CONVERGENCE, tmp_path).empty
    other = Journal(tmp_path, "other")
    other.open(RECORD)
    other.append([(CONVERGENCE, row("contact-abc"))], ("bench.py", "b"))
    other.close()
    living.close()
    assert list(read(CONVERGENCE, tmp_path)["method"]) == ["contact-abc", "rk4"]
    assert done(tmp_path, "smoke") == {("bench.py", "a"), ("bench.py", "b")}


KILLED_WHILE_FOLDING = """
import os, sys
from pathlib import Path
from contactbench.results import journal, provenance, store, tables
from contactbench.results.journal import Journal
replacing, calls = store.replacing, []
row = {"scene": "particle", "method": "rk4", "engine": "jax", "setting": "step=0.1", "status": "ok", "message": ""}
three = [(t, row) for t in (tables.CONVERGENCE, tables.LAWS_TABLE)]
timed = (tables.WORK_PRECISION, {**row, "time_median_s": 1.0})
def killed(results, writes):
    def dying(path):
        calls.append(path)
        if len(calls) > writes:
            os._exit(9)
        return replacing(path)
    run = Journal(results, "killed")
    run.open({"profile": "smoke"})
    run.append([*three, (tables.LAWS_TIME, {**row, "t": 1.0}), timed], ("bench.py", "a"))
    store.replacing = journal.replacing = provenance.replacing = dying
    run.close()
    os._exit(0)
for writes in map(int, sys.argv[2:]):  # a process each, without importing everything each time
    child = os.fork()
    if not child:
        killed(Path(sys.argv[1]) / str(writes), writes)
    print(writes, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
WRITES = (0, 1, 3, 4, 5, 6, 7)


@pytest.fixture(scope="module")
def killed_while_folding(tmp_path_factory):
    """A folder of results for every number of files written before the kill, and how each process ended."""
    folder = tmp_path_factory.mktemp("killed")
    command = [sys.executable, "-c", KILLED_WHILE_FOLDING, str(folder), *map(str, WRITES)]
    told = subprocess.run(command, timeout=120, capture_output=True, text=True, check=True).stdout
    return folder, dict(tuple(map(int, line.split())) for line in told.splitlines())


@pytest.mark.parametrize("writes", WRITES)
def test_a_kill_while_folding_loses_nothing(killed_while_folding, writes):
    """Five files of four tables, the environment and the list of what is done: killed before any is written."""
    folder, codes = killed_while_folding
    tmp_path = folder / str(writes)
    assert codes[writes] == (9 if writes < 7 else 0)
    fold_dead_runs(tmp_path)
    for table in (CONVERGENCE, LAWS_TABLE, WORK_PRECISION):
        assert list(read(table, tmp_path)["method"]) == ["rk4"]
    assert list(read(WORK_PRECISION, tmp_path)["time_median_s"]) == [1.0]
    assert [run["run"] for run in runs(tmp_path)] == ["killed"]
    assert done(tmp_path, "smoke") == {("bench.py", "a")}
    assert not [path for path in (tmp_path / FOLDER).iterdir() if path.is_dir()]


def lines(results):
    return sum(1 for run in (results / FOLDER).glob("*/") for _ in entries(run))


@pytest.mark.parametrize("moment", most_slow([0, 1, 4], 1), ids="killed after {} cells".format)
def test_a_killed_run_resumes_and_loses_and_doubles_nothing(tmp_path, moment):
    process = bench(tmp_path, SMALL)
    deadline = time.monotonic() + 60
    while not list((tmp_path / FOLDER).glob("*/run.json")) or lines(tmp_path) < moment:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    kept = [entry for run in (tmp_path / FOLDER).glob("*/") for entry in entries(run)]
    output = finished(bench(tmp_path, SMALL, "--resume"))
    assert f"{CELLS - len(kept)} passed" in output
    for name, one in [pair for entry in kept for pair in entry["rows"]]:  # made before the kill, kept after
        frame = read(TABLES[name], tmp_path)
        mine = frame[(frame["method"] == one["method"]) & (frame["setting"] == one["setting"])]
        assert len(mine)
    assert len(read(WORK_PRECISION, tmp_path)) == TIMED
    assert set(read(LAWS_TABLE, tmp_path)["method"]) == {"contact-strang", "cvode-adams"}


@pytest.mark.slow
def test_workers_resume_what_is_left(tmp_path):
    """The same with the cells handed out to worker processes, as in the untimed phase of a run."""
    workers = ("-m", "not timed", "-n", "2")
    finished(bench(tmp_path, f"{SMALL} and strang", *workers))
    resumed = finished(bench(tmp_path, SMALL, "--resume", *workers))
    assert "4 passed" in resumed  # decay and laws of the other method, errors of its two engines
    assert set(read(LAWS_TABLE, tmp_path)["method"]) == {"contact-strang", "cvode-adams"}


@pytest.mark.slow
def test_two_runs_at_once_do_not_corrupt_each_other(tmp_path):
    first, second = bench(tmp_path, f"{SMALL} and cvode"), bench(tmp_path, f"{SMALL} and strang")
    for process in (first, second):
        finished(process)
    work = read(WORK_PRECISION, tmp_path)
    assert set(work["method"]) == {"contact-strang", "cvode-adams"}


def expected_run(tmp_path, made, expected, **record):
    """A run that makes some cells of an experiment, each with a row of a method of its name."""
    journal = Journal(tmp_path, f"of-{'-'.join(made)}")
    journal.open({**RECORD, **record})
    for name in made:
        journal.append([(CONVERGENCE, row(name))], ("bench.py", name))
    if expected:
        journal.expect([("bench.py", name) for name in expected])
    journal.close()
    return list(read(CONVERGENCE, tmp_path)["method"])


def test_a_whole_run_removes_rows_whose_benchmark_no_longer_exists(tmp_path):
    assert expected_run(tmp_path, ["a", "gone"], ["a", "gone"]) == ["a", "gone"]
    begin_anew(tmp_path, "smoke", [("bench.py", "a"), ("bench.py", "b")])
    assert expected_run(tmp_path, ["b"], None) == ["a", "b", "gone"]  # a part keeps the rest
    assert expected_run(tmp_path, [], ["a", "b"]) == ["a", "b", "gone"]  # a has not been done again
    assert expected_run(tmp_path, ["a"], ["a", "b"]) == ["a", "b"]  # resumed: now all are done
    assert runs(tmp_path)[-1]["tables"] == {"convergence": "whole"}


def test_the_run_behind_rows_of_a_larger_profile_stays_on_record(tmp_path):
    large = Journal(tmp_path, "large")
    large.open({"profile": "standard"})
    large.append([(CONVERGENCE, row("a")), (CONVERGENCE, row("b", profile="standard"))], ("bench.py", "a"))
    large.expect([("bench.py", "a")])
    large.close()
    assert expected_run(tmp_path, ["a"], ["a"]) == ["a", "b"]
    assert {run["run"]: run["tables"]["convergence"] for run in runs(tmp_path)} == {
        "large": "whole",
        "of-a": "part",
    }


@pytest.mark.slow
def test_a_rerun_changes_what_the_clock_says_and_nothing_else(tmp_path):
    """Two runs on one machine: the same bytes in every table but those of times."""
    few = "particle and not long and not limit and strang and (laws or work_precision or convergence) and not jax"
    finished(bench(tmp_path, few))
    before = {path.name: path.read_bytes() for path in tmp_path.glob("*.csv")}
    finished(bench(tmp_path, few))
    after = {path.name: path.read_bytes() for path in tmp_path.glob("*.csv")}
    assert {"convergence.csv", "laws.csv", "laws_time.csv", "work_precision.csv"} < set(before) == set(after)
    assert {name for name in before if before[name] != after[name]} == {"work_precision_times.csv"}


@pytest.mark.parametrize("content", ["a,b\n1,2\n", "not a table"])
def test_a_foreign_file_is_refused_at_once_and_kept(tmp_path, content):
    path = CONVERGENCE.path(tmp_path)
    path.write_text(content)
    process = bench(tmp_path, SMALL)
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 4
    assert f"{path}: columns are not those of table 'convergence'; move it away or restore it" in output
    assert path.read_text() == content


def test_rows_of_a_run_whose_tables_are_foreign_stay_in_the_journal(tmp_path):
    journal = Journal(tmp_path, "one")
    journal.open(RECORD)
    journal.append([(CONVERGENCE, row())], ("bench.py", "a"))
    path = CONVERGENCE.path(tmp_path)
    path.write_text("a,b\n1,2\n")
    with pytest.raises(cb.BadInput, match="columns are not those"):
        journal.close()
    journal.alive.release()
    shutil.move(path, tmp_path / "elsewhere")
    fold_dead_runs(tmp_path)
    assert len(read(CONVERGENCE, tmp_path)) == 1


KILLS = 30


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_thirty_kills_lose_and_double_nothing(tmp_path):
    """One run, killed and resumed: before its first cell, after one or two more, in the timed phase too.

    Every other kill comes as soon as the process has begun, so that there are cells left for all of them.
    """
    kept: list = []
    killed = timed = 0
    resume = False
    while killed < KILLS or not timed:
        assert killed < 2 * KILLS  # of which none met the timed phase
        old = set((tmp_path / FOLDER).glob("*/"))
        process = bench(tmp_path, LARGE, *(["--resume"] if resume else []))
        before, deadline = len(done(tmp_path, "smoke")) if resume else 0, time.monotonic() + 120
        if killed % 2:
            while process.poll() is None and not any(
                next(iter(entries(run)), None) for run in set((tmp_path / FOLDER).glob("*/")) - old
            ):
                assert time.monotonic() < deadline
                time.sleep(0.02)
        else:
            time.sleep(0.2 * (killed % 16))
        resume = process.poll() is None  # it lives: this is a kill; else all is done, and begun anew
        process.send_signal(signal.SIGKILL)
        process.communicate()
        killed += resume
        new = [e for run in set((tmp_path / FOLDER).glob("*/")) - old for e in entries(run)]
        timed += any(row.get("time_median_s") for entry in new for _, row in entry["rows"])
        kept += new
        assert len(done(tmp_path, "smoke")) >= before
    finished(bench(tmp_path, LARGE, "--resume"))
    assert timed >= 1  # rows of timed cells were in the journal of the run that was killed
    for name, one in [pair for entry in kept for pair in entry["rows"]]:  # the numbers are there, once
        frame = read(TABLES[name], tmp_path)
        key = [column for column in TABLES[name].key if column in one]
        mine = frame[(frame[key] == [one[column] for column in key]).all(axis=1)]
        assert len(mine) == 1, (name, one)
        for column in ("solution_error", "evaluations", "steps"):
            if one.get(column) is not None:
                assert mine[column].iloc[0] == pytest.approx(one[column], rel=1e-5, nan_ok=True), (
                    name,
                    column,
                )
    for table in (WORK_PRECISION, LAWS_TABLE, CONVERGENCE):
        frame = read(table, tmp_path)
        assert not frame.duplicated(list(table.key)).any()
    assert len(read(WORK_PRECISION, tmp_path)) == LARGE_TIMED
