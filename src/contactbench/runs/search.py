"""Search the setting of a method that reaches an error or a cost, from coarse to fine and then by halving."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from time import perf_counter

import numpy as np

from contactbench.blame import UserError
from contactbench.methods.base import ENGINES, METHODS, prepare
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.prepared import IMPLICIT, Prepared
from contactbench.numbers.protocol import CannotRecord
from contactbench.runs.experiment import Row
from contactbench.runs.settings import ENDS, carry_of, control_of, setting_to, steps, times, tolerances
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.scene.scales import errors
from contactbench.solution import GROWING, Counts, Solution, Status
from contactbench.truth import OutOfTime, Reference


def halve(
    coarse: float,
    fine: float,
    reaches: Callable[[float], bool],
    between: Callable[[float, float], float | None],
) -> Iterator[None]:
    """Halve the range between a setting that misses a target and one that reaches it; yield after each try."""
    while (middle := between(coarse, fine)) is not None:
        coarse, fine = (coarse, middle) if reaches(middle) else (middle, fine)
        yield


# -- at a cost -------------------------------------------------------------------------------------
#: a tolerance is accepted if its cost is this close to the target, relatively; else the nearest one tried is
NEAR = 0.02
#: least difference of tolerances tried, in log10(rtol)
RESOLUTION = 2e-3


def right_hand_sides(solution: Solution) -> float:
    """Return the right-hand sides of a run, 0 for a bad end, inf for a spent budget."""
    if solution.ok:
        known = solution.counts.rhs_equivalents
        return IMPLICIT * (solution.counts.steps or 0) if known is None else known
    return math.inf if solution.status is Status.budget else 0.0


def tolerance_at(cost: Callable[[float], float], target: float, rtol_range: tuple[float, float]) -> float:
    """Return the tolerance, of three digits, at which a run costs `target`.

    cost : evaluations at a tolerance; 0 for a run that came to a bad end, inf for one that spent its budget.
    Of the tolerances tried, the one whose cost is nearest, as a ratio, the tightest of equals.  A method that costs
    more at its loosest tolerance gets the tightest that costs hardly more than that: the loosest buys nothing.
    """
    (finest, loosest), costs = rtol_range, dict[float, float]()

    def tried(value: float) -> float:
        rtol = min(max(float(f"{value:.2e}"), finest), loosest)
        costs[rtol] = cost(rtol)
        return costs[rtol]

    def between(coarse: float, fine: float) -> float | None:
        return math.sqrt(coarse * fine) if math.log10(coarse / fine) > RESOLUTION else None

    target = max(target, (1 + 2 * NEAR) * tried(loosest))
    for _ in halve(loosest, finest, lambda value: tried(value) >= target, between):
        if abs([*costs.values()][-1] / target - 1) < NEAR:
            break
    if not any(found >= target for found in costs.values()):  # the tightest costs less, or was not tried
        tried(finest)
    off = {rtol: abs(math.log(found / target)) for rtol, found in costs.items() if 0 < found < math.inf}
    return min(off or costs, key=lambda rtol: (off.get(rtol, math.inf), rtol))


def step_at(method: FixedStep, scene: Scene, target: float, part: int = 1) -> float:
    """Return the step, t_end over a multiple of `part`, at which a run costs nearest to `target` right-hand sides."""
    scale = 0.5 if method.kind_on(scene) == "rotation" else 1.0
    each = scale * method.per_step(scene)
    once = scale * method.counts(scene, 1) - each  # what a run costs beside its steps: a processor
    n = max(1, round((target - once) / each / part)) * part
    return scene.t_end / n


# -- at an error -----------------------------------------------------------------------------------
# Nothing is timed here.  The error of a setting is the largest over five end times, each the end of a run of its own:
# interpolation between steps, of lower order than some methods, plays no part in it.
#: number of settings tried between the first that is accurate enough and the one before it
HALVINGS = 4
#: steps of a method's first run at most, where nobody knows yet how long a step takes; and of any run at least
FIRST_STEPS, FEWEST_STEPS = {"compiled": 200_000, "callbacks": 5_000}, 1000
#: if half the step leaves more than this part of the error, the rest is round-off
STILL_BETTER = 0.7
#: tolerances down to this are always tried; round-off of short runs is smaller
CERTAIN = 1e-12
#: error about as large as the motion; longer steps are not tried
COARSE = 0.3
#: smallest tolerance tried for a method whose runs at looser tolerances take too long
WAKES = 1e-4
#: least ratio of tolerances whose errors are compared
APART = 5.0
#: exceptions of a compiler or of a missing library
BROKEN = (CannotRecord, ImportError, OSError, RuntimeError)


@dataclass(frozen=True)
class Question:
    """Hold the errors asked for and the truth at the ends of the runs; a run may take `longest` seconds.

    deadline : a turn of a method that goes on then is given up.
    """

    scene: Scene
    truth: Reference
    errors: tuple[float, ...]
    longest: float
    deadline: float = math.inf
    #: number of saved times of a run; its error is measured at the ends
    saved: int = 1

    def error(self, solutions: Sequence[Solution]) -> float:
        carry, labels = carry_of(self.scene), self.scene.labels(self.truth.carry)
        known = self.truth.y[:, [labels.index(name) for name in self.scene.labels(carry)]]
        start = self.scene.pack(self.scene.initial(carry))
        found = np.array([solution.y[-1] for solution in solutions])
        return float(errors(self.scene, found, known, start, carry).max())


@dataclass(frozen=True)
class Attempt:
    """Hold the result of a setting: its run to the end, and the largest error of five runs."""

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
        return self.status is Status.ok and math.isfinite(self.error)

    @property
    def evaluations(self) -> float:
        """Return right-hand sides, nan where the solver does not count them."""
        count = self.counts.rhs_equivalents
        return math.nan if count is None else count

    @property
    def work(self) -> float:
        return self.seconds if math.isnan(self.evaluations) else self.evaluations

    @property
    def engine(self) -> str:
        return "" if self.run is None else self.run.request.engine

    def reaches(self, error: float) -> bool:
        return self.ok and self.error <= error

    def columns(self, floor: float) -> Row:
        """Return the columns of its setting; no error below the floor is claimed."""
        error = max(self.error, floor)
        return {"setting": self.setting, "error_reached": error, "evaluations": self.evaluations}


def cheapest(attempts: Iterable[Attempt], error: float) -> Attempt | None:
    """Return the cheapest attempt that reaches an error."""
    return min((a for a in attempts if a.reaches(error)), key=lambda a: a.work, default=None)


class Search:
    """Try one method from its coarsest setting to the one that reaches the smallest error.

    why : status and reason if it got no further.  spent : seconds since its first run.  a_step : seconds of a step.
    """

    def __init__(self, question: Question, method: str) -> None:
        self.question, self.method = question, METHODS[method]
        self.engine, self.control = self.method.engines[0], control_of(question.scene, self.method)
        self.attempts: list[Attempt] = []
        self.why: tuple[str, str] | None = None
        self.compile_s, self.spent, self.a_step = 0.0, 0.0, math.nan

    @property
    def kind(self) -> str:
        return ENGINES.get(self.engine, "compiled")

    @property
    def finest(self) -> Attempt | None:
        return min(self.attempts, key=lambda a: a.value, default=None)

    @property
    def done(self) -> bool:
        return self.best(min(self.question.errors)) is not None

    def best(self, error: float) -> Attempt | None:
        return cheapest(self.attempts, error)

    def turns(self) -> Iterator[None]:
        """Try one setting per turn; set `why` if the method gets no further."""
        try:
            for attempt in self.coarse_to_fine():
                yield
                if attempt.status is Status.unsupported:  # as is found out only when it is prepared
                    self.why = ("unsupported", attempt.message)
                    self.attempts.clear()
                    return
                if attempt.status is Status.budget and not self.may_wake(attempt):
                    most = f"more than a run may take here, {self.question.longest:.2g} s"
                    self.why = ("budget", f"{attempt.setting}: {attempt.message}, {most}")
                    break
            for error in self.question.errors:
                yield from self.refine(error)
        except UserError as error:
            self.why = ("failed", str(error))
        except BROKEN as error:
            self.why = ("failed", f"{type(error).__name__}: {' '.join(str(error).split())[:200]}")

    def may_wake(self, stalled: Attempt) -> bool:
        """Return whether a tighter tolerance may be faster than the loosest ones, as with some step controls."""
        none_yet = not any(a.ok for a in self.attempts)
        return self.method.adaptive and none_yet and stalled.value > WAKES

    def coarse_to_fine(self) -> Iterator[Attempt]:
        scene, method, adaptive = self.question.scene, self.method, self.method.adaptive
        if method.exact:  # nothing to be set
            yield self.attempt(0.0)
            return
        for value in tolerances(method) if adaptive else steps(scene, method):
            if adaptive and value < CERTAIN and self.stagnates():
                return
            first = not self.attempts
            yield self.attempt(value)
            if first and not adaptive:
                yield from self.coarsen()
            if self.done:
                return
        # a low order needs small steps
        while not (adaptive or self.stagnates() or self.done):
            yield self.attempt(self.attempts[-1].value / 2)

    def coarsen(self) -> Iterator[Attempt]:
        """Double the step until its error is about the size of the motion: a scene may have any unit of time."""
        last, end = self.attempts[-1], self.question.scene.t_end
        while last.ok and last.error < COARSE and (count := round(end / last.value / ENDS) // 2):
            yield (last := self.attempt(end / (ENDS * count)))

    def stagnates(self) -> bool:
        *others, last = self.attempts
        apart = APART if self.method.adaptive else 1.0
        before = next((a for a in reversed(others) if a.value >= apart * last.value), others[-1])
        return before.ok and last.ok and not last.error < STILL_BETTER * before.error

    def refine(self, error: float) -> Iterator[None]:
        tried = sorted(self.attempts, key=lambda a: -a.value)
        fine = next((i for i, a in enumerate(tried) if a.reaches(error)), None)
        if fine:  # neither none nor the coarsest of all
            ends = tried[fine - 1].value, tried[fine].value
            reaches = lambda value: self.attempt(value).reaches(error)  # noqa: E731
            yield from islice(halve(*ends, reaches, self.between), HALVINGS)

    def between(self, coarse: float, fine: float) -> float | None:
        """Return the setting half-way in the logarithm, None without room; a step divides the time between two ends."""
        middle = math.sqrt(coarse * fine)
        if self.method.adaptive:
            return float(f"{middle:.3g}") if fine < middle < coarse else None
        end = self.question.scene.t_end
        low, n, high = (round(end / h / ENDS) for h in (coarse, middle, fine))
        return end / (ENDS * n) if low < n < high else None

    def most_steps(self) -> int:
        """Return the most steps of a run; constant for JAX, which compiles anew for each number."""
        if self.engine == "jax" or not self.a_step > 0:
            return FIRST_STEPS[self.kind]
        return max(FEWEST_STEPS, int(self.question.longest / self.a_step))

    def attempt(self, value: float) -> Attempt:
        scene, first = self.question.scene, not self.attempts
        options: Row = {"carry": carry_of(scene), "max_steps": self.most_steps()}
        *earlier, end = times(scene, ENDS).tolist()

        def prepared(end: float, saved: int = 1) -> Prepared:
            setting, saves = setting_to(end, scene, self.control, value), np.arange(1, saved + 1) / saved
            return prepare(scene, self.method, save_at=Elapsed(end * saves), **setting, **options)

        def solved(run: Prepared) -> Solution:
            if perf_counter() > self.question.deadline:
                raise OutOfTime("")
            return run()

        start = perf_counter()
        run = prepared(end, 1 if self.control == GROWING else self.question.saved)
        self.engine = run.request.engine
        if first:
            solved(run)  # the first call of a program may compile yet
            self.compile_s = perf_counter() - start
        start = perf_counter()
        solution = solved(run)
        seconds = perf_counter() - start
        if solution.ok and solution.counts.steps:  # one that diverges is run again and again, to find where
            each = seconds / solution.counts.steps
            self.a_step = self.a_step if self.a_step <= each else each  # of few steps most is the call
        error, worst = math.nan, solution
        if solution.ok:
            options["engine"] = self.engine
            runs = [solved(prepared(t)) for t in earlier] + [solution]
            worst = next((each for each in runs if not each.ok), solution)
            if worst.ok:
                error = self.question.error(runs)
        ended = worst.status, worst.message, seconds, error, solution.counts, run
        self.attempts.append(Attempt(value, run.request.setting, *ended))
        return self.attempts[-1]

    def along(self, attempt: Attempt) -> Prepared:
        """Return a run at a setting tried that carries every field; saved at the ends, where steps grow at each."""
        scene = self.question.scene
        setting = setting_to(scene.t_end, scene, self.control, attempt.value)
        saves = None if self.control == GROWING else Elapsed(times(scene, ENDS))
        return prepare(scene, self.method, save_at=saves, engine=self.engine, dense=False, **setting)
