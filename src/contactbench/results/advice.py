"""Advice from the population: what the methods cost on the problems that are most like one.

Problems are alike by damping, span, spread of the time scales, cost of the force, number of coordinates and kind of
scene, as a pilot finds them, and by which methods can run them.  Where a motion is so short that methods are tried on
it in Python, the evaluations that each takes there count, and the others say how long an evaluation takes.  Advice is
judged on problems it has not seen (`judged`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

#: costs that are compared: evaluations, and compiled time
COSTS = ("evaluations", "time_s")
#: problems that are asked, and a distance within which they count alike
NEIGHBOURS, ALIKE = 12, 0.1
#: a regret is no larger: what does not reach an error costs so many times the least
WORST = 30.0
#: damping over frequency below which it does not matter how weak it is, and a force that costs less than a step
#: beside it, in additions
LEAST = {"damping": 1e-7, "cost": 30.0}
#: a problem is far from all that is known where the nearest is farther than for so many problems of the population
KNOWN = 0.95
#: how much each feature counts, by the decade; another kind of scene; and that other methods can run it
WEIGHTS = {"damping": 0.5, "span": 0.6, "spread": 2.0, "cost": 1.0, "size": 0.7}
OTHER_KIND, OTHER_METHODS = 2.0, 0.5
#: methods tried first on a short motion; and what is not tried is thought dearer by so much
FIRST, UNTRIED = 4, 0.4
#: what is not tried: it has no steps in Python, or takes long there
NOT_TRIED = (
    "quinlan-tremaine8",
    "quinlan-tremaine12",
    "cvode-adams",
    "cyrk-dop853",
    "cyrk-vern8",
    "cyrk-lsoda",
    "heyoka-taylor",
)


def places(problems: pd.DataFrame) -> np.ndarray:
    """Return a point for each problem, (n, 5): the features that advice goes by, weighted."""
    known = {name: np.maximum(problems[name].astype(float), LEAST.get(name, 0.0)) for name in WEIGHTS}
    return np.stack([weight * np.log10(known[name]) for name, weight in WEIGHTS.items()], axis=1)


def distances(problems: pd.DataFrame, others: pd.DataFrame) -> np.ndarray:
    """Return how unlike each problem is to each other one, (n, k)."""
    gaps = places(problems)[:, None] - places(others)
    strange = problems["kind"].to_numpy()[:, None] != others["kind"].to_numpy()
    return np.asarray(np.hypot(np.linalg.norm(gaps, axis=2), OTHER_KIND * strange))


def spent(rows: pd.DataFrame, error: float, cost: str) -> pd.DataFrame:
    """Return the cost of an error by problem (seed, scene) and method; nan where it was not reached, or not run."""
    own = rows[rows["error"] == error].set_index(["seed", "scene", "method"])
    return own[cost].astype(float).where(own["status"] == "ok").unstack("method")


def regrets(rows: pd.DataFrame, error: float, cost: str) -> pd.DataFrame:
    """Return cost over the least by problem (seed, scene) and method; `WORST` where not reached, nan where not run."""
    found, own = spent(rows, error, cost), rows[rows["error"] == error]
    ran = own.set_index(["seed", "scene", "method"])["status"].unstack("method").notna()
    found = found[found.notna().any(axis=1)]
    found = found.div(found.min(axis=1), axis=0).clip(upper=WORST)
    return found.mask(found.isna() & ran.loc[found.index], WORST)


def rates(rows: pd.DataFrame, error: float, cost: str, like: pd.DataFrame) -> np.ndarray:
    """Return the logarithm of the cost of an evaluation by problem and method, as `regrets` has them, else nan."""
    evaluations = spent(rows, error, "evaluations")
    each = spent(rows, error, cost) / evaluations.where(evaluations > 0)
    found: np.ndarray = np.log(each.loc[like.index, like.columns].to_numpy())
    return found


def neighbours(known: np.ndarray, far: np.ndarray, runs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which problems are asked, the nearest first, and how much each counts.

    known : regrets, (n, m).  far : distances, (n,).  runs : whether each method can run the problem it is about, (m,).
    """
    others = np.minimum((np.isnan(known) == runs).sum(axis=1) / 2, 2.0)
    far = np.hypot(far, OTHER_METHODS * others)
    near = np.argsort(far, kind="stable")[:NEIGHBOURS]
    return near, 1 / (far[near] ** 2 + ALIKE**2)


def scores(known: np.ndarray, weights: np.ndarray, runs: np.ndarray) -> np.ndarray:
    """Return the mean logarithm of the regrets (n, m) of each method; inf of one that ran on few of the problems."""
    present = ~np.isnan(known) * weights[:, None]
    total = np.maximum(present.sum(axis=0), 1e-300)
    mean = np.nansum(np.log(known) * present, axis=0) / total
    return np.where(runs & (np.isnan(known).mean(axis=0) < 0.5), mean, math.inf)


