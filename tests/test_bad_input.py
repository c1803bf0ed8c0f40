"""Bad input is one line that names the value and what is allowed; the command line exits with 2."""

from __future__ import annotations

import json
import math
import re
import sys
from dataclasses import dataclass

import numpy as np
import pytest

import contactbench as cb
from cases import ALL_SCENES
from contactbench.cli import main
from contactbench.measure.laws import law
from contactbench.methods.fixed_step import FixedStep
from contactbench.scene import definition, verify

#: a scene, a method and options of a run, and a part of the refusal
RUNS = [
    ("partcle", "rk4", {"step": 0.1}, "unknown scene 'partcle': did you mean 'particle'?"),
    ("particle", "contact-strnag", {"step": 0.1}, "did you mean 'contact-strang'?"),
    ("particle", "rk4", {"rtol": 1e-20}, "rk4 takes 1e-13 to 0.1"),
    ("particle", "cvode-bdf", {"step": 0.1}, "give rtol"),
    ("particle", "cvode-bdf", {}, "rtol is missing"),
    ("particle", "cvode-bdf", {"rtol": 1e-30}, "takes 2.3e-16 to 0.1"),
    ("particle", "scipy-dop853", {"rtol": -1}, "rtol = -1: must be > 0"),
]
#: options of a run of rk4 on the particle, beside a step of 0.1
OPTIONS = [
    ({"step": -0.1}, "step = -0.1: must be > 0"),
    ({"step": 0}, "step = 0: must be > 0"),
    ({"step": math.nan}, "step = nan: must be a finite number"),
    ({"step": "0.1"}, "step = '0.1': must be a finite number"),
    ({"step": np.complex128(0.1)}, "step = "),
    ({"step": 10**400}, "must be a finite number"),
    ({"step": 10**5000}, "step = <int>: must be"),  # too long to be printed
    ({"engine": "fortran"}, "engine = 'fortran': rk4 runs on numba, jax, python"),
    ({"save_at": [3.0, 1.0]}, "strictly increasing"),
    ({"save_at": [1.0, math.nan]}, "must be finite times"),
    ({"save_at": []}, "must be finite times"),
    ({"carry": ("R",)}, "can carry s"),
    ({"carry": np.ones(10**6)}, "can carry s"),
    ({"carry": 5}, "carry = 5: scene 'particle' can carry s"),
    ({"max_steps": 0}, "max_steps = 0"),
    ({"max_steps": math.nan}, "max_steps = nan: must be"),
]
RUNS += [("particle", "rk4", {"step": 0.1} | options, says) for options, says in OPTIONS]


def refusal(call, *arguments, **options):
    """The message of a refusal: one line, short enough to be read."""
    with pytest.raises(cb.BadInput) as caught:
        call(*arguments, **options)
    assert len(str(caught.value)) <= 300
    assert str(caught.value).isprintable()
    return str(caught.value)


@pytest.mark.parametrize(("scene", "method", "options", "says"), RUNS, ids=[run[-1] for run in RUNS])
def test_a_run_is_refused_in_one_line(scene, method, options, says):
    assert says in refusal(cb.solve, scene, method, **options)


@pytest.mark.parametrize(
    ("registry", "wrong", "right"),
    [("SCENES", "rigidbody", "rigid_body"), ("METHODS", "RK4", "rk4"), ("LAWS", "momentum", "momentum_law")],
)
def test_registries_suggest_the_nearest_name(registry, wrong, right):
    with pytest.raises(cb.UnknownName, match=right):
        getattr(cb, registry)[wrong]


def test_a_prepared_run_checks_its_initial_data():
    run = cb.prepare("particle", "rk4", step=0.1)
    assert "q has 1 components" in refusal(run, q=(1.0,))
    assert "unknown initial value" in refusal(run, M=(1.0, 2.0, 3.0))


