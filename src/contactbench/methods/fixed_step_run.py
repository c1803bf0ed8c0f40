"""Runs of fixed-step methods: the division into steps, and the loop over them, by numba or by Python."""

from __future__ import annotations

import math
import threading
from abc import abstractmethod
from collections.abc import Callable, Hashable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, ClassVar

import numpy as np

from contactbench.errors import is_ours
from contactbench.methods.prepared import NO_NUMBER, Outcome, Prepared, stopwatch
from contactbench.methods.prescribed import EQUAL, GRID_ULPS, plateaus
from contactbench.numbers.dual import Dual, DualNumbers, slope, value
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import Cache, Scene, key
from contactbench.solution import DIVERGENCE, Counts, Solution, Status
from contactbench.trace.compiled import compile_function
from contactbench.trace.form import execute, lines
from contactbench.trace.program import Program, Watch, record

#: more steps than any budget allows are counted as this many
UNCOUNTED = 2**50
#: numbers that are computed ahead of a run at most, for intervals that all differ in their steps
AHEAD = 2**22
#: as many numbers take Python milliseconds, and `setup` takes a tenth of a second to compile
FEW = 2**13
#: steps times statements that take more than about a hundredth of a second, and seconds between two looks at signals
LONG, LOOK = 3e7, 0.1
#: divisions into steps whose rows a loop keeps, where they are few
KEPT = 32


@np.errstate(over="ignore")
def steps_in(span: Any, until: Any, step: float) -> Any:
    """The fewest equal steps ≤ `step` that cover each span, but for round-off of the time `until` at which it ends."""
    ratio = (span * (1 - 1e-12) - GRID_ULPS * np.spacing(until)) / step
    return np.minimum(np.maximum(np.ceil(ratio), 1), UNCOUNTED).astype(np.int64)


# -- the loop over steps, recorded from a method on a scene ------------------------------------------
def program_of(
    method: Any, scene: Scene, carry: tuple[str, ...], tangent: bool = False, counted: bool = False
) -> Program:
    """The recorded loop of a method on a scene; raises `CannotRecord` where one of them branches on values.

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
    """Whether a step map is one of this package, which computes the same tomorrow."""
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
        """What depends on the steps only, a row for each (h, n) among the intervals; and the program's shape."""
        given = numbers.tobytes(), h.tobytes(), n.tobytes()
        if (known := self._rows.items.get(given)) is not None:
            return known
        row_of: dict[tuple[float, int], int] = {}
        which = [row_of.setdefault(span, len(row_of)) for span in zip(h.tolist(), n.tolist(), strict=True)]
        w = self.table(numbers, np.array(list(row_of), dtype=float))
        rows = w, np.concatenate([self.program.shape, which])
        return self._rows.get(given if w.size + len(n) <= FEW else None, lambda: rows)

    def table(self, numbers: np.ndarray, spans: np.ndarray) -> np.ndarray:
        """The rows of several (h, n): by Python where they are few, `setup` is not compiled, and it can."""
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
    """The recorded loop of a method on a scene; one for all scenes of one identity.  Raises `CannotRecord`."""

    def make() -> Loop:
        elapsed = stopwatch()
        program = program_of(method, scene, carry, tangent, counted)
        return Loop(program, elapsed())

    return _loops.get(key(identity(method, scene, carry), tangent, counted), make)


