"""Rows of averages over long runs: what a lost trajectory, tangents and a tolerance make of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

import bench_long_time as bench
import contactbench as cb
from contactbench.results.long_time import DIMENSION, ENERGY, EXPONENT, LONG_TIME, SUM


@pytest.fixture
def short(monkeypatch):
    for name, value in {"PERIODS": 40, "SETTLE": 20, "TRAJECTORIES": 64}.items():
        monkeypatch.setattr(bench, name, value)


def by_quantity(rows):
    rows = list(rows)
    assert all(set(row) <= set(LONG_TIME.columns) for row in rows)
    return {row["quantity"]: row for row in rows}


def test_a_run_with_tangents_gives_every_average_and_what_the_pairs_are_off(short):
    rows = by_quantity(bench.with_tangents(cb.METHODS["rk4"], "step", bench.PERIOD / 16, 64))
    assert list(rows) == [ENERGY, EXPONENT, DIMENSION, SUM]
    assert rows[EXPONENT]["evaluations_per_time"] == pytest.approx(64 / bench.PERIOD)
    assert abs(rows[SUM]["mean"]) <= rows[SUM]["pairing_defect"]
    assert rows[SUM]["mean"] == pytest.approx(-1.8e-3, rel=0.1)  # with the error of order four of rk4
    assert "pairing_defect" not in rows[ENERGY]


def test_where_trajectories_are_lost_there_is_a_row_without_numbers(short):
    rows = by_quantity(bench.with_tangents(cb.METHODS["contact-rkn4"], "step", bench.PERIOD / 2, 64))
    for row in rows.values():
        assert (row["status"], "mean" in row) == ("diverged", False)
        assert row["message"].startswith("64 of 64")


@pytest.mark.slow
def test_a_plain_run_and_one_with_tangents_agree_on_the_energy_and_the_plain_one_is_cheaper(short):
    method = cb.METHODS["cyrk-dop853"]
    plain = bench.plain(method, "rtol", 1e-4)
    along = by_quantity(bench.with_tangents(method, "rtol", 1e-4, 64))[ENERGY]
    assert abs(plain["mean"] - along["mean"]) < 4 * math.hypot(plain["error"], along["error"])
    assert plain["evaluations_per_time"] < along["evaluations_per_time"]


@pytest.mark.parametrize("name", bench.FIXED)
def test_fixed_steps_are_chosen_for_equal_cost(name):
    method = cb.METHODS[name]
    each, settings = method.per_step(bench.SCENE, ()), bench.settings(method)
    spent = each * bench.PERIOD / np.array([value for _, value in settings])
    assert len(settings) > 5
    for wanted in bench.EVALUATIONS:
        assert np.abs(spent - wanted).min() <= each / 2
