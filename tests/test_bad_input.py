"""Bad input is one line that names the value and what is allowed; the command line exits with 2."""

import json
import math
import sys
from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest

import contactbench as cb
from cases import refusal
from contactbench.cli import main
from contactbench.methods.fixed_step import FixedStep
from contactbench.testing import check_method, check_scene
from properties import GENERAL

PARTICLE = cb.SCENES["particle"]
BODY, ANISOTROPIC = "rigid_body", "rigid_body_anisotropic"


# -- a user's functions ----------------------------------------------------------------------------
def user(**changes):
    functions = {
        "potential": lambda q: q[0] ** 2 / 2 + 2 * q[1] ** 2 + q[0] ** 2 * q[1],
        "gradient": lambda q: (q[0] + 2 * q[0] * q[1], 4 * q[1] + q[0] ** 2),
        "hessian": lambda q: ((1 + 2 * q[1], 2 * q[0]), (2 * q[0], 4.0)),
    }
    data = {"name": "mine", "q": (0.7, -0.4), "p": (0.1, 0.3), "gamma": 0.1, "t_end": 1.0}
    return cb.Mechanical(**data, **functions | changes)


GIVEN = {"name": "mine", "q": (1.0,), "p": (0.0,), "t_end": 1.0}
FORCE = {"potential": lambda q, **_: q[0] ** 2 / 2, "gradient": lambda q, **_: (q[0],)}
DRIVEN = {"potential": lambda q, t, **_: q[0] ** 2 / 2, "gradient": lambda q, t, **_: (q[0],)}
#: the arguments of a scene of each kind whose functions take any parameter
KINDS = {
    cb.Mechanical: FORCE,
    cb.GeneralDamping: {**FORCE, "damping": lambda s: s, "damping_slope": lambda s: 1.0},
    cb.Driven: {**DRIVEN, "rate": lambda t, **_: 1.0, "span": lambda t, h, xp, **_: (h, h)},
}


def wrong_user(**changes):
    return lambda: cb.solve(user(**changes), "scipy-radau", rtol=1e-6)


def made(kind, **changes):
    return lambda: cb.solve(kind(**KINDS[kind] | GIVEN | changes), "rk4", step=0.1)


def np_norm(q):
    return np.linalg.norm(q)


def damped(damping):
    return lambda: cb.GeneralDamping(**GIVEN, **KINDS[cb.GeneralDamping] | {"damping": damping})


def equations(rhs, **more):
    return lambda: cb.Equations(rhs=rhs, y0=(1.0, 2.0), t_end=1.0, **more)


def mine_pushed(force):
    return lambda: cb.Driven(**GIVEN, potential=lambda q, t: q[0] * force(t))


# -- calls -----------------------------------------------------------------------------------------
def solve(method="rk4", scene="particle", **options):
    return lambda: cb.solve(scene, method, **options)


def rk4(**options):
    return solve(**{"step": 0.1} | options)


def reference(times, **options):
    return lambda: cb.reference("particle", times, **options)


def changed(scene="particle", **changes):
    return lambda: cb.SCENES[scene].with_(**changes)


def composed(**changes):
    return lambda: cb.composition(**{"name": "x", "order": 2, "kick": [0.5, 0.5], "drift": [1]} | changes)


def run_from(method="rk4", rtol=None, **start):
    return lambda: cb.prepare("particle", method, rtol=rtol, step=None if rtol else 0.1)(**start)


def step(size, **parameters):
    return lambda: cb.step_map("particle", "rk4")((1.0,) * size, 0.1, **parameters)


def registered(registry, item):
    return lambda: registry.__setitem__("x", item)


def euler(scene, x, h, xp):
    return cb.shifted(x, h, scene.rhs(x))


