"""Which method for a scene, at once: a short pilot, what methods take in Python, what the population says."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from functools import lru_cache
from time import process_time

import numpy as np
import pandas as pd

from contactbench.blame import UserError
from contactbench.checks import finite, whole
from contactbench.errors import BadInput, excerpt
from contactbench.methods.base import METHODS
from contactbench.results.advice import COSTS, distances, outlook, rates, regrets, threshold
from contactbench.results.tables import results
from contactbench.scene import Scene
from contactbench.scene.base import scene_of
from contactbench.study.experiment import Row
from contactbench.study.features import Features, features
from contactbench.study.search import BROKEN, Question
from contactbench.study.trial import Trial, most_in_python, short_truth

#: methods that are named
NAMED = 3
COLUMNS = ["method", "setting", "value", "evaluations", "expected", "tried", "best", "regret", "regret_90"]
#: seconds after which no other method is tried, and how many times the least a run may cost there
SECONDS, GIVEN_UP = 1.4, 4.0
#: seconds of a pilot from which on nothing is tried
SLOW = 1.0


@lru_cache(1)
def known() -> tuple[pd.DataFrame, pd.DataFrame, float]:
    """Return rows of the registered methods, the problems that are not hard, and the distance that is far."""
    problems, rows = results("population_problems"), results("population")
    problems = problems[problems["hard"] == ""].set_index(["seed", "scene"])
    return rows[rows["method"].isin(METHODS)], problems, threshold(problems)


def advise(scene: Scene | str, error: float = 1e-6, cost: str = "time", methods: int = NAMED) -> pd.DataFrame:
    """Say which methods to take for a scene, without compiling any: from problems of the population like it.

    Parameters
    ----------
    scene :
        A scene or the name of one.
    error :
        Error wanted at the end, relative to the motion.  Methods are tried for it; of problems like it the nearest of
        1e-3, 1e-6 and 1e-9 is taken.
    cost :
        "time", compiled, or "evaluations" of the right-hand side.
    methods :
        How many to name.

    Returns
    -------
    pandas.DataFrame
        A row for each method, the best first: method, setting ("step" or "rtol"), value to begin with, evaluations
        to expect, expected (its cost over that of the first), tried (whether it reached the error on this very
        motion, which then is short, with this value and these evaluations; else both are those of problems like it,
        to begin with); best (how often it was the best of
        the problems like this one), regret (median of its cost over the least there) and regret_90 (its 90 %
        quantile).  ``attrs``: "features" (what the pilot found), "nearest" (problems of the population like it),
        "distance" of the nearest, "far" (whether it is unlike all of them and nothing could be tried),
        "stiff" (whether damping over frequency is larger than of any of them), "error", "cost".

    Raises
    ------
    BadInput
        For a wrong argument, a motion that diverges before its end (`Status.diverged`), and where no population
        comes with the installation.

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
    begun = process_time()
    found = features(scene)
    if found.left < scene.t_end:
        raise BadInput(
            f"scene {scene.name!r}: its motion left its scale by a factor 1e6 by t = {found.left:.6g}, "
            "where runs end as diverged: choose t_end before that"
        )
    table = regrets(rows, taken, costs[cost])
    own = problems.loc[table.index]
    gaps = distances(pd.DataFrame([found.row()]), own)[0]
    runs = np.array([METHODS[name].refuses(scene) is None for name in table])
    trials: dict[str, Row] = {}

    def evaluations_of(places: np.ndarray) -> np.ndarray:
        trials.update(tried(scene, found, table.columns[places], error, begun))
        return np.array([trials[name]["cost"] if name in trials else np.nan for name in table])

    each = rates(rows, taken, costs[cost], table)
    said = outlook(table, each, gaps, runs, evaluations_of)
    score, near, weights = said.score, said.near, said.weights
    order = np.argsort(score, kind="stable")[: min(methods, int(np.isfinite(score).sum()))]
    rows = rows[(rows["error"] == taken) & (rows["status"] == "ok")].set_index(["seed", "scene"])
    alike = {
        name: beginning(rows[rows["method"] == name], own.iloc[near], found)
        for name in {*trials, *table.columns[order]}
    }
    ratios = (row["evaluations"] / alike[name]["evaluations"] for name, row in trials.items())
    # what is not tried will take more than on problems alike too, as what is
    more = np.median([each for each in ratios if 0 < each < np.inf] or [1.0])
    lines = []
    for place in order:
        name, there = table.columns[place], table.iloc[near, place]
        begin = trials.get(name) or alike[name]
        evaluations = begin["evaluations"] * (1.0 if name in trials else more)
        best = float((there.le(1.0) * weights).sum() / weights.sum())
        expected = float(np.exp(score[place] - np.min(score)))
        setting = (name, METHODS[name].control, begin["value"], evaluations, expected, name in trials)
        lines.append((*setting, best, there.median(), there.quantile(0.9)))
    frame = pd.DataFrame(lines, columns=COLUMNS)
    frame.attrs = {
        "scene": scene.name,
        "error": error if trials else taken,
        "cost": cost,
        "features": found.row(),
        "nearest": [f"{name} of seed {seed}" for seed, name in own.index[near[:NAMED]]],
        "distance": float(gaps.min()),
        "far": bool(gaps.min() > far) and not trials,
        "stiff": bool(found.damping > problems["damping"].max()),
    }
    return frame


def tried(
    scene: Scene, known: Features, methods: Iterable[str], error: float, begun: float
) -> dict[str, Row]:
    """Try methods in Python on a motion that is short; return the setting and the evaluations that each takes.

    cost : evaluations, between settings.  begun : when the pilot did; of a slow force there is no time for trials.
    """
    found: dict[str, Row] = {}
    if process_time() - begun > SLOW:
        return found
    until = process_time() + SECONDS
    failing, truth = (UserError, *BROKEN), None  # as a function does that a long step takes out of its domain
    with suppress(*failing):
        truth = short_truth(scene, known)
    # its digits are those of the looser of two runs: it is itself about ten times nearer
    if truth is None or error < 10.0**-truth.digits:
        return found
    question, least = Question(scene, truth, (error,), np.inf), dict[float, float]()
    for name in methods:
        trial = Trial(question, METHODS[name], known, most_in_python(known), "python")
        with suppress(*failing), np.errstate(all="ignore"):
            trial.search((error,), least, GIVEN_UP)
            (row,) = trial.rows((error,), {})
            found[name] = {"value": np.nan, "evaluations": np.inf, "cost": row.get("evaluations", np.inf)}
            if (best := trial.best(error)) is not None:
                found[name] |= {"value": best.value, "evaluations": best.evaluations}
        if process_time() > until:
            break
    return found if least else {}  # at rest nothing has an error


def beginning(rows: pd.DataFrame, near: pd.DataFrame, found: Features) -> Row:
    """Return the setting to begin with and the evaluations to expect, from problems that are alike, nearest first."""
    there = near.join(rows[["control", "value", "evaluations"]], how="inner").head(2 * NAMED)
    scale = (there["omega"] / found.omega).where(there["control"] == "step", 1.0)
    evaluations = there["evaluations"] / there["span"] * found.span
    return {"value": gmean(there["value"] * scale), "evaluations": gmean(evaluations)}


def gmean(values: pd.Series) -> float:
    with np.errstate(divide="ignore"):  # nothing is set of an exact method
        return float(np.exp(np.log(values.to_numpy(dtype=float)).mean())) if len(values) else np.nan
