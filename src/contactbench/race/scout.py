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
from contactbench.measure.ladder import ENDS, carried, setting, tolerances, work_ladder
from contactbench.measure.laws import observed
from contactbench.methods.base import METHODS, Prepared, Refused
from contactbench.methods.engines import ENGINES
from contactbench.methods.entry import prepare
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import Scene
from contactbench.solution import Counts, Solution, Status
from contactbench.truth import Reference

#: bisections between the first setting that is accurate enough and the one before it
BISECTIONS = 4
#: steps of a method's first run at most, where nobody knows yet how long a step takes
FIRST_STEPS = {"compiled": 200_000, "callbacks": 5_000}
#: half the step must give less than this part of the error, or it is round-off that is left
STILL_BETTER = 0.7
#: tolerances down to this are tried whatever they bring; it is above what round-off leaves of short runs
CERTAIN = 1e-12
#: what a single run may take, as a share of the whole budget
RUN_SHARE = 0.006


@dataclass(frozen=True)
class Question:
    """What is asked of every method: a scene, its truth at five times, the errors, and the time there is."""

    scene: Scene
    truth: Reference
    errors: tuple[float, ...]
    budget: float

    @property
    def times(self) -> np.ndarray:
        return ends(self.scene)

    def floor(self) -> float:
        """What the reference itself may be off by, relative to the largest state: no error below is claimed."""
        return max(10.0**-self.truth.digits, float(np.finfo(float).eps))

    def error(self, solutions: Sequence[Solution]) -> float:
        """max ‖y − y*‖₂ / max ‖y*‖₂ over the ends of several runs."""
        scene, carry = self.scene, carried(self.scene)
        labels = self.truth.scene.labels(self.truth.carry)
        exact = self.truth.y[:, [labels.index(name) for name in scene.labels(carry)]]
        exact = observed(scene, exact, carry)
        numerical = observed(scene, np.array([solution.y[-1] for solution in solutions]), carry)
        size = np.linalg.norm(exact, axis=1).max()
        return float(np.linalg.norm(numerical - exact, axis=1).max() / size)


def ends(scene: Scene) -> np.ndarray:
    """The five times."""
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


@dataclass
class Scouted:
    """Everything tried of one method.

    why : a status and a reason where no setting could be tried, or finer ones were not.
    """

    method: str
    engine: str
    attempts: list[Attempt] = field(default_factory=list)
    why: tuple[str, str] | None = None
    compile_s: float = 0.0
    #: seconds spent on it so far, compiling not counted
    spent: float = 0.0

    @property
    def kind(self) -> str:
        """compiled or callbacks: times are compared within a kind."""
        return ENGINES.get(self.engine, "compiled")

    def best(self, error: float) -> Attempt | None:
        """The cheapest attempt that is as accurate."""
        reached = [a for a in self.attempts if a.ok and a.error <= error]
        return min(reached, key=lambda a: a.work) if reached else None

    def finest(self) -> Attempt | None:
        return min(self.attempts, key=lambda a: a.value, default=None)


def scout(question: Question, found: Scouted) -> Iterator[None]:
    """Settings of a method until the smallest error is reached or the range ends, one a turn."""
    limit = Limit(question)
    try:
        for attempt in ladder(question, found, limit):
            yield
            if attempt.ok and attempt.error <= min(question.errors):
                break
            if attempt.status is Status.budget:
                most = f"more than a run may take here, {limit.longest:.2g} s"
                found.why = ("budget", f"{attempt.setting}: {attempt.message}, {most}")
                break
        for error in question.errors:
            yield from refine(question, found, limit, error)
    except Unsupported as reason:
        found.why = ("unsupported", str(reason))
    except UserError as error:
        found.why = ("failed", str(error))
    except (
        CannotRecord,
        ImportError,
        OSError,
        RuntimeError,
    ) as error:  # a compiler or a library that is not there
        found.why = ("failed", f"{type(error).__name__}: {' '.join(str(error).split())[:200]}")


class Unsupported(Exception):
    """Why a method cannot do a scene, found out only when it was prepared."""


