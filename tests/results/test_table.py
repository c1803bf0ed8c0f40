"""Tables survive the round trip, partial runs, kills, and refuse what is not theirs."""

from __future__ import annotations

import math
import os
import random
import re

import numpy as np
import pandas as pd
import pytest

import contactbench as cb
from cells import controlled
from contactbench.results import provenance
from contactbench.results.round_off import STRUCTURE
from contactbench.results.schema import TABLES, Column, Rule, Table
from contactbench.results.store import OldTable, keys, merge, read, replacing
from contactbench.results.tables import (
    CONVERGENCE,
    DAMPING_RATES,
    LAWS_TABLE,
    STABILITY_LIMITS,
    STRONG_DAMPING,
    WORK_PRECISION,
)


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
    assert back["in_fit"].tolist() == [False, True]
    assert back["steps"].tolist() == [200, 200]
    assert back["value"].tolist() == [0.2, 0.1]
    assert back["order"].isna().all()
    assert back["family"].tolist() == ["", "established"]  # text is never missing


def test_numbers_have_six_digits_round_off_one_inputs_all_and_times_three(tmp_path):
    third = 1 / 3
    rows = [
        row(step=third, error=math.pi * 1e-3),
        row(step=0.25, error=math.pi * 5e-15, evaluations=800),
        row(step=0.125, error=math.pi * 5e-15, evaluations=10**8, engine="mpmath"),
    ]
    merge(CONVERGENCE, rows, tmp_path)
    back = read(CONVERGENCE, tmp_path).set_index("value")
    assert back.loc[third, "solution_error"] == 3.14159e-3
    assert back.loc[third, "setting"] == "step=0.333333"
    assert back.loc[0.25, "solution_error"] == 2e-14  # below 100 ε
    assert back.loc[0.125, "solution_error"] == 1.5708e-14  # at fifty digits it is no round-off
    law = {name: value for name, value in row().items() if name != "step"}
    merge(
        LAWS_TABLE,
        [law | {"momentum_law": 0.9 * STRUCTURE, "contact_drift": 1.23456789 * STRUCTURE}],
        tmp_path,
    )
    (law,) = read(LAWS_TABLE, tmp_path).to_dict("records")
    assert (law["momentum_law"], law["contact_drift"]) == (9e-13, 1.23457e-12)
    merge(WORK_PRECISION, [timed(seconds=1.23456789e-4)], tmp_path)
    assert read(WORK_PRECISION, tmp_path)["time_median_s"].tolist() == [1.23e-4]