# -- the command line ------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("solve particle rk5 --step 0.1", "did you mean 'rk4'?"),
        ("solve particle rk4 --step -1", "step = -1.0: must be > 0"),
        ("solve particle rk4 --step 0.1 --t-end nan", "t_end = nan"),
        ("solve particle rk4 --step 0.1 --set q=[1]", "q has 1 components and p 2"),
        ("solve particle rk4 --step 0.1 --set gamma=abc", "--set gamma=abc"),
        ("report --results /nonexistent", "no tables there"),
    ],
)
def test_command_line_prints_one_line_and_exits_2(line, says, capsys):
    assert main(line.split()) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith("contactbench: ")
    assert says in err


def test_command_line_solves_and_prints_json(capsys):
    assert (
        main(["solve", "particle", "contact-strang", "--step", "0.01", "--set", "gamma=0.3", "--json"]) == 0
    )
    out = json.loads(capsys.readouterr().out)
    assert out["status"] == "ok"
    assert set(out["state"]) == {"q1", "q2", "p1", "p2", "s"}
    assert out["counts"]["evaluations"] == 2001
    # H decays as e^{-γt}: an independent check on the printed number
    start = 0.625 + 0.045 + 0.05
    assert out["H"] == pytest.approx(start * math.exp(-0.3 * 20), rel=1e-3)


def test_command_line_lists_the_stored_references(capsys):
    assert main(["references"]) == 0
    digits = {line.split()[0]: int(line.split()[1]) for line in capsys.readouterr().out.splitlines()}
    assert list(digits) == [name for name in cb.SCENES if name in digits]  # a plug-in's have none
    assert {"particle", "rigid_body"} <= set(digits)
    assert min(digits.values()) >= 30


def test_command_line_lists_everything(capsys):
    assert main(["list"]) == 0
    listed = {line.split()[0] for line in capsys.readouterr().out.splitlines()}
    assert {*cb.SCENES, *cb.METHODS, *cb.LAWS} <= listed


def euler(scene, x, h, xp):
    return cb.shifted(x, h, scene.rhs(x))


# -- other calls -----------------------------------------------------------------------------------
PARTICLE = cb.SCENES["particle"]


def ensemble(start, **options):
    return lambda: cb.ensemble("particle", "rk4", start, step=0.5, **options)


def changed(**changes):
    return lambda: PARTICLE.with_(**changes)


def registered(registry, name, item):
    return lambda: registry.__setitem__(name, item)


CALLS = [
    (ensemble({"q": (np.ones(2) * 1j, 0.5)}), "q[0] = array([0.+1.j, 0.+1.j]): must be a number or an array"),
    (ensemble({"q": (np.array(["2020"], "datetime64[Y]"), 0.5)}), "must be a number or an array of numbers"),
    (ensemble({"s": np.ones(2)}, chunk="x"), "chunk = 'x'"),
    (changed(parameters=5), "parameters = 5: must be a dict"),
    (changed(potential=1), "potential = 1: must be a function"),
    (changed(experiments=("laws", "cost")), "experiments = ('laws', 'cost'): must be a tuple of names among"),
    (changed(mass=5e-324), "mass = 5e-324"),
    (changed(name="a\nb"), "name = 'a\\nb': must be"),
    (changed(about="\a"), "about = '\\x07': must be"),
    (lambda: cb.METHODS[[]], "unknown method []"),
    (lambda: cb.fixed_step("x", None), "order = None"),
    (lambda: cb.fixed_step("x", 1, evaluations=0), "evaluations = 0: must be a whole number ≥ 1"),
    (lambda: cb.fixed_step("x", 1, exactly=True), "'exactly': a step map declares kind, family"),
    (lambda: cb.prepare("particle", "scipy-dop853", rtol=1e-6)(q=(1e160, 0.0)), "not finite there"),
    (lambda: cb.composition("x", 1, 0.5, [1]), "kick = 0.5: must be a list"),
    (registered(cb.METHODS, "x", 3), "3 cannot be registered: it is no method"),
    (registered(cb.LAWS, "x", 3), "3 cannot be registered: it is no law"),
    (registered(cb.METHODS, "x", cb.METHODS["rk4"]), "method name 'x': must be"),
    (lambda: cb.solve("particle", FixedStep("a\tb", 1, euler), step=0.1), "'a\\tb': must be"),
    (lambda: cb.reference(PARTICLE.with_(gamma=0.11), [1e9], seconds=3.0), "more): allow it more"),
]


