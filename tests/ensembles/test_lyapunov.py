"""Lyapunov spectra: known ones, the sum that the contact form fixes, and error bars that say what they should."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import contactbench as cb
from cases import mine
from contactbench.ensembles.lyapunov import kaplan_yorke

PERIOD, EPS = 2 * np.pi, np.finfo(float).eps
OSCILLATOR, DUFFING = cb.SCENES["oscillator"], cb.SCENES["duffing"]


def starts(n, seed=1):
    rng = np.random.default_rng(seed)
    return {"q": (rng.uniform(-1.5, 1.5, n),), "p": (rng.uniform(-1, 1, n),)}


def duffing(method, n=64, intervals=100, scene=DUFFING, seed=1, **setting):
    options = {"every": PERIOD, "intervals": intervals, "settle": 30, "initial_conditions": starts(n, seed)}
    return cb.lyapunov(scene, method, **options | (setting or {"step": PERIOD / 16}))


@pytest.mark.parametrize(
    ("exponents", "dimension"),
    [((0.9, 0.0, -14.57), 2 + 0.9 / 14.57), ((0.25, -0.5), 1.5), ((-1.0, -2.0), 0.0), ((0.5, -0.5), 2.0)],
)
def test_kaplan_yorke(exponents, dimension):
    assert kaplan_yorke(np.array(exponents)) == pytest.approx(dimension, rel=1e-14)


@pytest.mark.parametrize(
    ("method", "how"),
    [("contact-rkn6", {"step": 0.05}), ("cyrk-dop853", {"rtol": 1e-12}), ("gauss6", {"step": 0.02})],
)
def test_an_overdamped_oscillator_has_the_rates_of_its_two_modes(method, how):
    found = cb.lyapunov(OSCILLATOR.with_(gamma=3.0), method, every=1.0, intervals=64, settle=30, **how)
    np.testing.assert_allclose(found.exponents.value, -1.5 + np.sqrt(1.25) * np.array([1, -1]), rtol=1e-10)
    assert np.all(found.exponents.error < 1e-10)


def test_a_body_loses_volume_of_momenta_at_three_times_its_damping():
    found = cb.lyapunov("rigid_body", "contact-strang", step=0.1, every=1.0, intervals=32)
    assert len(found.exponents.value) == 3
    assert found.total.value == pytest.approx(-3 * cb.SCENES["rigid_body"].gamma, rel=1e-12)


# -- the cost ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("method", ["rk4", "contact-strang", "contact-rkn6"])
@pytest.mark.parametrize(("intervals", "settle", "n"), [(1, 1, 1), (7, 5, 1), (16, 2, 3)])
def test_evaluations_of_steps_are_those_of_an_interval_over_its_length(method, intervals, settle, n):
    """The settling is not in it, nor is the number of trajectories."""
    once = cb.solve(OSCILLATOR, method, step=0.05, save_at=[0.4], carry=()).counts.evaluations
    options = {"intervals": intervals, "settle": settle, "initial_conditions": starts(n)}
    found = cb.lyapunov(OSCILLATOR, method, step=0.05, every=0.4, carry=(), **options)
    assert found.evaluations == pytest.approx(once / 0.4, rel=1e-14)


def test_evaluations_of_cyrk_are_those_of_scipys_variational_equations():
    """SciPy's DOP853 with the same tolerances, afresh in every interval, the tangents made orthonormal by NumPy."""
    every, settle, intervals, n = 1.5, 3, 6, 2
    matrix, initial = np.array([[0.0, 1.0], [-1.0, -OSCILLATOR.gamma]]), starts(n)
    spent = 0
    for q, p in zip(initial["q"][0], initial["p"][0], strict=True):
        y = np.concatenate([[q, p], np.eye(2).ravel()])  # the state, and the tangents one after the other
        for k in range(-settle, intervals):
            slope = lambda t, y: (y.reshape(3, 2) @ matrix.T).ravel()  # noqa: E731
            run = solve_ivp(slope, (0, every), y, "DOP853", rtol=1e-7, atol=1e-7)
            y = np.concatenate([run.y[:2, -1], np.linalg.qr(run.y[2:, -1].reshape(2, 2).T)[0].T.ravel()])
            spent += run.nfev * (k >= 0)
    options = {"every": every, "intervals": intervals, "settle": settle, "initial_conditions": initial}
    found = cb.lyapunov(OSCILLATOR, "cyrk-dop853", rtol=1e-7, **options)
    assert found.evaluations == pytest.approx(spent / (n * every * intervals), rel=1e-14)


