"""Linear stability: limits against theory and against orbits, slow rates, numerical damping."""

from __future__ import annotations

import math

import numpy as np
import pytest

import contactbench as cb
from contactbench.measure.stability import (
    THEORY,
    eigenvalues,
    fixed_step_methods,
    flow_matrix,
    is_processed,
    kernel,
    oscillator,
    propagation_error,
    run_matrix,
    slow_rate,
    spectral_radius,
    stability,
    step_matrix,
    true_radius,
    turning_points,
)
from contactbench.scene import State

METHODS = [kernel(method) for method in fixed_step_methods()]
every = pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
as_a_whole = pytest.mark.parametrize("method", fixed_step_methods(), ids=lambda m: m.name)


@pytest.mark.parametrize("name", THEORY)
@pytest.mark.parametrize(("gamma", "omega"), [(0.0, 1.0), (0.1, 2.0), (1.0, 0.5), (10.0, 1.0), (50.0, 10.0)])
def test_limits_are_those_of_theory(name, gamma, omega):
    expected, found = THEORY[name](gamma, omega), stability(cb.METHODS[name], gamma, omega).limit
    assert found == expected or found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("gamma", "limit"), [(499.8, 999.6), (500.2, math.inf)])
def test_limits_are_looked_for_up_to_a_thousand(gamma, limit):
    assert stability(cb.METHODS["contact-strang"], gamma, 1.0).limit == pytest.approx(limit, rel=1e-9)


def test_neighbouring_points_of_the_grid_may_each_have_an_extremum():
    grid = np.arange(5.0)
    found = turning_points(lambda h: -np.cos(np.pi * h), grid, np.array([-1.0, 1.0, -1.0, 1.0, -1.0]))
    np.testing.assert_allclose(found, [1.0, 2.0, 3.0], atol=1e-6)


