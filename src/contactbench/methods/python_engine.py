"""The Python engine of the fixed-step methods: plain floats."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.jax_engine import JaxSteps
from contactbench.methods.numba_engine import NumbaLoop
from contactbench.methods.step_map import trajectory
from contactbench.numbers.recording import CannotRecord


class PythonLoop(FixedStepRun):
    """Plain Python floats."""

    sensitivity_source = "forward-mode AD through the same steps, compiled"

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        try:
            return NumbaLoop(self.method, replace(self.request, engine="numba"), self.method_).sensitivity(y0)
        except CannotRecord:
            return JaxSteps(self.method, replace(self.request, engine="jax"), self.method_).sensitivity(y0)

    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        r = self.request
        x = r.scene.unpack(y0.tolist(), r.carry)
        spans = zip(h.tolist(), n.tolist(), strict=True)
        rows = []
        try:
            for state in trajectory(self.method_, r.scene, x, spans, math):
                rows.append(r.scene.pack(state))
        except (OverflowError, ZeroDivisionError, ValueError):  # Python's way to say inf or nan
            rows += [[math.nan] * len(y0)] * (len(n) - len(rows))
        return np.array(rows, dtype=float)
