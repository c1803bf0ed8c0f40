"""Ladders of tolerances: they end where a library's range ends, or earlier where the error stops falling."""

from __future__ import annotations

import math

import pytest

import contactbench as cb
from contactbench.measure.ladder import carry_of, tolerances, work_ladder
from contactbench.race.comparison import Attempt, Question, Scout, ends

PEERS = [m for m in cb.METHODS.values() if m.adaptive and m.family == "established"]


@pytest.mark.parametrize("method", PEERS, ids=lambda m: m.name)
def test_the_last_rung_is_the_end_of_the_range(method):
    values = tolerances(method)
    assert values[-1] == method.rtol_range[0] <= 1e-13
    assert values == sorted(set(values), reverse=True)
    assert {1e-3, 1e-6, 1e-13} <= {float(f"{v:.3g}") for v in values}


def test_a_ladder_ends_where_the_error_stops_falling(monkeypatch):
    """At 10⁻¹² and 10⁻¹³ the error is 3·10⁻¹³: one rung that brings nothing is tried, and no more."""

    def attempt(scout, value):
        scout.attempts.append(Attempt(value, "", cb.Status.ok, "", 0.0, max(value, 3e-13)))
        return scout.attempts[-1]

    monkeypatch.setattr(Scout, "attempt", attempt)
    scene = cb.SCENES["oscillator"]
    question = Question(scene, cb.reference(scene, ends(scene), carry_of(scene)), (1e-300,), 60.0)
    tried = list(Scout(question, "heyoka-taylor").ladder())
    assert tried[-1].value == pytest.approx(1e-14)
    assert all(math.isfinite(attempt.error) for attempt in tried)


def test_ladders_halve_from_four_on_a_body_and_go_by_roots_of_two_from_order_six_on():
    """The latter by multiples of five steps near 6.25 · 2^(k/2)."""
    body, particle = cb.SCENES["rigid_body"], cb.SCENES["particle"]
    assert work_ladder(body, 2) == pytest.approx([4.0, 2.0, *(0.8 / 2**k for k in range(9))])
    assert work_ladder(particle, 2) == pytest.approx([0.8 / 2**k for k in range(9)])
    counts = [particle.t_end / step for step in work_ladder(particle, 6)]
    assert counts == pytest.approx([5, 10, 20, 25, 35, 50, 70, 100, 140, 200])