#: a call, and a part of its refusal
CALLS = [
    # names
    (solve("contact-strnag", step=0.1), "did you mean 'contact-strang'?"),
    (lambda: cb.METHODS[[]], "unknown method []"),
    (changed(name="a\nb"), "name = 'a\\nb': must be"),
    (registered(cb.METHODS, 3), "3 cannot be registered: it is no method"),
    (registered(cb.METHODS, cb.METHODS["rk4"]), "method name 'x': must be"),
    # step and tolerance
    (solve(), "step is missing: rk4 has a fixed step; give step, or rtol"),
    (solve("quinlan-tremaine12", rtol=1e-6), "rtol = 1e-06: no step of quinlan-tremaine12 is chosen from a"),
    (rk4(rtol=1e-3), "step = 0.1 and rtol = 0.001: rk4 takes one of them"),
    (rk4(atol=1e-3), "atol = 0.001: rk4 has a fixed step and takes no atol"),
    (solve("cvode-bdf", step=0.1), "give rtol"),
    (solve("cvode-bdf", rtol=1e-30), "takes 2.3e-16 to 0.1"),
    (rk4(step=math.nan), "step = nan: must be a finite number"),
    (rk4(step=10**5000), "step = <int>: must be"),  # too long to be printed
    (rk4(step=[1.0, -1.0]), "step = [1.0, -1.0]: must be finite steps > 0"),
    (rk4(step=[1.0, 2.0]), "step: 2 steps to t = 3, none of which ends at t = 20"),
    (lambda: cb.geometric_steps(20.0, 24, 0.5, plateau=5), "plateau = 5: must divide count = 24"),
    # the nearest way to what there is not
    (lambda: cb.Mechanical(**FORCE, **GIVEN, gamma=lambda t: t), "cb.Driven(rate=lambda t: …)"),
    (lambda: cb.Mechanical(**FORCE, **GIVEN, kinetic=abs), "mass=(1., 2., 5.)"),
    (lambda: cb.Mechanical(**FORCE, **GIVEN, gamma=(0.1, 0.2)), "cb.diffrax.Contact"),
    (lambda: cb.Driven(**GIVEN, potential=lambda q: q[0]), "is called with q, t; it takes q"),
    (lambda: cb.SCENES["rigid_body"].with_(inertia=np.eye(3)), "three principal moments"),
    (lambda: cb.SCENES["heavy_top"].with_(gamma=abs), "solve_ivp"),
    (lambda: cb.SCENES["heavy_top"].with_(potential=lambda u: math.sin(u[0])), "use cb.math.sin"),
    (lambda: cb.compare("oscillator", []), "methods = []: must be names"),
    (rk4(gamma=0.2), "scene.with_(gamma=…)"),
    (rk4(dt=0.2), "dt: solve takes none: choose from about, atol"),
    (lambda: cb.Mechanical(**FORCE, **GIVEN, gama=0.1), "gama: Mechanical takes none: choose from"),
    (lambda: cb.Mechanical(**FORCE, **GIVEN, damping=abs), "cb.GeneralDamping"),
    (lambda: cb.Driven(**DRIVEN, **GIVEN, rate=lambda q, t: t), "a damping that depends on q is cb."),
    (lambda: cb.Mechanical(**GIVEN, potential=lambda q, p: q[0] * p[0]), "a force that depends on p is cb."),
    (lambda: cb.Mechanical(**GIVEN, potential=lambda q, t: q[0] * t), "cb.Driven(potential=lambda q, t: …)"),
    (lambda: cb.Mechanical(**GIVEN, potential=lambda q, k: k * q[0]), "parameters={'k': …}"),
    (lambda: cb.Mechanical(**FORCE, **GIVEN, hessian=lambda q, p: p), "it takes q, p"),
    (
        lambda: cb.Mechanical(**GIVEN, potential=abs, gradient=lambda q, p: q),
        "gradient: is called with q; it",
    ),
    (lambda: cb.Mechanical(**GIVEN, potential=np_norm), "use cb.math.sqrt(sum("),
    # equations of no Hamiltonian
    (lambda: cb.Equations(y0=(1.0,), t_end=1.0), "rhs: is missing, a function lambda t, y: …"),
    (equations(lambda y: y), "right_hand_side: is called with t, y; it takes y"),
    (equations(lambda t, y: y[0]), "rhs: must return 2 numbers, a tuple; it returns 1.0"),
    (equations(lambda t, y: y[:1]), "where rhs = (1.0,): must be 2 numbers"),
    (equations(lambda t, y: y, s=1.0), "s = 1.0: equations have no action"),
    (rk4(events=abs), "cb.scipy.Contact"),
    # other options
    (rk4(engine="fortran"), "engine = 'fortran': rk4 runs on llvm, python"),
    (rk4(save_at=[3.0, 1.0]), "strictly increasing"),
    (rk4(save_at=[]), "must be finite times"),
    (rk4(carry=("R",)), "can carry s"),
    (rk4(max_steps=0), "max_steps = 0"),
    (reference([1.0, math.nan]), "nan"),
    (reference([]), "shape"),
    # initial data and parameters
    (run_from(q=(1.0,)), "q = (1.0,): must be 2 numbers"),
    (run_from(q=(1e160, 0.0), method="scipy-dop853", rtol=1e-6), "is not finite there: State(q=(1e+160"),
    (changed(parameters=5), "parameters = 5: must be a dict"),
    (changed(mass=5e-324), "mass = 5e-324"),
    (changed("lane_emden_5", kappa=0.1), "without time"),
    (changed("lane_emden_5", gamma=0.1), "has it in it"),
    (lambda: GENERAL.with_(gamma=0.1), "Γ has them in it"),
    (changed(gama=0.1), "did you mean 'gamma'?"),
    (changed("lane_emden_5", rate=None), "its rate is missing"),
    (changed(q=(1.0,)), "q has 1 components and p 2"),
    (changed(BODY, inertia=(1.0, -2.0, 3.0)), "inertia = (1.0, -2.0, 3.0): all three moments must be > 0"),
    (changed(BODY, R=((1, 0, 0), (0, 1, 0), (0, 0, -1))), "it is a reflection; must be 1, a unit quaternion"),
    (changed(BODY, R=((1, 1e-3, 0), (0, 1, 0), (0, 0, 1))), "RᵀR is off the identity by 0.001; must be"),
    (changed(BODY, R=(1.1, 0, 0, 0)), "its length is 1.1; must be"),
    (changed(BODY, gamma=0.1, damping=(1.0, 1.0, 1.0)), "exactly one of gamma"),
    (changed(ANISOTROPIC, damping=((1, 2, 0), (0, 1, 0), (0, 0, 1))), "symmetric positive semi-definite"),
    # methods
    (lambda: cb.fixed_step("x", 1, exactly=True), "'exactly': a step map declares kind, family"),
    (lambda: cb.step_map("rigid_body", "contact-rkn6"), "contact-rkn6 needs kicks"),
    (lambda: cb.step_map("particle", "cvode-bdf"), "chooses its own steps"),
    (step(5, gama=1.0), "parameter of scene 'particle' 'gama': did you mean"),
    (step(4, gamma=math.nan), "gamma = nan"),
    (step(4), "y has 4 entries: must be 5"),
    (composed(kick=0.5), "kick = 0.5: must be a list"),
    (composed(kick=[0.5, "0.5000000001"]), "kick: coefficients add up to 1.0000000001"),
    (composed(kick=[0.5, 0.25, 0.25]), "kick has 3 coefficients and drift 1"),
    (composed(kick=[0.5, "x"]), "kick[1] = 'x': must be a number"),
    (composed(kick=[]), "kick = []: must have at least one coefficient"),
    (composed(name="rk4"), "method 'rk4' is already registered"),
    # functions that do not fit each other, whoever needs them first
    (wrong_user(hessian=lambda q: ((1 + 2 * q[1], 2 * q[0]), (q[0], 4.0))), "derivative: entry (2, 1) is"),
    (wrong_user(rotation_invariant=True), "exerts a torque"),
    (made(cb.GeneralDamping, s=0.5, damping=lambda s: s**3), "damping_slope is not the damping's"),
    # functions that return no number, fail, or leave
    (wrong_user(potential=lambda q: q), "its potential is (0.7, -0.4)"),
    (mine_pushed(lambda t: t % 1), "cb.math.floor"),
    (mine_pushed(lambda t: (t > 1) * (t < 2)), "cb.math.where"),
    (wrong_user(gradient=lambda q: q[5]), "test_bad_input.py, line "),
    (wrong_user(gradient=None, potential=lambda q: q[2]), "out of range; q has 2 components, from q[0] on"),
    (lambda: cb.solve(lambda t, y: y, "rk4", step=0.1), "it is cb.Equations(rhs=f, y0=…, t_end=…)"),
    (lambda: cb.compare(lambda t, y: y), "it is cb.Equations(rhs=f, y0=…, t_end=…)"),
    (wrong_user(gradient=lambda q: sys.exit(0)), "scene 'mine', <lambda> (test_bad_input.py, line "),
    (wrong_user(gradient=lambda q: {0: q[0]}), "gradient: must return 2 numbers, a tuple"),
    (made(cb.Driven, rate=lambda t: None), "rate: must return a real number; it returns None"),
    (made(cb.Driven, span=lambda t, h, xp: 1.0), "span: must return a pair"),
    (lambda: cb.reference(user(exact=lambda t: t), [1.0]), "scene 'mine': its closed form: TypeError"),
    (lambda: check_scene("particle"), "scene = 'particle': must be a scene"),
    (lambda: check_method("rk4"), "method = 'rk4': must be a method"),
]


