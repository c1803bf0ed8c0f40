"""How calls are timed, with calls whose times are scripted: no test waits for a clock."""

import itertools
from collections import Counter
from types import SimpleNamespace

import pytest

from contactbench.measure import clock
from contactbench.measure.clock import ROUND_SECONDS, VISITS, Call, Race, Visit, ratio_column, time_columns


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
