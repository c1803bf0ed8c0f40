"""No reference is wrong: pulses, steps and ramps in time against DOP853; what an engine would step over is found."""

import bisect
import importlib
import itertools
import math

import mpmath
import numpy as np
import pytest
from scipy.integrate import DOP853

import contactbench as cb
from cases import Ticks, after_pulse, bodies, chain, few_slow, masses, mine, pulse, refusal
from contactbench.numbers.functions import cos, cosh, exp, sin, tanh
from contactbench.scene import DrivenState
from contactbench.truth import OutOfTime, two_solvers
from contactbench.truth.reference import confirmed
from contactbench.truth.survey import Survey
from contactbench.truth.two_solvers import doubles

#: of all seeds those that are quick, one of each kind, and a jump reached by steps that sum up to a little more
QUICK, ALL = (2, 18, 20, 28, 54, 73), 240


def bell(x):
    return exp(-(x * x))


def hump(x):
    return 1 / (1 + x * x) ** 4


def soliton(x):
    return 1 / cosh(0.5 * tanh(x / 100) * 200) ** 2  # x/100 keeps cosh within the range of floats


SHAPES = {"bell": (bell, 7.0), "hump": (hump, 60.0), "soliton": (soliton, 25.0)}
WELLS = {
    "free": (lambda q: 0.0 * q, lambda q: 0.0 * q),
    "spring": (lambda q: q * q / 2, lambda q: q),
    "pendulum": (lambda q: -cos(q), sin),
    "double well": (lambda q: q * q * (q * q / 4 - 0.5), lambda q: q * (q * q - 1)),
}


def scene(seed):
    """Return a driven scene, and what `followed` needs of it: force and damping in floats, where steps are short."""
    rng = np.random.default_rng(seed)
    kind = ("pulse", "pulse", "step", "jump", "ramp", "moving", "damping")[seed % 7]
    t_end = float(rng.uniform(5, 40 if kind != "moving" else 10))
    well, slope = WELLS[rng.choice([*WELLS])]
    start = (0.0, 0.0) if rng.random() < 0.4 else tuple(rng.uniform(-1, 1, 2).tolist())
    gamma, size = float(rng.uniform(0, 0.3)), float(rng.uniform(0.1, 3) * rng.choice([-1, 1]))
    count = int(rng.integers(1, 4)) if kind == "pulse" else 1
    at = np.sort(rng.uniform(0, t_end, count)).tolist()
    least = {"pulse": 1e-3, "step": 1e-4, "ramp": t_end / 20, "damping": 3e-3}.get(kind, 1e-2)
    width = float(np.exp(rng.uniform(math.log(least), math.log(max(1.0, 4 * least)))))
    shape, reach = SHAPES[rng.choice([*SHAPES])]
    more, rate = {}, None
    if kind in ("pulse", "damping"):
        profile = lambda t: sum(shape((t - c) / width) for c in at)  # noqa: E731
    elif kind == "jump":
        profile, reach = lambda t: 1.0 if t < at[0] else -0.5, 0.0
        more = {"breaks": tuple(at)}
    else:
        profile, reach = lambda t: tanh((t - at[0]) / width), 20.0
    V = lambda q, t: well(q[0]) - size * q[0] * profile(t)  # noqa: E731
    force = lambda q, t: size * profile(t) - slope(q)  # noqa: E731
    if kind == "moving":
        width, slow = 0.02, float(rng.uniform(0.5, 1.5))
        V = lambda q, t: q[0] * q[0] / 2 - 0.3 * bell((q[0] - 3 * sin(slow * t)) / width)  # noqa: E731
        force = lambda q, t: (  # noqa: E731
            -q - 0.6 * (x := (q - 3 * sin(slow * t)) / width) / width * bell(x)
        )
    if kind == "damping":
        gamma, rate = 0.0, lambda t: 0.1 + abs(size) / width**0.5 * profile(t)
        V, force = (lambda q, t: well(q[0]) - q[0]), (lambda q, t: 1 - slope(q))
    made = cb.Driven(
        name=f"{kind} {seed}",
        potential=V,
        gradient=(lambda q, t: (-force(q[0], t),)) if kind == "jump" else None,
        gamma=gamma,
        rate=rate,
        q=start[:1],
        p=start[1:],
        t_end=t_end,
        **more,
    )
    places = [(c, width / 2, reach * width) for c in at]
    known = {"force": force, "rate": rate or (lambda t: gamma), "y": start, "end": t_end, "places": places}
    return made, known | {"longest": 1e-3 if kind == "moving" else 0.1}


