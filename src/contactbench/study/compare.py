"""Methods raced on one scene, the user's own for example: `compare`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from time import perf_counter

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from contactbench.blame import their_code
from contactbench.checks import finite, function, items_of, positive, real_array, switch
from contactbench.errors import BadInput, excerpt
from contactbench.measure.laws import laws_of
from contactbench.measure.statistics import PROCESSES
from contactbench.methods.base import METHODS
from contactbench.questions.contest import CUT, standings
from contactbench.runs.experiment import Row
from contactbench.runs.search import Attempt, Search
from contactbench.runs.settings import ENDS, carry_of, times
from contactbench.scene import Scene
from contactbench.scene.base import scene_of
from contactbench.solution import Solution
from contactbench.study.field import field
from contactbench.study.race import symbol
from contactbench.study.recommendation import recommendation
from contactbench.study.schedule import LEFT_OUT, Schedule
from contactbench.truth import Reference

ERRORS = (1e-3, 1e-6, 1e-9)
#: every method races
ALL = "all"
#: seconds of a race of the methods that lead on such problems, and of any others
BUDGET, LONG_BUDGET = 15.0, 50.0
#: a run made once may take so many times as long as its least round
ONCE = 2.0
#: seconds from which on a run is more than the call from Python
SLOW = 1e-3
#: methods at most that a reason names
NAMED = 3
#: types of the columns beside the laws
COLUMNS = dict.fromkeys(("scene", "method", "family", "engine", "kind"), "str")
COLUMNS |= {"error_asked": "float64", "setting": "str"}
COLUMNS |= dict.fromkeys(("error_reached", "time_s", "evaluations", "ratio", "margin", "at_least"), "float64")
COLUMNS |= dict.fromkeys(("verdict", "laws_kept", "laws_undecided", "status", "reason"), "str")


def compare(
    scene: Scene | str,
    methods: Sequence[str] | str | None = None,
    errors: Iterable[float] = ERRORS,
    budget: float | None = None,
    progress: bool = False,
    reference: Callable[[np.ndarray], ArrayLike] | None = None,
) -> pd.DataFrame:
    """Race methods on one scene: what each costs at each error, and what it keeps.

    Each method is tried from its coarsest setting to the one that reaches the smallest error, on the first
    of its engines that can run the scene; the settings that reach the errors are then timed in turns, as bare
    calls, each eight times or more, fewer on a machine too busy for that, and those that may lead until it is clear
    who does.  Times are compared within a kind of engine: compiled, or calling back into Python.
    Ctrl-C ends it with what there is.

    Parameters
    ----------
    scene :
        A scene or the name of one.  Where it `slows_after` some time, fixed steps grow geometrically.
    methods :
        Names; or "all", the most likely to lead first.  By default those that lead on problems like this one: on a
        fifth of the random problems of its kind and about its damping (of a kind without any, of the named scenes)
        they cost at most a quarter more than the least, in time or evaluations; beside them `rk4`, DOP853, CVODE's
        Adams method and what plug-ins bring.  Where no tables are installed all race.
    errors :
        Errors asked for, of ``max ‖y − y*‖ / max ‖y*‖`` over the ends of five runs and, of y*, the start: of q, p, M, R
        and each component with a unit of its own the largest.  `scale=` of the scene says what else they are parts of,
        `attitude=False` of a body that its R does not count.
    budget :
        Seconds for everything, by default 15, and 50 where `methods` are given; the reference may take five
        whatever it is.
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
        the least time of its kind at that error), margin (the ratio up to which the two cannot be told apart),
        at_least (seconds that it takes anyway where it was cut off or not timed), verdict (win; tie; undecided where
        the margin is too wide to judge, or a rival was cut off that might be sooner done; loss), laws_kept,
        laws_undecided (their round-off may hide a drift), a column for each law, status, reason (why a method got
        no further, was not timed, or is undecided).
        ``attrs``: "recommendation" (what to take, a sentence for each error),
        "reference" (source, digits, digits confirmed by a second engine, error: smaller ones are not
        claimed), "runs" (every setting tried), "motion" (states and energies of a run of the smallest error),
        "carry" (which of s and R the runs carry), "of_floats" (functions that cannot be recorded), "unbegun" (methods
        that no time was left for), "unrefined" (those without a last search for a coarser setting), "interrupted",
        "seconds".

    Raises
    ------
    BadInput
        For a wrong argument, and where no reference can be computed.
    """
    begun, scene = perf_counter(), scene_of(scene)
    every = isinstance(methods, str) and methods == ALL
    given = [] if methods is None or every else items_of("methods", methods, "a list of names, or 'all'")
    if not (given or methods is None or every):
        raise BadInput("methods = []: must be names, at least one, or 'all'")
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
    seconds = (BUDGET if methods is None else LONG_BUDGET) if budget is None else positive("budget", budget)
    leading = [] if given else field(scene, wanted)
    raced = list(dict.fromkeys(given)) or ([] if every else leading) or list(METHODS)
    race = Schedule(scene, raced, wanted, seconds, progress, truth, leading, begun)
    race.run()
    frame = frame_of(race)
    frame.attrs["recommendation"] = list(recommendation(frame))
    frame.attrs["seconds"] = perf_counter() - begun
    return frame


def users_reference(scene: Scene, given: Callable[[np.ndarray], ArrayLike]) -> Reference:
    """Return what a user's function says of the states at the ends of the runs; raise `BadInput` for other shapes."""
    function("reference", given)
    carry, t = carry_of(scene), times(scene, ENDS)
    labels = ", ".join(scene.labels(carry)[:8])
    wanted = f"a function of the times that gives a row of {labels} for each"
    with their_code("reference"):
        y = real_array("reference", given(t + scene.begins), wanted)
    if y.shape != (shape := (len(t), len(scene.labels(carry)))) or not np.isfinite(y).all():
        raise BadInput(f"reference: gives shape {y.shape}: must be {shape}, finite, for each time {labels}")
    return Reference(scene, carry, t, y, [], np.finfo(float).precision, "given")


