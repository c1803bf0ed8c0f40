"""What does accuracy cost?  One cell: a method on an engine, on a scene, at one setting.

What is timed is the solver's own call, by its fastest documented way: packed initial state in, packed final state
out.  The error is the largest over five end times, each the end of a run of its own: no interpolation plays a part.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from time import perf_counter

import contactbench as cb
from contactbench.measure.clock import Call, Part
from contactbench.measure.laws import errors_of
from contactbench.measure.stability import is_processed
from contactbench.methods.base import Method
from contactbench.methods.prepared import Prepared
from contactbench.questions.contest import CONTACT, TARGETS
from contactbench.runs.choice import SMOKE, controlled, engines, outcome, step_budget
from contactbench.runs.experiment import Cell, Profile, Recorded, Row, Timing, experiment, timed_experiment
from contactbench.runs.search import STILL_BETTER
from contactbench.runs.settings import (
    BETWEEN,
    ENDS,
    LOOSEST,
    carry_of,
    control_of,
    finer_steps,
    setting_to,
    steps,
    times,
    tolerances,
)
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.scenes import scenes_of
from contactbench.solution import EXACT, GROWING, PILOTS
from contactbench.tables.declared import WORK_PRECISION

#: of tolerances down to this a profile chooses some; tighter ones are all run
TIGHT = 1e-13
#: steps of a ladder that do not lessen the error before it ends: they show round-off
PATIENCE = 2
#: contact methods from this order on are given tolerances too
HIGH_ORDER = 4
PILOTED = [10.0**-k for k in range(3, 13)]


def ladder(profile: Profile) -> list[Cell]:
    """(scene, method, engine, control, value)."""
    rows: list[Cell] = []
    for scene in scenes_of("work_precision"):
        for name, engine in engines(scene, profile):
            method = cb.METHODS[name]
            if method.refuses(scene) is not None:  # one row says why
                values = (tolerances(method) if method.adaptive else steps(scene, method))[:1]
            elif method.control == EXACT:
                values = [0.0]
            elif method.adaptive:
                rungs = [r for r in tolerances(method) if "python" not in engine or r not in BETWEEN]
                values = profile.choose([rtol for rtol in rungs if TIGHT <= rtol < LOOSEST])
                if not profile.brief:  # both ends of the range, whatever the profile
                    values = [r for r in rungs if r >= LOOSEST or r in values or r < TIGHT]
                elif scene.name == SMOKE:  # a step control that stops short shows at the tightest
                    values.append(rungs[-1])
            else:
                values = profile.choose(steps(scene, method))
                if goes_on(engine, method, profile):
                    values = [*values, *finer_steps(scene, method)]
            rows += [(scene.name, name, engine, control_of(scene, method), value) for value in values]
            if by_pilots(scene, method, engine) and (not profile.brief or scene.name == SMOKE):
                rows += [(scene.name, name, engine, "rtol", rtol) for rtol in profile.choose(PILOTED)]
    return rows


def goes_on(engine: str, method: Method, profile: Profile) -> bool:
    """Return whether a ladder of steps goes on to the end of what a method can do: on its first engine."""
    return engine == method.engines[0] and not profile.brief


def is_past_the_end(cell: Cell) -> bool:
    """Return whether coarser steps of a ladder have passed every error asked for, or two of them were of no help."""
    name, *own, control, value = cell
    scene, method = cb.SCENES[name], cb.METHODS[own[0]]
    if control not in ("step", GROWING) or value >= (last := steps(scene, method)[-1]):
        return False
    least, idle = math.inf, 0
    for step in (last, *(step for step in finer_steps(scene, method) if step > value)):
        found = error_of((name, *own, control, step))
        idle = 0 if found <= STILL_BETTER * least else idle + 1
        least = min(least, found)
        if least <= TARGETS[-1] or idle == PATIENCE:
            return True
    return False


@cache
def error_of(cell: Cell) -> float:
    """Return the largest error at the ends, inf where a run ends badly."""
    ends = times(cb.SCENES[cell[0]], ENDS).tolist()
    solutions = [prepared(cell, None, [end])() for end in ends]
    return float(errors_of(solutions).max()) if all(solution.ok for solution in solutions) else math.inf


def by_pilots(scene: Scene, method: Method, engine: str) -> bool:
    """Return whether a fixed-step method is run by tolerance too: a contact one of high order, on its first engine."""
    contact = method.family == CONTACT and method.control == "step" and (method.order or 0) >= HIGH_ORDER
    explicit = not method.iterates  # pilots that iterate take longer than the run
    first = engine == method.engines[0] and scene.slows_after is None
    return contact and explicit and first and method.refuses(scene) is None


def passes_through(method: Method, engine: str, control: str) -> bool:
    """Return whether one run saved at all ends is, but for roundings, the runs to each, and slow enough to matter.

    Not of a processed method, which brings a state to its own coordinates and back wherever it is saved, nor of one
    that starts afresh there.
    """
    return engine == "python" and control == "step" and method.one_step and not is_processed(method)


def prepared(cell: Cell, budget: int | None, times: Sequence[float]) -> Prepared:
    """Return the run to the last of some times, saved at each of them."""
    name, method, engine, control, value = cell
    scene = cb.SCENES[name]
    given = {"engine": engine, "carry": carry_of(scene), "max_steps": budget}
    return cb.prepare(
        scene, method, save_at=Elapsed(times), **setting_to(times[-1], scene, control, value), **given
    )


def budget_of(cell: Cell, profile: Profile) -> int | None:
    return step_budget(profile, cb.SCENES[cell[0]], cb.METHODS[cell[1]], cell[2])


def errors(cell: Cell, profile: Profile) -> Row:
    """Return the row but for what is timed: how its run ends, what it costs, its error at several ends."""
    scene, method, engine, control, value = cb.SCENES[cell[0]], cb.METHODS[cell[1]], *cell[2:]
    budget = budget_of(cell, profile)
    run = prepared(cell, budget, [scene.t_end])
    start = perf_counter()
    solution = run()
    row: Row = {"compile_s": run.compile_s, "first_call_s": perf_counter() - start}
    carried = scene.initial(run.request.carry)._asdict().items()
    own = ("t",) if method.own_time else ()
    row |= {"carried": " ".join(name for name, field in carried if field is not None and name not in own)}
    variant = GROWING if control == GROWING else PILOTS if control != method.control else ""
    if control == GROWING:
        row |= controlled(method.control, value, variant)
    if not solution.ok:
        return outcome(solution, variant) | row
    earlier = times(scene, ENDS)[:-1].tolist()
    saves = [earlier] if passes_through(method, engine, control) else [[t] for t in earlier]
    others = [prepared(cell, budget, ends)() for ends in saves]
    row["solution_error"] = float(errors_of([*others, solution]).max())
    if method.adaptive and method.order is None:
        row["evaluations_spread"] = evaluations_spread(run, solution.counts.evaluations or 0)
    return outcome(solution, variant) | row


#: a run with callbacks that takes longer has no second length: what is fixed is lost in it; and in one longer than
#: SHORT what the public call adds
LONG_CALLBACK, SHORT = 0.02, 5e-4
#: rounds in which both calls are compared, and seconds of each
PAIRS, BLOCK_SECONDS = 9, 1e-4


def runs(cell: Cell, budget: int | None) -> tuple[Row, Call]:
    """Return what the public call adds, and what is timed: the bare run, and the one to the earliest end."""
    end = cb.SCENES[cell[0]].t_end
    run, shorter = (prepared(cell, budget, [t]) for t in (end, end / ENDS))
    # arrays that an engine has moved to its device ahead of the call
    bare, part = run.bare_call(), shorter.bare_call()
    call = Call(bare, Part(part, 1 / ENDS, end))
    call.warm_up()
    once = call.once[0]
    if "python" in cell[2] and once > LONG_CALLBACK:
        call = call.without_part()
    if once >= SHORT:
        return {}, call
    beside = Part(bare, 0.0, 1.0)
    added = beside.marginal([Call(run, beside, BLOCK_SECONDS).visit(PAIRS)])
    return {"call_s": max(0.0, added)}, call  # the difference may be lost in noise


#: changes of the initial data, relative: a few roundings
ROUNDINGS = (-2e-15, -1e-15, 1e-15, 2e-15)


def evaluations_spread(run: Prepared, own: int) -> float:
    """Return by how much the evaluations differ, relative to the fewest, where the initial data differ by `ROUNDINGS`.

    Measured, on `particle_long`: a solver of fixed order takes the same number of them at every tolerance;
    CVODE's choice of an order turns on a rounding at the tightest ones, and costs up to 60 % more or less.
    """
    others = (run.integrate(run.start * (1 + change)).counts.evaluations or 0 for change in ROUNDINGS)
    counted = [own, *others]
    return max(counted) / min(counted) - 1


@experiment(ladder)
def work_precision_errors(cell: Cell, profile: Profile) -> Recorded:
    if not is_past_the_end(cell):
        yield WORK_PRECISION, errors(cell, profile)


@timed_experiment(ladder, errors=work_precision_errors)
def work_precision(cell: Cell, profile: Profile, row: Row) -> Timing:
    return Timing(WORK_PRECISION, runs, (cell, budget_of(cell, profile)))
