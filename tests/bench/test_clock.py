"""The timed part of an experiment: every cell visited, a sample in a second process too, each recorded at the end."""

from __future__ import annotations

from collections import Counter

import pytest

from clock import SAMPLE, Clock, Entry, Timetable
from contactbench.measure.clock import Part, Visit


class Scripted:
    """A call whose visits take so long, one after the other; `order` says when it was visited."""

    def __init__(self, name, order, *times):
        self.name, self.order, self.times = name, order, iter(times)

    def warm_up(self):
        return 1.0

    def visit(self, rounds=3):
        self.order.append(self.name)
        t = next(self.times)
        return Visit([2 * t, t, 3 * t], [t / 2] * 3)


def test_visits_are_spread_over_the_timed_part_and_a_cell_is_recorded_with_its_last():
    order, recorded, cells = [], {}, "abcdef"
    table = Timetable(dict.fromkeys(cells, ""), visits=8)

    def entry(name):
        again = Scripted(f"{name} again", order, *[3.0] * 8) if name == "a" else None
        part = Part(lambda: None, share=0.25, span=1.0)
        record = lambda columns: recorded.update({name: (columns, len(order))})  # noqa: E731
        return Entry(Scripted(name, order, *[4.0, 2.0] * 4), part, again, record)

    table.entries += map(entry, cells)
    table.go()
    size = len(cells) + 1
    sweeps = {tuple(order[k : k + size]) for k in range(0, len(order), size)}
    assert len(sweeps) == 8
    assert {tuple(sorted(sweep)) for sweep in sweeps} == {("a", "a again", *"bcdef")}
    for name, (columns, visited) in recorded.items():
        assert (columns["visits"], columns["rounds"]) == (8, 24)
        assert columns["time_min_s"] == 2.0
        assert columns["marginal_s"] == pytest.approx((2.0 - 1.0) / 0.75)
        assert columns.get("time_process_ratio") == (1.5 if name == "a" else None)
        assert visited > 7 * size


def test_a_sample_of_every_engines_cells_is_timed_in_a_second_process():
    cells = {k: "numba" if k % 10 else "c" for k in range(1000)} | {1000 + k: "llvm" for k in range(5)}
    sample = Timetable(cells, 8).sample
    assert Counter(cells[k] for k in sample) == {"numba": SAMPLE, "c": SAMPLE, "llvm": 3}
    assert Timetable(cells, 8).sample == sample


def test_another_process_prepares_and_times_what_it_is_told():
    """The C loop of the particle, timed in a process of its own."""
    from bench_work_precision import prepared_limit

    table = Timetable({}, 8)
    try:
        call = table.remote([], [], prepared_limit, ("particle", "contact-strang", 0.1))
        row = call.prepared.result()[1]
        assert row["status"] == "ok"
        assert row["solution_error"] < 0.1
        call.warm_up()
        visit = call.visit(2)
        assert len(visit.whole) == 2
        assert min(visit.whole) * visit.iterations > 1e-5
    finally:
        table.end()


def test_without_times_the_row_is_recorded_at_once_and_so_is_what_cannot_be_run():
    rows = []

    def record(table, row):
        rows.append((table, row))

    def refuse(cell):
        return {"status": "unsupported"}, None

    Clock(None, "cell", record, None).time("table", {"a": 1}, lambda: ({"b": 2}, print))
    Clock(Timetable({"cell": ""}, 8), "cell", record, None).time("table", {"a": 1}, refuse, "cell")
    assert rows == [("table", {"a": 1, "b": 2}), ("table", {"a": 1, "status": "unsupported"})]