# -- rows ------------------------------------------------------------------------------------------
class Runs(tuple[Row, ...]):
    """Rows of every setting tried; pandas copies ``attrs`` deeply at every turn, which would take it seconds."""

    def __deepcopy__(self, memo: object) -> Runs:
        return self


def frame_of(race: Schedule) -> pd.DataFrame:
    scene, truth = race.question.scene, race.question.truth
    frame = pd.DataFrame([row(race, each, error) for each in race.searches for error in race.question.errors])
    columns = [*COLUMNS, *laws_in(scene), "map_growth", "time_halves_ratio"]
    frame = with_reasons(with_verdicts(frame)).reindex(columns=columns).astype(COLUMNS)
    known = {"source": truth.source, "digits": truth.digits, "confirmed": race.confirmed}
    frame.attrs = {
        "runs": Runs(run for each in race.searches for run in runs_of(each)),
        "reference": known | {"error": race.floor},
        "undamped": scene.is_undamped,
        "of_floats": scene.functions_of_floats,
        "unbegun": race.unbegun,
        "unrefined": race.unrefined,
        "carry": list(carry_of(scene)),
        "interrupted": race.interrupted,
        "motion": motion(race.motion),
    }
    return frame


def motion(solution: Solution | None) -> Runs:
    """Return the states of a run to be drawn and its energies, a row for each time, and which run it is."""
    if solution is None:
        return Runs()
    frame = solution.to_frame().assign(**{label: values for label, values, _ in solution.energies()})
    frame = frame.assign(run=f"{solution.method}, {solution.setting}")
    return Runs(frame.to_dict("records"))


def laws_in(scene: Scene) -> list[str]:
    """Return the laws that have a column."""
    return [law.name for law in laws_of(scene) if law.name not in LEFT_OUT]


def runs_of(search: Search) -> Iterator[Row]:
    known = {"method": search.method.name, "engine": search.engine, "kind": search.kind}
    for a in sorted(search.attempts, key=lambda a: -a.value):
        ended = {"value": a.value, "status": str(a.status), "message": a.message, "error": a.error}
        yield known | ended | a.columns(0.0)


