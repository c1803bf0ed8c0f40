"""Which methods race on a scene: those that lead on problems like it in the tables, and a few that everybody knows."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress

import numpy as np
import pandas as pd

from contactbench.errors import BadInput
from contactbench.measure.statistics import costs_to_reach
from contactbench.methods.base import METHODS
from contactbench.plugins import brought
from contactbench.scene import Scene
from contactbench.scenes import SCENES
from contactbench.study.features import features
from contactbench.study.problems import DAMPING
from contactbench.tables.contest import CONTACT
from contactbench.tables.declared import results
from contactbench.tables.regret import COSTS, regrets

#: the solvers that a reader asks about, which race whatever they cost
KNOWN = ("rk4", "scipy-dop853", "cyrk-dop853", "cvode-adams")
#: a method leads where it costs at most so many times the least, and races if it leads on this part of the problems
LEADS, PART = 1.25, 0.2
#: and on hard scenes, whose runs are timed once
LEADS_ONCE = 1.5
#: leaders that race at most, those that lead on most of the problems
MOST = 12
#: problems of the same kind that are asked, those of the nearest damping; damping below which there is none
NEAREST, UNDAMPED = 40, 1e-5
#: errors at which methods are compared on named scenes
ERRORS = (1e-3, 1e-6, 1e-9)


def field(scene: Scene, errors: Collection[float]) -> list[str]:
    """Return the methods that race by default, what plug-ins bring among them; none where no tables are installed."""
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
    """Return which methods lead on a part of the problems, at one of the errors and by one of the costs."""
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
    """Return damping over frequency as a pilot finds it, nan where a function fails on it."""
    with suppress(BadInput):
        return max(float(features(scene).damping), UNDAMPED)
    return np.nan


def random_problems(scene: Scene, damping: float) -> pd.DataFrame:
    """Return what methods cost on the random problems of the same kind whose damping is nearest."""
    problems = results("population_problems").set_index(["seed", "scene"])
    alike = problems[(problems["hard"] == "") & (problems["kind"] == scene.kind)]
    if damping == damping:
        gaps = np.log(alike["damping"].astype(float).clip(lower=UNDAMPED) / damping).abs()
        alike = alike.loc[gaps.nsmallest(NEAREST).index]
    rows = results("population")
    return rows[pd.MultiIndex.from_frame(rows[["seed", "scene"]]).isin(alike.index)]


def named_scenes(scene: Scene) -> pd.DataFrame:
    """Return what methods cost on the named scenes of the same kind, on all of them where there is none."""
    work = results("work_precision")
    alike = work[work["scene"].isin([name for name, own in SCENES.items() if own.kind == scene.kind])]
    return cost_rows(alike if len(alike) else work, "time_min_s")


def strongly_damped_scenes(scene: Scene) -> pd.DataFrame:
    """Return what methods cost on the hard scenes of the same kind that are damped beyond the random problems."""
    hard = results("stability")
    alike = (SCENES[name] for name in hard["scene"].unique() if name in SCENES)
    names = [own.name for own in alike if own.kind == scene.kind and damping_of(own) > DAMPING[1]]
    return cost_rows(hard[hard["scene"].isin(names)], "time_s")


def cost_rows(runs: pd.DataFrame, time: str) -> pd.DataFrame:
    """Return what each error costs each method on each scene, in the columns of the random problems."""
    found = []
    for (scene, method), own in runs[runs["status"] == "ok"].groupby(["scene", "method"]):
        columns = (own[name].to_numpy(dtype=float, na_value=np.nan) for name in ("rhs_equivalents", time))
        reached = own["solution_error"].to_numpy(dtype=float)
        costs = (costs_to_reach(reached, spent, ERRORS) for spent in columns)
        key = {"seed": 0, "scene": scene, "method": method, "status": "ok"}
        for error, *each in zip(ERRORS, *costs, strict=True):
            found.append(key | {"error": error} | dict(zip(COSTS, each, strict=True)))
    return pd.DataFrame(found, columns=["seed", "scene", "method", "error", "status", *COSTS])
