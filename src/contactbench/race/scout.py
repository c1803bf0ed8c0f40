"""What accuracy a method reaches at which setting: its ladder from coarse to fine, then the gaps.

Nothing is timed here.  The error of a setting is the largest over five end times, each the end of a run of
its own: interpolation between steps, of lower order than some methods, plays no part in it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from contactbench.boundary import UserError
from contactbench.measure.ladder import ENDS, carry_of, tolerances, work_ladder
from contactbench.measure.laws import observables
from contactbench.methods.base import ENGINES, METHODS
from contactbench.methods.entry import prepare
from contactbench.methods.prepared import Prepared, Refused
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import Scene
from contactbench.solution import Counts, Solution, Status, keywords
from contactbench.truth import Reference

#: bisections between the first setting that is accurate enough and the one before it
BISECTIONS = 4
#: steps of a method's first run at most, where nobody knows yet how long a step takes; and of any run at least
FIRST_STEPS, FEWEST_STEPS = {"compiled": 200_000, "callbacks": 5_000}, 1000
#: half the step must give less than this part of the error, or it is round-off that is left
STILL_BETTER = 0.7
#: tolerances down to this are tried whatever they bring; it is above what round-off leaves of short runs
CERTAIN = 1e-12
#: how much coarser a tolerance is at least whose error is compared: most of a decade
APART = 5.0
#: what a single run may take, as a share of the whole budget
RUN_SHARE = 0.006
#: what a compiler or a library that is not there raises
BROKEN = (CannotRecord, ImportError, OSError, RuntimeError)


@dataclass(frozen=True)
class Question:
    """What is asked of every method: a scene, its truth at five times, the errors, and the time there is."""

    scene: Scene
    truth: Reference
    errors: tuple[float, ...]
    budget: float

    @property
    def floor(self) -> float:
        """What the reference itself may be off by, relative to the largest state: no error below is claimed."""
        return max(10.0**-self.truth.digits, float(np.finfo(float).eps))

    def error(self, solutions: Sequence[Solution]) -> float:
        """Return max ‖y − y*‖₂ / max ‖y*‖₂ over the ends of several runs."""
        scene, carry = self.scene, carry_of(self.scene)
        labels = self.truth.scene.labels(self.truth.carry)
        exact = self.truth.y[:, [labels.index(name) for name in scene.labels(carry)]]
        exact = observables(scene, exact, carry)
        numerical = observables(scene, np.array([solution.y[-1] for solution in solutions]), carry)
        size = np.linalg.norm(exact, axis=1).max()
        return float(np.linalg.norm(numerical - exact, axis=1).max() / size)


def ends(scene: Scene) -> np.ndarray:
    """Return the five times."""
    return scene.t_end * np.arange(1, ENDS + 1) / ENDS


@dataclass(frozen=True)
class Attempt:
    """One setting of a method: how it ended, its error and counts, and the solver, ready to be timed."""

    value: float
    setting: str
    status: Status
    message: str
    seconds: float
    error: float = math.nan
    counts: Counts = field(default_factory=Counts)
    run: Prepared | None = None

    @property
    def ok(self) -> bool:
        return self.status is Status.ok

    @property
    def work(self) -> float:
        """Evaluations on the scale of a right-hand side; seconds where the solver does not count."""
        work = self.counts.rhs_equivalents
        return self.seconds if work is None else work


class Unsupported(Exception):
    """A method cannot do a scene, as is found out only when it is prepared."""


class Scout:
    """One method on its way from its coarsest setting to the one that reaches the smallest error.

    attempts : every setting tried.  why : a status and a reason where no setting could be tried, or no finer one.
    compile_s : seconds until its first run has ended.  spent : seconds it has had since.
    """

    def __init__(self, question: Question, method: str) -> None:
        self.question, self.method = question, METHODS[method]
        self.engine = self.method.engines[0]
        self.attempts: list[Attempt] = []
        self.why: tuple[str, str] | None = None
        self.compile_s = self.spent = 0.0
        #: seconds a step takes
        self.a_step = math.nan

    @property
    def kind(self) -> str:
        """compiled or callbacks: times are compared within a kind."""
        return ENGINES.get(self.engine, "compiled")

    @property
    def finest(self) -> Attempt | None:
        return min(self.attempts, key=lambda a: a.value, default=None)

    def best(self, error: float) -> Attempt | None:
        """Return the cheapest attempt that is as accurate."""
        return min(
            (a for a in self.attempts if a.ok and a.error <= error), key=lambda a: a.work, default=None
        )

    def turns(self) -> Iterator[None]:
        """Try settings until the smallest error is reached or the range ends, one a turn."""
        try:
            for attempt in self.ladder():
                yield
                if attempt.ok and attempt.error <= min(self.question.errors):
                    break
                if attempt.status is Status.budget:
                    most = f"more than a run may take here, {self.longest:.2g} s"
                    self.why = ("budget", f"{attempt.setting}: {attempt.message}, {most}")
                    break
            for error in self.question.errors:
                yield from self.refine(error)
        except Unsupported as reason:
            self.why = ("unsupported", str(reason))
        except UserError as error:
            self.why = ("failed", str(error))
        except BROKEN as error:
            self.why = ("failed", f"{type(error).__name__}: {' '.join(str(error).split())[:200]}")

    def ladder(self) -> Iterator[Attempt]:
        """Try the settings of the benchmark, and smaller steps than those as long as they bring something."""
        if self.method.exact:  # nothing to be set
            yield self.attempt(0.0)
            return
        adaptive = self.method.adaptive
        values = (
            tolerances(self.method) if adaptive else work_ladder(self.question.scene, self.method.order or 1)
        )
        for value in values:
            if adaptive and value < CERTAIN and self.stagnates():
                return
            yield self.attempt(value)
        while not adaptive and not self.stagnates():  # a low order needs small steps
            yield self.attempt(self.attempts[-1].value / 2)

    def stagnates(self) -> bool:
        """Return whether the last setting was hardly more accurate than one before: what is left is round-off."""
        *others, last = self.attempts
        apart = APART if self.method.adaptive else 1.0
        before = next((a for a in reversed(others) if a.value >= apart * last.value), others[-1])
        return before.ok and last.ok and not last.error < STILL_BETTER * before.error

    @property
    def longest(self) -> float:
        """Seconds that a run may take."""
        return RUN_SHARE * self.question.budget

    def most_steps(self) -> int:
        """Return how many steps a run may take; always the same of JAX, which compiles for each number anew."""
        if self.engine == "jax" or not self.a_step > 0:
            return FIRST_STEPS[self.kind]
        return max(FEWEST_STEPS, int(self.longest / self.a_step))

    def attempt(self, value: float) -> Attempt:
        """Make five runs at one setting, the longest first."""
        scene, name, first = self.question.scene, self.method.name, not self.attempts
        options: dict[str, Any] = {**keywords(self.method.control, value), "carry": carry_of(scene)}
        *earlier, end = ends(scene).tolist()
        start = perf_counter()
        run = prepare(scene, name, save_at=[end], max_steps=self.most_steps(), **options)
        if isinstance(run, Refused):
            raise Unsupported(run.why)
        self.engine = run.request.engine
        if first:
            run()  # the first call of a program may compile yet
            self.compile_s = perf_counter() - start
        start = perf_counter()
        solution = run()
        seconds = perf_counter() - start
        if solution.counts.steps:
            self.a_step = seconds / solution.counts.steps
        error, worst = math.nan, solution
        if solution.ok:
            options |= {"max_steps": run.request.max_steps, "engine": self.engine}
            runs = [prepare(scene, name, save_at=[t], **options)() for t in earlier] + [solution]
            worst = next((each for each in runs if not each.ok), solution)
            error = self.question.error(runs) if worst.ok else math.nan
        counts, printed = solution.counts, run.request.setting
        self.attempts.append(
            Attempt(value, printed, worst.status, worst.message, seconds, error, counts, run)
        )
        return self.attempts[-1]

    def refine(self, error: float) -> Iterator[None]:
        """Bisect between the coarsest setting that is accurate enough and its coarser neighbour."""
        for _ in range(BISECTIONS):
            tried = sorted(self.attempts, key=lambda a: -a.value)
            fine = next((i for i, a in enumerate(tried) if a.ok and a.error <= error), None)
            if not fine:  # none is, or the coarsest of all
                return
            value = self.between(tried[fine - 1].value, tried[fine].value)
            if value is None:
                return
            self.attempt(value)
            yield

    def between(self, coarse: float, fine: float) -> float | None:
        """Return the setting half-way in the logarithm, None where there is no room; a step divides the intervals
        between the five times."""
        middle = math.sqrt(coarse * fine)
        if self.method.adaptive:
            return float(f"{middle:.3g}") if fine < middle < coarse else None
        end = self.question.scene.t_end
        low, n, high = (round(end / h / ENDS) for h in (coarse, middle, fine))
        return end / (ENDS * n) if low < n < high else None
