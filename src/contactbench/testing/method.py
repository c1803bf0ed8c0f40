"""The rules of `methods.base.Method`, by their numbers there."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import wraps
from typing import Any

import numpy as np

from contactbench.errors import BadInput, excerpt
from contactbench.measure.laws import LAWS
from contactbench.measure.order import fit_order, march, order_at
from contactbench.methods.base import CALLBACKS, ENGINES, FAMILIES, METHODS, Method, prepare
from contactbench.methods.fixed_step import COUNTED, FixedStep
from contactbench.methods.prepared import Prepared, Refused
from contactbench.registry import NAME
from contactbench.scene import Scene
from contactbench.scenes import SCENES
from contactbench.solution import Status
from contactbench.testing.rules import Finding, follow, require
from contactbench.truth import blow_up_time, decimal_context

#: sizeable damping and other data than the registry's, so that nothing is tuned to the defaults
CASES = (
    SCENES["particle"].with_(gamma=0.35, q=(0.7, -0.6), p=(0.4, 0.5), s=0.3, t_end=4.0),
    SCENES["rigid_body"].with_(inertia=(1.0, 1.7, 2.1), gamma=0.25, M=(0.8, 0.9, -0.5), s=0.2, t_end=4.0),
    SCENES["rigid_body_anisotropic"].with_(M=(0.8, 0.9, -0.5), t_end=4.0),
)
#: on which runs that are asked for more than there is end
ESCAPE, BUDGET = "escape", 2
#: parts of the span of a coarse and a fine step; tolerances likewise
STEPS, RTOLS = {"coarse": 80, "fine": 1280}, {"coarse": 1e-5, "fine": 1e-9}
#: of this order on steps of a tenth of the span leave hardly an error
HIGH = 10
#: how far an order may be off, by steps at fifty digits; by runs of so many steps, where there are no digits but these
ORDER, ROUGH_ORDER, COUNTS = 0.02, 0.2, (4, 6, 8, 11, 16, 23, 32, 45, 64)
#: of another call of the same program; of another compiler over 80 steps, and of an invariant over ten
SAME, COMPILED, ROUND_OFF = 1e-14, 1e-13, 1e-12
#: how many times that of a method which feeds on its own history
MULTISTEP = 10
#: error over tolerance, at most, of a run this short; and what round-off of the phase leaves of a closed form
GROWTH, EXACT = 1e3, 1e-10


@dataclass(frozen=True)
class MethodCase:
    """A method on an engine and a scene, and what the rule that is followed measured."""

    method: Method
    engine: str
    scene: Scene
    measured: dict[str, float] = field(default_factory=dict, compare=False)

    def run(self, level: str = "coarse", **options: Any) -> Prepared:
        """Prepare at a setting of `STEPS` or `RTOLS`, to the end alone, unless the options say otherwise."""
        scene = options.pop("scene", self.scene)
        if not self.method.exact and not {"rtol", "step"} & {*options}:
            if self.method.adaptive:
                options["rtol"] = float(np.clip(RTOLS[level], *self.method.rtol_range))
            else:
                options["step"] = scene.t_end / STEPS[level]
        return prepare(scene, self.method, engine=self.engine, **{"save_at": [scene.t_end]} | options)

    def error(self, level: str = "coarse", **options: object) -> float:
        return float(LAWS["solution_error"](self.run(level, **options)()))

    @property
    def truncation(self) -> float:
        """Return what the fine setting leaves of an error, constants of size one."""
        if self.method.control != "step":
            return GROWTH * RTOLS["fine"]
        return float(10 * (self.scene.t_end / STEPS["fine"]) ** min(self.method.order or 1, 3))

    def require_below(self, bound: float, what: str, value: float, message: str) -> None:
        self.measured[what] = value
        require(value < bound, f"{message}: {what} {value:.1e}")


def gap(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(a - b).max() / np.abs(b).max())


def declares(case: MethodCase) -> None:
    method = case.method
    require(isinstance(method.name, str) and NAME.fullmatch(method.name), f"name = {method.name!r}")
    require(method.about and "\n" not in method.about, f"about = {method.about!r}: must be one line")
    require(method.family in FAMILIES, f"family = {method.family!r}: must be one of {', '.join(FAMILIES)}")
    require(method.engines and set(method.engines) <= set(ENGINES), f"engines = {method.engines!r}")
    varies, order = method.control != "step", method.order
    require((order is None and varies) or (isinstance(order, int) and order > 0), f"order = {order!r}")
    require(0 < method.rtol_range[0] < method.rtol_range[1], f"rtol_range = {method.rtol_range!r}")
    require(method.tolerance, "tolerance: says nothing of what rtol bounds")


def refuses(case: MethodCase) -> None:
    why = case.method.refuses(case.scene)
    require(why is None or (isinstance(why, str) and why.strip()), f"refuses = {why!r}")
    if why is not None:
        solution = case.run()()
        require(solution.status is Status.unsupported, f"a refused scene ends {solution.status}")
        require(solution.message == why, f"message = {solution.message!r}")
        require(np.isnan(solution.y).all(), "a refused scene has states")


def leaves_no_trace(case: MethodCase) -> None:
    save_at = [case.scene.t_end / 4]
    run = case.run(save_at=save_at)
    require(not isinstance(run, Refused), f"engine {case.engine!r}: {getattr(run, 'why', '')}")
    name = case.scene.initial_fields[0]
    moved = {name: tuple(0.9 * c + 0.01 for c in getattr(case.scene, name))}
    first, other, again = run(), run(**moved), run()
    require(np.array_equal(first.y, again.y, equal_nan=True), "a second call gives another result")
    fresh = case.run(save_at=save_at, scene=case.scene.with_(**moved))()
    require(np.array_equal(other.y, fresh.y), f"{moved}: not what a run prepared for them gives")
    require(not np.array_equal(first.y, other.y), f"{moved}: makes no difference")


def saves(case: MethodCase) -> None:
    scene = case.scene
    times, start = scene.t_end * np.array([0.0, 0.13, 0.5, 1.0]), scene.pack(scene.initial(scene.carry()))
    solution = case.run(save_at=times)()
    require(solution.ok, f"ends {solution.status}: {solution.message}")
    require(np.array_equal(solution.t, times), f"t = {solution.t}")
    require(solution.y.shape == (4, len(start)), f"states of shape {solution.y.shape}")
    require(np.array_equal(solution.y[0], start), "another initial state")
    require(solution.end_time == times[-1], f"ends at {solution.end_time}")
    error = float(LAWS["solution_error"](solution))
    case.require_below(0.1, "error", error, "the states are those of other times, or wrong")


def is_timed_by_its_own_call(case: MethodCase) -> None:
    run = case.run()
    bare, whole = run.bare(run.start), run().y[-1]
    require(bare.shape == whole.shape, f"bare gives shape {bare.shape}")
    case.require_below(SAME, "gap", gap(bare, whole), "bare ends off the run's last state")


def is_controlled_by_its_setting(case: MethodCase) -> None:
    method: Any = case.method
    if method.control == "step":
        if own := isinstance(method, FixedStep):
            order = order_at(method, case.scene, 1.0, 20 if method.one_step else 160)  # many steps of history
        else:
            steps = [case.scene.t_end / n for n in COUNTS]
            order = fit_order(steps, [case.error(step=h) for h in steps], ROUND_OFF).order
        case.measured["order"] = order
        near = abs(order - method.order) < (ORDER if own else ROUGH_ORDER)
        require(near, f"of order {order:.3f}, not {method.order}")
        case.require_below(case.truncation, "error", case.error("fine"), "at a fine step")
    elif method.exact:
        case.require_below(ROUND_OFF, "error", case.error(), "exact")
    else:
        errors = [case.error(rtol=rtol) for rtol in (1e-4, 1e-7, 1e-10)]
        case.measured["error at rtol 1e-10"] = errors[-1]
        require(errors[0] > 10 * errors[1] > 100 * errors[2], f"errors {errors} at rtol 1e-4, 1e-7, 1e-10")


def ends_as_it_says(case: MethodCase) -> None:
    times, asked = case.scene.t_end * np.arange(1, 11) / 10, f"max_steps = {BUDGET}"
    solution = case.run("fine", save_at=times, max_steps=BUDGET)()
    require(solution.status is Status.budget, f"{asked}: ends {solution.status}")
    require(str(BUDGET) in solution.message, f"{asked}: says {solution.message!r}")
    require(np.isnan(solution.y[-1]).all(), f"{asked}: has a state at the end")
    escape = SCENES[ESCAPE]
    if case.method.refuses(escape) is not None:
        return
    setting: dict[str, Any] = {"step": 0.002} if case.method.control == "step" else {}
    solution = case.run(scene=escape, max_steps=20_000, **setting)()
    require(solution.status is Status.diverged, f"beyond the blow-up: ends {solution.status}")
    require(np.isnan(solution.y[-1]).all(), "diverged, with a state at the end")
    found = blow_up_time(escape)
    off = abs(solution.end_time / float(found[0]) - 1) if found else math.inf
    case.require_below(0.01, "end of a blow-up", off, "diverged at another time")


def with_counter(scene: Scene, kind: str) -> tuple[Scene, list[int]]:
    """Return the scene with a gradient or rhs that counts its calls, and the count; it cannot be recorded."""
    calls, original = [0], getattr(scene, kind)

    def counting(x: Any, **parameters: float) -> object:
        calls[0] += 1
        float(x[0] if kind == "gradient" else x[0][0])  # asks for the value
        return original(x, **parameters)

    return scene._replaced(**{kind: counting}), calls


def counts(case: MethodCase) -> None:
    method: Any = case.method
    found = case.run()().counts
    require(found.evaluations is None or found.evaluations > 0, f"evaluations = {found.evaluations!r}")
    if method.control == "step":
        expected = method.counts(case.scene, 1) + (STEPS["coarse"] - 1) * method.per_step(case.scene)
        require(found.steps == STEPS["coarse"], f"{found.steps} steps")
        known = method.iterates or found.evaluations == expected
        require(known, f"{found.evaluations} evaluations, not {expected}")
        require(found.kind == method.kind_on(case.scene), f"counts {found.kind}")
    if found.evaluations is not None:
        case.measured["evaluations"] = found.evaluations
    # what cannot be counted on an engine is counted on another
    engine = next((e for e in (case.engine, *method.engines) if e in CALLBACKS), None)
    if engine and found.kind in COUNTED:
        twin, calls = with_counter(case.scene, found.kind)
        run = replace(case, engine=engine).run(scene=twin)
        calls[0] = 0
        reported = run().counts.evaluations
        case.measured["calls"] = calls[0]
        says = f"{reported} evaluations reported, {calls[0]} calls of the {COUNTED[found.kind]}"
        require(
            reported == calls[0], f"{says} in {found.steps} steps: declare evaluations= and kind= as it is"
        )


def engines_agree(case: MethodCase) -> None:
    times, method, scene = case.scene.t_end * np.array([0.5, 1.0]), case.method, case.scene
    level, bound = ("fine", 10 * RTOLS["fine"]) if method.adaptive else ("coarse", COMPILED)
    bound, same = (b if method.one_step else MULTISTEP * b for b in (bound, SAME))
    mine = case.run(level, save_at=times)().y
    for engine in method.engines:
        if engine != case.engine and not method.lacks(engine):
            run = replace(case, engine=engine).run(level, save_at=times)
            if not isinstance(run, Refused):
                case.require_below(bound, f"off {engine}", gap(mine, run().y), case.engine)
    if isinstance(method, FixedStep):
        x = scene.initial(scene.carry())
        pair = scene.unpack([np.array([c, 1.1 * c]) for c in scene.pack(x)], scene.carry())
        together, alone = (method.advance(scene, *given) for given in ((pair, 0.1, 5, np), (x, 0.1, 5, math)))
        first = np.array([np.ravel(c)[0] for c in scene.pack(together)])
        case.require_below(same, "arrays off numbers", gap(first, np.array(scene.pack(alone))), "on arrays")


def claims(case: MethodCase) -> None:
    method, scene, measured = case.method, case.scene, case.measured
    if scene.conformal_rate is not None and (method.contact or isinstance(method, FixedStep)):
        steps = 10 if (method.order or 1) < HIGH else 3  # an error far above round-off
        coarse: dict[str, Any] = {"step": scene.t_end / steps} if method.control == "step" else {}
        measured["contact drift"] = drift = LAWS["contact_drift"](case.run(**coarse)())
        # to round-off times the growth of the phase's own error along the run
        kept = drift < (EXACT if method.exact else ROUND_OFF)
        require(kept == method.contact, f"contact = {method.contact}, with a contact drift of {drift:.1e}")
    if isinstance(method, FixedStep) and method.one_step:
        context = decimal_context(50)
        ahead = march(method, scene, "0.2", 3, context)
        back, there = march(method, scene, "-0.2", 3, context, ahead), march(method, scene, "0", 1, context)
        measured["steps back"] = off = float(max(abs(a - b) for a, b in zip(back, there, strict=True)))
        says = f"symmetric = {method.symmetric}: three steps and back leave {off:.1e}"
        require((off < 1e-45) == method.symmetric, says)


def differentiates(case: MethodCase) -> str | None:
    run = case.run("fine")
    if not run.sensitivity_source:
        return "no derivative"
    exact = MethodCase(METHODS["rk4"], "llvm", case.scene).run("fine")
    sign = np.sign(run().y * exact().y)[..., None]  # a quaternion and its negative are one attitude
    off = gap(sign * run.sensitivity(run.start), exact.sensitivity(exact.start))
    case.require_below(case.truncation, "gap", off, "not that of the flow")
    return None


def costs(case: MethodCase) -> None:
    if case.method.refuses(case.scene) is not None:
        return
    cost = case.method.step_cost(case.scene, case.engine)
    require(cost is None or cost > 0, f"step_cost = {cost!r}")
    require(cost or case.engine not in CALLBACKS, f"no step_cost on {case.engine}, which calls back")
    case.measured.update({} if cost is None else {"right-hand sides": cost})


Rule = Callable[[MethodCase], str | None]


def of_a_run(rule: Rule) -> Rule:
    @wraps(rule)
    def follow_rule(case: MethodCase) -> str | None:
        return rule(case) if case.method.refuses(case.scene) is None else "the scene is refused"

    return follow_rule


RUN: tuple[Rule, ...] = (leaves_no_trace, saves, is_timed_by_its_own_call, is_controlled_by_its_setting)
RUN += (ends_as_it_says, counts, engines_agree, claims, differentiates)
METHOD_RULES: dict[int, Rule] = dict(enumerate((declares, refuses, *map(of_a_run, RUN), costs), start=1))


def case_findings(method: Method, engine: str, scene: Scene) -> Iterator[Finding]:
    what = f"{method.name} ({engine}) on {scene.name}"
    return follow(METHOD_RULES, MethodCase(method, engine, scene), what, engine)


def method_findings(
    method: Method, engines: Iterable[str] | None = None, scenes: Iterable[Scene] = CASES
) -> Iterator[Finding]:
    installed = [engine for engine in method.engines if not method.lacks(engine)] or method.engines
    scenes, chosen = tuple(scenes), tuple(installed if engines is None else engines)
    if not (chosen and scenes and set(chosen) <= set(method.engines)):
        allowed = f"must be one or more, engines of {', '.join(method.engines)}"
        raise BadInput(f"engines = {excerpt(chosen)}, scenes = {excerpt(scenes)}: {allowed}")
    for engine in chosen:
        if lacks := method.lacks(engine):
            raise BadInput(f"engine {engine}: {lacks}")
    for engine in chosen:
        for scene in scenes:
            yield from case_findings(method, engine, scene)
    if all(method.refuses(scene) is not None for scene in scenes):
        raise BadInput(f"scenes: {method.name} refuses all it is checked on; give scenes it takes")


def check_method(
    method: Method, *, engines: Iterable[str] | None = None, scenes: Iterable[Scene] = CASES
) -> list[Finding]:
    """Follow every rule of `methods.base.Method`.

    Parameters
    ----------
    method
        Itself, such as ``cb.METHODS["mine"]``.
    engines
        By default all of the method whose packages are installed.
    scenes
        By default one of every kind.

    Returns
    -------
    list of Finding
        The rules that were followed, on which engine and scene, and what was measured.

    Raises
    ------
    Violation
        Where a rule is broken.
    BadInput
        Where the method refuses all scenes, or is none.

    Examples
    --------
    >>> import contactbench as cb
    >>> from contactbench.testing import check_method
    >>> oscillator = cb.SCENES["oscillator"]
    >>> found = check_method(cb.METHODS["contact-strang"], engines=["python"], scenes=[oscillator])
    >>> found[0].rule
    1
    """
    if not isinstance(method, Method):
        raise BadInput(f"method = {excerpt(method)}: must be a method, such as cb.METHODS['rk4']")
    return list(method_findings(method, engines, scenes))
