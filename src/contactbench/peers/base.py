"""The common base of solvers of other libraries: method, run and call."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np

from contactbench.errors import BadInput
from contactbench.methods.base import Adaptive
from contactbench.methods.prepared import NO_NUMBER, Outcome, Prepared, Refused, Request
from contactbench.methods.scaled import RunByTolerance
from contactbench.numbers.dual import Dual, slope
from contactbench.numbers.protocol import Arithmetic, CannotRecord
from contactbench.scene import AnyState, Scene
from contactbench.solution import Counts, Status
from contactbench.trace.form import Function, Unpack, execute
from contactbench.trace.recording import Recorded, Tape, attempt


@dataclass(frozen=True)
class Peer(Adaptive):
    """Describe a solver of another library.

    call : makes the `Call` of a run.  solver : its name in the library.  package : the package that must be installed.
    stages : number of stages of an attempted step, if fixed.  costs : `step_cost` by engine.
    """

    name: str
    about: str
    call: Callable[[Peer, Request], Call]
    engines: tuple[str, ...]
    rtol_range: tuple[float, float]
    solver: str = ""
    package: str = ""
    order: int | None = None
    stages: int | None = None
    implicit: bool = False
    takes_atol: bool = True
    costs: Mapping[str, float] = field(default_factory=dict)
    largest: int = Adaptive.largest
    mission: bool = False
    stiff: bool = False
    like: str = ""
    own_time = True

    def refuses(self, scene: Scene) -> str | None:
        return self.lacks(self.engines[0])

    def step_cost(self, scene: Scene, engine: str) -> float | None:
        return self.costs.get(engine)

    def prepare(self, request: Request) -> Prepared:
        try:
            if request.scene.breaks_until(float(request.save_at[-1])):
                return Pieces(self.name, request, self)
            return PeerRun(self.name, request, self)
        except ImportError as why:
            return Refused(self.name, request, str(why))


class Ending(NamedTuple):
    """Hold the result of a call, for `Prepared.finish`."""

    y: np.ndarray | None
    counts: Counts
    status: Status = Status.ok
    message: str = ""
    stopped: tuple[float, np.ndarray] | None = None


class Call(ABC):
    """Call a library for one request.

    1. The constructor compiles, allocates and connects; it raises `ImportError` if the library cannot be used.
    2. ``call(y0)`` runs from a packed state.  It returns the saved states reached after the start (None if there is not
       even a start), the counts, and after a failure status, message, and the last time and state of the solver.
    3. ``last(y0)`` is the fastest call of the library: from a packed state to the final one, unchecked.
    """

    #: seconds of recording and compiling
    seconds = 0.0

    def __init__(self, method: Peer, request: Request) -> None:
        self.method, self.request, self.scene = method, request, request.scene
        self.clock, self.end = self.scene.clock, float(request.save_at[-1])
        self.later = request.save_at[request.save_at > 0]
        self.split_clock, self.insert_clock = self.scene.split_clock, self.scene.insert_clock

    @abstractmethod
    def __call__(self, y0: np.ndarray) -> Ending:
        """Run from a packed state to all saved times."""

    @abstractmethod
    def last(self, y0: np.ndarray) -> np.ndarray:
        """Run from a packed state to the last one, without saving others."""

    @property
    def spent(self) -> str:
        return f"max_steps = {self.request.max_steps} spent"


@dataclass
class PeerRun(RunByTolerance):
    """Run a solver of another library."""

    method_: Peer

    def __post_init__(self) -> None:
        super().__post_init__()
        self.call = self.method_.call(self.method_, self.request)
        self.compile_s, self.bare = self.call.seconds, self.call.last  # type: ignore[method-assign]

    def bare_states(self, y0: np.ndarray) -> np.ndarray:
        y = self.call(y0).y
        return np.empty((0, len(y0))) if y is None else y

    def integrate(self, y0: np.ndarray) -> Outcome:
        y, counts, status, message, stopped = self.call(y0)
        reached = np.empty((0, len(y0))) if y is None else self.from_start(y0, y)
        return self.finish(y0, reached, counts, status, message, stopped)


@dataclass
class Pieces(Prepared):
    """Run in pieces between breaks; a step of Heun crosses the uncertainty of each break."""

    method_: Peer

    def __post_init__(self) -> None:
        super().__post_init__()
        times, begin, skipped, before = self.request.save_at, 0.0, 0.0, -1.0
        #: runs, their begins, the time skipped before each, the slice of saved times, the places of the saved states
        self.pieces = list[tuple[Prepared, float, float, slice, np.ndarray]]()
        for time, exact in [*self.breaks, (self._end, 0.0)]:
            end, last = min(time, self._end) - exact, time >= self._end - exact
            until = times[-1] if last else max(time, begin)
            own = slice(*np.searchsorted(times, [before, until], "right"))
            if end > begin:
                inside = np.maximum(np.minimum(times[own], end) - begin, 0.0)
                save_at, which = np.unique(np.append(inside, end - begin), return_inverse=True)
                run = PeerRun(self.method, replace(self.request, save_at=save_at), self.method_)
                self.pieces.append((run, begin, skipped, own, which[:-1]))
                before = until
            if last:
                break
            begin, skipped = time + exact, time + exact - max(end, 0.0)
        self.compile_s = sum(run.compile_s for run, *_ in self.pieces)

    def over(self, y: np.ndarray, time: float) -> np.ndarray:
        """Return the state on the other side of a break, by a step of Heun."""
        scene, carry = self.request.scene, self.request.carry

        def slope(y: np.ndarray) -> np.ndarray:
            return np.array(scene.pack(scene.rhs(scene.unpack(y.tolist(), carry))))

        return y + time / 2 * (slope(y) + slope(y + time * slope(y))) if time else y

    def bare(self, y0: np.ndarray) -> np.ndarray:
        y = y0
        for run, begin, skipped, *_ in self.pieces:
            y = run.bare(self.at(begin, self.over(y, skipped), y0))
        return y

    def at(self, begin: float, y: np.ndarray, y0: np.ndarray) -> np.ndarray:
        """Return a state whose time is start + `begin`, without the rounding of a sum of pieces."""
        y = y.copy()
        y[self._clock] = y0[self._clock] + begin
        return y

    def integrate(self, y0: np.ndarray) -> Outcome:
        y, states, totals = y0, np.full((self._saves, len(y0)), np.nan), list[Counts]()
        for run, started, skipped, own, which in self.pieces:
            out = run.integrate(self.at(started, self.over(y, skipped), y0))
            states[own], y = out.y[which], out.y[-1]
            totals.append(out.counts)
            begin = started
            if out.status is not Status.ok:
                break
        columns = [*zip(*totals, strict=True)][:-1]
        counts = Counts._make([*(None if None in each else sum(each) for each in columns), totals[0].kind])
        if out.status is Status.ok and (counts.steps or 0) <= self.request.max_steps:
            return self.finish(y0, states, counts)
        status, message = out.status, f"{out.message} (of the piece from t = {begin:.6g})"
        if out.status is Status.ok:
            status, message = Status.budget, f"max_steps = {self.request.max_steps} spent"
            states[:] = np.nan
        reached = int(np.argmin(np.append(np.isfinite(states).all(axis=1), False)))
        found = self.finish(y0, states[:reached], counts, status, message)
        return replace(found, end_time=max(found.end_time, begin + out.end_time))


def derivative(scene: Scene, x: AnyState, carry: tuple[str, ...]) -> list[list[Arithmetic]]:
    """Return Df at x, rows in packed order: the scene's own Jacobian, or its right-hand side on dual numbers."""
    rows: list[list[Arithmetic]] | None = scene.jacobian(x)
    if rows is not None:
        return rows
    y = scene.pack(x)
    columns = []
    for j in range(len(y)):
        moved = [Dual(c, 1.0 if i == j else 0.0) for i, c in enumerate(y)]
        columns.append([slope(c) for c in scene.pack(scene.rhs(scene.unpack(moved, carry)))])
    return [list(row) for row in zip(*columns, strict=True)]


