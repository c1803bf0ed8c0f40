"""The overdamped oscillator at large steps: which compositions have the slow rate right, and which the momentum too."""

from __future__ import annotations

import math

import numpy as np
import pytest

import contactbench as cb

GAMMA, H = 50.0, 0.5
SLOW = GAMMA / 2 - math.sqrt(GAMMA**2 / 4 - 1)
TOO_LARGE = (GAMMA * H / 2) / math.tanh(GAMMA * H / 2)


def A(h):
    return np.array([[1.0, h], [0.0, 1.0]])


def B(h):
    return np.array([[1.0, 0.0], [-h, 1.0]])


def C(h):
    return np.diag([1.0, math.exp(-GAMMA * h)])


def worth(h):
    return -math.expm1(-GAMMA * h) / GAMMA


def AC(h):
    return np.array([[1.0, worth(h)], [0.0, math.exp(-GAMMA * h)]])


def BC(h):
    """The kick, damped while it lasts: the joint flow of V + γs."""
    return np.array([[1.0, 0.0], [-worth(h), math.exp(-GAMMA * h)]])


def slow_mode(step):
    """Rate, and p/q, of the slow mode of a step, over those of the motion."""
    values, vectors = np.linalg.eig(step)
    slow = np.argmax(np.abs(values))
    q, p = vectors[:, slow].real
    return -math.log(abs(values[slow])) / H / SLOW, p / q / -SLOW


@pytest.mark.parametrize(
    ("parts", "rate", "momentum"),
    [
        ((B, AC, B), 1.0, TOO_LARGE),
        ((AC, B, AC), 1.0, 0.0),
        ((B, A, C, A, B), TOO_LARGE, TOO_LARGE),
        ((A, C, B, C, A), 0.0, 0.0),
        ((B, C, A, C, B), 0.0, TOO_LARGE),
        ((A, BC, A), 1.0, 1.0),
        ((BC, A, BC), 1.0, 1.0),
    ],
    ids=lambda parts: "-".join(f.__name__ for f in parts) if isinstance(parts, tuple) else None,
)
def test_only_a_damped_kick_has_both_right(parts, rate, momentum):
    middle = len(parts) // 2
    step = np.eye(2)
    for i, part in enumerate(parts):
        step = part(H if i == middle else H / 2) @ step
    assert slow_mode(step) == (
        pytest.approx(rate, rel=0.07, abs=1e-3),
        pytest.approx(momentum, rel=0.005, abs=1e-3),
    )


def test_table_has_the_momentum_beside_the_rate():
    from stability_rows import overdamped_row

    row = overdamped_row("contact-strang", "step", H, None)
    assert row["rate_error"] < 0.005
    assert row["q_error"] < 0.02
    assert row["p_error"] == pytest.approx(TOO_LARGE - 1, rel=0.02)
    fine = overdamped_row("cyrk-radau", "rtol", 1e-9, None)
    assert max(fine["q_error"], fine["p_error"]) < 1e-6
    assert cb.SCENES["overdamped"].gamma == GAMMA
