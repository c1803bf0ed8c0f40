"""A damping Γ(s) of one's own: Γ and Γ' are enough, a closed form of s' = −Γ(s) makes it faster."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mpmath import mp

import contactbench as cb
from cases import in_mp
from contactbench.measure import order as precision
from contactbench.splitting.flows import decay
from contactbench.testing import check_scene
from properties import GENERAL, cubic_flow

QUADRATURE = GENERAL.with_(name="quadrature", rotation_invariant=True)
SCENE = QUADRATURE.with_(name="cubic", damping_flow=cubic_flow)
both = pytest.mark.parametrize("scene", [SCENE, QUADRATURE], ids=lambda s: s.name)


@both
def test_it_keeps_the_contract_of_a_scene(scene):
    check_scene(scene)


TAKE_IT = {"printed": True, "abc": True, "strang": True, "bm4": True, "bm6": True, "o8": True}
TAKE_IT |= {"rkn6": False, "rkn8": False, "adaptive": False, "exact": False}


@pytest.mark.parametrize(("name", "taken"), TAKE_IT.items())
def test_compositions_for_any_force_take_it_and_other_methods_do_not(name, taken):
    assert (cb.METHODS[f"contact-{name}"].refuses(SCENE) is None) is taken


@pytest.mark.parametrize("s", [0.0, 1e-12, -0.3, 0.7, 2.0])
@pytest.mark.parametrize("h", [1e-3, 0.3, -0.2, 0.8])
def test_quadrature_is_the_closed_form(s, h):
    """To round-off in doubles where Γ'h is below one, to 45 digits in mpmath; 2.5 are the largest here."""
    with mp.workdps(50):
        exact, _ = in_mp(QUADRATURE, QUADRATURE.initial(("s",)))
        true = cubic_flow(mp.mpf(s), mp.mpf(h), mp)
        assert abs(decay(exact, mp.mpf(s), mp.mpf(h), mp) - true) < mp.mpf(10) ** -45
    tolerance = 1e-15 * abs(s) if abs(s) < 1 else 1e-11
    assert decay(QUADRATURE, s, h, math) == pytest.approx(float(true), rel=0, abs=tolerance)
    together = decay(QUADRATURE, np.array([s, s]), h, np)
    np.testing.assert_allclose(together, float(true), rtol=0, atol=tolerance)


@pytest.mark.parametrize("method", ["contact-abc", "contact-bm4", "contact-bm6"])
def test_compositions_keep_their_order(method):
    method = cb.METHODS[method]
    assert precision.order_at(method, SCENE, 1.0, 20) == pytest.approx(method.order, abs=0.05)


@pytest.mark.parametrize("engine", ["numba", "jax", "python"])
@both
@pytest.mark.quick(scene="cubic")
def test_it_runs_on_every_engine_and_keeps_its_own_factor(scene, engine):
    times = [2.0, 4.0]
    solution = cb.solve(scene, "contact-bm4", step=0.05, save_at=times, engine=engine)
    assert solution.ok
    other = cb.solve(SCENE, "contact-bm4", step=0.05, save_at=times, engine="python")
    np.testing.assert_allclose(solution.y, other.y, rtol=0, atol=1e-12)
    assert cb.LAWS["own_factor_drift"](solution) < 1e-11
    assert cb.LAWS["solution_error"](solution) < 1e-6
    accurate = cb.solve(scene, "scipy-dop853", rtol=1e-11, save_at=times)
    np.testing.assert_allclose(accurate.y, solution.y, rtol=0, atol=1e-6)


def test_a_derived_hessian_is_no_jacobian():
    functions = {
        "potential": lambda q: q[0] ** 4 / 4,
        "damping": lambda s: s**3,
        "damping_slope": lambda s: 3 * s * s,
    }
    scene = cb.GeneralDamping(name="mine", q=(1.0,), p=(0.0,), s=0.3, t_end=3.0, **functions)
    runs = [cb.solve(scene, name, rtol=1e-8, save_at=[3.0]) for name in ("scipy-radau", "scipy-dop853")]
    np.testing.assert_allclose(runs[0].y, runs[1].y, rtol=0, atol=1e-6)


@pytest.mark.parametrize("engine", ["numba", "python"])
def test_blow_up_ends_as_diverged_with_the_time(engine):
    """Γ = −s³ feeds s until it is infinite: ds/dt = s³ from 1 ends at t = ½."""
    feeding = {"damping": lambda s: -s * s * s, "damping_slope": lambda s: -3 * s * s}
    at_rest = {"potential": lambda q: 0 * q[0], "q": (0.0,), "p": (0.0,), "s": 1.0, "t_end": 2.0}
    scene = cb.GeneralDamping(name="runaway", **feeding, **at_rest)
    solution = cb.solve(scene, "contact-abc", step=0.01, save_at=[0.4, 2.0], engine=engine)
    assert solution.status is cb.Status.diverged
    assert solution.end_time == pytest.approx(0.5, abs=0.021)
    assert solution.s[0] == pytest.approx(1 / math.sqrt(1 - 0.8), rel=1e-9)
    assert np.isnan(solution.y[1]).all()
