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
from contactbench.measure.order import march, order_at
from contactbench.methods.base import CALLBACKS, ENGINES, FAMILIES, METHODS, Method, prepare
from contactbench.methods.fixed_step import COUNTED, FixedStep
from contactbench.methods.loops import trajectory
from contactbench.methods.prepared import Prepared, Refused
from contactbench.registry import NAME
from contactbench.scene import Scene
from contactbench.scenes import SCENES
from contactbench.solution import Status
from contactbench.testing.rules import Finding, follow, require
from contactbench.truth import blow_up_time, decimal_context, reference

#: sizeable damping and other data than the registry's, so that nothing is tuned to the defaults
CASES = (
    SCENES["particle"].with_(gamma=0.35, q=(0.7, -0.6), p=(0.4, 0.5), s=0.3, t_end=4.0),
    SCENES["rigid_body"].with_(inertia=(1.0, 1.7, 2.1), gamma=0.25, M=(0.8, 0.9, -0.5), s=0.2, t_end=4.0),
    SCENES["rigid_body_anisotropic"].with_(M=(0.8, 0.9, -0.5), t_end=4.0),
)
#: on which runs that are asked for more than there is end
ESCAPE = "escape"
BUDGET = 2
#: parts of the span of a coarse and a fine step; tolerances likewise
STEPS, RTOLS = {"coarse": 80, "fine": 1280}, {"coarse": 1e-5, "fine": 1e-9}
#: of this order on steps of a tenth of the span leave hardly an error
HIGH = 10
#: how far an order extrapolated from 20, 40 and 80 steps may be off
ORDER = 0.02
#: the same of a library's steps, which no fifty digits run, and the numbers of them
ROUGH_ORDER, COUNTS = 0.2, (4, 6, 8, 11, 16, 23, 32, 45, 64)
#: the same operations in the same order, on arrays or by another call of the same program; by another compiler,
#: which contracts and reorders some, over 80 steps; an invariant over ten
SAME, COMPILED, ROUND_OFF = 1e-14, 1e-13, 1e-12
#: how many times the round-off of a step a formula of many steps may have: its coefficients are large, of both signs
MULTISTEP = 10
#: error over tolerance, at most, of a run this short
GROWTH = 1e3
#: what round-off of the phase leaves of a closed form
EXACT = 1e-10


@dataclass(frozen=True)
class MethodCase:
    """A method, engine and scene; first : whether what no engine changes is looked at; measured : by the rule."""

    method: Method
    engine: str
    scene: Scene
    first: bool = True
    measured: dict[str, float] = field(default_factory=dict, compare=False)

    def run(self, level: str = "coarse", **options: Any) -> Prepared:
        """Prepared at one of the settings of `STEPS` or `RTOLS`, to the end alone, unless the options say otherwise."""
        scene = options.pop("scene", self.scene)
        if not self.method.exact and not {"rtol", "step"} & {*options}:
            if self.method.adaptive:
                options["rtol"] = float(np.clip(RTOLS[level], *self.method.rtol_range))
            else:
                options["step"] = scene.t_end / STEPS[level]
        return prepare(scene, self.method, engine=self.engine, **{"save_at": [scene.t_end]} | options)

    def gap(self, a: np.ndarray, b: np.ndarray) -> float:
        """Return the largest relative difference of states or derivatives; ± a quaternion is one attitude."""
        part = [i for i, name in enumerate(self.scene.labels(self.scene.carry())) if name.startswith("R_")]
        axes = tuple(range(1, a.ndim))
        turned = (a[:, part] * b[:, part]).sum(axis=axes, keepdims=True) < 0
        a = a.copy()
        a[:, part] *= np.where(turned, -1.0, 1.0)
        return float(np.abs(a - b).max() / np.abs(b).max())

    def error(self, level: str = "coarse", **options: object) -> float:
        return float(LAWS["solution_error"](self.run(level, **options)()))

    def require_below(self, bound: float, what: str, value: float, message: str) -> None:
        self.measured[what] = value
        require(value < bound, f"{message}: {what} {value:.1e}")


def declares(case: MethodCase) -> None:
    method = case.method
    require(isinstance(method, Method), "no Method")
    require(isinstance(method.name, str) and NAME.fullmatch(method.name), f"name = {method.name!r}")
    require(method.about and "\n" not in method.about, f"about = {method.about!r}: must be one line")
    require(method.family in FAMILIES, f"family = {method.family!r}: must be one of {', '.join(FAMILIES)}")
    require(method.engines and set(method.engines) <= set(ENGINES), f"engines = {method.engines!r}")
    varies, order = method.control != "step", method.order
    require((order is None and varies) or (isinstance(order, int) and order > 0), f"order = {order!r}")
    low, high = method.rtol_range
    require(0 < low < high, f"rtol_range = {method.rtol_range!r}")
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
    field = case.scene.initial_fields[0]
    moved = {field: tuple(0.9 * c + 0.01 for c in getattr(case.scene, field))}
    first, other, again = run(), run(**moved), run()
    require(np.array_equal(first.y, again.y, equal_nan=True), "a second call gives another result")
    fresh = case.run(save_at=save_at, scene=case.scene.with_(**moved))()
    require(np.array_equal(other.y, fresh.y), f"{moved}: not what a run prepared for them gives")
    require(not np.array_equal(first.y, other.y), f"{moved}: makes no difference")


