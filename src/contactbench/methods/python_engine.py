"""The Python engine of the fixed-step methods: plain floats."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np

from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.jax_engine import JaxLoop
from contactbench.methods.numba_engine import NumbaLoop
from contactbench.methods.prepared import stopwatch
from contactbench.methods.request import NO_NUMBER
from contactbench.methods.step_map import program_of, tangent_program, trajectory
from contactbench.numbers.protocol import CannotRecord
from contactbench.trace.program import Program
from contactbench.trace.python import execute

Span = tuple[float, int]  #: a step size, and how many steps


class PythonLoop(FixedStepRun):
    """Plain Python floats, in the loop that the numba engine compiles.

    It takes a tenth of the time of the step map as it is written, which runs where none can be recorded.
    """

    sensitivity_source = "forward-mode AD through the same steps, compiled"

    def __post_init__(self) -> None:
        elapsed = stopwatch()
        self.program: Program | None = None
        with suppress(CannotRecord):
            self.program = program_of(self.method_, self.request.scene, self.request.carry)
            self.functions = execute(self.program.setup), execute(self.program.run)
            self.compile_s = elapsed()
        self.with_tangent = tangent_program(self.method_, self.request.scene, self.request.carry)
        super().__post_init__()

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        try:
            run = NumbaLoop(self.method, replace(self.request, engine="numba"), self.method_)
            run.with_tangent = self.with_tangent
            return run.sensitivity(y0)
        except CannotRecord:
            return JaxLoop(self.method, replace(self.request, engine="jax"), self.method_).sensitivity(y0)

    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        spans = list(zip(h.tolist(), n.tolist(), strict=True))
        if self.program is not None:
            with suppress(*NO_NUMBER):  # maybe in a branch that is not taken
                return np.array(self.run_program(self.program, y0.tolist(), spans))
        return np.array(self.as_written(y0.tolist(), spans), dtype=float)

    def run_program(self, program: Program, y: list[float], spans: list[Span]) -> list[list[float]]:
        """States after each interval, by the recorded loop."""
        setup, run = self.functions
        numbers, data, shape = self.request.scene.numbers(), program.data.tolist(), program.shape.tolist()
        rows, w, last = [], [[0.0] * program.width], None
        for span in spans:
            if span != last:
                setup(numbers, [span], data, shape, w)
                last = span
            after = [[0.0] * len(y)]
            run(y, w, [*shape, 0], after)
            rows.append(y := after[0])
        return rows

    def as_written(self, y: list[float], spans: list[Span]) -> list[list[float]]:
        """The same by the step map itself; NaN from where on there are no numbers."""
        r = self.request
        rows: list[list[float]] = []
        with suppress(*NO_NUMBER):
            for state in trajectory(self.method_, r.scene, r.scene.unpack(y, r.carry), spans, math):
                rows.append(r.scene.pack(state))
        return rows + [[math.nan] * len(y)] * (len(spans) - len(rows))
