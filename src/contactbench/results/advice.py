"""Advice from the population: what the methods cost on the problems that are most like one.

Problems are alike by damping, span, spread of the time scales, cost of the force, number of coordinates and kind of
scene, as a pilot finds them.  Advice is judged on problems it has not seen (`judged`).
"""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np
import pandas as pd

#: costs that are compared: evaluations, and compiled time
COSTS = ("evaluations", "time_s")
#: problems that are asked, and a distance within which they count alike
NEIGHBOURS, ALIKE = 12, 0.3
#: a regret is no larger: what does not reach an error costs so many times the least
WORST = 30.0
#: damping over frequency below which it does not matter how weak it is, and a force that costs less than a step
#: beside it, in additions
LEAST = {"damping": 1e-7, "cost": 30.0}
#: a problem is far from all that is known where the nearest is farther than for so many problems of the population
KNOWN = 0.95
#: how much each feature counts, by the decade; and another kind of scene
WEIGHTS = {"damping": 0.5, "span": 0.6, "spread": 2.0, "cost": 1.0, "size": 0.7}
OTHER_KIND = 2.0


def places(problems: pd.DataFrame) -> np.ndarray:
    """Return a point for each problem, (n, 5): the features that advice goes by, weighted."""
    known = {name: np.maximum(problems[name].astype(float), LEAST.get(name, 0.0)) for name in WEIGHTS}
    return np.stack([weight * np.log10(known[name]) for name, weight in WEIGHTS.items()], axis=1)


def distances(problems: pd.DataFrame, others: pd.DataFrame) -> np.ndarray:
    """Return how unlike each problem is to each other one, (n, k)."""
    gaps = places(problems)[:, None] - places(others)
    strange = problems["kind"].to_numpy()[:, None] != others["kind"].to_numpy()
    return np.asarray(np.hypot(np.linalg.norm(gaps, axis=2), OTHER_KIND * strange))


def regrets(rows: pd.DataFrame, error: float, cost: str) -> pd.DataFrame:
    """Return cost over the least by problem (seed, scene) and method; `WORST` where not reached, nan where not run."""
    own = rows[rows["error"] == error].set_index(["seed", "scene", "method"])
    spent = own[cost].astype(float).where(own["status"] == "ok").unstack("method")
    ran = own["status"].unstack("method").notna()
    spent = spent[spent.notna().any(axis=1)]
    found = spent.div(spent.min(axis=1), axis=0).clip(upper=WORST)
    return found.mask(found.isna() & ran.loc[found.index], WORST)


def neighbours(far: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which problems are asked, the nearest first, and how much each counts."""
    near = np.argsort(far, kind="stable")[:NEIGHBOURS]
    return near, 1 / (far[near] ** 2 + ALIKE**2)


def scores(known: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the mean logarithm of the regrets (n, m) of each method; inf of one that ran on few of the problems."""
    present = ~np.isnan(known) * weights[:, None]
    total = np.maximum(present.sum(axis=0), 1e-300)
    mean = np.nansum(np.log(known) * present, axis=0) / total
    return np.where(np.isnan(known).mean(axis=0) < 0.5, mean, math.inf)


def ranked(known: pd.DataFrame, far: np.ndarray, allowed: Collection[str]) -> pd.DataFrame:
    """Return the methods, best first, by their regrets on the neighbours: how often best, and quantiles."""
    near, weights = neighbours(far)
    own = known.iloc[near]
    score = pd.Series(scores(own.to_numpy(), weights), own.columns)
    order = score[np.isfinite(score) & score.index.isin(list(allowed))].sort_values(kind="stable").index
    own = own[order]
    share = own.le(1.0).mul(weights, axis=0).sum() / weights.sum()
    return pd.DataFrame({"best": share, "regret": own.median(), "regret_90": own.quantile(0.9)})


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
    values, methods = table.to_numpy(), table.columns
    seeds, families = own.index.get_level_values("seed"), own["structure"].to_numpy()
    far = distances(own, own)
    found = []
    for i in np.flatnonzero(seeds == asked):
        others = np.flatnonzero((seeds == known) & ((families != families[i]) | (known != asked)))
        near, weights = neighbours(far[i, others])
        score = np.where(np.isnan(values[i]), math.inf, scores(values[others[near]], weights))
        first = np.argsort(score, kind="stable")[:3]
        taken = values[i, first]
        found.append((families[i], methods[first[0]], taken[0], np.nanmin(taken)))
    return pd.DataFrame(found, columns=["structure", "first", "regret", "of_three"])
