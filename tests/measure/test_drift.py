"""The derivative of every numerical map, the choice of steps included, and the contact drift of it."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

import cases
import contactbench as cb
from cases import ALL_SCENES, few_slow, saved
from contactbench.measure.laws import row
from contactbench.measure.pullback import pairs, pullback, variational
from contactbench.methods import prepared
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.prepared import Outcome, differences
from contactbench.solution import SAFETY, Counts, Differential, Status


@pytest.fixture
def unlimited(monkeypatch):
    """Derivatives by differences whatever they cost."""
    for name in ("BUDGET", "CALLBACK_BUDGET"):
        monkeypatch.setattr(prepared, name, 10**9)


CENTRAL = cb.SCENES["central"]
#: where a step of cyrk-vern8 is nearly rejected, its differences at rtol = 1e-8 are uncertain by their own size
PEERS = ("scipy-dop853", "scipy-radau", "cvode-adams", "cvode-bdf", "heyoka-taylor")
PEERS += ("cyrk-dop853", "cyrk-lsoda", "cyrk-radau")
DIFFRAX = ("diffrax-tsit5", "diffrax-dopri8")
FIXED = [name for name, method in cb.METHODS.items() if isinstance(method, FixedStep)]


drift = cb.LAWS["contact_drift"]


# -- the map a user gets ---------------------------------------------------------------------------
@pytest.mark.parametrize("method", FIXED)
@pytest.mark.quick(method=("contact-strang", "contact-rkn6", "herglotz2", "rk4"))
def test_fixed_steps_are_differentiated_without_differences(method):
    solution = cb.solve(CENTRAL, method, step=0.1, save_at=saved(CENTRAL))
    assert len(solution.differential.estimates) == 1
    assert "differences" not in solution.differential.source


@pytest.mark.parametrize(
    "method", few_slow(["scipy-dop853", "cvode-bdf", "heyoka-taylor", *DIFFRAX], *DIFFRAX)
)
def test_where_the_solver_chooses_the_steps_its_drifts_have_error_bars(method):
    solution = cb.solve(CENTRAL, method, rtol=1e-6, save_at=saved(CENTRAL))
    for law in ("contact_drift", "distribution_drift"):
        measured = cb.LAWS[law].measured(solution)
        assert 0 < measured.uncertainty < measured.value / 2


# -- differences of the solver ---------------------------------------------------------------------
def bars(found):
    """The error bar of each column of a derivative."""
    return SAFETY * np.abs(np.diff(found.estimates, axis=0)).max(axis=(1, 2)).min(axis=0)


@cases.pairs([cb.METHODS[name] for name in ("contact-strang", "contact-gauss2", "rk4")], ALL_SCENES)
@pytest.mark.quick(scene=("oscillator", "rigid_body", "kepler_drag"), method=("contact-strang", "rk4"))
def test_error_bar_of_differences_covers_their_distance_to_the_exact_derivative(scene, method, unlimited):
    """Bodies included; the derivative itself where the scene is no contact system.

    All columns together, as the laws take them: a bar is twice the least of several disagreements, and at round-off two
    estimates of one column may agree by chance.
    """
    scene = scene.with_(t_end=min(scene.t_end, 20.0))
    # near-collisions of an orbit that is not resolved make its map bend within any increment
    steps = 8000 if scene.name in ("kepler_drag", "thermostat") else 400
    run = cb.prepare(scene, method, step=scene.t_end / steps, save_at=scene.begins + saved(scene))
    solution = run()
    assert solution.ok
    exact = solution.differential
    found = differences(run, run.start, run.integrate(run.start))
    off = np.abs(found.value - exact.value).max(axis=(0, 1))
    assert np.linalg.norm(off) <= np.linalg.norm(bars(found))
    assert np.all(bars(found) < 1e-5 * np.abs(exact.value).max())
    if scene.is_contact:
        mine, theirs = pullback(solution, exact), pullback(solution, found)
        assert np.linalg.norm(mine.values - theirs.values, axis=1).max() <= theirs.uncertainty.max()


def test_the_error_bar_is_twice_the_smallest_disagreement_of_two_estimates():
    """η(v) = v_s − p v_q with p = 3: of three estimates the last two agree best, to 0.01 and 3 · 0.02."""
    scene = cb.SCENES["oscillator"].with_(q=(1.0,), p=(3.0,))
    solution = cb.solve(scene, "rk4", step=0.1, save_at=[0.1])
    estimates = np.zeros((3, 1, 3, 3))
    estimates[:, 0, 0, 0] = 7.0, 5.0, 5.02
    estimates[:, 0, 2, 2] = 1.5, 1.0, 1.01
    solution.y[:] = 1.0, 3.0, 0.0
    found = pullback(solution, Differential("planted", estimates))
    np.testing.assert_allclose(found.values, [[-15.0, 0.0, 1.0]])
    np.testing.assert_allclose(found.uncertainty, [2 * np.hypot(0.06, 0.01)])
    np.testing.assert_allclose(found.terms, [np.hypot(15.0, 1.0)])


@pytest.mark.parametrize("away", [3e-4, 3e-5, -2e-5])
def test_a_jump_between_two_increments_is_passed_over(away):
    """As a changed decision on a step makes one."""

    def integrate(y0):
        y = np.sin(3 * y0) + 1e-4 * (y0 > 0.5 + away)
        return Outcome(y[None], Counts(1, 1), Status.ok, "", 1.0)

    y0 = np.array([0.5, 0.2, 0.4])
    plain = cb.prepare("oscillator", "rk4", step=0.1)
    run = SimpleNamespace(integrate=integrate, request=plain.request, scales=plain.scales)
    found = differences(run, y0, run.integrate(y0))
    wrong = np.abs(found.value[0] - np.diag(3 * np.cos(3 * y0))).max(axis=0)
    assert np.all(wrong <= bars(found))
    assert bars(found)[0] < 1e-6
    assert np.abs(found.estimates[:, 0, 0, 0] - 3 * math.cos(1.5)).max() > 1e-3  # some saw it


def test_a_map_that_bends_within_every_increment_has_no_derivative_by_differences():
    """A derivative of 10¹⁰, as the map of a near-collision that was not resolved has it."""
    run = cb.prepare(cb.SCENES["kepler_drag"].with_(t_end=20.0), "rk4", step=0.05, save_at=[16.0, 20.0])
    found = differences(run, run.start, run.integrate(run.start))
    assert not found.taken
    assert "do not converge" in found.source
    assert np.abs(run().sensitivity).max() > 1e9
    with pytest.raises(cb.BadInput, match="do not converge"):
        found.value  # noqa: B018


def test_a_drift_below_its_error_bar_is_given_as_an_upper_bound():
    solution = cb.solve(CENTRAL, "heyoka-taylor", rtol=1e-15, save_at=saved(CENTRAL))
    measured = cb.LAWS["contact_drift"].measured(solution)
    assert measured.bound
    assert measured.uncertainty < measured.value <= 2 * measured.uncertainty < 1e-8
    rough = cb.LAWS["contact_drift"].measured(cb.solve(CENTRAL, "heyoka-taylor", rtol=1e-6))
    assert not rough.bound


def test_no_derivative_beyond_the_budget_and_the_table_says_so(monkeypatch):
    """Counted in evaluations, so that no clock decides."""
    solution = cb.solve(CENTRAL, "scipy-dop853", rtol=1e-4, save_at=[20.0])
    cost = 60 * solution.counts.evaluations
    found = []
    for budget in (cost - 1, cost):
        monkeypatch.setattr(prepared, "CALLBACK_BUDGET", budget)
        found.append(row(cb.solve(CENTRAL, "scipy-dop853", rtol=1e-4, save_at=[20.0])))
    assert math.isnan(found[0]["contact_drift"])
    assert found[1]["contact_drift"] > 0


# -- other initial data ----------------------------------------------------------------------------
@pytest.mark.parametrize("method", few_slow(PEERS, "scipy-radau"))
def test_derivative_is_taken_at_the_initial_data_of_the_call(method):
    """It starts with the tangents there, and at other initial data is another: against differences of two runs."""
    scene = cb.SCENES["particle"].with_(t_end=2.0)
    run = cb.prepare(scene, method, rtol=1e-11, save_at=[0.0, 2.0], carry=())
    here = run(q=(0.4, -0.7))
    step = 1e-4  # central differences: truncation 1e-8, solver error 1e-10/1e-4
    ahead, behind = (run(q=(0.4 + d, -0.7)).y[1] for d in (step, -step))
    derivative = here.sensitivity
    np.testing.assert_allclose(derivative[0], np.eye(4), rtol=0, atol=1e-9)
    np.testing.assert_allclose(derivative[1, :, 0], (ahead - behind) / (2 * step), rtol=0, atol=1e-5)
    assert np.abs(derivative - run().sensitivity).max() > 0.05


@pytest.mark.parametrize("scene", ["particle", "forced_oscillator", "rigid_body"])
@pytest.mark.parametrize("method", ["scipy-radau", "cvode-bdf", "cyrk-dop853"])
@pytest.mark.quick(method="cyrk-dop853")
def test_variational_equations_have_the_derivative_of_the_motion(method, scene):
    """By a run of their own, of the solver's accuracy, against the differences of the motion."""
    solution = cb.solve(cb.SCENES[scene].with_(t_end=2.0), method, rtol=1e-10, save_at=[1.0, 2.0])
    found = variational(solution).value
    np.testing.assert_allclose(found, solution.sensitivity, rtol=0, atol=1e-6)