@pytest.mark.timeout(300)
@pytest.mark.parametrize(("call", "says"), CALLS, ids=[says for _, says in CALLS])
def test_a_call_is_refused_in_one_line(call, says):
    assert says in refusal(call)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["gamma", "q", "xp", "self"])
def test_a_parameter_that_would_hide_another_name_is_refused(kind, name):
    scene = kind(**KINDS[kind], **GIVEN, parameters={"stiffness": 1.0})
    message = refusal(lambda: scene.with_(parameters={"stiffness": 1.0, name: 1.0}))
    assert f"parameter '{name}': must have a name of its own" in message


def run_of(method, engine):
    return partial(cb.solve, "particle", method, step=0.1, engine=engine)


STEPS = {
    "returns q = ": lambda scene, x, h, xp: x._replace(q=(*x.q, 1.0)),
    "returns s = None: must be like 0.0": lambda scene, x, h, xp: x._replace(s=None),
    "must be a State": lambda scene, x, h, xp: x.q,
    "returns s = 1j: must be like 0.0": lambda scene, x, h, xp: x._replace(s=1j),
    "<lambda> (test_bad_input.py, line ": lambda scene, x, h, xp: {}["a"],
    "SystemExit: 0": lambda scene, x, h, xp: sys.exit(0),
}


