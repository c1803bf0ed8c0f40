"""Linear stability: limits against theory and against orbits, slow rates, numerical damping."""

from __future__ import annotations

import math

import numpy as np
import pytest

import contactbench as cb
from contactbench.measure.stability import (
    THEORY,
    fixed_step_methods,
    flow_matrix,
    oscillator,
    slow_rate,
    slow_rate_ratio,
    spectral_radius,
    stability_limit,
    step_matrix,
    true_radius,
)
from contactbench.scene import State

METHODS = fixed_step_methods()
every = pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)


@pytest.mark.parametrize("name", THEORY)
@pytest.mark.parametrize(("gamma", "omega"), [(0.0, 1.0), (0.1, 2.0), (1.0, 0.5), (10.0, 1.0), (50.0, 10.0)])
def test_limits_are_those_of_theory(name, gamma, omega):
    expected, found = THEORY[name](gamma, omega), stability_limit(cb.METHODS[name], gamma, omega)
    assert found == expected or found == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("gamma", [0.0, 0.1, 1.0, 10.0, 50.0])
def test_without_the_merged_flow_the_limit_is_two_at_every_damping(gamma):
    assert stability_limit(cb.METHODS["contact-abc"], gamma, 1.0) == pytest.approx(2.0, abs=1e-3)


def test_with_the_merged_flow_it_grows_like_twice_the_damping():
    assert stability_limit(cb.METHODS["contact-strang"], 50.0, 1.0) == pytest.approx(100.0, rel=1e-3)


def largest(method, gamma, h, steps):
    scene, x = oscillator(gamma), State((0.6,), (0.8,))
    worst = 0.0
    for _ in range(steps):
        x = method.advance(scene, x, h, 1, math)
        worst = max(worst, abs(x.q[0]), abs(x.p[0]))
        if worst > 1e12:
            break
    return worst


@every
@pytest.mark.parametrize("gamma", [0.0, 1.0, 10.0])
def test_orbits_are_bounded_below_the_limit_and_not_above(method, gamma):
    """The bisected limit is told by orbits alone: a per cent on either side."""
    limit = stability_limit(method, gamma, 1.0)
    if math.isinf(limit):
        assert largest(method, gamma, 50.0, 300) < 1e6
        return
    assert largest(method, gamma, 0.99 * limit, 1000) < 1e6
    # a window of instability may be narrower than a per cent: look right behind its border
    above = limit * np.array([1.0001, 1.001, 1.01])
    worst = above[int(np.argmax(spectral_radius(method, gamma, 1.0, above)))]
    steps = math.ceil(40 / math.log(spectral_radius(method, gamma, 1.0, worst)))
    assert largest(method, gamma, worst, min(steps, 60_000)) > 1e6


@every
def test_the_one_step_map_tends_to_the_flow(method):
    h = 1e-3
    for gamma in (0.0, 1.0, 5.0):
        gap = np.abs(step_matrix(method, gamma, 1.0, h) - flow_matrix(gamma, 1.0, h)).max()
        assert gap < 40 * h ** (method.order + 1) + 1e-15


@pytest.mark.parametrize("gamma", [0.0, 0.5, 1.0])
def test_contact_methods_damp_exactly_where_the_eigenvalues_are_complex(gamma):
    """Their determinant is e^{−γh}, so that a pair of complex eigenvalues has modulus e^{−γh/2}."""
    for method in METHODS:
        if method.contact:
            assert spectral_radius(method, gamma, 1.0, 0.3) == pytest.approx(
                true_radius(gamma, 1.0, 0.3), rel=1e-13
            )
    assert spectral_radius(cb.METHODS["rk4"], 0.0, 1.0, 0.3) < 1 - 1e-6  # numerical damping


@pytest.mark.parametrize(("damping", "expected"), [(1.0, 1.08), (5.0, 2.54), (25.0, 13.3)])
def test_splitting_force_and_friction_gets_the_creep_wrong(damping, expected):
    gamma, h = 50.0, damping / 50.0
    assert slow_rate_ratio(cb.METHODS["contact-abc"], gamma, h) == pytest.approx(expected, rel=0.01)
    assert slow_rate_ratio(cb.METHODS["contact-strang"], gamma, h) == pytest.approx(1.0, rel=0.01)


def test_the_slow_rate_is_the_one_orbits_show():
    from hard_cells import overdamped_row

    for name in ("contact-abc", "contact-strang"):
        row = overdamped_row(name, "step", 0.1, None)
        assert row["ratio"] == pytest.approx(slow_rate_ratio(cb.METHODS[name], 50.0, 0.1), rel=1e-9)
        assert row["true_rate"] == slow_rate(50.0)


def test_a_rate_is_read_off_an_oscillating_energy():
    from hard_cells import energy_rate

    t = np.arange(1, 1001) * 10.0
    energy = np.exp(-1e-5 * t) * (1 + 0.03 * np.cos(2.1 * t + 0.3))
    assert energy_rate(t, energy) == pytest.approx(1e-5, rel=1e-4)


@pytest.mark.parametrize("name", ["cvode-adams", "diffrax-dopri8", "contact-adaptive", "contact-strang"])
def test_weak_damping_is_measured_at_the_same_cost(name):
    from hard_cells import COST, weak_row

    row = weak_row("weak_damping", name, 1000.0)
    assert row["status"] == "ok"
    assert row["ratio"] == pytest.approx(1.0, abs=0.1)
    assert COST / 3 < row["evaluations"] / 1000.0 < COST * 3
