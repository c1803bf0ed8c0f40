"""Tables survive the round trip, partial runs, kills, and refuse what is not theirs."""

from __future__ import annotations

import math
import os

import pandas as pd
import pytest

import contactbench as cb
from contactbench.results import schema as table
from contactbench.results.schema import CONVERGENCE, merge, read, replacing


def row(method="rk4", setting="step=0.1", error=1e-3, **more):
    return {
        "scene": "particle", "method": method, "engine": "jax", "setting": setting, "status": "ok",
        "message": "", "step": 0.1, "solution_error": error, "steps": 200, "run_id": "one", **more,
    }  # fmt: skip


def test_round_trip_keeps_every_digit(tmp_path):
    error = math.pi * 1e-13
    merge(CONVERGENCE, [row(error=error)], tmp_path)
    back = read(CONVERGENCE, tmp_path)
    assert back["solution_error"].iloc[0] == error
    assert back["steps"].iloc[0] == 200
    assert pd.isna(back["order"].iloc[0])
    assert "e-13" in CONVERGENCE.path(tmp_path).read_text()  # scientific notation


def test_a_partial_run_replaces_its_rows_and_leaves_the_rest(tmp_path):
    merge(CONVERGENCE, [row("rk4"), row("contact-abc")], tmp_path)
    merge(CONVERGENCE, [row("rk4", error=5e-5, run_id="two")], tmp_path)
    back = read(CONVERGENCE, tmp_path).set_index("method")
    assert back.loc["rk4", "solution_error"] == 5e-5
    assert back.loc["rk4", "run_id"] == "two"
    assert back.loc["contact-abc", "run_id"] == "one"


def test_rows_are_in_registry_order_coarse_to_fine(tmp_path):
    rows = [row(m, f"step={h}") for m in ("rk4", "contact-strang") for h in (0.05, 0.1)]
    back = merge(CONVERGENCE, rows, tmp_path)
    assert list(zip(back["method"], back["setting"], strict=True)) == [
        ("contact-strang", "step=0.1"), ("contact-strang", "step=0.05"), ("rk4", "step=0.1"), ("rk4", "step=0.05"),
    ]  # fmt: skip


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


def test_another_schema_is_refused(tmp_path, monkeypatch):
    merge(CONVERGENCE, [row()], tmp_path)
    monkeypatch.setattr(table, "SCHEMA_VERSION", 99)
    with pytest.raises(cb.BadInput, match="this version reads 99"):
        read(CONVERGENCE, tmp_path)


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


def test_every_column_has_a_meaning_and_every_law_a_column():
    for item in table.TABLES.values():
        assert all(item.columns.values()), item.name
        assert set(item.key) <= set(item.columns)
    assert set(cb.LAWS) <= set(table.LAWS_TABLE.columns)


def test_environment_says_where_a_run_was_made():
    record = table.environment("smoke", 1)
    assert {"packages", "cpu", "cores", "threads", "commit", "dirty", "utc", "references"} <= set(record)
    assert record["packages"]["jax"]