class Limit:
    """How many steps a run may take so that it stays within its share of the time."""

    def __init__(self, question: Question) -> None:
        self.longest = RUN_SHARE * question.budget
        self.a_step: float | None = None

    def steps(self, found: Scouted) -> int:
        if self.a_step is None or found.engine == "jax":  # with another budget XLA would compile anew
            return FIRST_STEPS[found.kind]
        return max(1000, int(self.longest / self.a_step))

    def learn(self, seconds: float, steps: int | None) -> None:
        if steps:
            self.a_step = seconds / steps


def ladder(question: Question, found: Scouted, limit: Limit) -> Iterator[Attempt]:
    item = METHODS[found.method]
    if item.exact:  # nothing to be set
        yield attempt(question, found, limit, 0.0)
        return
    for value in values_of(item, question.scene):
        if item.adaptive and value < CERTAIN and spent(found):
            return
        yield attempt(question, found, limit, value)
    while item.control == "step" and not spent(found):  # a low order needs small steps
        yield attempt(question, found, limit, found.attempts[-1].value / 2)


def spent(found: Scouted) -> bool:
    """Return whether the last setting was hardly more accurate than the one before: what is left is round-off.

    The one before is most of a decade of tolerances away at least.
    """
    *others, last = found.attempts
    apart = 5 if METHODS[found.method].adaptive else 1
    before = next((a for a in reversed(others) if a.value >= apart * last.value), others[-1])
    return before.ok and last.ok and not last.error < STILL_BETTER * before.error


def values_of(item: Any, scene: Scene) -> list[float]:
    """From coarse to fine; a single one where there is nothing to be set."""
    if item.exact:
        return [0.0]
    if not item.adaptive:
        return work_ladder(scene, item.order or 1)
    return tolerances(item)


def attempt(question: Question, found: Scouted, limit: Limit, value: float) -> Attempt:
    """Five runs at one setting, the longest first; recorded in `found`."""
    scene, item = question.scene, METHODS[found.method]
    options: dict[str, Any] = {**setting(item, value), "carry": carried(scene)}
    *earlier, end = question.times.tolist()
    start = perf_counter()
    run = prepare(scene, found.method, save_at=[end], max_steps=limit.steps(found), **options)
    if isinstance(run, Refused):
        raise Unsupported(run.why)
    found.engine = run.request.engine
    first = not found.attempts
    if first:
        run()  # the first call of a program may compile yet
        found.compile_s = perf_counter() - start
    start = perf_counter()
    solution = run()
    seconds = perf_counter() - start
    options |= {"max_steps": run.request.max_steps, "engine": found.engine}
    limit.learn(seconds, solution.counts.steps)
    error, status, message = math.nan, solution.status, solution.message
    if solution.ok:
        shorter = [prepare(scene, found.method, save_at=[t], **options)() for t in earlier]
        bad = next((s for s in shorter if not s.ok), None)
        if bad is None:
            error = question.error([*shorter, solution])
        else:
            status, message = bad.status, bad.message
    made = Attempt(
        value, run.request.setting, status, message, seconds, error, run.count(solution.counts), run
    )
    found.attempts.append(made)
    return made


def refine(question: Question, found: Scouted, limit: Limit, error: float) -> Iterator[None]:
    """Bisect between the coarsest setting that is accurate enough and its coarser neighbour."""
    for _ in range(BISECTIONS):
        tried = sorted(found.attempts, key=lambda a: -a.value)
        fine = next((i for i, a in enumerate(tried) if a.ok and a.error <= error), None)
        if not fine:  # none is, or the coarsest of all
            return
        value = between(question, METHODS[found.method], tried[fine - 1].value, tried[fine].value)
        if value is None:
            return
        attempt(question, found, limit, value)
        yield


def between(question: Question, item: Any, coarse: float, fine: float) -> float | None:
    """The setting half-way in the logarithm; a step divides the intervals between the five times; None: no room."""
    middle = math.sqrt(coarse * fine)
    if item.adaptive:
        return float(f"{middle:.3g}") if fine < middle < coarse else None
    end = question.scene.t_end
    low, n, high = (round(end / h / ENDS) for h in (coarse, middle, fine))
    return end / (ENDS * n) if low < n < high else None
