"""Runs of fixed-step methods: what the engines share, and the plainest of them, Python floats."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from contactbench.methods.outcome import Outcome
from contactbench.methods.prepared import Prepared
from contactbench.methods.request import UNCOUNTED, steps_in
from contactbench.methods.step_map import StepMap
from contactbench.solution import Counts, Status

#: relative differences of steps that are round-off of the saved times
EQUAL = 1e-9


@dataclass
class FixedStepRun(Prepared):
    """What the engines share: the division of the run into intervals of equal steps."""

    method_: StepMap

    def __post_init__(self) -> None:
        super().__post_init__()
        r = self.request
        self.marks = np.diff(self.later, prepend=0.0)
        self.first_step = self.method_.counts(r.scene, 1, r.carry)
        self.each_step = self.method_.per_step(r.scene, r.carry)
        self.kind = self.method_.kind_on(r.scene)
        self.divide(r.step or math.nan)  # a fixed-step request always has one

    def divide(self, step: float) -> None:
        """Divide every interval into the fewest equal steps not longer than `step`."""
        self.n = self.division(step)
        self.h = self.marks / self.n
        self.steps_taken = step, float(self.h.max())
        self.totals, self.needed = self.cost(self.n), total(self.n)

    def divides_often(self) -> None:
        """Called before runs that divide at every call: prepares what makes dividing fast."""

    def cost(self, n: np.ndarray) -> Counts:
        """Counts of intervals of n[k] steps; every interval starts afresh."""
        steps = total(n)
        evaluations = len(n) * self.first_step + (steps - len(n)) * self.each_step
        return Counts(steps, evaluations, 0, 0, self.kind)

    def steps_at(self, step: float) -> int:
        """How many steps a division by `step` makes."""
        return total(self.division(step))

    def division(self, step: float) -> np.ndarray:
        """Steps in each interval when divided by `step`."""
        spans = zip(self.marks.tolist(), self.later.tolist(), strict=True)
        return np.array([steps_in(span, step, until) for span, until in spans], dtype=np.int64)

    @abstractmethod
    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        """Packed states after each interval of n[k] steps of size h[k]; shape (k, d)."""

    def log_factor(self, y0: np.ndarray, y: np.ndarray) -> np.ndarray | None:
        """As in `Prepared`: the flows are applied once more, in plain floats, from every saved state."""
        r = self.request
        starts = y[:-1] if self.saves_start else np.concatenate([y0[None], y[:-1]])
        logs = [
            self.method_.log_factor(r.scene, r.scene.unpack(start, r.carry), h, n)
            for start, h, n in zip(starts.tolist(), self.h.tolist(), self.n.tolist(), strict=True)
        ]
        known = [log for log in logs if log is not None]
        if len(known) < len(logs):
            return None
        return np.cumsum([0.0, *known] if self.saves_start else known)

    def modified_hamiltonian(self, x: Any) -> Any | None:
        """As in `Prepared`; other steps are the flow of another H̃, so that they are all to be of one size."""
        if np.ptp(self.h) > EQUAL * self.h[0]:
            return None
        return self.method_.modified_hamiltonian(self.request.scene, x, float(self.h[0]))

    def integrate(self, y0: np.ndarray) -> Outcome:
        r = self.request
        if self.needed > r.max_steps:
            nothing = np.empty((0, len(y0)))
            needed = str(self.needed) if self.needed < UNCOUNTED else f"more than {UNCOUNTED:.0e}"
            message = f"{needed} steps needed, max_steps = {r.max_steps}"
            return self.finish(y0, nothing, Counts(), Status.budget, message)
        y = self.intervals(y0, self.h, self.n)
        out = self.finish(y0, self.from_start(y0, y), self.totals)
        return out if out.status is not Status.diverged else self._locate(y0, out)

    def _locate(self, y0: np.ndarray, out: Outcome) -> Outcome:
        """A divergence pinned down to the step, by bisecting the interval in which it happened."""
        r = self.request
        k = int(np.argmax(np.isnan(out.y).all(axis=1)))  # the first saved time not reached
        i = k - 1 if self.saves_start else k
        good, time = (out.y[k - 1], float(r.save_at[k - 1])) if k else (y0, 0.0)
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


class Division(FixedStepRun):
    """The steps alone, for ensembles, which take them in ways of their own: nothing is recorded or compiled."""

    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        raise NotImplementedError


def total(n: np.ndarray) -> int:
    """Σ n[k], which may be more than an int64 holds: then about."""
    return int(n.sum(dtype=float))