def followed(force, rate, y, end, places, longest=0.1, atol=1e-13):
    """Return (q, p) at the end by DOP853; places : where steps are short, how long they may be, and how far around."""
    bounds = {0.0, end, *(c + side * reach for c, _, reach in places for side in (-1, 1))}
    for a, b in itertools.pairwise(sorted(t for t in bounds if 0 <= t <= end)):

        def slope(t, y, a=a, b=b):  # within the piece, also where it ends
            t = min(max(t, math.nextafter(a, b)), math.nextafter(b, a))
            return y[1], force(y[0], t) - rate(t) * y[1]

        steps = [step for c, step, reach in places if c - reach <= (a + b) / 2 <= c + reach]
        solver = DOP853(slope, a, y, b, rtol=1e-12, atol=atol, max_step=min([longest, *steps]))
        while solver.status == "running":
            solver.step()
        y = solver.y
    return y


@pytest.mark.parametrize("seed", few_slow(range(ALL), *{*range(ALL)} - {*QUICK}))
def test_no_reference_of_a_driven_scene_is_wrong(seed):
    made, known = scene(seed)
    found, true = cb.reference(made, [made.t_end], ()), followed(**known)
    # round-off of DOP853, which grows with the motion
    assert np.abs(found.y[0, :2] - true).max() <= 1e-8 * max(1.0, np.abs(true).max())


# -- what is small beside the rest of a motion, seen where it decides -----------------------------------
SPRING, DOUBLE = WELLS["spring"], WELLS["double well"]
#: well, γ, q at the start, end, and (height, centre, width) of its pulses
CASES = {
    "an ordinary pulse on rest": (SPRING, 0.1, 0.0, 22.0, [(70.0, 6.5, 0.1)]),
    "a later one": (SPRING, 0.1, 0.0, 22.0, [(70.0, 16.5, 0.1)]),
    "a narrow one": (SPRING, 0.1, 0.0, 30.0, [(1.0, 6.5, 0.05)]),
    "after decay": (SPRING, 1.0, 1000.0, 60.0, [(1e-6, 55.0, 0.03)]),
    "after a large one": (SPRING, 1.0, 0.0, 60.0, [(100.0, 5.0, 0.1), (1e-7, 55.0, 0.02)]),
    "before a large one": (DOUBLE, 0.1, 0.0, 30.0, [(1e-7, 5.3, 0.002), (10.0, 29.0, 0.02)]),
    "before a much larger one": (DOUBLE, 0.1, 0.0, 30.0, [(1e-9, 5.3, 0.002), (1e3, 29.0, 0.02)]),
    "weak and broad": (SPRING, 0.1, 0.0, 30.0, [(1e-4, 5.3, 0.3)]),
    "off a hilltop": (DOUBLE, 0.1, 0.0, 30.0, [(1e-8, 5.3, 0.02)]),
    "on a motion": (DOUBLE, 0.1, 1.3, 30.0, [(1e-6, 13.3, 0.02)]),
}

#: of which another shows the same, seldom run
LONG = tuple(case for case in CASES if case not in ("a narrow one", "after a large one"))


def force_of(pulses, xp_exp):
    return lambda t: sum(a * xp_exp(-(((t - c) / w) ** 2)) for a, c, w in pulses)


def kicked(slope, gamma, q, end, pulses):
    """Return (q, p) behind pulses, which may be faint."""
    pulse = force_of(pulses, np.exp)
    places = [(c, w / 5, 9 * w) for _, c, w in pulses]
    return followed(lambda q, t: pulse(t) - slope(q), lambda t: gamma, [q, 0.0], end, places, 0.05, 1e-26)


@pytest.mark.parametrize("case", few_slow(CASES, *LONG))
def test_a_pulse_is_seen_at_the_scale_of_what_it_changes(case):
    (well, slope), gamma, q, end, pulses = CASES[case]
    kick = force_of(pulses, exp)
    scene = mine(lambda q, t: well(q[0]) - q[0] * kick(t), q, t_end=end, kind=cb.Driven, gamma=gamma)
    found, true = cb.reference(scene, [end], ()), kicked(slope, gamma, q, end, pulses)
    assert np.abs(found.y[0, :2] - true).max() <= 1e-9 * np.abs(true).max()
    assert found.digits > 12


def test_a_component_beside_a_huge_one_has_a_scale_of_its_own():
    kick = force_of([(1.0, 3.3, 0.01)], exp)
    potential = lambda q, t: (q[0] ** 2 + q[1] ** 2) / 2 - q[0] * kick(t)  # noqa: E731
    scene = cb.Driven(name="two", potential=potential, gamma=0.1, q=(0.0, 1e12), p=(0.0, 0.0), t_end=5.0)
    true = kicked(SPRING[1], 0.1, 0.0, 5.0, [(1.0, 3.3, 0.01)])
    np.testing.assert_allclose(cb.reference(scene, [5.0], ()).y[0, [0, 2]], true, rtol=1e-9)


