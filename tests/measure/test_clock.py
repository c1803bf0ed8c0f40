"""How calls are timed, with calls whose times are scripted: no test waits for a clock."""

import itertools
from collections import Counter
from types import SimpleNamespace

import pytest

from contactbench.measure import clock
from contactbench.measure.clock import ROUND_SECONDS, VISITS, Call, Part, Race, Visit, time_columns


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


def test_the_least_round_is_the_estimate_median_and_spread_stay_and_the_halves_are_odd_and_even_visits():
    columns = time_columns([Visit([3.0, 2.0, 4.0], iterations=7), Visit([6.0, 1.0, 5.0], iterations=9)])
    times = {"time_min_s": 1.0, "time_median_s": 3.5, "time_iqr_s": 2.5, "time_halves_ratio": 0.5}
    assert columns == times | {"visits": 2, "rounds": 6, "iterations": 9}
    assert time_columns([Visit([t]) for t in (4.0, 9.0, 9.0, 6.0)])["time_halves_ratio"] == 1.5
    assert "time_halves_ratio" not in time_columns([Visit([1.0])])


def test_fixed_and_marginal_cost_are_those_of_the_line_through_the_least_rounds():
    part = Part(lambda: None, share=0.2, span=40.0)

    def visit(drift):
        return Visit([drift * (3e-6 + 2e-7 * 40)], [(3 - drift) * (3e-6 + 2e-7 * 8)])  # slow in turns

    columns = clock.length_columns([visit(d) for d in (1.0, 1.0, 2.0, 2.0)], part)
    assert columns["fixed_s"] == pytest.approx(3e-6)
    assert columns["marginal_s"] == pytest.approx(2e-7)
    assert columns["marginal_halves_ratio"] == pytest.approx(1.0)
    no_time = [Visit([2.0], [1.0]), Visit([2.0], [3.0])]  # one half of the visits says less than none
    assert "marginal_halves_ratio" not in clock.length_columns(no_time, part)


def test_a_second_process_is_compared_by_its_least_round():
    part = Part(lambda: None, share=0.5, span=1.0)
    first, second = [Visit([4.0], [1.0]), Visit([2.0], [1.5])], [Visit([9.0], [2.0]), Visit([3.0], [7.0])]
    columns = clock.process_columns(first, second, part)
    assert columns == {"time_process_ratio": 1.5, "marginal_process_ratio": 1.0}
    assert clock.process_columns(first, second) == {"time_process_ratio": 1.5}


def test_a_round_takes_as_long_as_it_should_however_slow_the_first_calls_were(machine):
    durations = [10 * ROUND_SECONDS] * 2 + [ROUND_SECONDS / 10] * 500
    call = Call(machine(*durations))
    call.warm_up()
    assert call.visit().iterations == 1  # as the warm-up had it
    assert call.visit().iterations in (10, 11)  # the clock's own rounding
    part = Part(machine(ROUND_SECONDS / 100), share=0.1, span=1.0)
    both = Call(machine(ROUND_SECONDS / 10), part)
    both.warm_up()
    visit = both.visit(2)
    assert len(visit.whole) == len(visit.part) == 2
    assert visit.part == pytest.approx([ROUND_SECONDS / 100] * 2)


def test_a_long_call_has_one_round_a_visit_and_one_to_warm_up(machine):
    calls = Counter()
    slow = machine(2 * clock.LONG)
    call = Call(lambda: (calls.update(["run"]), slow()))
    call.warm_up()
    assert len(call.visit().whole) == 1
    assert calls["run"] == 2


def test_a_call_without_its_part_is_as_warm(machine):
    call = Call(machine(2 * clock.LONG), Part(machine(clock.LONG), share=0.5, span=1.0))
    call.warm_up()
    whole, before = call.without_part(), machine.now[0]
    assert whole.warm_up() == pytest.approx(2 * clock.LONG)
    assert machine.now[0] == before
    assert whole.visit().part == ()


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
