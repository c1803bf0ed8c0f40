"""Measured rates of damping, and how fixed-step methods compare as damping gets strong."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
import pandas as pd

from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part, Section
from contactbench.report.numbers import DASH, count, names, scientific
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of
from contactbench.results.round_off import STRUCTURE

SOURCE, STRONG = "damping_rates.csv", "strong_damping.csv"
#: errors whose ratio is within this are as good as equal
ALIKE = 2.0
#: of those that tie, so many are named
NAMED = 3
#: a method may cost this much more than the others and still be at equal cost
AFFORDABLE = 1.15
#: γh per evaluation is sorted into ranges with these borders
DAMPING_RANGES = (0.0, 0.01, 0.1, 1.0, 10.0, math.inf)
#: with which the others are compared under strong damping: a composition without steps against time
BASE = "contact-strang"


# -- rates -----------------------------------------------------------------------------------------
def rates_view(frame: pd.DataFrame) -> View:
    """Return the most accurate methods at equal cost, one row for each rate measured."""
    ok = frame[frame["status"] == "ok"]
    creep, weak = ok[ok["experiment"] == "overdamped"], ok[ok["experiment"] == "weak"]
    rows = []
    for damping in sorted(creep["damping_per_step"].dropna().unique(), reverse=True):
        fixed = creep[creep["damping_per_step"] == damping]
        adaptive = creep[creep["damping_per_step"].isna()]
        rows.append((f"slow rate of creep, γh = {damping:g}", *at_equal_cost(fixed, adaptive)))
    for (scene, span), part in weak.groupby(["scene", "t_end"], sort=False):
        steps = part["control"] == "step"
        name = f"rate of weak damping, `{scene}`, T = {span:.0e}"
        rows.append((name, *at_equal_cost(part[steps], part[~steps])))
    legend = (
        "Error of a measured damping rate, at no more evaluations than the dearest fixed-step run took. Methods within "
        f"a factor of {ALIKE:g} tie."
    )
    labels = ["rate", "most accurate", "evaluations allowed"]
    return View("rates", "Most accurate damping rate", frame_of(rows, labels), legend, SOURCE)


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
    mark = Mark.tie if len(first) > 1 else Mark.best
    return Cell(f"{names(first, NAMED)} {scientific(least)}", mark=mark)


def rate_cell(rows: pd.DataFrame, column: str) -> Cell:
    """Return one measured rate or error, or how its run ended."""
    if not len(rows):
        return Cell(DASH)
    row = rows.iloc[0]
    if row["status"] != "ok":
        return Cell(str(row["status"]), mark=Mark.none if row["status"] == "unsupported" else Mark.bad)
    return as_cell(row[column], "{:.4g}".format if column == "ratio" else scientific)


def creep_views(frame: pd.DataFrame) -> Iterator[View]:
    """Yield the slow rate of the overdamped oscillator, with fixed steps and adaptive."""
    creep = frame[frame["experiment"] == "overdamped"]
    shown = {"ratio": "rate", "q_error": "error of q", "p_error": "error of p"}
    for control, key, title in (
        ("step", "damping_per_step", "γh = {:g}"),
        ("rtol", "value", "rtol = {:.0e}"),
    ):
        part = creep[creep["control"] == control]
        if not len(part):
            continue
        values = sorted(part[key].dropna().unique(), reverse=True)
        rows = [
            (method, *(rate_cell(own[own[key] == v], name) for name in shown for v in values))
            for method, own in part.groupby("method", sort=False)
        ]
        labels = [("", "method"), *((group, title.format(v)) for group in shown.values() for v in values)]
        kind = "fixed steps" if control == "step" else "adaptive"
        legend = "γ = 50. Rate: measured over true, 1 is exact."
        yield View(
            f"creep_{control}", f"Overdamped: the slow rate, {kind}", frame_of(rows, labels), legend, SOURCE
        )


def fading_view(frame: pd.DataFrame) -> View | None:
    """Return the error of the rate of weak damping, with its cost."""
    weak = frame[frame["experiment"] == "weak"]
    if not len(weak):
        return None
    runs = list(dict.fromkeys(zip(weak["scene"], weak["t_end"], strict=True)))
    rows = []
    for method, own in weak.groupby("method", sort=False):
        cells = []
        for scene, span in runs:
            here = own[(own["scene"] == scene) & (own["t_end"] == span)]
            ok = here[here["status"] == "ok"]
            spent = ok["evaluations"].iloc[0] if len(ok) else None
            cells += [rate_cell(here, "rate_error"), as_cell(spent, count)]
        rows.append((method, *cells))
    labels = [("", "method")]
    labels += [(f"{s}, T = {span:.0e}", name) for s, span in runs for name in ("error", "evaluations")]
    legend = "γ = 10⁻⁵. Error: |measured/true − 1| of the rate at which H0 falls."
    return View("fading", "Weak damping: the rate at equal cost", frame_of(rows, labels), legend, SOURCE)


# -- strong damping --------------------------------------------------------------------------------
def usable(frame: pd.DataFrame, method: str, gamma: float) -> float:
    """Return the largest γh per evaluation up to which the method is never worse than the base; 0 if nowhere."""
    part = frame[frame["gamma"] == gamma].pivot_table(
        index="damping_per_evaluation", columns="method", values="error", dropna=False
    )
    worse = (part[method] > part[BASE] * 1.001).to_numpy()
    first = int(np.argmax(worse)) if worse.any() else len(worse)
    return float(part.index[first - 1]) if first else 0.0


def strong_parts(frame: pd.DataFrame) -> Iterator[Part]:
    """Yield where negative substeps stop paying, who is best, and the figure."""
    if BASE not in set(frame["method"]):  # all others are compared with it
        return
    gammas = sorted(frame["gamma"].unique())
    labels = [f"γ = {g:g}" for g in gammas]
    rows = [
        (method, *(as_cell(usable(frame, method, g), "{:.2g}".format) for g in gammas))
        for method in dict.fromkeys(frame["method"])
        if method != BASE
    ]
    legend = (
        f"γh per evaluation up to which a method is no less accurate than {BASE} at the same cost; 0: nowhere. "
        "Substeps against time grow by e^{γ|a|h}."
    )
    title = "Where negative substeps stop paying"
    yield View("strong_usable", title, frame_of(rows, ["method", *labels]), legend, STRONG)
    rows = []
    for low, high in itertools.pairwise(DAMPING_RANGES):
        between = f"above {low:g}" if math.isinf(high) else f"{low:g} to {high:g}"
        rows.append((between, *(best_cell(median_errors(frame, g, low, high)) for g in gammas)))
    legend = f"Median error in each range of γh per evaluation. Methods within a factor of {ALIKE:g} tie."
    title = "The most accurate fixed-step method"
    yield View("strong_best", title, frame_of(rows, ["γh per evaluation", *labels]), legend, STRONG)


def median_errors(frame: pd.DataFrame, gamma: float, low: float, high: float) -> pd.Series:
    """Return the median error of every method in a range of damping per evaluation."""
    inside = frame["damping_per_evaluation"].between(low, high, inclusive="left")
    part = frame[(frame["gamma"] == gamma) & inside].assign(error=lambda f: f["error"].fillna(np.inf))
    return part.groupby("method", sort=False)["error"].median()


def parts(frames: Frames) -> list[Part]:
    rates = frames["damping_rates"]
    fading = fading_view(rates)
    found: list[Part] = [rates_view(rates), *creep_views(rates), *([fading] if fading else [])]
    strong = tuple(strong_parts(frames["strong_damping"]))
    return [*found, *([Section("Strong damping", strong)] if strong else [])]


CHAPTERS.add(
    Chapter(
        "damping",
        "Damping",
        "Who has damping rates right, and who strong damping?",
        54,
        ("damping_rates", "strong_damping"),
        parts,
    )
)
