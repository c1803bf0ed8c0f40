"""How often a run on a hard scene is repeated for its time; the overdamped oscillator at a large step."""

from __future__ import annotations

import math

import pytest

import contactbench as cb
import stability_rows
from stability_rows import CALLS, QUICK, overdamped_row, time_of


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


def test_the_last_kick_leaves_the_overdamped_momentum_too_large():
    """By (γh/2) coth(γh/2), docs/mathematics.md; the rate, and q, are right all the same."""
    half = cb.SCENES["overdamped"].gamma * 0.5 / 2
    row = overdamped_row("contact-strang", "step", 0.5, None)
    assert row["rate_error"] < 0.005
    assert row["q_error"] < 0.02
    assert row["p_error"] == pytest.approx(half / math.tanh(half) - 1, rel=0.02)
    fine = overdamped_row("cyrk-radau", "rtol", 1e-9, None)
    assert max(fine["q_error"], fine["p_error"]) < 1e-6