# -- the sum -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("method", ["contact-strang", "contact-rkn4", "contact-rkn6"])
@pytest.mark.parametrize("steps", [16, 40])
def test_of_a_contact_method_the_sum_is_the_damping_at_any_step(method, steps):
    rates = duffing(method, step=PERIOD / steps, intervals=20).rates
    growth = np.exp(PERIOD * (rates[:, 0] - rates[:, 1]))  # of the roundings of one tangent along the other
    off = abs(rates.sum(axis=1) + DUFFING.gamma)
    assert np.median(off) < 20 * EPS
    assert off.max() < EPS * growth.max()


def test_of_others_it_is_to_their_order():
    off = {n: duffing("rk4", step=PERIOD / n).total.value + DUFFING.gamma for n in (32, 64)}
    assert np.log2(abs(off[32] / off[64])) > 3
    rough, fine = (duffing("cyrk-dop853", rtol=r).total.value + DUFFING.gamma for r in (1e-3, 1e-8))
    assert abs(rough) > 1e-5
    assert 1e-13 < abs(fine) < 1e-9


# -- chaos -------------------------------------------------------------------------------------------
def test_two_ways_to_the_tangent_map_agree_on_the_chaotic_scene():
    """Dual numbers through splitting steps, and variational equations by an embedded Runge–Kutta pair."""
    ours, theirs = duffing("contact-rkn6", n=128), duffing("cyrk-dop853", n=128, seed=2, rtol=1e-8)
    for quantity in ("exponents", "dimension", "energy"):
        a, b = getattr(ours, quantity), getattr(theirs, quantity)
        assert np.all(np.abs(a.value - b.value) < 4 * np.hypot(a.error, b.error)), quantity
        assert np.all(a.error < 0.06 * np.abs(a.value)), quantity
    assert ours.exponents.value[0] > 0.15
    assert 1.3 < ours.dimension.value < 1.5


def test_the_published_spectrum_of_ueda():
    """Sprott, Chaos and Time-Series Analysis, Oxford University Press 2003: 0.1034, 0, −0.1534, dimension 2.6741."""
    potential = lambda q, t: q[0] ** 4 / 4 - 7.5 * q[0] * cb.math.sin(t)  # noqa: E731
    ueda = mine(potential, 2.5, t_end=20.0, kind=cb.Driven, gamma=0.05)
    found = duffing("contact-rkn6", n=256, intervals=200, scene=ueda, step=PERIOD / 32)
    assert np.all(np.abs(found.exponents.value - [0.1034, -0.1534]) < 3 * found.exponents.error)
    assert abs(found.dimension.value - 1.6741) < 3 * found.dimension.error
    assert np.all(found.exponents.error < 0.001)


# -- what is refused -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"method": "scipy-dop853", "rtol": 1e-6}, "a given step, and those of CyRK"),
        ({"method": "rk4", "step": 0.1, "every": 0.0}, "every"),
        ({"method": "rk4", "step": 0.1, "intervals": 0}, "intervals"),
        ({"method": "rk4", "step": 0.1, "settle": 0}, "settle"),
    ],
)
def test_what_cannot_be_done_is_said(options, said):
    with pytest.raises(cb.BadInput, match=said):
        cb.lyapunov(OSCILLATOR, **{"every": 1.0, "intervals": 40} | options)


def test_a_trajectory_that_leaves_is_left_out_and_counted():
    scene = cb.SCENES["particle"].with_(gamma=0.0)
    start = {"q": (np.array([0.1, 9.0]), np.array([0.1, -9.0])), "p": (0.0, np.array([0.0, -9.0]))}
    found = cb.lyapunov(scene, "contact-strang", step=0.1, every=1.0, intervals=40, initial_conditions=start)
    assert (found.diverged, found.rates.shape) == (1, (40, 4, 1))
    assert abs(found.total.value) < 1e-13
    # where all of them leave there is no number
    found = cb.lyapunov(OSCILLATOR, "contact-strang", step=6.0, every=6.0, intervals=40)
    assert found.diverged == 1
    assert np.isnan([*found.exponents.value, found.total.value, found.dimension.value]).all()


@pytest.mark.parametrize(("gamma", "every"), [(50.0, 2.0), (50.0, 1.0), (5.0, 10.0)])
def test_an_interval_that_loses_a_tangent_to_rounding_is_refused(gamma, every):
    """e^{−γt} apart: the smaller one is rounding, and the sum of the exponents would not be −γ."""
    scene = cb.SCENES["overdamped"].with_(gamma=gamma)
    with pytest.raises(cb.BadInput, match=f"every = {every:g}: one tangent grows more than"):
        cb.lyapunov(scene, "contact-strang", step=0.05, every=every, intervals=8)
    found = cb.lyapunov(scene, "contact-strang", step=0.05, every=0.25, intervals=64)
    assert found.total.value == pytest.approx(-gamma, rel=1e-9)
