"""The rules of `methods.base.Method`, by their numbers there."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, wraps
from typing import Any

import numpy as np

from contactbench.errors import NAME, BadInput, excerpt
from contactbench.measure.laws import LAWS
from contactbench.measure.order import march, order_at
from contactbench.methods.base import CALLBACKS, ENGINES, FAMILIES, METHODS, Method
from contactbench.methods.entry import prepare
from contactbench.methods.prepared import Prepared, Refused
from contactbench.methods.step_map import StepMap, trajectory
from contactbench.scene import Scene
from contactbench.scenes import SCENES
from contactbench.solution import Status
from contactbench.testing.rules import DoesNotApply, Finding, follow, require
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
#: how far an order extrapolated from 20, 40 and 80 steps may be off
ORDER = 0.02
#: the same operations in the same order, on arrays or by another call of the same program; by another compiler,
#: which contracts and reorders some, over 80 steps; an invariant over ten
SAME, COMPILED, ROUND_OFF = 1e-14, 1e-13, 1e-12
#: error over tolerance, at most, of a run this short
GROWTH = 1e3
#: what round-off of the phase leaves of a closed form
EXACT = 1e-10


@dataclass(frozen=True)
class MethodCase:
    """A method on an engine and a scene.

    first : whether what no engine changes is looked at here.  measured : by the rule that is followed.
    """

    method: Method
    engine: str
    scene: Scene
    first: bool = True
    measured: dict[str, float] = field(default_factory=dict, compare=False)

    def run(self, level: str = "coarse", scene: Scene | None = None, **options: Any) -> Prepared:
        """Prepared at one of the settings of `STEPS` or `RTOLS`, unless the options say otherwise."""
        scene = scene or self.scene
        if not self.method.exact and not {"rtol", "step"} & {*options}:
            if self.method.adaptive:
                low, high = self.method.rtol_range
                options["rtol"] = min(max(RTOLS[level], low), high)
            else:
                options["step"] = scene.t_end / STEPS[level]
        return prepare(scene, self.method, engine=self.engine, **options)

    @cached_property
    def refused(self) -> bool:
        """Whether there is nothing to run."""
        return self.method.refuses(self.scene) is not None

    def gap(self, a: np.ndarray, b: np.ndarray) -> float:
        """The largest difference of packed states (…, d) or their derivatives (k, d, m), over their largest size.

        A quaternion and its negative are one attitude.
        """
        quaternion = [
            i for i, name in enumerate(self.scene.labels(self.scene.carry())) if name.startswith("R_")
        ]
        if quaternion:
            axes = (1, 2) if a.ndim == 3 else (-1,)
            part = (slice(None), quaternion) if a.ndim == 3 else (..., quaternion)
            a = a.copy()
            a[part] *= np.where((a[part] * b[part]).sum(axis=axes, keepdims=True) < 0, -1.0, 1.0)
        return float(np.abs(a - b).max() / np.abs(b).max())

    def error(self, level: str = "coarse", **options: Any) -> float:
        """Return the error at the end of a run."""
        return LAWS["solution_error"](self.run(level, save_at=[self.scene.t_end], **options)())


def runs(rule: Callable[[MethodCase], None]) -> Callable[[MethodCase], None]:
    """Return a rule that does not apply where the scene is refused."""

    @wraps(rule)
    def follow_rule(case: MethodCase) -> None:
        if case.refused:
            raise DoesNotApply("the scene is refused")
        rule(case)

    return follow_rule


def declares(case: MethodCase) -> None:
    method = case.method
    require(isinstance(method, Method), "no Method")
    require(isinstance(method.name, str) and NAME.fullmatch(method.name), f"name = {method.name!r}")
    require(method.about and "\n" not in method.about, f"about = {method.about!r}: must be one line")
    require(method.family in FAMILIES, f"family = {method.family!r}: must be one of {', '.join(FAMILIES)}")
    require(method.engines and set(method.engines) <= set(ENGINES), f"engines = {method.engines!r}")
    order = method.order
    require(
        (order is None and method.control != "step") or (isinstance(order, int) and order > 0),
        f"order = {order!r}",
    )
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
    run = case.run(save_at=[case.scene.t_end / 4])
    require(not isinstance(run, Refused), f"engine {case.engine!r}: {getattr(run, 'why', '')}")
    field = case.scene.initial_fields[0]
    moved = {field: tuple(0.9 * c + 0.01 for c in getattr(case.scene, field))}
    first, other, again = run(), run(**moved), run()
    require(np.array_equal(first.y, again.y, equal_nan=True), "a second call gives another result")
    fresh = case.run(save_at=[case.scene.t_end / 4], scene=case.scene.with_(**moved))()
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
    case.measured["error"] = gap = case.gap(solution.y[1:], reference(scene, times[1:]).y)
    require(gap < 0.1, f"the states are those of other times: {gap:.1e} from the truth")


def is_timed_by_its_own_call(case: MethodCase) -> None:
    run = case.run(save_at=[case.scene.t_end])
    bare, whole = run.bare(run.start), run().y[-1]
    require(bare.shape == whole.shape, f"bare gives shape {bare.shape}")
    case.measured["gap"] = gap = case.gap(bare, whole)
    require(gap < SAME, f"bare ends {gap:.1e} from the run's last state")


def truncation(case: MethodCase) -> float:
    """What the fine step leaves of an error of the method's order, constants of size one."""
    step = case.scene.t_end / STEPS["fine"]
    return float(10 * step ** min(case.method.order or 1, 3))


