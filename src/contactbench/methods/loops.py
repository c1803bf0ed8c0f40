"""Loops over steps: packed states after intervals of equal steps, computed by LLVM or by Python."""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cache, cached_property
from typing import Any, ClassVar, Protocol

import numpy as np

from contactbench.blame import is_ours
from contactbench.methods import dates
from contactbench.methods.prepared import NO_NUMBER, Request, stopwatch
from contactbench.numbers.control import Repeat
from contactbench.numbers.control import repeat as plain
from contactbench.numbers.dual import Dual, DualNumbers, slope, value
from contactbench.numbers.protocol import Arithmetic, CannotRecord, Count, Namespace
from contactbench.scene import AnyState, Cache, Scene, key
from contactbench.scene.base import OwnState
from contactbench.solution import DIVERGENCE
from contactbench.trace.compiled import compile_function
from contactbench.trace.form import Function, execute, lines
from contactbench.trace.native_call import Native
from contactbench.trace.program import Program, Watch, record

#: most numbers computed ahead of a run, for intervals with different steps
AHEAD = 2**22
#: Python computes up to this many numbers in milliseconds; compiling `setup` takes a tenth of a second
FEW = 2**13
#: steps times statements of about a hundredth of a second; seconds between two checks for signals
LONG, LOOK = 3e7, 0.1
#: steps that differ by this part are equal: numbers kept beside the state serve the next one
SAME = 1e-6
#: number of divisions into steps whose rows a loop caches
KEPT = 32

#: from a start to all states of a run, and whether they are sound
Watched = Callable[[np.ndarray], tuple[np.ndarray, bool]]
#: intervals of n steps of size h with their dates, as a list; and as arrays, with the arguments of the loop unless
#: they are too many
Spans = list[tuple[float, int, list[float]]]
Rows = tuple[np.ndarray, np.ndarray, np.ndarray | None, tuple[np.ndarray, ...] | None]


def total(n: np.ndarray) -> int:
    """Return Σ n[k], approximately if it exceeds an int64."""
    return int(np.add.reduce(n, dtype=float))


class Steps(Hashable, Protocol):
    """The part of a method that a loop uses; usually a `FixedStep`."""

    iterates: ClassVar[bool]

    def advance(
        self, scene: Scene, x: AnyState, h: Arithmetic, n: Count, xp: Namespace, repeat: Repeat = ...
    ) -> AnyState:
        """Return the state after n ≥ 1 steps of size h."""