# -- solvers that call back into Python ---------------------------------------------------------------
#: evaluations of DOP853 for the interpolant of a step, and before the first step
INTERPOLANT, BEFORE = 3, 2


#: f(t, y), or its Jacobian, of floats
type Rates = Callable[[float, Sequence[float]], Sequence[Any]]


class Solver(Protocol):
    """The interface of SciPy's solvers."""

    t: float
    y: np.ndarray
    status: str
    njev: int

    def step(self) -> str | None: ...
    def dense_output(self) -> Callable[[float], np.ndarray]: ...


class Callback(Call):
    """Run a solver that calls Python functions of floats, recorded with the scene's numbers if possible."""

    #: number of steps that a failed last step counts as
    failure = 1

    def __init__(self, method: Peer, request: Request) -> None:
        super().__init__(method, request)
        scene, carry = self.scene, request.carry
        recorded = record_function(scene, "rhs", carry)
        self.slopes = recorded or (lambda t, y: scene.slopes(t, y, carry))
        self.nowhere = [math.nan] * len(scene.without_clock(scene.labels(carry)))
        self.jacobian: Rates | None = None
        if method.implicit and scene.has_jacobian:
            recorded = record_function(scene, "jacobian", carry)
            self.jacobian = recorded or (lambda t, y: motion_jacobian(scene, t, y, carry))

    def rhs(self, t: float, y: Sequence[float]) -> Sequence[float]:
        """Return the slopes, or nan if a function raises an arithmetic error: the solver then takes a smaller step."""
        try:
            return self.slopes(t, y)
        except NO_NUMBER as error:
            if isinstance(error, BadInput):
                raise
            return self.nowhere

    @abstractmethod
    def begin(self, start: float, y: np.ndarray, rhs: Rates) -> Solver:
        """Return a solver, with the interface of SciPy's, for the motion from a time on."""

    @np.errstate(under="ignore")  # SciPy looks for the number next to t = 0
    def __call__(self, y0: np.ndarray) -> Ending:
        times, most, calls, rows = self.later, self.request.max_steps, [0], list[np.ndarray]()
        start, y = self.split_clock(y0)
        steps, interpolated, status, message = 0, 0, Status.ok, ""

        def counting(t: float, y: Sequence[float]) -> Sequence[float]:
            calls[0] += 1  # libraries leave out the calls that difference the Jacobian
            return self.rhs(t, y)

        try:
            solver = self.begin(start, y, counting)
        except NO_NUMBER as error:  # the right-hand side failed at the initial state
            message = f"{type(error).__name__}: {error} (t = 0)"
            return Ending(None, Counts(0, calls[0], 0, None), Status.failed, message)
        try:
            while len(rows) < len(times):
                if steps == most:
                    status, message = Status.budget, f"{self.spent} at t = {solver.t:.6g}"
                    break
                note = solver.step()
                steps += self.failure if solver.status == "failed" else 1
                if solver.status == "failed":
                    status, message = Status.failed, f"{note} (t = {solver.t:.6g})"
                    break
                due = times[len(rows) : int(np.searchsorted(times, solver.t, side="right"))]
                if len(due) and due[0] < solver.t:  # no interpolation at the solver's own point
                    interpolated, interpolant = interpolated + 1, solver.dense_output()
                own = solver.t, solver.y.copy()
                rows += [own[1] if t == own[0] else interpolant(t) for t in due]
        except (*NO_NUMBER, np.linalg.LinAlgError) as error:
            status, message = Status.failed, f"{type(error).__name__}: {error} (t = {solver.t:.6g})"
        rejected = None
        if (stages := self.method.stages) is not None:
            rejected = (calls[0] - BEFORE - INTERPOLANT * interpolated) // stages - steps
        found = self.insert_clock(np.reshape(rows, (-1, len(y))), start, times[: len(rows)])
        counts = Counts(steps, calls[0], solver.njev, rejected)
        return Ending(found, counts, status, message, (float(solver.t), solver.y))


def record_function(scene: Scene, what: str, carry: tuple[str, ...]) -> Rates | None:
    tape = Tape()
    names = tuple(f"y{i}" for i in range(len(scene.without_clock(scene.labels(carry)))))
    t, *y = (Recorded(tape, name, "f", tape.root) for name in ["t", *names])
    slopes = scene.slopes if what == "rhs" else partial(motion_jacobian, scene)
    try:
        results = tape.results(attempt(lambda: slopes(t, y, carry)))
    except (CannotRecord, TypeError):
        return None
    return execute(Function(what, ("t", "y"), (Unpack(names, "y"), *tape.root.statements), results))


def motion_jacobian(
    scene: Scene, t: Arithmetic, y: Sequence[Arithmetic], carry: tuple[str, ...]
) -> list[Sequence[Arithmetic]]:
    rows = scene.jacobian(scene.unpack(scene.with_clock(y, t), carry))
    return [scene.without_clock(row) for row in scene.without_clock(rows)]
