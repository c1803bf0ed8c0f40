"""Timing in turns: every run twice, neither first nor last always, three times each at least."""

from __future__ import annotations

import time

import numpy as np
import pytest

from contactbench.measure import clock
from contactbench.measure.clock import MOST_ROUNDS, WARM, Race, calls_a_round, length_columns, time_columns


def test_runs_take_turns_in_changing_order_and_are_measured_twice(monkeypatch):
    calls = []
    race = Race([lambda i=i: (calls.append(i), time.sleep(2e-3)) for i in range(3)])
    monkeypatch.setattr(
        race, "warm_up", lambda warm_up=race.warm_up: [min(warm_up())] * 3
    )  # all of one length
    race.go(0.2)
    for i in range(3):
        assert [len(samples) for samples in race.measured[i]] == [
            len(samples) for samples in race.measured[0]
        ]
        assert min(map(len, race.measured[i])) >= 3
        columns = race.columns(i)
        taken = [t for samples in race.measured[i] for t in samples]
        assert min(taken) >= 2e-3  # asleep at least as long as asked for, however busy the machine
        assert columns["time_median_s"] == np.median(taken)
        assert columns["rounds"] == sum(map(len, race.measured[i]))
        assert columns["time_repeat_ratio"] > 0
    after = calls[6:]  # two each to warm up; one call fills a round
    rounds = [after[k : k + 3] for k in range(0, len(after), 3)]
    assert all(sorted(turn) == [0, 1, 2] for turn in rounds)
    assert len({tuple(turn) for turn in rounds}) > 1


def test_every_run_has_three_rounds_a_visit_where_there_is_no_time_for_more():
    race = Race([lambda: time.sleep(5 * WARM), lambda: None])
    race.go(0.0)
    assert [[len(samples) for samples in visits] for visits in race.measured] == [[3, 3], [3, 3]]


def test_a_run_that_grows_slower_has_three_rounds_a_visit_and_no_more(monkeypatch):
    """A clock by script: an eighth of a second for the warm call, eight for the others, in a race of two."""
    now, lengths = [0.0], iter([0.125])
    monkeypatch.setattr(clock, "perf_counter", lambda: now[0])

    def run():
        now[0] += next(lengths, 8.0)

    race = Race([run])
    race.go(2.0)
    assert race.measured == [[[8.0] * 3, [8.0] * 3]]


def test_an_interrupted_race_keeps_the_rounds_it_has():
    count = [0]

    def run():
        count[0] += 1
        time.sleep(2e-3)
        if count[0] == 5:
            raise KeyboardInterrupt

    race = Race([run])
    with pytest.raises(KeyboardInterrupt):
        race.go(1.0)
    assert len(race.measured[0][0]) == 2
    assert "time_repeat_ratio" not in race.columns(0)
    assert race.columns(0)["time_median_s"] > 0


def test_a_round_is_half_a_millisecond_of_calls():
    assert calls_a_round(1e-5) == 50
    assert calls_a_round(1.0) == 1
    assert MOST_ROUNDS >= 3


def test_the_columns_are_order_statistics():
    columns = time_columns([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], 7)
    assert (columns["time_min_s"], columns["time_median_s"], columns["rounds"], columns["iterations"]) == (
        1,
        3.5,
        6,
        7,
    )
    assert columns["time_repeat_ratio"] == 2.5


def test_fixed_and_marginal_cost_are_those_of_the_line_through_two_lengths():
    fixed, per_time, span, share = 3e-6, 2e-7, 40.0, 0.2
    drift = [1.0, 1.2, 0.9, 1.1]  # of the machine, in turns: it scales both lengths of a round
    whole = [[d * (fixed + per_time * span) for d in drift], [fixed + per_time * span] * 3]
    part = [[d * (fixed + per_time * span * share) for d in drift], [fixed + per_time * span * share] * 3]
    columns = length_columns(whole, part, share, span)
    assert columns["fixed_s"] == pytest.approx(fixed, rel=1e-9)
    assert columns["marginal_s"] == pytest.approx(per_time, rel=1e-9)
    assert columns["marginal_repeat_ratio"] == pytest.approx(1 / 1.05, rel=1e-9)
    assert columns["marginal_iqr_s"] > 0
    only = length_columns(whole[:1], part[:1], share, span)
    assert "marginal_repeat_ratio" not in only
