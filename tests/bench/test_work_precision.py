"""What work–precision adds to a run, and settings at which methods cost the same."""

from __future__ import annotations

import math

import pytest

import contactbench as cb
from bench_decay import COSTS, SAVES, evaluations, value_at
from bench_work_precision import error, errors, evaluations_spread, passes_through
from cases import few_slow
from cells import step_at, tolerance_at
from conftest import PROFILES
from contactbench.measure.ladder import ENDS, work_ladder


def spread(method, scene, rtol):
    run = cb.prepare(scene, method, rtol=rtol, save_at=[cb.SCENES[scene].t_end], carry=())
    return evaluations_spread(run, run().counts.evaluations)


@pytest.mark.parametrize("method", few_slow(["cvode-adams", "cvode-bdf", "heyoka-taylor"], "cvode-adams"))
def test_a_short_run_costs_the_same_whatever_the_last_digit_of_its_initial_data(method):
    assert spread(method, "particle", 1e-4) == 0


def test_a_long_run_of_cvode_at_a_tight_tolerance_turns_on_roundings():
    """Why its counts are not compared to a tenth: 31 to 49 thousand evaluations were met."""
    assert spread("cvode-adams", "particle_long", 1e-12) > 0.1


FIXED = [method.name for method in cb.METHODS.values() if method.control == "step"]


@pytest.mark.parametrize("method", FIXED)
def test_fixed_steps_pass_through_the_earlier_ends(method):
    """The error there, of runs of their own and of one that passes through; a processed method has more of it."""
    scene = cb.SCENES["central"]
    ends = [scene.t_end * k / ENDS for k in range(1, ENDS)]
    options = {"step": work_ladder(scene, cb.METHODS[method].order)[2], "engine": "python", "carry": ()}
    own = error([cb.solve(scene, method, save_at=[t], **options) for t in ends])
    passing = error([cb.solve(scene, method, save_at=ends, **options)])
    same = passing == pytest.approx(own, rel=1e-6, abs=1e-14)
    assert same == passes_through(cb.METHODS[method], "python", "step")


@pytest.mark.parametrize(
    ("scene", "method", "value", "fields"),
    [
        ("particle", "contact-strang", 0.8, "q p"),
        ("quadratic_damping", "contact-strang", 0.8, "q p s"),
        ("quadratic_damping", "cyrk-vern8", 1e-5, "q p s"),
        ("rigid_body", "cyrk-vern8", 1e-5, "M R"),
        ("rigid_body_anisotropic", "cyrk-vern8", 1e-5, "M"),
        ("forced_oscillator", "contact-strang", 0.8, "q p t"),
        ("forced_oscillator", "cyrk-vern8", 1e-5, "q p"),
    ],
)
def test_carried_is_what_is_integrated(scene, method, value, fields):
    item = cb.METHODS[method]
    row = errors((scene, method, item.engines[0], item.control, value), PROFILES["standard"])
    assert row["carried"] == fields


# -- settings of equal cost ------------------------------------------------------------------------
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
