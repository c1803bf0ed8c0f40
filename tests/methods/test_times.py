"""Times: counted from the last saved time or break, functions given the start and what has passed since, added once."""

import itertools
import math

import numpy as np
import pytest

import contactbench as cb
from cases import few_slow, refusal
from contactbench.scene import Driven, Mechanical

GAMMA = 0.1
#: a method of every kind of loop, with a setting at which errors are far from round-off and from one
SETTINGS = {
    "contact-strang": {"step": 0.02},
    "contact-rkn4": {"step": 0.1},
    "contact-bm6": {"step": 0.1},
    "contact-rkn6": {"step": 0.1},
    "contact-rkn8": {"step": 0.1},
    "contact-o8": {"step": 0.1},
    "contact-gauss4": {"step": 0.1},
    "herglotz2": {"step": 0.02},
    "rk4": {"step": 0.05},
    "rk8": {"step": 0.1},
    "rkn8": {"step": 0.1},
    "rkn12": {"step": 0.2},
    "rk8-7": {"rtol": 1e-8},
    "rkn8-6": {"rtol": 1e-8},
    "rkn12-10": {"rtol": 1e-8},
    "cvode-adams": {"rtol": 1e-7},
    "cyrk-dop853": {"rtol": 1e-6},
    "heyoka-taylor": {"rtol": 1e-9},
}
every = pytest.mark.parametrize("name", SETTINGS)
#: those that do not iterate, nor are another library's
OURS = [name for name in SETTINGS if not cb.METHODS[name].own_time]


def pushed(start, end, forces=(1.0,), breaks=(), turn=0.7, **changes):
    """q'' = −q − γq' + f cos(turn (t − start)), f one after the other of some forces, from break to break.

    All of them are parameters, so that scenes of as many breaks share their programs.
    """
    named = {f"force{k}": f for k, f in enumerate(forces)} | {f"break{k}": b for k, b in enumerate(breaks)}

    def force(t, start, turn, **given):
        total = given["force0"]
        for k in range(len(breaks)):
            more = given[f"force{k + 1}"] - given[f"force{k}"]
            total = total + cb.math.where(t >= given[f"break{k}"], more, 0.0)
        return total * cb.math.cos(turn * (t - start))

    given = {
        "potential": lambda q, t, **numbers: q[0] ** 2 / 2 - q[0] * force(t, **numbers),
        "gradient": lambda q, t, **numbers: (q[0] - force(t, **numbers),),
        "parameters": {"start": start, "turn": turn, **named},
        "gamma": GAMMA,
        "q": (1.0,),
        "p": (0.0,),
        "t_span": (start, start + end),
        "breaks": breaks,
    }
    return cb.Driven(name="pushed", **given | changes)


def motion(elapsed, start=0.0, forces=(1.0,), breaks=(), turn=0.7):
    """Return (q, p) of such a scene so long after its start, in closed form."""
    x, v, now, omega = 1.0, 0.0, 0.0, math.sqrt(1 - GAMMA * GAMMA / 4)
    for end, force in zip([*(b - start for b in breaks), math.inf], forces, strict=True):
        end = min(end, elapsed)
        if end <= now:
            continue
        wave = force / (1 - turn * turn + 1j * GAMMA * turn)
        before, after = (wave * np.exp(1j * turn * t) for t in (now, end))
        x, v, t = x - before.real, v - (1j * turn * before).real, end - now
        b, decay = (v + GAMMA * x / 2) / omega, math.exp(-GAMMA * t / 2)
        c, s = math.cos(omega * t), math.sin(omega * t)
        moved = decay * (x * c + b * s)
        v = decay * omega * (b * c - x * s) - GAMMA * moved / 2 + (1j * turn * after).real
        x, now = moved + after.real, end
    return x, v


def error(scene, name, engine=None, save_at=None, **known):
    run = cb.solve(scene, name, carry=(), engine=engine, save_at=save_at, dense=False, **SETTINGS[name])
    assert run.ok, run.message
    true = [motion(t, scene.t, **known) for t in run.elapsed.tolist()]
    return np.abs(run.y[:, :2] - true).max()


# -- the start ---------------------------------------------------------------------------------------
@every
@pytest.mark.parametrize("start", few_slow([1.7e9, 6.3e10], 6.3e10))
def test_the_start_costs_its_own_rounding_alone(name, start):
    if name == "cyrk-dop853" and start > 1e10:
        pytest.skip("its tolerance is below the rounding of such times")
    allowed = 10 * np.finfo(float).eps * start * 0.7
    assert error(pushed(start, 20.0), name) <= 2 * error(pushed(0.0, 20.0), name) + allowed


