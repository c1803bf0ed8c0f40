"""Who keeps the laws?  One cell: a method on a scene at three steps or four tolerances."""

from __future__ import annotations

import numpy as np

import contactbench as cb
from cells import cells, outcome, save_times, scenes, setting, step_budget, steps
from contactbench.measure.laws import (
    contact_deviation,
    energies,
    hamiltonian_deviation,
    has_momentum_law,
    is_contact,
    laws_of,
    momentum_deviation,
    relative_deviation,
)
from contactbench.results.tables import COMMON, LAWS_TABLE, LAWS_TIME

RTOLS = [1e-4, 1e-6, 1e-8, 1e-10]


def ladder(profile):
    return [(scene, method) for scene in scenes(profile) for method in cb.METHODS]


@cells(ladder)
def test_laws(cell, profile, record):
    scene, method = cb.SCENES[cell[0]], cb.METHODS[cell[1]]
    values = RTOLS if method.adaptive else steps(scene, 6)[::2]
    shown = values[1]
    for value in values:
        budget = step_budget(profile, scene, method, method.engines[0])
        solution = cb.solve(
            scene, method.name, save_at=save_times(scene), max_steps=budget, **setting(method, value)
        )
        row = {law.name: law(solution) for law in laws_of(scene)}
        record(
            LAWS_TABLE,
            **outcome(solution),
            saved_times=len(solution.t),
            derivative=solution.sensitivity_source if is_contact(scene) and solution.ok else "",
            **row,
        )
        if value == shown and solution.ok:
            for moment in along_time(solution):
                record(LAWS_TIME, **moment)


def along_time(solution):
    """Rows of the time table."""
    scene, nothing = solution.scene, np.full(len(solution.t), np.nan)
    energy, true_energy, _ = energies(solution)
    columns = {
        "t": solution.t,
        "energy": energy,
        "energy_deviation": relative_deviation(energy, true_energy),
        "hamiltonian_deviation": hamiltonian_deviation(solution) if is_contact(scene) else nothing,
        "momentum_deviation": momentum_deviation(solution) if has_momentum_law(scene) else nothing,
        "contact_deviation": contact_deviation(solution) if is_contact(scene) else nothing,
    }
    key = {name: value for name, value in outcome(solution).items() if name in COMMON}
    for values in zip(*columns.values(), strict=True):
        yield {**key, **dict(zip(columns, map(float, values), strict=True))}
