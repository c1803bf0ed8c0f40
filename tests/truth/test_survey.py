"""The survey of a motion: what an engine would step over is found, and a wrong truth is refused."""

import bisect
import importlib

import numpy as np
import pytest

import contactbench as cb
from cases import Ticks, after_pulse, bodies, chain, few_slow, masses, mine, pulse, refusal
from contactbench.numbers.functions import exp
from contactbench.truth import OutOfTime, two_solvers
from contactbench.truth.reference import confirmed
from contactbench.truth.survey import Survey
from contactbench.truth.two_solvers import doubles


def bell(x):
    return exp(-(x * x))


@pytest.mark.parametrize("width", few_slow([0.3, 3e-4], 0.3))
def test_a_pulse_that_finds_the_motion_at_rest_is_in_the_truth(width):
    """Both precisions of heyoka and extrapolation step over it by themselves."""
    found = cb.reference(pulse(width), [20.0], ())
    assert found.y[0, :2] == pytest.approx(after_pulse(width), abs=1e-13)
    assert found.digits >= 20


@pytest.mark.slow
def test_a_second_engine_confirms_a_pulse():
    assert confirmed(cb.reference(pulse(0.3), [20.0], ())) >= 15


def test_a_narrow_barrier_is_in_the_truth_of_a_scene_without_time():
    """A free particle is slowed for a moment: ∫ (1/√(1 − 2V) − 1) dq behind a flight at speed one."""
    scene = mine(lambda q: 0.1 * bell((q[0] - 3) / 0.01), q=0.0, p=1.0, t_end=6.0)
    x = np.linspace(-0.08, 0.08, 4001)
    late = (1 / np.sqrt(1 - 0.2 * np.exp(-((x / 0.01) ** 2))) - 1).sum() * (x[1] - x[0])
    found = cb.reference(scene, [6.0], ())
    assert late > 1e-3
    assert found.y[0] == pytest.approx([6.0 - late, 1.0], abs=1e-12)


def test_states_that_do_not_lead_to_each_other_are_refused(monkeypatch):
    """Engines that step over the pulse after all."""
    monkeypatch.setattr(Survey, "density", 0.0, raising=False)
    scene, module = pulse(0.3, gamma=0.11), importlib.import_module("contactbench.truth.reference")
    plain = module.taylor
    monkeypatch.setattr(module, "taylor", lambda *a, stops, **k: plain(*a, **k))
    assert "two engines disagree before t = " in refusal(lambda: cb.reference(scene, [20.0], ()))


@pytest.mark.parametrize(
    ("slope", "exact"),
    [
        (lambda y: 1.0, lambda t: t),
        (lambda y: 1 - y**2, np.tanh),
        (lambda y: 1 + y**2, np.tan),
        (lambda y: 3.0 * cb.math.cos(y), lambda t: 2 * np.arctan(np.tanh(1.5 * t))),
    ],
)
def test_a_slope_that_does_not_vanish_where_the_state_does_is_no_rough_one(slope, exact):
    """The state is then known far better than its slope, whose rounding alone was read as a force of time."""
    scene = cb.Equations(name="from zero", rhs=lambda t, y: (slope(y[0]),), y0=(0.0,), t_end=1.5)
    found = cb.reference(scene, [0.75, 1.5])
    assert found.digits >= 15
    np.testing.assert_allclose(found.y[:, 0], exact(np.array([0.75, 1.5])), rtol=1e-15)


def test_the_pole_of_a_motion_from_zero_is_said():
    scene = cb.Equations(name="pole", rhs=lambda t, y: (1 + y[0] ** 2,), y0=(0.0,), t_end=3.0)
    with pytest.raises(cb.BadInput, match=r"the trajectory blows up at t = 1\.5708"):
        cb.reference(scene, [3.0])


def test_two_solvers_that_agree_on_no_digit_are_refused(monkeypatch):
    module = importlib.import_module("contactbench.truth.two_solvers")
    monkeypatch.setattr(module, "by_scipy", lambda slope, y, times, **_: [y + 1.0 for _ in times])
    scene = cb.SCENES["oscillator"]
    assert "agree on no digit" in refusal(lambda: doubles(scene, np.array([1.0]), (), np.inf))