class StepLoop[Ready](ABC):
    """Take the steps of a method on a scene, by one engine.

    1. ``ready(h, n, since)`` returns everything that depends on the steps alone, for intervals of n[k] steps of size
       h[k].  since : the `dates` of the intervals, for a scene with a time; by default they follow each other.
    2. ``take(y0, ready)`` returns the packed states after each interval, (k, d), and the number of evaluations, None
       where it is known beforehand.  Calls are independent.
    3. ``last(ready)`` returns the fastest function from a start to the last state.
    4. ``watched(ready, steps, starts)`` returns the function from a start to all states, the start included if
       `starts`, and whether they are sound; None if the loop does not check that, or runs long.
    5. ``into(ready, steps, start, after)`` returns the same on memory that is given once.
    6. ``tangent(y0, v, h, n, since)`` returns the derivative of the states along v.

    Parameters
    ----------
    method
        A `FixedStep`.
    request
        The scene, the carried fields, the setting and the saved times.
    """

    #: the source of the derivative by `tangent`
    derivative = "forward-mode AD through the same steps, compiled"
    #: seconds of recording and compiling
    seconds = 0.0

    def __init__(self, method: Steps, request: Request) -> None:
        self.method, self.scene, self.carry = method, request.scene, request.carry
        #: how many numbers a run keeps beside the state
        self.beside = method.beside(self.scene, self.carry) if method.iterates else 0  # type: ignore[attr-defined]

    @abstractmethod
    def ready(self, h: np.ndarray, n: np.ndarray, since: np.ndarray | None = None) -> Ready:
        """Return everything that depends on the steps alone."""

    @abstractmethod
    def take(self, y0: np.ndarray, ready: Ready) -> tuple[np.ndarray, int | None]:
        """Return the states after each interval and the number of evaluations."""

    def last(self, ready: Ready) -> Callable[[np.ndarray], np.ndarray]:
        """Return the function from the first state to the last."""
        return lambda y0: self.take(y0, ready)[0][-1]

    def watched(self, ready: Ready, steps: int, starts: bool) -> Watched | None:
        """Return the function from a start to all states, and whether they are sound."""
        return None

    def into(
        self, ready: Ready, steps: int, start: np.ndarray, after: np.ndarray
    ) -> Callable[[], int] | None:
        """Return `watched` on fixed memory, `after` for states after `start`; a call returns −1 if they are sound."""
        return None

    @cached_property
    def tangents(self) -> Loop:
        return loop_of(self.method, self.scene, self.carry, tangent=True)

    def tangent(
        self, y0: np.ndarray, v: np.ndarray, h: np.ndarray, n: np.ndarray, since: np.ndarray | None = None
    ) -> np.ndarray:
        if since is None and self.scene.keeps_dates:
            since = self.dates(h, n)
        return self.tangents.states(self.scene, np.concatenate([y0, v]), h, n, since)[:, len(y0) :]

    def dates(self, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        """Return the dates of intervals that follow each other from the start."""
        ends = np.cumsum(h * n)
        return dates.dates(self.scene, np.append(0.0, ends[:-1]), ends)


def interruptible(work: Callable[[], object], stop: Callable[[], None], long: bool) -> None:
    """Call `work`; if it is `long` in a thread, which an exception in this thread ends by `stop`."""
    if not long or threading.current_thread() is not threading.main_thread():
        work()
        return
    worker = threading.Thread(target=work, daemon=True)
    worker.start()
    try:
        while worker.is_alive():
            worker.join(LOOK)
    except BaseException:  # Ctrl-C, a time limit
        stop()
        worker.join()
        raise


# -- the loop over steps, recorded from a method on a scene ------------------------------------------
def program_of(
    method: Steps, scene: Scene, carry: tuple[str, ...], tangent: bool = False, beside: int = 0
) -> Program:
    """Return the recorded loop of a method on a scene; raises `CannotRecord` if one of them branches on values.

    tangent : the state is followed by a tangent vector.  beside : how many numbers of the run follow it.
    """
    d = len(scene.labels(carry))

    def interval(
        numbers: Sequence[Arithmetic],
        h: Arithmetic,
        n: Count,
        y: Sequence[Arithmetic],
        xp: Namespace,
        repeat: Repeat,
        *clock: Arithmetic,
    ) -> list[Arithmetic]:
        if tangent:
            y, xp = list(map(Dual, y[:d], y[d:])), DualNumbers(xp)  # type: ignore[arg-type]
        twin, given = scene.with_numbers(numbers), y[d:] if beside else ()
        x, after = advanced(method, twin, scene.unpack(y[:d], carry), h, n, xp, clock, repeat, given)
        end = scene.pack(x)
        if beside:
            return [*end, *after]
        return [*map(value, end), *map(slope, end)] if tangent else end

    watch = None if tangent else watch_of(scene, carry)
    size = d * (1 + tangent) + beside
    clock = scene.clock if scene.keeps_dates else None
    return record(interval, len(scene.numbers()), size, scene.motion, DIVERGENCE, watch, clock)


def watch_of(scene: Scene, carry: tuple[str, ...]) -> Watch:
    """Return the tests of the states of a run, of numbers that begin with the scene's own."""
    d, given = len(scene.labels(carry)), len(scene.numbers())

    def slope_at(numbers: Sequence[Arithmetic], y: Sequence[Arithmetic]) -> list[Arithmetic]:
        twin = scene.with_numbers(numbers[:given])
        return twin.pack(twin.rhs(twin.unpack(y[:d], carry)))

    def energy_at(numbers: Sequence[Arithmetic], y: Sequence[Arithmetic]) -> tuple[Arithmetic, Arithmetic]:
        twin = scene.with_numbers(numbers[:given])
        x = twin.unpack(y[:d], carry)
        return twin.energy(x), twin.energy_terms(x)

    return Watch(slope_at, energy_at if scene.bounds_energy else None)


def advanced(
    method: Steps,
    scene: Scene,
    x: AnyState,
    h: Arithmetic,
    n: Count,
    xp: Namespace,
    clock: Sequence[Arithmetic],
    repeat: Repeat = plain,
    beside: Sequence[Arithmetic] = (),
    bounded: bool = True,
) -> tuple[OwnState, Sequence[Arithmetic]]:
    """Return the state after n steps, and the numbers beside it; clock : an origin and a row of `dates`.

    bounded : whether times stay on one side of the breaks.
    """
    origin, *since = clock or (0.0,)
    if since:
        scene, x = dates.begin(scene, x, xp, origin, since, bounded)
    if beside:
        x, beside = method.advance_beside(scene, x, h, n, xp, repeat, beside)  # type: ignore[attr-defined]
    else:
        x = method.advance(scene, x, h, n, xp, repeat)
    return dates.end(x, origin, since[0]) if since else x, beside


@cache
def is_fixed(method: Hashable) -> bool:
    """Return whether a step map belongs to this package, so that it never changes."""
    return is_ours(type(method)) and is_ours(getattr(method, "step", type(method)))


def identity(method: Steps, scene: Scene, carry: tuple[str, ...]) -> Hashable | None:
    """Return a key for everything a compiled loop depends on but the numbers; None if that is not known."""
    if (own := scene.identity) is None:
        return None
    if is_fixed(method):
        return method, own, carry
    try:
        program = program_of(method, scene, carry)
    except CannotRecord:
        return None
    recorded = program.setup.digest, program.run.digest, program.data.tobytes(), program.shape.tobytes()
    return *recorded, own, carry


class Loop:
    def __init__(self, program: Program, seconds: float) -> None:
        self.program = program
        #: seconds of recording and compiling
        self.seconds = seconds
        self._rows: Cache[tuple[np.ndarray, ...]] = Cache(KEPT)
        self._calls: Cache[Callable[[np.ndarray], Any]] = Cache(2 * KEPT)

    def compiled(self, function: Function, **options: bool) -> Native:
        elapsed = stopwatch()
        made = compile_function(function, **options)
        self.seconds += elapsed()
        return made

    @cached_property
    def run(self) -> Native:
        return self.compiled(self.program.run)

    @cached_property
    def setup(self) -> Native:
        return self.compiled(self.program.setup, fused=False)

    @cached_property
    def setup_in_python(self) -> Callable[..., None]:
        made: Callable[..., None] = execute(self.program.setup)
        return made

    @cached_property
    def size(self) -> int:
        return sum(1 for _ in lines(self.program.run.body))

    def is_long(self, steps: float) -> bool:
        return steps * self.size > LONG

    @cached_property
    def short(self) -> int:
        """Return the most steps that are not long."""
        return int(LONG / self.size)

    def execute(self, y0: np.ndarray, rows: Sequence[np.ndarray], after: np.ndarray, steps: float) -> None:
        """Call `run`, which another thread ends early by setting the first entry of the shape."""
        w, shape, *times = rows
        shape = shape.copy()
        stop = lambda: shape.__setitem__(0, 1)  # noqa: E731
        interruptible(lambda: self.run(y0, w, shape, *times, after), stop, self.is_long(steps))

    def rows(
        self, numbers: np.ndarray, h: np.ndarray, n: np.ndarray, since: np.ndarray | None = None
    ) -> tuple[np.ndarray, ...]:
        """Return the arguments of `run` for intervals: a row for each distinct (h, n), a shape, and the dates."""
        given = numbers.tobytes(), h.tobytes(), n.tobytes(), b"" if since is None else since.tobytes()
        if (known := self._rows.items.get(given)) is not None:
            return known
        row_of: dict[tuple[float, int], int] = {}
        which = [row_of.setdefault(span, len(row_of)) for span in zip(h.tolist(), n.tolist(), strict=True)]
        w = self.table(numbers, np.array(list(row_of), dtype=float))
        rows = w, np.concatenate([self.program.shape, which]), *(() if since is None else (since,))
        return self._rows.get(given if w.size + len(n) <= FEW else None, lambda: rows)

    def on(
        self, d: int, rows: tuple[np.ndarray, ...], part: tuple[int, int], flagged: bool = False
    ) -> Callable[[np.ndarray], Any]:
        """Return `run` as a function of a start of d doubles (see `Native.bind`), cached by its rows."""
        w, shape, *_ = rows
        given = id(w), part, flagged  # the cached call keeps w alive, so that its id is unique
        if (known := self._calls.items.get(given)) is not None:
            return known
        size = (len(shape) - len(self.program.shape)) * self.program.size
        call = self.run.bind(d, rows, size, slice(*part), flagged)
        return self._calls.get(given if w.size + size <= FEW else None, lambda: call)

    def table(self, numbers: np.ndarray, spans: np.ndarray) -> np.ndarray:
        """Return the rows of several (h, n); Python computes a few rows if `setup` is not compiled yet."""
        program = self.program
        if "setup" not in vars(self) and len(spans) * program.width <= FEW:
            rows = [[0.0] * program.width for _ in spans]
            with suppress(*NO_NUMBER):  # perhaps in an unused branch
                given = (numbers, spans, program.data, program.shape)
                self.setup_in_python(*(part.tolist() for part in given), rows)
                return np.array(rows, dtype=float)
        w = np.empty((len(spans), program.width))
        self.setup(numbers, spans, program.data, program.shape, w)
        return w

    def after(
        self, start: np.ndarray, *given: np.ndarray, since: np.ndarray | None = None, python: bool = False
    ) -> np.ndarray:
        """Return the rows after intervals, (k, size), from a row, not only from a state; given : as of `rows`."""
        numbers, h, n = given
        rows, after = self.rows(numbers, h, n, since), np.empty(len(n) * len(start))
        if python:
            found = [0.0] * len(after)
            self.run_in_python(start.tolist(), *(part.tolist() for part in rows), found)
            after[:] = found
        else:
            self.execute(start, rows, after, total(n))
        return after.reshape(-1, len(start))

    @cached_property
    def run_in_python(self) -> Callable[..., None]:
        made: Callable[..., None] = execute(self.program.run)
        return made

    def states(
        self, scene: Scene, y0: np.ndarray, h: np.ndarray, n: np.ndarray, since: np.ndarray | None = None
    ) -> np.ndarray:
        """Return packed states after each interval, (k, d)."""
        y, numbers = np.empty((len(n), len(y0))), np.array(scene.numbers())
        together = max(1, AHEAD // self.program.width)
        for first in range(0, len(n), together):
            part = slice(first, first + together)
            rows = self.rows(numbers, h[part], n[part], None if since is None else since[part])
            self.execute(y0, rows, y[part].reshape(-1), total(n[part]))  # a view
            y0 = dates.from_origin(scene, y[part][-1], y0)
        return y


_loops: Cache[Loop] = Cache(1024)


def loop_of(
    method: Steps, scene: Scene, carry: tuple[str, ...], tangent: bool = False, beside: int = 0
) -> Loop:
    """Return the recorded loop of a method on a scene, cached by their identity; raises `CannotRecord`."""

    def make() -> Loop:
        elapsed = stopwatch()
        program = program_of(method, scene, carry, tangent, beside)
        return Loop(program, elapsed())

    return _loops.get(key(identity(method, scene, carry), tangent, beside), make)


# -- by LLVM -----------------------------------------------------------------------------------------
class Recorded(StepLoop[Rows]):
    """Run the recorded loop, compiled by LLVM."""

    derivative = "forward-mode AD through the numerical map"

    def __init__(self, method: Steps, request: Request) -> None:
        super().__init__(method, request)
        self.numbers = np.array(self.scene.numbers())
        self.loop = loop_of(method, self.scene, self.carry, beside=self.beside)
        self.loop.run  # noqa: B018, compiled now
        if request.step is None:  # every call chooses the step: `setup` runs often
            self.loop.setup  # noqa: B018

    def ready(self, h: np.ndarray, n: np.ndarray, since: np.ndarray | None = None) -> Rows:
        """Return the steps, and the arguments of the loop unless they are too many."""
        if since is None and self.scene.keeps_dates:
            since = self.dates(h, n)
        few = len(n) * self.loop.program.width <= AHEAD
        rows = self.loop.rows(self.numbers, h, n, since) if few else None
        self.seconds = self.loop.seconds
        return h, n, since, rows

    def take(self, y0: np.ndarray, ready: Rows) -> tuple[np.ndarray, int | None]:
        h, n, since, rows = ready
        start = np.append(y0, np.zeros(self.beside)) if self.beside else y0
        if rows is None:
            y = self.loop.states(self.scene, start, h, n, since)
        else:
            y = np.empty((len(n), len(start)))
            self.loop.execute(start, rows, y.reshape(-1), total(n))
        return spent(y, self.beside)

    def last(self, ready: Rows) -> Callable[[np.ndarray], np.ndarray]:
        _, n, _, rows = ready
        if rows is None or self.beside:
            return super().last(ready)
        d = self.loop.program.size
        return self.loop.on(d, rows, (len(n) * d, len(n) * d + d))

    def into(self, ready: Rows, steps: int, start: np.ndarray, after: np.ndarray) -> Callable[[], int] | None:
        rows = ready[3]
        if rows is None or self.watched(ready, steps, False) is None:
            return None
        return self.loop.run.closed(start, *rows, after)

    def watched(self, ready: Rows, steps: int, starts: bool) -> Watched | None:
        _, n, _, rows = ready
        if rows is None or self.beside or not self.loop.program.watched or self.loop.is_long(steps):
            return None
        d, saves = self.loop.program.size, len(n) + starts
        run = self.loop.on(d, rows, (0 if starts else d, len(n) * d + d), flagged=True)

        def watched(y0: np.ndarray) -> tuple[np.ndarray, bool]:
            y, bad = run(y0)
            return y.reshape(saves, d), bad < 0

        return watched


def spent(y: np.ndarray, beside: int) -> tuple[np.ndarray, int | None]:
    """Return the states without the numbers beside them, and the first of these: the evaluations of the run."""
    if not beside:
        return y, None
    d = y.shape[1] - beside
    made = y[-1, d]
    return y[:, :d], int(made) if math.isfinite(made) else None


# -- by Python ---------------------------------------------------------------------------------------
class Plain(StepLoop[Spans]):
    """Run on Python floats: the recorded loop, or the step map itself if it cannot be recorded."""

    program: Program | None = None

    def __init__(self, method: Steps, request: Request, recorded: bool = True) -> None:
        super().__init__(method, request)
        if not recorded:
            return
        elapsed = stopwatch()
        with suppress(CannotRecord):
            program = program_of(method, self.scene, self.carry, beside=self.beside)
            self.setup, self.run = execute(program.setup), execute(program.run)
            self.program, self.seconds = program, elapsed()

    def ready(self, h: np.ndarray, n: np.ndarray, since: np.ndarray | None = None) -> Spans:
        if since is None and self.scene.keeps_dates:
            since = self.dates(h, n)
        times = [[]] * len(n) if since is None else since.tolist()
        return list(zip(h.tolist(), n.tolist(), times, strict=True))

    def take(self, y0: np.ndarray, ready: Spans) -> tuple[np.ndarray, int | None]:
        y = None
        if self.program is not None:
            with suppress(*NO_NUMBER):  # perhaps in an unused branch
                y = np.array(self.run_program(self.program, y0.tolist(), ready))
        if y is None:
            y = self.as_written(y0, ready)
        return spent(y, self.beside)

    def as_written(self, y0: np.ndarray, spans: Spans) -> np.ndarray:
        y = np.full((len(spans), len(y0) + self.beside), math.nan)
        with suppress(*NO_NUMBER), np.errstate(all="ignore"):
            for k, after in enumerate(self.states(y0, spans)):
                y[k] = after
        return y

    def run_program(self, program: Program, y: list[float], spans: Spans) -> list[list[float]]:
        numbers, data, shape = self.scene.numbers(), program.data.tolist(), program.shape.tolist()
        rows, w, last = [], [[0.0] * program.width], None
        y = [*y, *[0.0] * self.beside]
        start = y
        for *span, times in spans:
            if span != last:
                self.setup(numbers, [span], data, shape, w)
                last = span
            after = [0.0] * len(y)
            self.run(y, w, [*shape, 0], *([[times]] if times else []), after)
            rows.append(after)
            y = dates.from_origin(self.scene, after, start)
        return rows

    def states(self, y0: np.ndarray, spans: Spans) -> Iterator[Sequence[float]]:
        scene, beside = self.scene, [0.0] * self.beside  # type: Any, Any
        x, origin = scene.unpack(scene.entries(y0), self.carry), scene.split_clock(y0)[0]
        for h, n, times in spans:
            clock = (origin, *times) if times else ()
            x, beside = advanced(self.method, scene, x, h, n, math, clock, beside=beside)
            yield [*scene.pack(x), *beside]


#: engine → the loop that takes the steps
LOOPS: dict[str, type[StepLoop[Any]]] = {"llvm": Recorded, "python": Plain}


def trajectory(
    method: Steps, scene: Scene, x: AnyState, spans: Iterable[tuple[Arithmetic, Count]], xp: Namespace
) -> Iterator[OwnState]:
    """Yield the states after each (h, n) of `spans`, for any kind of numbers."""
    for h, n in spans:
        x = method.advance(scene, x, h, n, xp)
        yield x