@pytest.mark.parametrize("engine", ["llvm", "python"])
@pytest.mark.parametrize("says", STEPS)
def test_a_step_map_that_makes_no_state_is_refused(says, engine):
    message = refusal(run_of(FixedStep("mine", 1, STEPS[says]), engine))
    assert says in message
    assert "method 'mine'" in message


def test_an_error_later_in_a_run_is_told_as_theirs():
    left = [9]

    def step(scene, x, h, xp):
        left[0] -= 1
        float(x.q[0])  # a step map that wants values is not recorded, but called step by step
        return x if left[0] else {}["a"]

    assert "step (test_bad_input.py, line" in refusal(run_of(FixedStep("mine", 1, step), "python"))


# -- what is taken ---------------------------------------------------------------------------------
@pytest.mark.timeout(300)
@pytest.mark.parametrize(("end", "step"), [(20.0, 1e-300), (1e300, 1e-5)])
def test_a_run_of_too_many_steps_ends_as_budget(end, step):
    scene = PARTICLE.with_(t_end=end)
    assert cb.solve(scene, "rk4", step=step, save_at=[end]).status is cb.Status.budget


@pytest.mark.timeout(300)
@pytest.mark.parametrize("method", ["scipy-dop853", "scipy-radau"])
def test_a_first_step_that_is_no_number_ends_the_run(method):
    """A slope that is finite at the start and not where the first step leads: SciPy's loop would not end."""
    assert not cb.solve(PARTICLE.with_(q=(1e100, 0.0)), method, rtol=1e-6, save_at=[1.0]).ok


@dataclass
class Euler:
    """A step map with data of its own, which `dataclass` leaves without a hash."""

    slopes: int = 1

    def __call__(self, scene, x, h, xp):
        return euler(scene, x, h, xp)


