"""Every registered method keeps every rule of the contract; and a method that breaks one is told which."""

from dataclasses import dataclass, replace

import pytest

import contactbench as cb
from cases import refusal
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.loops import Plain
from contactbench.numbers.protocol import abilities
from contactbench.testing import METHOD_RULES, Violation, check_method
from contactbench.testing.method import CASES, case_findings

RK4 = cb.METHODS["rk4"]

INSTALLED = [(m, engine) for m in cb.METHODS.values() for engine in m.engines if not m.lacks(engine)]
PRODUCT = [(*pair, scene) for pair in INSTALLED for scene in CASES]
LABELS = [f"{method.name}-{engine}-{scene.name}" for method, engine, scene in PRODUCT]
#: those that Python alone runs, and one of every kind of run: rule 9 of the others compares with it
BY_PYTHON = tuple(m.name for m, _ in INSTALLED if m.engines == ("python",))
BY_PYTHON += ("contact-rkn8", "herglotz2", "rk8-7", "quinlan-tremaine8")
BODY_METHODS = ("contact-exact", "contact-bm6", "cvode-bdf", "cyrk-dop853")


@pytest.mark.parametrize(("method", "engine", "scene"), PRODUCT, ids=LABELS)
@pytest.mark.quick(scene="particle", engine=("llvm", "c", "c++"))
@pytest.mark.quick(scene="particle", engine="python", method=BY_PYTHON)
@pytest.mark.quick(scene="rigid_body", engine=("llvm", "c", "c++"), method=BODY_METHODS)
def test_a_method_keeps_its_contract(method, engine, scene):
    assert [found.rule for found in case_findings(method, engine, scene)] == list(METHOD_RULES)


# -- a violation of each rule ----------------------------------------------------------------------
def changed(kind, **methods):
    """A kind of run or method with some of its methods replaced."""
    return type("Changed", (kind,), methods)


def remember(run, y0):
    run.calls = getattr(run, "calls", 0) + 1
    out = FixedStepRun.integrate(run, y0)
    return replace(out, y=out.y * (1 + 1e-9 * run.calls))


def start_elsewhere(run, y0):
    out = FixedStepRun.integrate(run, y0)
    return replace(out, y=out.y + 1e-9 * (len(out.y) > 1))


def spend_more(run, y0):
    run.needed = 0
    return FixedStepRun.integrate(run, y0)


TIMED_ELSEWHERE = changed(
    FixedStepRun,
    shorten=lambda run: None,
    bare=lambda run, y0: FixedStepRun.bare(run, y0) * (1 + 1e-9),
)
DERIVES_WRONGLY = changed(FixedStepRun, sensitivity=lambda run, y0: 1.001 * FixedStepRun.sensitivity(run, y0))
OTHER_STEPS = changed(
    FixedStepRun,
    shorten=lambda run: None,
    take=lambda run, y0: (run.part(y0, y0, run.h * (1 + 1e-9), run.n, run.since), run.totals),
)


@dataclass(frozen=True)
class Broken(FixedStep):
    """RK4 on plain floats, run by a class that breaks a rule."""

    name: str = "broken"
    order: int = 4
    step: object = RK4.step
    evaluations: int = 4
    about: str = "planted"
    engines: tuple[str, ...] = ("python",)
    run: type[FixedStepRun] = FixedStepRun

    def prepare(self, request):
        if request.engine == "python" and request.step is not None:
            return self.run(self.name, request, self, Plain(self, request))
        return super().prepare(request)


def by_engine(scene, x, h, xp):
    """Other steps in compiled code."""
    return RK4.step(scene, x, h if abilities(xp).branch else h * (1 + 1e-9), xp)


BROKEN = [
    (1, Broken(about="")),
    (1, Broken(family="ours")),
    (1, Broken(engines=("python", "abacus"))),
    (2, changed(Broken, refuses=lambda method, scene: "")()),
    (3, Broken(run=changed(FixedStepRun, integrate=remember))),
    (4, Broken(run=changed(FixedStepRun, integrate=start_elsewhere))),
    (5, Broken(run=TIMED_ELSEWHERE)),
    (6, Broken(order=5)),
    (7, Broken(run=changed(FixedStepRun, integrate=spend_more))),
    (8, Broken(evaluations=3)),
    (8, Broken(kind="gradient", evaluations=3)),
    (9, Broken(engines=("python", "llvm"), step=by_engine)),
    (10, Broken(contact=True)),
    (10, Broken(symmetric=True)),
    (11, Broken(run=DERIVES_WRONGLY)),
    (12, changed(Broken, step_cost=lambda method, scene, engine: None)()),
]


@pytest.mark.parametrize(("rule", "method"), BROKEN, ids=[f"{r}-{i}" for i, (r, _) in enumerate(BROKEN)])
def test_a_broken_rule_is_named(rule, method):
    with pytest.raises(Violation) as caught:
        list(case_findings(method, method.engines[-1 if rule == 9 else 0], CASES[0]))
    assert caught.value.rule == rule, caught.value
    assert "broken" in str(caught.value)
    assert str(caught.value).endswith(f". {METHOD_RULES[rule].__doc__}")  # what to do


def test_every_rule_has_a_method_that_breaks_it():
    assert {rule for rule, _ in BROKEN} == set(METHOD_RULES)


@pytest.mark.parametrize(("engine", "other"), [("python", "llvm"), ("llvm", "python")])
def test_one_engine_alone_is_compared_with_another(engine, other):
    with pytest.raises(Violation, match=f"rule 9: .* {engine}: off {other}"):
        check_method(Broken(engines=("llvm", "python"), run=OTHER_STEPS), engines=[engine], scenes=CASES[:1])


def test_a_check_that_runs_nothing_is_refused():
    for nothing in ({"engines": []}, {"engines": ["c++"]}, {"scenes": []}):
        with pytest.raises(cb.BadInput, match="must be one or more"):
            check_method(Broken(), **nothing)
    refused = cb.METHODS["contact-exact"]
    found = list(case_findings(refused, "python", CASES[0]))
    assert [f.rule for f in found if f.not_here] == list(range(3, 12))
    with pytest.raises(cb.BadInput, match="refuses all"):
        check_method(refused, engines=["python"], scenes=CASES[:1])


# -- a step map of one's own -------------------------------------------------------------------------
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


def test_a_race_refuses_it_too_and_goes_on(registries, unconfirmed):
    cb.METHODS.add(FixedStep("free", 1, twice, 1, about="says that it costs half of what it does"))
    frame = cb.compare("oscillator", ["free", "rk4"], [0.1], budget=60.0)
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
    assert "test_contract.py, line" in found or "is called with" in says
