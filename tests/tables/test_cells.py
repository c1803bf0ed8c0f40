"""Runs that are killed, at any moment, and runs at the same time: no row lost, doubled or half-written."""

import json
import subprocess
import sys
import time

import pytest

from cases import bench, finished, own_processes
from contactbench.tables.cells import FOLDER, Cells
from contactbench.tables.declared import ORDERS, RUNS, TIMES
from contactbench.tables.provenance import runs
from contactbench.tables.schema import TABLES
from contactbench.tables.store import read
from made_up import row

SMALL = "bench_grid and oscillator and not forced and herglotz"
#: both at three settings
TIMED = 6
#: runs and times of both
CELLS = 4


def order(**more):
    return {"scene": "particle", "method": "rk4", "step": 0.1, "status": "ok", "error": 1e-3} | more


def finish(results, *names, run="one", profile="smoke", selection="", merged=(), **more):
    """A run that finishes cells, each with a row of a method of its name, and merges them unless merged is None."""
    cells = Cells(results, profile, run, selection)
    cells.begin({"profile": profile})
    for name in names:
        cells.save([(RUNS, row(name, **more))], ("bench.py", name))
    if merged is not None:
        cells.merge([("bench.py", name) for name in merged])
    return cells


def methods(results, table=RUNS):
    return list(read(table, results)["method"])


def test_a_run_ends_in_the_tables(tmp_path):
    cells = Cells(tmp_path, "smoke", "one")
    cells.begin({"profile": "smoke"})
    cells.save([(RUNS, row()), (ORDERS, order())], ("bench.py", "a"))
    cells.save([(RUNS, row("contact-abc", status="failed"))], ("bench.py", "b"), finished=False)
    cells.merge()
    assert methods(tmp_path) == ["contact-abc", "rk4"]
    (run,) = runs(tmp_path)
    assert (run["run"], run["tables"]) == ("one", {"runs": "part", "orders": "part"})
    assert set(cells.done()) == {("bench.py", "a")}
    assert [name for name, _ in cells.rows(("bench.py", "a"))] == ["runs", "orders"]
    assert cells.rows(("bench.py", "b")) is None
    assert not Cells(tmp_path, "standard", "two").done()


def test_cells_are_done_until_their_selection_begins_anew(tmp_path):
    finish(tmp_path, "a")
    part = Cells(tmp_path, "smoke", "two", "-k a")
    assert set(part.done()) == {("bench.py", "a")}
    time.sleep(0.02)
    part.begin_anew()
    assert not part.done()
    assert set(Cells(tmp_path, "smoke", "three").done()) == {("bench.py", "a")}  # of the whole


@pytest.mark.parametrize("damage", [b"", b"\xff\x00", b"[1, 2]", b'{"run": "one"}'])
def test_a_damaged_file_is_no_cell(tmp_path, damage):
    cells = finish(tmp_path, "a", "b", merged=None)
    next(cells.folder.glob("*.new")).write_bytes(damage)
    (tmp_path / FOLDER / "one.json").write_bytes(damage[:2])  # where and with what the run was made
    cells.merge()
    assert len(methods(tmp_path)) == len(cells.done()) == 1


def test_what_is_merged_is_not_merged_again(tmp_path):
    """Rows of a later run, or of a restored table, stay."""
    finish(tmp_path, "a", status="ok")
    finish(tmp_path, "a", run="two", profile="standard", status="failed")
    finish(tmp_path, "b", run="three")
    assert list(read(RUNS, tmp_path)["status"]) == ["failed", "ok"]


