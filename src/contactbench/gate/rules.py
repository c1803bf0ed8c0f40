"""How far a value moved, in parts of what the rule of its column allows: red beyond 1."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from contactbench.report.numbers import DASH
from contactbench.results.round_off import STRUCTURE, floor
from contactbench.results.schema import PROFILES, SPREAD, Rule

#: how far an error may move, in decades: a factor of two
DECADES = 0.3
#: how far a slope may move in the asymptotic range; other rounding moves it by 0.001
SLOPE = 0.05
#: how far a quantity that is no error may move, relatively
VALUE = 0.01
#: how far a count may move where a solver chooses its steps, as a share, and at least by one
SHARE = 0.1
#: what a claim measured is round-off up to this share of its bound
OF_BOUND = 1e-3

Judge = Callable[[np.ndarray, np.ndarray, pd.DataFrame], np.ndarray]


def decades(before: np.ndarray, after: np.ndarray, floor: np.ndarray | float) -> np.ndarray:
    """|log10(after/before)| in parts of what is allowed, neither taken below the floor."""
    with np.errstate(invalid="ignore"):
        moved = np.abs(np.log10(np.maximum(after, floor) / np.maximum(before, floor))) / DECADES
    return np.where(before == after, 0.0, moved)


def relative(before: np.ndarray, after: np.ndarray, allowed: np.ndarray | float) -> np.ndarray:
    """|after − before| in parts of what is allowed; equal numbers, infinite ones too, have not moved."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(before == after, 0.0, np.abs(after - before) / allowed)


def counts(before: np.ndarray, after: np.ndarray, rows: pd.DataFrame, alike: bool) -> np.ndarray:
    """Counts of solvers that choose their steps may move by a share on another processor, and by twice what
    roundings of the initial data do to them where that was measured to be more."""
    chosen = (rows["control"] == "rtol").to_numpy() & (not alike)
    spread = rows[SPREAD].fillna(0.0).to_numpy(dtype=float) if SPREAD in rows else 0.0
    return relative(
        before, after, np.where(chosen, np.maximum(1.0, np.maximum(SHARE, 2 * spread) * before), 0.0)
    )


def measured(before: np.ndarray, after: np.ndarray, rows: pd.DataFrame) -> np.ndarray:
    """What a claim measured: an upper bound's value counts in decades, above a small part of the bound.

    Others, lower bounds and orders, are quantities of their own: within a hundredth.
    """
    bound = pd.to_numeric(rows["bound"]).to_numpy(dtype=float, na_value=math.nan)
    ground = np.maximum(STRUCTURE, OF_BOUND * np.abs(np.nan_to_num(bound)))
    small = np.abs(before) <= ground, np.abs(after) <= ground
    moved = np.minimum(values(before, after), decades(np.abs(before), np.abs(after), ground))
    above = (rows["relation"] == "≤").to_numpy()
    moved = np.where(above, moved, values(before, after))
    return np.where(small[0] & small[1], 0.0, np.where(np.sign(before) * np.sign(after) < 0, math.inf, moved))


def values(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Relative change in parts of what is allowed; a limit may be infinite."""
    return relative(before, after, VALUE * np.abs(before))


def points(before: np.ndarray, after: np.ndarray, rows: pd.DataFrame) -> np.ndarray:
    """Coordinates, relative to the largest along their curve."""
    curve = [rows[name] for name in ("figure", "panel", "curve")]
    size = pd.Series(np.abs(before), rows.index).groupby(curve).transform("max").to_numpy()
    return relative(before, after, VALUE * np.nan_to_num(size) + STRUCTURE)


def ends(before: np.ndarray, after: np.ndarray, rows: pd.DataFrame) -> np.ndarray:
    """The end of a run that ended well is the one asked for."""
    return relative(before, after, np.where(rows["status"] == "ok", 0.0, SHARE * np.abs(before)))


MOVED: dict[Rule, Judge] = {
    Rule.error: lambda before, after, rows: decades(before, after, floor(Rule.error, rows)),
    Rule.structure: lambda before, after, rows: decades(before, after, floor(Rule.structure, rows)),
    Rule.value: lambda before, after, rows: values(before, after),
    Rule.slope: lambda before, after, rows: np.where(rows["in_fit"], np.abs(after - before) / SLOPE, 0.0),
    Rule.order: lambda before, after, rows: relative(before, after, SLOPE),
    Rule.measured: measured,
    Rule.point: points,
    Rule.end: ends,
}


def moved(
    rule: Rule, before: pd.Series, after: pd.Series, rows: pd.DataFrame, alike: bool = False
) -> np.ndarray:
    """How far each value of a column moved, in parts of what its rule allows: red beyond 1.

    rows : the rows before.  alike : both were made on the same processor with the same libraries.
    A value that is blank on one side only moved beyond all limits.
    """
    blank = before.isna().to_numpy(), after.isna().to_numpy()
    if rule is Rule.same:
        distance = np.where((before == after).to_numpy(na_value=False), 0.0, math.inf)
    elif rule is Rule.profile:
        rank = {name: k for k, name in enumerate(PROFILES)}
        first, then = (side.map(rank).fillna(len(rank)).to_numpy() for side in (before, after))
        distance = np.where((then <= first) & (then < len(rank)), 0.0, math.inf)
    else:
        old, new = (pd.to_numeric(side).to_numpy(dtype=float, na_value=math.nan) for side in (before, after))
        distance = counts(old, new, rows, alike) if rule is Rule.count else MOVED[rule](old, new, rows)
    distance = np.where(blank[0] & blank[1], 0.0, np.where(blank[0] ^ blank[1], math.inf, distance))
    return np.nan_to_num(distance, nan=math.inf, posinf=math.inf)


def change(rule: Rule, before: Any, after: Any) -> str:
    """By how much, in words that fit the measure."""
    if rule in (Rule.same, Rule.profile) or pd.isna(before) or pd.isna(after):
        return ""
    if rule in (Rule.error, Rule.structure):
        return f"×{after / before:.3g}" if before else "from 0"
    return f"{after - before:+.3g}"


def shown(value: Any) -> str:
    if pd.isna(value) or value == "":
        return DASH
    return f"{value:.3g}" if isinstance(value, float | np.floating) else str(value)
