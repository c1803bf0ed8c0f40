"""`compare`: reference, scouting, laws and timing, in that order, within a budget of time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import accumulate
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from contactbench.blame import UserError, their_code
from contactbench.checks import array, finite, function, items_of, positive, switch
from contactbench.errors import BadInput, excerpt
from contactbench.measure.clock import VISITS, Call, Race, time_columns
from contactbench.measure.ladder import (
    ENDS,
    GROWING,
    carry_of,
    control_of,
    setting_to,
    tolerances,
    work_ladder,
)
from contactbench.measure.laws import laws_of, observables, row
from contactbench.measure.statistics import PROCESSES
from contactbench.methods.base import ENGINES, METHODS, lookup, prepare
from contactbench.methods.prepared import Refused
from contactbench.numbers.protocol import CannotRecord
from contactbench.results.contest import CUT, standings
from contactbench.scene import Scene
from contactbench.scene.many import Many
from contactbench.solution import Counts, Solution, Status
from contactbench.truth import OutOfTime, Reference, confirmed, reference

ERRORS = (1e-3, 1e-6, 1e-9)
BUDGET = 60.0
#: by when, in parts of the budget, the reference, its check, the scouting and the laws are over
REFERENCE, CHECK, SCOUTING, LAWS = 0.4, 0.42, 0.6, 0.8
#: how much longer the rounds may take that every run is to have
LATE = 0.05
#: seconds for the reference at least, which it takes to compile it on a loaded machine: without one there is no race
LEAST_REFERENCE = 5.0
#: calls of a run in the shortest race: to warm up, and a round of each visit
FEWEST_CALLS = 1 + VISITS
KINDS = ("compiled", "callbacks")
#: seconds that compiling the first method of an engine takes: without them it is not begun
COMPILING = {"jax": 5.0, "c++": 1.5}
#: what compiles so slowly begins when every other method is done or had this part of the budget
PATIENCE = 0.03
#: a run made once may take so many times as long as its least round
ONCE = 2.0
#: measures of a run that are no laws, or that another one covers
LEFT_OUT = ("solution_error", "energy_law_relative", "energy_increases", "own_factor_drift")
#: what a derivative of the map costs, roughly: compilations of the solver, and runs
COMPILATIONS, RUNS = 2.0, 100.0
#: seconds that compiling a derivative takes at least, where the method itself was found compiled
CACHED = 0.2
#: components from which on compiling it takes longer, as their cube
MANY = 20
#: types of the columns beside the laws
COLUMNS = dict.fromkeys(("scene", "method", "family", "engine", "kind"), "str")
COLUMNS |= {"error_asked": "float64", "setting": "str"}
COLUMNS |= dict.fromkeys(("error_reached", "time_s", "evaluations", "ratio", "margin"), "float64")
COLUMNS |= dict.fromkeys(("verdict", "laws_kept", "status", "reason"), "str")


#: bisections between the first setting that is accurate enough and the one before it
BISECTIONS = 4
#: steps of a method's first run at most, where nobody knows yet how long a step takes; and of any run at least
FIRST_STEPS, FEWEST_STEPS = {"compiled": 200_000, "callbacks": 5_000}, 1000
#: half the step must give less than this part of the error, or it is round-off that is left
STILL_BETTER = 0.7
#: tolerances down to this are tried whatever they bring; it is above what round-off leaves of short runs
CERTAIN = 1e-12
#: an error about as large as the motion: longer steps are not tried
COARSE = 0.3
#: how much coarser a tolerance is at least whose error is compared: most of a decade
APART = 5.0
#: what a single run may take, as a share of the whole budget
RUN_SHARE = 0.006
#: what a compiler or a library that is not there raises
BROKEN = (CannotRecord, ImportError, OSError, RuntimeError)


def compare(
    scene: Scene | str,
    methods: Sequence[str] | None = None,
    errors: Iterable[float] = ERRORS,
    budget: float = BUDGET,
    progress: bool = False,
    reference: Callable[[np.ndarray], Any] | None = None,
) -> pd.DataFrame:
    """Race methods on one scene: what each costs at each error, and what it keeps.

    Each method is tried from its coarsest setting to the one that reaches the smallest error, on the first
    of its engines that can run the scene; the settings that reach the errors are then timed in turns, as bare
    calls, each eight times or more, fewer on a machine too busy for that.  Times are compared within a kind of engine:
    compiled, or calling back into Python.
    Ctrl-C ends it with what there is.

    Parameters
    ----------
    scene :
        A scene or the name of one.  Where it `slows_after` some time, fixed steps grow geometrically.
    methods :
        Names, by default all.
    errors :
        Errors asked for, of ``max ‖y − y*‖ / max ‖y*‖`` over the ends of five runs.
    budget :
        Seconds for everything; the reference may take five whatever it is.
    progress :
        Whether to show a bar on stderr, where that is a terminal.
    reference :
        ``reference(t) -> (k, d)``, the true states at k times where you know them: a row of q, then p (of a body of M,
        then the quaternion R) for each.  It is taken to be right to 15 digits.  By default it is computed.

    Returns
    -------
    pandas.DataFrame
        One row for each method and error, columns: scene, method, family, engine, kind, error_asked, setting,
        error_reached, time_s (the least round), evaluations (of the right-hand side, or what equals one), ratio (to
        the least time of its kind at that error), margin (the ratio up to which the two cannot be told apart), verdict
        (win; tie; undecided where the margin is too wide to judge, or a rival was cut off that might be sooner done;
        loss), laws_kept, a column for each law, status, reason (why a method got no further, or was not timed).
        ``attrs``: "reference" (source, digits, digits confirmed by a second engine, error: smaller ones are not
        claimed), "runs" (every setting tried), "of_floats" (functions that cannot be recorded), "unrefined" (methods
        without a last search for a coarser setting), "interrupted", "seconds".

    Raises
    ------
    BadInput
        For a wrong argument, and where no reference can be computed.
    """
    begun, (scene, _) = perf_counter(), lookup(scene, next(iter(METHODS)))
    given = items_of("methods", METHODS if methods is None else methods, "a list of names")
    if not given:
        raise BadInput("methods = []: must be names, at least one; None for all")
    for name in given:
        METHODS[name]  # an unknown one raises
    asked = items_of("errors", errors, "a list of numbers, as in errors=[1e-3, 1e-6]")
    wanted = tuple(sorted({finite("error", error) for error in asked}, reverse=True))
    if not wanted:
        raise BadInput("errors: at least one, as in errors=[1e-3, 1e-6]")
    for error in wanted:
        if not 0 < error < 1:
            size = "must be between 0 and 1, relative to the size of the motion"
            raise BadInput(f"error = {excerpt(error)}: {size}")
    switch("progress", progress)
    truth = None if reference is None else users_reference(scene, reference)
    names = list(dict.fromkeys(given))
    return Comparison(scene, names, wanted, positive("budget", budget), progress, truth, begun).frame()


def reference_within(scene: Scene, budget: float, seconds: float) -> Reference:
    """Return the reference at the ends of the runs; raise `OutOfTime`, which says what budget or end time would do."""
    try:
        return reference(scene, ends(scene), carry_of(scene), seconds)
    except OutOfTime as why:
        ways = "a larger budget, an earlier t_end"
        if math.isfinite(why.needed):
            more = float(f"{max(why.needed / REFERENCE, 2 * budget):.2g}")
            sooner = float(f"{scene.t_end * min(seconds / why.needed, 0.5):.1g}")
            ways = f"--budget {more:g}s (budget={more:g}), t_end={sooner:g}"
        what = f"no reference for scene {scene.name!r} in its part of the budget, {seconds:.2g} s"
        raise OutOfTime(f"{what}: give {ways}, or reference=, your own", why.needed) from why


def users_reference(scene: Scene, given: Callable[[np.ndarray], Any]) -> Reference:
    """Return what a user's function says of the states at the ends of the runs; raise `BadInput` for other shapes."""
    function("reference", given)
    carry, t = carry_of(scene), ends(scene)
    labels = ", ".join(scene.labels(carry)[:8])
    wanted = f"a function of the times that gives a row of {labels} for each"
    with their_code("reference"):
        y = array("reference", given(t.copy()), wanted)
    if y.shape != (shape := (len(t), len(scene.labels(carry)))) or not np.isfinite(y).all():
        raise BadInput(f"reference: gives shape {y.shape}: must be {shape}, finite, for each time {labels}")
    return Reference(scene, carry, t, y, [], np.finfo(float).precision, "given")