@pytest.mark.timeout(60)
@pytest.mark.parametrize(("call", "says"), CALLS, ids=[says for _, says in CALLS])
def test_a_call_is_refused_in_one_line(call, says):
    assert says in refusal(call)


@pytest.mark.timeout(60)
@pytest.mark.parametrize("options", [{"step": 1e-300}, {"step": 1e-5, "save_at": [1e300]}, {"step": 1e-20}])
def test_a_run_of_too_many_steps_ends_as_budget(options):
    assert cb.solve("particle", "rk4", **options).status is cb.Status.budget


@pytest.mark.timeout(60)
@pytest.mark.parametrize("method", ["scipy-dop853", "scipy-radau"])
def test_a_first_step_that_is_no_number_ends_the_run(method):
    """A slope that is finite at the start and not where the first step leads: SciPy's loop would not end."""
    assert not cb.solve(cb.SCENES["particle"].with_(q=(1e100, 0.0)), method, rtol=1e-6, save_at=[1.0]).ok


# -- a user's functions ----------------------------------------------------------------------------
def user(**changes):
    def potential(q):
        x, y = q
        return x * x / 2 + 2 * y * y + x * x * y

    def gradient(q):
        x, y = q
        return (x + 2 * x * y, 4 * y + x * x)

    def hessian(q):
        x, y = q
        return ((1 + 2 * y, 2 * x), (2 * x, 4.0))

    given = {"potential": potential, "gradient": gradient, "hessian": hessian, **changes}
    return cb.Mechanical(name="mine", q=(0.7, -0.4), p=(0.1, 0.3), gamma=0.1, t_end=1.0, **given)


GRADIENT = "gradient is not the potential's: component"
WRONG = {
    "sign": ({"gradient": lambda q: (-q[0] - 2 * q[0] * q[1], 4 * q[1] + q[0] ** 2)}, f"{GRADIENT} 1 is"),
    "factor": ({"gradient": lambda q: (q[0] + 2 * q[0] * q[1], 2 * q[1] + q[0] ** 2)}, f"{GRADIENT} 2 is"),
    "little": (
        {"gradient": lambda q: (q[0] + 2 * q[0] * q[1], 4.0001 * q[1] + q[0] ** 2)},
        f"{GRADIENT} 2 is",
    ),
    "hessian": (
        {"hessian": lambda q: ((1 + 2 * q[1], 2 * q[0]), (q[0], 4.0))},
        "derivative: entry (2, 1) is",
    ),
    "shape": ({"hessian": lambda q: ((1.0, 2.0),)}, "must be 2 rows of 2 real numbers"),
    "symmetry": ({"rotation_invariant": True}, "exerts a torque"),
    "no number": ({"potential": lambda q: q}, "its potential is (0.7, -0.4)"),
    "complex": ({"potential": lambda q: 1j * q[0]}, "must be a number"),
}
FIRST = {
    "solve": lambda scene: cb.solve(scene, "scipy-radau", rtol=1e-6),
    "reference": lambda scene: cb.reference(scene, [1.0]),
    "ensemble": lambda scene: cb.ensemble(scene, "rk4", {"s": np.ones(2)}, step=0.5),
}


@pytest.mark.parametrize("name", WRONG)
@pytest.mark.parametrize("first", FIRST)
def test_functions_that_do_not_fit_each_other_are_refused_with_both_numbers(name, first):
    changes, says = WRONG[name]
    message = refusal(FIRST[first], user(**changes))
    assert says in message
    assert "scene 'mine'" in message


@pytest.mark.parametrize(
    "changes",
    [{}, {"hessian": None}, {"potential": lambda q: 5.0 + q[0] ** 2 / 2 + 2 * q[1] ** 2 + q[0] ** 2 * q[1]}],
)
def test_functions_that_fit_are_taken(changes):
    assert cb.solve(user(**changes), "rk4", step=0.1).ok


