"""Measured rates of damping, and how fixed-step methods compare as damping gets strong."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from contactbench.measure.round_off import STRUCTURE
from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part
from contactbench.report.numbers import DASH, count, names, scientific
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of, matrix

SOURCE, STRONG = "damping_rates.csv", "strong_damping.csv"
#: errors whose ratio is within this are as good as equal
ALIKE = 2.0
#: a method may cost this much more than the others and still be at equal cost
AFFORDABLE = 1.15
#: γh per evaluation is sorted into ranges with these borders
DAMPING_RANGES = (0.0, 0.01, 0.1, 1.0, 10.0, math.inf)
#: with which the others are compared under strong damping: a composition without steps against time
BASE = "contact-strang"


def rates_view(frame: pd.DataFrame) -> View:
    """Return the most accurate methods at equal cost, one row for each rate measured."""
    ok = frame[frame["status"] == "ok"]
    creep, weak = ok[ok["experiment"] == "overdamped"], ok[ok["experiment"] == "weak"]
    rows = []
    adaptive = creep[creep["damping_per_step"].isna()]
    for damping, fixed in sorted(creep.groupby("damping_per_step"), reverse=True, key=lambda group: group[0]):
        rows.append((f"slow rate of creep, γh = {damping:g}", *at_equal_cost(fixed, adaptive)))
    for (scene, span), part in weak.groupby(["scene", "t_end"], sort=False):
        steps = part["control"] == "step"
        name = f"rate of weak damping, `{scene}`, T = {span:.0e}"
        rows.append((name, *at_equal_cost(part[steps], part[~steps])))
    legend = (
        "Error of a measured damping rate, at no more evaluations than the dearest fixed-step run took. Methods within "
        f"a factor of {ALIKE:g} tie."
    )
    table = frame_of(rows, ["rate", "most accurate", "evaluations allowed"])
    return View("rates", "Most accurate damping rate", table, legend, SOURCE)


def at_equal_cost(fixed: pd.DataFrame, adaptive: pd.DataFrame) -> tuple[Cell, Cell]:
    """Return the most accurate of the fixed-step runs and of the adaptive ones that cost no more; and that cost."""
    budget = AFFORDABLE * float((fixed if len(fixed) else adaptive)["evaluations"].max())
    rows = pd.concat([fixed, adaptive[adaptive["evaluations"] <= budget]])
    errors = rows.groupby("method", sort=False)["rate_error"].min()
    return best_cell(errors.astype(float)), as_cell(budget, count)


def best_cell(errors: pd.Series) -> Cell:
    """Return the most accurate, and those within ALIKE of it; all at round-off tie."""
    errors = errors[errors < 1].sort_values(kind="stable")
    if not len(errors):
        return Cell(DASH)
    least = float(errors.iloc[0])
    first = [str(m) for m in errors.index[errors <= max(STRUCTURE, ALIKE * least)]]
    return Cell(f"{names(first, 3)} {scientific(least)}", mark=Mark.tie if len(first) > 1 else Mark.best)


def usable(rows: pd.DataFrame, base: pd.DataFrame) -> float:
    """Return the largest γh per evaluation up to which a method is never worse than the base; 0 if nowhere."""
    errors, others = (part.set_index("damping_per_evaluation")["error"].sort_index() for part in (rows, base))
    worse = (errors > others * 1.001).to_numpy()
    first = int(np.argmax(worse)) if worse.any() else len(worse)
    return float(errors.index[first - 1]) if first else 0.0


def strong_views(frame: pd.DataFrame) -> list[View]:
    """Return where negative substeps stop paying, and the most accurate method by range."""
    bases = dict(list(frame[frame["method"] == BASE].groupby("gamma")))
    frame = frame[frame["gamma"].isin(bases)].sort_values("gamma", kind="stable")

    def cell(rows: pd.DataFrame) -> Cell:
        return as_cell(usable(rows, bases[rows["gamma"].iloc[0]]), "{:.2g}".format)

    def best(rows: pd.DataFrame) -> Cell:
        return best_cell(rows["error"].fillna(np.inf).groupby(rows["method"], sort=False).median())

    label = "γ = {:g}".format
    others = matrix(frame[frame["method"] != BASE], "method", "gamma", cell, label)
    legend = f"γh per evaluation up to which a method is no less accurate than {BASE} at the same cost; 0: nowhere."
    ranges = pd.cut(frame["damping_per_evaluation"], DAMPING_RANGES, right=False).astype(str)
    by_range = matrix(frame.assign(range=ranges), "range", "gamma", best, label)
    by_range = by_range.rename(columns={"range": "γh per evaluation"})
    median = f"Median error in each range. Methods within a factor of {ALIKE:g} tie."
    return [
        View("strong_usable", "Strong damping: where negative substeps stop paying", others, legend, STRONG),
        View("strong_best", "Strong damping: the most accurate fixed-step method", by_range, median, STRONG),
    ]


def parts(frames: Frames) -> list[Part]:
    strong = strong_views(frames["strong_damping"])
    return [rates_view(frames["damping_rates"]), *(view for view in strong if len(view.frame))]


TITLE, QUESTION = "Damping", "Who has damping rates right, and who strong damping?"
CHAPTERS.add(Chapter("damping", TITLE, QUESTION, 54, ("damping_rates", "strong_damping"), parts))
