"""Requests to methods, prepared solvers, and the outcomes of their calls."""

from __future__ import annotations

import math
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from contactbench.blame import blame, is_ours
from contactbench.checks import finite, vector
from contactbench.errors import BadInput, excerpt
from contactbench.numbers.protocol import CannotRecord
from contactbench.registry import Registry
from contactbench.scene import AnyState, Cache, Scene, key, norm, verify
from contactbench.scene.base import Numeric
from contactbench.solution import DIVERGENCE, EXACT, Counts, Differential, Solution, Status, setting_key

#: name → method, each a `base.Method`
METHODS = Registry("method")
FEW = 64
#: Python's way to say inf or nan
NO_NUMBER = (OverflowError, ZeroDivisionError, ValueError)


@dataclass(frozen=True)
class Request:
    """A validated request to a method: the scene, the setting and the saved times.

    steps : prescribed steps, the longest is `step`; None for equal steps between saved times.  atol : one number, or
    one for every component but the time.  scales : the factors that gave atol = rtol · scales, see `to_scale`; None
    where the user gave atol.  dense : saved times do not shorten steps.
    about : the point about which a method expands the potential, if the user gave it.
    """

    scene: Scene
    engine: str
    carry: tuple[str, ...]
    save_at: np.ndarray
    step: float | None = None
    rtol: float | None = None
    atol: Any = None
    max_steps: int = 10**8
    steps: np.ndarray | None = None
    scales: Any = None
    dense: bool = True
    about: tuple[float, ...] | None = None

    def to_scale(self, takes_atol: bool, **data: object) -> Request:
        """Return the request with the scales of the motion and the atol they give; data : another start."""
        assert self.rtol is not None
        start, scene, end = self.scene.initial(self.carry, **data), self.scene, float(self.save_at[-1])
        scale = None if scene.scale is None else tuple(scene.scale)
        known = None if data else key(scene.identity, *start, *scene.numbers(), scale, end)
        each = _scales.get(known, lambda: scene.scales(start, end))
        scales = 1.0 if (each == 1).all() else each
        return replace(self, scales=scales, atol=self.rtol * scales if takes_atol else None)

    @cached_property
    def start(self) -> np.ndarray:
        """Return the scene's own initial state, packed."""
        return np.array(self.scene.pack(self.scene.initial(self.carry)), dtype=float)

    @property
    def asked(self) -> tuple[str, float]:
        """Return the control, "step", "rtol" or "exact", and its value."""
        control = "step" if self.step is not None else "rtol" if self.rtol is not None else EXACT
        return control, self.step or self.rtol or 0.0

    @cached_property
    def setting(self) -> str:
        if self.steps is not None:
            return f"{len(self.steps)} steps of {self.steps.min():.6g} to {self.steps.max():.6g}"
        return setting_key(*self.asked)


_scales: Cache[np.ndarray] = Cache(1024)


@dataclass(slots=True)
class Outcome:
    """The result of a run: packed states (NaN where not reached), counts, status and message.

    checked : the states are known to be finite and to reach the end.  steps : the chosen step and the longest taken.
    interpolated : which states are; None of none.
    """

    y: np.ndarray
    counts: Counts
    status: Status
    message: str
    end_time: float
    checked: bool = False
    steps: tuple[float, float] | None = None
    interpolated: np.ndarray | None = None


class Pilot(NamedTuple):
    """A run that is compared with others: packed states after the start, and its counts.

    fine : whether the loop found it sound; None where the loop does not look.  spent : it needs more steps than
    allowed.  ended : the attributes of its solution, if it is fine.
    """

    run: Any
    y: np.ndarray
    counts: Counts
    fine: bool | None = None
    spent: bool = False
    ended: dict[str, object] | None = None


