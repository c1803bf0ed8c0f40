"""Find the cost of an error for one method on one problem.

Settings approach the error from a coarse one along the measured slope; the cost is interpolated between the settings
around the error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from contactbench.measure.statistics import costs_to_reach
from contactbench.methods.base import Method, prepare
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.prepared import Prepared
from contactbench.peers.heyoka import SHARED
from contactbench.questions.regret import WORST
from contactbench.runs.experiment import Row
from contactbench.runs.features import Features
from contactbench.runs.search import Attempt, Question, cheapest
from contactbench.runs.settings import carry_of
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.scene.scales import errors
from contactbench.solution import Solution, Status, keywords
from contactbench.truth import Reference

#: the only tolerances of methods that compile anew for every tolerance
RUNGS = {SHARED.name: (1e-3, 1e-5, 1e-8, 1e-11, 2.3e-16)}
#: ends of the runs whose largest error counts, relative to the span
ENDS = (0.5, 1.0)
#: most additions of a run, additions of an evaluation beside its own, and most settings tried for one error
LONGEST, BESIDE, TRIES = 3e7, 20.0, 5
#: typical evaluations per adaptive step of one-step methods and of methods of variable order, and the additions per
#: evaluation that the latter spend on themselves
TYPICAL, VARIABLE, OWN_WORK = 12.0, 2.0, 300.0
#: the error aimed at, in parts of that asked for; near enough to it; and settings between which is interpolated
AIM, NEAR, APART = 0.5, 8.0, 1.6
#: largest ratio of successive steps; of tolerances its square
LEAP = 24.0
#: the coarsest step in 1/ω for each evaluation it takes, and the loosest tolerance to begin with
FIRST_STEP, FIRST_TOLERANCE = 0.25, 1e-4
#: errors asked for are at least this multiple of the difference between two solvers for the truth
CLEAR = 10.0


def agreed(scene: Scene, carry: tuple[str, ...], one: Solution, other: Solution) -> Reference:
    """Return the states of one run as the truth, with the number of digits on which another run agrees."""
    gap = float(errors(scene, other.y, one.y, one.y0, carry).max())
    digits = max(0, math.floor(-math.log10(max(gap, 1e-16))))
    return Reference(scene, carry, np.asarray(one.elapsed), one.y, [], digits, "two solvers")


@dataclass
class Trial:
    """Try settings of one method on one problem."""

    question: Question
    method: Method
    known: Features
    #: evaluations that a run may make
    limit: float = math.inf
    tried: list[Attempt] = field(default_factory=list)

    def attempt(self, value: float, control: str = "") -> Attempt:
        scene, carry = self.question.scene, carry_of(self.question.scene)
        beside = OWN_WORK if self.stages == VARIABLE else BESIDE
        most = min(self.limit, LONGEST / (self.known.cost + beside))
        given = keywords(control or self.method.control, value)
        given |= {"max_steps": max(100, int(most / self.stages)), "carry": carry}
        runs, solutions, seconds = list[Prepared](), list[Solution](), math.inf
        for part in reversed(ENDS):  # where the whole run ends badly no other is made
            runs.append(prepare(scene, self.method, save_at=Elapsed([part * scene.t_end]), **given))
            begun = perf_counter()
            solutions.append(runs[-1]())
            seconds = min(seconds, (perf_counter() - begun) / part)
            if not solutions[-1].ok:
                break
        last = solutions[0] if solutions[-1].ok else solutions[-1]
        error = self.question.error(solutions[::-1]) if last.ok else math.nan
        ended = last.status, last.message, seconds, error, last.counts, runs[0]
        self.tried.append(Attempt(value, runs[0].request.setting, *ended))
        return self.tried[-1]

    @property
    def stages(self) -> float:
        """Return the evaluations of a step, about."""
        each = self.method.per_step(self.question.scene) if isinstance(self.method, FixedStep) else 0
        return float(each or (TYPICAL if self.method.order else VARIABLE))

    # -- the next setting ------------------------------------------------------------------------------
    def allowed(self, value: float) -> float:
        if self.method.name in RUNGS:
            return min(RUNGS[self.method.name], key=lambda rung: abs(math.log(rung / value)))
        if self.method.adaptive:
            low, high = self.method.rtol_range
            return float(f"{min(max(value, low), high):.3g}")
        end = self.question.scene.t_end  # a step ends at both ends
        return end / (2 * max(1, round(end / value / 2)))

    def first(self) -> float:
        if self.method.adaptive:
            return self.allowed(FIRST_TOLERANCE)
        return self.allowed(FIRST_STEP * self.stages / self.known.omega)

    def next(self, target: float) -> float:
        """Return the setting at which the slope of the error reaches a little less than the target."""
        good = [one for one in self.tried if one.ok and one.error > 0]
        if not good:
            return self.allowed(min(one.value for one in self.tried) / 4)
        off = lambda one: abs(math.log(one.error / target))  # noqa: E731
        near, *others = sorted(good, key=off)
        slope = order = 1.0 if self.method.adaptive else float(self.method.order or 1)
        for other in others[:1]:
            if other.value != near.value and other.error != near.error:
                found = math.log(other.error / near.error) / math.log(other.value / near.value)
                slope = min(max(found, order / 2), 1.5 * order)
        leap = LEAP**2 if self.method.adaptive else LEAP
        ratio = min(max((AIM * target / near.error) ** (1 / slope), 1 / leap), leap)
        value = near.value * ratio
        bad = [one.value for one in self.tried if not one.ok and one.value > near.value]
        return self.allowed(math.sqrt(near.value * min(bad)) if bad and value >= min(bad) else value)

    def finer(self, value: float) -> float:
        """Return the next setting below one."""
        if self.method.name in RUNGS:
            return max((rung for rung in RUNGS[self.method.name] if rung < value), default=value)
        return self.allowed(value / 2)

    def enclosed(self, target: float) -> bool:
        good = [one for one in self.tried if one.ok]
        reach = [one for one in good if one.error <= target]
        if any(one.error >= target / NEAR for one in reach):
            return True
        miss = [one for one in good if one.error > target]
        fewest = min((one.evaluations for one in reach), default=math.nan)
        return bool(miss) and fewest <= APART * max(one.evaluations for one in miss)

    def search(self, targets: Sequence[float], least: dict[float, float]) -> None:
        """Try settings for each error; least : fewest evaluations of any method so far by error, updated here."""
        if self.method.exact:
            self.attempt(0.0)
            return
        last = self.attempt(self.first())
        for target in targets:
            self.limit = WORST * least.get(target, math.inf)
            for _ in range(TRIES):
                if last.status is Status.unsupported or self.enclosed(target):
                    break
                value, known = self.next(target), [one.value for one in self.tried]
                if value in known and self.best(target) is None:
                    value = self.finer(min(known))
                if value in known:
                    break
                last = self.attempt(value)
                if last.status is Status.budget and value < min(one.value for one in self.tried[:-1]):
                    return
            if (best := self.best(target)) is not None:
                least[target] = min(least.get(target, math.inf), best.evaluations)

    # -- what came out -----------------------------------------------------------------------------------
    def best(self, target: float) -> Attempt | None:
        return cheapest(self.tried, target)

    def rows(self, targets: Sequence[float], seconds: dict[int, float]) -> Iterator[Row]:
        good = [one for one in self.tried if one.ok]
        errors = [max(one.error, 1e-300) for one in good]
        costs = costs_to_reach(errors, [one.evaluations for one in good], targets)
        for target, cost in zip(targets, costs, strict=True):
            best, finest = self.best(target), min(self.tried, key=lambda one: one.value)
            row: Row = {"error": target}
            if best is None or math.isnan(cost):
                ended = finest.status is not Status.ok
                why = str(finest.status) if ended else "unreached"
                yield row | {"status": why, "note": finest.message or "no setting tried is as accurate"}
                continue
            share = cost / best.evaluations if best.evaluations else 1.0
            row |= {"status": "ok", "reached": best.error, "evaluations": cost}
            yield row | {"time_s": seconds.get(id(best), math.nan) * share}
