"""How often a run on a hard scene is repeated for its time; the overdamped oscillator at a large step."""

from __future__ import annotations

import math

import pytest

import contactbench as cb
from bench_stability import overdamped_row


def test_the_last_kick_leaves_the_overdamped_momentum_too_large():
    """By (γh/2) coth(γh/2), docs/mathematics.md; the rate, and q, are right all the same."""
    half = cb.SCENES["overdamped"].gamma * 0.5 / 2
    row = overdamped_row("contact-strang", "step", 0.5, None)
    assert row["rate_error"] < 0.005
    assert row["q_error"] < 0.02
    assert row["p_error"] == pytest.approx(half / math.tanh(half) - 1, rel=0.02)
    fine = overdamped_row("cyrk-radau", "rtol", 1e-9, None)
    assert max(fine["q_error"], fine["p_error"]) < 1e-6
