"""Γ(s) = ½κs²: the laws where the rate of decay changes along the motion."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

import contactbench as cb
import decimals
from cases import random_state
from contactbench.measure import precision
from contactbench.measure.laws import decay_rate, laws_of
from contactbench.measure.pullback import pullback
from contactbench.methods.base import METHODS
from contactbench.plugins import OWN
from contactbench.splitting import composition, flows
from contactbench.truth import decimal_context, with_decimals
from contactbench.xla import jax, jnp

SCENE = cb.SCENES["quadratic_damping"]
TIMES = SCENE.t_end * np.arange(1, 26) / 25
LAWS = ("hamiltonian_law", "momentum_law", "contact_drift")


def solve(method, **setting):
    return cb.solve(SCENE, method, save_at=TIMES, **setting)


def test_hamiltonian_and_momentum_decay_at_the_rate_of_the_moment():
    """H' = −κs H and J' = −κs J at a generic state, s of either sign, by AD."""
    for seed in (1, 2):
        x = random_state(SCENE, seed)
        y, slope = (jnp.array(SCENE.pack(state)) for state in (x, SCENE.rhs(x)))
        for quantity in (SCENE.hamiltonian, lambda x: SCENE.momentum(x)[0]):
            value, rate = jax.jvp(lambda y, f=quantity: f(SCENE.unpack(list(y), ("s",))), (y,), (slope,))
            np.testing.assert_allclose(rate, -SCENE.kappa * x.s * value, rtol=1e-12, atol=1e-13)


def test_default_data_stay_away_from_antidamping_and_the_rate_really_changes():
    s = cb.reference(SCENE, TIMES).states().s
    assert s.min() > 0.15
    assert SCENE.s > 5 * s[-1]


def test_the_laws_apply_and_take_their_rate_from_the_truth():
    assert set(LAWS) <= {law.name for law in laws_of(SCENE)}
    assert "momentum_balance" not in {law.name for law in laws_of(SCENE)}
    assert "energy_increases" not in {law.name for law in laws_of(SCENE)}
    truth = cb.reference(SCENE, TIMES)
    rate = decay_rate(solve("scipy-dop853", rtol=1e-6))
    J = SCENE.momentum(truth.states())[0] / SCENE.momentum(SCENE.initial(("s",)))[0]
    np.testing.assert_allclose(np.exp(-rate * TIMES), J, rtol=1e-13)  # H and J decay alike
    # and so does the integral of κs, here by the trapezoidal rule over the frozen grid (error h²/12)
    grid = SCENE.t_end * np.arange(201) / 200
    integral = np.trapezoid(SCENE.kappa * cb.reference(SCENE, grid).states().s, grid)
    assert rate[-1] * SCENE.t_end == pytest.approx(integral, rel=1e-3)


def test_rate_is_finite_at_a_saved_start():
    solution = cb.solve(SCENE, "rk4", step=0.01, save_at=[0.0, 0.1])
    assert decay_rate(solution)[0] == 0
    assert cb.LAWS["momentum_law"](solution) < 1e-8


@pytest.mark.parametrize("name", ["hamiltonian_law", "momentum_law", "contact_drift_frozen"])
def test_an_accurate_run_keeps_the_laws_and_a_rough_one_does_not(name):
    tight, rough = (cb.LAWS[name](solve("scipy-dop853", rtol=rtol)) for rtol in (1e-12, 1e-4))
    assert tight < 1e-9  # 1e-12 per step over about 300 steps, and the factor e^{∫Γ'} = 45
    assert rough > 1e-6


def test_the_drift_of_an_adaptive_map_falls_with_its_tolerance():
    """Its derivative contains that of the choice of steps, and is larger than with the steps held fixed."""
    tight, rough = (solve("scipy-dop853", rtol=rtol) for rtol in (1e-12, 1e-4))
    assert cb.LAWS["contact_drift"](tight) < 1e-5 * cb.LAWS["contact_drift"](rough)  # measured 2e-7
    assert cb.LAWS["contact_drift"](tight) > cb.LAWS["contact_drift_frozen"](tight)


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


def test_the_factor_of_a_contact_method_is_the_ratio_by_which_its_momentum_decays():
    """Φ*η = (J(Φ)/J) η exactly: damping multiplies p, hence J and η, and nothing else touches either."""
    solution = solve("contact-abc", step=0.2)
    pulled, form, *_ = pullback(solution, solution.differential)
    ratio = SCENE.momentum(solution.states())[0] / SCENE.momentum(solution.start())[0]
    np.testing.assert_allclose(
        pulled / ratio[:, None], np.tile(form, (25, 1)), rtol=0, atol=1e-12
    )  # measured 2e-15


CONTACT = [
    name for name, method in METHODS.items()
    if getattr(method, "contact", False) and method.refuses(SCENE) is None
]  # fmt: skip


#: of each flow damped quadratically, `damp` and `drift_damp`, a method that JAX compiles in the quick tests; the
#: others compose the same flows, and their loops on JAX are the contract's
ON_JAX = ("contact-abc", "contact-strang")


def on_engines():
    for engine in ("numba", "jax", "python"):
        for name in CONTACT:
            quick = engine != "jax" or name in ON_JAX or name not in OWN
            yield pytest.param(name, engine, id=f"{engine}-{name}", marks=[] if quick else pytest.mark.slow)


@pytest.mark.parametrize(("method", "engine"), list(on_engines()))
@pytest.mark.quick(method=("contact-strang", "contact-o8"))
def test_contact_methods_keep_the_factor_of_their_own_flows(method, engine):
    """At coarse steps, where the true factor is missed by far more than round-off, and with both dampings."""
    for scene in (SCENE, SCENE.with_(gamma=0.2)):
        solution = cb.solve(scene, method, step=0.4, save_at=[0.0, *TIMES], engine=engine)
        assert cb.LAWS["own_factor_drift"](solution) < 1e-12
        assert cb.LAWS["contact_drift"](solution) > 1e-9


@pytest.mark.parametrize(("flow", "method"), [("damp", "contact-abc"), ("drift_damp", "contact-rkn6")])
def test_the_factor_is_compared_with_the_derivative_of_the_map(monkeypatch, flow, method):
    """A formula for the factor that is wrong, its root, shows; so would a flow that is."""
    solution = solve(method, step=0.2)
    right = flows.MECHANICAL[flow]

    def wrong(scene, x, h, xp):
        return right.log_factor(scene, x, h, xp) / 2

    monkeypatch.setitem(flows.MECHANICAL, flow, right._replace(log_factor=wrong))
    assert cb.LAWS["own_factor_drift"](solution) > 0.1


@pytest.mark.parametrize("method", ["rk4", "scipy-dop853"])
def test_a_method_that_is_no_composition_of_contact_maps_has_no_factor_of_its_own(method):
    setting = {"rtol": 1e-4} if cb.METHODS[method].adaptive else {"step": 0.1}
    assert math.isnan(cb.LAWS["own_factor_drift"](solve(method, **setting)))


@pytest.mark.parametrize(
    ("method", "n", "within"),
    [("contact-rkn4", 40, 0.02), ("contact-rkn6", 40, 0.02), ("contact-rkn8", 40, 0.05)],
)
@pytest.mark.quick(method="contact-rkn4")
def test_nystrom_tables_keep_their_order_under_nonlinear_damping(method, n, within):
    """[B,[B,[B,A]]] = 0 also for A = T + γs + ½κs²; slopes at 50 digits over n, 2n and 4n steps to t = 2."""
    method = cb.METHODS[method]
    assert precision.order_at(method, SCENE, 2.0, n) == pytest.approx(method.order, abs=within)


#: damping that feeds (s < 0 at the start), κ of either sign, a linear part
SCENES = [
    SCENE,
    SCENE.with_(name="both", gamma=0.2, s=-0.3),
    SCENE.with_(name="negative", kappa=-0.3, gamma=0.1),
]


@pytest.mark.parametrize("scene", SCENES, ids=lambda s: s.name)
@pytest.mark.parametrize("method", CONTACT)
@pytest.mark.quick(scene="quadratic_damping")
def test_the_form_is_kept_with_the_factor_of_the_flows_to_40_digits(method, scene, mp50):
    """Φ*η = c η with c the product of the flows' own factors: the law that is structural here."""
    method = cb.METHODS[method]
    pulled, form = decimals.pullback(method, scene, "0.2", 3)
    context = decimal_context(decimals.DERIVATIVE_DIGITS)
    exact = with_decimals(scene, context.mpf)
    start, h = exact.initial(("s",)), context.mpf("0.2")
    c = context.exp(composition.log_factor(method.composition, exact, start, h, 3, context))
    assert max(abs(a - c * b) for a, b in zip(pulled, form, strict=True)) < context.mpf(10) ** -40
    assert abs(c - 1) > 1e-3