KILLED_WHILE_MERGING = """
import os, sys
from pathlib import Path
from contactbench.tables import cells, provenance, store
from contactbench.tables import declared as tables
row = {"scene": "particle", "method": "rk4", "engine": "llvm", "control": "step", "setting": 0.1, "saved": 1}
ended = {**row, "status": "ok", "message": ""}
order = {"scene": "particle", "method": "rk4", "step": 0.1}
calls = []
def killed(results, steps):
    run = cells.Cells(results, "smoke", "killed")
    run.begin({"profile": "smoke"})
    run.save([(tables.RUNS, ended), (tables.ORDERS, order), (tables.TIMES, {**row, "least_s": 1.0})], ("bench.py", "a"))
    run.save([(tables.RUNS, {**ended, "method": "contact-abc"})], ("bench.py", "b"))
    replace = os.replace
    def dying(*paths):
        calls.append(paths)
        if len(calls) > steps:
            os._exit(9)
        replace(*paths)
    os.replace = dying
    run.merge()
    os._exit(0)
for steps in map(int, sys.argv[2:]):  # a process each, without importing everything each time
    child = os.fork()
    if not child:
        killed(Path(sys.argv[1]) / str(steps), steps)
    print(steps, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
#: files that take their names: three tables, the list of runs, two cells that are merged
STEPS = range(7)


@pytest.fixture(scope="module")
def killed_while_merging(tmp_path_factory):
    """A folder of results for every number of files renamed before the kill, and how each process ended."""
    folder = tmp_path_factory.mktemp("killed")
    command = [sys.executable, "-c", KILLED_WHILE_MERGING, str(folder), *map(str, STEPS)]
    printed = subprocess.run(command, timeout=120, capture_output=True, text=True, check=True).stdout
    return folder, dict(tuple(map(int, line.split())) for line in printed.splitlines())


@pytest.mark.posix
@pytest.mark.parametrize("steps", STEPS)
def test_a_kill_while_merging_loses_and_doubles_nothing(killed_while_merging, steps):
    folder, codes = killed_while_merging
    results = folder / str(steps)
    assert codes[steps] == (9 if steps < STEPS[-1] else 0)
    cells = Cells(results, "smoke", "next")
    cells.begin({"profile": "smoke"})
    assert methods(results) == ["contact-abc", "rk4"]
    for table in (ORDERS, TIMES):
        assert methods(results, table) == ["rk4"]
    assert list(read(TIMES, results)["least_s"]) == [1.0]
    assert [run["run"] for run in runs(results)] == ["killed"]
    assert set(cells.done()) == {("bench.py", "a"), ("bench.py", "b")}
    assert not list(results.glob(f"{FOLDER}/*/*.new"))


def finished_cells(results):
    """The entries of all cells that runs have finished, merged or not."""
    paths = results.glob(f"{FOLDER}/*/*")
    return [json.loads(path.read_text()) for path in paths if path.suffix in (".new", ".done")]


def wait_for(condition, seconds=240):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.parametrize("bench", [bench, own_processes], ids=["pytest", "contactbench bench"])
@pytest.mark.parametrize("moment", range(CELLS), ids="killed after {} cells".format)
@pytest.mark.quick(moment=1, bench=bench)
def test_a_killed_run_resumes_and_loses_and_doubles_nothing(tmp_path, moment, bench):
    process = bench(tmp_path, SMALL)
    wait_for(lambda: list(tmp_path.glob(f"{FOLDER}/*.json")))
    wait_for(lambda: process.poll() is not None or len(finished_cells(tmp_path)) >= moment)
    process.kill()
    process.communicate()
    kept = finished_cells(tmp_path)
    finished(bench(tmp_path, SMALL, "--resume"))
    again = [entry["cell"] for entry in finished_cells(tmp_path) if entry not in kept]
    assert len(again) == CELLS - len(kept)
    assert not [entry for entry in kept if entry["cell"] in again]
    for name, one in [pair for entry in kept for pair in entry["rows"]]:
        frame = read(TABLES[name], tmp_path)
        key = [column for column in TABLES[name].key if column in one]
        (mine,) = frame[(frame[key] == [one[column] for column in key]).all(axis=1)].to_dict("records")
        for column in {"error", "evaluations", "steps"} & one.keys():
            if one[column] is not None:
                assert mine[column] == pytest.approx(one[column], rel=1e-5, nan_ok=True), column
    assert len(read(TIMES, tmp_path)) == TIMED
    assert set(methods(tmp_path)) == {"herglotz1", "herglotz2"}


@pytest.mark.slow
def test_two_runs_at_once_do_not_corrupt_each_other(tmp_path):
    first, second = (bench(tmp_path, f"{SMALL}{n}") for n in (1, 2))
    for process in (first, second):
        finished(process)
    assert set(methods(tmp_path, TIMES)) == {"herglotz1", "herglotz2"}


def test_a_whole_run_removes_rows_whose_benchmark_no_longer_exists(tmp_path):
    finish(tmp_path, "a", "gone", merged=["a", "gone"])
    assert methods(tmp_path) == ["a", "gone"]
    time.sleep(0.02)
    Cells(tmp_path, "smoke", "two").begin_anew()
    finish(tmp_path, "b", run="two")  # a part keeps the rest
    finish(tmp_path, run="three", merged=["a", "b"])  # a has not been done again
    assert methods(tmp_path) == ["a", "b", "gone"]
    finish(tmp_path, "a", run="four", merged=["a", "b"])  # resumed: now all are done
    assert methods(tmp_path) == ["a", "b"]
    assert runs(tmp_path)[-1]["tables"] == {"runs": "whole"}
