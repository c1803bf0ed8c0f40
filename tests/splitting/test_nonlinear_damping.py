"""Γ(s) = ½κs² and a Γ(s) of one's own: the laws where the rate of decay changes along the motion."""

import math
from itertools import pairwise

import numpy as np
import pytest
from mpmath import mp

import contactbench as cb
import properties
from cases import in_mp, mine, pairs
from contactbench.measure import order as precision
from contactbench.measure.laws import decay_rate
from contactbench.methods.contact import ContactMethod
from contactbench.scene.general_damping import decayed
from contactbench.testing import check_scene
from contactbench.truth import decimal_context
from properties import GENERAL, cubic_flow

SCENE = cb.SCENES["quadratic_damping"]
TIMES = SCENE.t_end * np.arange(1, 26) / 25
COMPOSED = [m for m in cb.METHODS.values() if isinstance(m, ContactMethod) and m.refuses(SCENE) is None]
#: a linear part, damping that feeds (s < 0 at the start), κ of either sign
SCENES = [
    SCENE,
    SCENE.with_(name="both", gamma=0.2, s=-0.3),
    SCENE.with_(name="negative", kappa=-0.3, gamma=0.1),
]


def solve(method, **setting):
    return cb.solve(SCENE, method, save_at=TIMES, **setting)


def test_the_laws_take_their_rate_from_the_truth():
    truth = cb.reference(SCENE, TIMES)
    rate = decay_rate(solve("scipy-dop853", rtol=1e-6))
    J = SCENE.momentum(truth.states())[0] / SCENE.momentum(SCENE.initial(("s",)))[0]
    np.testing.assert_allclose(np.exp(-rate * TIMES), J, rtol=1e-13)  # H and J decay alike
    # and so does the integral of κs, here by the trapezoidal rule over the frozen grid (error h²/12)
    grid = SCENE.t_end * np.arange(201) / 200
    integral = np.trapezoid(SCENE.kappa * cb.reference(SCENE, grid).states().s, grid)
    assert rate[-1] * SCENE.t_end == pytest.approx(integral, rel=1e-3)


@pytest.mark.parametrize("name", ["hamiltonian_law", "momentum_law"])
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


@pairs(COMPOSED, SCENES)
@pytest.mark.quick(scene="both")
def test_the_form_is_kept_but_for_a_factor_to_40_digits(method, scene):
    """Φ*η = c η with a number c, which is that of ∂_s."""
    pulled, form = properties.pullback(method, scene, "0.2", 3)
    context = decimal_context(properties.DERIVATIVE_DIGITS)
    c = pulled[-1] / form[-1]
    assert max(abs(a - c * b) for a, b in zip(pulled, form, strict=True)) < context.mpf(10) ** -40
    assert abs(c - 1) > 1e-3


CUBIC = GENERAL.with_(name="cubic", rotation_invariant=True, damping_flow=cubic_flow)
ORDERS = [(SCENE, f"rkn{n}", 40, 0.02 if n < 8 else 0.05) for n in (4, 6, 8)]
ORDERS += [(CUBIC, name, 20, 0.05) for name in ("abc", "bm6")]


@pytest.mark.parametrize(("scene", "method", "steps", "within"), ORDERS)
@pytest.mark.quick(method=("rkn4", "abc", "bm6"))
def test_methods_keep_their_order_under_nonlinear_damping(scene, method, steps, within):
    """[B,[B,[B,A]]] = 0 also for A = T + γs + ½κs²; slopes at 50 digits over so many steps, twice and four times."""
    method = cb.METHODS[f"contact-{method}"]
    assert precision.order_at(method, scene, steps / 20, steps) == pytest.approx(method.order, abs=within)


FEEDING = {"damping": lambda s: -s * s * s, "damping_slope": lambda s: -3 * s * s}
AT_REST = {"name": "runaway", "potential": lambda q: 0 * q[0], "q": (0.0,), "p": (0.0,), "t_end": 20.0}
PUSHED = cb.Mechanical(**AT_REST | {"p": (0.8,)}, s=1.5, kappa=-2.0)
#: s' = T − ½κs² reaches infinity when its closed form does, 1 + wφ = rφ; ds/dt = s³ from 1 at t = ½
RUNAWAYS = [(PUSHED, name, 1 / (math.sqrt(0.32) + 1.5), None) for name in ("strang", "rkn6", "abc")]
RUNAWAYS += [(cb.Mechanical(**AT_REST, s=-3.0, kappa=1.0), "abc", 2 / 3, None)]
RUNAWAYS += [(cb.GeneralDamping(**AT_REST, s=1.0, **FEEDING), "abc", 0.5, 1 / math.sqrt(1 - 0.8))]


