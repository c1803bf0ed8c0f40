"""A fixed step chosen from a tolerance: pilots at halving steps, then one run at the step they imply.

The step is the same throughout a run, so that a contact method keeps everything it keeps.  Two pilots
h and h/2 over the same saved times give the error of the finer one, gap/(2^p − 1) (Richardson); once
two successive gaps fall as the order says, e(h) = C h^p is trusted to give the step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np

from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.outcome import Outcome
from contactbench.methods.prepared import Prepared
from contactbench.methods.step_map import StepMap
from contactbench.solution import Status

#: error aimed at, as a part of the tolerance
AIM = 0.4
#: first pilot: this many steps over the whole span
FIRST = 4
#: gaps larger than this are not asymptotic
TRUSTED_GAP = 0.05
#: how far the observed order may be from the method's
LEEWAY = 0.5
#: a gap of this size is round-off
ROUND_OFF = 1e-13
#: the last pilot's step is at most this many times the chosen one
REACH = 6.0


@dataclass
class ChosenStep(Prepared):
    """A fixed-step method run to a tolerance on max ‖y − y*‖ / max ‖y*‖ over the saved times.

    The pilots are part of every call: their evaluations are in the counts and their time in the call.
    """

    #: the state decides on a whole number of steps, which a small change of it leaves as it is
    steps_follow_state = False

    method_: StepMap
    engine_run: type[FixedStepRun]

    def __post_init__(self) -> None:
        super().__post_init__()
        first = float(self.request.save_at[-1]) / FIRST
        self.run = self.engine_run(self.method, replace(self.request, step=first), self.method_)
        self.run.divides_often()
        self.compile_s = self.run.compile_s
        self.alone = Lock()  # one run to divide: calls from several threads take turns
        self.sensitivity_source = self.run.sensitivity_source

    def integrate(self, y0: np.ndarray) -> Outcome:
        with self.alone:
            return self._integrate(y0)

    def _integrate(self, y0: np.ndarray) -> Outcome:
        step, evaluations = self.choose(y0)
        self.run.divide(step)
        out = self.run.integrate(y0)
        counts = out.counts._replace(evaluations=(out.counts.evaluations or 0) + evaluations)
        message = out.message
        if out.status is Status.budget:
            message = f"{out.message} (step {step:.3g} for rtol = {self.request.rtol:g})"
        return replace(out, counts=counts, message=message, steps=self.run.steps_taken)

    def linearised(self, y0: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self.run.divide(self.choose(y0)[0])
        return self.run.linearised(y0, y)

    def log_factor(self, y0: np.ndarray, y: np.ndarray) -> np.ndarray | None:
        self.run.divide(self.choose(y0)[0])
        return self.run.log_factor(y0, y)

    def choose(self, y0: np.ndarray) -> tuple[float, int]:
        """The step for the tolerance, and the evaluations spent on finding it."""
        r, order = self.request, self.method_.order
        assert r.rtol is not None
        end = float(r.save_at[-1])
        target, step, spent, gap = AIM * r.rtol, end / FIRST, 0, math.inf
        pilots: list[tuple[float, np.ndarray, float]] = []  # the step taken, the states, the step asked for
        divided, finer = 0, 2.0
        while (steps := self.run.steps_at(step)) <= r.max_steps:
            if steps == divided:  # one step between saved times already: the same pilot, not an agreeing one
                pilots[-1] = *pilots[-1][:2], step
                step /= 2
                continue
            # saved times shorten steps: a pilot may have less than twice as many as the one before
            coarser, finer = finer, steps / divided if divided else 2.0
            taken = step if math.isclose(steps * step, end) else end / steps
            divided = steps
            y, cost = self.pilot(y0, step)
            pilots.append((taken, y, step))
            spent += cost
            if len(pilots) > 1:
                before, gap = gap, distance(pilots[-2][1], y)
                if gap < ROUND_OFF:  # exact, or as good as it gets
                    return step, spent
                rate = math.log(before / gap) / math.log(coarser) if math.isfinite(before) else 0.0
                settled = gap < TRUSTED_GAP and rate > order - LEEWAY
                # an order seen to be higher, as the next term of the error makes it, counts in part
                finest = gap / (finer ** min(max(rate, order), order + LEEWAY) - 1)
                if settled and finest <= target:
                    return self.between(pilots, finest, target), spent
                ahead = (target / finest) ** (1 / order)
                if settled and rate < order + LEEWAY and ahead > 1 / REACH:
                    return taken * ahead, spent
            step /= 2
        return step, spent  # will end as `budget`

    @staticmethod
    def between(pilots: list[tuple[float, np.ndarray, float]], finest: float, target: float) -> float:
        """The step between two pilots at which the error, measured against the finest, is the target."""
        (fine, last, asked), error = pilots[-1], finest
        for taken, y, step in reversed(pilots[:-1]):
            larger = distance(y, last)
            if not larger <= target:
                if not math.isfinite(larger):
                    return asked
                shorter = math.log(target / error) / math.log(larger / error)
                return max(asked, fine * (taken / fine) ** shorter)
            fine, asked, error = taken, step, max(larger, error)
        return asked

    def pilot(self, y0: np.ndarray, step: float) -> tuple[np.ndarray, int]:
        """(q, p) or M at the saved times with a step, and the evaluations it took."""
        self.run.divide(step)
        y = self.run.intervals(y0, self.run.h, self.run.n)
        return y[:, : self._motion], self.run.totals.evaluations or 0


def distance(coarse: np.ndarray, fine: np.ndarray) -> float:
    """max ‖coarse − fine‖ / max ‖fine‖ over the saved times; infinite unless both are finite."""
    size = float(np.linalg.norm(fine, axis=1).max())
    gap = float(np.linalg.norm(coarse - fine, axis=1).max())
    if not (math.isfinite(size) and math.isfinite(gap)):
        return math.inf
    return gap / size if size > 0 else 0.0
