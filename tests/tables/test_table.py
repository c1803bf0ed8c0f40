"""Tables survive the round trip, partial runs, kills, refuse what is not theirs, and come with the package."""

import math
import os
import random
import tomllib

import pandas as pd
import pytest

import contactbench as cb
from cases import REPOSITORY
from contactbench.measure.law import STRUCTURE
from contactbench.runs.choice import controlled
from contactbench.tables import declared, provenance
from contactbench.tables.declared import CONVERGENCE, LAWS_TABLE, WORK_PRECISION
from contactbench.tables.schema import TABLES, Rule
from contactbench.tables.store import OldTable, keys, merge, read, replacing
from made_up import ROWS, folder


def row(method="rk4", step=0.1, error=1e-3, **more):
    made = {"scene": "particle", "method": method, "engine": "jax", "status": "ok", "profile": "smoke"}
    return made | controlled("step", step) | {"step": step, "solution_error": error, "steps": 200} | more


def timed(method="rk4", seconds=1.0, **more):
    untimed = {name: value for name, value in row(method).items() if name != "step"}
    return untimed | {"time_median_s": seconds, "rounds": 6} | more


def test_a_row_comes_back_typed(tmp_path):
    rows = [row(in_fit=True, family="established"), row(step=0.2, in_fit=False)]
    made = merge(CONVERGENCE, rows, tmp_path)
    back = read(CONVERGENCE, tmp_path)
    pd.testing.assert_frame_equal(back, made)
    assert back["in_fit"].dtype == bool
    assert back[["steps", "value", "family"]].values.tolist() == [[200, 0.2, ""], [200, 0.1, "established"]]
    assert back["order"].isna().all()


def test_numbers_have_six_digits_round_off_one_inputs_all_and_times_three(tmp_path):
    third = 1 / 3
    tiny = {"error": math.pi * 5e-15}
    rows = [row(step=third, error=math.pi * 1e-3), row(step=0.25, evaluations=800, **tiny)]
    rows += [row(step=0.125, evaluations=10**8, engine="mpmath", **tiny)]
    merge(CONVERGENCE, rows, tmp_path)
    errors = read(CONVERGENCE, tmp_path).set_index("value")["solution_error"]
    # below 100 ε one digit is known; at fifty digits it is no round-off
    assert errors.to_dict() == {third: 3.14159e-3, 0.25: 2e-14, 0.125: 1.5708e-14}
    law = {"momentum_law": 0.9 * STRUCTURE, "contact_drift": 1.23456789 * STRUCTURE}
    key = {name: value for name, value in row().items() if name != "step"}
    merge(LAWS_TABLE, [key | law], tmp_path)
    (law,) = read(LAWS_TABLE, tmp_path).to_dict("records")
    assert (law["momentum_law"], law["contact_drift"]) == (9e-13, 1.23457e-12)
    merge(WORK_PRECISION, [timed(seconds=1.23456789e-4)], tmp_path)
    assert read(WORK_PRECISION, tmp_path)["time_median_s"].tolist() == [1.23e-4]


def test_what_a_clock_says_is_in_a_file_of_its_own(tmp_path):
    folders = [tmp_path / "first", tmp_path / "second"]
    for seconds, place in enumerate(folders, start=1):
        rows = [timed(seconds=seconds), timed("contact-abc", seconds=math.nan, rounds=None)]
        merge(WORK_PRECISION, rows, place)
    first, second = (WORK_PRECISION.path(place).read_bytes() for place in folders)
    assert first == second
    times = pd.read_csv(folders[1] / "work_precision_times.csv")
    assert set(times.columns) == {*WORK_PRECISION.key, *WORK_PRECISION.timed, "schema"}
    assert len(times) == 1  # the row without a time has no place there
    assert not set(pd.read_csv(WORK_PRECISION.path(folders[1])).columns) & set(WORK_PRECISION.timed)
    joined = read(WORK_PRECISION, folders[1]).set_index("method")["time_median_s"]
    assert joined["rk4"] == 2.0
    assert math.isnan(joined["contact-abc"])


def test_the_order_in_which_rows_are_made_does_not_show(tmp_path):
    rows = [
        timed(method, variant=variant, setting=f"{variant} step=0.1".strip())
        for method in ("rk4", "contact-strang", "of-a-plugin", "another")
        for variant in ("", "chosen")
    ]
    merge(WORK_PRECISION, rows, tmp_path / "one")
    random.Random(1).shuffle(rows)
    for one in rows:
        merge(WORK_PRECISION, [one], tmp_path / "other")
    for path in WORK_PRECISION.files(tmp_path / "one"):
        assert path.read_bytes() == (tmp_path / "other" / path.name).read_bytes()


