"""What is kept at equal cost?  One cell: a method on a scene, its errors and decay laws at equal evaluations."""

from __future__ import annotations

from typing import cast

import contactbench as cb
from contactbench.measure.laws import row as law_columns
from contactbench.methods.base import Method
from contactbench.methods.fixed_step import FixedStep
from contactbench.runs.choice import outcome, pairs, step_budget
from contactbench.runs.experiment import Cell, Profile, Recorded, Row, experiment
from contactbench.runs.search import right_hand_sides, step_at, tolerance_at
from contactbench.runs.settings import times
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.solution import EXACT, Solution, keywords
from contactbench.tables.declared import DECAY_LAWS

#: of the scenes of every experiment
FEW = ("oscillator", "particle", "central", "rigid_body")
#: right-hand sides per unit of time: what the better methods take to follow these motions to three digits, and more
COSTS = (30.0, 100.0)
SAVES = 5


def ladder(profile: Profile) -> list[Cell]:
    costs = COSTS[:1] if profile.brief else COSTS
    chosen = pairs(profile, "decay_laws", cb.METHODS)
    some = (pair for pair in chosen if pair[0] in FEW or cb.SCENES[pair[0]].experiments)
    return [(*pair, cost) for pair in some for cost in costs]


def to_the_end(scene: Scene, method: Method, value: float, budget: int | None) -> Solution:
    """Return a run to the end, saved there alone; of diffrax, where that changes nothing, as the laws' program does."""
    saves = times(scene, SAVES) if method.adaptive and method.engines[0] == "jax" else [scene.t_end]
    return cb.solve(
        scene, method.name, save_at=Elapsed(saves), max_steps=budget, **keywords(method.control, value)
    )


def evaluations(scene: Scene, method: Method, value: float, budget: int | None = None) -> float:
    return right_hand_sides(to_the_end(scene, method, value, budget))


def value_at(scene: Scene, method: Method, target: float, budget: int | None = None) -> float:
    if method.refuses(scene) is not None:
        return method.rtol_range[1] if method.adaptive else scene.t_end / SAVES
    if method.control == EXACT:
        return 0.0
    if method.adaptive:
        return tolerance_at(lambda rtol: evaluations(scene, method, rtol, budget), target, method.rtol_range)
    return step_at(cast(FixedStep, method), scene, target, SAVES)  # or a library's, which says the same


def laws_row(scene: Scene, method: Method, value: float, budget: int | None) -> Row:
    setting = keywords(method.control, value)
    solution = cb.solve(scene, method.name, save_at=Elapsed(times(scene, SAVES)), max_steps=budget, **setting)
    if not solution.ok:
        return {"status": str(solution.status), "message": solution.message}
    return {name: value for name, value in law_columns(solution).items() if name in DECAY_LAWS.columns}


@experiment(ladder)
def decay_laws(cell: Cell, profile: Profile) -> Recorded:
    scene, method, cost = cb.SCENES[cell[0]], cb.METHODS[cell[1]], cell[2]
    # that of the laws at all tolerances, many times what is asked for: their programs serve here too
    budget = step_budget(profile, scene, method, method.engines[0])
    value = value_at(scene, method, cost * scene.t_end, budget)
    solution = to_the_end(scene, method, value, budget)
    row = outcome(solution) | {"cost": cost, "control": method.control, "value": value}
    if solution.ok:
        row |= laws_row(scene, method, value, budget)
    yield DECAY_LAWS, row
