"""Choose the methods that race on a scene: the leaders on similar problems, and the contestants of the README."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from contextlib import suppress

import numpy as np
import pandas as pd

from contactbench.errors import BadInput
from contactbench.measure.statistics import costs_to_reach
from contactbench.methods.base import ENGINES, METHODS
from contactbench.plugins import brought
from contactbench.questions.regret import COSTS, regrets
from contactbench.report.look import CONTACT, CONTESTANTS
from contactbench.runs.features import features
from contactbench.scene.base import Scene
from contactbench.scenes import SCENES
from contactbench.tables.declared import TIMES, results

#: a method leads on a problem if its cost is at most this multiple of the least
LEADS = 1.25
#: a method races if it leads on at least this share of the problems
LEAST_SHARE = 0.2
MOST_LEADERS = 12
#: number of random problems consulted, the ones with the nearest damping
NEAREST = 40
#: a smaller damping counts as this one
LEAST_DAMPING = 1e-5
#: errors at which the costs on named scenes are compared
ERRORS = (1e-3, 1e-6, 1e-9)


def field(scene: Scene, errors: Collection[float]) -> list[str]:
    """Return the methods that race by default, with plug-ins, the most likely to lead first; none without tables."""
    able = [name for name, method in METHODS.items() if method.refuses(scene) is None]
    here = [name for name in able if not METHODS[name].lacks(METHODS[name].engines[0])]
    leading: list[str] = []
    with suppress(BadInput):  # a table is missing
        rows, contact = similar(scene), [name for name in here if METHODS[name].family == CONTACT]
        leading = leaders(rows, here, errors)
        if not {*leading} & {*contact}:  # at least one method that keeps the contact form races
            leading += leaders(rows, contact, errors)
    everywhere = [*contestants(), *brought()] if leading else []
    return list(dict.fromkeys(name for name in (*leading, *everywhere) if name in able))


def contestants() -> list[str]:
    """Return the first contestant of every line and kind of engine that is registered."""
    found: dict[tuple[int, str], str] = {}
    for place, line in enumerate(CONTESTANTS):
        for name in filter(METHODS.__contains__, line):
            found.setdefault((place, ENGINES.get(METHODS[name].engines[0], "compiled")), name)
    return list(found.values())


def leaders(rows: pd.DataFrame, methods: list[str], errors: Collection[float]) -> list[str]:
    """Return the methods that lead on enough problems for some error and some cost, best first."""
    rows = rows[rows["method"].isin(methods)]
    measured, parts = rows["error"].unique(), dict[str, float]()
    nearest = {min(measured, key=lambda own: abs(np.log(own / error))) for error in errors if len(measured)}
    for table in (regrets(rows, error, cost) for error in nearest for cost in COSTS):
        share = table.le(LEADS).sum() / table.notna().sum()
        parts |= {name: max(part, parts.get(name, 0.0)) for name, part in share[share >= LEAST_SHARE].items()}
    return sorted(parts, key=lambda name: -parts[name])[:MOST_LEADERS]


def similar(scene: Scene) -> pd.DataFrame:
    """Return the costs on random problems of the kind with the nearest damping, else on named scenes."""
    problems, damping = results("problems").set_index(["seed", "scene"]), np.nan
    with suppress(BadInput):  # a pilot run fails
        damping = max(float(features(scene).damping), LEAST_DAMPING)
    drawn = problems[(problems["hard"].fillna("") == "") & (problems["kind"] == scene.kind)]
    gaps = np.log(drawn["damping"].astype(float).clip(lower=LEAST_DAMPING) / damping).abs()
    near, rows = (gaps.nsmallest(NEAREST) if damping == damping else gaps), results("population")
    rows = rows[pd.MultiIndex.from_frame(rows[["seed", "scene"]]).isin(near.index)]
    return rows if len(rows) else costs_on(name for name, own in SCENES.items() if own.kind == scene.kind)


def costs_on(scenes: Iterable[str]) -> pd.DataFrame:
    """Return the cost of each error for each method and named scene, in the columns of the random problems."""
    runs, times = (results(name).query("saved == 1") for name in ("runs", "times"))
    alike = runs[runs["scene"].isin([*scenes])]
    done = (runs if alike.empty else alike).query("status == 'ok'").merge(times, "left", list(TIMES.key))
    found = []
    for (scene, method), own in done.groupby(["scene", "method"]):
        reached, *spent = (
            own[name].to_numpy(float, na_value=np.nan) for name in ("error", "evaluations", "least_s")
        )
        costs = (costs_to_reach(reached, each, ERRORS) for each in spent)
        key = {"seed": 0, "scene": scene, "method": method, "status": "ok"}
        for error, *each in zip(ERRORS, *costs, strict=True):
            found.append(key | {"error": error} | dict(zip(COSTS, each, strict=True)))
    return pd.DataFrame(found, columns=["seed", "scene", "method", "error", "status", *COSTS])