@pytest.mark.parametrize("name", OURS)
def test_engines_agree_far_from_time_zero(name):
    scene, setting = pushed(6.3e10, 5.0), SETTINGS[name]
    runs = [
        cb.solve(scene, name, carry=(), engine=engine, dense=False, **setting)
        for engine in ("llvm", "python")
    ]
    np.testing.assert_allclose(runs[0].y, runs[1].y, rtol=0, atol=2e-5 if "rtol" in setting else 1e-5)
    np.testing.assert_array_equal(runs[0].y[:, 2], runs[0].t)


@pytest.mark.parametrize("name", ["contact-rkn6", "rk8", "rkn8", "contact-gauss4"])
def test_a_step_map_adds_the_time_once(name):
    scene = pushed(6.3e10, 20.0)
    step = cb.step_map(scene, name, carry=())
    y = step.start
    for _ in range(160):
        y = step(y, 0.125)
    run = cb.solve(scene, name, step=0.125, carry=(), save_at=[scene.t + 20.0])
    assert y[2] == scene.t + 20.0
    np.testing.assert_allclose(y[:2], run.y[-1, :2], rtol=0, atol=1e-5)


def test_the_clock_of_a_long_run_is_no_sum_of_steps():
    """A running sum of a million steps of 0.1 is off by 10⁻⁵."""
    scene = pushed(0.0, 1e5, turn=1.3)
    run = cb.solve(scene, "contact-rkn6", step=0.1, carry=(), save_at=[1e5])
    assert np.abs(run.y[-1, :2] - motion(1e5, turn=1.3)).max() < 1e-10


def test_a_reference_far_from_time_zero_is_the_one_at_zero():
    start = 1.7e9
    found = cb.reference(pushed(start, 20.0), [start + 20.0], ())
    np.testing.assert_allclose(found.y[0, :2], motion(20.0), rtol=0, atol=1e-14)
    assert found.source == "live"


def test_times_too_far_apart_are_warned_of():
    with pytest.warns(RuntimeWarning, match=r"times next to 1e\+15 are 0\.12 apart"):
        cb.solve(pushed(1e15, 20.0), "rk8", step=0.1)


# -- breaks ------------------------------------------------------------------------------------------
SQUARE = {"forces": [float(k % 2) for k in range(100)], "breaks": tuple((0.2 * np.arange(1, 100)).tolist())}
#: of which each is known to have been passed on the wrong side, by a rounding of a time
BROKEN = [
    (0.0, 2.0, {"forces": (0.0, 1.0), "breaks": (0.9,)}),
    (1.0, 2.0, {"forces": (0.0, 1.0), "breaks": (1.99,)}),
    (1e6, 20.0, {"forces": (0.3, 1.0, -1.0), "breaks": (1e6 + 1 / 3, 1e6 + 7.7)}),
]


@pytest.mark.quick(start=1e6)
@pytest.mark.quick(name=("contact-rkn6", "rk8-7", "rkn8-6"))
@pytest.mark.parametrize("name", OURS)
@pytest.mark.parametrize(("start", "end", "known"), BROKEN)
def test_no_step_straddles_a_break(name, start, end, known):
    """Forces that jump cost what those that do not jump cost, and the rounding of the start."""
    smooth = error(pushed(start, end, (1.0,)), name)
    found = error(pushed(start, end, **known), name, **known)
    beyond = 1e-5 if name == "contact-rkn8" else 1e-9  # a processor leads out of the steps
    assert found <= 10 * smooth + beyond


@pytest.mark.parametrize("name", ["contact-rkn6", "rk4", "rk8", "contact-gauss4"])
def test_a_square_wave_of_ninety_nine_breaks(name):
    scene = pushed(0.0, 20.0, **SQUARE, turn=0.0)
    assert error(scene, name, **SQUARE, turn=0.0) < 1e-4
    chosen = cb.solve(scene, name, carry=(), rtol=1e-6)
    assert np.abs(chosen.y[-1, :2] - motion(20.0, **SQUARE, turn=0.0)).max() < 2e-6
    assert chosen.counts.evaluations < 10**5


@pytest.mark.parametrize("name", ["cvode-adams", "cyrk-dop853", "scipy-dop853", "contact-rkn6", "rk8-7"])
def test_a_saved_time_a_rounding_from_a_break_is_no_gap(name):
    setting = SETTINGS.get(name, {"rtol": 1e-7})
    for k, way in itertools.product(range(1, 200, 33), (-1.0, 1.0)):
        known = {"forces": (0.0, 1.0), "breaks": (0.1 * k,)}
        beside = float(np.nextafter(0.1 * k, way * math.inf))
        run = cb.solve(pushed(0.0, 20.0, **known), name, carry=(), save_at=[beside, 20.0], **setting)
        assert run.ok, run.message
        np.testing.assert_allclose(run.y[0, :2], motion(beside, **known), rtol=0, atol=1e-3)


