"""Which methods are run on which scenes, and at which settings; and what of it is timed.

One cell: a scene and a method, all of its rows in runs.csv.  What is run follows from what scenes and methods declare.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache

import contactbench as cb
from contactbench.measure.isolation import Died, TimedOut, Worker
from contactbench.methods.base import ENGINES, Method
from contactbench.plugins import OWN
from contactbench.runs.experiment import Cell, Profile, Recorded, Row, Timing, experiment, timed
from contactbench.runs.rows import Question, SolverError, along, bare, ended, key
from contactbench.runs.settings import DEAREST, SAVES, control_of, ladder, rungs_of_equal_cost
from contactbench.scene import Scene
from contactbench.tables.declared import RUNS
from contactbench.tables.schema import PROFILES as NAMES

#: engines that take seconds for a scene: XLA compiles, Python is called back
DEAR = ("jax", "python")
#: rungs of a ladder in the smoke profile
FEW = 3
#: evaluations that a run of a ladder may cost where Python is called back
DEAREST_CALLBACKS = 2**12
#: evaluations that a run may cost whose map is differentiated: what it keeps shows in the coarser ones
DIFFERENTIATED = {"compiled": 2**16, "callbacks": 1000}
#: a ladder ends below the error SMALLEST, or after PATIENCE rungs that do not lower the error by the factor
#: STILL_BETTER; it does not end while every error is above LOST, about as large as the motion
SMALLEST, STILL_BETTER, PATIENCE, LOST = 1e-12, 0.7, 2, 0.1
#: contact methods from this order on are given tolerances too
PILOTED_ORDER = 4
#: with more components the map of a solver by tolerance is not differentiated: it takes runs for each of them
MANY = 32
#: seconds after which a call on a hard scene hangs; the dearest takes about twenty
LIMIT = 900.0


# -- which -----------------------------------------------------------------------------------------
def is_brought(scene: Scene, method: Method) -> bool:
    """Return whether a plug-in has brought either, which is run by all there is."""
    return not {scene.name, method.name} <= OWN


def is_dear(method: Method) -> bool:
    return method.engines[0] in DEAR


def is_run(scene: Scene, method: Method, profile: Profile) -> bool:
    """Return whether a profile runs a method on a scene.

    What is dear runs where the mission is, stiff solvers where it is, or where it is stiff or hard.  The smoke profile
    has the mission's scenes with all that is not dear, and elsewhere the mission's contestants alone.
    """
    if is_brought(scene, method) or profile.reaches(NAMES[2]):
        return True
    if is_dear(method):
        return not profile.brief and ((method.stiff and scene.stiff) or (method.mission and scene.mission))
    suits = scene.mission or scene.stiff or scene.hard or not method.stiff
    return suits and (method.mission or scene.mission or not profile.brief)


def cells(profile: Profile) -> list[Cell]:
    every = [(scene, method) for scene in cb.SCENES.values() for method in cb.METHODS.values()]
    return [(scene.name, method.name) for scene, method in every if is_run(scene, method, profile)]


def engines(scene: Scene, method: Method) -> list[str]:
    """Return the engines that a method is run by on a scene: its first and, where the mission is, those of callbacks.

    Of our methods the contact ones and the mission's are called back.
    """
    first, *others = method.engines
    asked = method.mission or (method.family == "contact" and not method.iterates)
    wanted = is_brought(scene, method) or (scene.mission and asked)
    return [first, *(each for each in others if wanted and not method.lacks(each))]


def takes_pilots(scene: Scene, method: Method) -> bool:
    """Return whether pilots choose the steps of a method too: of an explicit contact one of high order."""
    contact = method.family == "contact" and method.control == "step" and not method.iterates
    return contact and (method.order or 0) >= PILOTED_ORDER and scene.slows_after is None


def no_derivative(scene: Scene, method: Method) -> str:
    """Return why the map of a run is not differentiated, or "" if it is: solvers by tolerance need many runs for it."""
    if not method.adaptive or method.family == "contact":
        return ""
    if scene.motion > MANY:
        return f"{scene.motion} components, with runs for each"
    return "" if scene.mission or is_brought(scene, method) else "on the mission's scenes only"


# -- rows ------------------------------------------------------------------------------------------
@cache
def worker() -> Worker:
    """Return the process that all cells of this one share."""
    return Worker()


def guarded(scene: Scene, function: Callable[..., Row], question: Question, *more: object) -> Row:
    """Return the row of a run, of a solver that raises, dies or hangs too; on hard scenes in a process of its own."""
    saved = 1 if function is ended else SAVES
    bad = key(question, saved) | {"status": "failed"}
    try:
        if scene.hard:
            return worker().call(LIMIT, function, question, *more)
        return function(question, *more)
    except TimedOut as error:
        return bad | {"status": "timeout", "message": str(error)}
    except (Died, SolverError) as error:  # anything else is a fault of ours, and fails the cell
        return bad | {"message": " ".join(str(error).split())[:200]}


def climb(scene: Scene, method: Method, engine: str, control: str, profile: Profile) -> Iterator[Row]:
    """Yield rows of runs to the end alone, coarse to fine, to the end of what a method can do.

    That is until `SMALLEST` is passed, two rungs in a row are of no help, or a budget is spent.  The full profile has
    the rungs between.
    """
    dearest = DEAREST if ENGINES[engine] == "compiled" else DEAREST_CALLBACKS
    every, enough = ladder(scene, method, control, dearest)
    least, idle, value = math.inf, 0, math.inf
    for count, value in enumerate(enough[:FEW] if profile.brief else enough):
        row = guarded(scene, ended, (scene.name, method.name, engine, control, value))
        yield row | {"profile": NAMES[0] if count < FEW else NAMES[1]}
        error = row.get("error", math.inf)
        if row["status"] in ("budget", "unsupported") or (row.get("evaluations") or 0) > dearest:
            break
        idle = 0 if error <= STILL_BETTER * least or least > LOST else idle + 1
        least = min(least, error)
        if least <= SMALLEST or idle == PATIENCE:
            break
    for between in every if profile.reaches(NAMES[2]) else ():
        if between > value and between not in enough:
            row = guarded(scene, ended, (scene.name, method.name, engine, control, between))
            yield row | {"profile": NAMES[2]}


def look_along(scene: Scene, method: Method, engine: str, profile: Profile) -> Iterator[Row]:
    """Yield rows of runs saved along the motion, at rungs of equal cost.

    Where a tolerance spends the budget a tighter one would spend it too, and is not run.
    """
    values = rungs_of_equal_cost(scene, method)
    values = values[:1] if method.refuses(scene) else values
    ends, without, spent = {values[0], values[-1]}, no_derivative(scene, method), math.nan
    for value in values:
        if profile.brief and value not in ends:
            continue
        question = (scene.name, method.name, engine, method.control, value)
        if value < spent:
            message = f"not run: rtol={spent:g} spent the budget"
            row = key(question, SAVES) | {"status": "budget", "message": message}
        else:
            row = guarded(scene, along, question, without, DIFFERENTIATED[ENGINES[engine]])
        yield row | {"profile": NAMES[0] if value in ends else NAMES[1]}
        if row["status"] == "budget" and method.adaptive and math.isnan(spent):
            spent = value


@experiment(cells)
def run(cell: Cell, profile: Profile) -> Recorded:
    scene, method = cb.SCENES[cell[0]], cb.METHODS[cell[1]]
    least, works = NAMES.index(run.profile_of(cell)), ""
    for engine in [] if scene.hard else engines(scene, method):
        controls = [control_of(scene, method)]
        if not works and takes_pilots(scene, method) and not method.refuses(scene):
            controls.append("rtol")
        for control in controls:
            for row in climb(scene, method, engine, control, profile):
                works = works or engine * (row["status"] != "unsupported")
                yield RUNS, row | {"profile": NAMES[max(least, NAMES.index(row["profile"]))]}
    for row in look_along(scene, method, works or method.engines[0], profile):
        yield RUNS, row | {"profile": NAMES[max(least, NAMES.index(row["profile"]))]}


@timed(run)
def times(row: Row) -> Timing | None:
    if row["saved"] != 1 or row["status"] != "ok" or row.get("error") is None:
        return None
    names = ("scene", "method", "engine", "control", "setting")
    question = tuple(row[name] for name in names)
    return Timing(dict(zip(names, question, strict=True)) | {"saved": 1}, bare, (question,), row["error"])
