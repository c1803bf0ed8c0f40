"""From a question to a prepared solver: every argument checked, engines tried in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from contactbench.boundary import blame
from contactbench.errors import BadInput, excerpt, positive, text, whole
from contactbench.methods.base import CALLBACKS, METHODS, Method, Request
from contactbench.methods.prepared import Prepared, Refused, begins
from contactbench.methods.request import default_times, long_enough, saved_times
from contactbench.methods.step_map import StepMap, try_step
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import Scene, verify
from contactbench.scene.definition import verify_at
from contactbench.scenes import scene_of
from contactbench.solution import Solution
from contactbench.trace.compiled import compiles
from contactbench.trace.recording import reason_of

DEFAULT_MAX_STEPS = 10**8
ADAPTIVE_MAX_STEPS = 10**6
#: the largest budget: a year at ten steps in a microsecond is less
MOST_STEPS = 10**14


def lookup(scene: Scene | str, method: Method | str) -> tuple[Scene, Method]:
    """Scene and method, each itself or by name, `UnknownName` with a suggestion otherwise."""
    chosen = method if isinstance(method, Method) else METHODS[method]
    text("method name", chosen.name)
    return scene_of(scene), chosen


def prepare(
    scene: Scene | str,
    method: Method | str,
    *,
    step: float | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    save_at: Sequence[float] | np.ndarray | None = None,
    carry: Sequence[str] | None = None,
    engine: str | None = None,
    max_steps: int | None = None,
) -> Prepared:
    """A solver compiled for a scene: ``run = prepare(…); run(); run(q=…, p=…)``.

    step : step size of a fixed-step method.  Steps never straddle a saved time: each interval
        between saved times, the last of which is the end, is divided into the fewest equal steps not longer
        than `step`.  The steps taken may so be shorter, down to the distance of two saved times; the solution's
        `step` is the longest one.
    rtol, atol : tolerances of an adaptive method (atol defaults to rtol).  A fixed-step method given
        rtol instead of step chooses its step from pilots, which are part of every call and its counts; the
        solution's `step_chosen` is that step.  An exact method takes neither.
    save_at : increasing times > 0 (a leading 0 is allowed); by default 0 and every k-th step, at
        most 1001 of them, for fixed steps, and 201 equally spaced times for others.  The counts of a fixed-step
        method depend on them, since it starts afresh at each: with save_at=[t_end] it takes the fewest steps.
    carry : which of s and R to integrate; by default all the scene has.
    engine : "numba", "jax", "python", …; by default the method's first that can run this scene: a step map
        or a force that branches on values cannot be compiled.  Under NUMBA_DISABLE_JIT Python comes first.
    max_steps : budget; a run that needs more ends with status `budget`.
    Raises `BadInput` for anything it cannot work with.
    """
    scene, chosen = lookup(scene, method)
    request = make_request(scene, chosen, step, rtol, atol, save_at, carry, engine, max_steps)
    if isinstance(request, Refused):
        return request
    engines = engines_of(chosen) if engine is None else (engine,)
    try:
        run = first = compiled_by(chosen, request)
        for other in engines[1:]:
            if not isinstance(run, Refused):
                return run
            run = compiled_by(chosen, replace(request, engine=other))
    except BaseException as error:
        raise blame(f"{chosen.name} on scene {scene.name!r}", error) from error.__cause__
    return first if isinstance(run, Refused) else run


def compiled_by(method: Method, request: Request) -> Prepared:
    """Return a method's run on one engine; `Refused` where scene or method cannot be compiled for it."""
    try:
        return method.prepare(request)
    except CannotRecord as error:
        what = f"{method.name} on {request.scene.name!r} cannot be compiled"
        others = [
            f"; engine {engine!r} calls it as it is" for engine in method.engines if engine in CALLBACKS
        ]
        return Refused(method.name, request, f"{what}: {reason_of(error)}{''.join(others)}")


