"""Race methods on one scene, for example the user's own: `compare`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from contactbench.blame import their_code
from contactbench.checks import finite, function, items_of, positive, real_array, refuse, switch, whole
from contactbench.measure.laws import laws_of
from contactbench.measure.statistics import PROCESSES
from contactbench.methods.base import METHODS
from contactbench.questions.contest import CUT, standings
from contactbench.runs.search import Question, Search
from contactbench.runs.settings import ENDS, carry_of, times
from contactbench.scene.base import Scene, scene_of
from contactbench.study.field import field
from contactbench.study.race import recommendation, symbol
from contactbench.study.schedule import (
    INTERRUPTED,
    LEFT_OUT,
    NOT_BEGUN,
    Budget,
    Found,
    ask,
    find_reference,
    floor_of,
    measure_laws,
    reaching,
    search,
    time_runs,
)
from contactbench.truth import Reference

ERRORS = (1e-3, 1e-6, 1e-9)
ALL = "all"
#: default seconds for the methods chosen by default, and for methods that the user names
BUDGET, LONG_BUDGET = 15.0, 50.0
MOST_RIVALS_NAMED = 3
MOST_SAVED = 10**6
#: the sentence that follows the recommendation of a race with many saved times
MANY_SAVED = "Evaluations: dense output. Times: dense output or dense=False, whichever is faster."
#: a single run takes at most this multiple of its least round
ONCE = 2.0
#: longer runs spend little of their time in the call from Python, seconds
SLOW = 1e-3
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
    progress: bool = True,
    reference: Callable[[np.ndarray], ArrayLike] | None = None,
    saved: int = 1,
) -> pd.DataFrame:
    """Race methods on one scene: what each costs at each error, and what it keeps.

    Each method is tried from its coarsest setting to the one that reaches the smallest error, on the first of its
    engines that can run the scene; the settings that reach the errors are then timed in turns, as bare calls, at least
    eight times, or fewer if the machine is too busy for that.  Times are compared within a kind of engine: compiled, or
    calling back into Python.  Ctrl-C ends the race with the rows so far.

    Parameters
    ----------
    scene :
        A scene or the name of one.  Where it `slows_after` some time, fixed steps grow geometrically.
    methods :
        Names; or "all", the most likely to lead first.  By default the methods that lead on problems like this one: on
        a fifth of the random problems of its kind and about its damping (of the named scenes, for a kind without any)
        they cost at most a quarter more than the least, in time or evaluations; and with them the contestants of the
        README and the methods of plug-ins.  Where no tables are installed, all methods race.
    errors :
        Errors asked for: ``max ‖y − y*‖ / max ‖y*‖`` over the ends of five runs (y* also at the start), the largest of
        those of q, p, M, R and each component with a unit of its own.  `scale=` of the scene sets other denominators;
        with `attitude=False` the R of a body does not count.
    budget :
        Seconds for everything, by default 15, and 50 where `methods` are given; the reference may take five.
    progress :
        Whether to show a bar on stderr, in a terminal and in a notebook.
    reference :
        ``reference(t) -> (k, d)``, the true states at k times where you know them: a row of q, then p (of a body of M,
        then the quaternion R) for each.  It is taken to be right to 15 digits.  By default it is computed.
    saved :
        Number of equidistant saved times of a run that is counted and timed, by default the end alone.  Evaluations
        are those of dense output; the time is that of the faster of dense output and ``dense=False``.

    Returns
    -------
    pandas.DataFrame
        One row for each method and error, columns: scene, method, family, engine, kind, error_asked, setting,
        error_reached, time_s (the least round), evaluations (of the right-hand side, or what equals one), ratio (to the
        least time of its kind at that error), margin (the factor by which the less of the two must be ahead to lead
        alone), at_least (a lower bound of its seconds where it was cut off or not timed), verdict (win; tie of all
        within a quarter of the least; undecided where the margin is wider, or a rival that might be faster was cut off;
        loss), laws_kept, laws_undecided (their round-off may hide a drift), a column for each law, status, reason (why
        a method got no further, was not timed, or is undecided).
        ``attrs``: "recommendation" (what to take at each error; with `saved`, what is timed), "reference" (source,
        digits, digits confirmed by a second engine, error: smaller ones are not claimed), "runs" (every setting tried),
        "undamped", "carry" (which of s and R the runs carry), "of_floats" (functions that cannot be recorded),
        "unbegun" (methods that no time was left for), "unrefined" (those without a last search for a coarser setting),
        "interrupted", "seconds".

    Raises
    ------
    BadInput
        For a wrong argument, and where no reference can be computed.
    """
    begun, scene = perf_counter(), scene_of(scene)
    every = isinstance(methods, str) and methods == ALL
    given, wanted = [] if methods is None or every else named_methods(methods), errors_asked(errors)
    switch("progress", progress)
    saved = whole("saved", saved, MOST_SAVED)
    seconds = (BUDGET if methods is None else LONG_BUDGET) if budget is None else positive("budget", budget)
    own = None if reference is None else users_reference(scene, reference)
    with (time := Budget(seconds, begun, progress)).bar:
        leading = given or field(scene, wanted) or [*METHODS]
        raced = list(dict.fromkeys([*leading, *(METHODS if every else [])]))
        truth, confirmed = find_reference(scene, time, own)
        question = ask(scene, truth, wanted, time, saved)
        searches = search(question, raced, leading, time)
        laws = measure_laws(question, searches, time)
        clock = time_runs(question, searches, time)
    frame = frame_of(question, searches, laws, clock)
    unbegun = [one.method.name for one in searches if one.why == NOT_BEGUN and one.method.name in leading]
    frame.attrs |= {"unbegun": unbegun, "unrefined": time.unrefined}
    if saved > 1:
        frame.attrs["recommendation"].append(MANY_SAVED)
    frame.attrs |= {"interrupted": time.interrupted, "seconds": perf_counter() - begun}
    frame.attrs["reference"]["confirmed"] = confirmed
    return frame


# -- arguments -------------------------------------------------------------------------------------
def named_methods(methods: Sequence[str] | str) -> list[str]:
    """Return the methods that the user names, without repetition."""
    some = items_of("methods", methods, "a list of names, or 'all'")
    if not some:
        refuse("methods", methods, "names, at least one, or 'all'")
    for name in some:
        METHODS[name]  # an unknown one raises
    return list(dict.fromkeys(some))


def errors_asked(errors: Iterable[float]) -> tuple[float, ...]:
    """Return the errors asked for, the largest first."""
    asked = items_of("errors", errors, "a list of numbers, as in errors=[1e-3, 1e-6]")
    wanted = tuple(sorted({finite("error", error) for error in asked}, reverse=True))
    if not wanted:
        refuse("errors", errors, "at least one, as in errors=[1e-3, 1e-6]")
    for error in wanted:
        if not 0 < error < 1:
            refuse("error", error, "between 0 and 1, relative to the size of the motion")
    return wanted


def users_reference(scene: Scene, given: Callable[[np.ndarray], ArrayLike]) -> Reference:
    """Return the user's states at the ends of the runs as a reference; raise `BadInput` for another shape."""
    function("reference", given)
    carry, t = carry_of(scene), times(scene, ENDS)
    labels = ", ".join(scene.labels(carry)[:8])
    with their_code("reference"):
        y = real_array(
            "reference", given(t + scene.begins), f"a function that gives a row of {labels} for each time"
        )
    if y.shape != (shape := (len(t), len(scene.labels(carry)))) or not np.isfinite(y).all():
        refuse("reference", f"gives shape {y.shape}", f"{shape}, finite, for each time {labels}")
    return Reference(scene, carry, t, y, [], np.finfo(float).precision, "given")


