"""What work–precision adds to a run: how far its counts turn on roundings."""

from __future__ import annotations

import pytest

import contactbench as cb
from bench_work_precision import evaluations_spread


def spread(method, scene, rtol):
    run = cb.prepare(scene, method, rtol=rtol, save_at=[cb.SCENES[scene].t_end], carry=())
    return evaluations_spread(run, run().counts.evaluations)


@pytest.mark.parametrize("method", ["cvode-adams", "cvode-bdf", "heyoka-taylor"])
def test_a_short_run_costs_the_same_whatever_the_last_digit_of_its_initial_data(method):
    assert spread(method, "particle", 1e-4) == 0


def test_a_long_run_of_cvode_at_a_tight_tolerance_turns_on_roundings():
    """Why its counts are not compared to a tenth: 31 to 49 thousand evaluations were met."""
    assert spread("cvode-adams", "particle_long", 1e-12) > 0.1
