"""How often a run on a hard scene is repeated for its time."""

from __future__ import annotations

import pytest

import contactbench as cb
import stability_rows
from stability_rows import CALLS, QUICK, time_of


@pytest.mark.parametrize(
    ("method", "engine", "work", "calls"),
    [("rk4", "python", QUICK, 0), ("rk4", "numba", QUICK, 1), ("rk4", "python", QUICK / 2, CALLS)],
)
def test_a_long_run_in_python_is_timed_by_its_first_call(monkeypatch, method, engine, work, calls):
    run = cb.prepare("oscillator", method, engine=engine, step=0.1, save_at=[1.0])
    solution, count = run(), [0]

    def counted():
        count[0] += 1

    monkeypatch.setattr(stability_rows, "work", lambda solution: work)
    seconds = time_of(counted, solution, 7.0)
    assert count[0] == calls
    assert (seconds == 7.0) == (calls == 0)
