"""Settings of equal cost: found, the same every time, and honest where there are none."""

from __future__ import annotations

import math

import pytest

import contactbench as cb
from bench_decay import COSTS, SAVES, evaluations, value_at
from cells import step_at, tolerance_at

RANGE = (1e-13, 1e-1)


def smooth(rtol):
    return 10 * rtol**-0.2


@pytest.mark.parametrize("target", [20.0, 137.0, 2000.0])
def test_a_tolerance_is_found_for_a_cost(target):
    rtol = tolerance_at(smooth, target, RANGE)
    assert smooth(rtol) == pytest.approx(target, rel=0.03)
    assert float(f"{rtol:.3g}") == rtol  # as it is printed


def test_bad_ends_at_loose_tolerances_and_spent_budgets_are_avoided():
    def cost(rtol):
        return 0.0 if rtol > 1e-4 else math.inf if rtol < 1e-9 else smooth(rtol)

    assert smooth(tolerance_at(cost, 300.0, RANGE)) == pytest.approx(300.0, rel=0.03)
    assert cost(tolerance_at(cost, 15.0, RANGE)) == pytest.approx(
        smooth(1e-4), rel=0.05
    )  # the cheapest there is


@pytest.mark.parametrize("name", ["contact-strang", "contact-rkn8", "contact-o8", "rk4", "scipy-dop853"])
@pytest.mark.parametrize("cost", COSTS)
def test_costs_are_equal_within_a_tenth_and_settings_the_same_every_time(name, cost):
    scene, method = cb.SCENES["central"], cb.METHODS[name]
    target = cost * scene.t_end
    value = value_at(scene, method, target)
    assert value == value_at(scene, method, target)
    assert evaluations(scene, method, value) == pytest.approx(target, rel=0.1)


def test_steps_end_at_the_saved_times_and_rotations_count_half():
    for name in ("contact-strang", "contact-bm4"):
        method, body = cb.METHODS[name], cb.SCENES["rigid_body"]
        h = step_at(method, body, 600.0, SAVES)
        steps = body.t_end / h
        assert round(steps) % SAVES == 0
        assert method.counts(body, round(steps)) / 2 == pytest.approx(600, rel=0.1)
