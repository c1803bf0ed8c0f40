"""What is small beside the rest of a motion is seen where it decides: at rest, after decay, beside other scales."""

import itertools

import mpmath
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import contactbench as cb
from contactbench.numbers.functions import exp
from contactbench.scene import DrivenState
from contactbench.truth.survey import Survey

SPRING, DOUBLE = (
    (lambda q: q * q / 2, lambda q: q),
    (lambda q: q * q * (q * q / 4 - 0.5), lambda q: q * (q * q - 1)),
)
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


def force_of(pulses, xp_exp):
    return lambda t: sum(a * xp_exp(-(((t - c) / w) ** 2)) for a, c, w in pulses)


def followed(slope, gamma, q, end, pulses):
    """Return (q, p) by DOP853, in stretches and by short steps where a pulse is."""
    pulse = force_of(pulses, np.exp)
    bounds = sorted({0.0, end, *(min(c + k * 9 * w, end) for _, c, w in pulses for k in (-1, 0, 1))})
    y = [q, 0.0]
    for a, b in itertools.pairwise(bounds):
        longest = min([0.05, *(w / 5 for _, c, w in pulses if abs((a + b) / 2 - c) < 9 * w)])
        found = solve_ivp(
            lambda t, y: [y[1], pulse(t) - slope(y[0]) - gamma * y[1]],
            (a, b),
            y,
            method="DOP853",
            rtol=1e-12,
            atol=1e-26,
            max_step=longest,
        )
        y = found.y[:, -1]
    return y


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_a_pulse_is_seen_at_the_scale_of_what_it_changes(case):
    (well, slope), gamma, q, end, pulses = case
    kick = force_of(pulses, exp)
    scene = cb.Driven(
        name="faint",
        potential=lambda q, t: well(q[0]) - q[0] * kick(t),
        gamma=gamma,
        q=(q,),
        p=(0.0,),
        t_end=end,
    )
    found, true = cb.reference(scene, [end], ()), followed(slope, gamma, q, end, pulses)
    assert np.abs(found.y[0, :2] - true).max() <= 1e-9 * np.abs(true).max()
    assert found.digits > 12


def test_a_component_beside_a_huge_one_has_a_scale_of_its_own():
    kick = force_of([(1.0, 13.3, 0.01)], exp)
    potential = lambda q, t: (q[0] ** 2 + q[1] ** 2) / 2 - q[0] * kick(t)  # noqa: E731
    scene = cb.Driven(name="two", potential=potential, gamma=0.1, q=(0.0, 1e12), p=(0.0, 0.0), t_end=20.0)
    true = followed(SPRING[1], 0.1, 0.0, 20.0, [(1.0, 13.3, 0.01)])
    np.testing.assert_allclose(cb.reference(scene, [20.0], ()).y[0, [0, 2]], true, rtol=1e-9)


def test_the_shortest_of_times_has_a_reference():
    scene = cb.Mechanical(name="own", potential=lambda q: q[0] ** 4, gamma=0.1, q=(1.0,), p=(0.0,), t_end=1.0)
    assert cb.reference(scene, [1e-320], ()).y[0, 0] == 1.0


@pytest.mark.parametrize("width", [3, 7, 0.7])
def test_a_division_that_heyoka_makes_a_product_is_seen_in_a_pulse_that_is_over(width):
    """(t − 30)/3 is (t − 30)·0.333… to heyoka, with the third of a double: p ends 16 digits off."""
    pulse = lambda q, t: -q[0] * exp(-(((t - 30) / width) ** 2))  # noqa: E731
    scene = cb.Driven(name="free", potential=pulse, gamma=0.0, q=(0.0,), p=(0.0,), t_end=90.0)
    found = cb.reference(scene, [90.0], ())
    with mpmath.workdps(50):
        a, b = (mpmath.mpf(t) / width for t in (60, 30))
        true = width * mpmath.sqrt(mpmath.pi) / 2 * (mpmath.erf(a) + mpmath.erf(b))
        off = abs(mpmath.mpf(found.decimals[0][1]) / true - 1)
    assert found.digits > 20
    assert off < 10.0 ** (1 - found.digits)


