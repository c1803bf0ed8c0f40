"""Loops over steps: from a packed state to those after intervals of equal steps, compiled by numba or by Python."""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterator
from contextlib import suppress
from functools import cache, cached_property
from typing import Any

import numpy as np

from contactbench.blame import is_ours
from contactbench.methods.prepared import NO_NUMBER, Request, stopwatch
from contactbench.numbers.dual import Dual, DualNumbers, slope, value
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import Cache, Scene, key
from contactbench.solution import DIVERGENCE
from contactbench.trace.compiled import compile_function
from contactbench.trace.form import execute, lines
from contactbench.trace.program import Program, Watch, record

#: numbers that are computed ahead of a run at most, for intervals that all differ in their steps
AHEAD = 2**22
#: as many numbers take Python milliseconds, and `setup` takes a tenth of a second to compile
FEW = 2**13
#: steps times statements that take more than about a hundredth of a second, and seconds between two looks at signals
LONG, LOOK = 3e7, 0.1
#: divisions into steps whose rows a loop keeps, where they are few
KEPT = 32


def total(n: np.ndarray) -> int:
    """Σ n[k], which may be more than an int64 holds: then about."""
    return int(n.sum(dtype=float))


class StepLoop(ABC):
    """Take the steps of a method on a scene, by one engine.

    1. ``ready(h, n)`` is all that depends on the steps alone, intervals of n[k] of size h[k].
    2. ``take(y0, ready)`` returns the packed states after each interval, (k, d), and the evaluations made, None where
       they are known beforehand.  No call leaves a trace.
    3. ``last(ready)`` is the function that gives the last of these states alone, by the fastest way there is.
    4. ``tangent(y0, v, h, n)`` is the derivative of the states along v.

    Parameters
    ----------
    method
        A `FixedStep`.
    request
        The scene, what is carried, the setting and the saved times.
    """

    #: how `tangent` differentiates
    derivative = "forward-mode AD through the same steps, compiled"

    def __init__(self, method: Any, request: Request) -> None:
        self.method, self.scene, self.carry = method, request.scene, request.carry
        self.numbers = np.array(request.scene.numbers())

    #: spent on recording and compiling
    seconds: Any = 0.0

    @abstractmethod
    def ready(self, h: np.ndarray, n: np.ndarray) -> Any:
        """Return what depends on the steps alone."""

    @abstractmethod
    def take(self, y0: np.ndarray, ready: Any) -> tuple[np.ndarray, int | None]:
        """Return the states after each interval and the evaluations made."""

    def last(self, ready: Any) -> Callable[[np.ndarray], np.ndarray]:
        """Return the function from the first state to the last."""
        return lambda y0: self.take(y0, ready)[0][-1]

    def vouched(
        self, ready: Any, steps: int, starts: bool
    ) -> Callable[[np.ndarray], np.ndarray | None] | None:
        """Return the function that gives all states, after the first one if it `starts`, or None for what is wrong.

        None where the loop does not see all that can be wrong, or the steps take long.
        """
        return None

    def divides_often(self) -> None:  # noqa: B027
        """Prepare what makes `ready` fast."""

    def record_tangent(self) -> None:
        """Record what differentiates now: a user's map may be another when its derivative is asked for."""
        with suppress(CannotRecord):
            self.tangents  # noqa: B018

    @cached_property
    def tangents(self) -> Loop:
        return loop_of(self.method, self.scene, self.carry, tangent=True)

    def tangent(self, y0: np.ndarray, v: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        return self.tangents.states(self.numbers, np.concatenate([y0, v]), h, n)[:, len(y0) :]


# -- the loop over steps, recorded from a method on a scene ------------------------------------------
def program_of(
    method: Any, scene: Scene, carry: tuple[str, ...], tangent: bool = False, counted: bool = False
) -> Program:
    """Return the recorded loop of a method on a scene; raises `CannotRecord` where one of them branches on values.

    tangent : a tangent vector follows the state and is carried along.  counted : by the evaluations spent so far.
    """
    d = len(scene.labels(carry))

    def advance(numbers: Any, h: Any, n: Any, y: Any, xp: Any, repeat: Any) -> list[Any]:
        if tangent:
            y, xp = list(map(Dual, y[:d], y[d:])), DualNumbers(xp)
        start, twin = scene.unpack(y[:d], carry), scene.with_numbers(numbers)
        if counted:
            x, spent = method.advance_counted(twin, start, h, n, xp, repeat)
            return [*scene.pack(x), y[d] + spent]
        end = scene.pack(method.advance(twin, start, h, n, xp, repeat))
        return [*map(value, end), *map(slope, end)] if tangent else end

    def twin_at(numbers: Any, y: Any) -> tuple[Any, Any]:
        twin = scene.with_numbers(numbers)
        return twin, twin.unpack(y[:d], carry)

    def slope_at(numbers: Any, y: Any) -> list[Any]:
        twin, x = twin_at(numbers, y)
        return twin.pack(twin.rhs(x))

    def energy_at(numbers: Any, y: Any) -> tuple[Any, Any]:
        twin, x = twin_at(numbers, y)
        return twin.energy(x), twin.energy_terms(x)

    watch = None if tangent else Watch(slope_at, energy_at if scene.bounds_energy else None)
    return record(advance, len(scene.numbers()), d * (1 + tangent) + counted, scene.motion, DIVERGENCE, watch)


@cache
def is_fixed(method: Any) -> bool:
    """Return whether a step map is one of this package, which computes the same tomorrow."""
    return is_ours(type(method)) and is_ours(getattr(method, "step", type(method)))


def identity(method: Any, scene: Scene, carry: tuple[str, ...]) -> Hashable | None:
    """What a compiled loop depends on besides the numbers, by recording a user's map; None where nobody can tell."""
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
        #: spent on recording and compiling
        self.seconds = seconds
        self._rows: Cache[tuple[np.ndarray, np.ndarray]] = Cache(KEPT)

    @cached_property
    def run(self) -> Any:
        elapsed = stopwatch()
        run = compile_function(self.program.run)
        self.seconds += elapsed()
        return run

    @cached_property
    def setup(self) -> Any:
        elapsed = stopwatch()
        setup = compile_function(self.program.setup, fused=False)
        self.seconds += elapsed()
        return setup

    @cached_property
    def setup_in_python(self) -> Any:
        return execute(self.program.setup)

    @cached_property
    def size(self) -> int:
        return sum(1 for _ in lines(self.program.run.body))

    def is_long(self, steps: int) -> bool:
        return steps * self.size > LONG

    def execute(self, y0: np.ndarray, w: np.ndarray, shape: np.ndarray, after: np.ndarray, steps: int) -> int:
        """Call `run`; where that takes long in a thread of its own, which ends with what comes over this one."""
        if threading.current_thread() is not threading.main_thread() or not self.is_long(steps):
            return int(self.run(y0, w, shape, after))
        found: list[int] = []
        shape = shape.copy()
        worker = threading.Thread(target=lambda: found.append(self.run(y0, w, shape, after)), daemon=True)
        worker.start()
        try:
            while worker.is_alive():
                worker.join(LOOK)
        except BaseException:  # Ctrl-C, a time limit
            shape[0] = 1
            worker.join()
            raise
        return found[0]

    def rows(self, numbers: np.ndarray, h: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what depends on the steps only, a row for each (h, n) among the intervals; and the program's shape."""
        given = numbers.tobytes(), h.tobytes(), n.tobytes()
        if (known := self._rows.items.get(given)) is not None:
            return known
        row_of: dict[tuple[float, int], int] = {}
        which = [row_of.setdefault(span, len(row_of)) for span in zip(h.tolist(), n.tolist(), strict=True)]
        w = self.table(numbers, np.array(list(row_of), dtype=float))
        rows = w, np.concatenate([self.program.shape, which])
        return self._rows.get(given if w.size + len(n) <= FEW else None, lambda: rows)

    def table(self, numbers: np.ndarray, spans: np.ndarray) -> np.ndarray:
        """Return the rows of several (h, n): by Python where they are few, `setup` is not compiled, and it can."""
        program = self.program
        if "setup" not in vars(self) and len(spans) * program.width <= FEW:
            rows = [[0.0] * program.width for _ in spans]
            with suppress(*NO_NUMBER):  # maybe in a branch that is not taken
                given = (numbers, spans, program.data, program.shape)
                self.setup_in_python(*(part.tolist() for part in given), rows)
                return np.array(rows, dtype=float)
        w = np.empty((len(spans), program.width))
        self.setup(numbers, spans, program.data, program.shape, w)
        return w

    def states(self, numbers: np.ndarray, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        y = np.empty((len(n), len(y0)))
        together = max(1, AHEAD // self.program.width)
        for first in range(0, len(n), together):
            part = slice(first, first + together)
            w, shape = self.rows(numbers, h[part], n[part])
            self.execute(y0, w, shape, y[part].reshape(-1), total(n[part]))  # a view
            y0 = y[part][-1]
        return y


_loops: Cache[Loop] = Cache(1024)


def loop_of(
    method: Any, scene: Scene, carry: tuple[str, ...], tangent: bool = False, counted: bool = False
) -> Loop:
    """Return the recorded loop of a method on a scene; one for all scenes of one identity.  Raises `CannotRecord`."""

    def make() -> Loop:
        elapsed = stopwatch()
        program = program_of(method, scene, carry, tangent, counted)
        return Loop(program, elapsed())

    return _loops.get(key(identity(method, scene, carry), tangent, counted), make)


# -- by numba ----------------------------------------------------------------------------------------
class Recorded(StepLoop):
    """By the recorded loop, compiled."""

    derivative = "forward-mode AD through the numerical map"

    def __init__(self, method: Any, request: Request) -> None:
        super().__init__(method, request)
        self.counted = method.iterates
        self.loop = loop_of(method, self.scene, self.carry, counted=self.counted)
        self.loop.run  # noqa: B018, compiled now

    @property
    def seconds(self) -> float:  # type: ignore[override]
        return self.loop.seconds

    def divides_often(self) -> None:
        self.loop.setup  # noqa: B018, compiled now

    def ready(self, h: np.ndarray, n: np.ndarray) -> Any:
        """Return the arguments of the loop, or the steps where there are too many to be kept."""
        few = len(n) * self.loop.program.width <= AHEAD
        return (h, n, self.loop.rows(self.numbers, h, n) if few else None)

    def take(self, y0: np.ndarray, ready: Any) -> tuple[np.ndarray, int | None]:
        h, n, rows = ready
        start = np.append(y0, 0.0) if self.counted else y0
        if rows is None:
            y = self.loop.states(self.numbers, start, h, n)
        else:
            after = np.empty(len(n) * len(start))
            w, shape = rows
            self.loop.execute(start, w, shape, after, total(n))
            y = after.reshape(len(n), -1)
        return spent(y) if self.counted else (y, None)

    def last(self, ready: Any) -> Callable[[np.ndarray], np.ndarray]:
        _, n, rows = ready
        if rows is None or self.counted:
            return super().last(ready)
        run, empty, k = self.loop.run, np.empty, len(n)
        w, shape = rows

        def last(y0: np.ndarray) -> np.ndarray:
            d = len(y0)
            after = empty(k * d)
            run(y0, w, shape, after)
            return after if k == 1 else after[-d:]

        return last

    def vouched(
        self, ready: Any, steps: int, starts: bool
    ) -> Callable[[np.ndarray], np.ndarray | None] | None:
        _, n, rows = ready
        if rows is None or self.counted or not self.loop.program.watched or self.loop.is_long(steps):
            return None
        run, empty, saves = self.loop.run, np.empty, len(n) + starts
        w, shape = rows

        def vouched(y0: np.ndarray) -> np.ndarray | None:
            d = len(y0)
            after = y = empty(saves * d)
            if starts:
                y[:d], after = y0, y[d:]
            return None if run(y0, w, shape, after) >= 0 else y.reshape(saves, d)

        return vouched


def spent(y: np.ndarray) -> tuple[np.ndarray, int | None]:
    """Take the evaluations, the last number of each state, from the states."""
    made = y[-1, -1]
    return y[:, :-1], int(made) if math.isfinite(made) else None


# -- by Python ---------------------------------------------------------------------------------------
class Plain(StepLoop):
    """Plain Python floats: the loop numba compiles, or where it cannot be recorded the step map, ten times as slow."""

    program: Program | None = None

    def __init__(self, method: Any, request: Request, recorded: bool = True) -> None:
        super().__init__(method, request)
        self.counted = method.iterates
        if not recorded:
            return
        elapsed = stopwatch()
        with suppress(CannotRecord):
            program = program_of(method, self.scene, self.carry, counted=self.counted)
            self.setup, self.run = execute(program.setup), execute(program.run)
            self.program, self.seconds = program, elapsed()

    def ready(self, h: np.ndarray, n: np.ndarray) -> list[tuple[float, int]]:
        return list(zip(h.tolist(), n.tolist(), strict=True))

    def take(self, y0: np.ndarray, ready: Any) -> tuple[np.ndarray, int | None]:
        start = [*y0.tolist(), 0.0] if self.counted else y0.tolist()
        y = None
        if self.program is not None:
            with suppress(*NO_NUMBER):  # maybe in a branch that is not taken
                y = np.array(self.run_program(self.program, start, ready))
        if y is None:
            y = np.array(self.as_written(start, ready), dtype=float)
        return spent(y) if self.counted else (y, None)

    def run_program(
        self, program: Program, y: list[float], spans: list[tuple[float, int]]
    ) -> list[list[float]]:
        numbers, data, shape = self.scene.numbers(), program.data.tolist(), program.shape.tolist()
        rows, w, last = [], [[0.0] * program.width], None
        for span in spans:
            if span != last:
                self.setup(numbers, [span], data, shape, w)
                last = span
            after = [0.0] * len(y)
            self.run(y, w, [*shape, 0], after)
            rows.append(y := after)
        return rows

    def as_written(self, y: list[float], spans: list[tuple[float, int]]) -> list[list[float]]:
        rows: list[list[float]] = []
        with suppress(*NO_NUMBER):
            rows.extend(self.states(y, spans))
        return rows + [[math.nan] * len(y)] * (len(spans) - len(rows))

    def states(self, y: list[float], spans: list[tuple[float, int]]) -> Iterator[list[float]]:
        d = len(y) - self.counted
        x, made = self.scene.unpack(y[:d], self.carry), y[d:]
        for h, n in spans:
            if self.counted:
                x, more = self.method.advance_counted(self.scene, x, h, n, math)
                made = [made[0] + more]
            else:
                x = self.method.advance(self.scene, x, h, n, math)
            yield [*self.scene.pack(x), *made]


def trajectory(method: Any, scene: Any, x: Any, spans: Any, xp: Any) -> Iterator[Any]:
    """Return the states after each (h, n) of `spans`, on whatever numbers scene, x and xp are made of."""
    for h, n in spans:
        x = method.advance(scene, x, h, n, xp)
        yield x
