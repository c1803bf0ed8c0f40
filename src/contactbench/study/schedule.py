"""The stages of a race within a budget of time: reference, search, laws and times, each with its share."""

from __future__ import annotations

import math
import sys
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import accumulate, islice
from time import perf_counter
from typing import Any

import numpy as np
from tqdm import tqdm

from contactbench.errors import BadInput
from contactbench.measure.clock import VISITS, Call, Race, Visit, least
from contactbench.measure.laws import row as laws_row
from contactbench.runs.search import Attempt, Question, Search
from contactbench.runs.settings import ENDS, carry_of, times
from contactbench.scene.base import Elapsed, Scene
from contactbench.truth import OutOfTime, Reference, confirmed, reference

#: by when, in parts of the budget, the reference (half of it is for high precision, the rest for two solvers), its
#: check, the search and the laws are over; the clock has the rest
REFERENCE, CHECK, SEARCH, LAWS = 0.4, 0.25, 0.6, 0.85
#: what is timed although all time is over
LATE = 0.05
#: seconds for the reference at least, which it takes to compile it on a loaded machine: without one there is no race
LEAST_REFERENCE = 5.0
#: calls of a run in the shortest race: to warm up, and a round of each visit
FEWEST_CALLS = 1 + VISITS
#: seconds that compiling a method of an engine takes: without them it is not begun
COMPILING = {"jax": 5.0, "c++": 1.5}
#: what a method gets in the search after its first run at least, as a share of the whole budget: runs of one setting
#: each are no race
SHARE = 0.05
#: what a single run may take, as a share of the whole budget
RUN_SHARE = 0.006
#: what a derivative of the map costs, roughly: compilations of the solver, seconds each at least, and runs
COMPILATIONS, CACHED, RUNS = 2.0, 0.2, 100.0
#: components from which on compiling it takes longer, as their cube
MANY = 20
#: stages that the bar shows beside the methods
STAGES = 3
#: why a method has no run
NOT_BEGUN, INTERRUPTED = ("budget", "no time was left to begin it"), "interrupted"
#: measures of a run that are no laws, or that another one covers
LEFT_OUT = ("solution_error", "energy_increases")

#: the columns of an attempt, by its identity
type Found = dict[int, dict[str, Any]]


def watched() -> bool:
    """Return whether somebody sees a bar: stderr is a terminal, or the kernel of a notebook shows it."""
    kernel = sys.modules.get("ipykernel.kernelapp")
    return sys.stderr.isatty() or (kernel is not None and kernel.IPKernelApp.initialized())


