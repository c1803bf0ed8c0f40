"""What does an error cost on problems nobody chose?  One cell: the problems of a family and a seed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from contactbench.measure.clock import Call
from contactbench.methods.base import METHODS, Method, prepare
from contactbench.peers.heyoka import SHARED
from contactbench.runs.experiment import Cell, Profile, Recorded, Row, experiment
from contactbench.runs.features import Features, features
from contactbench.runs.problems import (
    COUNT,
    FAMILIES,
    HARD,
    HARD_COUNT,
    SEED,
    Problem,
    draw,
)
from contactbench.runs.search import Attempt, Question
from contactbench.runs.settings import carry_of
from contactbench.runs.trial import CLEAR, ENDS, Trial, agreed, is_short
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.tables.declared import POPULATION, POPULATION_HARD, POPULATION_PROBLEMS
from contactbench.truth import Reference

#: those that are best on such problems in the tables, the classical ones, and what libraries compile soon; first those
#: by whose cost others are given up
RACED = (
    *("rkn12-10", "rkn8", "rk8-7", "rkn8-6", "rkn12", "rk8", "contact-rkn8", "contact-rkn6", "contact-rkn4"),
    *("contact-o8", "contact-bm6", "contact-strang", "contact-exact", "contact-log8", "rk4"),
    *("quinlan-tremaine8", "quinlan-tremaine12"),
    *("cvode-adams", "cyrk-dop853", "cyrk-vern8", "cyrk-lsoda", "heyoka-taylor"),
)
#: what runs under a name, where it is not what is registered
ALIKE = {SHARED.name: SHARED}
ERRORS = (1e-3, 1e-6, 1e-9)
#: visits of a call, and how many times slower than the fastest it may be to be visited again
VISITS, SLOWER = 3, 10.0
#: of hard problems: the tolerance, what is wrong, and steps in a period of what takes no tolerance
TOLERANCE, WRONG, HARD_STEPS = 1e-6, 1e3, 1000
#: the seed that `--seed` gives; empty: that of the repository
OWN_SEED: list[int] = []


# -- the truth ---------------------------------------------------------------------------------------
#: pairs are tried until one is refused by neither
TIGHT = (("rkn12-10", 1e-14), ("rk8-7", 1e-14))


def truth_of(problem: Problem) -> tuple[Reference | None, str]:
    """Return what two solvers agree on at the ends, and which; None where either fails."""
    scene, carry = problem.scene, carry_of(problem.scene)
    ends = [part * scene.t_end for part in ENDS]
    method, rtol = next(each for each in TIGHT if METHODS[each[0]].refuses(scene) is None)
    solvers: list[tuple[Method | str, float]] = [(SHARED, SHARED.rtol_range[0])]
    solvers.append((method, max(rtol, METHODS[method].rtol_range[0])))
    found = [prepare(scene, one, save_at=Elapsed(ends), carry=carry, rtol=tight)() for one, tight in solvers]
    source = f"heyoka-taylor, {method}"
    if not all(one.ok for one in found):
        return None, next(f"{one.method}: {one.message}" for one in found if not one.ok)
    return agreed(scene, carry, *found), source


# -- rows ----------------------------------------------------------------------------------------------
def examine(problem: Problem) -> tuple[Row, Features, Reference | None]:
    """Return the row of a problem, what a pilot finds, and the truth."""
    scene, known = problem.scene, features(problem.scene)
    truth, source = truth_of(problem)
    row = {"seed": problem.seed, "scene": scene.name, "structure": problem.family, "hard": problem.hard}
    row |= {"t_end": scene.t_end, "short": is_short(scene, known), "source": source}
    return row | {"digits": truth.digits if truth else 0} | asdict(known), known, truth


def raced(scene: Scene) -> dict[str, Method]:
    every = {name: ALIKE.get(name, METHODS[name]) for name in RACED}
    return {name: method for name, method in every.items() if not method.refuses(scene)}


def cost_rows(problem: Problem) -> Recorded:
    row, known, truth = examine(problem)
    yield POPULATION_PROBLEMS, row
    if truth is None:
        return
    targets = [error for error in ERRORS if error >= CLEAR * 10.0**-truth.digits]
    question = Question(problem.scene, truth, ERRORS, math.inf)
    trials = [Trial(question, method, known) for method in raced(problem.scene).values()]
    least: dict[float, float] = {}
    with np.errstate(all="ignore"):
        for trial in trials:
            trial.search(targets, least)
        seconds = visited([a for trial in trials for error in targets if (a := trial.best(error))])
    for trial in trials:
        for row in trial.rows(targets, seconds):
            name = {"seed": problem.seed, "scene": problem.scene.name, "method": trial.method.name}
            yield POPULATION, name | row


def visited(tried: Sequence[Attempt]) -> dict[int, float]:
    """Return the least time of the bare call of each setting, all visited in turns; of slow ones that of its run."""
    seconds = {id(one): one.seconds for one in tried}
    most = SLOWER * min(seconds.values(), default=0.0)
    runs = {id(one): one.run for one in tried if one.run and one.seconds <= most}
    calls = {name: Call(run.bare_call(), round_seconds=1e-4) for name, run in runs.items()}
    for _ in range(VISITS):
        for call in calls.values():
            call.visit(1)
    return seconds | {name: call.once[0] for name, call in calls.items()}


def hard_rows(problem: Problem) -> Recorded:
    """Yield how each method ends that is given a tolerance, or a step where it takes none."""
    row, known, truth = examine(problem)
    yield POPULATION_PROBLEMS, row
    if truth is None or 10.0**-truth.digits * CLEAR > TOLERANCE * WRONG:
        return
    question = Question(problem.scene, truth, ERRORS, math.inf)
    for name, method in raced(problem.scene).items():
        steps = method.control == "step" and not (method.one_step or method.follows)
        control = "exact" if method.exact else "step" if steps else "rtol"
        value = 2 * math.pi / known.omega / HARD_STEPS if steps else TOLERANCE
        with np.errstate(all="ignore"):
            one = Trial(question, method, known).attempt(0.0 if method.exact else value, control)
        row = {"seed": problem.seed, "scene": problem.scene.name, "hard": problem.hard, "method": name}
        row |= {"control": control, "value": one.value, "status": str(one.status), "message": one.message}
        row |= {"engine": one.engine, "error_reached": one.error, "evaluations": one.evaluations}
        yield POPULATION_HARD, row | {"right": one.error <= TOLERANCE * WRONG if one.ok else None}


# -- cells ---------------------------------------------------------------------------------------------
#: of the smoke profile the first problem of these
SMOKE = ("pendulum", "toda-2")


def cells(profile: Profile) -> list[Cell]:
    """Return family, seed, and the first and last of its problems, or kind of hard problem and seed."""
    seeds = OWN_SEED or [SEED]
    found: list[Cell] = [(family, seed, 0, 1) for seed in seeds for family in SMOKE]
    if not profile.brief:
        found += [(family, seed, int(family in SMOKE), COUNT) for seed in seeds for family in FAMILIES]
    return found


def hard_cells(profile: Profile) -> list[Cell]:
    seeds = OWN_SEED or [SEED]
    return [] if profile.brief else [(kind, seed) for seed in seeds for kind in HARD]


@experiment(cells)
def population(cell: Cell, profile: Profile) -> Recorded:
    family, seed, low, high = cell
    for number in range(low, high):
        yield from cost_rows(draw(seed, family, number))


@experiment(hard_cells)
def population_hard(cell: Cell, profile: Profile) -> Recorded:
    kind, seed = cell
    for number in range(HARD_COUNT):
        families = HARD[kind].families
        yield from hard_rows(draw(seed, families[number % len(families)], number, kind))
