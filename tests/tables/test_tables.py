"""Tables survive the round trip, partial runs, kills, refuse what is not theirs, and come with the package."""

import json
import math
import os
import random
import subprocess
import sys
import time
import tomllib

import pandas as pd
import pytest

import contactbench as cb
from cases import REPOSITORY, bench, finished, own_processes
from contactbench.measure.law import STRUCTURE
from contactbench.tables import declared, provenance
from contactbench.tables.cells import FOLDER, Cells
from contactbench.tables.declared import LIMITS, ORDERS, PROBLEMS, RUNS, TIMES
from contactbench.tables.provenance import runs
from contactbench.tables.schema import TABLES, Rule
from contactbench.tables.store import OldTable, keys, merge, read, replacing
from made_up import row


def run(method="rk4", setting=0.1, **more):
    """A row of runs.csv."""
    made = {"scene": "particle", "method": method, "engine": "llvm", "control": "step", "setting": setting}
    return made | {"saved": 1, "status": "ok", "profile": "smoke", "steps": 200, "error": 1e-3} | more


def timed(method="rk4", seconds=1.0, **more):
    return {name: run(method)[name] for name in TIMES.key} | {"method": method, "least_s": seconds} | more


def order(step, error, **more):
    return {"scene": "particle", "method": "rk4", "step": step, "status": "ok", "error": error} | more


def test_a_row_comes_back_typed(tmp_path):
    rows = [run(momentum_law_claimed=True, momentum_law_kept=False), run(setting=0.2, family="established")]
    made = merge(RUNS, rows, tmp_path)
    back = read(RUNS, tmp_path)
    pd.testing.assert_frame_equal(back, made)
    assert back["momentum_law_claimed"].tolist() == [False, True]  # a flag that is not given is not set
    assert back["momentum_law_kept"].isna().tolist() == [True, False]  # an answer that is not given is none
    assert back[["steps", "setting", "family"]].values.tolist() == [[200, 0.2, "established"], [200, 0.1, ""]]
    assert back["end_time"].isna().all()


def test_numbers_have_six_digits_round_off_one_inputs_all_and_times_three(tmp_path):
    third, tiny = 1 / 3, math.pi * 5e-15
    rows = [order(third, math.pi * 1e-3), order(0.25, tiny), order(0.125, tiny, engine="mpmath")]
    merge(ORDERS, rows, tmp_path)
    errors = read(ORDERS, tmp_path).set_index("step")["error"]
    # below 100 ε one digit is known; at fifty digits it is no round-off
    assert errors.to_dict() == {third: 3.14159e-3, 0.25: 2e-14, 0.125: 1.5708e-14}
    laws = {"momentum_law": 0.9 * STRUCTURE, "contact_drift": 1.23456789 * STRUCTURE}
    merge(RUNS, [run(error=1.23e-13, **laws), run("contact-abc", error=1.23e-12, condition=1e3)], tmp_path)
    back = read(RUNS, tmp_path).set_index("method")
    assert back["error"].to_dict() == {
        "contact-abc": 1e-12,
        "rk4": 1.23e-13,
    }  # where errors grow so is round-off
    assert back.loc["rk4", ["momentum_law", "contact_drift"]].tolist() == [9e-13, 1.23457e-12]
    merge(TIMES, [timed(seconds=1.23456789e-4)], tmp_path)
    assert read(TIMES, tmp_path)["least_s"].tolist() == [1.23e-4]


@pytest.mark.parametrize("name", TABLES)
def test_a_clock_is_read_for_columns_of_their_own(name):
    """A run without a clock, and the gate on another machine, have all the others."""
    assert set(TABLES[name].timed) == {
        column for column in TABLES[name].columns if column.endswith("_s") or column in ("halves", "process")
    }


def test_the_order_in_which_rows_are_made_does_not_show(tmp_path):
    methods, settings = ("rk4", "contact-strang", "of-a-plugin", "another"), (0.1, 0.2)
    rows = [run(method, setting) for method in methods for setting in settings]
    merge(RUNS, rows, tmp_path / "one")
    random.Random(1).shuffle(rows)
    for name in methods:  # a method on a scene is made as a whole
        merge(RUNS, [row for row in rows if row["method"] == name], tmp_path / "other")
    assert RUNS.path(tmp_path / "one").read_bytes() == RUNS.path(tmp_path / "other").read_bytes()


