"""The derivative of every numerical map, and the contact drift computed from it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import contactbench as cb
from cases import TILTED, USER

SCENES = ("particle", "rigid_body")
VARIATIONAL = (
    "scipy-dop853", "scipy-radau", "cvode-adams", "cvode-bdf", "cyrk-dop853", "cyrk-vern8", "cyrk-tsit5",
    "cyrk-lsoda", "cyrk-radau", "heyoka-taylor",
)  # fmt: skip
RTOLS = (1e-4, 1e-6, 1e-8, 1e-10)
#: contact drift over rtol, at most: what a tolerance per step grows to over the run (T = 20; the
#: worst seen is 370, cvode-bdf at 1e-10), with a factor 10 in hand
GROWTH = 5e3
#: derivatives of two methods at tight tolerance agree to the growth of rtol = 1e-11
AGREE = 1e-7


def saved(scene, count=5):
    return scene.t_end * np.arange(1, count + 1) / count


@pytest.mark.parametrize("method", VARIATIONAL)
@pytest.mark.parametrize("name", SCENES)
def test_contact_drift_falls_with_the_tolerance(name, method):
    scene = cb.SCENES[name]
    drifts = []
    for rtol in RTOLS:
        solution = cb.solve(scene, method, rtol=rtol, save_at=saved(scene))
        assert "variational" in solution.sensitivity_source
        drifts.append(cb.LAWS["contact_drift"](solution))
    for rtol, drift in zip(RTOLS, drifts, strict=True):
        assert 0 < drift < GROWTH * rtol
    for coarse, fine in pairwise(drifts):
        assert fine < coarse / 5  # two decades of tolerance


@pytest.fixture(scope="module")
def independent():
    """(states, derivative) by forward AD through the compiled fourth-order loop at a small step."""

    def compute(scene):
        solution = cb.solve(scene, "rk4", step=scene.t_end / 8000, save_at=saved(scene))
        assert "AD" in solution.sensitivity_source
        return solution.y, solution.sensitivity

    return compute


SHORT = {name: cb.SCENES[name].with_(t_end=5.0) for name in SCENES} | {
    "no Hessian": USER,  # Df by AD of the right-hand side
    "quadratic damping": cb.SCENES["central"].with_(gamma=0.05, kappa=0.5, s=0.6, t_end=5.0),
    "full matrix D": TILTED.with_(t_end=5.0),
}


@pytest.mark.parametrize("case", list(SHORT))
def test_all_derivatives_agree_at_tight_tolerance(case, independent):
    """AD through RK4, AD through diffrax, and the variational equations of five solvers."""
    scene = SHORT[case]
    y, expected = independent(scene)
    assert expected.shape == (5, y.shape[1], len(scene.tangents(scene.initial(scene.optional))))
    for method in (*VARIATIONAL, "diffrax-dopri8"):
        solution = cb.solve(scene, method, rtol=1e-11, save_at=saved(scene))
        states, derivative = solution.linearised
        size = np.abs(expected).max()
        np.testing.assert_allclose(states, y, rtol=0, atol=AGREE, err_msg=method)
        np.testing.assert_allclose(derivative, expected, rtol=0, atol=AGREE * size, err_msg=method)


@pytest.mark.parametrize("method", ["rk4", "contact-strang", "contact-bm4"])
@pytest.mark.parametrize("name", SCENES)
def test_all_engines_give_the_same_derivative(name, method):
    """By dual numbers in a compiled loop, and by JAX's forward mode."""
    scene = cb.SCENES[name].with_(t_end=2.0)
    numba, jax, python = (
        cb.solve(scene, method, step=0.1, engine=engine, save_at=[0.0, 1.0, 2.0])
        for engine in ("numba", "jax", "python")
    )
    np.testing.assert_array_equal(python.sensitivity, numba.sensitivity)
    np.testing.assert_allclose(numba.sensitivity, jax.sensitivity, rtol=0, atol=1e-13)
    start = np.array([scene.pack(v) for v in scene.tangents(scene.initial(scene.optional))]).T
    np.testing.assert_array_equal(numba.sensitivity[0], start)


@pytest.mark.parametrize("method", VARIATIONAL)
def test_the_derivative_starts_with_the_tangents_when_the_start_is_saved(method):
    scene = cb.SCENES["rigid_body"].with_(t_end=1.0)
    solution = cb.solve(scene, method, rtol=1e-6, save_at=[0.0, 1.0])
    start = np.array([scene.pack(v) for v in scene.tangents(solution.start())]).T
    np.testing.assert_array_equal(solution.sensitivity[0], start)
    assert np.abs(solution.sensitivity[1] - start).max() > 0.1


@pytest.mark.parametrize("method", VARIATIONAL)
def test_derivative_is_taken_at_the_initial_data_of_the_call(method):
    """At other initial data it is another derivative: against differences of two runs."""
    scene = cb.SCENES["particle"].with_(t_end=2.0)
    run = cb.prepare(scene, method, rtol=1e-11, save_at=[2.0])
    here = run(q=(0.4, -0.7))
    step = 1e-4  # central differences: truncation 1e-8, solver error 1e-10/1e-4
    ahead, behind = (run(q=(0.4 + d, -0.7)).y[0] for d in (step, -step))
    np.testing.assert_allclose(here.sensitivity[0, :, 0], (ahead - behind) / (2 * step), rtol=0, atol=1e-5)
    assert np.abs(here.sensitivity - run().sensitivity).max() > 0.05


@pytest.mark.parametrize("name", SCENES)
def test_matrix_product_and_plain_components_push_the_same_tangents(name):
    from contactbench.methods.callback import flat_rhs, variational

    larger = variational(cb.prepare(name, "scipy-radau", rtol=1e-6).request)
    scene, carry = larger.scene, larger.carry
    y = np.random.default_rng(41).normal(size=len(scene.labels(carry))).tolist()
    by_components = scene.pack(scene.rhs(scene.unpack(y, carry)))
    np.testing.assert_allclose(list(flat_rhs(scene, carry)(y)), by_components, rtol=1e-14, atol=1e-14)
