"""A fixed step chosen from a tolerance: pilots at halving steps, then one run at the step they imply.

The step is the same throughout a run, so that a contact method keeps everything it keeps.  Two pilots
h and h/2 over the same saved times give the error of the finer one, gap/(2^p − 1) (Richardson); once
two successive gaps fall about as the order says, e(h) = C h^p is trusted to give the step.  Where the finer pilot
is good enough it is the run.

Saved times shorten steps, so that pilots of different steps may be one and the same run.  It is taken once, and the
run at the step chosen is one of the pilots.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from contactbench.methods.base import METHODS, prepare
from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.loops import StepLoop
from contactbench.methods.prepared import Outcome, Prepared
from contactbench.methods.prescribed import Elapsed
from contactbench.scene.scales import gaps, sizes_of
from contactbench.solution import Status

#: error aimed at, as a part of the tolerance
AIM = 0.4
#: first pilot: this many steps over the whole span, or between breaks
FIRST = 4
#: of methods without an exact flow of damping, damping times the first step at most
DAMPED = 8.0
#: gaps larger than this are not asymptotic; nor are those that follow one as large as the motion
TRUSTED_GAP, LOST = 0.05, 1.0
#: the first pilot's step is at most about a period of the motion, as the start has it: longer ones all fly off alike
PERIOD = 6.0
#: right-hand sides that the period takes, and the distance between them, relative to the motion
PROBES, BESIDE = 3, 1e-6
#: the observed order from which on gaps are trusted to fall, as a part of the method's, and how far beyond it counts
FALLING, LEEWAY = 0.6, 0.5
#: a gap of this size is round-off
ROUND_OFF = 1e-13
#: pilots in a row that leave any scale, after which a method with step control is asked whether the motion does
BLOWN, WITNESS, WITNESS_RTOL = 3, "rk8-7", 1e-8
#: and after which one is asked where they end; and the part of that time up to which two end at the same
FAILED, SAME_END = 6, 1e-3
#: the next pilot's step is at most so many times shorter; one foretold to be good enough may have such a larger error
REACH, TWICE = 6.0, 2.0


class Pilot(NamedTuple):
    """A run: its steps, their size, the least step asked for that makes them, evaluations; states, the start first."""

    steps: int
    size: float
    asked: float
    evaluations: int
    y: np.ndarray


@dataclass
class ChosenStep(Prepared):
    """A fixed-step method run to a tolerance on the error of the run; its pilots are part of every call."""

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
        #: how a motion ends that leaves any scale
        self.end: Outcome | None = None
        #: the step of a method that follows the motion is no time
        self.probes = 0 if self.method_.follows else PROBES
        self.alone = Lock()  # one run to divide: calls from several threads take turns
        self.sensitivity_source = self.run.sensitivity_source
        #: what the components of the motion are measured in
        self.units = self.scales(self.start)[: self._motion]

    def integrate(self, y0: np.ndarray) -> Outcome:
        with self.alone:
            step, pilots = self.choose(y0)
            self.run.divide(step)
            evaluations = sum(pilot.evaluations for pilot in pilots) + self.probes
            known = [pilot.y[1:] for pilot in pilots if pilot.steps == self.run.needed]
            if known:
                out = self.run.outcome(y0, known[0], self.run.totals)
            else:  # it takes too many steps
                out = self.run.integrate(y0)
                evaluations += out.counts.evaluations or 0
            message = out.message
            if out.status is Status.budget:
                message = f"{message} (step {step:.3g} for rtol = {self.request.rtol:g})"
            if self.end is not None and out.status is Status.diverged:
                message, out = self.end.message, replace(out, end_time=self.end.end_time)
            counts = out.counts._replace(evaluations=evaluations)
            return replace(out, counts=counts, message=message, steps=self.run.steps_taken)

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        self.run.divide(self.choose(y0)[0])
        return self.run.sensitivity(y0)

    @property
    def composed(self) -> bool:
        return self.run.composed

    def choose(self, y0: np.ndarray) -> tuple[float, list[Pilot]]:
        """Return the step to take and the pilots: one of them has it, unless it takes more steps than allowed."""
        r, order = self.request, self.method_.order
        assert r.rtol is not None
        enough, gap, finer = AIM * r.rtol, math.inf, 2.0
        step = min(self.first, PERIOD * self.time_scale(y0)) if self.probes else self.first
        pilots: list[Pilot] = []
        while (steps := self.run.steps_at(y0, step)) <= r.max_steps:
            before = pilots[-1] if pilots else None
            if before is not None and before.steps == steps:  # one step between saved times: the same pilot
                pilots[-1] = before._replace(asked=step)
                step /= 2
                continue
            pilots.append(self.pilot(y0, step))
            self.end = self.end_of(y0, pilots)
            if self.end is not None:
                step, others = self.until(self.end.end_time, y0, step)
                return step, pilots + others
            if self.fails(y0, pilots):
                return step, pilots
            step /= 2
            if before is None:
                continue
            # saved times shorten steps: a pilot may have less than twice as many as the one before
            coarser, finer = finer, steps / before.steps
            wider, gap = gap, self.distance(before, pilots[-1])
            if not math.isfinite(gap):  # nor are its steps, fewer maybe, those of a whole run
                continue
            gap /= 1 - finer**-order
            trusted = wider < LOST or wider == math.inf
            if gap < ROUND_OFF and trusted:  # exact, or as good as it gets
                finest = pilots[-1]
                return next(p.asked for p in pilots if self.distance(p, finest) <= enough), pilots
            falls = trusted and 0 < gap < TRUSTED_GAP and wider < math.inf
            if falls and gap <= min(enough, wider / 2):  # at any order: those to come are no more together
                return pilots[-1].asked, pilots
            rate = math.log(wider / gap) / math.log(coarser) if falls else 0.0
            if rate > FALLING * order:
                # errors do not fall evenly yet: an order seen to be lower, or higher, counts in part
                seen = min(max(rate, (rate + order) / 2), order + LEEWAY)
                error = gap / finer**seen
                if error <= enough:
                    return pilots[-1].asked, pilots
                enough = AIM * r.rtol
                ahead = (enough / error) ** (1 / min(seen, order))
                if rate < order + LEEWAY:
                    step = pilots[-1].size * max(ahead, 1 / REACH)
                    # what was to have the error aimed at may have twice as much
                    enough *= TWICE if ahead > 1 / REACH else 1.0
        return step, pilots  # will end as `budget`

    def end_of(self, y0: np.ndarray, pilots: list[Pilot]) -> Outcome | None:
        """Return how a motion ends that leaves any scale itself, as a solver with step control has it, asked once.

        Pilots say too little: into a steep wall they all fly off, at the same time.
        """
        bad = [not np.isfinite(pilot.y[-1]).all() for pilot in pilots[-BLOWN - 1 :]]
        r, witness = self.request, METHODS[WITNESS]
        if sum(bad) != BLOWN or not all(bad[-BLOWN:]) or witness.refuses(r.scene) is not None:
            return None
        run = prepare(r.scene, witness, rtol=WITNESS_RTOL, save_at=Elapsed([r.save_at[-1]]), carry=r.carry)
        out = run.integrate(y0)
        return out if out.status is Status.diverged else None

    def fails(self, y0: np.ndarray, pilots: list[Pilot]) -> bool:
        """Return whether a method cannot go on from where the motion is: many pilots end there, the last two alike."""
        if len(pilots) < FAILED or any(np.isfinite(pilot.y[-1]).all() for pilot in pilots[-FAILED:]):
            return False
        ended = []
        for pilot in pilots[-2:]:
            self.run.divide(pilot.asked)
            ended.append(self.run.integrate(y0))
        before, now = (out.end_time for out in ended)
        return all(out.status is Status.failed for out in ended) and abs(before - now) <= SAME_END * now

    def until(self, end: float, y0: np.ndarray, step: float) -> tuple[float, list[Pilot]]:
        """Return the step for what is saved before a motion ends, if anything is, and the pilots of that."""
        before = self.request.save_at[self.request.save_at < end]
        if not len(before) or not before[-1] > 0:
            return step, []
        run = self.method_.prepare(replace(self.request, save_at=before))
        found, pilots = run.choose(y0)
        return min(found, step), [pilot._replace(steps=0) for pilot in pilots]

    def time_scale(self, y0: np.ndarray) -> float:
        """Return 1/ω of the motion at the start: ω² = ‖J²f‖/‖f‖, in any units; infinite where f is still.

        A constant damping is no part of f: what it leaves is slow, and contact steps may be longer than it takes.
        """
        scene, carry, motion = self.request.scene, self.request.carry, self._motion
        momenta = motion // 2 if hasattr(scene.unpack(scene.entries(y0), carry), "q") else 0
        damped, rate = np.zeros(len(y0)), scene.conformal_rate
        damped[momenta:motion] = rate if isinstance(rate, float) else 0.0

        def slope(y: np.ndarray) -> np.ndarray:
            f: np.ndarray = np.array(scene.pack(scene.rhs(scene.unpack(scene.entries(y), carry))), float)
            f += damped * y
            return f

        def size(w: np.ndarray) -> float:
            return float(np.linalg.norm(w[:motion] / self.units))

        def bent(w: np.ndarray) -> np.ndarray:
            near = BESIDE * (size(y0) or 1.0) / (size(w) or 1.0)
            change: np.ndarray = slope(y0 + near * w) - first
            return change / near

        with np.errstate(all="ignore"):
            first = slope(y0)
            fast, slow = size(bent(bent(first))), size(first)
        return math.sqrt(slow / fast) if 0 < fast < math.inf and slow > 0 else math.inf

    def pilot(self, y0: np.ndarray, step: float) -> Pilot:
        run = self.run
        run.divide(step)
        y, counts = run.take(y0)
        steps, saved = counts.steps or 1, np.vstack([y0, y[run.saved]])
        return Pilot(steps, run.size_at(step, steps), step, counts.evaluations or 0, saved)

    def distance(self, coarse: Pilot, fine: Pilot) -> float:
        """Return the error of the coarse one against the fine one; infinite unless finite."""
        r = self.request
        with np.errstate(all="ignore"):
            sizes = sizes_of(r.scene, fine.y, r.carry)
            gap = float(gaps(r.scene, coarse.y, fine.y, sizes, r.carry).max())
        return gap if math.isfinite(gap) and np.isfinite(fine.y).all() else math.inf