def test_infinity_is_kept_where_it_is_a_value_and_blank_elsewhere(tmp_path):
    limit = {
        "question": "stability",
        "scene": "oscillator",
        "method": "rk4",
        "gamma": 1.0,
        "measured": math.inf,
    }
    assert merge(LIMITS, [limit], tmp_path)["measured"].tolist() == [math.inf]
    assert read(LIMITS, tmp_path)["measured"].tolist() == [math.inf]
    assert merge(RUNS, [run(bound=math.inf)], tmp_path)["bound"].isna().all()


def test_what_is_made_as_a_whole_loses_the_rows_that_are_not_made_again(tmp_path):
    merge(RUNS, [run(), run(setting=1 / 3), run("contact-abc")], tmp_path)
    merge(RUNS, [run(setting=1 / 3, steps=7)], tmp_path)
    assert read(RUNS, tmp_path)[["method", "setting", "steps"]].values.tolist() == [
        ["contact-abc", 0.1, 200],
        ["rk4", 1 / 3, 7],
    ]
    assert TIMES.whole == RUNS.whole == ("scene", "method")


def test_a_table_made_as_a_whole_drops_what_its_profiles_no_longer_make(tmp_path):
    """Its rows of other profiles stay, and those made of any."""
    profiles = {"rk4": "smoke", "contact-abc": "smoke", "contact-strang": "full"}
    rows = [run(method, profile=profile) for method, profile in profiles.items()]
    merge(RUNS, rows, tmp_path)
    kept = merge(RUNS, rows[:1], tmp_path, keys(RUNS, rows[:1]), ["smoke"])
    assert set(kept["method"]) == set(read(RUNS, tmp_path)["method"]) == {"rk4", "contact-strang"}


def test_a_table_without_profiles_is_whole_in_a_standard_run_alone(tmp_path):
    rows = [{"seed": 1, "scene": name, "hard": ""} for name in ("one", "two")]
    merge(PROBLEMS, rows, tmp_path)
    assert len(merge(PROBLEMS, rows[:1], tmp_path, keys(PROBLEMS, rows[:1]), ["smoke"])) == 2
    assert len(merge(PROBLEMS, rows[:1], tmp_path, keys(PROBLEMS, rows[:1]), ["smoke", "standard"])) == 1


def test_rows_that_are_dropped_are_named_and_those_of_others_stay(tmp_path, caplog):
    rows = [run(method) for method in ("rk4", "contact-strang", "gone", "mine")]
    merge(RUNS, rows, tmp_path)
    made, others = keys(RUNS, rows[-1:]), {"rk4", "contact-strang", rows[0]["scene"]}
    kept = merge(RUNS, rows[-1:], tmp_path, made, ["smoke"], others)
    assert set(kept["method"]) == {"rk4", "contact-strang", "mine"}
    (told,) = caplog.messages
    assert told.startswith("runs: dropped 1 rows that no profile makes any more: ")
    assert " gone " in told
    assert set(merge(RUNS, rows[-1:], tmp_path, made, ["smoke"])["method"]) == {"mine"}


@pytest.mark.parametrize("content", ["a,b\n1,2\n", "", "\x00\x01", '"unclosed'])
def test_a_foreign_or_corrupted_file_is_refused_and_kept(tmp_path, content):
    path = RUNS.path(tmp_path)
    path.write_text(content)
    with pytest.raises(cb.BadInput, match=str(path)):
        merge(RUNS, [run()], tmp_path)
    assert path.read_text() == content


def test_an_older_version_is_refused_when_read_and_replaced_when_written(tmp_path):
    RUNS.path(tmp_path).write_text("scene,method,engine,status\nparticle,rk4,jax,ok\n")
    with pytest.raises(OldTable, match="no column 'control', of another version"):
        read(RUNS, tmp_path)
    merge(RUNS, [run("contact-abc")], tmp_path)
    assert list(read(RUNS, tmp_path)["method"]) == ["contact-abc"]


def test_a_column_more_or_less_is_no_other_version(tmp_path, caplog):
    merge(RUNS, [run(bound=1e-12)], tmp_path)
    path = RUNS.path(tmp_path)
    lacking = ["bound", "momentum_law_claimed", "family"]
    pd.read_csv(path).drop(columns=lacking).assign(colour="red").to_csv(path, index=False)
    for _ in range(2):
        back = read(RUNS, tmp_path)
    assert list(back.columns) == list(RUNS.columns)
    assert math.isnan(back["bound"].iloc[0])
    assert back[lacking[1:]].values.tolist() == [[False, ""]]
    (record,) = caplog.records  # and only once
    assert "'colour'" in record.message


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"colour": "red"}, "no column 'colour'"),
        ({"steps": 2.5}, "column 'steps'"),
        ({"momentum_law_claimed": "perhaps"}, "column 'momentum_law_claimed'"),
    ],
)
def test_a_column_is_known_and_holds_its_type_or_is_refused(tmp_path, values, message):
    with pytest.raises(cb.BadInput, match=message):
        merge(RUNS, [run(**values)], tmp_path)