@pytest.mark.parametrize("scene", ALL_SCENES, ids=lambda scene: scene.name)
def test_every_scene_of_ours_fits(scene):
    """What is not checked at run time is checked here, by the same rules."""
    if isinstance(scene, cb.Mechanical):
        definition._verify(scene)
    else:
        verify(scene)


def test_a_definition_is_checked_once(monkeypatch):
    calls = []
    scene = user()
    cb.solve(scene, "rk4", step=0.1)
    monkeypatch.setattr(definition, "_verify", calls.append)
    cb.solve(scene, "rk4", step=0.1)
    cb.solve("particle", "rk4", step=0.1)
    assert calls == []
    cb.solve(scene.with_(gamma=0.2), "rk4", step=0.1)
    assert len(calls) == 1


ERRORS = {
    "scene": (lambda: user(gradient=lambda q: q[5]), "test_bad_input.py, line "),
    "exit": (
        lambda: user(gradient=lambda q: sys.exit(0)),
        "scene 'mine', <lambda> (test_bad_input.py, line ",
    ),
    "potential": (lambda: cb.solve(user(potential=lambda q: {}["a"]), "rk4", step=0.1), "KeyError: 'a'"),
    "dict": (lambda: user(gradient=lambda q: {0: q[0]}), "gradient: must return 2 numbers, a tuple"),
}


@pytest.mark.parametrize("name", ERRORS)
def test_an_error_of_a_users_function_is_told_as_theirs(name):
    call, says = ERRORS[name]
    assert says in refusal(call)


STEPS = {
    "another shape": (lambda scene, x, h, xp: x._replace(q=(*x.q, 1.0)), "returns q = "),
    "no s": (lambda scene, x, h, xp: x._replace(s=None), "returns s = None: must be like 0.0"),
    "no state": (lambda scene, x, h, xp: x.q, "must be a State"),
    "complex": (lambda scene, x, h, xp: x._replace(s=1j), "returns s = 1j: must be like 0.0"),
    "a list": (lambda scene, x, h, xp: x._replace(q=list(x.q)), "must be like (1.0, 0.5)"),
    "an error": (lambda scene, x, h, xp: {}["a"], "<lambda> (test_bad_input.py, line "),
    "an exit": (lambda scene, x, h, xp: sys.exit(0), "SystemExit: 0"),
}


@pytest.mark.parametrize("engine", ["numba", "jax", "python"])
@pytest.mark.parametrize("name", STEPS)
def test_a_step_map_that_makes_no_state_is_refused(name, engine):
    step, says = STEPS[name]
    message = refusal(cb.solve, "particle", FixedStep("mine", 1, step), step=0.1, engine=engine)
    assert says in message
    assert "method 'mine'" in message


def test_an_error_later_in_a_run_is_told_as_theirs():
    left = [9]

    def step(scene, x, h, xp):
        left[0] -= 1
        float(x.q[0])  # a step map that wants values is not recorded, but called step by step
        return x if left[0] else {}["a"]

    message = refusal(cb.solve, "particle", FixedStep("mine", 1, step), step=0.1, engine="python")
    assert re.search(r"mine on scene 'particle', step \(test_bad_input.py, line \d+\): KeyError", message)


def test_a_damping_whose_slope_is_another_is_refused():
    base = user()
    given = {name: getattr(base, name) for name in ("name", "potential", "gradient", "q", "p", "t_end")}
    given |= {"s": 0.5, "damping": lambda s: s**3}
    assert cb.solve(cb.GeneralDamping(**given, damping_slope=lambda s: 3 * s**2), "rk4", step=0.1).ok
    message = refusal(cb.solve, cb.GeneralDamping(**given, damping_slope=lambda s: s**2), "rk4", step=0.1)
    assert re.search(r"damping_slope is not the damping's: 0.\d+ at s = 0.\d+, the derivative", message)