def test_infinity_is_kept_where_it_is_a_value_and_blank_elsewhere(tmp_path):
    limits = {"method": "rk4", "gamma": 1.0, "omega": 1.0, "limit": math.inf}
    merge(declared.STABILITY_LIMITS, [limits], tmp_path)
    assert read(declared.STABILITY_LIMITS, tmp_path)["limit"].tolist() == [math.inf]
    damping = {"method": "rk4", "gamma": 1.0, "damping_per_evaluation": 0.1, "error": math.inf}
    merge(declared.STRONG_DAMPING, [damping], tmp_path)
    assert read(declared.STRONG_DAMPING, tmp_path)["error"].tolist() == [math.inf]
    assert merge(CONVERGENCE, [row(order=math.inf)], tmp_path)["order"].isna().all()


def test_a_key_that_is_a_number_is_found_again(tmp_path):
    """Written with six digits, it must still replace its row."""
    for limit in (2.0, 3.0):
        row = {"method": "rk4", "gamma": 1 / 3, "omega": 2 / 3, "limit": limit}
        merge(declared.STABILITY_LIMITS, [row], tmp_path)
    assert read(declared.STABILITY_LIMITS, tmp_path)["limit"].tolist() == [3.0]


def test_a_measurement_that_now_times_out_does_not_keep_its_old_result(tmp_path):
    """Weak damping: the setting is found by the measurement, and a run that ends early knows none."""
    weak = {"experiment": "weak", "scene": "weak_damping", "method": "rk4", "engine": "jax", "t_end": 1e4}
    done = weak | controlled("step", 0.5) | {"status": "ok"}
    merge(declared.DAMPING_RATES, [done, done | {"t_end": 1e5}], tmp_path)
    merge(declared.DAMPING_RATES, [weak | {"setting": "", "status": "timeout"}], tmp_path)
    back = read(declared.DAMPING_RATES, tmp_path)[["t_end", "status", "setting"]]
    assert back.values.tolist() == [[1e4, "timeout", ""], [1e5, "ok", "step=0.5"]]


def test_a_table_made_as_a_whole_drops_what_its_profiles_no_longer_make(tmp_path):
    """Its rows of other profiles stay, and those made of any."""
    profiles = {"rk4": "smoke", "contact-abc": "smoke", "contact-strang": "full"}
    rows = [row(method, profile=profile) for method, profile in profiles.items()]
    merge(CONVERGENCE, rows, tmp_path)
    kept = merge(CONVERGENCE, rows[:1], tmp_path, keys(CONVERGENCE, rows[:1]), ["smoke"])
    assert set(kept["method"]) == set(read(CONVERGENCE, tmp_path)["method"]) == {"rk4", "contact-strang"}


def test_rows_that_are_dropped_are_named_and_those_of_others_stay(tmp_path, caplog):
    rows = [row(method, profile="smoke") for method in ("rk4", "contact-strang", "gone", "mine")]
    merge(CONVERGENCE, rows, tmp_path)
    made = keys(CONVERGENCE, rows[-1:])
    others = {"rk4", "contact-strang", rows[0]["scene"]}
    kept = merge(CONVERGENCE, rows[-1:], tmp_path, made, ["smoke"], others)
    assert set(kept["method"]) == {"rk4", "contact-strang", "mine"}
    (told,) = caplog.messages
    assert told.startswith("convergence: dropped 1 rows that no profile makes any more: ")
    assert " gone " in told
    assert set(merge(CONVERGENCE, rows[-1:], tmp_path, made, ["smoke"])["method"]) == {"mine"}


@pytest.mark.parametrize("content", ["a,b\n1,2\n", "", "\x00\x01", '"unclosed'])
def test_a_foreign_or_corrupted_file_is_refused_and_kept(tmp_path, content):
    path = CONVERGENCE.path(tmp_path)
    path.write_text(content)
    with pytest.raises(cb.BadInput, match=str(path)):
        merge(CONVERGENCE, [row()], tmp_path)
    assert path.read_text() == content


def test_an_older_version_is_refused_when_read_and_replaced_when_written(tmp_path):
    old = "scene,method,engine,setting,status,schema,run_id\nparticle,rk4,jax,step=0.1,ok,2,one\n"
    CONVERGENCE.path(tmp_path).write_text(old)
    with pytest.raises(OldTable, match="schema 2, this version reads 3"):
        read(CONVERGENCE, tmp_path)
    merge(CONVERGENCE, [row("contact-abc")], tmp_path)
    assert list(read(CONVERGENCE, tmp_path)["method"]) == ["contact-abc"]