# -- runs --------------------------------------------------------------------------------------------
@dataclass
class FixedStepRun(Prepared):
    """What the engines share, the division into intervals of equal steps; they write `intervals`, and maybe `bare`."""

    #: a `FixedStep`
    method_: Any

    sensitivity_source = "forward-mode AD through the same steps, compiled"
    #: whether the loop carries the evaluations spent so far, as a last number
    counted: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        r = self.request
        self.numbers = np.array(r.scene.numbers())
        breaks = [time for time, _ in self.breaks if 0 < time < self._end]
        #: where intervals of equal steps end, at least
        self.ends = np.union1d(self.later, breaks) if breaks else self.later
        self.marks = np.diff(self.ends, prepend=0.0)
        self.first_step = self.method_.counts(r.scene, 1, r.carry)
        self.each_step = self.method_.per_step(r.scene, r.carry)
        self.kind = self.method_.kind_on(r.scene)
        if not is_fixed(self.method_):  # a user's map may be another when its derivative is asked for
            with suppress(CannotRecord):
                self.tangent_loop  # noqa: B018
        self.divide(r.step or math.nan)  # a fixed-step request always has one

    def divide(self, step: float) -> None:
        #: which intervals of equal steps end at saved times: all of them, but of prescribed steps
        self.saved: Any = slice(None)
        if self.request.steps is not None:
            self.h, self.n, self.saved = plateaus(self.request.steps, self.ends)
        else:
            self.n = self.division(step)
            self.h = self.marks / self.n
        if self.breaks:
            self.bridge()
        self.steps_taken = step, float(self.h.max())
        self.totals, self.needed = self.cost(self.n), total(self.n)

    def bridge(self) -> None:
        """Make a step of its own of the few roundings around every break, so that others end this side of it.

        The sums of steps that are a run's own time are as exact as so many roundings.
        """
        reached = np.arange(len(self.n))[self.saved]
        self.saved = reached[np.searchsorted(self.ends, self.later)]
        ends = np.append(0.0, np.cumsum(self.h * self.n))
        for time, exact in reversed(self.breaks):
            k = int(np.argmin(np.abs(ends - time)))
            around = slice(max(k - 1, 0), k + 1)
            margins = exact * np.maximum(self.n[around], 1)
            self.h[around] -= margins / self.n[around]
            self.h, self.n = np.insert(self.h, k, margins.sum()), np.insert(self.n, k, 1)
            self.saved[self.saved >= k - 1 + (k == 0)] += 1

    @property
    def until(self) -> np.ndarray:
        """The saved time at which each interval ends, nan where none is."""
        times = np.full(len(self.n), math.nan)
        times[self.saved] = self.later
        return times

    def divides_often(self) -> None:
        """Called before runs that divide at every call: prepares what makes dividing fast."""

    def cost(self, n: np.ndarray) -> Counts:
        """Counts of intervals of n[k] steps; every interval starts afresh."""
        steps = total(n)
        evaluations = len(n) * self.first_step + (steps - len(n)) * self.each_step
        return Counts(steps, evaluations, 0, 0, self.kind)

    def division(self, step: float) -> np.ndarray:
        return steps_in(self.marks, self.ends, step)

    @abstractmethod
    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        """Packed states after each interval of n[k] steps of size h[k]; shape (k, d)."""

    def take(self, y0: np.ndarray) -> tuple[np.ndarray, Counts]:
        """Take the steps of this division: packed states after each of its intervals, and the counts."""
        return self.intervals(y0, self.h, self.n), self.totals

    def integrate(self, y0: np.ndarray) -> Outcome:
        r = self.request
        if self.needed > r.max_steps:
            needed = str(self.needed) if self.needed < UNCOUNTED else f"more than {UNCOUNTED:.0e}"
            message = f"{needed} steps needed, max_steps = {r.max_steps}"
            return self.finish(y0, np.empty((0, len(y0))), Counts(), Status.budget, message)
        y, counts = self.take(y0)
        return self.judge(y0, y[self.saved], counts)

    def judge(self, y0: np.ndarray, y: np.ndarray, counts: Counts) -> Outcome:
        out = self.finish(y0, self.from_start(y0, y), counts)
        return out if out.status is not Status.diverged else self._locate(y0, out)

    def _locate(self, y0: np.ndarray, out: Outcome) -> Outcome:
        """A divergence pinned down to the step, by bisecting the interval in which it happened."""
        r = self.request
        k = int(np.argmax(np.isnan(out.y).all(axis=1)))  # the first saved time not reached
        good, time = (out.y[k - 1], float(r.save_at[k - 1])) if k else (y0, 0.0)
        ends = np.append(0, np.arange(1, len(self.n) + 1)[self.saved])
        i, end = ends[k - int(self.saves_start) :][:2]
        if i + 1 < end:  # several intervals lead there
            y = self.intervals(good, np.roll(self.h, -i), np.roll(self.n, -i))[: end - i]
            reached = self.first_divergence(y0, y)
            assert reached is not None
            good = y[reached - 1] if reached else good
            time += float(self.h[i : i + reached] @ self.n[i : i + reached])
            i += reached
        h, left = self.h[i], int(self.n[i])
        taken = 0  # of the interval
        while left > 1:
            half = np.ones_like(self.n)  # the compiled loop has a fixed number of intervals
            half[0] = left // 2
            y = self.intervals(good, np.full(len(half), h), half)[:1]
            if self.first_divergence(y0, y) is None:
                good, time = y[0], time + float(half[0] * h)
                taken, left = taken + int(half[0]), left - int(half[0])
            else:
                left = int(half[0])
        end = time + float(h)
        counts = self.cost(np.append(self.n[:i], taken + 1))
        message = f"left the scene's scale by a factor 1e6 at t = {end:.6g}"
        return Outcome(out.y, counts, Status.diverged, message, end)

    # -- the map ---------------------------------------------------------------------------------------
    @cached_property
    def tangent_loop(self) -> Loop:
        return loop_of(self.method_, self.request.scene, self.request.carry, tangent=True)

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        tangents = self.tangents(y0)
        starts = [np.concatenate([y0, v]) for v in tangents]
        states = [self.tangent_loop.states(self.numbers, start, self.h, self.n) for start in starts]
        columns = np.stack(states, axis=-1)[self.saved, len(y0) :]
        return self.from_start(np.array(tangents).T, columns)

    def log_factor(self, y0: np.ndarray, y: np.ndarray) -> np.ndarray | None:
        """As in `Prepared`: the flows are applied once more, in plain floats, from where each interval starts."""
        r = self.request
        y = y[1:] if self.saves_start else y
        if len(self.n) > len(self.later):
            y = self.intervals(y0, self.h, self.n)
        starts = np.concatenate([y0[None], y[:-1]])
        logs = [
            self.method_.log_factor(r.scene, r.scene.unpack(start, r.carry), h, n)
            for start, h, n in zip(starts.tolist(), self.h.tolist(), self.n.tolist(), strict=True)
        ]
        known = [log for log in logs if log is not None]
        if len(known) < len(logs):
            return None
        return np.append([0.0] if self.saves_start else [], np.cumsum(known)[self.saved])

    def modified_hamiltonian(self, x: Any) -> Any | None:
        """As in `Prepared`; other steps are the flow of another H̃, so that they are all to be of one size."""
        if np.ptp(self.h) > EQUAL * self.h[0]:
            return None
        return self.method_.modified_hamiltonian(self.request.scene, x, float(self.h[0]))