# -- one method ------------------------------------------------------------------------------------
# Nothing is timed here.  The error of a setting is the largest over five end times, each the end of a run of its own:
# interpolation between steps, of lower order than some methods, plays no part in it.
@dataclass(frozen=True)
class Question:
    scene: Scene
    truth: Reference
    errors: tuple[float, ...]
    longest: float
    deadline: float = math.inf  #: a turn of a method that goes on then is given up

    def error(self, solutions: Sequence[Solution]) -> float:
        scene, carry = self.scene, carry_of(self.scene)
        labels = self.truth.scene.labels(self.truth.carry)
        exact = self.truth.y[:, [labels.index(name) for name in scene.labels(carry)]]
        exact = observables(scene, exact, carry)
        numerical = observables(scene, np.array([solution.y[-1] for solution in solutions]), carry)
        size = np.linalg.norm(exact, axis=1).max()
        return float(np.linalg.norm(numerical - exact, axis=1).max() / size)


def ends(scene: Scene) -> np.ndarray:
    return scene.t_end * np.arange(1, ENDS + 1) / ENDS


@dataclass(frozen=True)
class Attempt:
    value: float
    setting: str
    status: Status
    message: str
    seconds: float
    error: float = math.nan
    counts: Counts = field(default_factory=Counts)
    run: Any = None

    @property
    def ok(self) -> bool:
        return self.status is Status.ok

    @property
    def work(self) -> float:
        work = self.counts.rhs_equivalents
        return self.seconds if work is None else work

    def reached(self, floor: float) -> dict[str, Any]:
        """Return the columns of its setting; no error below the floor is claimed."""
        counted = self.counts.rhs_equivalents is not None
        columns = {"setting": self.setting, "error_reached": max(self.error, floor)}
        return columns | {"evaluations": self.work if counted else math.nan}


