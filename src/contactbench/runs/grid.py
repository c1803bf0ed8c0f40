"""Run methods on scenes: rows of runs.csv and times.csv; a cell is a scene and a method.

The declared properties of scenes and methods decide which pairs run, and at which settings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache

import contactbench as cb
from contactbench.measure.isolation import Died, TimedOut, Worker
from contactbench.methods.base import ENGINES, Method
from contactbench.plugins import OWN
from contactbench.questions.judgement import CURVE, CURVE_ERRORS
from contactbench.runs.experiment import Cell, Profile, Recorded, Row, Timing, experiment, timed
from contactbench.runs.rows import Question, SolverError, along, bare, ended, key, many
from contactbench.runs.settings import DEAREST, SAVES, control_of, ladder, rungs_of_equal_cost
from contactbench.scene import Scene
from contactbench.solution import GROWING
from contactbench.tables.declared import RUNS
from contactbench.tables.schema import PROFILES as NAMES

#: engines that take seconds for a scene: XLA compiles, Python is called back
DEAR = ("jax", "python")
#: number of settings in the smoke profile
FEW = 3
#: largest error of a run that is repeated saved at many times
FOLLOWS = 1e-2
#: most evaluations of a run that calls back into Python
DEAREST_CALLBACKS = 2**12
#: evaluations of a run along the motion after which no tighter tolerance is run
LAST = {"compiled": math.inf, "callbacks": 2**11}
#: most evaluations of a run whose map is differentiated; coarser runs show which laws it keeps
DIFFERENTIATED = {"compiled": 2**16, "callbacks": 1000}
#: a ladder ends below the error SMALLEST, or after PATIENCE settings that do not lower the error by the factor
#: STILL_BETTER; it does not end while every error is above LOST, about as large as the motion
SMALLEST, STILL_BETTER, PATIENCE, LOST = 1e-12, 0.7, 2, 0.1
#: contact methods from this order on run by tolerance too
PILOTED_ORDER = 4
#: most components of a scene on which the map of an adaptive solver is differentiated, which takes runs for each one
MANY = 32
#: seconds after which a call on a hard scene counts as hanging; the longest takes about twenty
LIMIT = 900.0


# -- which -----------------------------------------------------------------------------------------
def is_brought(scene: Scene, method: Method) -> bool:
    """Return whether a plug-in has registered the scene or the method; such pairs always run."""
    return not {scene.name, method.name} <= OWN


def is_dear(method: Method) -> bool:
    return method.engines[0] in DEAR


def is_run(scene: Scene, method: Method, profile: Profile) -> bool:
    """Return whether a profile runs a method on a scene.

    Slow engines run on the mission's scenes only, stiff solvers there and on stiff or hard scenes, methods with an
    exact linear part there and on stiff ones, unless the force is linear.  The smoke profile runs all fast methods on
    the mission's scenes, and only the mission's contestants elsewhere.
    """
    if is_brought(scene, method) or profile.reaches(NAMES[2]):
        return True
    if is_dear(method):
        return not profile.brief and ((method.stiff and scene.stiff) or (method.mission and scene.mission))
    suits = scene.mission or scene.stiff or (not method.expands and (scene.hard or not method.stiff))
    return suits and not method.solves(scene) and (method.mission or scene.mission or not profile.brief)


def cells(profile: Profile) -> list[Cell]:
    every = [(scene, method) for scene in cb.SCENES.values() for method in cb.METHODS.values()]
    return [(scene.name, method.name) for scene, method in every if is_run(scene, method, profile)]


def engines(scene: Scene, method: Method) -> list[str]:
    """Return the engines that run a method on a scene: its first and, on the mission's scenes, those with callbacks.

    Among our methods only contact methods and contestants of the mission run with callbacks.
    """
    first, *others = method.engines
    asked = method.mission or (method.family == "contact" and not method.iterates)
    wanted = is_brought(scene, method) or (scene.mission and asked)
    return [first, *(each for each in others if wanted and not method.lacks(each))]


def takes_pilots(scene: Scene, method: Method) -> bool:
    """Return whether a method also runs by tolerance, with steps from pilots: explicit contact ones of high order."""
    contact = method.family == "contact" and method.control == "step" and not method.iterates
    return contact and (method.order or 0) >= PILOTED_ORDER and scene.slows_after is None


def no_derivative(scene: Scene, method: Method) -> str:
    """Return the reason why the map of a run is not differentiated, or "" if it is; adaptive solvers need many runs."""
    if not method.adaptive or method.family == "contact":
        return ""
    if scene.motion > MANY:
        return f"{scene.motion} components, with runs for each"
    return "" if scene.mission or is_brought(scene, method) else "on the mission's scenes only"


# -- rows ------------------------------------------------------------------------------------------
@cache
def worker() -> Worker:
    """Return the worker process that all cells of this process share."""
    return Worker()


def guarded(scene: Scene, function: Callable[..., Row], question: Question, *more: object) -> Row:
    """Return the row of a run, even if the solver raises, dies or hangs; hard scenes use a process of their own."""
    saved = {ended: 1, many: CURVE}.get(function, SAVES)
    bad = key(question, saved) | {"status": "failed"}
    try:
        if scene.hard:
            return worker().call(LIMIT, function, question, *more)
        return function(question, *more)
    except TimedOut as error:
        return bad | {"status": "timeout", "message": str(error)}
    except (Died, SolverError) as error:  # any other exception is a fault of this package and fails the cell
        return bad | {"message": " ".join(str(error).split())[:200]}


def is_saved(scene: Scene, method: Method, control: str, row: Row) -> bool:
    """Return whether a run is repeated saved at many times, for its evaluations: on the mission's scenes.

    A method that is given a step is compared as such, not with steps that pilots choose.
    """
    if not scene.mission or is_dear(method) or row["engine"] != method.engines[0]:
        return False
    own = control == control_of(scene, method) and control != GROWING
    follows = row["status"] == "ok" and row.get("error", math.inf) <= FOLLOWS
    return own and follows and row["evaluations"] <= DEAREST_CALLBACKS


def climb(scene: Scene, method: Method, engine: str, control: str, profile: Profile) -> Iterator[Row]:
    """Yield rows of runs that save only the end, coarse to fine, until finer settings do not help.

    They end when the error is below `SMALLEST`, two settings in a row do not lower it, or a budget is spent.  The full
    profile adds the settings between.
    """
    dearest = DEAREST if ENGINES[engine] == "compiled" else DEAREST_CALLBACKS
    every, enough = ladder(scene, method, control, dearest)
    least, idle, value = math.inf, 0, math.inf
    for count, value in enumerate(enough[:FEW] if profile.brief else enough):
        question = scene.name, method.name, engine, control, value
        row, own = guarded(scene, ended, question), {"profile": NAMES[0] if count < FEW else NAMES[1]}
        yield row | own
        if is_saved(scene, method, control, row):
            yield guarded(scene, many, question) | own
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
    """Yield rows of runs saved along the motion, at settings of equal cost.

    After a tolerance that spends the budget no tighter one is run, nor after one with more callbacks than `LAST`.
    """
    values = rungs_of_equal_cost(scene, method)
    values = values[:1] if method.refuses(scene) else values
    ends, without, spent = {values[0], values[-1]}, no_derivative(scene, method), math.nan
    for value in values:
        if profile.brief and value not in ends:
            continue
        question = (scene.name, method.name, engine, method.control, value)
        if value < spent:
            message = f"not run: rtol={spent:g} took too many evaluations"
            row = key(question, SAVES) | {"status": "budget", "message": message}
        else:
            row = guarded(scene, along, question, without, DIFFERENTIATED[ENGINES[engine]])
        yield row | {"profile": NAMES[0] if value in ends else NAMES[1]}
        dear = row["status"] == "budget" or (row.get("evaluations") or 0) > LAST[ENGINES[engine]]
        if dear and method.adaptive and math.isnan(spent):
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
    saved, error, (least, most) = row["saved"], row.get("error"), CURVE_ERRORS
    if row["status"] != "ok" or error is None:
        return None
    if saved != 1 and not (saved == CURVE and least < error <= most):
        return None
    names = ("scene", "method", "engine", "control", "setting")
    question = tuple(row[name] for name in names)
    return Timing(dict(zip(names, question, strict=True)) | {"saved": saved}, bare, (question, saved), error)
