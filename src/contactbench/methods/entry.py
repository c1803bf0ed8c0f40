"""From a question to a prepared solver: every argument checked, engines tried in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from contactbench.boundary import blame
from contactbench.errors import BadInput, array, excerpt, positive, text, whole
from contactbench.methods.base import CALLBACKS, METHODS, Method
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.fixed_step_run import steps_in
from contactbench.methods.prepared import Prepared, Refused, Request, require_slope
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import Mechanical, Scene, verify
from contactbench.scene.definition import verify_at
from contactbench.scenes import scene_of
from contactbench.solution import Solution
from contactbench.trace.compiled import compiles
from contactbench.trace.recording import reason_of

DEFAULT_MAX_STEPS = 10**8
ADAPTIVE_MAX_STEPS = 10**6
#: the largest budget: a year at ten steps in a microsecond is less
MOST_STEPS = 10**14
#: saved times when the caller names none: every k-th step with at most this many for fixed steps,
#: this many equal intervals for adaptive methods
DEFAULT_SAVES = 1000
ADAPTIVE_SAVES = 200
#: numbers in all saved states at most, where the caller names no times: 128 MB
MOST_SAVED = 2**24
#: parts of a shorter run are no longer normal numbers
SHORTEST_RUN = 1e-290


def lookup(scene: Scene | str, method: Method | str) -> tuple[Scene, Method]:
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
        run = first = prepare_on_engine(chosen, request)
        for other in engines[1:]:
            if not isinstance(run, Refused):
                return run
            run = prepare_on_engine(chosen, replace(request, engine=other))
    except BaseException as error:
        raise blame(f"{chosen.name} on scene {scene.name!r}", error) from error.__cause__
    return first if isinstance(run, Refused) else run


def prepare_on_engine(method: Method, request: Request) -> Prepared:
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
    step, rtol, atol = setting_of(chosen, step, rtol, atol)
    if max_steps is None:
        budget = ADAPTIVE_MAX_STEPS if chosen.adaptive or chosen.exact else DEFAULT_MAX_STEPS
    else:
        budget = whole("max_steps", max_steps, MOST_STEPS)
    times = default_times(scene, step, budget) if save_at is None else saved_times(save_at)
    if times[-1] < SHORTEST_RUN:
        raise BadInput(f"the run ends at t = {times[-1]:.3g}: must be {SHORTEST_RUN:g} or later")
    engine = engine or engines_of(chosen)[0]
    request = Request(scene, engine, scene.carry(carry), times, step, rtol, atol, budget)
    if (why := chosen.refuses(scene) or too_large(chosen, request)) is not None:
        return Refused(chosen.name, request, why)
    verify(scene)
    require_slope(scene, scene.initial(request.carry))
    if isinstance(chosen, FixedStep):
        chosen.try_step(scene, request.carry, step)
    return request


def too_large(chosen: Method, request: Request) -> str | None:
    """Why a scene has too many components to be compiled one by one, or None."""
    scene, most = request.scene, chosen.largest
    if not isinstance(scene, Mechanical) or request.engine in CALLBACKS or len(scene.q) <= most:
        return None
    size = f"the {len(scene.q)} components of scene {scene.name!r}, more than {most}"
    return f"{chosen.name} would compile {size}, one by one: write it as a cb.Lattice or cb.Particles, of any size"


def setting_of(
    method: Method, step: Any, rtol: Any, atol: Any
) -> tuple[float | None, float | None, float | None]:
    name = method.name
    if method.exact:
        if not step is rtol is atol is None:
            given = f"step = {excerpt(step)}, rtol = {excerpt(rtol)}, atol = {excerpt(atol)}"
            raise BadInput(f"{given}: {name} is exact and takes neither step nor tolerance")
        return None, None, None
    if method.adaptive:
        if step is not None:
            raise BadInput(f"step = {excerpt(step)}: {name} chooses its own steps; give rtol")
        if atol is not None and not method.takes_atol:
            raise BadInput(f"atol = {excerpt(atol)}: {name} takes rtol alone")
        if rtol is None:
            raise BadInput(f"rtol is missing: {name} is adaptive; give rtol")
        rtol = tolerance(method, rtol)
        if not method.takes_atol:
            return None, rtol, None
        return None, rtol, rtol if atol is None else positive("atol", atol)
    if step is not None and rtol is not None:
        raise BadInput(
            f"step = {excerpt(step)} and rtol = {excerpt(rtol)}: {name} takes one of them, a fixed step or "
            "a tolerance to choose it from"
        )
    if atol is not None:
        raise BadInput(f"atol = {excerpt(atol)}: {name} has a fixed step and takes no atol")
    if step is rtol is None:
        raise BadInput(f"step is missing: {name} has a fixed step; give step, or rtol to have it chosen")
    if step is None:
        return None, tolerance(method, rtol), None
    return positive("step", step), None, None


def tolerance(method: Method, rtol: Any) -> float:
    rtol = positive("rtol", rtol)
    low, high = method.rtol_range
    if not low <= rtol <= high:
        raise BadInput(f"rtol = {rtol!r}: {method.name} takes {low:g} to {high:g}")
    return rtol


def default_times(scene: Scene, step: float | None, budget: int) -> np.ndarray:
    most = max(1, MOST_SAVED // scene.motion)
    if step is None:
        return np.linspace(0.0, scene.t_end, min(ADAPTIVE_SAVES, most) + 1)
    n = int(steps_in(scene.t_end, scene.t_end, step))
    if n > budget:  # will end as `budget`; no grid of that size is needed
        return np.array([scene.t_end])
    stride = -(-n // min(DEFAULT_SAVES, most))
    marks = np.append(np.arange(0, n, stride), n)
    return marks * (scene.t_end / n)


def saved_times(save_at: Any) -> np.ndarray:
    times = np.array(array("save_at", save_at, "increasing times"), ndmin=1)  # a copy
    if times.ndim != 1 or not len(times) or not np.all(np.isfinite(times)):
        raise BadInput(f"save_at = {excerpt(save_at)}: must be finite times, at least one")
    if times[0] < 0 or np.any(np.diff(times) <= 0):
        raise BadInput("save_at: times must be ≥ 0 and strictly increasing")
    if len(times) == 1 and times[0] == 0:
        raise BadInput("save_at: at least one time must be > 0")
    return times


def engines_of(method: Method) -> tuple[str, ...]:
    """Return a method's engines in the order to try them: Python first where numba is told not to compile."""
    return method.engines if compiles() else tuple(sorted(method.engines, key=lambda e: e not in CALLBACKS))


def solve(scene: Scene | str, method: Method | str, **options: Any) -> Solution:
    """Solve a scene once; takes the keywords of `prepare`.

    Raises `BadInput` as it does, and where a gradient is not that of the potential at a saved state.
    """
    solution = prepare(scene, method, **options)()
    if solution.ok:
        verify_at(solution.scene, solution.y)
    return solution
