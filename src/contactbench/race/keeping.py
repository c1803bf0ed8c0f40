"""Which laws of the motion a method keeps at a setting."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd

from contactbench.errors import BadInput
from contactbench.measure.ladder import setting
from contactbench.measure.laws import Law, laws_of
from contactbench.measure.pullback import growth
from contactbench.measure.round_off import decided
from contactbench.methods.base import METHODS
from contactbench.methods.entry import prepare
from contactbench.race.scout import Attempt, Question, Scouted
from contactbench.results.judgement import bound
from contactbench.scene import Scene

#: measures of a run that are no laws, or that another one covers
LEFT_OUT = ("solution_error", "energy_law_relative", "energy_increases", "own_factor_drift")
FROZEN = "_frozen"
#: what a derivative costs, roughly: compilations of the solver, and runs
COMPILATIONS, RUNS = 2.0, 100.0


def laws_shown(scene: Scene) -> list[Law]:
    """The laws of a scene that a comparison has columns for."""
    return [law for law in laws_of(scene) if law.name not in LEFT_OUT and not law.name.endswith(FROZEN)]


def expected(scouted: Scouted, attempt: Attempt) -> float:
    """About how many seconds the derivative of the map takes."""
    return COMPILATIONS * scouted.compile_s + RUNS * attempt.seconds


def laws_at(question: Question, scouted: Scouted, attempt: Attempt, seconds: float) -> dict[str, float]:
    """Deviations from the laws at the five times, of a run that carries every field.

    seconds : how long it may take; what is expected to take longer is left out.
    """
    scene, item = question.scene, METHODS[scouted.method]
    if seconds < (scouted.compile_s if scouted.engine == "jax" else 0.0):  # another field is another program
        return {}
    options: dict[str, Any] = {**setting(item, attempt.value), "engine": scouted.engine}
    solution = prepare(scene, item.name, save_at=question.times, **options)()
    affordable = expected(scouted, attempt) <= seconds
    found = {
        law.name: _measured(law, solution)
        for law in laws_shown(scene) if affordable or not law.differentiates
    }  # fmt: skip
    if affordable and scene.is_contact and solution.ok and solution.differential.taken:
        found["map_growth"] = growth(solution.differential)
    return found


def _measured(law: Law, solution: object) -> float:
    try:
        return float(law(solution))  # type: ignore[arg-type]
    except BadInput:  # H(0) = 0, say: the law has nothing to be relative to
        return math.nan


def kept(frame: pd.DataFrame, scene: Scene) -> list[str]:
    """For each row the labels of the laws kept to round-off, by the bound of the tables of laws."""
    names = {law.name: law.label or law.name for law in laws_shown(scene) if law.name in frame}
    shown = {label: decided(frame[name], bound(frame, name))[0] for name, label in names.items()}
    return [", ".join(label for label, keeps in shown.items() if keeps[i]) for i in frame.index]