def is_controlled_by_its_setting(case: MethodCase) -> None:
    method, scene, measured = case.method, case.scene, case.measured
    if isinstance(method, StepMap):
        if case.first:
            measured["order"] = order = order_at(method, scene, 1.0, 20)
            require(abs(order - method.order) < ORDER, f"of order {order:.3f}, not {method.order}")
        measured["error"] = error = case.error("fine")
        require(error < truncation(case), f"error {error:.1e}")
    elif method.exact:
        measured["error"] = error = case.error()
        require(error < 1e-12, f"exact, with an error of {error:.1e}")
        settings: dict[str, Any] = {"step": 0.1, "rtol": 1e-6}
        for name, value in settings.items():
            try:
                case.run(save_at=[scene.t_end], **{name: value})
            except BadInput:
                continue
            raise AssertionError(f"exact, and takes {name} = {value}")
    else:
        for rtol in (1e-4, 1e-7, 1e-10):
            measured[f"error at rtol {rtol:.0e}"] = case.error(rtol=rtol)
        errors = list(measured.values())
        require(errors[0] > 10 * errors[1] > 100 * errors[2], f"errors {errors} at rtol 1e-4, 1e-7, 1e-10")


def ends_as_it_says(case: MethodCase) -> None:
    times = case.scene.t_end * np.arange(1, 11) / 10
    solution = case.run("fine", save_at=times, max_steps=BUDGET)()
    require(solution.status is Status.budget, f"max_steps = {BUDGET}: ends {solution.status}")
    require(str(BUDGET) in solution.message, f"max_steps = {BUDGET}: says {solution.message!r}")
    require(np.isnan(solution.y[-1]).all(), f"max_steps = {BUDGET}: has a state at the end")
    escape = SCENES[ESCAPE]
    if case.method.refuses(escape) is not None:
        return
    setting: dict[str, Any] = {"step": 0.002} if isinstance(case.method, StepMap) else {}
    solution = case.run(scene=escape, save_at=[escape.t_end], max_steps=20_000, **setting)()
    require(solution.status is Status.diverged, f"beyond the blow-up: ends {solution.status}")
    found = blow_up_time(escape)
    off = abs(solution.end_time / float(found[0]) - 1) if found else math.inf
    require(off < 0.01, f"diverged at {solution.end_time}, {off:.1e} off the blow-up")
    require(np.isnan(solution.y[-1]).all(), "diverged, with a state at the end")
    case.measured["end of a blow-up"] = off