def test_a_failed_write_leaves_the_old_file_and_no_litter(tmp_path):
    path = tmp_path / "x.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError), replacing(path) as file:  # noqa: PT012
        file.write("half")
        raise RuntimeError
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["x.txt"]


@pytest.mark.parametrize("name", [name for name in cb.LAWS if name in RUNS.columns])
def test_a_law_has_a_column_as_it_says(name):
    law, column = cb.LAWS[name], RUNS.columns[name]
    assert (column.meaning, column.rule) == (law.definition, Rule[law.gate.value])
    assert law.structural == (f"{name}_claimed" in RUNS.columns) == (f"{name}_kept" in RUNS.columns)


def test_there_are_nine_tables_of_at_most_130_columns():
    assert len(TABLES) == 9
    assert sum(len(table.columns) for table in TABLES.values()) <= 130


# -- provenance ------------------------------------------------------------------------------------
#: runs one after another: what each made, what it made whole, and the runs on record then
MADE = [
    ("one", "runs orders", "runs orders", {"one": "runs orders"}),
    ("two", "runs", "", {"one": "runs orders", "two": "runs"}),
    ("three", "runs", "runs", {"one": "orders", "three": "runs"}),
    ("four", "runs", "", {"one": "orders", "three": "runs", "four": "runs"}),
    # of the same commit as four
    ("five", "runs", "", {"one": "orders", "three": "runs", "five": "runs"}),
    ("six", "runs orders", "runs orders", {"six": "runs orders"}),
    # resumes a run that has made the rest of what is whole
    ("seven", "runs", "runs orders", {"six": "orders", "seven": "runs"}),
]


def test_environment_lists_the_last_whole_run_and_the_partial_ones_since(tmp_path):
    for name, made, whole, listed in MADE:
        run = {"profile": "standard", "commit": {"five": "four"}.get(name, name)}
        provenance.save_run(name, run, made.split(), whole.split(), tmp_path)
        found = {run["run"]: run["tables"] for run in provenance.runs(tmp_path)}
        assert {r: {*t} for r, t in found.items()} == {r: {*t.split()} for r, t in listed.items()}
        assert set(found[name].values()) == {"whole" if whole else "part"}


# -- The tables that come with the package -----------------------------------------------------------
@pytest.mark.parametrize("name", TABLES)
def test_a_table_is_a_typed_frame_with_the_meaning_of_its_columns(name, tmp_path):
    table = TABLES[name]
    kinds = {"number": 1.5, "whole": 2, "flag": True, "answer": True, "text": "ok"}
    merge(table, [{column: kinds[each.type] for column, each in table.columns.items()}], tmp_path)
    frame = cb.results(name, tmp_path)
    assert len(frame) == 1
    assert set(frame.attrs["columns"]) == set(frame.columns) == set(table.columns)
    letters = {"number": "f", "whole": "i", "flag": "b", "answer": "b"}
    for column in frame:
        assert frame[column].dtype.kind == letters.get(table.columns[column].type, frame[column].dtype.kind)


def test_tables_lie_inside_an_installed_package_or_beside_the_sources(tmp_path, monkeypatch):
    """As the wheel lays them out (the project's file says that it does), and as a clone has them."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert "/results/*.csv" in wheel["include"]
    assert wheel["sources"]["results"] == "contactbench/_results"
    package = tmp_path / "src" / "contactbench"
    monkeypatch.setattr(declared, "__file__", str(package / "tables" / "declared.py"))
    with pytest.raises(cb.BadInput, match="no result tables in this installation"):
        cb.results("runs")
    merge(RUNS, [run("contact-abc")], package / "_results")
    assert cb.results("runs")["method"].tolist() == ["contact-abc"]
    merge(RUNS, [run("rk4")], tmp_path / "results")
    assert cb.results("runs")["method"].tolist() == ["rk4"]


# -- runs that are killed, at any moment, and runs at the same time ----------------------------------
SMALL = "bench_grid and oscillator and not forced and herglotz"
#: both at three settings
TIMED = 6
#: runs and times of both
CELLS = 4


def order_row(**more):
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
    cells.save([(RUNS, row()), (ORDERS, order_row())], ("bench.py", "a"))
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