def test_two_solvers_reach_a_jump_to_round_off():
    """Their steps do not sum up the time: a few roundings late, ten digits would agree."""
    at = [0.7 + 1.9 * k for k in range(4)]
    side = lambda t: float(bisect.bisect(at, float(t)) % 2)  # noqa: E731  # float() refuses to be recorded
    V, gradient = (lambda q, t: q[0] ** 2 / 2 - q[0] * side(t)), (lambda q, t: (q[0] - side(t),))
    scene = mine(V, 0.3, t_end=8.0, kind=cb.Driven, gradient=gradient, gamma=0.1, breaks=at)
    found = cb.reference(scene, [8.0], ())
    assert found.source == "two solvers"
    assert found.digits >= 12


# -- fast motion is no blow-up -----------------------------------------------------------------------
@pytest.mark.parametrize(("rate", "span"), few_slow([(1e7, 1e6), (1e5, 3e7)], (1e5, 3e7)))
def test_a_stiff_motion_has_the_truth_of_two_implicit_solvers(rate, span):
    """q = e^{−t/γ}, to 1/γ²; explicit solvers would take 10¹² steps."""
    scene = mine(lambda q: q[0] ** 2 / 2, t_end=span, gamma=rate)
    t = min(span, 3 * rate)
    found = cb.reference(scene, [t], (), seconds=6)
    assert found.source == "two solvers"
    assert found.y[0, 0] == pytest.approx(np.exp(-t / rate), rel=1e-9)


@pytest.mark.parametrize("omega", few_slow([1e7, 3e9], 3e9))
def test_a_fast_motion_that_cannot_be_afforded_is_said_to_be_that(omega):
    scene = mine(lambda q: omega**2 * q[0] ** 2 / 2, t_end=1e7, gamma=0.1)
    with pytest.raises(OutOfTime, match="in the time it was given"):
        cb.reference(scene, [1e7], (), seconds=1)


@pytest.mark.parametrize("digits", [12, 30])
def test_extrapolation_takes_fast_motion_for_no_singularity(digits, monkeypatch):
    """10¹³ periods lie ahead; 1e-12 of the span is not a step of it."""
    engines = importlib.import_module("contactbench.truth.engines")
    scene = cb.SCENES["oscillator"].with_(omega=1e9, gamma=0.0, q=(1.0,), p=(0.0,), t_end=1e5)
    for engine, setting in ((engines.extrapolation, digits), (engines.taylor, 140)):
        monkeypatch.setattr(engines, "perf_counter", Ticks())
        with pytest.raises(engines.OutOfTime):
            engine(scene, ["100000.0"], (), setting, deadline=100.0)


def test_a_wall_that_a_trial_step_goes_far_beyond_has_a_truth():
    """There q⁴⁰ is no number any more: the step is too long, not the motion lost."""
    wall = mine(lambda q: q[0] ** 40 / 40, 0.1, 1.5, 2.0, gamma=0.05)
    assert cb.reference(wall, [2.0]).digits >= 20


# -- two solvers in double precision, where high precision takes too long ----------------------------
def digits(found, true):
    return -np.log10(np.abs(found - true).max() / np.abs(true).max())


LIVE = {
    "ring": chain(8, t_end=1.5),
    "free": chain(8, "free", mass=masses(8), t_end=1.5),
    "bodies": bodies(3, 3, t_end=1.5),
    "damped": chain(8, "fixed", gamma=6.0, t_end=1.5),
}


@pytest.mark.parametrize("name", few_slow(LIVE, "ring", "damped", "free"))
def test_two_solvers_in_doubles_have_the_digits_that_they_say(name):
    """Against 30 digits by other engines, component by component."""
    scene, times = LIVE[name], np.array([0.2, 0.4])
    found, known = two_solvers.doubles(scene, times, ("s",), np.inf)
    true = cb.reference(scene, times)
    assert true.digits >= 20
    assert digits(found, true.y) >= known >= 10


@pytest.mark.filterwarnings("error")
def test_what_leaves_has_no_reference():
    scene = mine(lambda q: -(q[0] ** 4), 2.0, t_end=20.0, gamma=0.1)
    with pytest.raises(cb.BadInput, match="cannot be followed to t = 20"):
        two_solvers.doubles(scene, np.array([20.0]), (), np.inf)


def test_a_reference_out_of_time_says_so():
    with pytest.raises(cb.BadInput, match="allow it more"):
        cb.reference(chain(64, t_end=1e5), [1e5], seconds=0.5)


def test_where_high_precision_is_late_two_solvers_take_over(monkeypatch):
    module = importlib.import_module("contactbench.truth.reference")

    def late(*_, **__):
        raise OutOfTime("late")

    monkeypatch.setattr(module, "live", late)
    found = cb.reference(chain(6), [0.9])
    assert (found.source, found.decimals) == ("two solvers", [])
    assert found.digits >= 10