@pytest.mark.parametrize("engine", ["llvm", "python"])
@pytest.mark.parametrize(("scene", "method", "infinity", "grown"), RUNAWAYS)
def test_blow_up_in_finite_time_ends_as_diverged_with_the_time(engine, scene, method, infinity, grown):
    times = [(0.8 if grown else 0.5) * infinity, 20.0]
    solution = cb.solve(scene, f"contact-{method}", step=0.01, save_at=times, engine=engine)
    assert solution.status is cb.Status.diverged
    assert solution.end_time == pytest.approx(infinity, abs=0.011)
    assert np.isfinite(solution.y[0]).all()
    assert np.isnan(solution.y[1]).all()
    assert solution.s[0] == pytest.approx(grown or solution.s[0], rel=1e-9)


# -- a damping of one's own: Γ and Γ' are enough, a closed form of s' = −Γ(s) makes it faster -------------
QUADRATURE = CUBIC.with_(name="quadrature", damping_flow=None)
both = pytest.mark.parametrize("scene", [CUBIC, QUADRATURE], ids=lambda s: s.name)


@both
def test_it_keeps_the_contract_of_a_scene(scene):
    check_scene(scene)


@pytest.mark.parametrize(("s", "h"), [(0.0, 0.3), (1e-12, 0.8), (-0.3, -0.2), (0.7, 1e-3), (2.0, 0.3)])
def test_quadrature_is_the_closed_form(s, h):
    """To round-off in doubles where Γ'h is below one, to 45 digits in mpmath; 2.5 are the largest here."""
    with mp.workdps(50):
        exact, _ = in_mp(QUADRATURE, QUADRATURE.initial(("s",)))
        true = cubic_flow(mp.mpf(s), mp.mpf(h), mp)
        assert abs(decayed(exact, mp.mpf(s), mp.mpf(h), mp)[0] - true) < mp.mpf(10) ** -45
    tolerance = 1e-15 * abs(s) if abs(s) < 1 else 1e-11
    assert decayed(QUADRATURE, s, h, math)[0] == pytest.approx(float(true), rel=0, abs=tolerance)
    together = decayed(QUADRATURE, np.array([s, s]), h, np)[0]
    np.testing.assert_allclose(together, float(true), rtol=0, atol=tolerance)


GONE = {"damping": lambda s: cb.math.exp(s) - 1, "damping_slope": cb.math.exp}
FLOWS = [None, lambda s, h, xp: -xp.log(1 + (xp.exp(-s) - 1) * xp.exp(-h))]


@pytest.mark.parametrize("flow", FLOWS, ids=["quadrature", "closed form"])
def test_round_off_near_a_zero_of_the_damping_does_not_reach_the_factor(flow):
    """Γ = e^s − 1 has none of its digits right where s is 1e-17; the factor there is e^{−h} all the same."""
    scene = cb.GeneralDamping(**AT_REST | {"p": (0.8,)}, s=0.5, **GONE, damping_flow=flow)
    for s in (0.0, 1e-17, 1e-9, -1e-12):
        assert decayed(scene, s, 0.2, math)[1] == pytest.approx(-0.2 - s * (1 - math.exp(-0.2)), abs=1e-15)
    solution = cb.solve(scene.with_(t_end=40.0), "contact-abc", step=0.1)
    assert cb.LAWS["distribution_drift"](solution) < 1e-13


@pytest.mark.parametrize("engine", ["llvm", "python"])
@both
@pytest.mark.quick(scene="cubic")
def test_it_runs_on_every_engine_and_keeps_the_distribution(scene, engine):
    times = [2.0, 4.0]
    solution = cb.solve(scene, "contact-bm6", step=0.05, save_at=times, engine=engine)
    assert solution.ok
    other = cb.solve(CUBIC, "contact-bm6", step=0.05, save_at=times, engine="python")
    np.testing.assert_allclose(solution.y, other.y, rtol=0, atol=1e-12)
    assert cb.LAWS["distribution_drift"](solution) < 1e-11
    assert cb.LAWS["solution_error"](solution) < 1e-6
    accurate = cb.solve(scene, "scipy-dop853", rtol=1e-11, save_at=times)
    np.testing.assert_allclose(accurate.y, solution.y, rtol=0, atol=1e-6)


def test_a_derived_hessian_is_no_jacobian():
    damping = {"damping": lambda s: s**3, "damping_slope": lambda s: 3 * s * s}
    scene = mine(lambda q: q[0] ** 4 / 4, t_end=3.0, kind=cb.GeneralDamping, s=0.3, **damping)
    runs = [cb.solve(scene, name, rtol=1e-8, save_at=[3.0]) for name in ("scipy-radau", "scipy-dop853")]
    np.testing.assert_allclose(runs[0].y, runs[1].y, rtol=0, atol=1e-6)
