"""Linear stability: limits against theory and against orbits, slow rates, numerical damping."""

import math

import numpy as np
import pytest

import contactbench as cb
from contactbench.measure import stability as linear
from contactbench.runs.limits import creep_rows, weak_row
from contactbench.scene import State

METHODS = [linear.kernel(method) for method in linear.fixed_step_methods()]


@pytest.mark.parametrize("name", linear.THEORY)
@pytest.mark.parametrize(("gamma", "omega"), [(0.0, 1.0), (0.1, 2.0), (1.0, 0.5), (10.0, 1.0), (50.0, 10.0)])
def test_limits_are_those_of_theory(name, gamma, omega):
    expected = linear.THEORY[name](gamma, omega)
    found = linear.stability(cb.METHODS[name], gamma, omega).limit
    assert found == expected or found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "limit"),
    [("contact-bm6", 3.134), ("contact-rkn4", 3.163), ("contact-rkn6", 3.1414), ("contact-rkn8", 3.1406)],
)
def test_the_first_loss_without_damping_is_a_narrow_window_next_to_half_a_period(name, limit):
    found = linear.stability(linear.kernel(cb.METHODS[name]), 0.0, 1.0)
    assert found.limit == pytest.approx(limit, rel=3e-4)
    start, end = found.windows[0]
    assert start == found.limit
    assert end - start < 0.02
    assert found.last > 5.0


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
@pytest.mark.quick(method=[m for m in METHODS if not m.iterates])
def test_windows_at_random_damping_are_those_of_long_runs(method):
    """2³⁰ steps by squaring the matrix, at random steps up to the last border and none of them next to one."""
    rng = np.random.default_rng(5)
    judged = 0
    for gamma in 10 ** rng.uniform(-2, 1.3, 12):
        found = linear.stability(method, gamma, 1.0)
        borders = np.array([found.limit, *np.ravel(found.windows), found.last])
        reach = found.last if math.isfinite(found.last) else 1.5 * max(found.limit, 10.0)
        middles = np.mean(found.windows or [[1e-2]], axis=1)
        steps = np.append(rng.uniform(0.02, min(reach, 300.0), 15), middles)
        for h in steps[np.abs(borders[:, None] / steps - 1).min(axis=0) > 1e-3]:
            inside = any(start < h < end for start, end in found.windows)
            with np.errstate(all="ignore"):
                power = np.linalg.matrix_power(linear.step_matrix(method, gamma, 1.0, h), 2**30)
            assert (np.abs(power).max() < 1e6) is not inside, (gamma, h)
            judged += 1
    assert judged > 60


def test_a_processed_method_is_repeated_by_its_kernel_or_as_a_whole():
    method = cb.METHODS["contact-rkn8"]
    assert [m.name for m in linear.fixed_step_methods() if linear.is_processed(m)] == ["contact-rkn8"]
    at_the_end, at_every_step = (
        linear.stability(m, 10.0, 1.0).limit for m in (linear.kernel(method), method)
    )
    assert (at_the_end, at_every_step) == pytest.approx((2.8435, 2.3295), abs=1e-4)
    h, scene = (at_the_end + at_every_step) / 2, linear.oscillator(10.0)
    often, seldom = (
        cb.solve(scene, method.name, step=h, engine="python", save_at=times, carry=())
        for times in (h * np.arange(1, 401), [40 * h, 400 * h])
    )
    assert seldom.ok  # an unbounded orbit has grown 10⁶ times by then
    assert often.status is cb.Status.diverged


@pytest.mark.parametrize(("name", "order"), [("contact-strang", 2), ("rk4", 4), ("contact-rkn8", 8)])
def test_the_error_of_a_whole_run_falls_with_the_order_of_the_method(name, order):
    coarse, fine = (linear.propagation_error(cb.METHODS[name], 1.0, h) for h in (0.5, 0.25))
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.4)


@pytest.mark.parametrize(
    ("name", "expected"), [("contact-abc", (1.08, 2.54, 13.3)), ("contact-strang", (1, 1, 1))]
)
def test_splitting_force_and_friction_gets_the_creep_wrong(name, expected):
    rows = list(creep_rows(cb.METHODS[name]))
    assert [row["setting"] * row["gamma"] for row in rows] == pytest.approx([1.0, 5.0, 25.0])
    assert {row["true"] for row in rows} == {linear.slow_rate(50.0)}
    assert [row["measured"] / row["true"] for row in rows] == pytest.approx(expected, rel=0.01)


def test_the_last_kick_leaves_the_overdamped_momentum_too_large():
    """By (γh/2) coth(γh/2), docs/mathematics.md; the rate, and q, are right all the same."""
    scene = cb.SCENES["overdamped"]
    half, truth = scene.gamma * 0.5 / 2, cb.reference(scene, [scene.t_end], ()).y[-1]
    coarse, fine = (
        np.abs(cb.solve(scene, name, save_at=[scene.t_end], carry=(), **setting).y[-1] / truth - 1)
        for name, setting in (("contact-strang", {"step": 0.5}), ("cyrk-radau", {"rtol": 1e-9}))
    )
    assert coarse[0] < 0.02
    assert coarse[1] == pytest.approx(half / math.tanh(half) - 1, rel=0.02)
    assert fine.max() < 1e-6


@pytest.mark.parametrize("gamma", [0.0, 0.5, 1.0])
def test_contact_methods_damp_exactly_where_the_eigenvalues_are_complex(gamma):
    """Their determinant is e^{−γh}, so that a pair of complex eigenvalues has modulus e^{−γh/2}."""
    found = [linear.spectral_radius(method, gamma, 1.0, 0.3) for method in METHODS if method.contact]
    assert found == pytest.approx([linear.true_radius(gamma, 1.0, 0.3)] * len(found), rel=1e-13)
    assert linear.spectral_radius(cb.METHODS["rk4"], 0.0, 1.0, 0.3) < 1 - 1e-6  # numerical damping


@pytest.mark.parametrize(("name", "least", "most"), [("contact-linear2", 0.0, 1e-12), ("rk8-7", 1e-2, 1.0)])
def test_a_method_that_solves_the_oscillator_exactly_has_no_error_of_its_rate(name, least, most):
    """Beside one that chooses its steps, at the same cost."""
    row = weak_row(cb.METHODS[name], 1e4)
    assert row["status"] == "ok"
    assert row["true"] == pytest.approx(1e-5, rel=1e-4)
    assert row["evaluations"] == pytest.approx(80_000, rel=0.05)
    assert least <= row["error"] <= most


@pytest.mark.parametrize("n", [1, 2, 7])
@pytest.mark.parametrize("method", linear.fixed_step_methods(), ids=lambda m: m.name)
def test_the_matrix_of_a_run_is_the_run(method, n):
    x = method.advance(linear.oscillator(0.5), State((0.6,), (0.8,)), 0.3, n, math)
    np.testing.assert_allclose(linear.run_matrix(method, 0.5, 0.3, n) @ (0.6, 0.8), [*x.q, *x.p], rtol=1e-12)