@pytest.mark.parametrize(
    "method", ["contact-abc", "contact-strang", "contact-rkn6", "contact-rkn8", "contact-bm6"]
)
def test_momentum_and_form_follow_the_own_factor_to_round_off(method):
    """In double precision over the whole span: J(Φ) = c J and Φ*η = c η."""
    steps, h = 100, 0.2
    solution = cb.solve(SCENE, method, step=h, save_at=[steps * h])
    c = math.exp(cb.METHODS[method].log_factor(SCENE, solution.start(), h, steps))
    J = [SCENE.momentum(x)[0] for x in (solution.start(), solution.states())]
    assert float(J[1][0] / (c * J[0])) == pytest.approx(1, abs=1e-12)
    pulled, form, *_ = pullback(solution, solution.differential)
    np.testing.assert_allclose(pulled[-1] / c, form, rtol=0, atol=1e-11)


@pytest.mark.parametrize("engine", ["numba", "jax", "python"])
@pytest.mark.parametrize(
    ("kappa", "s", "method"),
    [
        (-2.0, 1.5, "contact-strang"),
        (-2.0, 1.5, "contact-rkn6"),
        (1.0, -3.0, "contact-abc"),
        (-2.0, 1.5, "contact-abc"),
    ],
)
@pytest.mark.quick(engine="numba")
def test_blow_up_in_finite_time_ends_as_diverged_with_the_time(engine, kappa, s, method):
    """No force: s' = T − ½κs² reaches infinity when its closed form does; T = 0 where κ > 0."""
    p = 0.0 if kappa > 0 else 0.8
    scene = cb.Mechanical(
        name="runaway", potential=lambda q: 0 * q[0], gradient=lambda q: (0 * q[0],),
        q=(0.0,), p=(p,), s=s, kappa=kappa, t_end=20.0,
    )  # fmt: skip
    r = math.sqrt(abs(kappa) * p * p / 4)
    infinity = 1 / (r - kappa * s / 2)  # 1 + wφ = rφ
    solution = cb.solve(scene, method, step=0.01, save_at=[0.5 * infinity, 20.0], engine=engine)
    assert solution.status is cb.Status.diverged
    assert solution.end_time == pytest.approx(infinity, abs=0.011)
    assert np.isfinite(solution.y[0]).all()
    assert np.isnan(solution.y[1]).all()


@pytest.mark.parametrize("method", ["herglotz1", "herglotz2"])
def test_methods_that_need_a_constant_rate_refuse(method):
    solution = cb.solve(SCENE, method, step=0.1)
    assert solution.status is cb.Status.unsupported
    assert SCENE.name in solution.message


def test_hamiltonian_zero_gives_no_rate():
    """At rest in the minimum with s = 0: said, not divided by."""
    scene = cb.Mechanical(
        name="level", potential=lambda q: q[0] * q[0] / 2, gradient=lambda q: (q[0],),
        q=(0.0,), p=(0.0,), s=0.0, kappa=0.5, t_end=1.0,
    )  # fmt: skip
    solution = cb.solve(scene, "rk4", step=0.1)
    with pytest.raises(cb.BadInput, match=r"H\(0\) = 0"):
        cb.LAWS["hamiltonian_law"](solution)