def saves(case: MethodCase) -> None:
    scene = case.scene
    times = scene.t_end * np.array([0.0, 0.13, 0.5, 1.0])
    solution = case.run(save_at=times)()
    require(solution.ok, f"ends {solution.status}: {solution.message}")
    require(np.array_equal(solution.t, times), f"t = {solution.t}")
    require(solution.y.shape == (4, len(scene.labels(scene.carry()))), f"states of shape {solution.y.shape}")
    require(np.array_equal(solution.y[0], scene.pack(scene.initial(scene.carry()))), "another initial state")
    require(solution.end_time == times[-1], f"ends at {solution.end_time}")
    gap = case.gap(solution.y[1:], reference(scene, times[1:]).y)
    labels, last = scene.labels(scene.carry()), reference(scene, times[1:]).y[-1]
    worst = labels[int(np.argmax(np.abs(solution.y[-1] - last)))]
    case.require_below(
        0.1, "error", gap, f"the states are those of other times, or wrong: most of all {worst}"
    )


def is_timed_by_its_own_call(case: MethodCase) -> None:
    run = case.run()
    bare, whole = run.bare(run.start), run().y[-1]
    require(bare.shape == whole.shape, f"bare gives shape {bare.shape}")
    case.require_below(SAME, "gap", case.gap(bare[None], whole[None]), "bare ends off the run's last state")


def truncation(case: MethodCase) -> float:
    """Return what the fine step leaves of an error of the method's order, constants of size one."""
    step = case.scene.t_end / STEPS["fine"]
    return float(10 * step ** min(case.method.order or 1, 3))


def order_by_runs(case: MethodCase) -> float:
    """Return the order by the two finest of runs whose errors are no round-off."""
    steps = [case.scene.t_end / n for n in COUNTS]
    errors = [error for h in steps if (error := case.error(step=h)) > ROUND_OFF]
    (h, e), (finer, less) = list(zip(steps, errors, strict=False))[-2:]
    return math.log(e / less) / math.log(h / finer)


def is_controlled_by_its_setting(case: MethodCase) -> None:
    method: Any = case.method
    if method.control == "step":
        if case.first:
            own = isinstance(method, FixedStep)
            steps = 20 if method.one_step else 160  # of many steps of history
            order = order_at(method, case.scene, 1.0, steps) if own else order_by_runs(case)
            case.measured["order"] = order
            off = abs(order - method.order)
            require(off < (ORDER if own else ROUGH_ORDER), f"of order {order:.3f}, not {method.order}")
        case.require_below(truncation(case), "error", case.error("fine"), "at a fine step")
    elif method.exact:
        case.require_below(1e-12, "error", case.error(), "exact")
        settings: tuple[dict[str, Any], ...] = ({"step": 0.1}, {"rtol": 1e-6})
        for setting in settings:
            try:
                case.run(**setting)
            except BadInput:
                continue
            raise AssertionError(f"exact, and takes {setting}")
    else:
        for rtol in (1e-4, 1e-7, 1e-10):
            case.measured[f"error at rtol {rtol:.0e}"] = case.error(rtol=rtol)
        errors = list(case.measured.values())
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
    """Return the scene with a function that counts its calls, and the count; it cannot be recorded."""
    of_force = "gradient_at" if scene.by_sites else "gradient"
    calls, name = [0], of_force if kind == "gradient" else "rhs"
    original = getattr(scene, name)

    def counting(x: Any, **parameters: float) -> object:
        calls[0] += 1
        first = x[0] if name == "gradient" else x[0][0]
        require(float(np.ravel(first)[0]) < math.inf, "not finite")  # asks for the value
        return original(x, **parameters)

    return scene._replaced(**{name: counting}), calls


def counts(case: MethodCase) -> None:
    method: Any = case.method
    scene = case.scene
    found = case.run()().counts
    require(found.evaluations is None or found.evaluations > 0, f"evaluations = {found.evaluations!r}")
    if method.control == "step":
        expected = method.counts(scene, 1) + (STEPS["coarse"] - 1) * method.per_step(scene)
        require(found.steps == STEPS["coarse"], f"{found.steps} steps")
        known = method.iterates or found.evaluations == expected
        require(known, f"{found.evaluations} evaluations, not {expected}")
        require(found.kind == method.kind_on(scene), f"counts {found.kind}")
    if found.evaluations is not None:
        case.measured["evaluations"] = found.evaluations
    # what cannot be counted on an engine is counted on another
    engine = next((e for e in (case.engine, *method.engines) if e in CALLBACKS), None)
    if engine and (engine == case.engine or case.first) and found.kind in ("gradient", "rhs"):
        twin, calls = with_counter(scene, found.kind)
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
    # the default, and for itself the last: JAX compiles for seconds
    for engine in (method.engines[0], *reversed(method.engines)):
        if method.lacks(engine):
            continue
        run = replace(case, engine=engine).run(level, save_at=times)
        if engine != case.engine and not isinstance(run, Refused):
            case.require_below(bound, f"off {engine}", case.gap(mine, run().y), case.engine)
            break
    if isinstance(method, FixedStep):
        x = scene.initial(scene.carry())
        pair = scene.unpack([np.array([v, 1.1 * v]) for v in scene.pack(x)], scene.carry())
        together = next(trajectory(method, scene, pair, [(0.1, 5)], np))
        alone = next(trajectory(method, scene, x, [(0.1, 5)], math))
        gap = case.gap(np.array([[c[0] for c in scene.pack(together)]]), np.array([scene.pack(alone)]))
        case.require_below(same, "arrays off numbers", gap, "on arrays")