class Budget:
    """The time that a race has, and what it had no time for.

    interrupted : whether Ctrl-C ended a stage.  unrefined : methods without a last search for a coarser setting.
    """

    def __init__(self, seconds: float, begun: float, progress: bool) -> None:
        self.begun, self.seconds, self.interrupted = begun, seconds, False
        self.unrefined: list[str] = []
        self.bar = tqdm(total=STAGES, disable=not (progress and watched()), unit="", leave=False)

    def left(self, part: float = 1.0) -> float:
        return self.begun + part * self.seconds - perf_counter()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Show a stage by its name; Ctrl-C ends it with what there is."""
        self.bar.set_description(name)
        try:
            with np.errstate(all="ignore"):  # long steps overflow, and end as diverged
                yield
        except KeyboardInterrupt:
            self.interrupted = True
        self.bar.update()


# -- reference -------------------------------------------------------------------------------------
def find_reference(scene: Scene, budget: Budget, given: Reference | None) -> tuple[Reference, int | None]:
    """Return the truth at the ends of the runs and how many digits a second engine confirms."""
    budget.bar.set_description("reference")
    seconds = max(budget.left(REFERENCE), LEAST_REFERENCE)
    try:
        truth = given or reference(scene, Elapsed(times(scene, ENDS)), carry_of(scene), seconds)
    except OutOfTime as why:
        ways = "a larger budget, an earlier t_end"
        if math.isfinite(why.needed):
            more = float(f"{max(why.needed / REFERENCE, 2 * budget.seconds):.2g}")
            sooner = float(f"{scene.t_end * min(seconds / why.needed, 0.5):.1g}")
            ways = f"--budget {more:g}s (budget={more:g}), t_end={sooner:g}"
        what = f"no reference for scene {scene.name!r} in its part of the budget, {seconds:.2g} s"
        raise OutOfTime(f"{what}: give {ways}, or reference=, your own", why.needed) from why
    digits = confirmed(truth, budget.left(CHECK))
    if digits == 0:
        raise BadInput(f"no reference for scene {scene.name!r}: a second engine confirms none of its digits")
    return truth, digits


def ask(scene: Scene, truth: Reference, errors: tuple[float, ...], budget: Budget) -> Question:
    return Question(scene, truth, errors, RUN_SHARE * budget.seconds, budget.begun + LAWS * budget.seconds)


def floor_of(truth: Reference) -> float:
    """Return what a reference may be off by, relative to the largest state: no error below is claimed."""
    return max(10.0**-truth.digits, float(np.finfo(float).eps))


# -- search ----------------------------------------------------------------------------------------
def search(
    question: Question, methods: Sequence[str], first: Collection[str], budget: Budget
) -> list[Search]:
    """Search the settings of every method: of those that may lead first, of what compiles for long last.

    In every pass over the methods each has an equal share of the time that is left, which the next ones get if it does
    not need it; where shares are small the first ones get more, and the last are not begun.
    """
    searches, unfinished = [Search(question, name) for name in methods], dict[Search, Iterator[None]]()
    with budget.stage("search"), suppress(OutOfTime):
        for each in searches:
            if (why := each.method.refuses(question.scene)) is not None:
                each.why = ("unsupported", why)
        able = sorted(
            (one for one in searches if not one.why), key=lambda one: COMPILING.get(one.engine, 0.0)
        )
        unfinished = {one: one.turns() for one in able}
        budget.bar.total = len(able) + STAGES
        least = SHARE * budget.seconds
        for leads in (True, False):
            group = [one for one in able if (one.method.name in first) == leads]
            while group and budget.left(SEARCH) > 0:
                for waiting, each in zip(range(len(group), 0, -1), [*group], strict=True):
                    left = budget.left(SEARCH)
                    budget.bar.set_description(each.method.name)
                    if left < (0.0 if each.attempts else COMPILING.get(each.engine, 0.0)):
                        group.remove(each)
                    elif are_over(unfinished[each], perf_counter() + left / waiting, least):
                        group.remove(each)
                        del unfinished[each]
                        budget.bar.update()
    for each in unfinished:
        stop(each, budget)
    return searches


def are_over(turns: Iterator[None], until: float, least: float) -> bool:
    """Take a turn, and more until some time, or for `least` seconds; return whether there are no more."""
    if any(True for _ in islice(turns, 1)):
        until = max(until, perf_counter() + least)
    return all(perf_counter() < until for _ in turns)


def stop(each: Search, budget: Budget) -> None:
    """Say why a search did not go on."""
    last = each.finest
    if each.why is None and each.done:
        budget.unrefined.append(each.method.name)
    elif each.why is None and budget.interrupted:
        each.why = (INTERRUPTED, f"interrupted {f'after {last.setting}' if last else 'before it was tried'}")
    elif each.why is None:
        each.why = NOT_BEGUN if last is None else ("budget", f"no time was left after {last.setting}")


def reaching(searches: Iterable[Search], error: float, floor: float) -> list[tuple[Search, Attempt]]:
    """Return the methods that reach an error, each with its setting."""
    return [(each, a) for each in searches if error >= floor and (a := each.best(error)) is not None]


# -- laws ------------------------------------------------------------------------------------------
def measure_laws(question: Question, searches: Sequence[Search], budget: Budget) -> Found:
    """Measure the laws at the settings that reach the errors, those first that may keep some and are soon done."""
    found: Found = {}
    with budget.stage("laws"):
        for error in question.errors:
            pairs = reaching(searches, error, floor_of(question.truth))
            for pair in sorted(
                pairs, key=lambda p: (p[0].method.family == "established", differentiation_time(*p))
            ):
                if id(pair[1]) not in found and not budget.interrupted and budget.left(LAWS) > 0:
                    found[id(pair[1])] = laws_at(question, *pair, budget)
    return found


def laws_at(question: Question, search: Search, attempt: Attempt, budget: Budget) -> dict[str, Any]:
    """Return how far a run that carries every field is from the laws; nothing where that would take too long."""
    scene, left, known = question.scene, budget.left(LAWS), question.truth
    found: dict[str, Any] = {}
    if left > COMPILING.get(search.engine, 0.0):  # another field is another program
        with suppress(BadInput):  # its truth takes too long, or a function takes no arrays
            solution = search.along(attempt)()
            given = solution.carry == known.carry and np.array_equal(solution.elapsed, known.t)
            solution.truth = (
                known if given else reference(scene, Elapsed(solution.elapsed), solution.carry, left)
            )
            late = "" if differentiation_time(search, attempt) <= left else "no time was left"
            found = laws_row(solution, late, LEFT_OUT.__contains__)
    return found


def differentiation_time(search: Search, attempt: Attempt) -> float:
    """Return about how many seconds the derivative of the map takes."""
    compilation = max(search.compile_s, CACHED) * (1 + (search.question.scene.motion / MANY) ** 3)
    return COMPILATIONS * compilation + RUNS * attempt.seconds


# -- times -----------------------------------------------------------------------------------------
def time_runs(question: Question, searches: Sequence[Search], budget: Budget) -> Found:
    """Time the settings that reach the errors side by side; the slowest are left out where time is short."""
    floor, given = floor_of(question.truth), max(budget.left(), LATE * budget.seconds)
    reach = {id(a): a for e in question.errors for _, a in reaching(searches, e, floor) if a.run}
    attempts = sorted(reach.values(), key=lambda attempt: attempt.seconds)
    spent = accumulate(FEWEST_CALLS * attempt.seconds for attempt in attempts)
    timed = [attempt for attempt, seconds in zip(attempts, spent, strict=True) if seconds <= given]
    race = Race([Call(a.run.bare_call()) for a in timed if a.run])
    with budget.stage("timing"):
        race.go(0.0 if budget.interrupted else given, given + LATE * budget.seconds)
    visited = [(id(a), visits) for a, visits in zip(timed, race.visits, strict=True) if visits]
    return {one: {"time_s": least(visits), "halves": halves(visits)} for one, visits in visited}


def halves(visits: Sequence[Visit]) -> float:
    """Return the least round of every other visit over that of the rest."""
    return least(visits[1::2]) / least(visits[::2]) if len(visits) > 1 else math.nan
