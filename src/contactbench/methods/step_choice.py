"""A fixed step chosen from a tolerance: pilots at halving steps, then one run at the step they imply.

The step is the same throughout a run, so that a contact method keeps everything it keeps.  Two pilots
h and h/2 over the same saved times give the error of the finer one, gap/(2^p − 1) (Richardson); once
two successive gaps fall as the order says, e(h) = C h^p is trusted to give the step.

Saved times shorten steps, so that pilots of different steps may be one and the same run.  It is taken once: the run
at the step chosen, too, may have been one of the pilots.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.loops import StepLoop
from contactbench.methods.prepared import Outcome, Prepared
from contactbench.solution import Status

#: error aimed at, as a part of the tolerance
AIM = 0.4
#: first pilot: this many steps over the whole span, or between breaks
FIRST = 4
#: of methods without an exact flow of damping, damping times the first step at most
DAMPED = 8.0
#: gaps larger than this are not asymptotic
TRUSTED_GAP = 0.05
#: how far the observed order may be from the method's
LEEWAY = 0.5
#: a gap of this size is round-off
ROUND_OFF = 1e-13
#: the last pilot's step is at most this many times the chosen one
REACH = 6.0


class Pilot(NamedTuple):
    """A run: its steps, their size, the least step asked for that makes them, evaluations; states, the start first."""

    steps: int
    size: float
    asked: float
    evaluations: int
    y: np.ndarray


@dataclass
class ChosenStep(Prepared):
    """A fixed-step method run to a tolerance on max ‖y − y*‖ / max ‖y*‖; its pilots are part of every call."""

    #: the state decides on a whole number of steps, which a small change of it leaves as it is
    steps_follow_state = False

    #: a `FixedStep`
    method_: Any
    loop: StepLoop[Any] | None

    def __post_init__(self) -> None:
        super().__post_init__()
        # between two breaks lies something that steps as long as their distance do not see
        times = [0.0, *(time for time, _ in self.breaks if 0 < time < self._end), self._end]
        self.first = min(float(np.diff(times).min()) / FIRST, self.method_.longest)
        rate = self.request.scene.conformal_rate
        if not self.method_.contact and isinstance(rate, float) and rate:
            # over steps much longer than the damping takes all of such pilots agree, on nothing that is left
            self.first = min(self.first, DAMPED / abs(rate))
        # or a `ToleranceRun` of a method that follows the motion, which is asked the same
        self.run: FixedStepRun = self.method_.run_of(replace(self.request, step=self.first), self.loop)
        self.compile_s = self.run.compile_s
        self.alone = Lock()  # one run to divide: calls from several threads take turns
        self.sensitivity_source = self.run.sensitivity_source
        #: what the parts of the motion are measured in
        self.units = self.scales(self.start)[: self._motion]

    def integrate(self, y0: np.ndarray) -> Outcome:
        with self.alone:
            step, pilots = self.choose(y0)
            self.run.divide(step)
            evaluations = sum(pilot.evaluations for pilot in pilots)
            known = [pilot.y[1:] for pilot in pilots if pilot.steps == self.run.needed]
            if known:
                out = self.run.outcome(y0, known[0], self.run.totals)
            else:
                out = self.run.integrate(y0)
                evaluations += out.counts.evaluations or 0
            message = out.message
            if out.status is Status.budget:
                message = f"{message} (step {step:.3g} for rtol = {self.request.rtol:g})"
            counts = out.counts._replace(evaluations=evaluations)
            return replace(out, counts=counts, message=message, steps=self.run.steps_taken)

    def linearised(self, y0: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self.run.divide(self.choose(y0)[0])
        return self.run.linearised(y0, y)

    def log_factor(self, y0: np.ndarray, y: np.ndarray) -> np.ndarray | None:
        self.run.divide(self.choose(y0)[0])
        return self.run.log_factor(y0, y)

    def choose(self, y0: np.ndarray) -> tuple[float, list[Pilot]]:
        r, order = self.request, self.method_.order
        assert r.rtol is not None
        target, step, gap, finer = AIM * r.rtol, self.first, math.inf, 2.0
        pilots: list[Pilot] = []
        while (steps := self.run.steps_at(y0, step)) <= r.max_steps:
            before = pilots[-1] if pilots else None
            if before is not None and before.steps == steps:  # one step between saved times: the same pilot
                pilots[-1] = before._replace(asked=step)
                step /= 2
                continue
            pilots.append(self.pilot(y0, step))
            if before is not None:
                # saved times shorten steps: a pilot may have less than twice as many as the one before
                coarser, finer = finer, steps / before.steps
                wider, gap = gap, self.distance(before, pilots[-1])
                if gap < ROUND_OFF:  # exact, or as good as it gets; the run is one that was taken
                    finest = pilots[-1]
                    return next(p.asked for p in pilots if self.distance(p, finest) <= target), pilots
                rate = math.log(wider / gap) / math.log(coarser) if math.isfinite(wider + gap) else 0.0
                settled = gap < TRUSTED_GAP and rate > order - LEEWAY
                # an order seen to be higher, as the next term of the error makes it, counts in part
                error = gap / (finer ** min(max(rate, order), order + LEEWAY) - 1)
                if settled and error <= target:
                    return self.between(y0, pilots, error, target), pilots
                ahead = (target / error) ** (1 / order)
                if settled and rate < order + LEEWAY and ahead > 1 / REACH:
                    return pilots[-1].size * ahead, pilots
            step /= 2
        return step, pilots  # will end as `budget`

    def pilot(self, y0: np.ndarray, step: float) -> Pilot:
        run = self.run
        run.divide(step)
        y, counts = run.take(y0)
        steps, saved = counts.steps or 1, np.vstack([y0, y[run.saved]])
        return Pilot(steps, run.size_at(step, steps), step, counts.evaluations or 0, saved)

    def between(self, y0: np.ndarray, pilots: list[Pilot], error: float, target: float) -> float:
        """The step between two pilots at which the error, measured against the finest, is the target.

        It becomes a pilot too.  Where steps are so long that errors do not fall evenly its own may be beyond the
        tolerance, and the finer of the two pilots is taken.
        """
        finest = finer = pilots[-1]
        for pilot in reversed(pilots[:-1]):
            larger = self.distance(pilot, finest)
            if not larger <= target:
                if not math.isfinite(larger):
                    break
                shorter = math.log(target / error) / math.log(larger / error)
                step = float(max(finer.asked, finer.size * (pilot.size / finer.size) ** shorter))
                if self.run.steps_at(y0, step) == finer.steps:
                    return step
                pilots.append(self.pilot(y0, step))
                return step if self.distance(pilots[-1], finest) <= target / AIM else finer.asked
            finer, error = pilot, max(larger, error)
        return finer.asked

    def distance(self, coarse: Pilot, fine: Pilot) -> float:
        """Return max ‖coarse − fine‖ / max ‖fine‖ of (q, p) or M, the start included; infinite unless finite."""
        a, b = (pilot.y[:, : self._motion] / self.units for pilot in (coarse, fine))
        with np.errstate(all="ignore"):
            size = float(np.linalg.norm(b, axis=1).max())
            gap = float(np.linalg.norm(a - b, axis=1).max())
        if not (math.isfinite(size) and math.isfinite(gap)):
            return math.inf
        return gap / size if size > 0 else 0.0
