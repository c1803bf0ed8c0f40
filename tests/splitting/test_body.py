"""The rigid body's parts on hard data: what they solve exactly, and what they keep whatever the data."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest

import contactbench as cb

BODY = cb.SCENES["rigid_body"]
UNDAMPED = BODY.with_(name="undamped", gamma=0.0)
UNDERFLOW = BODY.with_(name="underflow", gamma=50.0, t_end=100.0)
HARD = [
    BODY.with_(name="tumbling", M=(1e-8, 1.0, 1e-8), gamma=1e-3, t_end=200.0),
    BODY.with_(name="needle", inertia=(1e-3, 1.0, 1.001)),
    UNDAMPED,
    UNDERFLOW,
]
#: A on a body is the free body itself
EXACT_DRIFT = ["contact-printed", "contact-abc"]
#: A on a body is split once more
SPLIT = ["contact-strang", "contact-bm4", "contact-bm6", "contact-rkn4", "contact-o8"]
every = pytest.mark.parametrize("method", [*EXACT_DRIFT, *SPLIT])


SYMMETRIC = [BODY.with_(inertia=inertia) for inertia in ((2, 2, 2), (1, 2, 2), (2, 1, 1), (2, 3, 2))]


@pytest.mark.parametrize(
    ("method", "scene"), [*product(SPLIT, SYMMETRIC), *((method, UNDAMPED) for method in EXACT_DRIFT)]
)
def test_a_body_is_solved_exactly_at_any_step_by_the_one_part_it_has(method, scene):
    """Of a symmetric body one part of A is zero; without damping the printed schemes are A alone."""
    solution = cb.solve(scene, method, step=5.0, save_at=[5.0, 10.0, 20.0], engine="python")
    assert cb.LAWS["solution_error"](solution) < 1e-13


@every
@pytest.mark.parametrize("scene", HARD, ids=lambda scene: scene.name)
def test_momentum_attitude_and_contact_form_are_kept_on_hard_data(method, scene):
    """Round-off of the contact form grows with the derivative of the map: 10⁶ tumbling, 10³ for the needle."""
    solution = cb.solve(scene, method, step=scene.t_end / 100, save_at=[scene.t_end / 2, scene.t_end])
    assert solution.ok
    assert cb.LAWS["momentum_law"](solution) < 1e-13
    assert cb.LAWS["attitude_drift"](solution) < 1e-13
    growth = np.linalg.norm(solution.sensitivity, axis=(1, 2)).max()
    assert cb.LAWS["contact_drift"](solution) < 1e-13 * max(growth, 1)


@pytest.mark.parametrize("inertia", list(permutations((1.0, 2.0, 3.0))), ids=str)
def test_the_axes_may_come_in_any_order(inertia):
    """Renaming the axes of body and data renames the solution, with the sign of an odd permutation."""
    order = [(1.0, 2.0, 3.0).index(i) for i in inertia]
    sign = round(np.linalg.det(np.eye(3)[order]))
    other = BODY.with_(inertia=inertia, M=sign * np.array(BODY.M)[order])
    plain, renamed = (
        cb.solve(scene, "contact-bm6", step=0.5, save_at=[20.0], engine="python") for scene in (BODY, other)
    )
    np.testing.assert_allclose(renamed.M, sign * plain.M[:, order], rtol=0, atol=1e-14)
    np.testing.assert_allclose(renamed.R, plain.R[:, order][:, :, order], rtol=0, atol=1e-13)


@every
def test_a_body_at_rest_stays_and_has_a_derivative(method):
    solution = cb.solve(BODY.with_(M=(0.0, 0.0, 0.0)), method, step=0.5, save_at=[1.0, 2.0])
    np.testing.assert_array_equal(solution.M, 0)
    np.testing.assert_allclose(solution.R, [np.eye(3)] * 2, rtol=0, atol=1e-15)
    assert np.isfinite(solution.sensitivity).all()


@pytest.mark.parametrize("method", EXACT_DRIFT)
@pytest.mark.parametrize("M", [(1, 0, 0), (0, 1, 0), (0, 0, 2), (1, 1, 0), (1, 0, 1)], ids=str)
@pytest.mark.parametrize("engine", ["numba", "jax"])
@pytest.mark.quick(engine="numba")
def test_the_closed_form_has_a_derivative_on_the_axes_and_between_two(method, M, engine):
    solution = cb.solve(BODY.with_(M=M), method, step=0.5, save_at=[1.0], engine=engine)
    assert cb.LAWS["contact_drift"](solution) < 1e-13


@pytest.mark.parametrize("engine", ["jax", "python"])
@pytest.mark.quick(engine="python")
def test_a_step_as_long_as_the_decay_is_no_trouble(engine):
    """e^{−γh} underflows within one step; negative substeps would grow by e^{+γ|a|h} if they met damping."""
    scene = UNDERFLOW.with_(M=(0.1, 0.2, 0.3))
    solution = cb.solve(scene, "contact-o8", step=50.0, save_at=[50.0, 100.0], engine=engine)
    assert cb.LAWS["solution_error"](solution) < 1e-12


@pytest.mark.parametrize("method", EXACT_DRIFT)
@pytest.mark.parametrize("engine", ["numba", "python"])
def test_the_printed_scheme_on_a_body_is_exact_but_for_its_clock(method, engine):
    """A_τ and C commute up to the clock of A: M and R are those of the true body at a time of its own.

    Printed, right to left, C comes before A: n steps run the free body for h (e^{−γh} + e^{−2γh} + …); the
    palindrome has half a step before and half after each C.
    """
    h, n = 0.4, 50
    solution = cb.solve(BODY, method, step=h, save_at=[h * n], engine=engine)
    ticks = np.exp(-BODY.gamma * h * np.arange(n + 1))
    weights = {"contact-printed": [0.0] + [1.0] * n, "contact-abc": [0.5] + [1.0] * (n - 1) + [0.5]}
    clock = h * np.dot(weights[method], ticks)
    free_time = -np.log1p(-BODY.gamma * clock) / BODY.gamma  # φ(t) = clock
    exact = cb.solve(BODY, "contact-exact", save_at=[free_time], engine=engine)
    grown = np.exp(BODY.gamma * np.array([h * n, free_time]))
    np.testing.assert_allclose(grown[0] * solution.M, grown[1] * exact.M, rtol=0, atol=1e-13)
    np.testing.assert_allclose(solution.R, exact.R, rtol=0, atol=1e-13)
    assert abs(free_time - h * n) > 1e-3
