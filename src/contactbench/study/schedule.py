"""The schedule of a race: reference, search, laws and timing, in that order, within a budget of time."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from contextlib import suppress
from dataclasses import replace
from itertools import accumulate
from time import perf_counter

import numpy as np
from tqdm import tqdm

from contactbench.blame import UserError
from contactbench.errors import BadInput
from contactbench.measure.clock import VISITS, Call, Race, Visit, least, ratio_column, time_columns
from contactbench.measure.laws import row as laws_row
from contactbench.measure.statistics import PROCESSES, margin, ties
from contactbench.methods.base import prepare
from contactbench.questions.contest import CUT
from contactbench.runs.experiment import Row
from contactbench.runs.search import Attempt, Question, Search
from contactbench.runs.settings import ENDS, carry_of, setting_to, times
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.solution import GROWING, Solution
from contactbench.truth import OutOfTime, Reference, confirmed, reference

#: by when, in parts of the budget, the reference (half of it is for high precision, the rest for two solvers), its
#: check, the search and the laws are over
REFERENCE, CHECK, SEARCH, LAWS = 0.4, 0.25, 0.65, 0.8
#: how much longer the rounds may take that every run is to have, and what is timed although all time is over
LATE = 0.05
#: seconds for the reference at least, which it takes to compile it on a loaded machine: without one there is no race
LEAST_REFERENCE = 5.0
#: calls of a run in the shortest race: to warm up, and a round of each visit
FEWEST_CALLS = 1 + VISITS
KINDS = ("compiled", "callbacks")
#: states of the motion that is kept to be drawn, and its components at most
DRAWN, LARGEST_DRAWN = 400, 1000
#: the part of the search that is kept for those that have begun: runs of one setting each are no race
SECOND_RUNS = 0.35
#: the part of the timing that the whole field gets; the rest is for those that may lead
FIELD = 0.6
#: who leads is settled where the margin of a pair is no wider than this, and left open after so many visits
SETTLED, MOST_OF_LEADERS = 1.06, 400
#: seconds that compiling the first method of an engine takes: without them it is not begun
COMPILING = {"jax": 5.0, "c++": 1.5}
#: a method without an order is begun as one of this
MIDDLE = 8
#: what a single run may take, as a share of the whole budget
RUN_SHARE = 0.006
#: what a derivative of the map costs, roughly: compilations of the solver, and runs
COMPILATIONS, RUNS = 2.0, 100.0
#: seconds that compiling a derivative takes at least, where the method itself was found compiled
CACHED = 0.2
#: measures of a run that are no laws, or that another one covers
LEFT_OUT = ("solution_error", "energy_increases")
#: components from which on compiling it takes longer, as their cube
MANY = 20


class Schedule:
    """The state of one race: what was found of each method, and the laws and times at the settings that reach an error.

    floor : what the reference may be off by, relative to the largest state; no error below is claimed.  unrefined :
    methods without a last search for a coarser setting.  leading : methods that may lead, if not all: the others, which
    are `last`, wait until these are done.  begun : when the budget began, by default now.
    """

    def __init__(
        self,
        scene: Scene,
        methods: list[str],
        errors: tuple[float, ...],
        budget: float,
        progress: bool = False,
        truth: Reference | None = None,
        leading: Collection[str] = (),
        begun: float | None = None,
    ) -> None:
        self.begun, self.budget = perf_counter() if begun is None else begun, budget
        self.bar = tqdm(total=len(methods) + 3, disable=None if progress else True, unit="", leave=False)
        self.bar.set_description("reference")
        truth = truth or self.reference_of(scene)
        self.question = Question(scene, truth, errors, RUN_SHARE * budget, self.begun + LAWS * budget)
        self.floor = max(10.0**-truth.digits, float(np.finfo(float).eps))
        self.confirmed = confirmed(truth, self.left(CHECK))
        if self.confirmed == 0:
            why = "a second engine confirms none of its digits"
            raise BadInput(f"no reference for scene {scene.name!r}: {why}")
        self.bar.update()
        self.searches = [Search(self.question, name) for name in methods]
        self.last = {each for each in self.searches if leading and each.method.name not in leading}
        self.interrupted = False
        self.unrefined: list[str] = []
        self.motion: Solution | None = None
        self.laws: dict[int, Row] = {}
        self.times: dict[int, Row] = {}
        self.truths: dict[tuple[tuple[str, ...], bytes], Reference | None] = {}
        #: how many times longer than foreseen the last derivative of a map took
        self.slower = 1.0

    def reference_of(self, scene: Scene) -> Reference:
        """Return the truth at the ends of the runs; raise `OutOfTime`, which says what budget or end time would do."""
        seconds = max(self.left(REFERENCE), LEAST_REFERENCE)
        try:
            return reference(scene, Elapsed(times(scene, ENDS)), carry_of(scene), seconds)
        except OutOfTime as why:
            ways = "a larger budget, an earlier t_end"
            if math.isfinite(why.needed):
                more = float(f"{max(why.needed / REFERENCE, 2 * self.budget):.2g}")
                sooner = float(f"{scene.t_end * min(seconds / why.needed, 0.5):.1g}")
                ways = f"--budget {more:g}s (budget={more:g}), t_end={sooner:g}"
            what = f"no reference for scene {scene.name!r} in its part of the budget, {seconds:.2g} s"
            raise OutOfTime(f"{what}: give {ways}, or reference=, your own", why.needed) from why

    def left(self, part: float) -> float:
        return self.begun + part * self.budget - perf_counter()

    def chosen(self, search: Search, error: float) -> Attempt | None:
        return search.best(error) if error >= self.floor else None

    def reaching(self, error: float) -> list[tuple[Search, Attempt]]:
        """Return the methods that reach an error, each with its setting."""
        return [(each, a) for each in self.searches if (a := self.chosen(each, error)) is not None]

    def run(self) -> None:
        """Do all of it; Ctrl-C ends it with what there is, a second time at once."""
        for stage in (self.search, self.follow_motion, self.measure_laws, self.time):
            try:
                with np.errstate(all="ignore"):  # long steps overflow, and end as diverged
                    stage()
            except KeyboardInterrupt:
                if self.interrupted:
                    break
                self.interrupted = True
                before, after = "interrupted before it was tried", "interrupted after"
                self.stop("interrupted", before, after, self.searches)
            self.bar.update()
        self.bar.close()

    # -- search ----------------------------------------------------------------------------------------
    def search(self) -> None:
        """Give every method a first run, then the next turn to what has had the least time.

        What a cheap method leaves goes to the others.  First runs: high orders first, those of JAX last, which compiles
        for seconds.  When most of the time is over those that have begun go on.
        """
        for each in self.searches:
            if (why := each.method.refuses(self.question.scene)) is not None:
                each.why = ("unsupported", why)
        ranked = sorted(self.searches, key=lambda one: (one.engine == "jax", -(one.method.order or MIDDLE)))
        turns = {each: each.turns() for each in ranked if each.why is None}
        self.bar.update(len(self.searches) - len(turns))
        kept = SECOND_RUNS * self.left(SEARCH)

        def turn(one: Search) -> tuple[bool, bool, float]:
            return one in self.last, bool(one.attempts) == (self.left(SEARCH) > kept), one.spent

        while turns and (left := self.left(SEARCH)) > 0:
            each = min(turns, key=turn)
            self.bar.set_description(each.method.name)
            seen = [one.compile_s for one in self.searches if one.engine == each.engine and one.compile_s]
            expected = 0.0 if each.attempts else max(COMPILING.get(each.engine, 0.0), min(seen, default=0.0))
            if expected > left:
                each.why = ("budget", f"compiling it takes about {expected:.2g} s, {left:.2g} s were left")
                del turns[each]
                continue
            begun, compiled = perf_counter(), each.compile_s
            try:
                next(turns[each])
            except OutOfTime:
                break
            except StopIteration:
                del turns[each]
                self.bar.update()
            each.spent += perf_counter() - begun - (each.compile_s - compiled)
        self.stop("budget", "no time was left to begin it", "no time was left after", turns)

    def stop(self, status: str, before: str, after: str, some: Iterable[Search]) -> None:
        for each in (each for each in some if each.why is None):
            last = each.finest
            if last is None:
                each.why = (status, before)
            elif not each.done:
                each.why = (status, f"{after} {last.setting}, {each.spent:.2g} s of its own")
            else:
                self.unrefined.append(each.method.name)

    @property
    def unbegun(self) -> list[str]:
        """Return the methods that may lead and that no time was left for."""
        cut = (each for each in self.searches if each.why and each.why[0] in (*CUT, "interrupted"))
        return [each.method.name for each in cut if not (each.attempts or each in self.last)]

    # -- motion ----------------------------------------------------------------------------------------
    def follow_motion(self) -> None:
        """Keep a run to be drawn: of those that reach the smallest error the one that is soonest done."""
        scene, found = self.question.scene, list[tuple[Search, Attempt]]()
        for error in self.question.errors:
            found = self.reaching(error) or found
        if not found or scene.motion > LARGEST_DRAWN or self.interrupted or self.left(LAWS) < 0:
            return
        search, attempt = min(found, key=lambda pair: pair[1].seconds)
        setting = setting_to(scene.t_end, scene, search.control, attempt.value)
        saves = None if search.control == GROWING else Elapsed(times(scene, DRAWN))
        with suppress(UserError):
            solution = prepare(scene, search.method, save_at=saves, engine=search.engine, **setting)()
            self.motion = solution if solution.ok else None

    # -- laws ------------------------------------------------------------------------------------------
    def measure_laws(self) -> None:
        self.bar.set_description("laws")
        for error in self.question.errors:
            order = lambda pair: (pair[0].method.family == "established", differentiation_time(*pair))  # noqa: E731
            for each, attempt in sorted(
                self.reaching(error), key=order
            ):  # first what may have something to keep
                if id(attempt) not in self.laws and not self.interrupted:
                    begun, foreseen = perf_counter(), differentiation_time(each, attempt)
                    self.laws[id(attempt)] = self.laws_at(each, attempt)
                    self.slower = max(1.0, (perf_counter() - begun) / foreseen)

    def laws_at(self, search: Search, attempt: Attempt) -> Row:
        """Return how far a run that carries every field is from the laws; nothing where that would take too long."""
        scene, left = self.question.scene, self.left(LAWS)
        if left < (search.compile_s if search.engine == "jax" else 0.0):  # another field is another program
            return {}
        options = setting_to(scene.t_end, scene, search.control, attempt.value) | {"engine": search.engine}
        saves = Elapsed(times(scene, ENDS)) if search.control != GROWING else None
        solution = prepare(scene, search.method, save_at=saves, **options)()
        if (truth := self.truth_of(solution)) is None:
            return {}
        late = "" if self.slower * differentiation_time(search, attempt) <= left else "no time was left"
        try:
            return laws_row(replace(solution, truth=truth), late, LEFT_OUT.__contains__)
        except UserError:  # a function of floats, and laws are taken of arrays
            return {}

    def truth_of(self, solution: Solution) -> Reference | None:
        """Return the truth of a run with every field, None where it takes longer than there is."""
        t, carry, known = solution.elapsed, solution.carry, self.question.truth
        if carry == known.carry and np.array_equal(t, known.t):
            return known
        if (carry, t.tobytes()) not in self.truths:
            found = None
            with suppress(OutOfTime):
                found = reference(solution.scene, Elapsed(t), carry, self.left(LAWS))
            self.truths[carry, t.tobytes()] = found
        return self.truths[carry, t.tobytes()]

    # -- times -----------------------------------------------------------------------------------------
    def time(self) -> None:
        """Time each kind of engine by itself, the compiled first; the slowest are left out where time is short."""
        self.bar.set_description("timing")
        runs: dict[str, dict[int, Attempt]] = {kind: {} for kind in KINDS}
        for each, attempt in (pair for error in self.question.errors for pair in self.reaching(error)):
            runs[each.kind][id(attempt)] = attempt
        least = sum(FEWEST_CALLS * attempt.seconds for attempt in runs["callbacks"].values())
        for kind in KINDS:
            left = max(self.left(1.0), LATE * self.budget)
            given = max(left - (least if kind == "compiled" else 0.0), left / 2, 0.0)
            attempts = sorted(runs[kind].values(), key=lambda attempt: attempt.seconds)
            spent = accumulate(FEWEST_CALLS * attempt.seconds for attempt in attempts)
            timed = [attempt for attempt, seconds in zip(attempts, spent, strict=True) if seconds <= given]
            race = Race([Call(a.run.bare_call()) for a in timed if a.run])
            until, late = perf_counter() + given, max(self.left(1 + LATE), LATE * self.budget)
            try:
                race.go(0.0 if self.interrupted else FIELD * given, late)
                if not self.interrupted:
                    self.settle(race, [id(attempt) for attempt in timed], until)
            finally:
                visited = zip(timed, race.visits, strict=True)
                self.times |= {id(attempt): time_columns(visits) for attempt, visits in visited if visits}

    def settle(self, race: Race, timed: list[int], until: float) -> None:
        """Visit those that may lead, and no others, until it is decided who does or time is over."""
        while some := self.unsettled(race, timed):
            for _ in range(VISITS):
                for _ in race.sweep(some=some):
                    if perf_counter() > until:
                        return

    def unsettled(self, race: Race, timed: list[int]) -> list[int]:
        """Return which calls stand so near to the least of an error that the clock does not tell them apart yet."""
        found = set[int]()
        for error in self.question.errors:
            reach = [e for e in self.question.errors if e <= error]
            chosen = ({id(a) for e in reach if (a := self.chosen(each, e))} for each in self.searches)
            runs = [[i for i in map(timed.index, own & {*timed}) if race.visits[i]] for own in chosen]
            seconds = lambda i: least(race.visits[i])  # noqa: E731
            ranked = sorted((min(own, key=seconds) for own in runs if own), key=seconds)
            for other in ranked[1:]:
                first, second = race.visits[ranked[0]], race.visits[other]
                apart = margin((halves(first), halves(second)), PROCESSES)
                if apart > SETTLED and ties(least(second), least(first), apart):
                    found |= {ranked[0], other}
        return sorted(i for i in found if len(race.visits[i]) < MOST_OF_LEADERS)


def halves(visits: list[Visit]) -> float:
    return ratio_column("halves", least, visits[::2], visits[1::2]).get("halves", math.inf)


def differentiation_time(search: Search, attempt: Attempt) -> float:
    scene = search.question.scene
    compilation = max(search.compile_s, CACHED) * (1 + (scene.motion / MANY) ** 3)
    return COMPILATIONS * compilation + RUNS * attempt.seconds