def claims(case: MethodCase) -> None:
    method, scene, measured = case.method, case.scene, case.measured
    if scene.conformal_rate is not None and (method.contact or isinstance(method, FixedStep)):
        steps = 10 if (method.order or 1) < HIGH else 3  # an error far above round-off
        coarse: dict[str, Any] = {"step": scene.t_end / steps} if method.control == "step" else {}
        measured["contact drift"] = drift = LAWS["contact_drift"](case.run(**coarse)())
        # to round-off times the growth of the phase's own error along the run
        kept = drift < (EXACT if method.exact else ROUND_OFF)
        require(kept == method.contact, f"contact = {method.contact}, with a contact drift of {drift:.1e}")
    if isinstance(method, FixedStep) and method.one_step and case.first:
        context = decimal_context(50)
        ahead = march(method, scene, "0.2", 3, context)
        back = march(method, scene, "-0.2", 3, context, ahead)
        there = march(method, scene, "0", 1, context)
        measured["steps back"] = gap = float(max(abs(a - b) for a, b in zip(back, there, strict=True)))
        says = f"symmetric = {method.symmetric}: three steps and back leave {gap:.1e}"
        require((gap < 1e-45) == method.symmetric, says)


def differentiates(case: MethodCase) -> str | None:
    run = case.run("fine")
    if not run.sensitivity_source:
        return "no derivative"
    mine = run.sensitivity(run.start)
    exact = MethodCase(METHODS["rk4"], "numba", case.scene).run("fine")
    bound = truncation(case) if case.method.control == "step" else GROWTH * RTOLS["fine"]
    case.require_below(bound, "gap", case.gap(mine, exact.sensitivity(exact.start)), "not that of the flow")
    return None


def costs(case: MethodCase) -> None:
    if case.method.refuses(case.scene) is not None:
        return
    cost = case.method.step_cost(case.scene, case.engine)
    require(cost is None or cost > 0, f"step_cost = {cost!r}")
    require(cost or case.engine not in CALLBACKS, f"no step_cost on {case.engine}, which calls back")
    case.measured.update({} if cost is None else {"right-hand sides": cost})


Rule = Callable[[MethodCase], str | None]


def runs(rule: Rule) -> Rule:
    @wraps(rule)
    def follow_rule(case: MethodCase) -> str | None:
        return rule(case) if case.method.refuses(case.scene) is None else "the scene is refused"

    return follow_rule


RUN: tuple[Rule, ...] = (leaves_no_trace, saves, is_timed_by_its_own_call, is_controlled_by_its_setting)
RUN += (ends_as_it_says, counts, engines_agree, claims, differentiates)
METHOD_RULES: dict[int, Rule] = dict(enumerate((declares, refuses, *map(runs, RUN), costs), start=1))


def method_cases(
    method: Method, engines: Iterable[str] | None = None, scenes: Iterable[Scene] = CASES
) -> Iterator[MethodCase]:
    lacking = {engine: lacks for engine in method.engines if (lacks := method.lacks(engine))}
    installed = [engine for engine in method.engines if engine not in lacking] or method.engines
    scenes, chosen = tuple(scenes), tuple(installed if engines is None else engines)
    if not (chosen and scenes and set(chosen) <= set(method.engines)):
        allowed = f"must be one or more, engines of {', '.join(method.engines)}"
        raise BadInput(f"engines = {excerpt(chosen)}, scenes = {excerpt(scenes)}: {allowed}")
    for engine in lacking.keys() & set(chosen):
        raise BadInput(f"engine {engine}: {lacking[engine]}")
    for engine in chosen:
        for scene in scenes:
            yield MethodCase(method, engine, scene, first=engine == chosen[0])


def method_findings(
    method: Method, engines: Iterable[str] | None = None, scenes: Iterable[Scene] = CASES
) -> Iterator[Finding]:
    cases = list(method_cases(method, engines, scenes))
    for case in cases:
        yield from case_findings(case)
    if all(method.refuses(case.scene) is not None for case in cases):
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


def case_findings(case: MethodCase) -> Iterator[Finding]:
    what = f"{case.method.name} ({case.engine}) on {case.scene.name}"
    return follow(METHOD_RULES, case, what, case.engine, case.scene.name)