def with_counter(scene: Any, kind: str) -> tuple[Any, list[int]]:
    """Return the scene with a function that counts its calls, and the count; it cannot be recorded."""
    calls, name = [0], "gradient" if kind == "gradient" else "rhs"
    original = getattr(scene, name)

    def counting(x: Any, **parameters: Any) -> Any:
        calls[0] += 1
        first = x[0] if kind == "gradient" else x[0][0]
        require(float(first) < math.inf, "not finite")  # asks for the value
        return original(x, **parameters)

    return scene._replaced(**{name: counting}), calls


def counts(case: MethodCase) -> None:
    method, scene = case.method, case.scene
    run = case.run(save_at=[scene.t_end])
    found = run().counts
    require(found.evaluations is None or found.evaluations > 0, f"evaluations = {found.evaluations!r}")
    if isinstance(method, StepMap):
        once, each = method.counts(scene, 1), method.per_step(scene)
        require(found.steps == STEPS["coarse"], f"{found.steps} steps")
        expected = once + (STEPS["coarse"] - 1) * each
        require(found.evaluations == expected, f"{found.evaluations} evaluations, not {expected}")
        require(found.kind == method.kind_on(scene), f"counts {found.kind}")
    if found.evaluations is not None:
        case.measured["evaluations"] = found.evaluations
    # what cannot be counted on an engine is counted on another
    engine = next((e for e in (case.engine, *method.engines) if e in CALLBACKS), None)
    if engine and (engine == case.engine or case.first) and found.kind in ("gradient", "rhs"):
        twin, calls = with_counter(scene, found.kind)
        run = replace(case, engine=engine).run(scene=twin, save_at=[scene.t_end])
        calls[0] = 0
        reported = run().counts.evaluations
        case.measured["calls"] = calls[0]
        require(reported == calls[0], f"{reported} evaluations reported, {calls[0]} calls")


def engines_agree(case: MethodCase) -> None:
    times, method = case.scene.t_end * np.array([0.5, 1.0]), case.method
    level, bound = ("fine", 10 * RTOLS["fine"]) if method.adaptive else ("coarse", COMPILED)
    mine = case.run(level, save_at=times)().y
    # the default, and for itself the last: JAX compiles for seconds
    for engine in (method.engines[0], *reversed(method.engines)):
        run = replace(case, engine=engine).run(level, save_at=times)
        if engine == case.engine or isinstance(run, Refused):
            continue
        case.measured[f"off {engine}"] = gap = case.gap(mine, run().y)
        require(gap < bound, f"{case.engine} is {gap:.1e} off {engine}")
        break
    if isinstance(method, StepMap):
        scene: Any = case.scene
        x = scene.initial(scene.carry())
        pair = scene.unpack([np.array([v, 1.1 * v]) for v in scene.pack(x)], scene.carry())
        together, alone = (
            next(trajectory(method, scene, *of)) for of in ((pair, [(0.1, 5)], np), (x, [(0.1, 5)], math))
        )
        gap = case.gap(np.array([c[0] for c in scene.pack(together)]), np.array(scene.pack(alone)))
        require(gap < SAME, f"an array gives {gap:.1e} else than a number")
        case.measured["arrays off numbers"] = gap


def claims(case: MethodCase) -> None:
    method, scene = case.method, case.scene
    if scene.conformal_rate is not None and (method.contact or isinstance(method, StepMap)):
        coarse: dict[str, Any] = {"step": scene.t_end / 10} if method.control == "step" else {}
        case.measured["contact drift"] = drift = LAWS["contact_drift"](
            case.run(save_at=[scene.t_end], **coarse)()
        )
        # to round-off times the growth of the phase's own error along the run
        kept = drift < (EXACT if method.exact else ROUND_OFF)
        require(kept == method.contact, f"contact = {method.contact}, with a contact drift of {drift:.1e}")
    if isinstance(method, StepMap) and case.first:
        context = decimal_context(50)
        ahead = march(method, scene, "0.2", 3, context)
        back = march(method, scene, "-0.2", 3, context, ahead)
        there = march(method, scene, "0", 1, context)
        gap = max(abs(a - b) for a, b in zip(back, there, strict=True))
        kept, case.measured["steps back"] = gap < context.mpf(10) ** -45, float(gap)
        require(
            kept == method.symmetric,
            f"symmetric = {method.symmetric}: three steps and back leave {float(gap):.1e}",
        )


