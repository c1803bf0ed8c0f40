"""Averages over long runs of a chaotic scene: who has them right, for how many evaluations; and what the pairs do."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pandas as pd

from contactbench.measure.law import STRUCTURE
from contactbench.measure.statistics import RUNG, ties
from contactbench.report.chapters import Answer, Frames, Part, chapter, chart, view
from contactbench.report.curves import ROUND_OFF, by_method, decade
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.report.numbers import names, scientific
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of, matrix
from contactbench.results.contest import CONTACT
from contactbench.results.tables import DIMENSION, ENERGY, EXPONENT, SUM

#: how far an average may be off, as a part of it
ALLOWED = {ENERGY: 0.1, EXPONENT: 0.05, DIMENSION: 0.01}
#: error bars that count as a deviation
SURE = 2.0


def of(frame: pd.DataFrame, quantity: str) -> pd.DataFrame:
    rows = frame[(frame["quantity"] == quantity) & (frame["status"] == "ok")]
    return rows.sort_values("evaluations_per_time", kind="stable")


def deviations(frame: pd.DataFrame, quantity: str) -> pd.DataFrame:
    """Return the rows of an average; off, bar : from the reference, and error bar, in parts of what is allowed."""
    part = of(frame, quantity)
    reference, own = part[part["reference"]], part[~part["reference"]]
    if not len(reference):
        return own.assign(off=np.nan, bar=np.nan)
    true = reference.iloc[0]
    allowed = ALLOWED[quantity] * abs(true["mean"])
    bar = np.hypot(own["error"], true["error"]) / allowed
    return own.assign(off=(own["mean"] - true["mean"]).abs() / allowed, bar=bar)


def right_from(rows: pd.DataFrame, right: pd.Series) -> float:
    """Return the evaluations of one method from which on every setting is right; nan if the dearest is not."""
    wrong = ~right.to_numpy(dtype=bool)
    first = int(np.flatnonzero(wrong)[-1]) + 1 if wrong.any() else 0
    return float(rows["evaluations_per_time"].iloc[first]) if first < len(rows) else np.nan


def least(frame: pd.DataFrame, quantity: str) -> pd.DataFrame:
    """Return the fewest evaluations that have an average right; bound : the cheapest setting; first : or a tie."""
    found = {}
    for name, own in deviations(frame, quantity).groupby("method", sort=False):
        cost = right_from(own, own["off"] + SURE * own["bar"] <= 1)
        found[name] = cost, cost == own["evaluations_per_time"].iloc[0]
    costs = pd.DataFrame.from_dict(found, orient="index", columns=["cost", "bound"]).dropna()
    costs = costs.sort_values("cost", kind="stable")
    return costs.assign(first=ties(costs["cost"], costs["cost"].min(), RUNG))


def cost_text(cost: pd.Series) -> str:
    return f"{'≤ ' if cost['bound'] else ''}{cost['cost']:.2g}"


def pairing(frame: pd.DataFrame) -> pd.Series:
    worst = of(frame, SUM).groupby("method")["pairing_defect"].max()
    return worst.reindex([m for m in dict.fromkeys(frame["method"]) if m in worst.index])


def answers(frames: Frames) -> Iterator[Answer]:
    frame = frames["long_time"]
    for quantity in ALLOWED:
        costs = least(frame, quantity)
        if len(costs):
            first = [str(name) for name in costs.index[costs["first"]]]
            question = f"Which methods need the fewest evaluations for the right {quantity}?"
            cost = f"{cost_text(costs.iloc[0])} evaluations per unit of time"
            yield Answer(question, names(first, 4), cost)
    defects = pairing(frame)
    if len(defects):
        kept = [str(name) for name in defects.index[defects <= STRUCTURE]]
        count = f"{len(kept)} of {len(defects)} methods"
        yield Answer("Who keeps the pairs of exponents to round-off?", names(kept) or "nobody", count)


def costs_view(frame: pd.DataFrame) -> View:
    costs = {quantity: least(frame, quantity) for quantity in ALLOWED}
    found = pd.concat(costs, names=["average", "method"]).reset_index()
    alone = found.groupby("average")["first"].sum() == 1

    def cell(rows: pd.DataFrame) -> Cell:
        cost = rows.iloc[0]
        mark = Mark.best if alone[cost["average"]] else Mark.tie
        return Cell(cost_text(cost), float(cost["cost"]), mark if cost["first"] else None)

    allowed = names([f"{100 * part:g} % ({quantity})" for quantity, part in ALLOWED.items()])
    table = matrix(found, "method", "average", cell)
    return view("long_time_costs", table, allowed=allowed, sure=SURE, rung=RUNG)


def pairs_view(frame: pd.DataFrame) -> View:
    rows = []
    for method in pairing(frame).index:
        own = frame[frame["method"] == method]
        sums, bars = of(own, SUM), of(own, EXPONENT).set_index("setting")["error"]
        kept = Mark.kept if (sums["pairing_defect"] <= STRUCTURE).all() else None
        ends = (as_cell(sums["pairing_defect"].iloc[k], scientific, kept) for k in (0, -1))
        right = right_from(sums, sums["mean"].abs() <= sums["setting"].map(bars))
        rows.append((method, *ends, as_cell(right, "{:.2g}".format)))
    labels = ["method", "defect, cheapest setting", "defect, dearest setting", "sum right from"]
    return view("long_time_pairs", frame_of(rows, labels))


def figure(frame: pd.DataFrame) -> Figure | None:
    rows = of(frame, SUM)
    rows = rows[~rows["reference"] & rows["pairing_defect"].notna()]
    own = rows["family"] == CONTACT
    ours, theirs = rows[own]["pairing_defect"].max(), rows[~own]["pairing_defect"].min()
    if math.isnan(ours) or math.isnan(theirs):
        return None
    curves = by_method(rows, "evaluations_per_time", "pairing_defect")
    x, y = Axis("evaluations per unit of time", "log"), Axis("pairing defect per unit of time", "log")
    at_most, at_best = decade(ours, math.ceil), decade(theirs, math.floor)
    return chart("pairing", [Panel("", x, y, curves, (ROUND_OFF,))], ours=at_most, theirs=at_best)


@chapter("long_time", answers)
def parts(frames: Frames) -> list[Part | None]:
    frame = frames["long_time"]
    return [costs_view(frame), pairs_view(frame), figure(frame)]