def largest(method, gamma, h, steps, at_once=50):
    """The largest |q| or |p| met when one looks every so many steps."""
    scene, x = oscillator(gamma), State((0.6,), (0.8,))
    worst = 0.0
    for _ in range(-(-steps // at_once)):
        x = method.advance(scene, x, h, at_once, math)
        worst = max(worst, abs(x.q[0]), abs(x.p[0]))
        if worst > 1e12:
            break
    return worst


@every
@pytest.mark.parametrize("gamma", [0.0, 1.0, 10.0])
@pytest.mark.quick(gamma=1.0)
def test_orbits_are_bounded_below_the_limit_and_not_above(method, gamma):
    """The limit is told by orbits alone: a per mille below, and behind it, where a window may be narrow."""
    found = stability(method, gamma, 1.0)
    limit = found.limit
    if math.isinf(limit):
        assert largest(method, gamma, 50.0, 300) < 1e6
    else:
        assert largest(method, gamma, 0.999 * limit, 1000) < 1e6
        worst = sum(found.windows[0]) / 2 if found.windows else 1.01 * limit
        steps = math.ceil(40 / math.log(spectral_radius(method, gamma, 1.0, worst)))
        assert largest(method, gamma, worst, min(steps, 60_000)) > 1e6


@pytest.mark.parametrize(
    ("name", "limit"),
    [("contact-bm6", 3.134), ("contact-rkn4", 3.163), ("contact-rkn6", 3.1414), ("contact-rkn8", 3.1406)],
)
def test_the_first_loss_without_damping_is_a_narrow_window_next_to_half_a_period(name, limit):
    found = stability(kernel(cb.METHODS[name]), 0.0, 1.0)
    assert found.limit == pytest.approx(limit, rel=3e-4)
    start, end = found.windows[0]
    assert start == found.limit
    assert end - start < 0.02
    assert found.last > 5.0


@every
def test_windows_at_random_damping_are_those_of_long_runs(method):
    """2³⁰ steps by squaring the matrix, at random steps none of which is next to a border."""
    rng = np.random.default_rng(5)
    verdicts = []
    for gamma in 10 ** rng.uniform(-2, 1.3, 12):
        found = stability(method, gamma, 1.0)
        borders = np.array([found.limit, *np.ravel(found.windows), found.last])
        reach = 1.5 * found.last if math.isfinite(found.last) else 1.5 * max(found.limit, 10.0)
        candidates = np.append(
            rng.uniform(0.02, min(reach, 300.0), 15), np.mean(found.windows or [[1e-2]], axis=1)
        )
        for h in candidates:
            if np.abs(borders / h - 1).min() < 1e-3:
                continue
            inside = any(start < h < end for start, end in found.windows)
            if h > found.last:
                continue  # islands are left out there
            with np.errstate(all="ignore"):
                power = step_matrix(method, gamma, 1.0, h)
                for _ in range(30):
                    power = power @ power
            verdicts.append(inside)
            assert (np.abs(power).max() < 1e6) is not inside, (gamma, h)
    assert len(verdicts) > 60


def test_a_processed_method_is_repeated_by_its_kernel_or_as_a_whole():
    method = cb.METHODS["contact-rkn8"]
    assert [m.name for m in fixed_step_methods() if is_processed(m)] == ["contact-rkn8"]
    at_the_end, at_every_step = (stability(m, 10.0, 1.0).limit for m in (kernel(method), method))
    assert at_the_end == pytest.approx(2.8435, abs=1e-4)
    assert at_every_step == pytest.approx(2.3295, abs=1e-4)
    h, scene = (at_the_end + at_every_step) / 2, oscillator(10.0)
    ends = [40 * h, 400 * h]
    run = cb.solve(scene, method.name, step=h, engine="python", save_at=ends, carry=())
    assert run.ok  # an unbounded orbit has grown 10⁶ times by then
    saved = cb.solve(scene, method.name, step=h, engine="python", save_at=h * np.arange(1, 401), carry=())
    assert saved.status is cb.Status.diverged
    for n in (1, 2, 7):
        x = method.advance(oscillator(0.5), State((0.6,), (0.8,)), 0.3, n, math)
        np.testing.assert_allclose(
            run_matrix(method, 0.5, 1.0, 0.3, n) @ (0.6, 0.8), [*x.q, *x.p], rtol=1e-12
        )
    assert propagation_error(method, 1.0, 1.0) != propagation_error(method, 1.0, 1.0, every_step=True)


@as_a_whole
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


def slow_rate_ratio(method, gamma, h):
    """The decay rate of the slow mode under a method, over the true one; nan where there is none.

    The slow mode is the eigenvalue nearest to the true e^{−λh}; a negative or complex one alternates or
    oscillates, and has no rate of creep.
    """
    exact = true_radius(gamma, 1.0, h)
    slow = min(eigenvalues(step_matrix(method, gamma, 1.0, h)), key=lambda value: abs(complex(value) - exact))
    if abs(slow.imag) > 1e-12 or slow.real <= 0:
        return math.nan
    return -math.log(slow.real) / h / slow_rate(gamma)


@pytest.mark.parametrize(("damping", "expected"), [(1.0, 1.08), (5.0, 2.54), (25.0, 13.3)])
def test_splitting_force_and_friction_gets_the_creep_wrong(damping, expected):
    gamma, h = 50.0, damping / 50.0
    assert slow_rate_ratio(cb.METHODS["contact-abc"], gamma, h) == pytest.approx(expected, rel=0.01)
    assert slow_rate_ratio(cb.METHODS["contact-strang"], gamma, h) == pytest.approx(1.0, rel=0.01)


def test_the_slow_rate_is_the_one_orbits_show():
    from stability_rows import overdamped_row

    for name in ("contact-abc", "contact-strang"):
        row = overdamped_row(name, "step", 0.1, None)
        assert row["ratio"] == pytest.approx(slow_rate_ratio(cb.METHODS[name], 50.0, 0.1), rel=1e-9)
        assert row["true_rate"] == slow_rate(50.0)


@pytest.mark.parametrize(
    ("name", "off"),
    [
        ("cvode-adams", 0.3),
        ("contact-adaptive", 1e-4),
        ("contact-strang", 1e-4),
        pytest.param("diffrax-dopri8", 0.3, marks=pytest.mark.slow),
    ],
)
def test_weak_damping_is_measured_at_the_same_cost(name, off):
    """At eight evaluations a unit of time the dissipation of a peer is a good part of the true one."""
    from stability_rows import COST, weak_row

    row = weak_row("weak_damping", name, 1000.0)
    assert row["status"] == "ok"
    assert row["ratio"] == pytest.approx(1.0, abs=off)
    assert row["evaluations"] / 1000.0 == pytest.approx(COST, rel=0.1)


@pytest.mark.parametrize("t_end", [1e4, 1e5])
def test_the_exact_solution_has_no_error_of_its_rate(t_end):
    """A method that returns the truth, through all that a method goes through."""
    from planted import plant_truth
    from stability_rows import weak_row

    with plant_truth() as name:
        row = weak_row("weak_damping", name, t_end)
    assert row["status"] == "ok"
    assert row["true_rate"] == pytest.approx(1e-5, rel=1e-4)
    assert row["rate_error"] <= 1e-12


def test_the_truth_between_frozen_times_is_that_of_one_long_run():
    from stability_rows import SAMPLES, against_truth

    scene = cb.SCENES["weak_damping_particle"]
    times = scene.t_end * np.arange(1, SAMPLES + 1) / SAMPLES
    run = cb.solve(scene, "heyoka-taylor", rtol=2.3e-16, save_at=times, carry=())
    assert against_truth(scene, times, run.states())["rate_error"] < 1e-11
