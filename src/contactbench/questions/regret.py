"""Regret: the cost of each method on each problem over the least cost of any."""

from __future__ import annotations

import numpy as np
import pandas as pd

#: costs that are compared: evaluations, and compiled time
COSTS = ("evaluations", "time_s")
#: a regret is no larger: what does not reach an error costs so many times the least
WORST = 30.0


def regrets(rows: pd.DataFrame, error: float, cost: str) -> pd.DataFrame:
    """Return cost over the least by problem (seed, scene) and method; `WORST` where not reached, nan where not run."""
    own = rows[rows["error"] == error].set_index(["seed", "scene", "method"])
    found = own[cost].astype(float).where(own["status"] == "ok").unstack("method")
    ran = own["status"].unstack("method").notna()
    found = found[found.notna().any(axis=1)]
    found = found.div(found.min(axis=1), axis=0).clip(upper=WORST)
    return found.mask(found.isna() & ran.loc[found.index], WORST)


def mean_regrets(rows: pd.DataFrame, error: float, cost: str) -> pd.Series:
    """Return the mean logarithm of the regrets of each method that runs on every problem, the least first."""
    return np.log(regrets(rows, error, cost).dropna(axis=1)).mean().sort_values(kind="stable")
