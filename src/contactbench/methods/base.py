"""The contract of a method, and the registry.

A method is an object with a `name`, its `engines` (the first is the default), `adaptive`, `order`,
a one-line `about`, a `family` (contact, variational or established, which it is where a method does not say), and

    refuses(scene) -> str | None          why the scene is out of reach, or None
    prepare(Request) -> Prepared          compile once; the result is called many times

Adaptive methods also give `rtol_range`, the tolerances they accept, and `stiff`.  `FixedStep`
(fixed_step.py) implements most of it for a step map; see contact.py for a method that is data and
sundials.py for one that is a solver.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import hypot
from time import perf_counter
from typing import Any, Protocol, runtime_checkable

import numpy as np

from contactbench.errors import BadInput, Registry, positive
from contactbench.methods.differences import differences
from contactbench.scene import Scene
from contactbench.solution import Counts, Differential, Solution, Status, divergence_bound, first_divergence

#: saved times when the caller names none: every k-th step with at most this many for fixed steps,
#: this many equal intervals for adaptive methods
DEFAULT_SAVES = 1000
ADAPTIVE_SAVES = 200
DEFAULT_MAX_STEPS = 10**8
ADAPTIVE_MAX_STEPS = 10**6


@runtime_checkable
class Method(Protocol):
    """What `METHODS` holds; see the module's docstring."""

    name: str
    engines: tuple[str, ...]
    adaptive: bool
    order: int | None
    about: str

    def refuses(self, scene: Scene) -> str | None: ...
    def prepare(self, request: Request) -> Prepared: ...


METHODS = Registry("method", Method)


@dataclass(frozen=True)
class Request:
    """A validated question to a method: what to solve, how finely, and what to save."""

    scene: Scene
    engine: str
    carry: tuple[str, ...]
    save_at: np.ndarray
    step: float | None = None
    rtol: float | None = None
    atol: float | None = None
    max_steps: int = DEFAULT_MAX_STEPS

    @property
    def control(self) -> str:
        """What is set: "step" or "rtol"."""
        return "rtol" if self.step is None else "step"

    @property
    def value(self) -> float:
        """To what it is set."""
        value = self.rtol if self.step is None else self.step
        assert value is not None  # `prepare` sees to it
        return value

    @cached_property
    def setting(self) -> str:
        """The setting as it is keyed in tables."""
        return f"{self.control}={self.value:.6g}"