def test_what_a_clock_says_is_in_a_file_of_its_own(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    merge(WORK_PRECISION, [timed(seconds=1.0), timed("contact-abc", seconds=math.nan, rounds=None)], first)
    merge(WORK_PRECISION, [timed(seconds=2.0), timed("contact-abc", seconds=math.nan, rounds=None)], second)
    assert WORK_PRECISION.path(first).read_bytes() == WORK_PRECISION.path(second).read_bytes()
    times = pd.read_csv(WORK_PRECISION.times_path(first))
    assert set(times.columns) == {*WORK_PRECISION.key, *WORK_PRECISION.timed, "schema"}
    assert len(times) == 1  # the row without a time has no place there
    assert not set(pd.read_csv(WORK_PRECISION.path(first)).columns) & set(WORK_PRECISION.timed)
    joined = read(WORK_PRECISION, second).set_index("method")["time_median_s"]
    assert joined["rk4"] == 2.0
    assert math.isnan(joined["contact-abc"])
    assert not LAWS_TABLE.times_path(first).exists()


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
    assert merge(STABILITY_LIMITS, [limits], tmp_path)["limit"].tolist() == [math.inf]
    assert read(STABILITY_LIMITS, tmp_path)["limit"].tolist() == [math.inf]
    errors = dict.fromkeys(["error", "error_saved", "radius"], math.inf)
    merge(
        STRONG_DAMPING, [{"method": "rk4", "gamma": 1.0, "damping_per_evaluation": 0.1, **errors}], tmp_path
    )
    assert np.isinf(read(STRONG_DAMPING, tmp_path)[list(errors)].to_numpy()).all()
    assert merge(CONVERGENCE, [row(order=math.inf)], tmp_path)["order"].isna().all()


def test_a_partial_run_replaces_its_rows_and_leaves_the_rest(tmp_path):
    merge(CONVERGENCE, [row("rk4"), row("contact-abc")], tmp_path)
    before = CONVERGENCE.path(tmp_path).read_text().splitlines()
    merge(CONVERGENCE, [row("rk4", error=5e-5)], tmp_path)
    after = CONVERGENCE.path(tmp_path).read_text().splitlines()
    assert [line for line in after if line not in before] == [line for line in after if "rk4" in line]
    assert read(CONVERGENCE, tmp_path).set_index("method").loc["rk4", "solution_error"] == 5e-5


def test_a_key_that_is_a_number_is_found_again(tmp_path):
    """Written with six digits, it must still replace its row."""
    for limit in (2.0, 3.0):
        merge(STABILITY_LIMITS, [{"method": "rk4", "gamma": 1 / 3, "omega": 2 / 3, "limit": limit}], tmp_path)
    assert read(STABILITY_LIMITS, tmp_path)["limit"].tolist() == [3.0]


def test_a_measurement_that_now_times_out_does_not_keep_its_old_result(tmp_path):
    """Weak damping: the setting is found by the measurement, and a run that ends early knows none."""
    weak = {"experiment": "weak", "scene": "weak_damping", "method": "rk4", "engine": "jax", "t_end": 1e4}
    other = weak | {"t_end": 1e5, **controlled("step", 0.5), "status": "ok"}
    merge(DAMPING_RATES, [weak | controlled("step", 0.5) | {"status": "ok"}, other], tmp_path)
    merge(DAMPING_RATES, [weak | {"setting": "", "status": "timeout"}], tmp_path)
    back = read(DAMPING_RATES, tmp_path)
    assert back[["t_end", "status", "setting"]].values.tolist() == [
        [1e4, "timeout", ""],
        [1e5, "ok", "step=0.5"],
    ]


def test_rows_whose_benchmark_no_longer_exists_are_forgotten(tmp_path):
    made = [row("rk4"), row("contact-strang")]
    merge(CONVERGENCE, [*made, row("gone"), row("of-a-larger-run", profile="full")], tmp_path)
    merge(CONVERGENCE, [], tmp_path, keys(CONVERGENCE, made), ("smoke", "standard"))
    assert set(read(CONVERGENCE, tmp_path)["method"]) == {"rk4", "contact-strang", "of-a-larger-run"}


def test_unknown_columns_are_refused(tmp_path):
    with pytest.raises(cb.BadInput, match="no columns \\['colour'\\]"):
        merge(CONVERGENCE, [row(colour="red")], tmp_path)


@pytest.mark.parametrize(
    "content",
    ["a,b\n1,2\n", "", "\x00\x01", '"unclosed'],
    ids=["foreign", "empty", "binary", "cut short"],
)
def test_a_foreign_or_corrupted_file_is_refused_and_kept(tmp_path, content):
    path = CONVERGENCE.path(tmp_path)
    path.write_text(content)
    with pytest.raises(cb.BadInput, match=str(path)):
        merge(CONVERGENCE, [row()], tmp_path)
    assert path.read_text() == content


def test_an_older_version_is_refused_when_read_and_replaced_when_written(tmp_path):
    old = "scene,method,engine,setting,status,schema,run_id\nparticle,rk4,jax,step=0.1,ok,2,one\n"
    CONVERGENCE.path(tmp_path).write_text(old)
    with pytest.raises(OldTable, match=r"schema 2, this version reads 3; run the benchmark") as error:
        read(CONVERGENCE, tmp_path)
    assert "\n" not in str(error.value)
    merge(CONVERGENCE, [row("contact-abc")], tmp_path)
    assert list(read(CONVERGENCE, tmp_path)["method"]) == ["contact-abc"]


def test_a_column_more_or_less_is_no_other_version(tmp_path, caplog):
    merge(CONVERGENCE, [row(order=4.0)], tmp_path)
    path = CONVERGENCE.path(tmp_path)
    frame = pd.read_csv(path).drop(columns=["order", "in_fit", "family"]).assign(colour="red")
    frame.to_csv(path, index=False)
    back = read(CONVERGENCE, tmp_path)
    assert list(back.columns) == list(CONVERGENCE.every_column)
    assert math.isnan(back["order"].iloc[0])
    assert back[["in_fit", "family"]].values.tolist() == [[False, ""]]
    read(CONVERGENCE, tmp_path)
    assert [record.message for record in caplog.records] == [
        f"{path}: columns ['colour'] are not known to this version and left out"
    ]


def test_a_column_holds_its_type_or_is_refused(tmp_path):
    with pytest.raises(cb.BadInput, match="'convergence', column 'steps'"):
        merge(CONVERGENCE, [row(steps=2.5)], tmp_path)
    with pytest.raises(cb.BadInput, match="'convergence', column 'in_fit': neither True nor False"):
        merge(CONVERGENCE, [row(in_fit="perhaps")], tmp_path)
    with pytest.raises(cb.BadInput, match="key columns"):
        Table("t", "", {"a": Column("a", "number", timed=True)}, key=("a",))


def test_a_failed_write_leaves_the_old_file_and_no_litter(tmp_path):
    path = tmp_path / "x.txt"
    path.write_text("old")

    def fail():
        with replacing(path) as file:
            file.write("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["x.txt"]


def test_every_column_has_a_meaning_and_every_law_a_column_as_it_says():
    for item in TABLES.values():
        assert all(column.meaning for column in item.columns.values()), item.name
        assert {*item.key, *item.whole} <= set(item.columns)
    for name, law in cb.LAWS.items():
        column = LAWS_TABLE.columns[name]
        assert (column.meaning, column.rule, column.shown) == (
            law.definition,
            Rule[law.gate.value],
            law.shown,
        )
        assert column.label


# -- provenance ------------------------------------------------------------------------------------
def test_environment_says_where_a_run_was_made():
    record = provenance.environment("smoke", 1)
    assert {"packages", "cpu", "cores", "threads", "commit", "dirty", "utc", "references"} <= set(record)
    assert record["packages"]["jax"]
    assert re.fullmatch(r"\S+ [0-9a-f]{12}", record["isa"])


def test_environment_lists_the_last_whole_run_and_the_partial_ones_since(tmp_path):
    def ran(name, made, whole=(), commit="a"):
        provenance.save_run(name, {"profile": "standard", "commit": commit}, made, whole, tmp_path)
        return {run["run"]: run["tables"] for run in provenance.runs(tmp_path)}

    assert ran("one", ["laws", "convergence"], ["laws", "convergence"]) == {
        "one": {"laws": "whole", "convergence": "whole"}
    }
    assert ran("two", ["laws"], commit="b")["two"] == {"laws": "part"}
    assert ran("three", ["laws"], ["laws"], commit="c") == {
        "one": {"convergence": "whole"},
        "three": {"laws": "whole"},
    }
    assert set(ran("four", ["laws"], commit="d")) == {"one", "three", "four"}
    assert set(ran("five", ["laws"], commit="d")) == {"one", "three", "five"}  # four again
    assert set(ran("six", ["laws", "convergence"], ["laws", "convergence"])) == {"six"}


@pytest.mark.parametrize("content", ["[1]", "[]", "{}", "nothing", '{"runs": [{"cpu": 1}]}'])
def test_an_odd_environment_is_refused(tmp_path, content):
    (tmp_path / "environment.json").write_text(content)
    with pytest.raises(cb.BadInput, match="not the record of a benchmark run"):
        provenance.runs(tmp_path)
