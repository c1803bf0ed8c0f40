"""How far a column may move between two runs: it names its rule (`schema.Rule`), `LIMITS` has what that allows."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pandas as pd

from contactbench.measure.round_off import STRUCTURE
from contactbench.results.schema import PROFILES, SPREAD, Rule, floor

#: by what factor an error may move, above its floor
FACTOR = 2.0
#: how far a slope or an order may move, and a quantity that is no error, relatively
SLOPE, VALUE = 0.05, 0.01
#: how far a count may move where a solver chooses its steps, or a run that did not end well, as a share
SHARE = 0.1
#: what a claim measures is round-off up to this share of its bound
OF_BOUND = 1e-3


def factor(before: np.ndarray, after: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Return |log(after/before)| in parts of `FACTOR`, neither taken below the floor."""
    with np.errstate(invalid="ignore"):
        moved = np.abs(np.log(np.maximum(after, floor) / np.maximum(before, floor))) / math.log(FACTOR)
    return np.where(before == after, 0.0, moved)


def amount(before: np.ndarray, after: np.ndarray, allowed: np.ndarray | float) -> np.ndarray:
    """Return |after − before| in parts of what is allowed; equal infinities have not moved."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(before == after, 0.0, np.abs(after - before) / allowed)


def count(before: np.ndarray, after: np.ndarray, rows: pd.DataFrame) -> np.ndarray:
    """Return |after − before|, where a solver chooses its steps in parts of a share or of twice their spread."""
    spread = rows[SPREAD].fillna(0.0).to_numpy(dtype=float) if SPREAD in rows else 0.0
    share = np.maximum(SHARE, 2 * spread) * before
    return amount(before, after, np.where(rows["control"] == "rtol", np.maximum(1.0, share), 0.0))


def point(before: np.ndarray, after: np.ndarray, rows: pd.DataFrame) -> np.ndarray:
    """Return |after − before| in parts of a share of the largest coordinate along the curve of each point."""
    curve = [rows[name] for name in ("figure", "panel", "curve")]
    largest = pd.Series(np.abs(before), rows.index).groupby(curve).transform("max").fillna(0.0).to_numpy()
    return amount(before, after, VALUE * largest + STRUCTURE)


def claim(before: np.ndarray, after: np.ndarray, rows: pd.DataFrame) -> np.ndarray:
    """Return how far what a claim measures moved: below an upper bound as an error, else as a value."""
    bound = pd.to_numeric(rows["bound"]).to_numpy(dtype=float, na_value=0.0)
    near = factor(before, after, np.maximum(STRUCTURE, OF_BOUND * np.abs(bound)))
    return np.where(rows["relation"] == "≤", near, amount(before, after, VALUE * np.abs(before)))


#: rule → how far a value moved, in parts of what is allowed, from the values before and after and the rows before
LIMITS: dict[Rule, Callable[[np.ndarray, np.ndarray, pd.DataFrame], np.ndarray]] = {
    Rule.error: lambda b, a, rows: factor(b, a, floor(Rule.error, rows)),
    Rule.structure: lambda b, a, rows: factor(b, a, floor(Rule.structure, rows)),
    Rule.count: count,
    Rule.value: lambda b, a, rows: amount(b, a, VALUE * np.abs(b)),
    Rule.order: lambda b, a, rows: amount(b, a, SLOPE),
    Rule.slope: lambda b, a, rows: np.where(rows["in_fit"], amount(b, a, SLOPE), 0.0),
    Rule.point: point,
    Rule.end: lambda b, a, rows: amount(b, a, np.where(rows["status"] == "ok", 0.0, SHARE * np.abs(b))),
    Rule.measured: claim,
}


def distance(rule: Rule, before: pd.Series, after: pd.Series, rows: pd.DataFrame, alike: bool) -> np.ndarray:
    """Return how far each value of a column moved, in parts of what its rule allows: red beyond 1.

    alike : both were made on the same processor with the same libraries, where every count is exact.
    A value that is blank on one side only moved beyond all limits.
    """
    if rule is Rule.same or (rule is Rule.count and alike):
        moved = np.where((before == after).to_numpy(na_value=False), 0.0, math.inf)
    elif rule is Rule.profile:
        rank = {name: k for k, name in enumerate(PROFILES)}
        first, then = (side.map(rank).fillna(math.inf) for side in (before, after))
        moved = np.where((then <= first) & (then < math.inf), 0.0, math.inf)
    else:
        old, new = (pd.to_numeric(side).to_numpy(dtype=float, na_value=math.nan) for side in (before, after))
        moved = LIMITS[rule](old, new, rows)
    blank = before.isna().to_numpy(), after.isna().to_numpy()
    moved = np.where(blank[0] & blank[1], 0.0, np.where(blank[0] ^ blank[1], math.inf, moved))
    return np.nan_to_num(moved, nan=math.inf, posinf=math.inf)