def differentiates(case: MethodCase) -> None:
    scene = case.scene
    run = case.run("fine", save_at=[scene.t_end])
    if not run.sensitivity_source:
        raise DoesNotApply("no derivative")
    states, mine = run.linearised(run.start, run().y)
    require(case.gap(states, run().y) < GROWTH * RTOLS["fine"], "the derivative is taken elsewhere")
    exact = MethodCase(METHODS["rk4"], "numba", scene).run("fine", save_at=[scene.t_end])
    bound = truncation(case) if isinstance(case.method, StepMap) else GROWTH * RTOLS["fine"]
    case.measured["gap"] = gap = case.gap(mine, exact.sensitivity(exact.start))
    require(gap < bound, f"the derivative is {gap:.1e} off that of the flow")


def costs(case: MethodCase) -> None:
    cost = case.method.step_cost(case.scene, case.engine) if not case.refused else 1
    require(cost is None or cost > 0, f"step_cost = {cost!r}")
    require(
        cost is not None or case.engine not in CALLBACKS, f"no step_cost on {case.engine}, which calls back"
    )
    if cost is not None:
        case.measured["right-hand sides"] = cost


RUN = (
    leaves_no_trace,
    saves,
    is_timed_by_its_own_call,
    is_controlled_by_its_setting,
    ends_as_it_says,
    counts,
    engines_agree,
    claims,
    differentiates,
)
METHOD_RULES: dict[int, Callable[[MethodCase], None]] = dict(
    enumerate((declares, refuses, *map(runs, RUN), costs), start=1)
)


def method_cases(
    method: Method, engines: Iterable[str] | None = None, scenes: Iterable[Scene] = CASES
) -> Iterator[MethodCase]:
    """The method on each of its engines, or some, and on scenes of every kind, or others."""
    scenes, chosen = tuple(scenes), tuple(method.engines if engines is None else engines)
    if not (chosen and scenes and set(chosen) <= set(method.engines)):
        raise BadInput(
            f"engines = {excerpt(chosen)}, scenes = {excerpt(scenes)}: must be one or more, engines of "
            f"{', '.join(method.engines)}"
        )
    for engine in chosen:
        for scene in scenes:
            yield MethodCase(method, engine, scene, first=engine == chosen[0])


def method_findings(
    method: Method, engines: Iterable[str] | None = None, scenes: Iterable[Scene] = CASES
) -> Iterator[Finding]:
    """`check_method`, a finding at a time."""
    cases = list(method_cases(method, engines, scenes))
    for case in cases:
        yield from case_findings(case)
    if all(case.refused for case in cases):
        raise BadInput(f"scenes: {method.name} refuses all it is checked on; give scenes it takes")


def check_method(
    method: Method, *, engines: Iterable[str] | None = None, scenes: Iterable[Scene] = CASES
) -> list[Finding]:
    """Follow every rule of `methods.base.Method`.

    Parameters
    ----------
    engines, scenes : by default all engines of the method, and one scene of every kind.

    Returns
    -------
    The rules that were followed, on which engine and scene, and what was measured.

    Raises
    ------
    Violation : a rule is broken.
    """
    return list(method_findings(method, engines, scenes))


def case_findings(case: MethodCase) -> Iterator[Finding]:
    """Follow every rule on one engine and scene; raises `Violation`."""
    what = f"{case.method.name} ({case.engine}) on {case.scene.name}"
    return follow(METHOD_RULES, case, what, case.engine, case.scene.name)
