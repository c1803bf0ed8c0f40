"""Make rows of runs.csv: the ending of a run, its cost, its error and its deviations from the laws.

Timed runs save only the end: packed initial state in, packed final state out.  Their error is the largest over five end
times, each the end of a separate run, so that interpolation does not matter.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from functools import cache
from time import perf_counter

import numpy as np

import contactbench as cb
from contactbench.blame import UserError
from contactbench.measure.clock import Call
from contactbench.measure.laws import row as law_columns
from contactbench.measure.stability import is_processed
from contactbench.methods.base import Method
from contactbench.methods.prepared import Prepared
from contactbench.questions.judgement import CURVE
from contactbench.runs.experiment import Row
from contactbench.runs.settings import ENDS, LOOKED_AT, SAVES, carry_of, setting_to, times
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.scene.scales import errors
from contactbench.solution import Solution
from contactbench.tables.declared import RUNS
from contactbench.truth import Reference, blow_up_time, condition_number

#: scene, method, engine, control, setting: the key of a run without its saved times
type Question = tuple[str, str, str, str, float]

#: most callbacks of a run over a span up to `LONG`; longer spans get proportionally more up to a limit, and hard scenes
#: three times as many
CALLBACKS, LONG, LONGEST, HARD = 40_000, 800.0, 2000.0, 3


class SolverError(Exception):
    """Report that a solver raised; any other exception here is a fault of the experiment."""


@contextlib.contextmanager
def blamed_on_solver() -> Iterator[None]:
    try:
        yield
    except UserError as error:  # a plug-in's solver
        raise SolverError(str(error)) from error
    except cb.BadInput:  # a wrong setting
        raise
    except Exception as error:
        raise SolverError(f"{type(error).__name__}: {error}") from error


def step_budget(scene: Scene, method: Method, engine: str) -> int | None:
    """Return the budget of steps that keeps a run with callbacks below about a second."""
    if method.refuses(scene) or (each := method.step_cost(scene, engine)) is None:
        return None
    share = max(1.0, min(scene.t_end, LONGEST) / LONG) * (HARD if scene.hard else 1)
    return int(round(CALLBACKS * share) // each)


def prepared(
    question: Question, saves: Sequence[float], carry: Sequence[str] | None, dense: bool = True
) -> Prepared:
    """Return the run to the last of some times, saved at each of them."""
    name, method, engine, control, value = question
    scene = cb.SCENES[name]
    given: Row = {
        "engine": engine,
        "carry": carry,
        "max_steps": step_budget(scene, cb.METHODS[method], engine),
        "dense": dense,
    }
    setting = setting_to(saves[-1], scene, control, value)
    with blamed_on_solver():
        return cb.prepare(scene, method, save_at=Elapsed(saves), **setting, **given)


@cache
def truth_at(scene: str, carry: tuple[str, ...], count: int, which: slice = slice(None)) -> Reference:
    return cb.reference(scene, Elapsed(times(cb.SCENES[scene], count)[which]), carry)


@cache
def truth_of(scene: str) -> Row:
    """Return the columns that all runs of a scene share."""
    ends = "diverged" if blow_up_time(cb.SCENES[scene]) else "ok"
    return {"truth": ends, "condition": condition_number(cb.SCENES[scene]) or math.nan}


def key(question: Question, saved: int) -> Row:
    scene, method, engine, control, value = question
    own = {"scene": scene, "method": method, "family": cb.METHODS[method].family, "engine": engine}
    return own | {"control": control, "setting": value, "saved": saved}


def outcome(question: Question, saved: int, solution: Solution) -> Row:
    """Return the columns of the ending and the cost of a run."""
    counts, method = solution.counts, cb.METHODS[solution.method]
    row = key(question, saved) | {"engine": solution.engine}
    row |= {"status": str(solution.status), "message": solution.message, "end_time": solution.end_time}
    row |= {"steps": counts.steps, "evaluations": counts.rhs_equivalents, "jacobians": counts.jacobians}
    row |= {"rejected": counts.rejected if method.adaptive else None}
    supported = solution.status is not cb.Status.unsupported
    return row | (truth_of(solution.scene.name) if supported else {})


# -- to the end alone ------------------------------------------------------------------------------
def passes_through(scene: Scene, method: Method, engine: str, control: str) -> bool:
    """Return whether one run saved at all ends can replace the separate runs, and is slow enough to matter.

    It cannot for a processed method, which leaves its own coordinates at every saved time, nor for a method that
    restarts there.
    """
    slow = engine == "python" and control == "step"
    return slow and method.one_step and not is_processed(method.on(scene))


def ended(question: Question) -> Row:
    """Return the row of a run to the end alone."""
    scene, method = cb.SCENES[question[0]], cb.METHODS[question[1]]
    *earlier, end = times(scene, ENDS).tolist()
    carry = carry_of(scene)

    def solve(saves: Sequence[float]) -> Solution:
        run = prepared(question, saves, carry)
        with blamed_on_solver():
            return run()

    solution = solve([end])
    row = outcome(question, 1, solution)
    if solution.ok:
        whole = passes_through(scene, method, *question[2:4])
        others = [solve(ends) for ends in ([earlier] if whole else [[t] for t in earlier])]
        if all(each.ok for each in others):
            found = np.vstack([each.y for each in (*others, solution)])
            true = truth_at(scene.name, solution.carry, ENDS).y
            row["error"] = float(errors(scene, found, true, solution.y0, solution.carry).max())
    return row


def many(question: Question) -> Row:
    """Return the row of a run saved at `CURVE` times, with its error at some of them, which end no step."""
    scene = cb.SCENES[question[0]]
    run = prepared(question, times(scene, CURVE).tolist(), carry_of(scene))
    with blamed_on_solver():
        solution = run()
    row = outcome(question, CURVE, solution)
    if solution.ok and row["truth"] != "diverged":
        true = truth_at(scene.name, solution.carry, CURVE, LOOKED_AT).y
        found = solution.y[LOOKED_AT]
        row["error"] = float(errors(scene, found, true, solution.y0, solution.carry).max())
    return row


def bare(question: Question, saved: int = 1) -> tuple[Row, Call]:
    """Return the times of preparation and of the first call of a run with so many saved times, and the call to time."""
    scene = cb.SCENES[question[0]]
    run = prepared(question, times(scene, saved).tolist(), carry_of(scene))
    start = perf_counter()
    run()
    first = perf_counter() - start
    # arrays that an engine has moved to its device ahead of the call
    return {"compile_s": run.compile_s, "first_s": first}, Call(run.bare_call(), first=first)


# -- along the motion --------------------------------------------------------------------------------
def along(question: Question, without: str = "", most: float = math.inf) -> Row:
    """Return the row of a run saved at 25 times, with all laws.

    without : why no derivative is taken.  most : largest number of evaluations of a differentiated run.
    """
    scene = cb.SCENES[question[0]]
    run = prepared(question, times(scene).tolist(), None, dense=False)
    with blamed_on_solver():
        solution = run()
    row = outcome(question, SAVES, solution)
    if not solution.ok or row["truth"] == "diverged":
        return row
    solution.truth = truth_at(scene.name, solution.carry, SAVES)
    if (row["evaluations"] or 0) > most:
        without = f"of a run of more than {most:.0f} evaluations"
    found = law_columns(solution, without)
    row |= {name: value for name, value in found.items() if name in RUNS.columns}
    return row | {"error": found["solution_error"]}
