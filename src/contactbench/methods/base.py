"""The contract of a method, and the registry.

`METHODS` holds everything that is compared.  What a method must be, and what experiments, laws and tables rely
on, are the numbered rules of `Method`; `contactbench.testing.check_method` tests every one of them.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import hypot
from time import perf_counter
from typing import Any

import numpy as np

from contactbench.boundary import reported
from contactbench.errors import BadInput, Registry, shown
from contactbench.methods.differences import differences
from contactbench.methods.engines import CALLBACKS
from contactbench.methods.outcome import Outcome, audited
from contactbench.scene import Scene
from contactbench.solution import (
    EXACT,
    Counts,
    Differential,
    Solution,
    Status,
    divergence_bound,
    first_divergence,
    printed_setting,
)

#: what a method may be compared as: composed of exact contact flows, derived from a discrete action, or in use
#: for differential equations at large
FAMILIES = ("contact", "variational", "established")
#: Python's way to say inf or nan
NO_NUMBER = (OverflowError, ZeroDivisionError, ValueError)
#: the tightest rtol of a library without a limit of its own, and of CVODE, which refuses less than a rounding
ROUNDING = 2.3e-16
#: the tightest of SciPy and CyRK, which raise any below 100 ε to that
CLAMPED = 2.3e-14
#: a step this small against the span hardly moves the clock: a singularity is ahead
SHORTEST = 1e-15


class Method(ABC):
    """What can be compared with the other methods.

    To bring a step map ``(scene, x, h, xp) -> x``, use `fixed_step` or subclass `FixedStep`; to bring a solver
    that chooses its own steps, subclass `Adaptive` and write `prepare`.  Everything else here has a default.

     1. It declares itself: `name` (a key in tables and a word on the command line), `about` (one line with its
        source), `family` (one of `FAMILIES`), `engines` (keys of `engines.ENGINES`, the default first), `order`.
     2. ``refuses(scene)`` is None or one sentence: why the scene is out of reach.  A run of a refused scene ends
        `unsupported` with that sentence, and never raises.
     3. ``prepare(request)`` does all that depends on scene, setting and saved times alone (recording, compiling,
        allocating); where that fails for one engine it returns `Refused`, and the next engine is tried.  The
        result is called any number of times, with other initial data if wanted; no call leaves a trace: equal
        data, equal bits.
     4. A run gives the states at exactly the saved times, the initial state bit for bit where 0 is among them.
     5. ``bare(y0)`` is the solver's own call, by its fastest way: the last state of the run to within the
        roundings of another way to the same time.  It is what is timed.
     6. The setting controls the error.  Not `adaptive`: takes `step`; steps are equal between saved times and no
        longer than `step`, and the error falls as step^order.  `adaptive`: takes `rtol` within `rtol_range` and
        `atol`, and says in `tolerance` what they bound; the error falls as they do.  `exact`: takes neither
        and has no truncation error.
     7. `max_steps` is never exceeded: a run that needs more ends as `budget`, and the states it did not reach
        are NaN.  So are they after `diverged` (which comes with the time, to the step) and `failed`.
     8. `Counts.evaluations` are all evaluations that a run made, of the kind the counts name, those for a
        Jacobian, an interpolant or a pilot included; None where the solver does not say and
        ``Prepared.count`` finds it out or cannot.
     9. All engines compute the same: to round-off where the steps are given, else within the tolerance.
    10. Claims hold on every scene that is not refused, and are not left out where they hold: `contact` (every
        run is a composition of contact maps whose factors are those of the exact flow), `symmetric`
        (Φ_{−h} ∘ Φ_h = id).
    11. Where `Prepared.sensitivity_source` says how, `sensitivity` is the derivative of the saved states of the
        map of the steps taken, along the scene's tangents.
    12. ``step_cost(scene, engine)`` is about what a step costs where the right-hand side is called back from
        Python, in right-hand sides; None where a step is so cheap that no experiment need limit their number.
    """

    name: str
    about: str
    family: str = "established"
    engines: tuple[str, ...]

    def __init_subclass__(cls) -> None:
        """Methods are told apart by identity, whatever `dataclass` would compare: a step need not be hashable."""
        super().__init_subclass__()
        cls.__eq__, cls.__hash__ = object.__eq__, object.__hash__  # type: ignore[method-assign]

    #: of convergence; None where it varies
    order: int | None
    #: whether it takes rtol and chooses its own steps
    adaptive: bool
    #: whether there is no truncation error, and nothing to be set
    exact: bool = False
    contact: bool = False
    symmetric: bool = False
    rtol_range: tuple[float, float] = (1e-13, 1e-1)
    #: whether it takes an absolute tolerance beside rtol
    takes_atol: bool = True
    #: what rtol and atol bound
    tolerance: str
    #: whether its solver has a time of its own: that of a scene is then no part of what it integrates
    own_time: bool = False

    @property
    def control(self) -> str:
        """What is set: "step", "rtol" or nothing, "exact"."""
        return EXACT if self.exact else "rtol" if self.adaptive else "step"

    def refuses(self, scene: Scene) -> str | None:
        """Why the scene is out of reach, or None."""
        return None

    @abstractmethod
    def prepare(self, request: Request) -> Prepared:
        """A run for the request, compiled."""

    @abstractmethod
    def step_cost(self, scene: Scene, engine: str) -> float | None:
        """About the right-hand sides, called back from Python, that a step costs as much as."""


METHODS = Registry("method", Method)


class Adaptive(Method):
    """Base of the solvers that choose their own steps from rtol."""

    adaptive = True
    tolerance = "the local error of a step, by rtol |y| + atol in every component"
    #: right-hand sides of a typical step
    evaluations_per_step: int = 1

    def step_cost(self, scene: Scene, engine: str) -> float | None:
        return self.evaluations_per_step if engine in CALLBACKS else None


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
    max_steps: int = 10**8

    @property
    def control(self) -> str:
        """What is set: "step", "rtol" or nothing, "exact"."""
        return "step" if self.step is not None else "rtol" if self.rtol is not None else EXACT

    @property
    def value(self) -> float:
        """To what it is set; 0 for nothing."""
        return self.step or self.rtol or 0.0

    @cached_property
    def setting(self) -> str:
        """The setting as it is keyed in tables."""
        return printed_setting(self.control, self.value)


@dataclass
class Prepared(ABC):
    """A compiled solver: call it, with other initial data if you like, to get a `Solution`.

    A solver's own class writes `integrate`; `bare` where there is a faster way to the last state; `count` where
    a run does not tell its cost; and, where its map can be differentiated, `sensitivity` (or `linearised`)
    together with `sensitivity_source`.

    It belongs to what the scene's functions computed when it was prepared.  A function that cannot be recorded is
    called as it is; where that is so, and something has changed since, a call computes with the change.
    """

    method: str
    request: Request
    #: seconds spent tracing and compiling; zero where nothing is compiled
    compile_s: float = field(default=0.0, kw_only=True)

    def __init_subclass__(cls) -> None:
        """The short repr, which `dataclass` would replace in every class."""
        super().__init_subclass__()
        cls.__repr__ = Prepared.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        """One line: what a call runs."""
        r = self.request
        saved = f"{len(r.save_at)} states to t = {r.save_at[-1]:g}"
        return f"<{self.method} on {r.scene.name} ({r.engine}, {r.setting}), prepared: a call gives {saved}>"

    @abstractmethod
    def integrate(self, y0: np.ndarray) -> Outcome:
        """Run from a packed initial state."""

    @property
    def start(self) -> np.ndarray:
        """The scene's own initial state, packed."""
        return self._own_start

    def bare(self, y0: np.ndarray) -> np.ndarray:
        """The solver's own call, by its fastest way: packed initial state to packed final state, unchecked."""
        return self.integrate(y0).y[-1]

    #: of fixed steps: the step asked for, and the longest taken
    steps_taken = (math.nan, math.nan)

    #: how `sensitivity` differentiates the map of the steps taken; empty: it cannot
    sensitivity_source = ""

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        """(k, d, m): derivative of the saved states along the scene's m tangents at y0, steps held fixed."""
        raise BadInput(f"{self.method} ({self.request.engine}): its map cannot be differentiated")

    def linearised(self, y0: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Saved states (k, d) and their derivative (k, d, m), of one and the same numerical map.

        y : the saved states of the plain run.  A solver that has to run anew for the derivative
        gives the states of that run instead.
        """
        return y, self.sensitivity(y0)

    @property
    def steps_follow_state(self) -> bool:
        """Whether other initial data may mean other steps: then `sensitivity` is not that of the map."""
        return self.request.rtol is not None

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

    def modified_hamiltonian(self, x: Any) -> Any | None:
        """H̃ at x (see `splitting.modified`), None where the run is not known to be the flow of one."""
        return None

    def __call__(self, **data: Any) -> Solution:
        r = self.request
        if data:
            start = r.scene.initial(r.carry, **r.scene.checked(data))
            begins(r.scene, start)
            y0 = np.array(r.scene.pack(start), dtype=float)
        else:
            y0 = self._own_start
        try:
            out = self.integrate(y0)
        except BaseException as error:
            raise reported(f"{self.method} on scene {r.scene.name!r}", error) from error.__cause__
        if not out.checked:
            out = audited(out, self._end)
        if out.status is Status.ok and self._bounded:
            out = self._risen(y0, out)
        return Solution(
            *self._asked, out.y, out.status, out.message, out.counts, out.end_time, y0, self, *self._set,
            *(out.steps or self.steps_taken),
        )  # fmt: skip

    def _risen(self, y0: np.ndarray, out: Outcome) -> Outcome:
        """The outcome, an `ok` taken back where H0 ends above its start by more than all its terms there.

        No motion of a scene that `bounds_energy` does so: the steps are far too long for it.  An error that is
        small beside the terms at the end, after a start next to an equilibrium, is no such rise.
        """
        r = self.request
        start, most = self._own_energy if y0 is self._own_start else self._energy(y0)
        x = r.scene.unpack(out.y[-1].tolist(), r.carry)
        end = r.scene.energy(x)
        if not (end > most > start and end - start > r.scene.energy_terms(x) / 2):
            return out
        energies = r.scene.energy(r.scene.unpack(tuple(out.y.T), r.carry))
        first = int(np.argmax(energies > most))
        y = out.y.copy()
        y[first:] = math.nan
        message = f"H0 rose from {start:.6g} to {end:.6g}, above all that the scene allows: a smaller step is needed"
        return replace(
            out, y=y, status=Status.diverged, message=message, end_time=float(r.save_at[first]), checked=True
        )

    def _energy(self, y0: np.ndarray) -> tuple[float, float]:
        """H0 at a start, and what it cannot reach on any motion from there."""
        scene = self.request.scene
        x = scene.unpack(y0.tolist(), self.request.carry)
        start = float(scene.energy(x))
        return start, start + float(scene.energy_terms(x))

    @cached_property
    def _own_energy(self) -> tuple[float, float]:
        return self._energy(self._own_start)

    @property
    def atol(self) -> float | None:
        """The absolute tolerance of the run, where its method takes one."""
        takes = self.method not in METHODS or METHODS[self.method].takes_atol
        return self.request.atol if takes else None

    def __reduce__(self) -> Any:
        """Pickled as what it was prepared from."""
        return Deferred, (self.method, self.request)

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
        self._motion, self._clock, self._end = r.scene.motion, r.scene.clock, float(r.save_at[-1])
        self._bounded = isinstance(r.scene, Scene) and r.scene.bounds_energy
        self._own_bound = divergence_bound(self._own_start[: self._motion])
        self._saves = len(r.save_at)
        self.saves_start = r.save_at[0] == 0
        #: the saved times > 0
        self.later = r.save_at[1:] if self.saves_start else r.save_at
        self._set = (r.control, r.value)

    def split_clock(self, y0: np.ndarray) -> tuple[float, np.ndarray]:
        """The time at which a packed state begins, 0 where it has none, and the components less the time."""
        clock = self._clock
        if clock is None:
            return 0.0, y0
        y = y0[:clock] if clock == len(y0) - 1 else np.concatenate((y0[:clock], y0[clock + 1 :]))
        return float(y0[clock]), y

    def insert_clock(self, y: np.ndarray, start: float, times: Any) -> np.ndarray:
        """Packed states, of components less the time: (k, ·) at k times since `start`, or a single one."""
        clock = self._clock
        if clock is None:
            return y
        packed = np.empty((*y.shape[:-1], y.shape[-1] + 1))  # a tenth of the time of np.insert
        packed[..., :clock], packed[..., clock], packed[..., clock + 1 :] = (
            y[..., :clock],
            start + times,
            y[..., clock:],
        )
        return packed

    def from_start(self, y0: np.ndarray, y: np.ndarray) -> np.ndarray:
        """The saved states, of those at `later` times: the initial one before them where it is saved."""
        return np.concatenate([y0[None], y]) if self.saves_start else y

    def tangents(self, y0: np.ndarray) -> list[np.ndarray]:
        """The scene's tangent vectors at a packed state, packed."""
        r = self.request
        start = r.scene.unpack(tuple(y0.tolist()), r.carry)
        return [np.array(r.scene.pack(v), dtype=float) for v in r.scene.tangents(start)]

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


@dataclass
class Deferred:
    """A run that has come out of a pickle: it is prepared anew when something is asked of it."""

    method: str
    request: Request

    @cached_property
    def run(self) -> Prepared:
        return METHODS[self.method].prepare(self.request)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.run, name)

    def __call__(self, **data: Any) -> Solution:
        return self.run(**data)


class Refused(Prepared):
    """A prepared 'no': every call gives a solution with status `unsupported`."""

    def __init__(self, method: str, request: Request, why: str) -> None:
        super().__init__(method, request)
        self.why = why

    def integrate(self, y0: np.ndarray) -> Outcome:
        nothing = np.full((len(self.request.save_at), len(y0)), math.nan)
        return Outcome(nothing, Counts(), Status.unsupported, self.why, 0.0)


def begins(scene: Scene, start: Any) -> None:
    """Raise `BadInput` unless the equations have a finite slope at an initial state.

    Some solvers, SciPy's among them, never return from a first step that is not a number.
    """
    try:
        slope = [float(component) for component in scene.pack(scene.rhs(start))]
    except NO_NUMBER as error:
        if isinstance(error, BadInput):
            raise
        slope = [math.nan]
    except BaseException as error:
        raise reported(f"scene {scene.name!r}", error) from error.__cause__
    if not math.isfinite(hypot(*slope)):
        raise BadInput(
            f"initial data: the right-hand side of scene {scene.name!r} is not finite there: {shown(start)}"
        )


def stopwatch() -> Any:
    """A function that returns the seconds since it was made."""
    start = perf_counter()
    return lambda: perf_counter() - start
