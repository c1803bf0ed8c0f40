"""Which methods race on a scene: those that lead on problems like it in the tables, and a few that everybody knows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress

import numpy as np
import pandas as pd

from contactbench.errors import BadInput
from contactbench.measure.statistics import costs_to_reach
from contactbench.methods.base import METHODS
from contactbench.plugins import brought
from contactbench.results.contest import CONTACT, contestants
from contactbench.results.regret import COSTS, regrets
from contactbench.results.tables import results
from contactbench.scene import Scene
from contactbench.scenes import SCENES
from contactbench.study.features import features

#: the solvers that a reader asks about, which race whatever they cost
KNOWN = ("rk4", "scipy-dop853", "cyrk-dop853", "cvode-adams")
#: a method leads where it costs at most so many times the least, and races if it leads on this part of the problems
LEADS, PART = 1.25, 0.2
#: problems of the same kind that are asked, those of the nearest damping; damping below which there is none
NEAREST, UNDAMPED = 40, 1e-5
#: errors at which methods are compared on named scenes
ERRORS = (1e-3, 1e-6, 1e-9)


def field(scene: Scene, errors: Iterable[float]) -> list[str]:
    """Return the methods that race by default, what plug-ins bring among them; none where no tables are installed."""
    able = [
        name
        for name, method in METHODS.items()
        if method.refuses(scene) is None and not method.lacks(method.engines[0])
    ]
    leading: set[str] = set()
    with suppress(BadInput):  # a table is missing
        rows = random_problems(scene)
        rows = rows if len(rows) else named_scenes(scene)
        leading = leaders(rows[rows["method"].isin(able)], errors)
        contact = {name for name in able if METHODS[name].family == CONTACT}
        if not leading & contact:  # what the contact form costs is part of the answer
            leading |= leaders(rows[rows["method"].isin(contact)], errors)
    return [name for name in METHODS if name in {*KNOWN, *brought(), *leading}] if leading else []


def leaders(rows: pd.DataFrame, errors: Iterable[float]) -> set[str]:
    """Return the methods that lead on a part of the problems, at one of the errors and by one of the costs."""
    measured, found = rows["error"].unique(), set[str]()
    nearest = {min(measured, key=lambda own: abs(np.log(own / error))) for error in errors if len(measured)}
    for error in nearest:
        for cost in COSTS:
            table = regrets(rows, error, cost)
            share = table.le(LEADS).sum() / table.notna().sum()
            found |= {*share.index[share >= PART]}
    return found


def random_problems(scene: Scene) -> pd.DataFrame:
    """Return what methods cost on the random problems of the same kind whose damping is nearest."""
    problems = results("population_problems").set_index(["seed", "scene"])
    alike = problems[(problems["hard"] == "") & (problems["kind"] == scene.kind)]
    if len(alike) > NEAREST:
        with suppress(BadInput):  # a function fails on the pilot
            damping = max(features(scene).damping, UNDAMPED)
            gaps = np.log(alike["damping"].astype(float).clip(lower=UNDAMPED) / damping).abs()
            alike = alike.loc[gaps.nsmallest(NEAREST).index]
    rows = results("population")
    return rows[pd.MultiIndex.from_frame(rows[["seed", "scene"]]).isin(alike.index)]


def named_scenes(scene: Scene) -> pd.DataFrame:
    """Return what methods cost on the named scenes of the same kind, on all of them where there is none."""
    work = contestants(results("work_precision"))
    alike = work[work["scene"].isin([name for name, own in SCENES.items() if own.kind == scene.kind])]
    return pd.DataFrame(cost_rows(alike if len(alike) else work))


def cost_rows(work: pd.DataFrame) -> Iterator[dict[str, object]]:
    """Yield what each error costs each method on each scene, in the columns of the random problems."""
    measured = {"evaluations": "rhs_equivalents", "time_s": "time_min_s"}
    for (scene, method), own in work[work["status"] == "ok"].groupby(["scene", "method"]):
        reached = own["solution_error"].to_numpy(dtype=float)
        spent = (own[column].to_numpy(dtype=float, na_value=np.nan) for column in measured.values())
        costs = (costs_to_reach(reached, each, ERRORS) for each in spent)
        for error, *both in zip(ERRORS, *costs, strict=True):
            row = {"seed": 0, "scene": scene, "method": method, "error": error, "status": "ok"}
            yield row | dict(zip(measured, both, strict=True))