def test_a_column_more_or_less_is_no_other_version(tmp_path, caplog):
    merge(CONVERGENCE, [row(order=4.0)], tmp_path)
    path = CONVERGENCE.path(tmp_path)
    frame = pd.read_csv(path).drop(columns=["order", "in_fit", "family"]).assign(colour="red")
    frame.to_csv(path, index=False)
    for _ in range(2):
        back = read(CONVERGENCE, tmp_path)
    assert list(back.columns) == list(CONVERGENCE.every_column)
    assert math.isnan(back["order"].iloc[0])
    assert back[["in_fit", "family"]].values.tolist() == [[False, ""]]
    (record,) = caplog.records  # and only once
    assert "'colour'" in record.message


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"colour": "red"}, "no column 'colour'"),
        ({"steps": 2.5}, "column 'steps'"),
        ({"in_fit": "perhaps"}, "column 'in_fit'"),
    ],
)
def test_a_column_is_known_and_holds_its_type_or_is_refused(tmp_path, values, message):
    with pytest.raises(cb.BadInput, match=message):
        merge(CONVERGENCE, [row(**values)], tmp_path)


def test_a_failed_write_leaves_the_old_file_and_no_litter(tmp_path):
    path = tmp_path / "x.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError), replacing(path) as file:  # noqa: PT012
        file.write("half")
        raise RuntimeError
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["x.txt"]


def test_every_law_has_a_column_as_it_says():
    for name, law in cb.LAWS.items():
        column = LAWS_TABLE.columns[name]
        told = (column.meaning, column.rule, column.shown)
        assert told == (law.definition, Rule[law.gate.value], law.shown)


# -- provenance ------------------------------------------------------------------------------------
#: runs one after another: what each made, what it made whole, and the runs on record then
RUNS = [
    ("one", "laws convergence", "laws convergence", {"one": "laws convergence"}),
    ("two", "laws", "", {"one": "laws convergence", "two": "laws"}),
    ("three", "laws", "laws", {"one": "convergence", "three": "laws"}),
    ("four", "laws", "", {"one": "convergence", "three": "laws", "four": "laws"}),
    # of the same commit as four
    ("five", "laws", "", {"one": "convergence", "three": "laws", "five": "laws"}),
    ("six", "laws convergence", "laws convergence", {"six": "laws convergence"}),
    # resumes a run that has made the rest of what is whole
    ("seven", "laws", "laws convergence", {"six": "convergence", "seven": "laws"}),
]


def test_environment_lists_the_last_whole_run_and_the_partial_ones_since(tmp_path):
    for name, made, whole, listed in RUNS:
        run = {"profile": "standard", "commit": {"five": "four"}.get(name, name)}
        provenance.save_run(name, run, made.split(), whole.split(), tmp_path)
        found = {run["run"]: run["tables"] for run in provenance.runs(tmp_path)}
        assert {r: {*t} for r, t in found.items()} == {r: {*t.split()} for r, t in listed.items()}
        assert set(found[name].values()) == {"whole" if whole else "part"}


# -- The tables that come with the package.  Those that are looked at here are made u --------------
@pytest.mark.parametrize("name", ROWS)
def test_a_table_is_a_typed_frame_with_the_meaning_of_its_columns(name, tmp_path, monkeypatch):
    made = folder(tmp_path / "tables")
    monkeypatch.setattr(declared, "shipped_folder", lambda: made)
    frame, columns = cb.results(name), TABLES[name].every_column
    assert len(frame) == len(ROWS[name])
    assert set(frame.attrs["columns"]) == set(frame.columns) == set(columns)
    kinds = {"number": "f", "whole": "i", "flag": "b", "answer": "b"}
    for column in frame:
        assert frame[column].dtype.kind == kinds.get(columns[column].type, frame[column].dtype.kind), column
    assert name != "work_precision" or frame["time_median_s"].notna().sum() == 2  # times come along


def test_tables_lie_inside_an_installed_package_or_beside_the_sources(tmp_path, monkeypatch):
    """As the wheel lays them out (the project's file says that it does), and as a clone has them."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert "/results/*.csv" in wheel["include"]
    assert wheel["sources"]["results"] == "contactbench/_results"
    package = tmp_path / "src" / "contactbench"
    monkeypatch.setattr(declared, "__file__", str(package / "tables" / "declared.py"))
    with pytest.raises(cb.BadInput, match="no result tables in this installation"):
        cb.results("claims")
    folder(package / "_results")
    assert cb.results("claims")["id"].tolist() == ["C01"]
    folder(tmp_path / "results", lambda which, row: {**row, "id": "C02"} if "id" in row else row)
    assert cb.results("claims")["id"].tolist() == ["C02"]
