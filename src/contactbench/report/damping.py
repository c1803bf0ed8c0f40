"""Measured rates of damping, and how fixed-step methods compare as damping gets strong."""

from __future__ import annotations

import numpy as np
import pandas as pd

from contactbench.measure.law import STRUCTURE
from contactbench.measure.statistics import ALIKE, COUNTED, ties
from contactbench.report.chapters import view
from contactbench.report.numbers import DASH, count, names, scientific
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of, matrix

#: with which the others are compared under strong damping: a composition without steps against time
BASE = "contact-strang"


def rates_view(frame: pd.DataFrame) -> View:
    ok = frame[frame["status"] == "ok"]
    creep, weak = ok[ok["experiment"] == "overdamped"], ok[ok["experiment"] == "weak"]
    adaptive = creep[creep["damping_per_step"].isna()]
    rows = [
        (f"slow rate of creep, γh = {damping:g}", *at_equal_cost(fixed, adaptive))
        for damping, fixed in reversed([*creep.groupby("damping_per_step")])
    ]
    for (scene, span), part in weak.groupby(["scene", "t_end"], sort=False):
        steps = part["control"] == "step"
        name = f"rate of weak damping, `{scene}`, T = {span:.0e}"
        rows.append((name, *at_equal_cost(part[steps], part[~steps])))
    return view("rates", frame_of(rows, ["rate", "most accurate", "evaluations allowed"]), alike=ALIKE)


def at_equal_cost(fixed: pd.DataFrame, adaptive: pd.DataFrame) -> tuple[Cell, Cell]:
    budget = COUNTED * float((fixed if len(fixed) else adaptive)["evaluations"].max())
    rows = pd.concat([fixed, adaptive[adaptive["evaluations"] <= budget]])
    errors = rows.groupby("method", sort=False)["rate_error"].min()
    return best_cell(errors.astype(float)), as_cell(budget, count)


def best_cell(errors: pd.Series) -> Cell:
    errors = errors[errors < 1].sort_values(kind="stable")
    if not len(errors):
        return Cell(DASH)
    least = float(errors.iloc[0])
    first = list(errors.index[(errors <= STRUCTURE) | ties(errors, least, ALIKE)])
    return Cell(f"{names(first, 3)} {scientific(least)}", mark=Mark.tie if len(first) > 1 else Mark.best)


def usable(rows: pd.DataFrame, base: pd.DataFrame) -> float:
    """Return the largest γh per evaluation up to which a method is never worse than the base; 0 if nowhere."""
    errors, others = (part.set_index("damping_per_evaluation")["error"].sort_index() for part in (rows, base))
    worse = (errors > others * 1.001).to_numpy()
    first = int(np.argmax(worse)) if worse.any() else len(worse)
    return float(errors.index[first - 1]) if first else 0.0


def strong_view(frame: pd.DataFrame) -> View:
    bases = dict(list(frame[frame["method"] == BASE].groupby("gamma")))
    rows = frame[frame["gamma"].isin(bases) & (frame["method"] != BASE)].sort_values("gamma", kind="stable")

    def cell(rows: pd.DataFrame) -> Cell:
        return as_cell(usable(rows, bases[rows["gamma"].iloc[0]]), "{:.2g}".format)

    return view("strong_usable", matrix(rows, "method", "gamma", cell, "γ = {:g}".format), base=BASE)
