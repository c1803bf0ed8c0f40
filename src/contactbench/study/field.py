"""Which methods race on a scene: the leaders on similar problems in the tables, and the best-known solvers."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress

import numpy as np
import pandas as pd

from contactbench.errors import BadInput
from contactbench.measure.statistics import costs_to_reach
from contactbench.methods.base import METHODS
from contactbench.plugins import brought
from contactbench.questions.contest import CONTACT
from contactbench.questions.regret import COSTS, regrets
from contactbench.runs.features import features
from contactbench.runs.problems import DAMPING
from contactbench.scene import Scene
from contactbench.scenes import SCENES
from contactbench.tables.declared import results

#: solvers that every reader knows: they race on every scene
KNOWN = ("rk4", "scipy-dop853", "cyrk-dop853", "cvode-adams")
#: a method leads on a problem if its cost is at most `LEADS` times the least; it races if it leads on at
#: least the share `PART` of the problems
LEADS, PART = 1.25, 0.2
#: the same factor for hard scenes, whose runs are timed only once
LEADS_ONCE = 1.5
#: the most leaders taken from one set of problems: those that lead on the largest part of it
MOST = 12
#: how many random problems are consulted, those with the nearest damping; a smaller damping counts as this one
NEAREST, UNDAMPED = 40, 1e-5
#: errors at which the costs on named scenes are compared
ERRORS = (1e-3, 1e-6, 1e-9)


def field(scene: Scene, errors: Collection[float]) -> list[str]:
    """Return the methods that race by default, those of plug-ins included; none if no tables are installed."""
    able = [
        name
        for name, method in METHODS.items()
        if method.refuses(scene) is None and not method.lacks(method.engines[0])
    ]
    contact = [name for name in able if METHODS[name].family == CONTACT]
    leading: set[str] = set()
    with suppress(BadInput):  # a table is missing
        damping = damping_of(scene)
        rows = random_problems(scene, damping)
        rows = rows if len(rows) else named_scenes(scene)
        leading = leaders(rows, able, errors)
        if not leading & {*contact}:  # what the contact form costs is part of the answer
            leading |= leaders(rows, contact, errors)
        if damping > DAMPING[1]:  # stronger than of any random problem
            leading |= leaders(strongly_damped_scenes(scene), able, errors, LEADS_ONCE)
    return [name for name in METHODS if name in {*KNOWN, *brought(), *leading}] if leading else []


def leaders(
    rows: pd.DataFrame, methods: list[str], errors: Collection[float], most: float = LEADS
) -> set[str]:
    """Return the methods that lead on enough problems, at any of the errors and by any of the costs."""
    rows = rows[rows["method"].isin(methods)]
    measured, parts = rows["error"].unique(), dict[str, float]()
    nearest = {min(measured, key=lambda own: abs(np.log(own / error))) for error in errors if len(measured)}
    for error in nearest:
        for cost in COSTS:
            table = regrets(rows, error, cost)
            share = table.le(most).sum() / table.notna().sum()
            parts |= {name: max(part, parts.get(name, 0.0)) for name, part in share[share >= PART].items()}
    return {*sorted(parts, key=lambda name: -parts[name])[:MOST]}


def damping_of(scene: Scene) -> float:
    """Return the ratio of damping to frequency, estimated by a pilot run; nan if the pilot fails."""
    with suppress(BadInput):
        return max(float(features(scene).damping), UNDAMPED)
    return np.nan


def random_problems(scene: Scene, damping: float) -> pd.DataFrame:
    """Return the costs on the random problems of the same kind with the nearest damping."""
    problems = results("population_problems").set_index(["seed", "scene"])
    alike = problems[(problems["hard"] == "") & (problems["kind"] == scene.kind)]
    if damping == damping:
        gaps = np.log(alike["damping"].astype(float).clip(lower=UNDAMPED) / damping).abs()
        alike = alike.loc[gaps.nsmallest(NEAREST).index]
    rows = results("population")
    return rows[pd.MultiIndex.from_frame(rows[["seed", "scene"]]).isin(alike.index)]


def named_scenes(scene: Scene) -> pd.DataFrame:
    """Return the costs on the named scenes of the same kind, or on all named scenes if there is none."""
    work = results("work_precision")
    alike = work[work["scene"].isin([name for name, own in SCENES.items() if own.kind == scene.kind])]
    return cost_rows(alike if len(alike) else work, "time_min_s")


def strongly_damped_scenes(scene: Scene) -> pd.DataFrame:
    """Return the costs on the hard scenes of the same kind with more damping than any random problem."""
    hard = results("stability")
    alike = (SCENES[name] for name in hard["scene"].unique() if name in SCENES)
    names = [own.name for own in alike if own.kind == scene.kind and damping_of(own) > DAMPING[1]]
    return cost_rows(hard[hard["scene"].isin(names)], "time_s")


def cost_rows(runs: pd.DataFrame, time: str) -> pd.DataFrame:
    """Return the cost of each error for each method and scene, in the columns of the random problems."""
    found = []
    for (scene, method), own in runs[runs["status"] == "ok"].groupby(["scene", "method"]):
        columns = (own[name].to_numpy(dtype=float, na_value=np.nan) for name in ("rhs_equivalents", time))
        reached = own["solution_error"].to_numpy(dtype=float)
        costs = (costs_to_reach(reached, spent, ERRORS) for spent in columns)
        key = {"seed": 0, "scene": scene, "method": method, "status": "ok"}
        for error, *each in zip(ERRORS, *costs, strict=True):
            found.append(key | {"error": error} | dict(zip(COSTS, each, strict=True)))
    return pd.DataFrame(found, columns=["seed", "scene", "method", "error", "status", *COSTS])
