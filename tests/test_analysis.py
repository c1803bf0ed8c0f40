"""Order fits, equal-error costs and timing statistics on data whose answer is known."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from clock import FEWEST_ROUNDS, Clock, time_columns
from contactbench.errors import BadInput
from contactbench.measure.order import fit_order
from contactbench.results.statistics import (
    cost_at_error,
    cost_to_reach,
    noise,
    paired_ratio,
    timing,
    verdict,
)

H = [0.8 / 2**k for k in range(9)]


@pytest.mark.parametrize("order", [1, 2, 4, 6, 8])
def test_order_of_a_clean_power_law(order):
    fit = fit_order(H, [3 * h**order for h in H])
    assert fit.order == pytest.approx(order, abs=1e-12)
    assert fit.used.all()
    assert math.isnan(fit.pairwise[0])  # nothing coarser to compare with
    np.testing.assert_allclose(fit.pairwise[1:], order)


def test_pre_asymptotic_points_and_the_round_off_plateau_are_left_out():
    errors = [h**4 * (1 + 30 * h**2) + 1e-10 for h in H]
    fit = fit_order(H, errors, floor=1e-9)
    assert fit.order == pytest.approx(4, abs=0.1)
    assert not fit.used[0]
    assert not fit.used[-1]
    assert fit.low < fit.order < fit.high


def test_the_answer_does_not_depend_on_the_order_of_the_points():
    errors = [h**2 * (1 + h) for h in H]
    one, other = fit_order(H, errors), fit_order(H[::-1], errors[::-1])
    assert one.order == other.order
    np.testing.assert_array_equal(one.used, other.used[::-1])
    np.testing.assert_array_equal(one.pairwise, other.pairwise[::-1])


def test_noise_has_no_order():
    noise = np.random.default_rng(0).uniform(0.1, 1, len(H))
    assert math.isnan(fit_order(H, noise).order)
    assert math.isnan(fit_order(H[:3], [h**2 for h in H[:3]]).order)  # three points are too few
    assert math.isnan(fit_order(H, [math.nan] * len(H)).order)


def test_cost_at_error_interpolates_inside_and_refuses_outside():
    errors, costs = [1e-2, 1e-4, 1e-6], [1.0, 10.0, 100.0]  # cost = error^{-1/2}/10
    assert cost_at_error(errors, costs, 1e-3) == pytest.approx(10**0.5)
    assert cost_at_error(errors, costs, 1e-6) == pytest.approx(100)
    assert math.isnan(cost_at_error(errors, costs, 1e-7))
    assert math.isnan(cost_at_error(errors, costs, 0.1))
    assert math.isnan(cost_at_error([], [], 0.1))


def test_a_setting_that_costs_more_for_less_does_not_count():
    assert cost_at_error([1e-2, 1e-3, 1e-4], [1.0, 500.0, 10.0], 1e-3) == pytest.approx(10**0.5)
    # an accurate setting that is cheaper than all others
    assert cost_at_error([1e-2, 1e-4], [500.0, 10.0], 1e-3) == pytest.approx(10.0)


def test_who_is_more_accurate_than_asked_pays_for_the_cheapest_setting():
    errors, costs = [1e-4, 1e-6, 1e-5], [1.0, 100.0, math.nan]
    assert cost_to_reach(errors, costs, 1e-2) == pytest.approx(1.0)
    assert cost_to_reach(errors, costs, 1e-5) == pytest.approx(10.0)
    assert math.isnan(cost_to_reach(errors, costs, 1e-7))


def test_timing_statistics():
    stats = timing([1.0, 2.0, 3.0, 4.0, 100.0])
    assert (stats.minimum, stats.median, stats.iqr, stats.rounds) == (1.0, 3.0, 2.0, 5)


@pytest.mark.parametrize("true", [0.5, 1.0, 1.3, 2.0])
def test_a_ratio_is_found_in_noise_and_drift(true):
    """Pairs that share a drift and have heavy-tailed noise of their own."""
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(200):
        drift = np.exp(np.cumsum(rng.normal(0, 0.3, 15)))
        base, head = (drift * factor * np.exp(0.03 * rng.standard_t(3, 15)) for factor in (1.0, true))
        found = paired_ratio(base, head)
        assert found.low <= found.ratio <= found.high
        assert found.ratio == pytest.approx(true, rel=0.15)
        inside += found.low <= true <= found.high
    assert inside >= 0.9 * 200  # a percentile interval of a median of 15 covers about 95 %


def test_a_ratio_does_not_mind_single_interruptions_and_is_exact_without_noise():
    base, head = np.full(15, 1e-3), np.full(15, 1.5e-3)
    assert paired_ratio(base, head).ratio == pytest.approx(1.5, rel=1e-12)
    head[[2, 7, 11]] *= 100
    found = paired_ratio(base, head)
    assert found.ratio == found.low == pytest.approx(1.5, rel=1e-12)


# -- wins and ties ---------------------------------------------------------------------------------
def repeated(ratios):
    return pd.DataFrame({"time_repeat_ratio": ratios})


def test_noise_covers_nineteen_of_twenty_repeated_measurements_whichever_was_slower():
    quiet = [1.01, 0.99, 1.02, 1 / 1.03] * 5
    assert noise(repeated(quiet)) == pytest.approx(1.03)
    assert noise(repeated([*quiet, 2.0])) == pytest.approx(1.03)  # one of 21
    assert noise(repeated([*quiet, 2.0, 0.25])) == pytest.approx(2.0)  # two of 22
    assert noise(repeated([1.0, math.nan, 1.3])) == pytest.approx(1.3)
    assert noise(repeated([0.5])) == pytest.approx(2.0)
    assert noise(repeated([])) == noise(repeated([math.nan])) == 1.0


def test_noise_is_found_where_it_was_put():
    spread = np.exp(np.random.default_rng(0).normal(0, 0.1, 4000))
    assert noise(repeated(spread)) == pytest.approx(math.exp(1.96 * 0.1), rel=0.02)


@pytest.mark.parametrize(
    ("ratio", "noise", "expected"),
    [
        (1.14, 1.0, "tie"), (1 / 1.14, 1.0, "tie"), (1.16, 1.0, "loss"), (1 / 1.16, 1.0, "win"),
        (1.16, 1.2, "tie"), (1.25, 1.2, "loss"), (1 / 1.25, 1.2, "win"), (1.0, 3.0, "tie"), (math.inf, 2.0, "loss"),
    ],
)  # fmt: skip
def test_a_verdict_needs_more_than_fifteen_per_cent_and_more_than_the_noise(ratio, noise, expected):
    assert verdict(ratio, noise) == expected


@pytest.mark.parametrize("noise", [1.0, 1.1, 1.4])
def test_the_other_side_sees_the_opposite(noise):
    opposite = {"win": "loss", "loss": "win", "tie": "tie"}
    for ratio in np.geomspace(0.3, 3, 61):
        assert verdict(1 / ratio, noise) == opposite[verdict(ratio, noise)]


@pytest.mark.parametrize("ratio", [0.0, -1.0, math.nan])
def test_what_is_no_ratio_has_no_verdict(ratio):
    with pytest.raises(BadInput, match="ratio of two costs"):
        verdict(ratio, 1.0)


# -- the clock of the benchmark --------------------------------------------------------------------
def test_two_visits_make_one_row_and_measure_the_noise():
    columns = time_columns([[1.0, 2.0, 3.0], [2.0, 4.0, 6.0]], iterations=7)
    assert columns == {
        "time_min_s": 1.0, "time_median_s": 2.5, "time_iqr_s": 1.75, "rounds": 6, "iterations": 7,
        "time_repeat_ratio": 2.0,
    }  # fmt: skip
    assert "time_repeat_ratio" not in time_columns([[1.0, 2.0, 3.0]], iterations=7)


class Benchmark:
    """Stands for pytest-benchmark's fixture: every round takes as long as it is told."""

    def __init__(self, seconds, disabled=False):
        self.seconds, self.disabled, self.asked = seconds, disabled, []
        self.stats = SimpleNamespace(stats=SimpleNamespace(data=[]))

    def pedantic(self, run, rounds, iterations):
        self.asked.append((rounds, iterations))
        self.stats.stats.data = [self.seconds] * rounds


def test_the_second_visit_times_what_the_first_has_prepared():
    cells, made = {}, []
    profile = SimpleNamespace(seconds=0.0)
    first = Clock(cells, "cell", profile, Benchmark(1.0))
    run = first.prepared(lambda: made.append(1) or (lambda: None))
    assert "time_repeat_ratio" not in first.columns(run, "group")
    second = Clock(cells, "cell", profile, Benchmark(1.5))
    columns = second.columns(second.prepared(lambda: made.append(2)), "group")
    assert made == [1]
    assert columns["time_repeat_ratio"] == 1.5
    assert columns["rounds"] == 2 * FEWEST_ROUNDS
    assert second.benchmark.asked[0][1] == first.benchmark.asked[0][1]  # as many calls a round
    assert cells == {}


@pytest.mark.parametrize("disabled", [True, False])
def test_a_run_without_a_clock_or_an_end_has_no_times(disabled):
    cells = {}
    clock = Clock(cells, "cell", SimpleNamespace(seconds=0.0), Benchmark(1.0, disabled))
    run = clock.prepared(lambda: (lambda: None) if disabled else None)
    assert clock.columns(run, "group") == {}
    assert clock.benchmark.asked == []
    assert cells == {}