def row(race: Schedule, search: Search, error: float) -> Row:
    """Return a row; at_least : seconds that it takes anyway, where it was cut off or left untimed, else nan."""
    known, clock, laws = unreached(race, search, error), {}, {}
    if (attempt := soonest(race, search, error)) is not None:
        clock, laws = race.times.get(id(attempt), {}), race.laws.get(id(attempt), {})
        reason = "" if clock else "too slow for the time that was left"
        known = attempt.columns(race.floor) | {"status": "ok", "reason": reason}
    cut = known["status"] in (*CUT, "interrupted") or (attempt is not None and not clock)
    unlikely = not search.attempts and search in race.last
    at_least = least_time(race, search, error) if cut and not unlikely else math.nan
    row = {"scene": race.question.scene.name, "method": search.method.name, "family": search.method.family}
    row |= {"engine": search.engine, "kind": search.kind, "error_asked": error, **known}
    row |= {"time_s": clock.get("least_s", math.nan), "at_least": at_least}
    own_laws = laws_in(race.question.scene)
    row |= {name: laws.get(name, math.nan) for name in (*own_laws, "map_growth")}
    for known_as in ("kept", "undecided"):
        found = (symbol(law) for law in own_laws if laws.get(f"{law}_{known_as}"))
        row[f"laws_{known_as}"] = ", ".join(found)
    return row | {"time_halves_ratio": clock.get("halves", math.nan)}


def least_time(race: Schedule, search: Search, error: float) -> float:
    """Return what a method takes at least to reach an error: as much as to a larger one, or where it did not get there.

    Of one that was not begun it is the least time on its engine.
    """
    timed = {
        each: [clock["least_s"] for a in each.attempts if (clock := race.times.get(id(a)))]
        for each in race.searches
    }
    if not search.attempts:
        alike = (t for each in timed if each.engine == search.engine for t in timed[each])
        return min(alike, default=0.0) / ONCE
    untimed = soonest(race, search, error)
    slow = (a.seconds / ONCE for a in search.attempts if a is untimed or not a.reaches(error))
    return float(max(*timed[search], *(seconds for seconds in slow if seconds > SLOW), 0.0, 0.0))


def soonest(race: Schedule, search: Search, error: float) -> Attempt | None:
    """Return the setting that reaches an error and is soonest done, by its least round: one for less may be."""
    if race.chosen(search, error) is None:
        return None
    reach = filter(None, (race.chosen(search, e) for e in race.question.errors if e <= error))
    return min(reach, key=lambda a: race.times.get(id(a), {}).get("least_s", math.inf))


def unreached(race: Schedule, search: Search, error: float) -> Row:
    best = min((a for a in search.attempts if a.ok), key=lambda a: a.error, default=None)
    known = {"setting": "", "error_reached": math.nan} if best is None else best.columns(race.floor)
    last = search.finest
    if error < race.floor:
        why = ("unresolved", f"the reference is known to {race.floor:.1e} only")
    elif search.why is not None:
        why = search.why
    elif last is not None and not last.ok:
        why = (str(last.status), f"{last.setting}: {last.message}")
    else:
        assert last is not None
        why = ("unreached", f"no setting is as accurate, tried down to {last.setting}")
    return known | {"evaluations": math.nan, "status": why[0], "reason": why[1]}


def with_verdicts(frame: pd.DataFrame) -> pd.DataFrame:
    halves = frame["time_halves_ratio"]
    costs = frame.assign(cost=frame["time_s"], halves=halves, processes=PROCESSES, place=range(len(frame)))
    return standings(costs, ("kind", "error_asked")).sort_values("place", ignore_index=True)


def with_reasons(frame: pd.DataFrame) -> pd.DataFrame:
    """Say of what is undecided why: a rival that was cut off, or the margin of its times."""
    reasons = frame["reason"].copy()
    for _, part in frame.groupby(["kind", "error_asked"], sort=False):
        unclear = part["verdict"] == "undecided"
        rivals = list(part.loc[part["at_least"] <= part["time_s"].min(), "method"])
        why = f"times cannot be told apart within a factor of {part.loc[unclear, 'margin'].max():.3g}"
        if rivals:
            more = f" and {len(rivals) - NAMED} more" if len(rivals) > NAMED else ""
            why = f"may be sooner done, but for want of time nobody knows: {', '.join(rivals[:NAMED])}{more}"
        reasons[part.index[unclear]] = why
    return frame.assign(reason=reasons)
