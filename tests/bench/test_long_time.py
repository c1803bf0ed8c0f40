"""Rows of averages over long runs: what a lost trajectory, tangents and a tolerance make of them."""

from __future__ import annotations

import numpy as np
import pytest

import bench_long_time as bench
import contactbench as cb
from contactbench.results.tables import DIMENSION, ENERGY, EXPONENT, LONG_TIME, SUM


@pytest.fixture
def rows(monkeypatch):
    """The rows of a short run with tangents by their quantities."""
    for name, value in {"PERIODS": 40, "SETTLE": 20, "TRAJECTORIES": 64}.items():
        monkeypatch.setattr(bench, name, value)

    def run(method, steps):
        made = list(bench.with_tangents(cb.METHODS[method], "step", bench.PERIOD / steps, 64))
        assert all(set(row) <= set(LONG_TIME.columns) for row in made)
        return {row["quantity"]: row for row in made}

    return run


def test_a_run_with_tangents_gives_every_average_and_what_the_pairs_are_off(rows):
    found = rows("rk4", 16)
    assert list(found) == [ENERGY, EXPONENT, DIMENSION, SUM]
    assert found[EXPONENT]["evaluations_per_time"] == pytest.approx(64 / bench.PERIOD)
    assert abs(found[SUM]["mean"]) <= found[SUM]["pairing_defect"]
    assert found[SUM]["mean"] == pytest.approx(-1.8e-3, rel=0.1)  # with the error of order four of rk4
    assert "pairing_defect" not in found[ENERGY]


def test_where_trajectories_are_lost_there_is_a_row_without_numbers(rows):
    for row in rows("contact-rkn4", 2).values():
        assert (row["status"], "mean" in row) == ("diverged", False)


@pytest.mark.parametrize("name", bench.FIXED)
def test_fixed_steps_are_chosen_for_equal_cost(name):
    method = cb.METHODS[name]
    each, settings = method.per_step(bench.SCENE, ()), bench.settings(method)
    spent = each * bench.PERIOD / np.array([value for _, value in settings])
    assert len(settings) > 5
    for wanted in bench.EVALUATIONS:
        assert np.abs(spent - wanted).min() <= each / 2
