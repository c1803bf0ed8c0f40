"""The numba engine of the fixed-step methods: loops recorded from the method, compiled by LLVM."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.outcome import Outcome
from contactbench.methods.prepared import stopwatch
from contactbench.methods.request import NO_NUMBER
from contactbench.methods.step_map import StepMap, identity, program_of, tangent_program
from contactbench.scene import Scene
from contactbench.scene.cache import Cache, key
from contactbench.solution import Status
from contactbench.trace.compiled import compile_function
from contactbench.trace.program import Program
from contactbench.trace.python import execute

#: numbers that are computed ahead of a run at most, for intervals that all differ in their steps
AHEAD = 2**22
#: as many numbers take Python milliseconds, and `setup` takes a tenth of a second to compile
FEW = 2**13


@dataclass
class Loop:
    """A compiled loop of steps, and how long it took to record and compile."""

    program: Program
    run: Any
    seconds: float
    #: to compile `setup`, where that was needed
    setup_seconds: float = 0.0

    @cached_property
    def setup(self) -> Any:
        """What is computed ahead of a run, compiled: the same bits as in Python, whose operations are not fused."""
        elapsed = stopwatch()
        setup = compile_function(self.program.setup, fused=False)
        self.setup_seconds = elapsed()
        return setup

    @cached_property
    def in_python(self) -> Any:
        return execute(self.program.setup)

    def rows(self, numbers: np.ndarray, h: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What depends on the steps only, a row for each (h, n) among the intervals; and the program's shape."""
        spans = np.column_stack([h, n])
        which = np.zeros(1, dtype=np.int64)
        if len(n) > 1:
            spans, which = np.unique(spans, axis=0, return_inverse=True)
        return self.table(numbers, spans), np.concatenate([self.program.shape, which])

    def table(self, numbers: np.ndarray, spans: np.ndarray) -> np.ndarray:
        """The rows of several (h, n): by Python where they are few, `setup` is not compiled, and it can."""
        program = self.program
        if "setup" not in vars(self) and len(spans) * program.width <= FEW:
            rows = [[0.0] * program.width for _ in spans]
            with suppress(*NO_NUMBER):  # maybe in a branch that is not taken
                given = (numbers, spans, program.data, program.shape)
                self.in_python(*(part.tolist() for part in given), rows)
                return np.array(rows, dtype=float)
        w = np.empty((len(spans), program.width))
        self.setup(numbers, spans, program.data, program.shape, w)
        return w


_loops: Cache[Loop] = Cache(1024)


def loop_of(method: StepMap, scene: Scene, carry: tuple[str, ...], tangent: bool = False) -> Loop:
    """The recorded loop of a method on a scene, compiled; once for all scenes of one identity."""

    def make() -> Loop:
        elapsed = stopwatch()
        return loop_from(program_of(method, scene, carry, tangent), elapsed)

    return _loops.get(key(identity(method, scene, carry), tangent), make)


def loop_from(program: Program, elapsed: Any) -> Loop:
    """A recorded loop compiled; elapsed : the stopwatch it is timed by."""
    return Loop(program, compile_function(program.run), elapsed())


class NumbaLoop(FixedStepRun):
    """The steps as one compiled loop over all intervals."""

    sensitivity_source = "forward-mode AD through the numerical map"

    def __post_init__(self) -> None:
        r = self.request
        self.loop = loop_of(self.method_, r.scene, r.carry)
        self.with_tangent = tangent_program(self.method_, r.scene, r.carry)
        self.compile_s = self.loop.seconds
        self.numbers = np.array(r.scene.numbers())
        self.run = self.loop.run
        super().__post_init__()

    def divide(self, step: float) -> None:
        super().divide(step)
        self.size = len(self.n), len(self._own_start)
        if self.short(self.n):
            self.rows, self.shape = self.loop.rows(self.numbers, self.h, self.n)

    def divides_often(self) -> None:
        self.loop.setup  # noqa: B018, compiled now
        self.compile_s = self.loop.seconds + self.loop.setup_seconds

    def short(self, n: np.ndarray) -> bool:
        """Whether what depends on the steps is computed ahead of a run."""
        return len(n) * self.loop.program.width <= AHEAD

    def bare(self, y0: np.ndarray) -> np.ndarray:
        after = np.empty(self.size)
        self.run(y0, self.rows, self.shape, after)
        return after[-1]

    def integrate(self, y0: np.ndarray) -> Outcome:
        if self.saves_start or self.needed > self.request.max_steps or not self.short(self.n):
            return super().integrate(y0)
        after = np.empty(self.size)
        if self.run(y0, self.rows, self.shape, after) < 0:  # nothing to look for
            return Outcome(after, self.totals, Status.ok, "", self._end, True)
        return super().integrate(y0)

    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        return self.states(self.loop, y0, h, n)

    def states(self, loop: Loop, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        """Packed states after each interval, by the loop of the states alone or with a tangent."""
        y = np.empty((len(n), len(y0)))
        together = max(1, AHEAD // loop.program.width)
        for first in range(0, len(n), together):
            part = slice(first, first + together)
            if loop is self.loop and n is self.n and self.short(n):
                rows, shape = self.rows, self.shape
            else:
                rows, shape = loop.rows(self.numbers, h[part], n[part])
            loop.run(y0, rows, shape, y[part])
            y0 = y[part][-1]
        return y

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        r, d, tangents = self.request, len(y0), self.tangents(y0)
        if self.with_tangent is None:
            loop = loop_of(self.method_, r.scene, r.carry, tangent=True)
        else:
            loop = loop_from(self.with_tangent, stopwatch())
        columns = [self.states(loop, np.concatenate([y0, v]), self.h, self.n)[:, d:] for v in tangents]
        derivative = np.stack(columns, axis=-1)
        if not self.saves_start:
            return derivative
        return np.concatenate([np.array(tangents).T[None], derivative])
