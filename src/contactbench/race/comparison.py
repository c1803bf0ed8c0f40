"""`compare`: reference, scouting, laws and timing, in that order, within a budget of time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from time import perf_counter
from typing import Any

import pandas as pd
from tqdm import tqdm

from contactbench.errors import BadInput, excerpt, finite, items_of, positive, switch
from contactbench.measure.clock import VISITS, Call, Race, time_columns
from contactbench.measure.laws import laws_of, row
from contactbench.measure.statistics import PROCESSES
from contactbench.methods.base import METHODS
from contactbench.methods.entry import lookup, prepare
from contactbench.race.scout import Attempt, Question, Scout, ends
from contactbench.results.contest import standings
from contactbench.scene import Scene
from contactbench.solution import keywords
from contactbench.truth import confirmed, reference

ERRORS = (1e-3, 1e-6, 1e-9)
BUDGET = 60.0
#: by when, in parts of the budget, the reference, its check, the scouting and the laws are over
REFERENCE, CHECK, SCOUTING, LAWS = 0.4, 0.42, 0.6, 0.8
#: seconds for the reference at least, which it takes to compile it on a loaded machine: without one there is no race
LEAST_REFERENCE = 5.0
#: calls of a run in the shortest race: to warm up, and a round of each visit
FEWEST_CALLS = 1 + VISITS
KINDS = ("compiled", "callbacks")
#: seconds that compiling the first method of an engine takes: without them it is not begun
COMPILING = {"jax": 5.0, "c++": 1.5}
#: what compiles so slowly begins when every other method is done or had this part of the budget
PATIENCE = 0.03
#: measures of a run that are no laws, or that another one covers
LEFT_OUT = ("solution_error", "energy_law_relative", "energy_increases", "own_factor_drift")
#: what a derivative of the map costs, roughly: compilations of the solver, and runs
COMPILATIONS, RUNS = 2.0, 100.0
#: types of the columns beside the laws
COLUMNS = dict.fromkeys(("scene", "method", "family", "engine", "kind"), "str")
COLUMNS |= {"error_asked": "float64", "setting": "str"}
COLUMNS |= dict.fromkeys(("error_reached", "time_s", "evaluations", "ratio", "margin"), "float64")
COLUMNS |= dict.fromkeys(("verdict", "laws_kept", "status", "reason"), "str")


def compare(
    scene: Scene | str,
    methods: Sequence[str] | None = None,
    errors: Iterable[float] = ERRORS,
    budget: float = BUDGET,
    progress: bool = False,
) -> pd.DataFrame:
    """Race methods on one scene: what each costs at each error, and what it keeps.

    Each method is tried from its coarsest setting to the one that reaches the smallest error, on the first
    of its engines that can run the scene; the settings that reach the errors are then timed in turns, as bare
    calls, each eight times or more.  Times are compared within a kind of engine: compiled, or calling back into Python.
    Ctrl-C ends it with what there is.

    Parameters
    ----------
    scene :
        A scene or the name of one.
    methods :
        Names, by default all.
    errors :
        Errors asked for, of max ‖y − y*‖ / max ‖y*‖ over the ends of five runs.
    budget :
        Seconds for everything; the reference may take five whatever it is.
    progress :
        Whether to show a bar on stderr, where that is a terminal.

    Returns
    -------
    pandas.DataFrame
        One row for each method and error, columns: scene, method, family, engine, kind, error_asked, setting,
        error_reached, time_s (the least round), evaluations (of the right-hand side, or what equals one), ratio (to
        the least time of its kind at that error), margin (the ratio up to which the two cannot be told apart), verdict
        (win; tie; undecided where the margin is too wide to judge; loss), laws_kept, a column for each law, status,
        reason (why a method got no further, or was not timed).  ``attrs``: "reference" (source, digits, digits
        confirmed by a second engine, error: smaller ones are not claimed), "runs" (every setting tried), "unrefined"
        (methods without a last search for a coarser setting), "interrupted", "seconds".

    Raises
    ------
    BadInput
        For a wrong argument, and where no reference can be computed.
    """
    scene, _ = lookup(scene, next(iter(METHODS)))
    given = items_of("methods", METHODS if methods is None else methods, "a list of names")
    for name in given:
        METHODS[name]  # an unknown one raises
    asked = items_of("errors", errors, "a list of numbers, as in errors=[1e-3, 1e-6]")
    wanted = tuple(sorted({_error(error) for error in asked}, reverse=True))
    if not wanted:
        raise BadInput("errors: at least one, as in errors=[1e-3, 1e-6]")
    switch("progress", progress)
    return Comparison(scene, list(dict.fromkeys(given)), wanted, positive("budget", budget), progress).frame()


def _error(value: Any) -> float:
    error = finite("error", value)
    if not 0 < error < 1:
        raise BadInput(
            f"error = {excerpt(value)}: must be between 0 and 1, relative to the size of the motion"
        )
    return error


class Comparison:
    """The state of one comparison; `frame` runs it to its end."""

    def __init__(
        self, scene: Scene, methods: list[str], errors: tuple[float, ...], budget: float, progress: bool
    ) -> None:
        self.begun, self.budget = perf_counter(), budget
        self.bar = tqdm(total=len(methods) + 3, disable=None if progress else True, unit="", leave=False)
        self.interrupted = False
        self.bar.set_description("reference")
        truth = reference(scene, ends(scene), seconds=max(self.left(REFERENCE), LEAST_REFERENCE))
        self.question = Question(scene, truth, errors, budget)
        self.compiling = dict(COMPILING)
        self.confirmed = confirmed(truth, self.left(CHECK))
        self.bar.update()
        self.scouts = [Scout(self.question, name) for name in methods]
        self.times: dict[int, dict[str, Any]] = {}
        self.too_slow: set[int] = set()
        self.unrefined: list[str] = []
        self.laws: dict[int, dict[str, Any]] = {}
        self.columns = {
            law.name: law.label or law.name
            for law in laws_of(scene)
            if law.name not in LEFT_OUT and not law.name.endswith("_frozen")
        }

    def left(self, part: float) -> float:
        """Return the seconds until that part of the budget is spent."""
        return self.begun + part * self.budget - perf_counter()

    def frame(self) -> pd.DataFrame:
        """Run all stages and return the rows, with every run in ``attrs``."""
        for stage in (self.scout, self.measure_laws, self.time):
            try:
                stage()
            except KeyboardInterrupt:
                if self.interrupted:  # a second time: at once
                    break
                self.interrupted = True
                self.stop("interrupted", "interrupted before it was tried", "interrupted after")
            self.bar.update()
        self.bar.close()
        question = self.question
        frame = pd.DataFrame([self.row(each, error) for each in self.scouts for error in question.errors])
        frame = judge_times(frame)
        frame = frame.reindex(columns=[*COLUMNS, *self.columns, "map_growth", "time_halves_ratio"]).astype(
            COLUMNS
        )
        truth = question.truth
        known = {"source": truth.source, "digits": truth.digits, "confirmed": self.confirmed}
        frame.attrs = {
            "runs": Runs(tried(self.scouts)),
            "reference": known | {"error": question.floor},
            "unrefined": self.unrefined,
            "interrupted": self.interrupted,
            "seconds": perf_counter() - self.begun,
        }
        return frame

    # -- scouting --------------------------------------------------------------------------------------
    def scout(self) -> None:
        """Give the next turn to the method that has had the least time, so that what a cheap one leaves goes to the
        others."""
        turns = {}
        for each in self.scouts:
            if (why := each.method.refuses(self.question.scene)) is not None:
                each.why = ("unsupported", why)
            else:
                turns[each] = each.turns()
        self.bar.update(len(self.scouts) - len(turns))
        while turns and self.left(SCOUTING) > 0:
            each = min(turns, key=self.waited)
            self.bar.set_description(each.method.name)
            if not each.attempts and (expected := self.compiling.get(each.engine, 0.0)) > self.left(SCOUTING):
                left = f"{self.left(SCOUTING):.2g} s were left"
                each.why = ("budget", f"compiling it takes about {expected:.2g} s, {left}")
                del turns[each]
                continue
            begun, first = perf_counter(), not each.attempts
            if next(turns[each], self) is self:  # it is done
                del turns[each]
                self.bar.update()
            each.spent += perf_counter() - begun - (each.compile_s if first else 0.0)
            if first and each.engine in COMPILING:
                self.compiling[each.engine] = max(each.compile_s, COMPILING[each.engine] / 2)
        self.stop("budget", "no time was left to begin it", "no time was left after", set(turns))

    def waited(self, each: Scout) -> float:
        """Return the seconds a method has had; what compiles slowly lets the others go first."""
        begun = each.attempts or each.engine not in COMPILING
        return each.spent if begun else PATIENCE * self.budget

    def stop(self, status: str, before: str, after: str, some: set[Scout] | None = None) -> None:
        """Note of the methods that were not done how far they got."""
        for each in self.scouts if some is None else some:
            last = each.finest
            if each.why is not None:
                continue
            if last is None:
                each.why = (status, before)
            elif each.best(min(self.question.errors)) is None:
                each.why = (status, f"{after} {last.setting}, {each.spent:.2g} s of its own")
            else:
                self.unrefined.append(each.method.name)

    def chosen(self, each: Scout, error: float) -> Attempt | None:
        """Return the cheapest setting of a method that reaches an error; None below what the reference can tell."""
        return each.best(error) if error >= self.question.floor else None

    # -- laws and times --------------------------------------------------------------------------------
    def measure_laws(self) -> None:
        """Measure the laws, at the largest error first, so that there is something of every method; slow runs last."""
        self.bar.set_description("laws")
        for error in self.question.errors:
            pairs = [(each, a) for each in self.scouts if (a := self.chosen(each, error)) is not None]
            for each, attempt in sorted(pairs, key=lambda pair: differentiation_time(*pair)):
                if id(attempt) not in self.laws and not self.interrupted:
                    self.laws[id(attempt)] = self.laws_at(each, attempt)

    def laws_at(self, each: Scout, attempt: Attempt) -> dict[str, Any]:
        """Return how far a run that carries every field is from the laws at the five times, and which it keeps.

        What is expected to take longer than there is time is left out.
        """
        scene, left = self.question.scene, self.left(LAWS)
        if left < (each.compile_s if each.engine == "jax" else 0.0):  # another field is another program
            return {}
        options: dict[str, Any] = {**keywords(each.method.control, attempt.value), "engine": each.engine}
        solution = prepare(scene, each.method.name, save_at=ends(scene), **options)()
        return row(solution, "" if differentiation_time(each, attempt) <= left else "no time was left")

    def time(self) -> None:
        """Time the chosen settings, each kind of engine by itself; the compiled first, which is soon over.

        The slowest are left out where the fewest rounds of all would take longer than there is.
        """
        self.bar.set_description("timing")
        runs: dict[str, dict[int, Attempt]] = {kind: {} for kind in KINDS}
        for each in self.scouts:
            attempts = filter(None, (self.chosen(each, error) for error in self.question.errors))
            runs[each.kind] |= {id(attempt): attempt for attempt in attempts}
        least = sum(FEWEST_CALLS * attempt.seconds for attempt in runs["callbacks"].values())
        for kind in KINDS:
            left = self.left(1.0)
            given = max(left - (least if kind == "compiled" else 0.0), left / 2, 0.0)
            seconds, fits = given, {}
            for key, attempt in sorted(runs[kind].items(), key=lambda item: item[1].seconds):
                seconds -= FEWEST_CALLS * attempt.seconds
                if seconds < 0:
                    self.too_slow.add(key)
                else:
                    fits[key] = attempt
            race = Race([Call(bare(attempt)) for attempt in fits.values()])
            try:
                race.go(0.0 if self.interrupted else given)
            finally:
                self.times |= {key: time_columns(v) for key, v in zip(fits, race.visits, strict=True) if v}

    # -- rows ------------------------------------------------------------------------------------------
    def row(self, each: Scout, error: float) -> dict[str, Any]:
        """Return the row of a method at an error."""
        known, times, laws = self.unreached(each, error), {}, {}
        if (attempt := self.soonest(each, error)) is not None:
            times, laws = self.times.get(id(attempt), {}), self.laws.get(id(attempt), {})
            reason = "too slow for the time that was left" if id(attempt) in self.too_slow else ""
            known = reached(attempt, self.question.floor) | {"status": "ok", "reason": reason}
        row = {"scene": self.question.scene.name, "method": each.method.name, "family": each.method.family}
        row |= {"engine": each.engine, "kind": each.kind, "error_asked": error, **known}
        row |= {"time_s": times.get("time_min_s", math.nan)}
        row |= {name: laws.get(name, math.nan) for name in (*self.columns, "map_growth")}
        row |= {"time_halves_ratio": times.get("time_halves_ratio", math.nan)}
        return row | {
            "laws_kept": ", ".join(label for law, label in self.columns.items() if laws.get(f"{law}_kept"))
        }

    def soonest(self, each: Scout, error: float) -> Attempt | None:
        """Return which of the settings chosen for an error or a smaller one is the soonest done."""
        if self.chosen(each, error) is None:
            return None
        reach = filter(None, (self.chosen(each, e) for e in self.question.errors if e <= error))
        return min(reach, key=lambda a: self.times.get(id(a), {}).get("time_median_s", math.inf))

    def unreached(self, each: Scout, error: float) -> dict[str, Any]:
        """Return how far a method got, and why no further."""
        best = min((a for a in each.attempts if a.ok), key=lambda a: a.error, default=None)
        known = (
            {"setting": "", "error_reached": math.nan} if best is None else reached(best, self.question.floor)
        )
        last = each.finest
        if error < self.question.floor:
            why = ("unresolved", f"the reference is known to {self.question.floor:.1e} only")
        elif each.why is not None:
            why = each.why
        elif last is not None and not last.ok:
            why = (str(last.status), f"{last.setting}: {last.message}")
        else:
            assert last is not None
            why = ("unreached", f"no setting is as accurate, tried down to {last.setting}")
        return known | {"evaluations": math.nan, "status": why[0], "reason": why[1]}


def differentiation_time(each: Scout, attempt: Attempt) -> float:
    """Return about how many seconds the derivative of the map takes."""
    return COMPILATIONS * each.compile_s + RUNS * attempt.seconds


def bare(attempt: Attempt) -> Any:
    """Return the solver's own call from the scene's initial state."""
    run = attempt.run
    assert run is not None
    start = run.start
    return lambda: run.bare(start)


def reached(attempt: Attempt, floor: float) -> dict[str, Any]:
    work = attempt.counts.rhs_equivalents
    return {
        "setting": attempt.setting,
        "error_reached": max(attempt.error, floor),
        "evaluations": math.nan if work is None else work,
    }


def judge_times(frame: pd.DataFrame) -> pd.DataFrame:
    """Add ratio, margin and verdict of every time, beside the least of its kind at its error."""
    costs = frame.assign(
        cost=frame["time_s"], halves=frame["time_halves_ratio"], processes=PROCESSES, place=range(len(frame))
    )
    judged = standings(costs, ("kind", "error_asked")).sort_values("place", ignore_index=True)
    return judged.drop(columns=["cost", "halves", "processes", "place"])


class Runs(tuple):
    """Rows that are not copied: pandas makes a deep copy of all ``attrs`` in every operation on a frame."""

    def __deepcopy__(self, memo: object) -> Runs:
        return self


def tried(scouts: Iterable[Scout]) -> Iterator[dict[str, Any]]:
    """Yield every setting tried, of each method from coarse to fine."""
    for each in scouts:
        for a in sorted(each.attempts, key=lambda a: -a.value):
            known = {"method": each.method.name, "engine": each.engine, "kind": each.kind}
            ended = {"value": a.value, "status": str(a.status), "message": a.message, "error": a.error}
            yield known | ended | reached(a, 0.0)
