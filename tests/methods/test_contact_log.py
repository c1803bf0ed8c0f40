"""Steps that follow the motion: the flows of the logarithmic Hamiltonian, and what is made of them."""

import math
from contextlib import nullcontext
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest

import contactbench as cb
from contactbench.measure.order import fastest
from contactbench.methods.contact_log import Base
from contactbench.methods.fixed_step import with_counters
from contactbench.methods.runge_kutta import table
from contactbench.numbers.control import repeat
from contactbench.scene import State
from contactbench.truth import decimal_context, with_decimals

METHOD = cb.METHODS["contact-log8"]
KEPLER, DRAG = cb.SCENES["kepler"], cb.SCENES["kepler_drag"]
#: no closed orbits, two masses, and a damping that is felt
BENT = cb.Mechanical(
    name="bent",
    potential=lambda q: -((q[0] * q[0] + q[1] * q[1] + 0.04) ** -0.5) - 0.1 * q[0] * (1 + q[1] * q[1]) ** -1,
    q=(0.9, 0.1),
    p=(0.1, 0.8),
    s=0.3,
    gamma=0.05,
    mass=(1.0, 1.7),
    t_end=6.0,
)


def after(method, t, step, context):
    """The state at a time at 50 digits."""
    xp = fastest(context)
    with getattr(xp, "context", nullcontext()):
        twin = with_decimals(BENT, xp.mpf)
        x, zero = twin.initial(("s",)), xp.mpf(0)
        beside = [zero] * method.beside(len(twin.pack(x)))
        x, (*_, lag) = method.march(twin, x, beside, xp.mpf(t), 10**6, [xp.mpf(step)], xp)
        assert lag == 0
        return [context.mpf(str(c)) for c in twin.pack(x)]


def order(method, runs=4):
    """By differences between runs of halving steps of τ, extrapolated to none: the time is met whatever they are."""
    context = decimal_context(50)
    ends = [after(method, "1.0", f"{0.2 / 2**k}", context) for k in range(runs)]
    gaps = [context.norm([a - b for a, b in zip(*pair, strict=True)]) for pair in pairwise(ends)]
    slopes = [float(context.log(a / b, 2)) for a, b in pairwise(gaps)]
    return slopes[-1] + sum(np.diff(slopes)) / 3


def test_it_has_its_order_in_steps_of_tau_and_a_wrong_coefficient_another():
    assert order(METHOD) == pytest.approx(8, abs=0.12)
    stages = list(METHOD.composition.stages)
    stages[1] = stages[1][0], stages[1][1] * Fraction(101, 100)
    assert order(replace(METHOD, composition=replace(METHOD.composition, stages=tuple(stages))), 3) < 7


def whole(scene, y, step, context):
    """One step as a map of (q, P, t, E, S), e^{γt} put back."""
    n, g = len(scene.q), scene.gamma
    q, P, (t, E, S) = tuple(y[:n]), y[n : 2 * n], y[2 * n :]
    shrink = context.exp(-g * t)
    x = State(q, tuple(shrink * c for c in P), shrink * S)
    zero = context.mpf(0)
    base = Base(x, shrink * E, zero, context.mpf(100), zero, shrink * step)
    shares = [table([c for _, c in METHOD.composition.stages[i::2]], context, None) for i in (0, 1)]
    end, _ = METHOD.step(scene, base, context.mpf(1), shares, context, repeat)
    grow = context.exp(g * (t + end.t))
    return [
        *end.x.q,
        *(grow * c for c in end.x.p),
        t + end.t,
        grow * (base.depth + end.depth),
        grow * end.x.s,
    ]


def test_a_step_keeps_the_contact_form_of_the_extended_space():
    """ds − P dq − E dt, by central differences at 50 digits, from a point off Λ = 0, too."""
    context = decimal_context(50)
    scene = with_decimals(BENT, context.mpf)
    y = [context.mpf(c) for c in ("0.8", "-0.3", "0.4", "0.7", "2.5", "0.35", "-0.6")]
    increment, step = context.mpf("1e-16"), context.mpf("0.1")
    end = whole(scene, y, step, context)

    def form(y, v):
        return v[6] - y[2] * v[0] - y[3] * v[1] - y[5] * v[4]

    for i in range(7):
        unit = [context.mpf(i == j) for j in range(7)]
        sides = [[a + way * increment * b for a, b in zip(y, unit, strict=True)] for way in (1, -1)]
        ends = [whole(scene, side, step, context) for side in sides]
        moved = [(a - b) / (2 * increment) for a, b in zip(*ends, strict=True)]
        assert abs(form(end, moved) - form(y, unit)) < 1e-28


def test_it_is_of_order_eight_where_fixed_steps_see_nothing():
    """Eccentricity 0.9, T = 100: what a fixed step cannot afford."""
    solution = cb.solve(DRAG, "contact-log8", step=0.2, save_at=[100.0])
    other = cb.solve(DRAG, "contact-rkn6", step=100 / 4000, save_at=[100.0])
    assert 4 * solution.counts.evaluations < other.counts.evaluations
    assert cb.LAWS["solution_error"](solution) < 3e-11  # of p, the larger of two
    assert cb.LAWS["solution_error"](other) > 1e-5


def test_angular_momentum_decays_exactly_and_the_rest_does_not():
    solution = cb.solve(DRAG, "contact-log8", step=0.2, save_at=[20.0, 50.0, 100.0])
    assert cb.LAWS["momentum_law"](solution) < 1e-12
    claims = [law for law in cb.LAWS.values() if law.applies(DRAG) and law.claimed(solution)]
    assert [law.name for law in claims] == ["momentum_law"]
    assert 1e-8 < cb.LAWS["contact_drift"](cb.solve(KEPLER, METHOD, step=0.8, save_at=[8.0])) < 1e-2