# -- saved times -------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["contact-rkn6", "rk8-7", "cvode-adams"])
def test_saved_times_are_those_of_the_span(name):
    scene = pushed(5.0, 20.0)
    run = cb.solve(scene, name, carry=(), save_at=[10, 25], **SETTINGS[name])
    assert run.t.tolist() == [10.0, 25.0]
    assert run.elapsed.tolist() == [5.0, 20.0]
    assert run.y[:, 2].tolist() == [10.0, 25.0]
    np.testing.assert_allclose(run.y[:, :2], [motion(5.0), motion(20.0)], rtol=0, atol=1e-3)
    assert run.laws().loc["solution_error", "deviation"] < 1e-3


@pytest.mark.parametrize("early", [4.9, 0.0])
def test_saved_times_before_the_start_are_refused_but_for_roundings(early):
    says = refusal(lambda: cb.solve(pushed(5.0, 20.0), "rk4", step=0.1, save_at=[early, 12.0]))
    assert says == f"save_at contains {early}: must be ≥ 5, the start of 'pushed'"
    times = [float(np.nextafter(5.0, 0.0)), 30.0]
    assert cb.solve(pushed(5.0, 20.0), "rk4", step=0.1, save_at=times).t.tolist() == [5.0, 30.0]


# -- the time is no component of the state whose error adaptive solvers control ----------------------
ADAPTIVE = [
    (method.name, engine)
    for method in cb.METHODS.values()
    if method.adaptive and method.family == "established"
    if method.refuses(cb.SCENES["forced_oscillator"]) is None
    for engine in method.engines
]
#: XLA compiles four programs for seconds: one of its methods stands for all
LONG = [pair for pair in ADAPTIVE if pair[1] == "jax" and "tsit5" not in pair[0]]
adaptive = pytest.mark.parametrize(("method", "engine"), few_slow(ADAPTIVE, *LONG))
STILL = {"q": (1.0,), "p": (0.3,), "gamma": 0.1, "t_end": 7.0}


class WithoutJacobian(Mechanical):
    """As a driven scene: solvers difference, or take dual numbers."""

    @property
    def has_jacobian(self):
        return False

    def jacobian(self, x):
        return None


FORCE = {
    "potential": lambda q, t=None: -cb.math.cos(q[0]),
    "gradient": lambda q, t=None: (cb.math.sin(q[0]),),
}
#: one and the same motion, without and with the time in its state
WITHOUT = WithoutJacobian(name="pendulum", **FORCE, **STILL)
WITH = Driven(name="timed", **FORCE, t=0.5, **STILL)


@adaptive
@pytest.mark.quick(engine=tuple({engine for _, engine in ADAPTIVE} - {"jax"}))
@pytest.mark.parametrize("carry", [("s",), pytest.param((), marks=pytest.mark.slow)])
def test_a_time_that_does_nothing_changes_nothing(method, engine, carry):
    """The same evaluations and the same motion, to the bit where the arithmetic is the same."""
    times = np.array([0.0, 1.5, 7.0])
    plain, timed = (
        cb.prepare(scene, method, rtol=1e-7, engine=engine, carry=carry, save_at=scene.begins + times)
        for scene in (WITHOUT, WITH)
    )
    a, b = plain(), timed()
    assert a.counts == b.counts
    np.testing.assert_allclose(np.delete(b.y, 2, axis=1), a.y, rtol=0, atol=1e-12)
    assert b.y[:, 2].tolist() == [0.5, 2.0, 7.5]
    np.testing.assert_allclose(timed.bare(timed.start), b.y[-1], rtol=0, atol=1e-5)
    assert timed.bare(timed.start)[2] == 7.5


@adaptive
def test_initial_data_begin_at_a_time_of_their_own(method, engine):
    scene = cb.SCENES["forced_oscillator"]
    moved = cb.prepare(scene, method, rtol=1e-8, engine=engine, carry=(), save_at=[3.0])(t=0.7)
    own = cb.prepare(scene.with_(t=0.7), method, rtol=1e-8, engine=engine, carry=(), save_at=[3.7])()
    np.testing.assert_array_equal(moved.y, own.y)
    assert moved.y[0, 2] == 3.7
    assert cb.LAWS["solution_error"](own) < 1e-6
