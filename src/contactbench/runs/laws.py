"""Who keeps the laws?  One cell: a method on a scene at three steps or up to four tolerances."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import contactbench as cb
from contactbench.measure.law import relative_deviation
from contactbench.measure.laws import LAWS, energies, row
from contactbench.runs.choice import affordable, outcome, pairs, step_budget
from contactbench.runs.experiment import Cell, Profile, Recorded, Row, experiment
from contactbench.runs.settings import halving_steps, times
from contactbench.scene.base import Elapsed
from contactbench.solution import Solution, keywords
from contactbench.tables.declared import LAWS_TABLE, LAWS_TIME

RTOLS = [1e-4, 1e-6, 1e-8, 1e-10]
#: the one at which laws are shown along time
SHOWN = RTOLS[1]
#: components from which on the map of an adaptive solver is not differentiated, by runs or equations for each of them
MANY = 32


@experiment(lambda profile: pairs(profile, "laws", cb.METHODS))
def laws(cell: Cell, profile: Profile) -> Recorded:
    scene, method = cb.SCENES[cell[0]], cb.METHODS[cell[1]]
    steps, rtols = halving_steps(scene, 6)[::2], affordable(RTOLS, method.name, profile)
    values = {"step": steps, "rtol": rtols}.get(method.control, [0.0])
    shown = {"step": steps[1:2], "rtol": [SHOWN]}.get(method.control, values)
    if method.refuses(scene) is not None:  # one row says why
        values = values[:1]
    each = f"{scene.motion} components, with runs for each"
    without = each if method.adaptive and scene.motion > MANY else ""
    for value in values:
        budget = step_budget(profile, scene, method, method.engines[0])
        options = {"save_at": Elapsed(times(scene)), "max_steps": budget, **keywords(method.control, value)}
        solution = cb.solve(scene, method.name, **options)
        yield LAWS_TABLE, outcome(solution) | {"saved_times": len(solution.t)} | row(solution, without)
        if value in shown and solution.ok:
            yield from ((LAWS_TIME, each) for each in along_time(solution))


#: the columns of `laws_time`, and the laws whose deviations they hold
DEVIATIONS = {"hamiltonian": "hamiltonian_law", "momentum": "momentum_law", "contact": "contact_drift"}


def along_time(solution: Solution) -> Iterator[Row]:
    numerical, exact = energies(solution)
    columns = {"t": solution.elapsed}
    columns["energy_deviation"] = relative_deviation(numerical, exact)
    for name, law in DEVIATIONS.items():
        found = LAWS[law].along(solution) if LAWS[law].applies(solution.scene) else np.nan
        columns[f"{name}_deviation"] = getattr(found, "size", np.full(len(solution.t), np.nan))
    key = {name: value for name, value in outcome(solution).items() if name in LAWS_TIME.columns}
    for values in zip(*columns.values(), strict=True):
        yield {**key, **dict(zip(columns, map(float, values), strict=True))}