# -- rows ------------------------------------------------------------------------------------------
class Runs(tuple[dict[str, Any], ...]):
    """Hold a row per setting tried; not copied, because pandas copies ``attrs`` often and would take seconds."""

    def __deepcopy__(self, memo: object) -> Runs:
        return self


def frame_of(question: Question, searches: Sequence[Search], laws: Found, clock: Found) -> pd.DataFrame:
    """Return the table of a race with verdicts, and the recommendation in its ``attrs``."""
    scene, truth = question.scene, question.truth
    rows = [row(question, each, error, laws, clock) for each in searches for error in question.errors]
    frame = with_verdicts(pd.DataFrame(rows))
    frame = frame.reindex(columns=[*COLUMNS, *laws_in(scene)]).astype(COLUMNS)
    known = {"source": truth.source, "digits": truth.digits, "error": floor_of(truth)}
    frame.attrs = {"reference": known, "runs": Runs(run for each in searches for run in runs_of(each))}
    frame.attrs |= {"undamped": scene.is_undamped, "of_floats": scene.functions_of_floats}
    frame.attrs |= {"carry": list(carry_of(scene)), "recommendation": list(recommendation(frame))}
    return frame


def runs_of(one: Search) -> Iterable[dict[str, Any]]:
    """Yield a row for each setting tried, coarse to fine."""
    for a in sorted(one.attempts, key=lambda a: -a.value):
        known = {"method": one.method.name, "engine": one.engine, "kind": one.kind, "value": a.value}
        yield known | a.columns(0.0) | {"status": str(a.status), "message": a.message, "error": a.error}