# -- what functions of time and of s return --------------------------------------------------------
GIVEN = {"name": "mine", "q": (1.0,), "p": (0.0,), "t_end": 1.0}
TIMED = {"potential": lambda q, t: q[0] ** 2 / 2, "gradient": lambda q, t: (q[0],), **GIVEN}
PLAIN = {"potential": lambda q: q[0] ** 2 / 2, "gradient": lambda q: (q[0],), **GIVEN}
OF_TIME = [
    ({"rate": lambda t: None}, "rate: must return a real number; it returns None"),
    ({"rate": lambda t: "1"}, "rate: must return a real number"),
    ({"rate": lambda t: 1.0, "span": lambda t, h, xp: None}, "span: must return a pair"),
    ({"rate": lambda t: 1.0, "span": lambda t, h, xp: 1.0}, "span: must return a pair"),
    ({"rate": lambda t: 1 / 0}, "scene 'mine', <lambda> (test_bad_input.py, line "),
]
OF_S = [
    ({"damping": lambda s: None}, "damping: must return a real number"),
    ({"damping_slope": lambda s: None}, "damping_slope: must return a real"),
    ({"damping_flow": lambda s, h, xp: None}, "damping_flow: must return a real"),
]


@pytest.mark.parametrize(("changes", "says"), OF_TIME)
def test_a_function_of_time_that_returns_no_number_is_refused(changes, says):
    assert says in refusal(cb.Driven, **TIMED | changes)


@pytest.mark.parametrize(("changes", "says"), OF_S)
def test_a_function_of_s_that_returns_no_number_is_refused(changes, says):
    given = PLAIN | {"damping": lambda s: s, "damping_slope": lambda s: 1.0}
    assert says in refusal(cb.GeneralDamping, **given | changes)


# -- names of parameters ---------------------------------------------------------------------------
FORCE = {"potential": lambda q, **_: q[0] ** 2 / 2, "gradient": lambda q, **_: (q[0],)}
DRIVEN = {"potential": lambda q, t, **_: q[0] ** 2 / 2, "gradient": lambda q, t, **_: (q[0],)}
KINDS = {
    cb.Mechanical: FORCE,
    cb.GeneralDamping: {**FORCE, "damping": lambda s: s, "damping_slope": lambda s: 1.0},
    cb.Driven: {**DRIVEN, "rate": lambda t, **_: 1.0, "span": lambda t, h, xp, **_: (h, h)},
}
TAKEN = [
    "s",
    "gamma",
    "mass",
    "t_end",
    "q",
    "p",
    "t",
    "h",
    "xp",
    "self",
    "y",
    "numbers",
    "name",
    "parameters",
]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", TAKEN)
def test_a_parameter_that_would_hide_another_name_is_refused(kind, name):
    scene = kind(**KINDS[kind], **GIVEN, parameters={"stiffness": 1.0})
    message = refusal(scene.with_, parameters={"stiffness": 1.0, name: 1.0})
    assert f"parameter '{name}': must have a name of its own" in message


# -- functions without a hash ----------------------------------------------------------------------
@dataclass
class Euler:
    """A step map with data of its own, which `dataclass` leaves without a hash."""

    slopes: int = 1

    def __call__(self, scene, x, h, xp):
        return euler(scene, x, h, xp)


@dataclass(frozen=True)
class Tabled(FixedStep):
    """A method with a list in it."""

    table: tuple | list = ()


@pytest.mark.parametrize("engine", ["numba", "jax", "python"])
@pytest.mark.parametrize("method", [FixedStep("own", 1, Euler()), Tabled("own", 1, euler, table=[1.0])])
def test_a_step_map_need_not_be_hashable(method, engine):
    plain = cb.solve("particle", FixedStep("plain", 1, euler), step=0.1, engine=engine)
    np.testing.assert_array_equal(cb.solve("particle", method, step=0.1, engine=engine).y, plain.y)


def test_nor_need_a_law():
    @dataclass
    class Ended:
        offset: float = 1.0

        def __call__(self, solution):
            return self.offset

    law("the end", "end")(Ended())
    try:
        assert cb.solve("particle", "rk4", step=0.1).laws().loc["Ended", "deviation"] == 1.0
    finally:
        del cb.LAWS["Ended"]