def test_the_error_of_the_energy_does_not_grow():
    """Over 600 revolutions of an orbit that does not close; Runge–Kutta's grows with the time and more."""
    scene = BENT.with_(gamma=1e-4, t_end=3000.0)
    grown = {}
    for name, step in (("contact-log8", 0.3), ("rk4", 0.02)):
        solution = cb.solve(scene, name, step=step, save_at=np.arange(1, 601) * 5.0)
        H = scene.hamiltonian(solution.states()) * np.exp(scene.gamma * solution.t)
        off = np.abs(H - scene.hamiltonian(scene.initial(("s",))))
        assert off[:60].max() > 1e-8  # no round-off
        grown[name] = off.max() / off[:60].max()
    assert grown["contact-log8"] < 3
    assert grown["rk4"] > 10


def test_steps_do_not_depend_on_the_saved_times():
    one = cb.solve(DRAG, "contact-log8", step=0.2, save_at=[40.0])
    many = cb.solve(DRAG, "contact-log8", step=0.2, save_at=np.arange(1, 401) / 10)
    np.testing.assert_allclose(many.y[-1], one.y[-1], rtol=0, atol=1e-11)
    assert cb.LAWS["momentum_law"](many) < 1e-12
    assert abs(many.counts.steps - 400 - (one.counts.steps - 1)) <= 1


@pytest.mark.parametrize("carry", [(), ("s",)])
def test_engines_agree_and_count_the_same(carry):
    runs = [
        cb.solve(BENT, "contact-log8", step=0.2, save_at=[2.0, 6.0], carry=carry, engine=engine)
        for engine in ("llvm", "python")
    ]
    np.testing.assert_allclose(runs[0].y, runs[1].y, rtol=0, atol=1e-12)
    assert runs[0].counts == runs[1].counts
    accurate = cb.solve(BENT, "scipy-dop853", rtol=1e-12, save_at=[2.0, 6.0], carry=carry)
    fine = cb.solve(BENT, "contact-log8", step=0.1, save_at=[2.0, 6.0], carry=carry)
    np.testing.assert_allclose(fine.y, accurate.y, rtol=0, atol=1e-9)


def test_every_evaluation_is_counted():
    scene, calls = with_counters(KEPLER.with_(t_end=3.0), plain=True)
    run = cb.prepare(scene, METHOD, step=0.3, save_at=[1.0, 3.0], carry=(), engine="python")
    calls["gradient"] = 0
    assert run().counts.evaluations == calls["gradient"]


def test_other_initial_data_are_what_a_run_prepared_for_them_takes():
    run = cb.prepare(KEPLER, "contact-log8", step=0.2, save_at=[5.0])
    moved = {"q": (0.5, 0.2), "p": (-0.3, 1.1)}
    assert np.array_equal(
        run(**moved).y, cb.solve(KEPLER.with_(**moved), "contact-log8", step=0.2, save_at=[5.0]).y
    )
    assert np.array_equal(run().y, run().y)


@pytest.mark.parametrize("scale", [1e-3, 1e4])
def test_the_step_has_no_dimension(scale):
    """Another unit of length, and with it of time and momentum: the same run."""
    times = scale**1.5 * np.array([3.0, 8.0])
    q, p = (scale * c for c in KEPLER.q), (c / math.sqrt(scale) for c in KEPLER.p)
    other = KEPLER.with_(q=tuple(q), p=tuple(p), gamma=1e-3 / scale**1.5, t_end=float(times[-1]))
    first = cb.solve(KEPLER, "contact-log8", step=0.2, save_at=[3.0, 8.0], carry=())
    second = cb.solve(other, "contact-log8", step=0.2, save_at=times, carry=())
    np.testing.assert_allclose(second.q / scale, first.q, rtol=0, atol=1e-12)
    assert first.counts.steps == second.counts.steps


def test_what_it_does_not_take_is_refused_in_one_line():
    for name in ("oscillator", "rigid_body", "duffing", "quadratic_damping"):
        solution = cb.solve(name, "contact-log8", step=0.1)
        assert solution.status is cb.Status.unsupported
        assert "contact-log8 needs" in solution.message
        assert "\n" not in solution.message
    with pytest.raises(cb.BadInput, match="takes one, of τ"):
        cb.solve(KEPLER, "contact-log8", step=[0.1, 0.2], save_at=[0.3])


WELL = cb.Mechanical(name="well", potential=lambda q: q[0] ** 2 / 2 - 1, q=(1.0,), p=(1.5,), t_end=10.0)


@pytest.mark.parametrize("engine", ["llvm", "python"])
def test_a_run_that_leaves_the_well_fails_and_says_why(engine):
    solution = cb.solve(WELL, "contact-log8", step=0.02, engine=engine)
    assert solution.status is cb.Status.failed
    assert "V ≥ 0" in solution.message
    edge = math.asin(math.sqrt(2 / 3.25)) - math.atan(1 / 1.5)  # 1.5 sin t + cos t = √2
    assert 0.7 * edge < solution.end_time < edge  # steps are long where V is small
    begins = cb.prepare(WELL, "contact-log8", step=0.02, engine=engine)(q=(1.6,))
    assert begins.status is cb.Status.failed
    assert begins.end_time == 0


def test_no_run_takes_more_steps_than_allowed():
    for setting in ({"step": 0.1}, {"rtol": 1e-8}):
        solution = cb.solve(DRAG, "contact-log8", max_steps=50, **setting)
        assert solution.status is cb.Status.budget
        assert "50" in solution.message
        assert np.isnan(solution.y[-1]).all()