def to_try(score: np.ndarray, methods: pd.Index, runs: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return which methods are tried on a short motion, as places, should time be up: a few that are best first.

    Then follow those that the fewest of the known problems can run, regrets (n, m): they are made for some.
    """
    able = np.flatnonzero(runs & ~methods.isin(NOT_TRIED))
    best = able[np.argsort(score[able], kind="stable")]
    few = np.argsort((~np.isnan(known)).sum(axis=0)[best[FIRST:]], kind="stable")
    found: np.ndarray = np.concatenate([best[:FIRST], best[FIRST:][few]])
    return found


def an_evaluation(each: np.ndarray, near: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the logarithm of what an evaluation costs each method, (m,), from the problems that are asked.

    each : `rates`, (n, m).  Of a method that ran on none of them it follows from all others.
    """
    known = ~np.isnan(each)

    def mean(values: np.ndarray, weights: np.ndarray, axis: int) -> np.ndarray:
        with np.errstate(invalid="ignore"):
            found: np.ndarray = np.nansum(values * weights, axis=axis) / weights.sum(axis=axis)
        return found

    level = mean(each, known, 1)
    beside = each - level[:, None]
    here = mean(beside[near], known[near] * weights[:, None], 0)
    found: np.ndarray = np.where(np.isnan(here), mean(beside, known, 0), here)
    return found + float(np.average(level[near], weights=weights))


def with_tried(score: np.ndarray, spent: np.ndarray, each: np.ndarray) -> np.ndarray:
    """Return scores by what methods took on the problem itself, and what an evaluation costs on those like it.

    spent : evaluations, (m,); inf of what did not reach the error, nan of what was not tried.  each : as
    `an_evaluation` returns it.  What is not tried is put beside the others by its score.
    """
    own = np.log(np.maximum(spent, 1.0)) + each
    both = np.isfinite(own) & np.isfinite(score)
    if not both.any():
        return score
    found: np.ndarray = np.where(np.isnan(own), score + np.median(own[both] - score[both]) + UNTRIED, own)
    return found


@dataclass(frozen=True)
class Outlook:
    """What is to be expected of each method on a problem.

    score : logarithm of its cost, (m,), to be compared; inf of what cannot run, or failed.  near : the problems that
    were asked, nearest first, as places, and weights : how much each of them counts.
    """

    score: np.ndarray
    near: np.ndarray
    weights: np.ndarray


def outlook(
    known: pd.DataFrame,
    each: np.ndarray,
    far: np.ndarray,
    runs: np.ndarray,
    trials: Callable[[np.ndarray], np.ndarray],
) -> Outlook:
    """Return what the problems that are known, regrets (n, m), and trials say of a problem.

    each : `rates`, (n, m).  far : distances, (n,).  runs : whether each method can run it, (m,).  trials : takes the
    places of methods, the first to be tried first, and returns evaluations as `with_tried` takes them.
    """
    values = known.to_numpy()
    near, weights = neighbours(values, far, runs)
    score = scores(values[near], weights, runs)
    taken = trials(to_try(score, known.columns, runs, values))
    return Outlook(with_tried(score, taken, an_evaluation(each, near, weights)), near, weights)


def threshold(problems: pd.DataFrame) -> float:
    """Return the distance of the nearest other problem that `KNOWN` of the population do not exceed."""
    far = distances(problems, problems)
    np.fill_diagonal(far, math.inf)
    return float(np.quantile(far.min(axis=1), KNOWN))


def judged(
    rows: pd.DataFrame, problems: pd.DataFrame, error: float, cost: str, known: int, asked: int
) -> pd.DataFrame:
    """Return the regret of the first method that is named, and of the best of three, on problems not seen.

    known : the seed whose problems are looked at, without those of the same family.  asked : the seed of the problems;
    of another seed families are not left out.
    """
    table = regrets(rows, error, cost)
    own = problems.set_index(["seed", "scene"]).loc[table.index]
    values, each = table.to_numpy(), rates(rows, error, cost, table)
    least = regrets(rows, error, "evaluations").loc[table.index, table.columns].to_numpy()
    seeds, families = own.index.get_level_values("seed"), own["structure"].to_numpy()
    far, short = distances(own, own), own["short"].to_numpy()

    def trials(i: int, places: np.ndarray) -> np.ndarray:
        """Return what methods take on a problem, over the least: nothing is known of a long one."""
        taken = np.full(len(table.columns), math.nan)
        if short[i]:
            taken[places] = np.where(least[i, places] < WORST, least[i, places], math.inf)
        return taken

    found = []
    for i in np.flatnonzero(seeds == asked).tolist():
        others = np.flatnonzero((seeds == known) & ((families != families[i]) | (known != asked)))
        runs = ~np.isnan(values[i])
        said = outlook(table.iloc[others], each[others], far[i, others], runs, partial(trials, i))
        first = np.argsort(said.score, kind="stable")[:3]
        taken = values[i, first]
        found.append((families[i], table.columns[first[0]], taken[0], np.nanmin(taken)))
    return pd.DataFrame(found, columns=["structure", "first", "regret", "of_three"])
