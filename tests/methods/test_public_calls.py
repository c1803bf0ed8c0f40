"""What a call of a prepared run costs beside the loop, and that the short way gives what the long one does."""

import os
import signal
import sys
import threading

import numpy as np
import pytest

import contactbench as cb
from cases import ALL_SCENES, mine
from contactbench.methods.scaled import compiled_scales

PARTICLE = cb.SCENES["particle"]
SHORT = {"step": PARTICLE.t_end / 12, "carry": (), "save_at": [PARTICLE.t_end]}


def calls(function):
    """How many functions of Python's a call passes through; bare times would be those of the machine."""
    names = set()
    sys.setprofile(lambda frame, event, _: names.add(frame.f_code) if event == "call" else None)
    try:
        function()
    finally:
        sys.setprofile(None)
    return len(names)


def test_public_calls_are_short():
    run = cb.prepare(PARTICLE, "contact-rkn6", **SHORT)
    cb.solve(PARTICLE, "contact-rkn6", step=0.1)
    run(q=(1.0, 0.4)), run.bare(run.start)
    most = {"run()": 5, "run(q=…)": 8, "bare": 2, "solve": 61}
    found = {
        "run()": calls(run),
        "run(q=…)": calls(lambda: run(q=(1.0, 0.45), p=[0.1, 0.2])),
        "bare": calls(lambda: run.bare(run.start)),
        "solve": calls(lambda: cb.solve(PARTICLE, "contact-rkn6", step=0.1)),
    }
    assert {name: n for name, n in found.items() if n > most[name]} == {}


@pytest.mark.parametrize("times", [[1.0], [0.0, 0.5, 1.0]], ids=str)
@pytest.mark.parametrize("scene", ALL_SCENES, ids=lambda scene: scene.name)
def test_the_short_way_gives_what_the_long_one_does(scene, times):
    run = cb.prepare(scene.with_(t_end=1.0), "contact-rkn4", step=0.05, save_at=times)
    name = "M" if hasattr(scene, "M") else "q"
    moved = {name: tuple(1.01 * c for c in getattr(scene, name))}
    for data in ({}, moved):
        short = run(**data)
        vars(run)["at_once"], kept = None, run.at_once
        long = run(**data)
        vars(run)["at_once"] = kept
        np.testing.assert_array_equal(short.y, long.y)
        np.testing.assert_array_equal(short.y0, long.y0)
        assert (repr(short), short.step, short.end_time) == (repr(long), long.step, long.end_time)


def test_the_loop_sees_a_start_without_a_slope_and_energy_that_rises():
    """A singular force, and a step far beyond the stability limit: neither is `ok`."""
    kepler = cb.SCENES["kepler_drag"]
    run = cb.prepare(kepler, "contact-rkn6", step=0.01, save_at=[1.0])
    with pytest.raises(cb.BadInput, match="not finite"):
        run(q=(0.0, 0.0))
    spring = mine(lambda q: q[0] ** 2 / 2, t_end=8.2, gamma=1e-3)
    rising = cb.solve(spring, "contact-strang", step=2.05, save_at=[8.2])
    assert rising.status == "diverged"
    assert "H0 rose" in rising.message
    of_floats = spring.with_(potential=lambda q: float(q[0]) ** 2 / 2, gradient=lambda q: (float(q[0]),))
    same = cb.solve(of_floats, "contact-strang", step=2.05, save_at=[8.2])
    assert (same.status, same.message) == (rising.status, rising.message)


@pytest.mark.parametrize(
    "value", [(1.0,), (1.0, np.inf), ("1", "2"), 1.0, np.array([[1.0, 2.0]]), None], ids=str
)
def test_initial_data_are_checked_one_by_one(value):
    run = cb.prepare(PARTICLE, "contact-rkn6", **SHORT)
    with pytest.raises(cb.BadInput, match=r"^q"):
        run(q=value)
    for same in ((1.0, 0.5), [1, 0.5], np.array([1.0, 0.5]), np.array([1.0, 0.5], dtype=np.float32)):
        np.testing.assert_array_equal(run(q=same).y, run().y)


def long_run(save_at):
    run = cb.prepare(
        PARTICLE.with_(t_end=1e9), "contact-strang", step=1e-3, carry=(), save_at=save_at, max_steps=10**13
    )
    assert run.loop.loop.is_long(run.needed)
    return run


@pytest.mark.posix
def test_a_long_run_hears_a_signal():
    """One interval of some 10¹² steps: a signal ends it within its turn, and nothing goes on behind."""
    before, run = {*threading.enumerate()}, long_run([1e9])
    timer = threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):  # noqa: PT012
        timer.start()
        run()
    timer.join()
    assert {*threading.enumerate()} <= before


@pytest.mark.parametrize(
    ("method", "setting"), [("rk8", {"step": 0.1}), ("rk8-7", {"rtol": 1e-6}), ("rk4", {"rtol": 1e-3})]
)
def test_a_packed_state_of_another_length_is_refused(method, setting):
    run = cb.prepare("oscillator", method, **setting)
    with pytest.raises(cb.BadInput, match="y0 has 2 numbers: must be 3, those of q1, p1, s"):
        run.integrate(run.start[:2])


@pytest.mark.parametrize("size", [1e-5, 1.0, 1e5])
@pytest.mark.parametrize("name", ["oscillator", "particle", "central", "kepler", "rigid_body", "heavy_top"])
def test_compiled_scales_are_those_of_python(name, size):
    run = cb.prepare(name, "rk8-7", rtol=1e-6)
    scene, carry = run.request.scene, run.request.carry
    scales = compiled_scales(run.request)
    assert scales is not None
    y0 = run.start * size
    wanted = scene.scales(scene.unpack(y0.tolist(), carry), float(run.request.save_at[-1]))
    assert scales(y0) == pytest.approx(wanted, rel=1e-14)


@pytest.mark.parametrize("name", ["oscillator", "particle", "rigid_body"])
def test_a_short_call_gives_all_that_a_long_one_gives(name):
    run = cb.prepare(name, "rk8-7", rtol=1e-6, save_at=[0.0, 1.0, 2.0], dense=False)
    short, long = run(), run.solved(run.start, run.integrate)
    assert run.at_once is not None
    assert short.counts == long.counts
    assert (short.y == long.y).all()
    assert (short.t == long.t).all()


def test_a_call_from_a_start_of_another_size_has_its_own_tolerance():
    run = cb.prepare("oscillator", "rk8-7", rtol=1e-6, save_at=[1.0])
    q, p = (1e5,), (0.0,)
    wanted = cb.prepare(cb.SCENES["oscillator"].with_(q=q, p=p), "rk8-7", rtol=1e-6, save_at=[1.0])()
    assert (run(q=q, p=p).y == wanted.y).all()


def test_a_start_is_thrown_as_long_as_its_force_changes_little():
    scene = cb.SCENES[
        "oscillator"
    ]  # q'' = −q from rest: the change h²/2 of the force times h is at most h/2 · 1
    (q, p), _ = scene.sizes(scene.initial(()), scene.t_end)
    assert (q, p) == (1.0, 20.0 / 64)  # of the spans 20/8^k the first one below 1
