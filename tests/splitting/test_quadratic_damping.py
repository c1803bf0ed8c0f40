"""Γ(s) = ½κs²: the laws where the rate of decay changes along the motion."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

import contactbench as cb
import decimals
from cases import random_state
from contactbench.measure import order as precision
from contactbench.measure.laws import decay_rate
from contactbench.splitting import composition
from contactbench.truth import decimal_context, with_decimals
from contactbench.xla import jax, jnp

SCENE = cb.SCENES["quadratic_damping"]
TIMES = SCENE.t_end * np.arange(1, 26) / 25
CONTACT = [name for name, m in cb.METHODS.items() if m.contact and m.refuses(SCENE) is None]
#: a linear part, damping that feeds (s < 0 at the start), κ of either sign
SCENES = [
    SCENE,
    SCENE.with_(name="both", gamma=0.2, s=-0.3),
    SCENE.with_(name="negative", kappa=-0.3, gamma=0.1),
]


def solve(method, **setting):
    return cb.solve(SCENE, method, save_at=TIMES, **setting)


@pytest.mark.parametrize("seed", [1, 2])
def test_hamiltonian_and_momentum_decay_at_the_rate_of_the_moment(seed):
    """H' = −κs H and J' = −κs J at a generic state, s of either sign, by AD."""
    x = random_state(SCENE, seed)
    y, slope = (jnp.array(SCENE.pack(state)) for state in (x, SCENE.rhs(x)))
    for quantity in (SCENE.hamiltonian, lambda x: SCENE.momentum(x)[0]):
        value, rate = jax.jvp(lambda y, f=quantity: f(SCENE.unpack(list(y), ("s",))), (y,), (slope,))
        np.testing.assert_allclose(rate, -SCENE.kappa * x.s * value, rtol=1e-12, atol=1e-13)


def test_the_laws_take_their_rate_from_the_truth():
    truth = cb.reference(SCENE, TIMES)
    rate = decay_rate(solve("scipy-dop853", rtol=1e-6))
    J = SCENE.momentum(truth.states())[0] / SCENE.momentum(SCENE.initial(("s",)))[0]
    np.testing.assert_allclose(np.exp(-rate * TIMES), J, rtol=1e-13)  # H and J decay alike
    # and so does the integral of κs, here by the trapezoidal rule over the frozen grid (error h²/12)
    grid = SCENE.t_end * np.arange(201) / 200
    integral = np.trapezoid(SCENE.kappa * cb.reference(SCENE, grid).states().s, grid)
    assert rate[-1] * SCENE.t_end == pytest.approx(integral, rel=1e-3)


@pytest.mark.parametrize("name", ["hamiltonian_law", "momentum_law", "contact_drift_frozen"])
def test_an_accurate_run_keeps_the_laws_and_a_rough_one_does_not(name):
    tight, rough = (cb.LAWS[name](solve("scipy-dop853", rtol=rtol)) for rtol in (1e-12, 1e-4))
    assert tight < 1e-9  # 1e-12 per step over about 300 steps, and the factor e^{∫Γ'} = 45
    assert rough > 1e-6


def test_contact_methods_are_contact_maps_whose_factor_has_the_order_of_the_method():
    """Not the truth's factor, hence no round-off for drift and momentum, but the distribution is kept."""
    solutions = [solve("contact-abc", step=h) for h in (0.1, 0.05, 0.025)]
    for name in ("momentum_law", "contact_drift"):
        drifts = [cb.LAWS[name](solution) for solution in solutions]
        assert drifts[-1] > 1e-7
        for coarse, fine in pairwise(drifts):
            assert math.log2(coarse / fine) == pytest.approx(2, abs=0.1)
    # measured 1e-14
    assert max(cb.LAWS["distribution_drift"](solution) for solution in solutions) < 1e-12


@pytest.mark.parametrize("method", CONTACT)
@pytest.mark.parametrize("engine", ["numba", "jax", "python"])
@pytest.mark.quick(method=("contact-strang", "contact-abc"))
def test_contact_methods_keep_the_factor_of_their_own_flows(method, engine):
    """At coarse steps, where the true factor is missed by far more than round-off, and with both dampings."""
    for scene in (SCENE, SCENE.with_(gamma=0.2)):
        solution = cb.solve(scene, method, step=0.4, save_at=[0.0, *TIMES], engine=engine)
        assert cb.LAWS["own_factor_drift"](solution) < 1e-12
        assert cb.LAWS["contact_drift"](solution) > 1e-9


@pytest.mark.parametrize("method", CONTACT)
@pytest.mark.parametrize("scene", SCENES, ids=lambda s: s.name)
@pytest.mark.quick(scene="both")
def test_the_form_is_kept_with_the_factor_of_the_flows_to_40_digits(method, scene):
    """Φ*η = c η with c the product of the flows' own factors."""
    method = cb.METHODS[method]
    pulled, form = decimals.pullback(method, scene, "0.2", 3)
    context = decimal_context(decimals.DERIVATIVE_DIGITS)
    exact = with_decimals(scene, context.mpf)
    start, h = exact.initial(("s",)), context.mpf("0.2")
    c = context.exp(composition.log_factor(method.composition, exact, start, h, 3, context))
    assert max(abs(a - c * b) for a, b in zip(pulled, form, strict=True)) < context.mpf(10) ** -40
    assert abs(c - 1) > 1e-3


@pytest.mark.parametrize(
    ("method", "within"), [("contact-rkn4", 0.02), ("contact-rkn6", 0.02), ("contact-rkn8", 0.05)]
)
@pytest.mark.quick(method="contact-rkn4")
def test_nystrom_tables_keep_their_order_under_nonlinear_damping(method, within):
    """[B,[B,[B,A]]] = 0 also for A = T + γs + ½κs²; slopes at 50 digits over 40, 80 and 160 steps to t = 2."""
    method = cb.METHODS[method]
    assert precision.order_at(method, SCENE, 2.0, 40) == pytest.approx(method.order, abs=within)


@pytest.mark.parametrize("engine", ["numba", "jax", "python"])
@pytest.mark.parametrize(
    ("kappa", "s", "p", "method"),
    [
        (-2.0, 1.5, 0.8, "contact-strang"),
        (-2.0, 1.5, 0.8, "contact-rkn6"),
        (-2.0, 1.5, 0.8, "contact-abc"),
        (1.0, -3.0, 0.0, "contact-abc"),
    ],
)
def test_blow_up_in_finite_time_ends_as_diverged_with_the_time(engine, kappa, s, p, method):
    """No force: s' = T − ½κs² reaches infinity when its closed form does, 1 + wφ = rφ."""
    free = {"potential": lambda q: 0 * q[0], "gradient": lambda q: (0 * q[0],), "q": (0.0,)}
    scene = cb.Mechanical(name="runaway", **free, p=(p,), s=s, kappa=kappa, t_end=20.0)
    infinity = 1 / (math.sqrt(abs(kappa) * p * p / 4) - kappa * s / 2)
    solution = cb.solve(scene, method, step=0.01, save_at=[0.5 * infinity, 20.0], engine=engine)
    assert solution.status is cb.Status.diverged
    assert solution.end_time == pytest.approx(infinity, abs=0.011)
    assert np.isfinite(solution.y[0]).all()
    assert np.isnan(solution.y[1]).all()
