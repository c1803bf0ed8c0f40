"""`compare`: reference, scouting, timing and laws, in that order, within a budget of time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from time import perf_counter
from typing import Any

import pandas as pd
from tqdm import tqdm

from contactbench.errors import BadInput, finite, listed, positive, shown, switch
from contactbench.measure.clock import Race
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
KINDS = ("compiled", "callbacks")
#: seconds it takes XLA to compile an adaptive solver: without them it is not begun
COMPILING = {"jax": 8.0}


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
    calls, each twice.  Times are compared within a kind of engine: compiled, or calling back into Python.

    Returns one row for each method and error, columns: scene, method, family, engine, kind, error_asked,
    setting, error_reached, time_s (median), evaluations (of the right-hand side, or what equals one), ratio (to
    the least time of its kind at that error), verdict (cheapest, tie, or ×ratio), laws_kept, a column for each
    law, status, reason.  ``attrs``: "reference" (source, digits, digits confirmed by a second engine, error:
    smaller ones are not claimed), "margins" (by kind: the ratio up to which times are a tie, measured as A/A),
    "runs" (every setting tried), "interrupted", "seconds".
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
        self.begun, self.budget, self.methods = perf_counter(), budget, methods
        self.bar = tqdm(total=len(methods) + 3, disable=None if progress else True, unit="", leave=False)
        self.interrupted = False
        self.say("reference")
        truth = reference(scene, ends(scene), seconds=self.left(REFERENCE))
        self.question = Question(scene, truth, errors, budget)
        self.confirmed = confirmed(truth, self.left(CHECK))
        self.bar.update()
        self.scouted: list[Scouted] = []
        self.chosen: dict[tuple[str, float], Attempt] = {}
        self.times: dict[int, dict[str, Any]] = {}
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
                self.choose()
            self.bar.update()
        self.bar.close()
        self.fill_up()
        made = table(self.question, self.scouted, self.chosen, self.times, self.laws)
        truth = self.question.truth
        made.attrs |= {
            "reference": {
                "source": truth.source, "digits": truth.digits, "confirmed": self.confirmed,
                "error": self.question.floor(),
            },
            "interrupted": self.interrupted,
            "seconds": perf_counter() - self.begun,
        }  # fmt: skip
        return made

    def scout_all(self) -> None:
        """What compiles slowly comes last, and only while there is time."""
        for name in sorted(self.methods, key=lambda name: COMPILING.get(METHODS[name].engines[0], 0)):
            self.say(name)
            item = METHODS[name]
            if (
                self.left(SCOUTING) < COMPILING.get(item.engines[0], 0)
                and item.refuses(self.question.scene) is None
            ):
                self.scouted.append(Scouted(name, item.engines[0], why=("budget", "no time left for it")))
            else:
                self.scouted.append(scout(self.question, name, self.begun + SCOUTING * self.budget))
            self.bar.update()
        self.choose()

    def choose(self) -> None:
        """For each method and error the cheapest setting that reaches it."""
        for each in self.scouted:
            for error in self.question.errors:
                if error >= self.question.floor() and (best := each.best(error)) is not None:
                    self.chosen[each.method, error] = best

    def time_all(self) -> None:
        """A race for each kind of engine; the compiled first, which is soon over."""
        self.say("timing")
        kinds = {each.method: each.kind for each in self.scouted}
        for kind in KINDS:
            attempts = {id(a): a for (name, _), a in self.chosen.items() if kinds[name] == kind}
            race = Race([bare(a) for a in attempts.values()])
            try:
                race.go(0.0 if self.interrupted else max(0.0, self.left(1.0)))
            finally:
                self.times |= {key: race.columns(i) for i, key in enumerate(attempts)}

    def measure_laws(self) -> None:
        """At the largest error first, so that there is something to say of every method; what is slow last."""
        self.say("laws")
        for error in self.question.errors:
            reached = [(s, a) for s in self.scouted if (a := self.chosen.get((s.method, error))) is not None]
            for each, chosen in sorted(reached, key=lambda pair: expected(*pair)):
                if id(chosen) not in self.laws and not self.interrupted:
                    self.laws[id(chosen)] = laws_at(self.question, each, chosen, self.left(LAWS))

    def fill_up(self) -> None:
        """The methods it did not come to, in the order asked for."""
        known = {each.method: each for each in self.scouted}
        missing = ("interrupted", "interrupted before it was tried")
        self.scouted = [
            known.get(name) or Scouted(name, METHODS[name].engines[0], why=missing) for name in self.methods
        ]


def bare(attempt: Attempt) -> Any:
    """The solver's own call from the scene's initial state."""
    run = attempt.run
    assert run is not None
    start = run.start
    return lambda: run.bare(start)
