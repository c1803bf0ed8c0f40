"""Measure the cost of an error on random problems, and the endings on hard ones; a cell is a family of problems."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from contactbench.measure.clock import Call
from contactbench.methods.base import CALLBACKS, METHODS, PACKAGES, Method, prepare
from contactbench.methods.fixed_step import FixedStep
from contactbench.peers.heyoka import SHARED, TAYLOR
from contactbench.runs.experiment import Cell, Profile, Recorded, Row, experiment
from contactbench.runs.features import Features, features
from contactbench.runs.problems import COUNT, FAMILIES, HARD, SEED, Problem, draw
from contactbench.runs.search import Attempt, Question
from contactbench.runs.settings import carry_of
from contactbench.runs.trial import CLEAR, ENDS, Trial, agreed
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.tables.declared import POPULATION, PROBLEMS
from contactbench.truth import Reference

ERRORS = (1e-3, 1e-6, 1e-9)
#: visits of a call; a call is visited again if at most this many times slower than the fastest
VISITS, SLOWER = 3, 10.0
#: hard problems: the tolerance, the multiple of it beyond which a result is wrong, and steps per period of methods
#: without a tolerance
TOLERANCE, WRONG, HARD_STEPS = 1e-6, 1e3, 1000
#: the seed of `--seed`; empty for the seed of the repository
OWN_SEED: list[int] = []


# -- the truth ---------------------------------------------------------------------------------------
#: solver and tolerance for the truth; the first one that takes the scene
TIGHT = (("rkn12-10", 1e-14), ("rk8-7", 1e-14))


def truth_of(problem: Problem) -> Reference | None:
    """Return the states at the ends on which two solvers agree; None if either fails."""
    scene, carry = problem.scene, carry_of(problem.scene)
    ends = [part * scene.t_end for part in ENDS]
    method, rtol = next(each for each in TIGHT if METHODS[each[0]].refuses(scene) is None)
    solvers: list[tuple[Method | str, float]] = [(SHARED, SHARED.rtol_range[0])]
    solvers.append((method, max(rtol, METHODS[method].rtol_range[0])))
    # steps end at the saved times, as in the trials
    given: Row = {"save_at": Elapsed(ends), "carry": carry, "dense": False}
    found = [prepare(scene, one, rtol=tight, **given)() for one, tight in solvers]
    return agreed(scene, carry, *found) if all(one.ok for one in found) else None


# -- who is run ----------------------------------------------------------------------------------------
#: least order of methods without a geometric structure that race
HIGH = 8


def raced(scene: Scene) -> list[Method]:
    """Return the methods that race: those likely to lead, and the compiled contestants of the mission.

    Among our fixed-step methods the cheapest per family and order races, contact methods from order 2 on and others
    from `HIGH` on; besides them exact methods, embedded pairs of high order, and the Taylor method.  On a stiff scene
    only methods for stiff problems race, and the contestants among other packages.
    """
    stand_ins = {method.like for method in METHODS.values() if method.mission}
    compiled = [m for m in METHODS.values() if m.engines[0] not in (*CALLBACKS, *PACKAGES)]
    fit = [m for m in compiled if not m.stiff]
    if scene.stiff:
        fit = [m for m in compiled if m.stiff or (m.package and (m.mission or m.name in stand_ins))]
    able = [m for m in fit if not (m.iterates or m.follows or m.refuses(scene))]
    theirs = [m for m in able if m.package and (m.mission or m.name in stand_ins or m is TAYLOR)]
    ours = [m for m in able if not m.package and (m.contact or m.mission or (m.order or HIGH) >= HIGH)]
    steps: dict[object, FixedStep] = {}
    for method in ours:
        if isinstance(method, FixedStep) and method.order > 1:
            alike = method.contact, method.order, method.one_step, method.stiff
            both = method, steps.get(alike, method)
            steps[alike] = min(both, key=lambda own: (own.per_step(scene), not own.mission))
    # first the methods whose cost lets others give up
    ranked = sorted(
        [*steps.values(), *(m for m in ours if not isinstance(m, FixedStep))], key=lambda m: -(m.order or 0)
    )
    return [*ranked, *(SHARED if method is TAYLOR else method for method in theirs)]


# -- rows ----------------------------------------------------------------------------------------------
def examine(problem: Problem) -> tuple[Row, Features, Reference | None]:
    """Return the row of a problem, its features, and the truth."""
    scene, known = problem.scene, features(problem.scene)
    truth = truth_of(problem)
    row = {"seed": problem.seed, "scene": scene.name, "structure": problem.family, "hard": problem.hard}
    row |= {"t_end": scene.t_end, "digits": truth.digits if truth else 0}
    return row | asdict(known), known, truth


def named(problem: Problem, method: Method) -> Row:
    return {"seed": problem.seed, "scene": problem.scene.name, "method": method.name}


def cost_rows(problem: Problem) -> Recorded:
    row, known, truth = examine(problem)
    yield PROBLEMS, row
    if truth is None:
        return
    errors = HARD[problem.hard].errors if problem.hard else ERRORS
    targets = [error for error in errors if error >= CLEAR * 10.0**-truth.digits]
    question = Question(problem.scene, truth, errors, math.inf)
    trials = [Trial(question, method, known) for method in raced(problem.scene)]
    least: dict[float, float] = {}
    with np.errstate(all="ignore"):
        for trial in trials:
            trial.search(targets, least)
        seconds = visited([a for trial in trials for error in targets if (a := trial.best(error))])
    for trial in trials:
        yield from ((POPULATION, named(problem, trial.method) | row) for row in trial.rows(targets, seconds))


def visited(tried: Sequence[Attempt]) -> dict[int, float]:
    """Return the least time of the bare call of each setting, in turns; slow calls keep the time of their run."""
    seconds = {id(one): one.seconds for one in tried}
    most = SLOWER * min(seconds.values(), default=0.0)
    runs = {id(one): one.run for one in tried if one.run and one.seconds <= most}
    calls = {name: Call(run.bare_call(), round_seconds=1e-4) for name, run in runs.items()}
    for _ in range(VISITS):
        for call in calls.values():
            call.visit(1)
    return seconds | {name: call.once for name, call in calls.items()}


def hard_rows(problem: Problem) -> Recorded:
    """Yield the ending of each method at a tolerance, or at a step if it takes no tolerance."""
    row, known, truth = examine(problem)
    yield PROBLEMS, row
    if truth is None or 10.0**-truth.digits * CLEAR > TOLERANCE * WRONG:
        return
    question = Question(problem.scene, truth, ERRORS, math.inf)
    for method in raced(problem.scene):
        steps = method.control == "step" and not (method.one_step or method.follows)
        control = "exact" if method.exact else "step" if steps else "rtol"
        value = 2 * math.pi / known.omega / HARD_STEPS if steps else TOLERANCE
        with np.errstate(all="ignore"):
            one = Trial(question, method, known).attempt(0.0 if method.exact else value, control)
        row = named(problem, method) | {"error": TOLERANCE, "status": str(one.status), "note": one.message}
        yield POPULATION, row | {"reached": one.error, "evaluations": one.evaluations}


# -- cells ---------------------------------------------------------------------------------------------
def cells(profile: Profile) -> list[Cell]:
    """Return (family, seed, kind of hard problems or blank); smoke has one family."""
    seeds = OWN_SEED or [SEED]
    easy = [(family, "") for family in FAMILIES]
    hard = [(family, kind) for kind in HARD for family in HARD[kind].families]
    chosen = easy[:1] if profile.brief else easy + hard
    return [(family, seed, kind) for seed in seeds for family, kind in chosen]


@experiment(cells)
def population(cell: Cell, profile: Profile) -> Recorded:
    family, seed, kind = cell
    families = HARD[kind].families if kind else (family,)
    count = HARD[kind].count if kind else 1 if profile.brief else COUNT
    rows = hard_rows if kind and not HARD[kind].errors else cost_rows
    for number in range(count):
        if families[number % len(families)] == family:
            yield from rows(draw(seed, family, number, kind))
