"""Calls of what solves, with whatever comes to hand: each ends in a value, a status or one line.

Half of the arguments of a call are sound, so that the calls get past the first check.  The calls are the same in
every run (derandomised): a part of them in the quick run, all 1250 of them with ``-m slow``.
"""

from __future__ import annotations

import math
import warnings
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

import contactbench as cb
from contactbench.errors import LONGEST
from contactbench.solution import Status

#: calls of each kind
QUICK, ALL = 20, 250

# -- what comes to hand ----------------------------------------------------------------------------
NUMBERS = [0, -1, 3, True, 0.5, math.nan, math.inf, -math.inf, 5e-324, 1e160, 1e300, 10**5000, 1j]
NUMBERS += [np.float32(0.1), np.int64(3), np.complex128(1 + 2j), Fraction(1, 3), np.datetime64("2020-01-01")]
WORDS = [None, "", "x", "0.1", "s", b"s", "rk4", "particle", "numba", "\n", "x" * 10**5]
LISTS = [[], {}, set(), [[]], [None], ["s", "s"], ("R", "s"), [1.0, "x"], [1j, 0.5], {"q": 1}]
LISTS += [(1.0,), (1.0, 2.0), (0.0, 0.0), (1e160, 0.0), (1.0, 2.0, 3.0), [[1.0], [2.0, 3.0]]]
ARRAYS = [np.array(1.0), np.ones(10**6), np.ones((2, 2)), np.ones(4) * 1j, np.zeros(0), np.array([None, 1])]
OBJECTS = [object(), object, len, lambda *a, **k: None, lambda: 1 / 0, range(3), ..., iter([1.0])]
OBJECTS += [cb.SCENES, cb.SCENES["particle"], cb.METHODS["rk4"]]
ANYTHING = st.sampled_from(NUMBERS + WORDS + LISTS + ARRAYS + OBJECTS)

#: solvers of every kind that are prepared in milliseconds
FAST = ("rk4", "contact-strang", "contact-rkn6", "herglotz2", "contact-adaptive", "contact-exact")
PEERS = ("scipy-dop853", "scipy-radau", "cvode-bdf", "cvode-adams", "cyrk-dop853", "cyrk-lsoda")
METHOD = st.sampled_from((*FAST, *PEERS, "heyoka-taylor"))
SCENE = st.sampled_from(["particle", "oscillator", "rigid_body", "central", "rigid_body_anisotropic"])
ENGINE = st.sampled_from(["numba", "python", "c", "c++", "llvm"])
STEP = st.sampled_from([0.5, 0.1])
RTOL = st.sampled_from([1e-3, 1e-6])
TIMES = st.sampled_from([[1.0], [0.0, 0.5, 1.0], (0.3,), np.array([1.0, 2.0])])
CARRY = st.sampled_from([(), ("s",), "s", ("R", "s")])
PAIR, TRIPLE = st.just((1.0, 0.5)), st.just((1.0, 2.0, 3.0))
TENTH = st.just(0.1)
SETTING = st.one_of(STEP.map(lambda h: {"step": h}), RTOL.map(lambda r: {"rtol": r}))
#: budgets are small where nothing else is given: the check is tried, not the solver
SOUND = SETTING.map(lambda setting: {"max_steps": 2000, **setting})


def loose(sound):
    """Mostly what is sound, now and then anything."""
    return st.one_of(sound, sound, sound, ANYTHING)


def options(**sound):
    """Keywords: some are left out, some are not what they should be."""
    return st.fixed_dictionaries({}, optional={name: loose(values) for name, values in sound.items()})


def force(q, **parameters):
    return tuple(q)


def potential(q, **parameters):
    return sum(x * x for x in q) / 2


def leave(*arguments):
    raise SystemExit(0)


#: functions a user might bring: right, wrong in every way, failing, and leaving
FUNCTIONS = [potential, force, lambda q: {0: q[0]}, lambda q: (q[0], "x"), lambda q: [1j] * len(q), np.array]
FUNCTIONS += [lambda q: q[5], lambda q: 1 / 0, leave, lambda q: math.nan, lambda q: math.exp(1e6), lambda: 1]
FUNCTIONS += [lambda q, **p: tuple(-x for x in q), lambda q: [[1.0] * len(q)] * len(q), iter, 1, None]
FUNCTION = st.sampled_from(FUNCTIONS)


# -- the calls -------------------------------------------------------------------------------------
def solve(draw):
    budget = st.sampled_from([10, 1000])
    given = options(
        step=STEP, rtol=RTOL, atol=RTOL, save_at=TIMES, carry=CARRY, engine=ENGINE, max_steps=budget
    )
    return cb.solve(draw(loose(SCENE)), draw(loose(METHOD)), **{**draw(SOUND), **draw(given)})


def prepare_and_run(draw):
    run = cb.prepare(draw(SCENE), draw(METHOD), **draw(SOUND), save_at=draw(TIMES))
    return run(**draw(options(q=PAIR, p=PAIR, M=TRIPLE, R=st.just(1), s=TENTH)))


def reference(draw):
    scene = cb.SCENES[draw(SCENE)]
    return cb.reference(draw(loose(st.just(scene))), draw(loose(TIMES)), draw(loose(st.just(("s",)))), 0.2)


def mechanical(draw):
    given = {"potential": draw(FUNCTION), "gradient": draw(FUNCTION), "q": (1.0, 0.5), "p": (0.0, 0.1)}
    functions = {"hessian": FUNCTION, "exact": FUNCTION}
    more = options(
        q=PAIR, p=PAIR, name=st.just("x"), **functions, mass=TENTH, gamma=TENTH, kappa=TENTH, s=TENTH
    )
    scene = cb.Mechanical(**{"name": "user", "t_end": 1.0, **given, **draw(more)})
    return cb.solve(scene, draw(METHOD), **draw(SOUND))


def changed(draw):
    names = (
        "q p s gamma kappa mass t_end coupling parameters potential gradient hessian name exact x inertia M R"
    )
    change = draw(st.dictionaries(st.sampled_from(names.split()), ANYTHING, min_size=1, max_size=2))
    scene = cb.SCENES[draw(SCENE)].with_(**change)
    return cb.solve(scene, draw(METHOD), **draw(SOUND), save_at=[min(scene.t_end, 1.0)])


CALLS = (solve, prepare_and_run, reference, mechanical, changed)


def ends(call, data):
    """A value, a status or one line."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.filterwarnings("error", message=".*imaginary part")  # a part of the data that is lost
        try:
            value = call(data.draw)
        except cb.BadInput as error:
            message = str(error)
            assert 0 < len(message) <= LONGEST
            assert message.isprintable()
            return
    if isinstance(value, cb.Solution):
        assert value.status in Status
        assert value.y.dtype == float
        assert not value.ok or np.isfinite(value.y).all()


SAME = {"deadline": None, "derandomize": True, "database": None, "phases": [Phase.generate]}
SAME["suppress_health_check"] = list(HealthCheck)


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.__name__)
@pytest.mark.parametrize("n", [QUICK, ALL])
@pytest.mark.quick(n=QUICK)
def test_a_call_ends_in_a_value_a_status_or_one_line(call, n):
    settings(max_examples=n, **SAME)(given(data=st.data())(lambda data: ends(call, data)))()