class Unsupported(Exception):
    """A method cannot do a scene, as is found out only when it is prepared."""


class Scout:
    """One method on its way from its coarsest setting to the one that reaches the smallest error.

    why : a status and a reason where it got no further.  spent : seconds since its first run.  a_step : of a step.
    """

    def __init__(self, question: Question, method: str) -> None:
        self.question, self.method = question, METHODS[method]
        self.engine = self.method.engines[0]
        self.attempts: list[Attempt] = []
        self.why: tuple[str, str] | None = None
        self.compile_s, self.spent, self.a_step = 0.0, 0.0, math.nan

    @property
    def kind(self) -> str:
        return ENGINES.get(self.engine, "compiled")

    @property
    def control(self) -> str:
        return control_of(self.question.scene, self.method)

    @property
    def finest(self) -> Attempt | None:
        return min(self.attempts, key=lambda a: a.value, default=None)

    def best(self, error: float) -> Attempt | None:
        reached = (a for a in self.attempts if a.ok and a.error <= error)
        return min(reached, key=lambda a: a.work, default=None)

    def turns(self) -> Iterator[None]:
        try:
            for attempt in self.ladder():
                yield
                if attempt.status is Status.budget:
                    most = f"more than a run may take here, {self.question.longest:.2g} s"
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

    def runs(self) -> Iterator[dict[str, Any]]:
        known = {"method": self.method.name, "engine": self.engine, "kind": self.kind}
        for a in sorted(self.attempts, key=lambda a: -a.value):
            ended = {"value": a.value, "status": str(a.status), "message": a.message, "error": a.error}
            yield known | ended | a.reached(0.0)

    def ladder(self) -> Iterator[Attempt]:
        if self.method.exact:  # nothing to be set
            yield self.attempt(0.0)
            return
        method, adaptive = self.method, self.method.adaptive
        for value in tolerances(method) if adaptive else work_ladder(self.question.scene, method.order or 1):
            if adaptive and value < CERTAIN and self.stagnates():
                return
            first = not self.attempts
            yield self.attempt(value)
            if first and not adaptive:
                yield from self.coarsen()
            if self.best(min(self.question.errors)) is not None:
                return
        # a low order needs small steps
        while not adaptive and not self.stagnates() and self.best(min(self.question.errors)) is None:
            yield self.attempt(self.attempts[-1].value / 2)

    def coarsen(self) -> Iterator[Attempt]:
        """Double the step until its error is about the size of the motion: a scene may have any unit of time."""
        last, end = self.attempts[-1], self.question.scene.t_end
        while last.ok and last.error < COARSE and (steps := round(end / last.value / ENDS) // 2):
            yield (last := self.attempt(end / (ENDS * steps)))

    def stagnates(self) -> bool:
        *others, last = self.attempts
        apart = APART if self.method.adaptive else 1.0
        before = next((a for a in reversed(others) if a.value >= apart * last.value), others[-1])
        return before.ok and last.ok and not last.error < STILL_BETTER * before.error

    def most_steps(self) -> int:
        """Return how many steps a run may take; always the same of JAX, which compiles for each number anew."""
        if self.engine == "jax" or not self.a_step > 0:
            return FIRST_STEPS[self.kind]
        return max(FEWEST_STEPS, int(self.question.longest / self.a_step))

    def attempt(self, value: float) -> Attempt:
        scene, name, first = self.question.scene, self.method.name, not self.attempts
        options: dict[str, Any] = {"carry": carry_of(scene), "max_steps": self.most_steps()}

        def prepared(end: float) -> Any:
            setting = setting_to(end, scene, self.control, value)
            return prepare(scene, name, save_at=[end], **setting, **options)

        *earlier, end = ends(scene).tolist()

        def solved(run: Any) -> Solution:
            if perf_counter() > self.question.deadline:
                raise OutOfTime("")
            return run()

        start = perf_counter()
        run = prepared(end)
        if isinstance(run, Refused):
            raise Unsupported(run.why)
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

    def refine(self, error: float) -> Iterator[None]:
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
        """Return the setting half-way in the logarithm, None without room; a step divides the time between two ends."""
        middle = math.sqrt(coarse * fine)
        if self.method.adaptive:
            return float(f"{middle:.3g}") if fine < middle < coarse else None
        end = self.question.scene.t_end
        low, n, high = (round(end / h / ENDS) for h in (coarse, middle, fine))
        return end / (ENDS * n) if low < n < high else None


# -- all of them -----------------------------------------------------------------------------------
class Runs(tuple[dict[str, Any], ...]):
    """Rows of every setting tried; pandas copies ``attrs`` deeply at every turn, which would take it seconds."""

    def __deepcopy__(self, memo: Any) -> Runs:
        return self


class Comparison:
    """The state of one comparison; `frame` runs it to its end."""

    def __init__(
        self,
        scene: Scene,
        methods: list[str],
        errors: tuple[float, ...],
        budget: float,
        progress: bool,
        truth: Reference | None = None,
        begun: float | None = None,
    ) -> None:
        self.begun, self.budget = begun or perf_counter(), budget
        self.bar = tqdm(total=len(methods) + 3, disable=None if progress else True, unit="", leave=False)
        self.interrupted = False
        self.bar.set_description("reference")
        seconds = max(self.left(REFERENCE), LEAST_REFERENCE)
        truth = truth or reference_within(scene, budget, seconds)
        self.question = Question(scene, truth, errors, RUN_SHARE * budget, self.begun + LAWS * budget)
        #: what the reference itself may be off by, relative to the largest state: no error below is claimed
        self.floor = max(10.0**-truth.digits, float(np.finfo(float).eps))
        self.confirmed = confirmed(truth, self.left(CHECK))
        if self.confirmed == 0:
            raise BadInput(
                f"no reference for scene {scene.name!r}: a second engine confirms none of its digits"
            )
        self.bar.update()
        self.scouts = [Scout(self.question, name) for name in methods]
        self.times: dict[int, dict[str, Any]] = {}
        self.unrefined: list[str] = []
        self.laws: dict[int, dict[str, Any]] = {}
        self.truths: dict[tuple[tuple[str, ...], bytes], Reference | None] = {}
        #: how many times longer than foreseen the derivative of a map has taken
        self.slower = 1.0
        self.columns = {
            law.name: law.label or law.name
            for law in laws_of(scene)
            if law.name not in LEFT_OUT and not law.name.endswith("_frozen")
        }

    def left(self, part: float) -> float:
        return self.begun + part * self.budget - perf_counter()

    def frame(self) -> pd.DataFrame:
        for stage in (self.scout, self.measure_laws, self.time):
            try:
                with np.errstate(all="ignore"):  # long steps overflow, and end as diverged
                    stage()
            except KeyboardInterrupt:
                if self.interrupted:  # a second time: at once
                    break
                self.interrupted = True
                self.stop("interrupted", "interrupted before it was tried", "interrupted after", self.scouts)
            self.bar.update()
        self.bar.close()
        question, truth = self.question, self.question.truth
        frame = pd.DataFrame([self.row(each, error) for each in self.scouts for error in question.errors])
        columns = [*COLUMNS, *self.columns, "map_growth", "time_halves_ratio"]
        frame = judge_times(frame).reindex(columns=columns).astype(COLUMNS)
        known = {"source": truth.source, "digits": truth.digits, "confirmed": self.confirmed}
        frame.attrs = {
            "runs": Runs(run for each in self.scouts for run in each.runs()),
            "reference": known | {"error": self.floor},
            "of_floats": question.scene.functions_of_floats,
            "unrefined": self.unrefined,
            "interrupted": self.interrupted,
            "seconds": perf_counter() - self.begun,
        }
        return frame

    # -- scouting --------------------------------------------------------------------------------------
    def scout(self) -> None:
        """Give the next turn to the method that has had the least time: what a cheap one leaves goes to the others."""
        for each in self.scouts:
            if (why := each.method.refuses(self.question.scene)) is not None:
                each.why = ("unsupported", why)
        turns = {each: each.turns() for each in self.scouts if each.why is None}
        self.bar.update(len(self.scouts) - len(turns))
        while turns and (left := self.left(SCOUTING)) > 0:
            slow = {each for each in turns if each.engine in COMPILING and not each.attempts}
            # the others go first
            each = min(turns, key=lambda one: PATIENCE * self.budget if one in slow else one.spent)
            self.bar.set_description(each.method.name)
            seen = [one.compile_s for one in self.scouts if one.engine == each.engine and one.compile_s]
            expected = 0.0 if each.attempts else max(COMPILING.get(each.engine, 0.0), min(seen, default=0.0))
            if expected > left:
                each.why = ("budget", f"compiling it takes about {expected:.2g} s, {left:.2g} s were left")
                del turns[each]
                continue
            begun, compiled = perf_counter(), each.compile_s
            try:
                done = next(turns[each], self) is self
            except OutOfTime:
                break
            if done:
                del turns[each]
                self.bar.update()
            each.spent += perf_counter() - begun - (each.compile_s - compiled)
        self.stop("budget", "no time was left to begin it", "no time was left after", turns)

    def stop(self, status: str, before: str, after: str, some: Iterable[Scout]) -> None:
        for each in (each for each in some if each.why is None):
            last = each.finest
            if last is None:
                each.why = (status, before)
            elif each.best(min(self.question.errors)) is None:
                each.why = (status, f"{after} {last.setting}, {each.spent:.2g} s of its own")
            else:
                self.unrefined.append(each.method.name)

    def chosen(self, each: Scout, error: float) -> Attempt | None:
        return each.best(error) if error >= self.floor else None

    # -- laws and times --------------------------------------------------------------------------------
    def measure_laws(self) -> None:
        self.bar.set_description("laws")
        for error in self.question.errors:
            pairs = [(each, a) for each in self.scouts if (a := self.chosen(each, error)) is not None]
            for each, attempt in sorted(pairs, key=lambda pair: differentiation_time(*pair)):
                if id(attempt) not in self.laws and not self.interrupted:
                    begun, foreseen = perf_counter(), differentiation_time(each, attempt)
                    self.laws[id(attempt)] = self.laws_at(each, attempt)
                    self.slower = max(self.slower, (perf_counter() - begun) / foreseen)

    def laws_at(self, each: Scout, attempt: Attempt) -> dict[str, Any]:
        """Return how far a run that carries every field is from the laws; nothing where that would take too long."""
        scene, left = self.question.scene, self.left(LAWS)
        if left < (each.compile_s if each.engine == "jax" else 0.0):  # another field is another program
            return {}
        options = setting_to(scene.t_end, scene, each.control, attempt.value) | {"engine": each.engine}
        times = ends(scene) if each.control != GROWING else None
        solution = prepare(scene, each.method.name, save_at=times, **options)()
        if (truth := self.truth_of(solution)) is None:
            return {}
        solution = replace(solution, truth=truth)
        late = "" if self.slower * differentiation_time(each, attempt) <= left else "no time was left"
        try:
            return row(solution, late)
        except UserError:  # a function of floats, and laws are taken of arrays
            return {}

    def truth_of(self, solution: Solution) -> Reference | None:
        """Return the truth of a run with every field, None where it takes longer than there is."""
        t, carry, known = solution.t, solution.carry, self.question.truth
        if carry == known.carry and np.array_equal(t, known.t):
            return known
        if (carry, t.tobytes()) not in self.truths:
            found = None
            with suppress(OutOfTime):
                found = reference(solution.scene, t, carry, self.left(LAWS))
            self.truths[carry, t.tobytes()] = found
        return self.truths[carry, t.tobytes()]

    def time(self) -> None:
        """Time each kind of engine by itself, the compiled first; the slowest are left out where time is short."""
        self.bar.set_description("timing")
        runs: dict[str, dict[int, Attempt]] = {kind: {} for kind in KINDS}
        for each in self.scouts:
            found = (self.chosen(each, error) for error in self.question.errors)
            runs[each.kind] |= {id(attempt): attempt for attempt in found if attempt}
        least = sum(FEWEST_CALLS * attempt.seconds for attempt in runs["callbacks"].values())
        for kind in KINDS:
            left = self.left(1.0)
            given = max(left - (least if kind == "compiled" else 0.0), left / 2, 0.0)
            attempts = sorted(runs[kind].values(), key=lambda attempt: attempt.seconds)
            spent = accumulate(FEWEST_CALLS * attempt.seconds for attempt in attempts)
            timed = [attempt for attempt, seconds in zip(attempts, spent, strict=True) if seconds <= given]
            race = Race([Call(partial(attempt.run.bare, attempt.run.start)) for attempt in timed])
            try:
                race.go(0.0 if self.interrupted else given, given + LATE * self.budget)
            finally:
                visited = zip(timed, race.visits, strict=True)
                self.times |= {id(attempt): time_columns(visits) for attempt, visits in visited if visits}

    # -- rows ------------------------------------------------------------------------------------------
    def row(self, each: Scout, error: float) -> dict[str, Any]:
        """Return a row; at_least : seconds that it takes anyway, where it was cut off or left untimed, else nan."""
        known, times, laws = self.unreached(each, error), {}, {}
        if (attempt := self.soonest(each, error)) is not None:
            times, laws = self.times.get(id(attempt), {}), self.laws.get(id(attempt), {})
            reason = "" if times else "too slow for the time that was left"
            known = attempt.reached(self.floor) | {"status": "ok", "reason": reason}
        cut = known["status"] in (*CUT, "interrupted") or (attempt is not None and not times)
        last = attempt or each.finest
        at_least = (last.seconds / ONCE if last else 0.0) if cut else math.nan
        row = {"scene": self.question.scene.name, "method": each.method.name, "family": each.method.family}
        row |= {"engine": each.engine, "kind": each.kind, "error_asked": error, **known}
        row |= {"time_s": times.get("time_min_s", math.nan), "at_least": at_least}
        row |= {name: laws.get(name, math.nan) for name in (*self.columns, "map_growth")}
        kept = (label for law, label in self.columns.items() if laws.get(f"{law}_kept"))
        halves = times.get("time_halves_ratio", math.nan)
        return row | {"time_halves_ratio": halves, "laws_kept": ", ".join(kept)}

    def soonest(self, each: Scout, error: float) -> Attempt | None:
        if self.chosen(each, error) is None:
            return None
        reach = filter(None, (self.chosen(each, e) for e in self.question.errors if e <= error))
        return min(reach, key=lambda a: self.times.get(id(a), {}).get("time_median_s", math.inf))

    def unreached(self, each: Scout, error: float) -> dict[str, Any]:
        best, floor = min((a for a in each.attempts if a.ok), key=lambda a: a.error, default=None), self.floor
        known = {"setting": "", "error_reached": math.nan} if best is None else best.reached(floor)
        last = each.finest
        if error < floor:
            why = ("unresolved", f"the reference is known to {floor:.1e} only")
        elif each.why is not None:
            why = each.why
        elif last is not None and not last.ok:
            why = (str(last.status), f"{last.setting}: {last.message}")
        else:
            assert last is not None
            why = ("unreached", f"no setting is as accurate, tried down to {last.setting}")
        return known | {"evaluations": math.nan, "status": why[0], "reason": why[1]}


def differentiation_time(each: Scout, attempt: Attempt) -> float:
    scene = each.question.scene
    components = 0 if isinstance(scene, Many) else scene.motion
    compilation = max(each.compile_s, CACHED) * (1 + (components / MANY) ** 3)
    return COMPILATIONS * compilation + RUNS * attempt.seconds


def judge_times(frame: pd.DataFrame) -> pd.DataFrame:
    halves = frame["time_halves_ratio"]
    costs = frame.assign(cost=frame["time_s"], halves=halves, processes=PROCESSES, place=range(len(frame)))
    return standings(costs, ("kind", "error_asked")).sort_values("place", ignore_index=True)
