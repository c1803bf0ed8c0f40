"""`compare`: reference, scouting, timing and laws, in that order, within a budget of time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from time import perf_counter, process_time
from typing import Any

import pandas as pd
from tqdm import tqdm

from contactbench.errors import BadInput, finite, listed, positive, shown, switch
from contactbench.measure.clock import VISITS, Call, Race, time_columns
from contactbench.methods.base import METHODS
from contactbench.methods.entry import lookup
from contactbench.race.keeping import expected, laws_at
from contactbench.race.scout import Attempt, Question, Scouted, ends, scout
from contactbench.race.table import table
from contactbench.scene import Scene
from contactbench.truth import confirmed, reference

ERRORS = (1e-3, 1e-6, 1e-9)
BUDGET = 60.0
#: by when, in parts of the budget, the reference, its check, the scouting and the laws are over
REFERENCE, CHECK, SCOUTING, LAWS = 0.4, 0.42, 0.6, 0.8
#: calls of a run in the shortest race: to warm up, and a round of each visit
FEWEST_CALLS = 1 + VISITS
KINDS = ("compiled", "callbacks")
#: seconds that compiling the first method of an engine takes on an idle core: without them it is not begun
COMPILING = {"jax": 5.0, "c++": 1.5}
#: times as long on a loaded machine, at most, by what share of the time this process has had so far
MOST_WAITING = 4.0
#: what compiles so slowly begins when every other method is done or had this part of the budget
PATIENCE = 0.03


def compare(
    scene: Scene | str,
    methods: Sequence[str] | None = None,
    errors: Iterable[float] = ERRORS,
    budget: float = BUDGET,
    progress: bool = False,
) -> pd.DataFrame:
    """A work–precision race on one scene: what each method costs at each error, and what it keeps.

    scene : a scene or the name of one.  methods : names, by default all.  errors : asked for, of
        max ‖y − y*‖ / max ‖y*‖ over the ends of five runs.  budget : seconds for everything.
    progress : a bar on stderr, where that is a terminal.

    Each method is tried from its coarsest setting to the one that reaches the smallest error, on the first
    of its engines that can run the scene; the settings that reach the errors are then timed in turns, as bare
    calls, each eight times or more.  Times are compared within a kind of engine: compiled, or calling back into Python.

    Returns one row for each method and error, columns: scene, method, family, engine, kind, error_asked,
    setting, error_reached, time_s (the least round), evaluations (of the right-hand side, or what equals one), ratio
    (to the least time of its kind at that error), margin (the ratio up to which the two cannot be told apart), verdict
    (cheapest, tie, undecided where the margin is too wide to judge, or ×ratio), laws_kept, a column for each law,
    status, reason (why a method got no further, or was not timed).  ``attrs``: "reference" (source, digits, digits
    confirmed by a second engine, error: smaller ones are not claimed), "runs" (every setting tried), "unrefined"
    (methods without a last search for a coarser setting), "interrupted", "seconds".
    Ctrl-C ends it with what there is.  Raises `BadInput`, also where no reference can be computed.
    """
    scene, _ = lookup(scene, next(iter(METHODS)))
    given = listed("methods", METHODS if methods is None else methods, "a list of names")
    for name in given:
        METHODS[name]  # an unknown one raises
    names = list(dict.fromkeys(given))
    asked = listed("errors", errors, "a list of numbers, as in errors=[1e-3, 1e-6]")
    wanted = tuple(sorted({_error(error) for error in asked}, reverse=True))
    if not wanted:
        raise BadInput("errors: at least one, as in errors=[1e-3, 1e-6]")
    switch("progress", progress)
    return Comparison(scene, names, wanted, positive("budget", budget), progress).frame()


def _error(value: Any) -> float:
    error = finite("error", value)
    if not 0 < error < 1:
        raise BadInput(f"error = {shown(value)}: must be between 0 and 1, relative to the size of the motion")
    return error


class Comparison:
    """The state of one comparison; `frame` runs it to its end."""

    def __init__(
        self, scene: Scene, methods: list[str], errors: tuple[float, ...], budget: float, progress: bool
    ) -> None:
        self.begun, self.computed, self.budget = perf_counter(), process_time(), budget
        self.bar = tqdm(total=len(methods) + 3, disable=None if progress else True, unit="", leave=False)
        self.interrupted = False
        self.say("reference")
        truth = reference(scene, ends(scene), seconds=self.left(REFERENCE))
        self.question = Question(scene, truth, errors, budget)
        self.compiling = dict(COMPILING)
        self.confirmed = confirmed(truth, self.left(CHECK))
        self.bar.update()
        self.scouted = [Scouted(name, METHODS[name].engines[0]) for name in methods]
        self.chosen: dict[tuple[str, float], Attempt] = {}
        self.times: dict[int, dict[str, Any]] = {}
        self.untimed: dict[int, str] = {}
        self.unrefined: list[str] = []
        self.laws: dict[int, dict[str, float]] = {}

    def left(self, part: float) -> float:
        """Seconds until that part of the budget is spent."""
        return self.begun + part * self.budget - perf_counter()

    def say(self, what: str) -> None:
        self.bar.set_description(what)

    def frame(self) -> pd.DataFrame:
        for stage in (self.scout_all, self.measure_laws, self.time_all):
            try:
                stage()
            except KeyboardInterrupt:
                if self.interrupted:  # a second time: at once
                    break
                self.interrupted = True
                self.stop("interrupted", "interrupted before it was tried", "interrupted after")
            self.bar.update()
        self.bar.close()
        made = table(self.question, self.scouted, self.chosen, self.times, self.laws, self.untimed)
        truth = self.question.truth
        made.attrs |= {
            "reference": {
                "source": truth.source, "digits": truth.digits, "confirmed": self.confirmed,
                "error": self.question.floor(),
            },
            "unrefined": self.unrefined, "interrupted": self.interrupted,
            "seconds": perf_counter() - self.begun,
        }  # fmt: skip
        return made

    def scout_all(self) -> None:
        """The method that has had the least time is next, so that what a cheap one leaves goes to the others."""
        turns = {}
        for each in self.scouted:
            if (why := METHODS[each.method].refuses(self.question.scene)) is not None:
                each.why = ("unsupported", why)
            else:
                turns[each.method] = scout(self.question, each)
        self.bar.update(len(self.scouted) - len(turns))
        while turns and self.left(SCOUTING) > 0:
            each = min((s for s in self.scouted if s.method in turns), key=self.waited)
            self.say(each.method)
            if not each.attempts and not self.compiles_in_time(each):
                del turns[each.method]
                continue
            begun, first = perf_counter(), not each.attempts
            if next(turns[each.method], self) is self:  # it is done
                del turns[each.method]
                self.bar.update()
            each.spent += perf_counter() - begun - (each.compile_s if first else 0.0)
            if first and each.engine in COMPILING:
                self.compiling[each.engine] = max(each.compile_s, COMPILING[each.engine] / 2)
        self.stop("budget", "no time was left to begin it", "no time was left after", set(turns))

    def waited(self, each: Scouted) -> float:
        """Seconds a method has had; what compiles slowly lets the others go first."""
        begun = each.attempts or each.engine not in COMPILING
        return each.spent if begun else PATIENCE * self.budget

    def compiles_in_time(self, each: Scouted) -> bool:
        """Whether there is time to compile it, by what the last one of its engine took or this machine's load."""
        expected = self.compiling.get(each.engine, 0.0)
        if expected and self.compiling[each.engine] == COMPILING[each.engine]:  # none of them yet
            waiting = (perf_counter() - self.begun) / max(process_time() - self.computed, 0.1)
            expected *= min(max(1.0, waiting), MOST_WAITING)
        if expected <= self.left(SCOUTING):
            return True
        each.why = (
            "budget",
            f"compiling it takes about {expected:.2g} s, {self.left(SCOUTING):.2g} s were left",
        )
        return False

    def stop(self, status: str, before: str, after: str, names: set[str] | None = None) -> None:
        """Say of the methods that were not done how far they got, and choose from what there is."""
        for each in self.scouted:
            if each.why is None and (names is None or each.method in names):
                last = each.finest()
                if last is None:
                    each.why = (status, before)
                elif each.best(min(self.question.errors)) is None:
                    each.why = (status, f"{after} {last.setting}, {each.spent:.2g} s of its own")
                else:
                    self.unrefined.append(each.method)
        self.choose()

    def choose(self) -> None:
        """For each method and error the cheapest setting that reaches it."""
        for each in self.scouted:
            for error in self.question.errors:
                if error >= self.question.floor() and (best := each.best(error)) is not None:
                    self.chosen[each.method, error] = best

    def time_all(self) -> None:
        """A race for each kind of engine; the compiled first, which is soon over.  The slowest are left out where
        the fewest rounds of all would take longer than there is."""
        self.say("timing")
        kinds = {each.method: each.kind for each in self.scouted}
        runs = {
            kind: {id(a): a for (name, _), a in self.chosen.items() if kinds[name] == kind} for kind in KINDS
        }
        least = {kind: sum(FEWEST_CALLS * a.seconds for a in runs[kind].values()) for kind in KINDS}
        for kind in KINDS:
            kept = sum(
                least[later] for later in KINDS[KINDS.index(kind) + 1 :]
            )  # for those that are yet to come
            given = max(self.left(1.0) - kept, self.left(1.0) / 2, 0.0)
            seconds, fits = given, {}
            for key, attempt in sorted(runs[kind].items(), key=lambda item: item[1].seconds):
                seconds -= FEWEST_CALLS * attempt.seconds
                if seconds < 0:
                    self.untimed[key] = "too slow for the time that was left"
                else:
                    fits[key] = attempt
            race = Race([Call(bare(a)) for a in fits.values()])
            try:
                race.go(0.0 if self.interrupted else given)
            finally:
                self.times |= {key: time_columns(v) for key, v in zip(fits, race.visits, strict=True) if v}

    def measure_laws(self) -> None:
        """At the largest error first, so that there is something to say of every method; what is slow last."""
        self.say("laws")
        for error in self.question.errors:
            reached = [(s, a) for s in self.scouted if (a := self.chosen.get((s.method, error))) is not None]
            for each, chosen in sorted(reached, key=lambda pair: expected(*pair)):
                if id(chosen) not in self.laws and not self.interrupted:
                    self.laws[id(chosen)] = laws_at(self.question, each, chosen, self.left(LAWS))


def bare(attempt: Attempt) -> Any:
    """The solver's own call from the scene's initial state."""
    run = attempt.run
    assert run is not None
    start = run.start
    return lambda: run.bare(start)
