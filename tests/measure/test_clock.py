"""How calls are timed, with calls whose times are scripted: no test waits for a clock."""

import itertools
import math
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest

from contactbench.errors import BadInput
from contactbench.measure import clock, statistics
from contactbench.measure.clock import ROUND_SECONDS, VISITS, Call, Race, Visit, ratio_column, time_columns
from contactbench.measure.statistics import Verdict, margin, verdict


@pytest.fixture
def machine(monkeypatch):
    """A clock that stands still but for what calls add to it."""
    now = [0.0]
    monkeypatch.setattr(clock, "perf_counter", lambda: now[0])

    def call(*durations):
        """A function that takes so long, one duration after the other and again."""
        taken = itertools.cycle(durations)
        return lambda: now.__setitem__(0, now[0] + next(taken))

    call.now = now
    return call


def test_the_least_round_is_the_estimate_and_the_halves_are_odd_and_even_visits():
    columns = time_columns([Visit([3.0, 2.0, 4.0]), Visit([6.0, 1.0, 5.0])])
    assert columns == {"least_s": 1.0, "halves": 0.5}
    assert time_columns([Visit([t]) for t in (4.0, 9.0, 9.0, 6.0)])["halves"] == 1.5
    assert "halves" not in time_columns([Visit([1.0])])


def test_a_second_process_is_compared_by_its_least_round():
    first, second = [Visit([4.0]), Visit([2.0])], [Visit([9.0]), Visit([3.0])]
    assert ratio_column("process", clock.least, first, second) == {"process": 1.5}
    assert ratio_column("process", clock.least, first, []) == {}


def test_a_round_takes_as_long_as_it_should_however_slow_the_first_calls_were(machine):
    durations = [10 * ROUND_SECONDS] * 2 + [ROUND_SECONDS / 10] * 500
    call = Call(machine(*durations))
    call.warm_up()
    assert call.calls_a_round() == 1
    call.visit()
    assert call.calls_a_round() in (10, 11)  # the clock's own rounding
    assert call.visit(2).whole == pytest.approx([ROUND_SECONDS / 10] * 2)


def test_a_long_call_has_one_round_a_visit_and_one_to_warm_up(machine):
    calls = Counter()
    slow = machine(2 * clock.LONG)
    call = Call(lambda: (calls.update(["run"]), slow()))
    call.warm_up()
    assert len(call.visit().whole) == 1
    assert calls["run"] == 2


@pytest.mark.parametrize(
    ("budget", "visits", "rounds"),
    [(0.0, VISITS, 1), (2.2 * VISITS * 2, VISITS, 2), (1e9, clock.MOST_VISITS, clock.ROUNDS)],
)
def test_where_time_is_short_there_are_fewer_rounds_and_never_fewer_visits(machine, budget, visits, rounds):
    seen = ([], [])

    def call(rounds_of_visits):
        def visit(rounds):
            machine.now[0] += rounds
            rounds_of_visits.append(rounds)
            return Visit([1.0])

        return SimpleNamespace(warm_up=lambda: 1.0, visit=visit)

    Race(list(map(call, seen))).go(budget)
    assert seen == ([rounds] * visits,) * 2


def test_no_visit_begins_after_the_limit(machine):
    visits = []

    def visit(rounds):
        machine.now[0] += 1.0
        visits.append(rounds)
        return Visit([1.0])

    Race([SimpleNamespace(warm_up=lambda: 1.0, visit=visit)] * 2).go(2.0, limit=4.5)
    assert len(visits) == 5


# -- statistics of times and costs -------------------------------------------------------------------
def test_a_setting_that_costs_more_for_less_does_not_count():
    cost = statistics.costs_to_reach([1e-2, 1e-3, 1e-4], [1.0, 500.0, 10.0], [1e-3])
    assert cost == pytest.approx([10**0.5])
    # an accurate setting that is cheaper than all others
    assert statistics.costs_to_reach([1e-2, 1e-4], [500.0, 10.0], [1e-3]) == pytest.approx([10.0])


@pytest.mark.parametrize("true", [0.5, 1.0, 1.3, 2.0])
def test_a_ratio_is_found_in_noise_and_drift(true):
    """Pairs that share a drift and have heavy-tailed noise of their own."""
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(200):
        drift = np.exp(np.cumsum(rng.normal(0, 0.3, 15)))
        base, head = (drift * factor * np.exp(0.03 * rng.standard_t(3, 15)) for factor in (1.0, true))
        found = statistics.paired_ratio(base, head)
        assert found.low <= found.ratio <= found.high
        assert found.ratio == pytest.approx(true, rel=0.15)
        inside += found.low <= true <= found.high
    assert inside >= 0.9 * 200  # a percentile interval of a median of 15 covers about 95 %


# -- margins ---------------------------------------------------------------------------------------
def test_a_margin_is_of_both_cells_and_of_processes_and_has_a_floor():
    assert margin((1.0, 1.0), 1.0) == margin((1.1, 1.0), 1.1) == statistics.WIDEST == 1.25
    assert margin((1.3, 1.0), 1.0) == margin((1.0, 1 / 1.3), 1.0) == pytest.approx(1.3)
    assert margin((1.0, 1.0), 1.3) == pytest.approx(1.3)
    together = np.exp(np.linalg.norm(np.log([1.2, 1.2, 1.1])))
    assert margin((1.2, 1 / 1.2), 1.1) == pytest.approx(together)
    assert margin((1.0, math.nan), 1.0) == math.inf  # of a cell that was visited once nothing is known


@pytest.mark.parametrize(
    ("ratio", "within", "expected"),
    [
        (1.06, 1.05, Verdict.loss),
        (1 / 1.06, 1.05, Verdict.win),
        (1.04, 1.05, Verdict.tie),
        (1 / 1.04, 1.05, Verdict.tie),
        (1.04, 2 * statistics.WIDEST, Verdict.undecided),
        (46.0, 56.0, Verdict.undecided),
        (60.0, 56.0, Verdict.loss),
        (1e9, math.inf, Verdict.undecided),
    ],
)
def test_a_verdict_is_a_tie_only_where_the_clock_can_tell(ratio, within, expected):
    assert verdict(ratio, within) is expected


@pytest.mark.parametrize("ratio", [0.0, -1.0, math.nan])
def test_what_is_no_ratio_of_costs_is_refused(ratio):
    with pytest.raises(BadInput, match="must be a ratio of two costs"):
        verdict(ratio, 1.05)


@pytest.mark.parametrize(
    ("processes", "halves", "spread"),
    [
        ([1.0] * 94 + [1 / 1.05] * 2 + [3.0] * 4, [1.0] * 100, 1.05),  # what covers 95 of 100 cells
        ([math.nan, 1 / 1.5], [1.0, math.nan], 1.5),
        ([math.nan], [1.0], statistics.PROCESSES),
        ([1.02, 1.5, 1.4], [1.0, 1.3, 1 / 1.3], 1.02),  # noisy cells say nothing of processes
        ([1.2, 1.5], [1.1, 1.3], 1.5),  # where there are others
    ],
)
def test_processes_differ_by_what_covers_most_of_the_quiet_cells(processes, halves, spread):
    assert statistics.process_spread(processes, halves) == pytest.approx(spread)
