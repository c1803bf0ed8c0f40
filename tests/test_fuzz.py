"""Calls of every public function with whatever comes to hand: each ends in a value, a status or one line.

Half of the arguments of a call are sound, so that the calls get past the first check.  The calls are the same in
every run (derandomised): the first part always, all 2000 of them with ``-m slow``.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import math
import warnings
from datetime import datetime
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

import contactbench as cb
from contactbench.cli import main
from contactbench.errors import LONGEST
from contactbench.methods.base import METHODS
from contactbench.solution import Status

#: calls of each kind: of a part, and of all
QUICK, ALL = 20, 170

# -- what comes to hand ----------------------------------------------------------------------------
ODD_NUMBERS = [
    0, -1, 1, 3, True, 0.5, -0.0, math.nan, math.inf, -math.inf, 5e-324, 1e-300, 1e300, 1e160, 10**400, 10**5000,
    2**63, 1j, np.complex128(1 + 2j), np.float32(0.1), np.int64(3), np.float64(math.nan), Fraction(1, 3),
    Decimal("0.1"), np.datetime64("2020-01-01"), np.timedelta64(3, "s"), datetime(2020, 1, 1),
]  # fmt: skip
ODD_THINGS = [
    None, "", "x", "0.1", "s", b"s", "rk4", "particle", "numba", "\n", "x" * 10**5, [], (), {}, set(), [[]], [None],
    ["s"], ["s", "s"], ("R", "s"), [1.0, "x"], [1j, 0.5], [[1.0, 2.0], [3.0]], (1.0,), (1.0, 2.0), (0.0, 0.0),
    (1e160, 0.0), (1.0, 2.0, 3.0), (5e-324, 5e-324), np.array(1.0), np.ones(2), np.ones(10**6), np.ones((2, 2)),
    np.ones(4) * 1j, np.array(["2020-01-01", "2020-01-02"], "datetime64[D]"), np.array([None, 1]), np.zeros(0),
    np.array([math.nan, 1.0]), {"q": 1}, {1: 2}, object(), object, len, lambda *a, **k: None, lambda: 1 / 0,
    range(3), ..., NotImplemented, iter([1.0]), cb.SCENES, cb.SCENES["particle"], cb.METHODS["rk4"],
]  # fmt: skip
ANYTHING = st.sampled_from(ODD_NUMBERS + ODD_THINGS)

#: solvers of every kind that are prepared in milliseconds
FAST = ["rk4", "contact-strang", "contact-rkn6", "herglotz", "contact-adaptive", "scipy-dop853", "scipy-radau",
        "cvode-bdf", "cvode-adams", "cyrk-dop853", "cyrk-lsoda", "heyoka-taylor", "contact-exact"]  # fmt: skip
METHOD = st.sampled_from([name for name in FAST if name in METHODS])
SCENE = st.sampled_from(["particle", "oscillator", "rigid_body", "central", "rigid_body_anisotropic"])
STEP = st.sampled_from([0.5, 0.1])
RTOL = st.sampled_from([1e-3, 1e-6])
TIMES = st.sampled_from([[1.0], [0.0, 0.5, 1.0], (0.3,), np.array([1.0, 2.0])])


def loose(sound):
    """Mostly what is sound, now and then anything."""
    return st.one_of(sound, sound, sound, ANYTHING)


def options(**sound):
    """Keywords: some are left out, some are not what they should be."""
    return st.fixed_dictionaries({}, optional={name: loose(values) for name, values in sound.items()})


DATA = options(
    q=st.just((1.0, 0.5)), p=st.just((0.1, 0.2)), s=st.just(0.1), M=st.just((1.0, 2.0, 3.0)), R=st.just(1)
)
SOLVING = options(
    step=STEP, rtol=RTOL, atol=RTOL, save_at=TIMES, carry=st.sampled_from([(), ("s",), "s", ("R", "s")]),
    engine=st.sampled_from(["numba", "python", "c", "c++", "llvm"]), max_steps=st.sampled_from([10, 1000]),
)  # fmt: skip
SETTING = st.one_of(STEP.map(lambda h: {"step": h}), RTOL.map(lambda r: {"rtol": r}))
#: budgets are small where nothing else is said: what is tried is the check, not the solver
SOUND = SETTING.map(lambda setting: {"max_steps": 2000, **setting})


def force(q, **parameters):
    return tuple(q)


def potential(q, **parameters):
    return sum(x * x for x in q) / 2


#: functions a user might bring: right, wrong in every way, failing, and leaving
FUNCTIONS = st.sampled_from([
    potential, force, lambda q: {0: q[0]}, lambda q: (q[0], "x"), lambda q: [1j] * len(q), lambda q: None,
    lambda q: q[5], lambda q: 1 / 0, lambda q: exec("raise SystemExit(0)"), lambda q, **p: tuple(-x for x in q),
    lambda q: math.nan, lambda q: math.exp(1e6), lambda q: [[1.0] * len(q)] * len(q), lambda q: np.array(q),
    lambda q: exec("raise KeyError"), lambda: 1, lambda q: "x" * 10**6, iter, 1, None, "x",
])  # fmt: skip

STEP_MAPS = st.sampled_from([
    lambda scene, x, h, xp: cb.shifted(x, h, scene.rhs(x)), lambda scene, x, h, xp: x._replace(s=None),
    lambda scene, x, h, xp: x[0], lambda scene, x, h, xp: type(x)(*[(*x[0], 1.0), *x[1:]]),
    lambda scene, x, h, xp: None, lambda scene, x, h, xp: 1 / 0, lambda scene, x, h, xp: exec("raise SystemExit(0)"),
    lambda scene, x, h, xp: x._replace(s=1j), lambda scene, x, h, xp: x if x[0][0] > 0 else cb.shifted(x, h, x),
    lambda scene, x, h, xp: xp.nothing(x), lambda: None, 5, None,
])  # fmt: skip
NUMBER = itertools.count()


# -- the calls -------------------------------------------------------------------------------------
def solve(draw):
    return cb.solve(
        draw(loose(SCENE)), draw(loose(METHOD)), **draw(SOUND), **draw(options(carry=st.just(("s",))))
    )


def solve_oddly(draw):
    return cb.solve(draw(SCENE), draw(METHOD), **{**draw(SOUND), **draw(SOLVING)})


def prepare_and_run(draw):
    run = cb.prepare(draw(SCENE), draw(METHOD), **draw(SOUND), save_at=draw(TIMES))
    return run(**draw(DATA))


def ensemble(draw):
    component = st.sampled_from([np.ones(4), np.linspace(0.1, 1, 4), 0.5])
    fields = st.fixed_dictionaries({}, optional={
        name: loose(st.lists(loose(component), min_size=n, max_size=n)) for name, n in (("q", 2), ("p", 2), ("M", 3))
    })  # fmt: skip
    keywords = draw(options(
        measure_at=TIMES, parameters=st.sampled_from([{}, {"gamma": 0.3}]), carry=st.just(("s",)), keep=st.booleans(),
        chunk=st.just(2), progress=st.just(False), engine=st.just("numba"),
    ))  # fmt: skip
    given = draw(loose(fields))
    return cb.ensemble(
        draw(st.sampled_from(["particle", "rigid_body"])), draw(st.sampled_from(["rk4", "contact-strang"])), given,
        **{"step": draw(loose(STEP)), "engine": "numba", **keywords},
    )  # fmt: skip


def reference(draw):
    scene = cb.SCENES[draw(SCENE)]
    return cb.reference(draw(loose(st.just(scene))), draw(loose(TIMES)), draw(loose(st.just(("s",)))), 0.2)


def compare(draw):
    """Its arguments: one of them is always unsound, so that nothing is raced."""
    sound = {"scene": "particle", "methods": ["rk4"], "errors": [1e-3], "budget": 1.0}
    name = draw(st.sampled_from(["errors", "budget", "methods", "scene"]))
    unsound = {
        "errors": [
            5,
            [],
            [0.0],
            [math.nan],
            ["x"],
            [2.0],
            None,
            [1j],
            [[1e-3]],
            np.zeros(0),
            [10**5000],
            object(),
        ],
        "budget": [0, -1, math.nan, "x", None, 1j, 10**400, [], np.ones(2)],
        "methods": [5, ["x"], "rk4x", [5], [[]], [None], [[]], object(), [np.ones(2)]],
        "scene": [5, "x", None, [], object(), np.ones(3), "x" * 10**5],
    }
    return cb.compare(**{**sound, name: draw(st.sampled_from(unsound[name]))})


def mechanical(draw):
    scene = cb.Mechanical(**{
        "name": "user", "potential": draw(FUNCTIONS), "gradient": draw(FUNCTIONS), "q": (1.0, 0.5), "p": (0.0, 0.1),
        "t_end": 1.0, **draw(options(
            q=st.just((1.0,)), p=st.just((0.5,)), hessian=FUNCTIONS, parameters=st.just({"a": 1.0}), mass=st.just(2.0),
            gamma=st.just(0.1), kappa=st.just(0.1), rotation_invariant=st.booleans(), s=st.just(0.0),
            name=st.just("x"), exact=FUNCTIONS, about=st.just(""),
        )),
    })  # fmt: skip
    return cb.solve(scene, draw(METHOD), **draw(SOUND))


def rigid_body(draw):
    scene = cb.RigidBody(**{
        "name": "user", "inertia": (1.0, 2.0, 3.0), "M": (1.0, 0.5, 0.1), "t_end": 1.0, **draw(options(
            inertia=st.just((1.0, 2.0, 3.0)), M=st.just((1.0, 2.0, 3.0)), gamma=st.just(0.1), R=st.just(1),
            damping=st.just((0.1, 0.2, 0.3)), t_end=st.just(2.0), s=st.just(0.0), name=st.just("x"),
        )),
    })  # fmt: skip
    return cb.solve(scene, draw(METHOD), **draw(SOUND))


def changed(draw):
    names = ["q", "p", "s", "gamma", "kappa", "mass", "t_end", "coupling", "parameters", "potential", "gradient",
             "hessian", "rotation_invariant", "name", "exact", "x", "inertia", "M", "R", "damping"]  # fmt: skip
    change = draw(st.dictionaries(st.sampled_from(names), ANYTHING, min_size=1, max_size=2))
    scene = cb.SCENES[draw(SCENE)].with_(**change)
    return cb.solve(scene, draw(METHOD), **draw(SOUND), save_at=[min(scene.t_end, 1.0)])


def step_map(draw):
    name = f"fuzz{next(NUMBER)}"
    try:
        cb.fixed_step(draw(loose(st.just(name))), draw(loose(st.just(1))), **draw(options(
            evaluations=st.just(1), about=st.just("x"), kind=st.just("rhs"), family=st.just("established"),
            contact=st.booleans(), symmetric=st.booleans(), factor=st.just(lambda scene, h, xp: 1.0), x=st.just(1),
        )))(draw(STEP_MAPS))  # fmt: skip
        return cb.solve(draw(SCENE), name, step=0.1, engine=draw(st.sampled_from(["numba", "python"])))
    finally:
        METHODS.pop(name, None)


def registries(draw):
    registry = draw(st.sampled_from([cb.METHODS, cb.SCENES, cb.LAWS]))
    return draw(st.sampled_from([registry.__getitem__, registry.add]))(draw(ANYTHING))


def shell(draw):
    """The command line, in this process: its words are text, and its end is a status of 0, 1 or 2."""
    words = st.sampled_from(["0.1", "-1", "nan", "1e-300", "1e300", "inf", "x", "", "q=[1]", "q=[1e160,0]",
                             "gamma=1e999", "gamma=" + "9" * 5000, "gamma=[" * 3000, "potential=1", "name=3",
                             "parameters=5", "mass=5e-324", "s=null", 's="a"', "q={}", "=", "1" * 400])  # fmt: skip
    line = ["solve", draw(loose(SCENE).map(str))[:200], draw(METHOD), draw(st.sampled_from(["--step", "--rtol"])),
            draw(st.one_of(st.just("0.1"), st.just("1e-3"), words))]  # fmt: skip
    flags = ["--set", "--t-end", "--engine", "--max-steps", "--out", "--plot", "--traceback-x", "--plugin"]
    for flag in draw(st.lists(st.sampled_from(flags), max_size=2)):
        word = draw(words)
        line += [flag, f"/nonexistent/{word[:20]}" if flag in ("--out", "--plot", "--plugin") else word]
    if "--max-steps" not in line:
        line += ["--max-steps", "2000"]
    line += draw(st.lists(st.sampled_from(["--json", "--laws"]), max_size=1))
    err = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(err):
        try:
            status = main(line)
        except SystemExit as end:  # argparse's way to leave
            status = end.code
    said = err.getvalue()
    assert status in (0, 1, 2), line
    assert said.count("\n") == (status == 2), (line, said)
    assert len(said) <= LONGEST + len("contactbench: \n") or "--help" in said, (line, said)
    return status


CALLS = [solve, solve_oddly, prepare_and_run, ensemble, reference, compare, mechanical, rigid_body, changed, step_map,
         registries, shell]  # fmt: skip


def ends(call, data):
    """A value, a status or one line."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.filterwarnings("error", message=".*imaginary part")  # a part of the data that is lost
        try:
            value = call(data.draw)
        except cb.BadInput as error:
            said = str(error)
            assert 0 < len(said) <= LONGEST
            assert said.isprintable()
            return
    if isinstance(value, cb.Solution):
        assert value.status in Status
        assert value.y.dtype == float
        assert not value.ok or np.isfinite(value.y).all()


FUZZ = {
    "deadline": None, "derandomize": True, "database": None, "phases": [Phase.generate],
    "suppress_health_check": list(HealthCheck),
}  # fmt: skip


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.__name__)
@settings(max_examples=QUICK, **FUZZ)
@given(data=st.data())
def test_a_call_ends_in_a_value_a_status_or_one_line(call, data):
    ends(call, data)


@pytest.mark.slow
@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.__name__)
@settings(max_examples=ALL, **FUZZ)
@given(data=st.data())
def test_2000_calls_end_in_a_value_a_status_or_one_line(call, data):
    ends(call, data)


def test_the_calls_are_2000():
    assert ALL * len(CALLS) >= 2000