def test_a_division_that_heyoka_makes_a_product_is_seen_in_a_pulse_that_is_over():
    """(t − 30)/3 is (t − 30)·0.333… to heyoka, with the third of a double: p ends 16 digits off."""
    width = 3
    pulse = lambda q, t: -q[0] * exp(-(((t - 30) / width) ** 2))  # noqa: E731
    scene = mine(pulse, 0.0, t_end=90.0, kind=cb.Driven, gamma=0.0)
    found = cb.reference(scene, [90.0], ())
    with mpmath.workdps(50):
        a, b = (mpmath.mpf(t) / width for t in (60, 30))
        true = width * mpmath.sqrt(mpmath.pi) / 2 * (mpmath.erf(a) + mpmath.erf(b))
        off = abs(mpmath.mpf(found.decimals[0][1]) / true - 1)
    assert found.digits > 20
    assert off < 10.0 ** (1 - found.digits)


def test_a_narrow_box_is_a_jump_and_no_singularity():
    width, height = 5e-5, 1e4
    box = lambda q, t: -q[0] * cb.math.where(abs(t - 3.0) < width, height, 0.0)  # noqa: E731
    scene = mine(box, 0.0, t_end=5.0, kind=cb.Driven, gamma=0.0)
    with pytest.raises(cb.BadInput, match=r"jumps at t = 2\.99"):
        cb.reference(scene, [5.0], ())
    named = cb.reference(scene.with_(breaks=(3.0 - width, 3.0 + width)), [5.0], ())
    true = np.array([2.0, 1.0]) * 2 * width * height
    assert np.abs(named.y[0, :2] / true - 1).max() <= 10.0**-named.digits


def test_a_jump_that_nobody_names_is_to_be_named():
    """A force of 1 from t = 2 on, by floats."""
    force = lambda t: float(t > 2.0)  # noqa: E731
    gradient = lambda q, t: (-force(t),)  # noqa: E731
    scene = mine(lambda q, t: -q[0] * force(t), 0.0, t_end=5.0, kind=cb.Driven, gradient=gradient)
    says = "jumps at t = 2 after the start: name the time in breaks="
    assert says in refusal(lambda: cb.reference(scene, [5.0], ()))


def test_a_closed_form_that_leaves_a_pulse_out_is_no_truth(monkeypatch):
    """One survey of the whole motion serves the look at the closed form, at any number of times, and the reference."""
    ends, begin = [], Survey.__post_init__
    monkeypatch.setattr(Survey, "__post_init__", lambda survey: (ends.append(survey.end), begin(survey)))
    kick = force_of([(1.0, 9.0, 1 / 16)], exp)
    given = lambda scene, t, xp: DrivenState((xp.cos(t),), (-xp.sin(t),), t, None)  # noqa: E731
    V = lambda q, t: q[0] ** 2 / 2 - q[0] * kick(t)  # noqa: E731
    scene = mine(V, t_end=20.0, kind=cb.Driven, gamma=0.0, exact=given)
    true = kicked(SPRING[1], 0.0, 1.0, 20.0, [(1.0, 9.0, 1 / 16)])
    found = cb.reference(scene, [3.0, 12.0, 20.0], ())
    np.testing.assert_allclose(found.y[-1, :2], true, rtol=1e-9)
    assert ends == [20.0]


def test_two_solvers_of_a_motion_at_rest_agree_on_it():
    """A force that heyoka does not have, zero at the start and for good: 0/0 was the digits of the truth."""
    where = cb.math.where
    V = lambda q, t: q[0] ** 2 * where(t < 5, 0.5, 1.0)  # noqa: E731
    scene = mine(V, 0.0, t_end=10.0, kind=cb.Driven, gamma=0.1, breaks=(5.0,))
    found = cb.reference(scene, [10.0], ())
    assert (found.source, found.digits) == ("two solvers", 15)
    assert np.array_equal(found.y[0, :2], [0.0, 0.0])


def test_a_refusal_of_a_scene_with_time_names_breaks(monkeypatch):
    V = lambda q, t: q[0] ** 2 / 2 - q[0] * bell((t - 9.0) * 16)  # noqa: E731
    rough = mine(V, t_end=20.0, kind=cb.Driven, gamma=0.1)
    monkeypatch.setattr("contactbench.truth.survey.PIECES", 10)
    survey = Survey(rough, (), 20.0)
    survey.stops  # noqa: B018
    assert "too rough at t = " in str(survey.ended)
    assert str(survey.ended).endswith("name the times in breaks=")


# -- the survey of a motion: what an engine would step over is found ---------------------------------
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
