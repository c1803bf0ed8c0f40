"""Check the rules of `methods.base.Method`, by their numbers there."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import wraps
from typing import Any

import numpy as np

from contactbench.errors import BadInput, excerpt
from contactbench.measure.laws import LAWS
from contactbench.measure.order import fit_order, march, order_at
from contactbench.methods.base import CALLBACKS, ENGINES, FAMILIES, METHODS, Method, prepare
from contactbench.methods.fixed_step import COUNTED, FixedStep, with_counters
from contactbench.methods.prepared import Prepared, Refused
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.scenes import SCENES
from contactbench.solution import Status
from contactbench.testing.rules import Finding, follow, require
from contactbench.truth import blow_up_time, decimal_context

#: scenes with sizeable damping and other data than the registered ones, to which a method may be tuned
CASES = (
    SCENES["particle"].with_(gamma=0.35, q=(0.7, -0.6), p=(0.4, 0.5), s=0.3, t_end=4.0),
    SCENES["rigid_body"].with_(inertia=(1.0, 1.7, 2.1), gamma=0.25, M=(0.8, 0.9, -0.5), s=0.2, t_end=4.0),
    SCENES["rigid_body_anisotropic"].with_(M=(0.8, 0.9, -0.5), t_end=4.0),
)
#: numbers of steps, coarse and fine, and tolerances likewise
STEPS, RTOLS = (80, 1280), (1e-5, 1e-9)
#: allowed difference between calls of one program, between engines over 80 steps, and of an invariant over ten steps
SAME, COMPILED, ROUND_OFF = 1e-14, 1e-13, 1e-12
#: factor on these bounds for a multistep method
MULTISTEP = 10
#: largest error over tolerance in a run this short, and allowed drift of an exact method by rounding of the phase
GROWTH, EXACT = 1e3, 1e-10


@dataclass(frozen=True)
class MethodCase:
    """A method on an engine and a scene."""

    method: Method
    engine: str
    scene: Scene

    def run(self, fine: bool = False, **options: Any) -> Prepared:
        """Prepare at a coarse or a fine setting and to the end alone, unless the options say otherwise."""
        if self.method.control == "step":
            options.setdefault("step", self.scene.t_end / STEPS[fine])
        elif self.method.control == "rtol":
            options.setdefault("rtol", float(np.clip(RTOLS[fine], *self.method.rtol_range)))
        options.setdefault("save_at", [self.scene.t_end])
        options.setdefault("dense", False)
        options["save_at"] = Elapsed(options["save_at"])
        return prepare(self.scene, self.method, engine=self.engine, **options)

    def error(self, **options: Any) -> float:
        return float(LAWS["solution_error"](self.run(**options)()))


def require_below(bound: float, value: float, what: str) -> None:
    require(value < bound, f"{what}: {value:.1e}, not below {bound:.1e}")


def gap(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(a - b).max() / np.abs(b).max())


def declares(case: MethodCase) -> None:
    """Give it an `about` of one line, and family, engines, order and tolerance that are allowed."""
    method = case.method
    require(method.about and "\n" not in method.about, f"about = {method.about!r}")
    require(method.family in FAMILIES, f"family = {method.family!r}: must be one of {', '.join(FAMILIES)}")
    require(method.engines and set(method.engines) <= set(ENGINES), f"engines = {method.engines!r}")
    require(method.order or method.control != "step", f"order = {method.order!r}")
    require(method.tolerance, "tolerance: does not say which error rtol bounds")


def refuses(case: MethodCase) -> None:
    """Return from `refuses` one sentence for a scene out of reach, None for any other."""
    why = case.method.refuses(case.scene)
    require(why is None or (isinstance(why, str) and why.strip()), f"refuses = {why!r}")
    if why is not None:
        solution = case.run()()
        ended = solution.status is Status.unsupported and solution.message == why
        require(ended and np.isnan(solution.y).all(), f"ends {solution.status}: {solution.message!r}")


def leaves_no_trace(case: MethodCase) -> None:
    """Let a call depend on its request and its initial data alone: keep nothing between calls."""
    save_at = [case.scene.t_end / 4]
    run = case.run(save_at=save_at)
    require(not isinstance(run, Refused), getattr(run, "why", ""))
    name = case.scene.initial_fields[0]
    moved = {name: tuple(0.9 * c + 0.01 for c in getattr(case.scene, name))}
    first, other, again = run(), run(**moved), run()
    require(np.array_equal(first.y, again.y, equal_nan=True), "a second call gives another result")
    fresh = replace(case, scene=case.scene.with_(**moved)).run(save_at=save_at)()
    require(np.array_equal(other.y, fresh.y), f"{moved}: not what a run prepared for them gives")
    require(not np.array_equal(first.y, other.y), f"{moved}: makes no difference")


def saves(case: MethodCase) -> None:
    """Return the states at exactly the saved times, the initial one itself where 0 is among them."""
    scene, times = case.scene, case.scene.t_end * np.array([0.0, 0.13, 0.5, 1.0])
    solution, start = case.run(save_at=times)(), scene.pack(scene.initial(scene.carry()))
    require(solution.ok, f"ends {solution.status}: {solution.message}")
    require(np.array_equal(solution.elapsed, times) and solution.end_time == times[-1], f"t = {solution.t}")
    require(solution.y.shape == (4, len(start)), f"states of shape {solution.y.shape}")
    require(np.array_equal(solution.y[0], start), "another initial state")
    require_below(0.1, LAWS["solution_error"](solution), "error")


def is_timed_by_its_own_call(case: MethodCase) -> None:
    """Let `bare` return the last state of the run."""
    run = case.run()
    bare, whole = run.bare(run.start), run().y[-1]
    require(bare.shape == whole.shape, f"bare gives shape {bare.shape}")
    require_below(SAME, gap(bare, whole), "bare off the run's last state")


def is_controlled_by_its_setting(case: MethodCase) -> None:
    """Declare the order that the steps have, or mend them; let errors fall with rtol."""
    method: Any = case.method
    if method.exact:
        require_below(ROUND_OFF, case.error(), "error")
    elif method.adaptive:
        errors = [case.error(rtol=rtol) for rtol in (1e-4, 1e-7, 1e-10)]
        require(errors[0] > 10 * errors[1] > 100 * errors[2], f"errors {errors} at rtol 1e-4, 1e-7, 1e-10")
    else:
        if isinstance(method, FixedStep):  # at fifty digits; many steps where there is a history
            count = 160 if not method.one_step else 20 if method.order < 16 else 5  # above round-off
            order, near = order_at(method, case.scene, 1.0, count), 0.02
        else:
            steps = [case.scene.t_end / n for n in (4, 6, 8, 11, 16, 23, 32, 45, 64)]
            order, near = fit_order(steps, [case.error(step=h) for h in steps], ROUND_OFF).order, 0.2
        require(abs(order - method.order) < near, f"of order {order:.3f}, not {method.order}")


def ends_as_it_says(case: MethodCase) -> None:
    """Count steps against `max_steps`; end as `budget`, or `diverged` with the time, and with nan from there on."""
    solution = case.run(fine=True, save_at=case.scene.t_end * np.arange(1, 11) / 10, max_steps=2)()
    says = f"max_steps = 2: ends {solution.status}, {solution.message!r}"
    require(solution.status is Status.budget and "2" in solution.message, says)
    require(np.isnan(solution.y[-1]).all(), "max_steps = 2: has a state at the end")
    escape = replace(case, scene=SCENES["escape"])
    if case.method.refuses(escape.scene) is None:
        setting: dict[str, Any] = {"step": 0.002} if case.method.control == "step" else {}
        solution = escape.run(max_steps=20_000, **setting)()
        lost = solution.status is Status.diverged and np.isnan(solution.y[-1]).all()
        require(lost, f"beyond a blow-up: ends {solution.status}")
        found = blow_up_time(escape.scene)
        off = abs(solution.end_time / float(found[0]) - 1) if found else math.inf
        require_below(0.01, off, "end off a blow-up")


def counts(case: MethodCase) -> None:
    """Declare `evaluations=` and `kind=` as they are, or count in `counts` all that is evaluated."""
    method: Any = case.method
    found = case.run()().counts
    require(found.evaluations is None or found.evaluations > 0, f"evaluations = {found.evaluations!r}")
    if method.control == "step":
        expected = method.counts(case.scene, 1) + (STEPS[False] - 1) * method.per_step(case.scene)
        known = found.steps == STEPS[False] and (method.iterates or found.evaluations == expected)
        require(known, f"{found.evaluations} evaluations in {found.steps} steps, not {expected}")
        require(found.kind == method.kind_on(case.scene), f"counts {found.kind}")
    # evaluations are counted on an engine that calls back into Python
    engine = next((e for e in (case.engine, *method.engines) if e in CALLBACKS), None)
    if engine and found.kind in COUNTED:
        twin, calls = with_counters(case.scene, plain=True)
        run = replace(case, engine=engine, scene=twin).run()
        calls[found.kind] = 0
        reported = run().counts.evaluations
        says = f"{reported} evaluations reported, {calls[found.kind]} calls of the {COUNTED[found.kind]}"
        require(reported == calls[found.kind], says)


def engines_agree(case: MethodCase) -> None:
    """Compute by plain arithmetic and functions of `xp`, so that every engine does the same."""
    times, method, scene = case.scene.t_end * np.array([0.5, 1.0]), case.method, case.scene
    history = 1 if method.one_step else MULTISTEP
    bound = history * (10 * RTOLS[True] if method.adaptive else COMPILED)
    mine = case.run(method.adaptive, save_at=times)().y
    for engine in method.engines:
        if engine != case.engine and not method.lacks(engine):
            run = replace(case, engine=engine).run(method.adaptive, save_at=times)
            if not isinstance(run, Refused):
                require_below(bound, gap(mine, run().y), f"{case.engine}: off {engine}")
    if isinstance(method, FixedStep):
        x = scene.initial(scene.carry())
        pair = scene.unpack([np.array([c, 1.1 * c]) for c in scene.pack(x)], scene.carry())
        together, alone = (method.advance(scene, *given) for given in ((pair, 0.1, 5, np), (x, 0.1, 5, math)))
        first = np.array([np.ravel(c)[0] for c in scene.pack(together)])
        require_below(history * SAME, gap(first, np.array(scene.pack(alone))), "arrays off numbers")


def claims(case: MethodCase) -> None:
    """Declare `contact` and `symmetric` as they are."""
    method, scene = case.method, case.scene
    if scene.conformal_rate is not None and (method.contact or isinstance(method, FixedStep)):
        steps = 10 if (method.order or 1) < 10 else 3  # an error far above round-off
        coarse: dict[str, Any] = {"step": scene.t_end / steps} if method.control == "step" else {}
        drift = LAWS["contact_drift"](case.run(**coarse)())
        # to round-off times the growth of the phase's own error along the run
        kept = drift < (EXACT if method.exact else ROUND_OFF)
        require(kept == method.contact, f"contact = {method.contact}, with a contact drift of {drift:.1e}")
    if isinstance(method, FixedStep) and method.one_step:
        context = decimal_context(50)
        ahead = march(method, scene, "0.2", 3, context)
        back, there = march(method, scene, "-0.2", 3, context, ahead), march(method, scene, "0", 1, context)
        off = float(max(abs(a - b) for a, b in zip(back, there, strict=True)))
        says = f"symmetric = {method.symmetric}: three steps and back leave {off:.1e}"
        require((off < 1e-45) == method.symmetric, says)


def differentiates(case: MethodCase) -> str | None:
    """Let `sensitivity` be the derivative of the saved states, the steps held fixed."""
    run = case.run(fine=True)
    if not run.sensitivity_source:
        return "no derivative"
    exact = MethodCase(METHODS["rk4"], "llvm", case.scene).run(fine=True)
    sign = np.sign(run().y * exact().y)[..., None]  # a quaternion and its negative are one attitude
    off = gap(sign * run.sensitivity(run.start), exact.sensitivity(exact.start))
    # error of the fine setting, with error constants of size one
    step, power = case.scene.t_end / STEPS[True], min(case.method.order or 1, 3)
    bound = 10 * step**power if case.method.control == "step" else GROWTH * RTOLS[True]
    require_below(bound, off, "off the derivative of the flow")
    return None


def costs(case: MethodCase) -> None:
    """Return from `step_cost` the right-hand sides of a step where Python is called back, else None."""
    if case.method.refuses(case.scene) is None:
        cost = case.method.step_cost(case.scene, case.engine)
        known = case.engine not in CALLBACKS if cost is None else cost > 0
        require(known, f"step_cost = {cost!r} on {case.engine}")


Rule = Callable[[MethodCase], str | None]


def of_a_run(rule: Rule) -> Rule:
    @wraps(rule)
    def of_what_runs(case: MethodCase) -> str | None:
        return rule(case) if case.method.refuses(case.scene) is None else "the scene is refused"

    return of_what_runs


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
        The rules that were followed, on which engine and scene.

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