@dataclass
class Prepared(ABC):
    """Run a compiled solver: a call, with other initial data if given, returns a `Solution`.

    A subclass writes `integrate`.  It writes `bare` if it has a faster way to the last state, and `sensitivity` with
    `sensitivity_source` if its map can be differentiated.

    The solver keeps the scene's functions as they were recorded.  A function that cannot be recorded is called, so
    that a call sees later changes of its globals.

    Parameters
    ----------
    method
        The name of the method.
    request
        The scene, the carried fields, the setting and the saved times.
    compile_s
        Seconds spent on tracing and compiling; zero where nothing is compiled.

    Raises
    ------
    BadInput
        On a call, for initial data that the scene does not have or cannot start from.
    """

    method: str
    request: Request
    compile_s: float = field(default=0.0, kw_only=True)

    #: of fixed steps: the step asked for, and the longest taken
    steps_taken = (math.nan, math.nan)
    #: how `sensitivity` differentiates the map of the steps taken; empty: it cannot
    sensitivity_source = ""

    def __init_subclass__(cls) -> None:
        """Restore the short repr, which `dataclass` replaces in every subclass."""
        super().__init_subclass__()
        cls.__repr__ = Prepared.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        r = self.request
        saved = f"{len(r.save_at)} states to t = {r.save_at[-1]:g}"
        return f"<{self.method} on {r.scene.name} ({r.engine}, {r.setting}), prepared: a call gives {saved}>"

    def __reduce__(self) -> tuple[object, ...]:
        return prepare_again, (self.method, self.request)

    def __post_init__(self) -> None:
        r = self.request
        self.start = r.start
        self._motion, self._clock, self._end = r.scene.motion, r.scene.clock, float(r.save_at[-1])
        self._saves = len(r.save_at)
        #: the whole call from a packed state, for a loop that detects failures itself
        self.at_once: Callable[[np.ndarray], Solution] | None = None
        #: times since the start that no step straddles, and how exact they are
        self.breaks = r.scene.breaks_until(self._end)
        self.saves_start = r.save_at[0] == 0
        self._bounds = b"", np.empty(0)
        #: the saved times > 0
        self.later = r.save_at[1:] if self.saves_start else r.save_at

    def __call__(self, **data: object) -> Solution:
        y0 = self.packed(data) if data else self.start
        at_once = self.at_once
        return at_once(y0) if at_once else self.solved(y0, self.integrate)

    def solved(self, y0: np.ndarray, integrate: Callable[[np.ndarray], Outcome]) -> Solution:
        """Return the solution from a packed state, with all checks of its start and its result."""
        if y0 is not self.start:
            require_slope(self.request.scene, self.request.scene.unpack(y0.tolist(), self.request.carry))
            self.require_clock(y0)
        try:
            out = integrate(y0)
        except BaseException as error:
            raise blame(f"{self.method} on scene {self.request.scene.name!r}", error) from error.__cause__
        out = self.audit(y0, out)
        steps = out.steps or self.steps_taken
        ended = self.attributes(out.status, out.message, out.counts, out.end_time, steps)
        ended["t"], ended["between"] = self.times_from(y0), out.interpolated
        return Solution.of(ended, self._dated(y0, out.y), y0)

    def times_from(self, y0: np.ndarray) -> np.ndarray:
        """Return the saved times of a run from a packed state."""
        begins, save_at = self.request.scene.split_clock(y0)[0], self.request.save_at
        return save_at + begins if begins else save_at

    def attributes(
        self, status: Status, message: str, counts: Counts, end: float, steps: tuple[float, float]
    ) -> dict[str, object]:
        """Return all of a `Solution` but its states."""
        r, (chosen, longest) = self.request, steps
        control, value = r.asked
        settings = {"control": control, "value": value, "step_chosen": chosen, "step": longest}
        ended = {"status": status, "message": message, "counts": counts, "end_time": end}
        run = {"scene": r.scene, "method": self.method, "engine": r.engine, "carry": r.carry}
        run["t"] = r.save_at if self._clock is None else self.times_from(self.start)
        return {**run, "run": self, **ended, **settings}

    def packed(self, data: Mapping[str, Any]) -> np.ndarray:
        """Return the initial state with other initial data, packed; raises `BadInput`."""
        y0, places = self.start.copy(), self.places
        for name, value in data.items():
            if name not in places:
                start = self.request.scene.initial(self.request.carry, **self.request.scene.checked(data))
                return np.array(self.request.scene.pack(start), dtype=float)
            where, length = places[name]
            if length is None:
                y0[where] = finite(name, value)
                continue
            if type(value) is np.ndarray and value.dtype == float:
                value = value.tolist()
            plain = type(value) in (tuple, list) and len(value) == length and set(map(type, value)) == {float}
            if not (plain and math.isfinite(sum(value))):
                value = vector(name, value, length)
            y0[where] = value
        return y0

    @cached_property
    def places(self) -> dict[str, tuple[int | slice, int | None]]:
        """Return the place and the length of initial data in a packed state, for data that need no further checks."""
        scene, carry = self.request.scene, self.request.carry
        found: dict[str, tuple[int | slice, int | None]] = {}
        at = 0
        for name in scene.fields_in(carry) if is_ours(type(scene)) else ():
            value, check = getattr(scene, name), scene.checks.get(name)
            check = check.func if isinstance(check, partial) else check
            length = len(value) if isinstance(value, tuple) else None
            if check is (finite if length is None else vector):
                found[name] = (at, None) if length is None else (slice(at, at + length), length)
            at += length or 1
        return found

    def bare_call(self) -> Callable[[], np.ndarray]:
        """Return the solver's own call from the scene's start, to be timed, after a first one in which it settles."""
        call = self.bare if self._saves == 1 else self.bare_states
        call(self.start)
        return partial(call, self.start)

    def require_size(self, y0: np.ndarray) -> None:
        """Raise `BadInput` for a packed state of another length, which compiled code does not detect."""
        if len(y0) != len(self.start):
            names = ", ".join(self.request.scene.labels(self.request.carry)[:8])
            raise BadInput(f"y0 has {len(y0)} numbers: must be {len(self.start)}, those of {names}")

    def require_clock(self, y0: np.ndarray) -> None:
        """Raise `BadInput` for a start at another time if the scene has breaks."""
        if self.breaks and (begins := y0[self._clock]) != self.start[self._clock]:
            how = f"scene.with_(t={begins:g})"
            raise BadInput(f"t = {begins:g}: steps that end at breaks begin with the scene: {how}")

    @abstractmethod
    def integrate(self, y0: np.ndarray) -> Outcome:
        """Run from a packed initial state."""

    def bare(self, y0: np.ndarray) -> np.ndarray:
        """Make the solver's own call, by its fastest way: packed initial state to packed final state, unchecked."""
        return np.asarray(self.integrate(y0).y[-1])

    def bare_states(self, y0: np.ndarray) -> np.ndarray:
        """Make the same call for all saved states, (k, d)."""
        return self.integrate(y0).y

    def from_start(self, y0: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y0[None], y]) if self.saves_start else y

    def _dated(self, y0: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return saved states whose time is the saved one, not the sum of many steps; NaN where not reached."""
        if (clock := self._clock) is None:
            return y
        y = y.copy()
        y[:, clock] = np.where(np.isnan(y[:, clock]), math.nan, y0[clock] + self.request.save_at)
        return y

    # -- how a run ended -------------------------------------------------------------------------------
    def first_divergence(self, y0: np.ndarray, y: np.ndarray) -> int | None:
        """Return the index of the first saved state in y that is not finite, or beyond its scale."""
        # the common case first, without an overflow; a few numbers are worth no NumPy, many are
        start = y0[: self._motion]
        bound = DIVERGENCE * max(1.0, math.sqrt(float(start @ start)))
        largest = math.hypot(*y.ravel().tolist()) if y.size <= FEW else np.abs(y).max()
        if largest <= bound:  # nan fails every comparison
            return None
        bad = ~(np.isfinite(y).all(axis=1) & (np.abs(y[:, : self._motion]) <= self.bounds(y0)).all(axis=1))
        return int(np.argmax(bad)) if bad.any() else None

    def bounds(self, y0: np.ndarray) -> np.ndarray:
        """Return `furthest` from a packed state; the latest result is cached, since all pilots of a start need it."""
        known, given = self._bounds, y0.tobytes()  # another thread may replace the cached result
        if known[0] != given:
            known = self._bounds = given, furthest(self.request.scene, self.request.carry, y0, self._end)
        return known[1]

    def scales(self, y0: np.ndarray) -> np.ndarray:
        """Return the scale of every component but the time of the motion from a packed state."""
        scene = self.request.scene
        return scene.scales(scene.unpack(scene.entries(y0), self.request.carry), self._end)

    def finish(
        self,
        y0: np.ndarray,
        y: np.ndarray,
        counts: Counts,
        status: Status = Status.ok,
        message: str = "",
        stopped: tuple[float, np.ndarray] | None = None,
    ) -> Outcome:
        """Return the outcome for the saved states reached: check for divergence, pad with NaN.

        stopped : time and state at which a solver gave up: out of scale it has diverged, with ever shorter steps.
        """
        bad = self.first_divergence(y0, y)
        if bad is None and status is Status.ok and len(y) == self._saves:
            return Outcome(y, counts, status, message, self._end, True)
        times, reached, left = self.request.save_at, len(y), "left the scene's scale by a factor 1e6"
        if bad is not None:
            y, reached = y[:bad], bad
            status, message = Status.diverged, f"{left} before t = {times[bad]:.6g}"
        if reached < len(times):
            if status is Status.ok:
                status, message = Status.failed, f"stopped before t = {times[reached]:.6g}"
            y = np.concatenate([y, np.full((len(times) - reached, len(y0)), math.nan)])
        end = float(times[reached - 1]) if reached else 0.0
        if status is not Status.ok and stopped is not None:
            end = max(end, min(stopped[0], float(times[-1])))
            if self.first_divergence(y0, stopped[1][None]) is not None:
                status, message = Status.diverged, f"{left} by t = {end:.10g}"
        return Outcome(y, counts, status, message, end)

    def audit(self, y0: np.ndarray, out: Outcome) -> Outcome:
        """Return the outcome; withdraw an `ok` that cannot be true."""
        if out.status is Status.ok and not out.checked:
            if out.end_time != self._end:
                message = f"ended at t = {out.end_time:.6g}, not at t = {self._end:.6g}"
                return replace(out, y=np.full_like(out.y, math.nan), status=Status.failed, message=message)
            if not np.isfinite(out.y[-1]).all():
                return replace(out, status=Status.diverged, message="not finite at the end")
        if out.status is Status.ok and self.request.scene.bounds_energy:
            return self._without_rise(y0, out)
        return out

    def _without_rise(self, y0: np.ndarray, out: Outcome) -> Outcome:
        """Withdraw an `ok` if a bounded H0 ends above its start by more than all its terms there."""
        r = self.request
        x = r.scene.unpack(r.scene.entries(y0), r.carry)
        start = r.scene.energy(x)
        most = start + r.scene.energy_terms(x)  # no motion from there reaches it
        x = r.scene.unpack(r.scene.entries(out.y[-1]), r.carry)
        end = r.scene.energy(x)
        if not (end > most > start and end - start > r.scene.energy_terms(x) / 2):
            return out
        # state by state: functions may take floats only
        states = (r.scene.unpack(r.scene.entries(y), r.carry) for y in out.y)
        first = next(k for k, x in enumerate(states) if r.scene.energy(x) > most)
        y, time = out.y.copy(), float(r.save_at[first])
        y[first:] = math.nan
        message = f"H0 rose from {start:.6g} to {end:.6g}, above all that the scene allows: a smaller step is needed"
        return replace(out, y=y, status=Status.diverged, message=message, end_time=time, checked=True)

    # -- the map of the steps taken --------------------------------------------------------------------
    @property
    def steps_follow_state(self) -> bool:
        """Return whether the steps depend on the initial data: `sensitivity` then misses a part."""
        return self.request.rtol is not None

    def tangents(self, y0: np.ndarray) -> list[np.ndarray]:
        r = self.request
        start = r.scene.unpack(tuple(y0.tolist()), r.carry)
        return [np.array(r.scene.pack(v), dtype=float) for v in r.scene.tangents(start)]

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        """Return the derivative of the saved states along the scene's m tangents at y0, steps fixed, (k, d, m)."""
        raise BadInput(f"{self.method} ({self.request.engine}): its map cannot be differentiated")

    def differential(
        self, y0: np.ndarray, out: Outcome | Solution, patience: Patience | None = None
    ) -> Differential:
        """Return dΦ of the whole map: to round-off where the engine can, else by differences of the solver."""
        if self.sensitivity_source and not self.steps_follow_state:
            with suppress(CannotRecord):  # a function that dual numbers do not know
                return Differential(self.sensitivity_source, self.sensitivity(y0)[None])
        return differences(self, y0, out, patience)

    @property
    def composed(self) -> bool:
        """Return whether a run is a composition of contact maps, with any conformal factors."""
        return False

    def modified_hamiltonian(self, x: AnyState) -> Numeric:
        """Return H̃ at x (see `splitting.modified`), None if the run has no known modified Hamiltonian."""
        return None


def furthest(scene: Scene, carry: tuple[str, ...], y0: np.ndarray, end: float) -> np.ndarray:
    """Return the sizes of the components beyond which a motion from a packed state has diverged, (motion,)."""
    with np.errstate(all="ignore"):
        scales = scene.scales(scene.unpack(tuple(y0), carry), end)[: scene.motion]
        most = np.fmax(scales, np.fmax(1.0, np.linalg.norm(y0[: scene.motion])))
    return np.asarray(DIVERGENCE * most)


def prepare_again(method: str, request: Request) -> Prepared:
    run: Prepared = METHODS[method].prepare(request)
    return run


class Refused(Prepared):
    def __init__(self, method: str, request: Request, why: str) -> None:
        super().__init__(method, request)
        self.why = why

    def integrate(self, y0: np.ndarray) -> Outcome:
        nothing = np.full((len(self.request.save_at), len(y0)), math.nan)
        return Outcome(nothing, Counts(), Status.unsupported, self.why, 0.0)


def require_slope(scene: Scene, start: AnyState) -> None:
    """Raise `BadInput` unless the slope at a state is finite: some solvers never return from a nan."""
    try:
        slope = [float(component) for component in scene.pack(scene.rhs(start))]
    except NO_NUMBER as error:
        if isinstance(error, BadInput):
            raise
        slope = [math.nan]
    except BaseException as error:
        raise blame(f"scene {scene.name!r}", error) from error.__cause__
    if not math.isfinite(math.hypot(*slope)):
        raise BadInput(
            f"initial data: the right-hand side of scene {scene.name!r} is not finite there: {excerpt(start)}"
        )


#: number of times at which a slope is compared with the slope one rounding later, and their allowed relative
#: difference; a span of more roundings of its times than MANY needs no comparison
LOOKS, APART, MANY = 16, 0.01, 1e9


def warn_of_rounding(scene: Scene, carry: tuple[str, ...]) -> None:
    """Warn if the rounding of times far from 0 changes the slope of the scene noticeably."""
    begins, end = scene.begins, scene.t_end
    ulp = float(np.spacing(abs(begins) + end))
    if not begins or ulp * MANY < end:
        return
    y = scene.without_clock(scene.pack(scene.initial(carry)))
    times = begins + end * (np.arange(LOOKS) + 0.5) / LOOKS
    with suppress(*NO_NUMBER), np.errstate(all="ignore"):
        slopes = [
            np.array([scene.slopes(t, y, carry) for t in (times + late).tolist()]) for late in (0.0, ulp)
        ]
        apart = np.median(np.abs(slopes[1] - slopes[0]), axis=0) / np.abs(slopes[0]).max(axis=0)
        if (most := float(np.nanmax(apart, initial=0.0))) > APART:
            how = (
                f"are {ulp:.2g} apart, between which its slope changes by {most:.0%}: count time from nearby"
            )
            warnings.warn(
                f"scene {scene.name!r}: times next to {begins:.6g} {how}", RuntimeWarning, stacklevel=2
            )


_started: Cache[bool] = Cache(1024)


def require_start(scene: Scene, carry: tuple[str, ...]) -> None:
    """Raise `BadInput` for a scene whose slope at the start is not finite; check each scene once."""
    if scene.has_users_functions:
        verify(scene)

    def passes() -> bool:
        require_slope(scene, scene.initial(carry))
        warn_of_rounding(scene, carry)
        return True

    data = [getattr(scene, name) for name in scene.initial_fields]
    known = key(scene.identity, carry, *scene.numbers(), *data)
    _started.get(known, passes)


def stopwatch() -> Callable[[], float]:
    start = perf_counter()
    return lambda: perf_counter() - start


# -- the derivative of any numerical map by central differences ------------------------------------
RATIO = 4.0
#: increments, relative to the size of the displaced field
INCREMENTS = tuple(1e-3 / RATIO**k for k in range(6))
#: relative disagreement of the last two estimates beyond which the derivative is not resolved
UNRESOLVED = 0.1
#: a disagreement below this many roundings of the state over the smallest increment is round-off: a derivative
#: may be that small, for example along a decayed s
ROUNDINGS = 8
#: most right-hand sides of the runs for a derivative, in compiled code and in Python; right-hand sides of a step of
#: an implicit method that does not count them
BUDGET, CALLBACK_BUDGET, IMPLICIT = 1_000_000, 200_000, 20


class Patience:
    """A limit of time for measuring laws, on the clock of `perf_counter`; tell : reports progress."""

    def __init__(self, until: float, tell: Callable[[str], None]) -> None:
        self.until, self.tell, self.over = until, tell, False

    @property
    def left(self) -> float:
        return max(self.until - perf_counter(), 0.0)

    def counts(self, runs: int) -> Callable[[], None]:
        """Return a function to call after each of some runs; it raises `OutOfPatience` if they will take too long."""
        begun, left, done = perf_counter(), self.left, 0

        def after_run() -> None:
            nonlocal done
            done += 1
            needed = (perf_counter() - begun) * runs / done
            self.over = needed > left
            if self.over:
                why = f"{runs} runs take about {needed:.3g} s, {left:.3g} s were left"
                raise OutOfPatience(f"not taken: {why}; laws(seconds=…) gives more")
            self.tell(f"run {done} of {runs}")

        return after_run


class OutOfPatience(Exception):
    """Report that the runs for a derivative would take too long."""


def scale(x: AnyState, v: AnyState, units: AnyState) -> float:
    """Return the size of the field that v displaces; for a zero field the size it reaches along the motion."""
    for own, part, unit in zip(x, v, units, strict=True):
        if any(part) if isinstance(part, tuple) else part:
            return norm(own if isinstance(own, tuple) else (own,)) or float(np.max(unit))
    return 1.0


def differences(
    run: Prepared, y0: np.ndarray, out: Outcome | Solution, patience: Patience | None = None
) -> Differential:
    """Return dΦ at y0 by differences of `run.integrate`, the choice of steps included.

    The initial data are displaced along the tangents by increments δ that fall by the factor `RATIO`.  Two neighbouring
    central differences D give R = (r² D(δ/r) − D(δ))/(r² − 1).  The value is the R that agrees best with its neighbour,
    the error bar twice their difference (Ridders, Adv. Eng. Software 4, 75 (1982), doi:10.1016/S0141-1195(82)80057-0);
    none if the last two differ by a tenth of their size and by more than round-off.
    """
    scene: Scene = run.request.scene
    x = scene.unpack(tuple(y0.tolist()), run.request.carry)
    tangents = scene.tangents(x)
    runs = 2 * len(tangents) * len(INCREMENTS)
    counts, budget = out.counts, CALLBACK_BUDGET if "python" in run.request.engine else BUDGET
    steps = (counts.steps or 0) + (counts.rejected or 0)
    cost = runs * (IMPLICIT * steps if counts.rhs_equivalents is None else counts.rhs_equivalents)
    none = np.empty((0, *out.y.shape, len(tangents)))
    after_run = (lambda: None) if patience is None else patience.counts(runs)
    if patience is None and cost > budget:
        why = f"not taken: {runs} runs would cost {cost:.1e} right-hand sides, more than {budget:.0e}"
        return Differential(why, none)

    def end(v: object, amount: float) -> np.ndarray:
        y = run.integrate(np.array(scene.pack(scene.displaced(x, v, amount)), dtype=float)).y
        after_run()
        return y

    def quotient(v: object, amount: float) -> np.ndarray:
        return np.asarray((end(v, amount) - end(v, -amount)) / (2 * amount))

    each = np.array(scene.with_clock(run.scales(y0).tolist(), 1.0))
    units = scene.unpack(each.tolist(), run.request.carry)
    flat = (np.abs(np.array(scene.pack(v), dtype=float)) for v in tangents)
    scales = [float(max(v * each)) for v in flat] if scene.mixed else [scale(x, v, units) for v in tangents]
    moved = list(zip(tangents, scales, strict=True))
    try:
        plain = np.array([[quotient(v, d * size) for v, size in moved] for d in INCREMENTS])
    except OutOfPatience as why:
        return Differential(str(why), none)
    better = (RATIO**2 * plain[1:] - plain[:-1]) / (RATIO**2 - 1)
    gap, size = (np.abs(v / each).max(axis=(1, 2)) for v in (better[-1] - better[-2], better[-1]))  # (m,)
    round_off = (
        ROUNDINGS * np.finfo(float).eps * np.abs(out.y / each).max() / (INCREMENTS[-1] * np.array(scales))
    )
    if not np.all(gap < np.maximum(UNRESOLVED * size, round_off)):
        return Differential("not taken: differences of the solver do not converge", none)
    return Differential(f"central differences of the solver, {runs} runs", np.moveaxis(better, 1, -1))