def total(n: np.ndarray) -> int:
    """Σ n[k], which may be more than an int64 holds: then about."""
    return int(n.sum(dtype=float))


class Division(FixedStepRun):
    """The steps alone, for ensembles, which take them in ways of their own: nothing is recorded or compiled."""

    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        raise NotImplementedError


def last_state(
    run: Callable[..., int], w: np.ndarray, shape: np.ndarray, d: int, size: int
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function of the initial state that gives the last one; a closure is called a tenth faster."""
    empty = np.empty

    def last(y0: np.ndarray) -> np.ndarray:
        after = empty(size)
        run(y0, w, shape, after)
        return after if size == d else after[-d:]

    return last


class NumbaLoop(FixedStepRun):
    sensitivity_source = "forward-mode AD through the numerical map"

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return self.intervals(y0, self.h, self.n)[-1]

    def __post_init__(self) -> None:
        r = self.request
        self.loop = loop_of(self.method_, r.scene, r.carry, counted=self.counted)
        self.run = self.loop.run
        self.compile_s = self.loop.seconds
        super().__post_init__()
        self.shorten()

    def divide(self, step: float) -> None:
        super().divide(step)
        self.size = len(self.n) * (len(self.start) + self.counted)
        #: arguments of the loop that depend on the steps only, unless there are too many to be kept
        self.ahead = None
        if len(self.n) * self.loop.program.width <= AHEAD:
            self.ahead = self.loop.rows(self.numbers, self.h, self.n)

    def shorten(self) -> None:
        """Make of the calls for these steps, where nothing else is to be done, closures of all they need."""
        if self.ahead is None or self.counted:
            return
        self.bare = last_state(self.run, *self.ahead, len(self.start), self.size)  # type: ignore
        affordable = self.needed <= self.request.max_steps and not self.loop.is_long(self.needed)
        if isinstance(self.saved, slice) and self.loop.program.watched and affordable:
            self.at_once = self.watched(*self.ahead)  # type: ignore

    def divides_often(self) -> None:
        self.loop.setup  # noqa: B018, compiled now
        self.compile_s = self.loop.seconds

    def watched(self, w: np.ndarray, shape: np.ndarray) -> Callable[[np.ndarray], Solution | None]:
        """Return `at_once` of one call of the loop, which gives all saved states and sees what is wrong with them."""
        run, empty, of, date = self.run, np.empty, Solution.of, self._dated
        ended = self.attributes(Status.ok, "", self.totals, self._end, self.steps_taken)
        saves, d, starts, dated = self._saves, len(self.start), self.saves_start, self._clock is not None
        size = saves * d

        def at_once(y0: np.ndarray) -> Solution | None:
            after = y = empty(size)
            if starts:
                y[:d], after = y0, y[d:]
            if run(y0, w, shape, after) >= 0:
                return None
            states = y.reshape(saves, d)
            return of(ended, date(y0, states) if dated else states, y0)

        return at_once

    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        if n is not self.n or self.ahead is None:
            return self.loop.states(self.numbers, y0, h, n)
        after = np.empty(self.size)
        self.loop.execute(y0, *self.ahead, after, self.needed)
        return after.reshape(len(n), -1)


class PythonLoop(FixedStepRun):
    """Plain Python floats: the loop numba compiles, or where it cannot be recorded the step map, ten times as slow."""

    program: Program | None = None

    def __post_init__(self) -> None:
        self.record()
        super().__post_init__()

    def record(self) -> None:
        elapsed = stopwatch()
        with suppress(CannotRecord):
            r = self.request
            program = program_of(self.method_, r.scene, r.carry, counted=self.counted)
            self.setup, self.run = execute(program.setup), execute(program.run)
            self.program, self.compile_s = program, elapsed()

    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        spans = list(zip(h.tolist(), n.tolist(), strict=True))
        if self.program is not None:
            with suppress(*NO_NUMBER):  # maybe in a branch that is not taken
                return np.array(self.run_program(self.program, y0.tolist(), spans))
        return np.array(self.as_written(y0.tolist(), spans), dtype=float)

    def run_program(
        self, program: Program, y: list[float], spans: list[tuple[float, int]]
    ) -> list[list[float]]:
        numbers, data, shape = self.request.scene.numbers(), program.data.tolist(), program.shape.tolist()
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
        scene, carry = self.request.scene, self.request.carry
        for x in trajectory(self.method_, scene, scene.unpack(y, carry), spans, math):
            yield scene.pack(x)


# -- methods that iterate ----------------------------------------------------------------------------
class Counted(FixedStepRun):
    """Runs of a method whose evaluations are known only when they have been made."""

    counted = True

    def cost(self, n: np.ndarray) -> Counts:
        return super().cost(n)._replace(evaluations=None)

    def take(self, y0: np.ndarray) -> tuple[np.ndarray, Counts]:
        y = self.carried(y0, self.h, self.n)
        spent = y[-1, -1]
        return y[:, :-1], self.totals._replace(evaluations=int(spent) if math.isfinite(spent) else None)

    def carried(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        """Return what `intervals` does, and the evaluations spent so far; shape (k, d + 1)."""
        return super().intervals(np.append(y0, 0.0), h, n)  # type: ignore[safe-super]

    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        return self.carried(y0, h, n)[:, :-1]

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return self.intervals(y0, self.h, self.n)[-1]

    def integrate(self, y0: np.ndarray) -> Outcome:
        return FixedStepRun.integrate(self, y0)


class CountedNumbaLoop(Counted, NumbaLoop):
    """By the compiled loop."""


class CountedPythonLoop(Counted, PythonLoop):
    def states(self, y: list[float], spans: list[tuple[float, int]]) -> Iterator[list[float]]:
        scene, spent = self.request.scene, y[-1]
        x = scene.unpack(y[:-1], self.request.carry)
        for h, n in spans:
            x, more = self.method_.advance_counted(scene, x, h, n, math)
            yield [*scene.pack(x), spent := spent + more]


def trajectory(method: Any, scene: Any, x: Any, spans: Any, xp: Any) -> Iterator[Any]:
    """States after each (h, n) of `spans`, on whatever numbers scene, x and xp are made of."""
    for h, n in spans:
        x = method.advance(scene, x, h, n, xp)
        yield x
