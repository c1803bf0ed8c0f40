"""A step map of one's own: what it declares is counted wherever it runs; what goes wrong in it is one line."""

import pytest

import contactbench as cb
from cases import refusal
from contactbench.methods.fixed_step import FixedStep

SCENES = ["oscillator", "forced_oscillator", "rigid_body"]


def euler(scene, x, h, xp):
    return cb.shifted(x, h, scene.rhs(x))


def twice(scene, x, h, xp):
    return cb.shifted(x, h, scene.rhs(cb.shifted(x, h, scene.rhs(x))))


def kicked(scene, x, h, xp):
    return x._replace(p=tuple(p - h * g for p, g in zip(x.p, scene.gradient_at(x), strict=True)))


def solved(step, evaluations, scene="oscillator", kind="rhs", carry=None):
    own = FixedStep("own", 1, step, evaluations, kind, about="mine")
    return lambda: cb.solve(scene, own, step=0.1, save_at=[0.2], carry=carry, engine="python")


@pytest.mark.parametrize("scene", SCENES)
def test_the_evaluations_it_declares_are_those_it_makes(scene):
    assert solved(twice, 2, scene)().counts.evaluations == 4
    assert "counted: right-hand side 2" in refusal(solved(twice, 1, scene))
    assert "declare evaluations=2" in refusal(solved(twice, 3, scene))


@pytest.mark.parametrize("scene", ["oscillator", "forced_oscillator"])
def test_a_kind_that_it_never_evaluates_is_not_the_one_it_is(scene):
    assert 'right-hand side 0, gradient 1: declare kind="gradient"' in refusal(solved(kicked, 1, scene))
    assert solved(kicked, 1, scene, "gradient")().counts.evaluations == 2
    assert "declare evaluations=1" in refusal(solved(euler, 2, scene, "gradient"))


def test_a_race_refuses_it_too_and_goes_on(registries):
    cb.METHODS.add(FixedStep("free", 1, twice, 1, about="says that it costs half of what it does"))
    frame = cb.compare("oscillator", ["free", "rk4"], [0.1], budget=20.0)
    assert list(frame["status"]) == ["failed", "ok"]
    assert "counted: right-hand side 2" in frame["reason"][0]


STATE = "x = State(q=(1.0,), p=(0.0,), s=None)"
CALLABLE = "scene.dV(q) and scene.velocity(p), which know the scene's parameters"
WRONG = {
    "action": (lambda scene, x, h, xp: x._replace(s=x.s + h), f"{STATE}: vectors are tuples, fields not"),
    "vector": (lambda scene, x, h, xp: x._replace(p=x.p - h * x.q), STATE),
    "parameters": (lambda scene, x, h, xp: x._replace(p=scene.gradient(x.q)), CALLABLE),
    "arguments": (lambda scene, x, h: x, "a step map is called with scene, x, h, xp"),
    "body": (lambda scene, x, h, xp: x._replace(M=x.M), STATE),
}


@pytest.mark.parametrize(("step", "says"), WRONG.values(), ids=WRONG)
def test_an_error_inside_names_its_line_and_what_the_state_holds(step, says):
    found = refusal(solved(step, 1, carry=()))
    assert says in found
    assert "test_own_steps.py, line" in found or "is called with" in says
