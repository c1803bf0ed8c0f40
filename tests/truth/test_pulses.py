"""No reference of a driven scene is wrong: pulses, steps and ramps in time, at random and faint, against DOP853."""

import itertools
import math

import mpmath
import numpy as np
import pytest
from scipy.integrate import DOP853

import contactbench as cb
from cases import few_slow, mine
from contactbench.numbers.functions import cos, cosh, exp, sin, tanh
from contactbench.scene import DrivenState
from contactbench.truth.survey import Survey

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