def laws_in(scene: Scene) -> list[str]:
    """Return the names of the laws that have a column."""
    return [law.name for law in laws_of(scene) if law.name not in LEFT_OUT]


def row(question: Question, one: Search, error: float, laws: Found, clock: Found) -> dict[str, Any]:
    """Return the row of a method at an error: its fastest setting that reaches this or a smaller error asked for."""
    floor, scene, of_laws = floor_of(question.truth), question.scene, laws_in(question.scene)
    reach = [a for e in question.errors if e <= error for _, a in reaching([one], e, floor)]
    attempt = min(reach, key=lambda a: clock.get(id(a), {}).get("time_s", math.inf), default=None)
    best = attempt or min((a for a in one.attempts if a.ok), key=lambda a: a.error, default=None)
    timed, kept = clock.get(id(attempt), {}), laws.get(id(attempt), {})
    status, reason = ending(one, error, floor)
    if attempt is not None:
        status, reason = "ok", "" if timed else "too slow for the time that was left"
    slow = [a.seconds / ONCE for a in one.attempts if not a.reaches(error) and a.seconds > ONCE * SLOW]
    cut = one.attempts and status in (*CUT, INTERRUPTED)
    verdicts = {symbol(law): kept[f"{law}_kept"] for law in of_laws if f"{law}_kept" in kept}
    judged = not math.isnan(kept.get("bound", math.nan))
    found = {"scene": scene.name, "method": one.method.name, "family": one.method.family}
    found |= {"engine": one.engine, "kind": one.kind, "error_asked": error, "setting": ""}
    found |= {"error_reached": math.nan} | ({} if best is None else best.columns(floor))
    found |= {"evaluations": math.nan} if attempt is None else {}
    found |= {"time_s": math.nan, "halves": math.nan} | timed
    found |= {"at_least": max(slow, default=0.0) if cut else math.nan}
    found["laws_kept"] = ", ".join(name for name, verdict in verdicts.items() if verdict)
    found["laws_undecided"] = ", ".join(
        name for name, verdict in verdicts.items() if judged and verdict is None
    )
    return found | {"status": status, "reason": reason} | {law: kept.get(law, math.nan) for law in of_laws}


def ending(one: Search, error: float, floor: float) -> tuple[str, str]:
    """Return the status and the reason of a method that does not reach an error."""
    last = one.finest
    why = ("unreached", f"no setting is as accurate, tried down to {last.setting if last else 'none'}")
    if error < floor:
        why = ("unresolved", f"the reference is known to {floor:.1e} only")
    elif one.why is not None:
        why = one.why
    elif last is not None and not last.ok:
        why = (str(last.status), f"{last.setting}: {last.message}")
    return why


def with_verdicts(frame: pd.DataFrame) -> pd.DataFrame:
    """Add verdicts on the times of each kind at each error, with a reason where one is undecided."""
    costs = frame.assign(cost=frame["time_s"], processes=PROCESSES, place=range(len(frame)))
    judged = standings(costs, ("kind", "error_asked")).sort_values("place", ignore_index=True)
    for _, part in judged.groupby(["kind", "error_asked"], sort=False):
        unclear = part["verdict"] == "undecided"
        rivals = list(part.loc[part["at_least"] <= part["time_s"].min(), "method"])
        why = f"times cannot be told apart within a factor of {part.loc[unclear, 'margin'].max():.3g}"
        if rivals:
            why = f"cut off for want of time, may be faster: {', '.join(rivals[:MOST_RIVALS_NAMED])}"
        judged.loc[part.index[unclear], "reason"] = why
    return judged