def test_a_ramp_that_begins_on_rest_is_no_singularity():
    begin, end = 1.2345, 5.0
    ramp = lambda q, t: -q[0] * cb.math.where(t > begin, t - begin, 0.0)  # noqa: E731
    scene = cb.Driven(name="ramp", potential=ramp, gamma=0.0, q=(0.0,), p=(0.0,), t_end=end)
    true = (end - begin) ** 3 / 6, (end - begin) ** 2 / 2
    np.testing.assert_allclose(cb.reference(scene, [end], ()).y[0, :2], true, rtol=1e-12)


@pytest.mark.parametrize(("width", "height"), [(5e-3, 1e2), (5e-4, 1e3), (5e-5, 1e4)])
def test_a_narrow_box_is_a_jump_and_no_singularity(width, height):
    box = lambda q, t: -q[0] * cb.math.where(abs(t - 3.0) < width, height, 0.0)  # noqa: E731
    kick = {"potential": box, "gamma": 0.0, "q": (0.0,), "p": (0.0,), "t_end": 5.0}
    with pytest.raises(cb.BadInput, match=r"jumps at t = 2\.99"):
        cb.reference(cb.Driven(name="box", **kick), [5.0], ())
    named = cb.reference(cb.Driven(name="box", **kick, breaks=(3.0 - width, 3.0 + width)), [5.0], ())
    true = np.array([2.0, 1.0]) * 2 * width * height
    assert np.abs(named.y[0, :2] / true - 1).max() <= 10.0**-named.digits


def test_a_closed_form_that_leaves_a_pulse_out_is_no_truth(monkeypatch):
    """One survey of the whole motion serves the look at the closed form, at any number of times, and the reference."""
    ends, begin = [], Survey.__post_init__
    monkeypatch.setattr(Survey, "__post_init__", lambda survey: (ends.append(survey.end), begin(survey)))
    kick = force_of([(1.0, 9.0, 1 / 16)], exp)
    given = lambda scene, t, xp: DrivenState((xp.cos(t),), (-xp.sin(t),), t, None)  # noqa: E731
    scene = cb.Driven(
        name="kicked",
        potential=lambda q, t: q[0] ** 2 / 2 - q[0] * kick(t),
        gamma=0.0,
        q=(1.0,),
        p=(0.0,),
        t_end=20.0,
        exact=given,
    )
    true = followed(SPRING[1], 0.0, 1.0, 20.0, [(1.0, 9.0, 1 / 16)])
    found = cb.reference(scene, [3.0, 12.0, 20.0], ())
    np.testing.assert_allclose(found.y[-1, :2], true, rtol=1e-9)
    assert ends == [20.0]


def test_two_solvers_of_a_motion_at_rest_agree_on_it():
    """A force that heyoka does not have, zero at the start and for good: 0/0 was the digits of the truth."""
    where = cb.math.where
    scene = cb.Driven(
        name="rest",
        potential=lambda q, t: q[0] ** 2 * where(t < 5, 0.5, 1.0),
        gamma=0.1,
        q=(0.0,),
        p=(0.0,),
        t_end=10.0,
        breaks=(5.0,),
    )
    found = cb.reference(scene, [10.0], ())
    assert (found.source, found.digits) == ("two solvers", 15)
    assert np.array_equal(found.y[0, :2], [0.0, 0.0])


def test_a_refusal_of_a_scene_with_time_names_breaks(monkeypatch):
    rough = cb.Driven(
        name="rough",
        potential=lambda q, t: q[0] ** 2 / 2 - q[0] * exp(-(((t - 9.0) * 16) ** 2)),
        gamma=0.1,
        q=(1.0,),
        p=(0.0,),
        t_end=20.0,
    )
    monkeypatch.setattr("contactbench.truth.survey.PIECES", 10)
    survey = Survey(rough, (), 20.0)
    survey.stops  # noqa: B018
    assert "too rough at t = " in str(survey.ended)
    assert str(survey.ended).endswith("name the times in breaks=")