@pytest.mark.parametrize("engine", ["llvm", "python"])
def test_a_step_map_need_not_be_hashable(engine):
    own, plain = (run_of(FixedStep("own", 1, step), engine)() for step in (Euler(), euler))
    np.testing.assert_array_equal(own.y, plain.y)


# -- messages --------------------------------------------------------------------------------------
@pytest.mark.parametrize("off", [1e-15, -3e-8])
def test_an_attitude_that_is_rounded_is_the_nearest_one(off):
    angle = 0.3
    turn = np.array(
        [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
    )
    half = np.array([math.cos(angle / 2), 0, 0, math.sin(angle / 2)])
    for given in (turn + off * np.arange(9).reshape(3, 3), half * (1 + off)):
        R = np.array(cb.SCENES[BODY].with_(R=given.tolist()).R)
        assert abs(np.linalg.norm(R) - 1) < 1e-14
        assert np.abs(R - half).max() <= 10 * abs(off) + 1e-14


def test_a_comparison_that_heyoka_does_not_know_is_said_to_be_one():
    """Not by advice to write it as one."""
    jump = lambda q, t: q[0] * q[0] / 2 - q[0] * cb.math.where(t < 1.0, 0.5, 1.0)  # noqa: E731
    scene = cb.Driven(**GIVEN | {"t_end": 2.0}, potential=jump, breaks=(1.0,))
    run = cb.solve(scene, "heyoka-taylor", rtol=1e-6)
    assert run.status == "unsupported"
    assert "in `if` or cb.math.where, of a number" in run.message
    assert "a Taylor series has none, take another method" in run.message


# -- the command line ------------------------------------------------------------------------------
LINES = [
    ("solve particle rk44 --step 0.1", "unknown method 'rk44': did you mean 'rk4'?"),
    ("solve particle rk4 --step 0.1 --set gamma=abc", "--set gamma=abc"),
    ("solve particle rk4 --step 0.1 --set gamma=" + "[" * 3000, "gamma"),
    ("solve particle rk4 --step 0.1 --plugin /nonexistent/x.py", "no such file"),
    ("report --results /nonexistent", "no tables there"),
    ("compare particle rk4 --error small", "--error small: must be errors separated by commas"),
    ("compare particle rk4 --error -1e-3,1e-2", "error = -0.001: must be between 0 and 1"),
    ("compare particle rk4 --budget soon", "--budget soon: must be a time, as in 60s or 2m"),
    ("compare particle rk4 --budget 0", "budget = 0.0: must be > 0"),
    ("compare particle rk4 --plot out.txt", "--plot out.txt: must end in .svg, .png, .pdf"),
    ("compare particle --error 1e-6 1e-9", "unknown method '1e-9'"),
    ("compare my.py", "scene my.py: add the name of a scene that the file registers, as in my.py:NAME"),
    ("check particel", "unknown method or scene 'particel': did you mean 'particle'?"),
    ("check central --engine numba", "--engine numba: central is a scene"),
    ("claim C99", "unknown claim 'C99'"),
]


@pytest.mark.parametrize(("line", "says"), LINES, ids=[says for _, says in LINES])
def test_command_line_prints_one_line_and_exits_2(line, says, capsys):
    assert main(line.split()) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith("contactbench: ")
    assert says in err


@pytest.mark.parametrize("line", ["compare", "gate --only everything"])
def test_bad_usage_is_one_line(line, capsys):
    with pytest.raises(SystemExit) as caught:
        main(line.split())
    err = capsys.readouterr().err
    assert (caught.value.code, err.count("\n")) == (2, 1)
    assert err.startswith(f"contactbench {line.split()[0]}: ")


def test_command_line_solves_and_prints_json(capsys):
    line = "solve particle contact-strang --step 0.01 --set gamma=0.3 --json"
    assert main(line.split()) == 0
    out = json.loads(capsys.readouterr().out)
    assert out["status"] == "ok"
    assert set(out["state"]) == {"q1", "q2", "p1", "p2", "s"}
    assert out["counts"]["evaluations"] == 2001
    # H decays as e^{-γt}: an independent check on the printed number
    assert out["H"] == pytest.approx((0.625 + 0.045 + 0.05) * math.exp(-0.3 * 20), rel=1e-3)
