"""Which method for a scene, at once: a short pilot, and what the problems of the population like it say."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pandas as pd

from contactbench.checks import finite, whole
from contactbench.errors import BadInput, excerpt
from contactbench.methods.base import METHODS
from contactbench.results.advice import COSTS, distances, ranked, regrets, threshold
from contactbench.results.tables import results
from contactbench.scene import Scene
from contactbench.scene.base import scene_of
from contactbench.study.features import features

#: methods that are named
NAMED = 3
COLUMNS = ["method", "setting", "value", "evaluations", "best", "regret", "regret_90"]


@lru_cache(1)
def known() -> tuple[pd.DataFrame, pd.DataFrame, float]:
    """Return the rows of the population, its problems that are not hard, and the distance that is far."""
    problems = results("population_problems")
    problems = problems[problems["hard"] == ""].set_index(["seed", "scene"])
    return results("population"), problems, threshold(problems)


def advise(scene: Scene | str, error: float = 1e-6, cost: str = "time", methods: int = NAMED) -> pd.DataFrame:
    """Say which methods to take for a scene, without compiling any: from problems of the population like it.

    Parameters
    ----------
    scene :
        A scene or the name of one.
    error :
        Error wanted at the end, relative to the motion, between 1e-9 and 1e-3; the nearest decade of these that is
        measured, by three, is taken.
    cost :
        "time", compiled, or "evaluations" of the right-hand side.
    methods :
        How many to name.

    Returns
    -------
    pandas.DataFrame
        A row for each method, the best first: method, setting ("step" or "rtol"), value to begin with, evaluations
        expected, best (how often it was the best of the problems like this one), regret (median of its cost over the
        least there) and regret_90 (its 90 % quantile).  ``attrs``: "features" (what the pilot found), "nearest"
        (problems of the population like it), "distance" of the nearest, "far" (whether it is unlike all of them),
        "error", "cost".

    Raises
    ------
    BadInput
        For a wrong argument, and where no population comes with the installation.

    Examples
    --------
    >>> import contactbench as cb
    >>> advice = cb.advise("particle", error=1e-6)  # doctest: +SKIP
    """
    scene = scene_of(scene)
    costs = {name.removesuffix("_s"): name for name in COSTS}
    if cost not in costs:
        raise BadInput(f"cost = {excerpt(cost)}: must be one of {', '.join(costs)}")
    whole("methods", methods, len(METHODS))
    if not 0 < finite("error", error) < 1:
        raise BadInput(
            f"error = {excerpt(error)}: must be between 0 and 1, relative to the size of the motion"
        )
    rows, problems, far = known()
    measured = rows["error"].unique()
    taken = float(min(measured, key=lambda each: abs(np.log(each / error))))
    found = features(scene)
    table = regrets(rows, taken, costs[cost])
    own = problems.loc[table.index]
    gaps = distances(pd.DataFrame([found.row()]), own)[0]
    allowed = [name for name in table if METHODS[name].refuses(scene) is None]
    order = ranked(table, gaps, allowed).head(methods)
    near = [own.index[i] for i in np.argsort(gaps, kind="stable")]
    lines = []
    for name, one in order.iterrows():
        there = rows[(rows["error"] == taken) & (rows["method"] == name) & (rows["status"] == "ok")]
        there = there.set_index(["seed", "scene"])
        there = there.loc[[key for key in near if key in there.index][: NAMED * 2]].join(
            own[["omega", "span"]]
        )
        control = METHODS[name].control
        scale = there["omega"] / found.omega if control == "step" else 1.0
        each = there["evaluations"] / there["span"] * found.span
        lines.append(
            (name, control, gmean(there["value"] * scale), gmean(each), *one[["best", "regret", "regret_90"]])
        )
    frame = pd.DataFrame(lines, columns=COLUMNS)
    frame.attrs = {
        "scene": scene.name,
        "error": taken,
        "cost": cost,
        "features": found.row(),
        "nearest": [f"{name} of seed {seed}" for seed, name in near[:NAMED]],
        "distance": float(gaps.min()),
        "far": bool(gaps.min() > far),
    }
    return frame


def gmean(values: pd.Series) -> float:
    with np.errstate(divide="ignore"):  # nothing is set of an exact method
        return float(np.exp(np.log(values.to_numpy(dtype=float)).mean()))
