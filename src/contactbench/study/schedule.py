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

#: shares of the budget after which the reference, its check, the search and the laws end; the timing has the rest
REFERENCE, CHECK, SEARCH, LAWS = 0.4, 0.25, 0.6, 0.85
#: share of the budget for timing that is granted even if the budget is spent
LATE = 0.05
#: least seconds for the reference, enough to compile it on a loaded machine
LEAST_REFERENCE = 5.0
#: fewest calls of a timed run: one to warm up, and one round per visit
FEWEST_CALLS = 1 + VISITS
#: seconds to compile a method, by engine; a method is not begun with less time left
COMPILING = {"jax": 5.0, "c++": 1.5}
#: least share of the budget for a method after its first run, so that it gets several settings
SHARE = 0.05
#: largest share of the budget for one run
RUN_SHARE = 0.006
#: rough cost of the derivative of a map: compilations, least seconds of each, and runs
COMPILATIONS, CACHED, RUNS = 2.0, 0.2, 100.0
#: number of components above which its compilation grows like their cube; stages that the progress bar counts
MANY, STAGES = 20, 3
#: status and reason of a method without a run
NOT_BEGUN, INTERRUPTED = ("budget", "no time was left to begin it"), "interrupted"
#: measures that are not laws, or that another column covers
LEFT_OUT = ("solution_error", "energy_increases")

#: measured columns by the identity of an attempt
type Found = dict[int, dict[str, Any]]


def watched() -> bool:
    """Return whether somebody sees a bar: stderr is a terminal, or the kernel of a notebook shows it."""
    kernel = sys.modules.get("ipykernel.kernelapp")
    return sys.stderr.isatty() or (kernel is not None and kernel.IPKernelApp.initialized())


class Budget:
    """Track the time of a race; interrupted : by Ctrl-C; unrefined : methods whose setting is not refined."""

    def __init__(self, seconds: float, begun: float, progress: bool) -> None:
        self.begun, self.seconds, self.interrupted = begun, seconds, False
        self.unrefined: list[str] = []
        self.bar = tqdm(total=STAGES, disable=not (progress and watched()), unit="", leave=False)

    def left(self, part: float = 1.0) -> float:
        return self.begun + part * self.seconds - perf_counter()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Show a stage in the progress bar; Ctrl-C ends the stage and keeps its results."""
        self.bar.set_description(name)
        try:
            with np.errstate(all="ignore"):  # long steps overflow, and end as diverged
                yield
        except KeyboardInterrupt:
            self.interrupted = True
        self.bar.update()


# -- reference -------------------------------------------------------------------------------------
def find_reference(scene: Scene, budget: Budget, given: Reference | None) -> tuple[Reference, int | None]:
    """Return the true states at the ends of the runs and the number of digits that a second engine confirms."""
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


def ask(
    scene: Scene, truth: Reference, errors: tuple[float, ...], budget: Budget, saved: int = 1
) -> Question:
    longest, deadline = RUN_SHARE * budget.seconds, budget.begun + LAWS * budget.seconds
    return Question(scene, truth, errors, longest, deadline, saved)


def floor_of(truth: Reference) -> float:
    """Return the relative uncertainty of a reference, the least error that a race reports."""
    return max(10.0**-truth.digits, float(np.finfo(float).eps))


# -- search ----------------------------------------------------------------------------------------
def search(
    question: Question, methods: Sequence[str], first: Collection[str], budget: Budget
) -> list[Search]:
    """Search the settings of every method, likely leaders first and slow compilers last.

    In every pass each has an equal share of the time left, at least a least one; then the last ones are not begun.
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
    """Take turns until a time, at least one and for at least `least` seconds; return whether all are taken."""
    if any(True for _ in islice(turns, 1)):
        until = max(until, perf_counter() + least)
    return all(perf_counter() < until for _ in turns)


def stop(each: Search, budget: Budget) -> None:
    """Record why a search ended early."""
    last = each.finest
    if each.why is None and each.done:
        budget.unrefined.append(each.method.name)
    elif each.why is None and budget.interrupted:
        each.why = (INTERRUPTED, f"interrupted {f'after {last.setting}' if last else 'before it was tried'}")
    elif each.why is None:
        each.why = NOT_BEGUN if last is None else ("budget", f"no time was left after {last.setting}")


def reaching(searches: Iterable[Search], error: float, floor: float) -> list[tuple[Search, Attempt]]:
    """Return the searches that reach an error, each with its cheapest attempt."""
    return [(each, a) for each in searches if error >= floor and (a := each.best(error)) is not None]


# -- laws ------------------------------------------------------------------------------------------
def measure_laws(question: Question, searches: Sequence[Search], budget: Budget) -> Found:
    """Measure the laws at the settings that reach the errors, geometric and quick methods first."""
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
    """Return the deviations from the laws of a run that carries every field; nothing if there is no time."""
    scene, left, known = question.scene, budget.left(LAWS), question.truth
    found: dict[str, Any] = {}
    if left > COMPILING.get(search.engine, 0.0):  # carrying every field compiles another program
        with suppress(BadInput):  # the reference takes too long, or a function takes no arrays
            solution = search.along(attempt)()
            given = solution.carry == known.carry and np.array_equal(solution.elapsed, known.t)
            solution.truth = (
                known if given else reference(scene, Elapsed(solution.elapsed), solution.carry, left)
            )
            late = "" if differentiation_time(search, attempt) <= left else "no time was left"
            found = laws_row(solution, late, LEFT_OUT.__contains__)
    return found


def differentiation_time(search: Search, attempt: Attempt) -> float:
    """Estimate the seconds that the derivative of the map takes."""
    compilation = max(search.compile_s, CACHED) * (1 + (search.question.scene.motion / MANY) ** 3)
    return COMPILATIONS * compilation + RUNS * attempt.seconds


# -- times -----------------------------------------------------------------------------------------
def time_runs(question: Question, searches: Sequence[Search], budget: Budget) -> Found:
    """Time the settings that reach the errors in turns; leave out the slowest if time is short."""
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
    """Return the least round of the odd visits over the least round of the even visits."""
    return least(visits[1::2]) / least(visits[::2]) if len(visits) > 1 else math.nan
