"""Adaptive solvers have the time as their own: it is no component of the state whose error they control."""

import numpy as np
import pytest

import contactbench as cb
from cases import few_slow
from contactbench.scene import Driven, Mechanical

ADAPTIVE = [
    (method.name, engine)
    for method in cb.METHODS.values()
    if method.adaptive and method.family == "established"
    if method.refuses(cb.SCENES["forced_oscillator"]) is None
    for engine in method.engines
]
#: XLA compiles four programs for seconds: one of its methods stands for all
LONG = [pair for pair in ADAPTIVE if pair[1] == "jax" and "tsit5" not in pair[0]]
every = pytest.mark.parametrize(("method", "engine"), few_slow(ADAPTIVE, *LONG))
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


@every
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


@every
def test_initial_data_begin_at_a_time_of_their_own(method, engine):
    scene = cb.SCENES["forced_oscillator"]
    moved = cb.prepare(scene, method, rtol=1e-8, engine=engine, carry=(), save_at=[3.0])(t=0.7)
    own = cb.prepare(scene.with_(t=0.7), method, rtol=1e-8, engine=engine, carry=(), save_at=[3.7])()
    np.testing.assert_array_equal(moved.y, own.y)
    assert moved.y[0, 2] == 3.7
    assert cb.LAWS["solution_error"](own) < 1e-6