def make_request(
    scene: Scene,
    chosen: Method,
    step: Any,
    rtol: Any = None,
    atol: Any = None,
    save_at: Any = None,
    carry: Any = None,
    engine: Any = None,
    max_steps: Any = None,
) -> Request | Refused:
    """Return the checked request for the first engine; `Refused` where the method refuses the scene."""
    if engine is not None and not (isinstance(engine, str) and engine in chosen.engines):
        raise BadInput(f"engine = {excerpt(engine)}: {chosen.name} runs on {', '.join(chosen.engines)}")
    if chosen.exact:
        if not step is rtol is atol is None:
            raise BadInput(
                f"{_settings(step, rtol, atol)}: {chosen.name} is exact and takes neither step nor tolerance"
            )
    elif chosen.adaptive:
        if step is not None:
            raise BadInput(f"step = {excerpt(step)}: {chosen.name} chooses its own steps; give rtol")
        if atol is not None and not chosen.takes_atol:
            raise BadInput(f"atol = {excerpt(atol)}: {chosen.name} takes rtol alone")
        rtol, own = _tolerances(chosen, rtol, atol)
        atol = own if chosen.takes_atol else None
    else:
        if step is not None and rtol is not None:
            raise BadInput(
                f"step = {excerpt(step)} and rtol = {excerpt(rtol)}: {chosen.name} takes one of them, a fixed step or "
                "a tolerance to choose it from"
            )
        if atol is not None:
            raise BadInput(f"atol = {excerpt(atol)}: {chosen.name} has a fixed step and takes no atol")
        if step is rtol is None:
            raise BadInput(
                f"step is missing: {chosen.name} has a fixed step; give step, or rtol to have it chosen"
            )
        if step is None:
            rtol, _ = _tolerances(chosen, rtol, None)
        else:
            step = positive("step", step)
    budget = _budget(chosen, max_steps)
    times = long_enough(default_times(scene, step, budget)) if save_at is None else saved_times(save_at)
    engine = engine or engines_of(chosen)[0]
    request = Request(scene, engine, scene.carry(carry), times, step, rtol, atol, budget)
    if (why := chosen.refuses(scene)) is not None:
        return Refused(chosen.name, request, why)
    verify(scene)
    begins(scene, scene.initial(request.carry))
    if isinstance(chosen, StepMap):
        try_step(chosen, scene, request.carry, step)
    return request


def engines_of(method: Method) -> tuple[str, ...]:
    """Return a method's engines in the order to try them: Python first where numba is told not to compile."""
    return method.engines if compiles() else tuple(sorted(method.engines, key=lambda e: e not in CALLBACKS))


def _settings(step: Any, rtol: Any, atol: Any) -> str:
    return f"step = {excerpt(step)}, rtol = {excerpt(rtol)}, atol = {excerpt(atol)}"


def solve(scene: Scene | str, method: Method | str, **options: Any) -> Solution:
    """Solve a scene once; takes the keywords of `prepare`.

    Raises `BadInput` as it does, and where a gradient is not that of the potential at a saved state.
    """
    solution = prepare(scene, method, **options)()
    if solution.ok:
        verify_at(solution.scene, solution.y)
    return solution


def _tolerances(method: Any, rtol: float | None, atol: float | None) -> tuple[float, float]:
    if rtol is None:
        raise BadInput(f"rtol is missing: {method.name} is adaptive; give rtol")
    rtol = positive("rtol", rtol)
    low, high = method.rtol_range
    if not low <= rtol <= high:
        raise BadInput(f"rtol = {rtol!r}: {method.name} takes {low:g} to {high:g}")
    return rtol, rtol if atol is None else positive("atol", atol)


def _budget(method: Method, max_steps: int | None) -> int:
    if max_steps is None:
        return DEFAULT_MAX_STEPS if method.control == "step" else ADAPTIVE_MAX_STEPS
    return whole("max_steps", max_steps, MOST_STEPS)