@dataclass
class Prepared:
    """A compiled solver: call it, with other initial data if you like, to get a `Solution`."""

    method: str
    request: Request
    #: seconds spent tracing and compiling; zero where nothing is compiled
    compile_s: float = field(default=0.0, kw_only=True)

    def integrate(self, y0: np.ndarray) -> Outcome:
        """Run from a packed initial state."""
        raise NotImplementedError

    @property
    def start(self) -> np.ndarray:
        """The scene's own initial state, packed."""
        return self._own_start

    def bare(self, y0: np.ndarray) -> np.ndarray:
        """The solver's own call, by its fastest way: packed initial state to packed final state, unchecked."""
        return self.integrate(y0).y[-1]

    #: how `sensitivity` differentiates the map of the steps taken; empty: it cannot
    sensitivity_source = ""

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        """(k, d, m): derivative of the saved states along the scene's m tangents at y0, steps held fixed."""
        raise NotImplementedError

    def linearised(self, y0: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Saved states (k, d) and their derivative (k, d, m), of one and the same numerical map.

        y : the saved states of the plain run.  A solver that has to run anew for the derivative
        gives the states of that run instead.
        """
        return y, self.sensitivity(y0)

    @property
    def steps_follow_state(self) -> bool:
        """Whether other initial data may mean other steps: then `sensitivity` is not that of the map."""
        return self.request.step is None

    def differential(self, y0: np.ndarray, out: Outcome, frozen: bool) -> Differential:
        """dΦ of the map its user gets, or with the steps frozen.

        To round-off where the engine can, else by differences of the solver.
        """
        if self.sensitivity_source and (frozen or not self.steps_follow_state):
            states, derivative = self.linearised(y0, out.y)
            return Differential(self.sensitivity_source, states, derivative[None])
        if frozen and self.steps_follow_state:
            return Differential("", out.y, np.empty((0, *out.y.shape, 0)))
        return differences(self, y0, out)

    def log_factor(self, y0: np.ndarray, y: np.ndarray) -> np.ndarray | None:
        """Log of the product of the conformal factors of the contact maps applied, up to each saved time, (k,).

        y : the saved states.  None where a run is no composition of such maps.
        """
        return None

    def __call__(self, **data: Any) -> Solution:
        r = self.request
        if data:
            y0 = np.array(r.scene.pack(r.scene.initial(r.carry, **r.scene.checked(data))), dtype=float)
        else:
            y0 = self._own_start
        out = self.integrate(y0)
        if not out.checked:
            out = audited(out, self._end)
        return Solution(
            *self._asked, out.y, out.status, out.message, out.counts, out.end_time, y0, self, *self._set
        )

    @cached_property
    def _asked(self) -> tuple[Scene, str, str, str, tuple[str, ...], np.ndarray]:
        """The fields that all solutions of this run have in common."""
        r = self.request
        return r.scene, self.method, r.engine, r.setting, r.carry, r.save_at

    def count(self, counts: Counts) -> Counts:
        """What one run costs, from its own counts; may repeat it in a slower mode that tells more."""
        return counts

    def __post_init__(self) -> None:
        r = self.request
        self._own_start = np.array(r.scene.pack(r.scene.initial(r.carry)), dtype=float)
        self._motion, self._end = r.scene.motion, float(r.save_at[-1])
        self._own_bound = divergence_bound(self._own_start[: self._motion])
        self._saves = len(r.save_at)
        self._set = (r.control, r.value)

    def first_divergence(self, y0: np.ndarray, y: np.ndarray) -> int | None:
        """Index of the first saved state in y that is not finite or out of scale, or None."""
        own = y0 is self._own_start
        bound = self._own_bound if own else divergence_bound(y0[: self._motion])
        return first_divergence(y, self._motion, bound)

    def at_end(self, y0: np.ndarray, end: list[float], y: np.ndarray, counts: Counts) -> Outcome:
        """The outcome of a solver that says it is at the only saved time: y (1, d), and the same as floats.

        What `finished` says, sooner: the call of a short run is not to cost more than the run.
        """
        bound = self._own_bound if y0 is self._own_start else divergence_bound(y0[: self._motion])
        if hypot(*end) <= bound:  # nan fails every comparison
            return Outcome(y, counts, Status.ok, "", self._end, True)
        return self.finished(y0, y, counts)

    def finished(
        self,
        y0: np.ndarray,
        y: np.ndarray,
        counts: Counts,
        status: Status = Status.ok,
        message: str = "",
        stopped: tuple[float, np.ndarray] | None = None,
    ) -> Outcome:
        """An outcome from the saved states reached so far: checked for divergence, padded with NaN.

        stopped : time and state at which a solver gave up.  Where that state is out of scale the solver
        was right to, and the run has diverged by then: steps shrink without end before a singularity.
        """
        bad = self.first_divergence(y0, y)
        if bad is None and status is Status.ok and len(y) == self._saves:
            return Outcome(y, counts, status, message, self._end, True)
        times, reached = self.request.save_at, len(y)
        if bad is not None:
            y, reached = y[:bad], bad
            status, message = (
                Status.diverged,
                f"left the scene's scale by a factor 1e6 before t = {times[bad]:.6g}",
            )
        if reached < len(times):
            if status is Status.ok:
                status, message = Status.failed, f"stopped before t = {times[reached]:.6g}"
            y = np.concatenate([y, np.full((len(times) - reached, len(y0)), math.nan)])
        end = float(times[reached - 1]) if reached else 0.0
        if status is not Status.ok and stopped is not None:
            end = max(end, min(stopped[0], float(times[-1])))
            if self.first_divergence(y0, stopped[1][None]) is not None:
                status, message = Status.diverged, f"left the scene's scale by a factor 1e6 by t = {end:.10g}"
        return Outcome(y, counts, status, message, end)


@dataclass(slots=True)
class Outcome:
    """What integrating gave: packed states (NaN where not reached), counts, and how it ended.

    checked : the states are known to be finite and the last one to be at the end.
    """

    y: np.ndarray
    counts: Counts
    status: Status
    message: str
    end_time: float
    checked: bool = False


def audited(out: Outcome, end: float) -> Outcome:
    """The outcome, an `ok` taken back from a run that ended elsewhere or without a number."""
    if out.checked or out.status is not Status.ok:
        return out
    if out.end_time != end:
        message = f"ended at t = {out.end_time:.6g}, not at t = {end:.6g}"
        return replace(out, y=np.full_like(out.y, math.nan), status=Status.failed, message=message)
    if not np.isfinite(out.y[-1]).all():
        return replace(out, status=Status.diverged, message="not finite at the end")
    return out


class Refused(Prepared):
    """A prepared 'no': every call gives a solution with status `unsupported`."""

    def __init__(self, method: str, request: Request, why: str) -> None:
        super().__init__(method, request)
        self.why = why

    def integrate(self, y0: np.ndarray) -> Outcome:
        nothing = np.full((len(self.request.save_at), len(y0)), math.nan)
        return Outcome(nothing, Counts(), Status.unsupported, self.why, 0.0)


class Adaptive:
    """Base of the solvers that choose their own steps from rtol."""

    adaptive = True
    family = "established"

    def refuses(self, scene: Scene) -> str | None:
        return None


def lookup(scene: Scene | str, method: str) -> tuple[Scene, Method]:
    """Scene and method by name, `UnknownName` with a suggestion otherwise."""
    from contactbench.scenes import SCENES

    if isinstance(scene, str):
        scene = SCENES[scene]
    if not isinstance(scene, Scene):
        raise BadInput(f"scene = {scene!r}: must be a scene or the name of one: {', '.join(SCENES)}")
    return scene, METHODS[method]


def prepare(
    scene: Scene | str,
    method: str,
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
        between saved times is divided into the fewest equal steps not longer than `step`.
    rtol, atol : tolerances of an adaptive method (atol defaults to rtol).  A fixed-step method given
        rtol instead of step chooses its step from pilots, which are part of every call and its counts.
    save_at : increasing times > 0 (a leading 0 is allowed); by default 0 and every k-th step, at
        most 1001 of them, for fixed steps, and 201 equally spaced times for adaptive methods.
    carry : which of s and R to integrate; by default all the scene has.
    engine : "numba", "jax", "python", …; by default the method's first that can run this scene: a step map
        or a force that branches on values cannot be compiled.
    max_steps : budget; a run that needs more ends with status `budget`.
    Raises `BadInput` for anything it cannot work with.
    """
    scene, chosen = lookup(scene, method)
    if engine is not None and engine not in chosen.engines:
        raise BadInput(f"engine = {engine!r}: {method} runs on {', '.join(chosen.engines)}")
    if chosen.adaptive:
        if step is not None:
            raise BadInput(f"step = {step!r}: {method} chooses its own steps; give rtol")
        step, rtol, atol = None, *_tolerances(chosen, rtol, atol)
    else:
        if atol is not None or (step is None) == (rtol is None):
            given = f"step = {step!r}, rtol = {rtol!r}, atol = {atol!r}"
            raise BadInput(f"{given}: {method} has a fixed step; give step > 0, or rtol to have it chosen")
        if step is None:
            rtol, _ = _tolerances(chosen, rtol, None)
        else:
            step = positive("step", step)
    budget = _budget(chosen, max_steps)
    times = _default_times(scene, step, budget) if save_at is None else _times(save_at)
    engines = chosen.engines if engine is None else (engine,)
    request = Request(scene, engines[0], scene.carry(carry), times, step, rtol, atol, budget)
    if (why := chosen.refuses(scene)) is not None:
        return Refused(chosen.name, request, why)
    run = first = chosen.prepare(request)
    for other in engines[1:]:
        if not isinstance(run, Refused):
            return run
        run = chosen.prepare(replace(request, engine=other))
    return first if isinstance(run, Refused) else run


def solve(scene: Scene | str, method: str, **options: Any) -> Solution:
    """Solve a scene once; takes the keywords of `prepare`."""
    return prepare(scene, method, **options)()


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
        return ADAPTIVE_MAX_STEPS if method.adaptive else DEFAULT_MAX_STEPS
    if isinstance(max_steps, bool) or int(max_steps) != max_steps or max_steps < 1:
        raise BadInput(f"max_steps = {max_steps!r}: must be a whole number ≥ 1")
    return int(max_steps)


def _default_times(scene: Scene, step: float | None, budget: int) -> np.ndarray:
    if step is None:
        return np.linspace(0.0, scene.t_end, ADAPTIVE_SAVES + 1)
    n = steps_in(scene.t_end, step)
    if n > budget:  # will end as `budget`; no grid of that size is needed
        return np.array([scene.t_end])
    stride = -(-n // DEFAULT_SAVES)
    marks = np.append(np.arange(0, n, stride), n)
    return marks * (scene.t_end / n)


def _times(save_at: Any) -> np.ndarray:
    try:
        times = np.atleast_1d(np.asarray(save_at, dtype=float))
    except (TypeError, ValueError):
        raise BadInput(f"save_at = {save_at!r}: must be increasing times") from None
    if times.ndim != 1 or not len(times) or not np.all(np.isfinite(times)):
        raise BadInput(f"save_at = {save_at!r}: must be finite times, at least one")
    if times[0] < 0 or np.any(np.diff(times) <= 0):
        raise BadInput("save_at: times must be ≥ 0 and strictly increasing")
    if len(times) == 1 and times[0] == 0:
        raise BadInput("save_at: at least one time must be > 0")
    return times


#: how far the difference of two saved times may be off, in units of the last place of the later one: both are
#: rounded, as a product or a sum of two, and so may be the spacing of the grid
GRID_ULPS = 4


def steps_in(span: float, step: float, until: float | None = None) -> int:
    """The fewest equal steps that cover `span` without exceeding `step` (up to round-off).

    until : the time at which the interval ends, by default `span`.  The difference of two saved times has
    their round-off, which for short intervals late in a run is far above that of the interval itself.
    """
    round_off = GRID_ULPS * math.ulp(span if until is None else until)
    return max(1, math.ceil((span * (1 - 1e-12) - round_off) / step))


def stopwatch() -> Any:
    """A function that returns the seconds since it was made."""
    start = perf_counter()
    return lambda: perf_counter() - start