# -- pairs of singular values ----------------------------------------------------------------------
LAW = cb.LAWS["pairing_drift"]
PARTICLE = cb.SCENES["particle"]


def differential(*estimates):
    return Differential("planted", np.array(estimates)[:, None])


def test_pairs_are_the_products_of_the_largest_and_the_smallest_and_so_on_inwards():
    found = pairs(differential(np.diag([2.0, 7.0, 3.0, 5.0, 99.0])), 2)
    np.testing.assert_allclose(found.values, [[7 * 2, 5 * 3]], rtol=1e-15)
    np.testing.assert_allclose(found.terms, [7 * np.hypot(7, 5)], rtol=1e-15)
    assert found.uncertainty is None


def test_of_several_estimates_the_two_that_agree_best_give_the_value_and_its_error_bar():
    found = pairs(differential(*(np.diag([2.0, b, 1.0]) for b in (1.3, 1.01, 1.0, 1.1))), 1)
    np.testing.assert_allclose(found.values, [[2.02]], rtol=1e-15)
    np.testing.assert_allclose(found.uncertainty, [SAFETY * 0.02], rtol=1e-12)


@pytest.mark.parametrize("method", ["rk4", "herglotz1", "herglotz2"])
def test_other_steps_pair_to_their_order_only(method):
    """The factor of a Herglotz step is another than e^{−γh}."""
    found = [LAW(cb.solve(PARTICLE, method, step=h, save_at=saved(PARTICLE))) for h in (0.05, 0.025)]
    assert found[0] > 1e-7
    assert np.log2(found[0] / found[1]) == pytest.approx(cb.METHODS[method].order, abs=0.2)
