"""Measured rates of damping, and how fixed-step methods compare as damping gets strong."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
import pandas as pd

from contactbench.report.cells import DASH, Cell, Head, Mark, View, marks, number, word
from contactbench.report.contest import NAMED
from contactbench.report.figures import stability as figures
from contactbench.report.numbers import count, names, scientific, times, upper
from contactbench.report.raw import raw
from contactbench.report.rooms import ROOMS, Frames, Part, Room, Section
from contactbench.results.round_off import STRUCTURE
from contactbench.results.tables import DAMPING_RATES, STRONG_DAMPING

#: errors whose ratio is within this are as good as equal
ALIKE = 2.0
#: a method may cost this much more than the others and still be at equal cost
AFFORDABLE = 1.15
#: γh per evaluation is sorted into ranges with these borders
DAMPING_RANGES = (0.0, 0.01, 0.1, 1.0, 10.0, math.inf)
#: with which the others are compared under strong damping: a composition without steps against time
BASE = "contact-strang"


def rate_cell(rows: pd.DataFrame, column: str) -> Cell:
    if not len(rows):
        return Cell(DASH)
    row = rows.iloc[0]
    if row["status"] != "ok":
        return Cell(
            str(row["status"]), marks=marks(Mark.none if row["status"] == "unsupported" else Mark.bad)
        )
    return number(row[column], "{:.4g}".format if column == "ratio" else scientific)


#: what is shown of the overdamped oscillator
CREEP = {"ratio": "rate", "q_error": "error of q", "p_error": "error of p"}


def creep_views(frame: pd.DataFrame) -> Iterator[View]:
    """The slow rate of the overdamped oscillator."""
    creep = frame[frame["experiment"] == "overdamped"]
    meaning = (
        f"{upper(DAMPING_RATES.columns['ratio'].meaning)} of the slow rate, γ = 50: 1 is exact. Then "
        f"{DAMPING_RATES.columns['q_error'].meaning}, and {DAMPING_RATES.columns['p_error'].meaning}."
    )
    for control, key, title in (
        ("step", "damping_per_step", "γh = {:g}"),
        ("rtol", "value", "rtol = {:.0e}"),
    ):
        part = creep[creep["control"] == control]
        if not len(part):
            continue
        columns = sorted(part[key].dropna().unique(), reverse=True)
        rows = [
            (word(method), *(rate_cell(mine[mine[key] == c], name) for name in CREEP for c in columns))
            for method, mine in part.groupby("method", sort=False)
        ]
        heads = (
            Head("method", words=True),
            *(Head(title.format(c), group=group) for group in CREEP.values() for c in columns),
        )
        kind = "fixed steps" if control == "step" else "adaptive"
        yield View(
            f"creep_{control}",
            f"Overdamped: the slow rate, {kind}",
            meaning,
            heads,
            tuple(rows),
            "damping_rates.csv",
        )


def fading_view(frame: pd.DataFrame) -> View | None:
    """The rate of weak damping at about equal cost."""
    weak = frame[frame["experiment"] == "weak"]
    if not len(weak):
        return None
    questions = list(dict.fromkeys(zip(weak["scene"], weak["t_end"], strict=True)))
    rows = []
    for method, mine in weak.groupby("method", sort=False):
        cells = [word(method)]
        for scene, span in questions:
            here = mine[(mine["scene"] == scene) & (mine["t_end"] == span)]
            spent = here["evaluations"].iloc[0] if len(here) and here["status"].iloc[0] == "ok" else None
            cells += [rate_cell(here, "rate_error"), number(spent, count)]
        rows.append(tuple(cells))
    heads = [Head("method", words=True)]
    for scene, span in questions:
        group = f"{scene}, T = {span:.0e}"
        heads += [
            Head("error", DAMPING_RATES.columns["rate_error"].meaning, group=group),
            Head("evaluations", group=group),
        ]
    meaning = (
        "|measured/true − 1| of the rate at which H0 falls, γ = 10⁻⁵, at about the same number of "
        "evaluations for every "
        "method, or as near to that as its tolerances come."
    )
    return View(
        "fading",
        "Weak damping: the rate at equal cost",
        meaning,
        tuple(heads),
        tuple(rows),
        "damping_rates.csv",
    )


def rates_view(frame: pd.DataFrame) -> View:
    """Errors of damping rates at equal cost, each question with its ties."""
    rows = []
    creep = frame[(frame["experiment"] == "overdamped") & (frame["status"] == "ok")]
    for damping in sorted(creep["damping_per_step"].dropna().unique(), reverse=True):
        fixed = creep[creep["damping_per_step"] == damping]
        budget = AFFORDABLE * float(fixed["evaluations"].max())
        adaptive = creep[creep["damping_per_step"].isna() & (creep["evaluations"] <= budget)]
        rows.append(
            (
                word(f"slow rate of creep, γh = {damping:g}"),
                *at_equal_cost(pd.concat([fixed, adaptive]), budget),
            )
        )
    weak = frame[(frame["experiment"] == "weak") & (frame["status"] == "ok")]
    for (scene, span), part in weak.groupby(["scene", "t_end"], sort=False):
        steps = part[part["control"] == "step"]
        budget = AFFORDABLE * float((steps if len(steps) else part)["evaluations"].max())
        rows.append(
            (
                word(f"rate of weak damping, `{scene}`, T = {span:.0e}"),
                *at_equal_cost(part[part["evaluations"] <= budget], budget),
            )
        )
    heads = (Head("rate", words=True), Head("most accurate", words=True), Head("evaluations allowed"))
    meaning = (
        "Error of a measured damping rate. Compared at equal cost: an adaptive method takes part "
        "with its settings that "
        f"cost no more than {100 * (AFFORDABLE - 1):.0f} % above the dearest fixed-step run. Methods "
        "within a factor of "
        f"{ALIKE:g} are a tie."
    )
    return View(
        "advice_rates", "Which integrator for damping rates", meaning, heads, tuple(rows), "damping_rates.csv"
    )


def at_equal_cost(rows: pd.DataFrame, budget: float) -> tuple[Cell, Cell]:
    errors = rows.groupby("method", sort=False)["rate_error"].min()
    return alike_cell(errors.astype(float)), number(budget, count)


def alike_cell(errors: pd.Series) -> Cell:
    """The most accurate, and those within ALIKE of it; all that is round-off is alike."""
    errors = errors[errors < 1].sort_values(kind="stable")
    if not len(errors):
        return Cell(DASH)
    first = [str(m) for m in errors.index[errors <= max(STRUCTURE, ALIKE * errors.iloc[0])]]
    tied = len(first) > 1
    text = f"tie ({times(ALIKE)}): {names(first, NAMED)}" if tied else first[0]
    least = float(errors.iloc[0])
    return Cell(f"{text} {scientific(least)}", least, marks(Mark.tie if tied else Mark.best))


def usable(frame: pd.DataFrame, method: str, gamma: float) -> float:
    """The largest γh per evaluation up to which the method is never worse than the base; 0 if nowhere."""
    part = frame[frame["gamma"] == gamma].pivot_table(
        index="damping_per_evaluation", columns="method", values="error", dropna=False
    )
    worse = (part[method] > part[BASE] * 1.001).to_numpy()
    first = int(np.argmax(worse)) if worse.any() else len(worse)
    return float(part.index[first - 1]) if first else 0.0


def strong_parts(frame: pd.DataFrame) -> Iterator[Part]:
    if BASE not in set(frame["method"]):  # all others are compared with it
        return
    gammas = sorted(frame["gamma"].unique())
    heads = tuple(Head(f"γ = {g:g}") for g in gammas)
    rows = tuple(
        (word(method), *(number(usable(frame, method, g), "{:.2g}".format) for g in gammas))
        for method in dict.fromkeys(frame["method"]) if method != BASE
    )  # fmt: skip
    yield View(
        "strong_usable", "Strong damping: where negative substeps stop paying",
        f"Damping between two evaluations, γh/evaluations, up to which a method is no less accurate than {BASE} at the "
        "same cost (oscillator, ω = 1, over the time in which the motion falls by a factor e; 0: nowhere). "
        "Substeps against time "
        "grow by e^{γ|a|h}.", (Head("method", words=True), *heads), rows, "strong_damping.csv",
    )  # fmt: skip
    ranges = []
    for low, high in itertools.pairwise(DAMPING_RANGES):
        label = (
            f"below {high:g}"
            if low == 0
            else f"above {low:g}"
            if math.isinf(high)
            else f"{low:g} to {high:g}"
        )
        ranges.append((word(label), *(alike_cell(in_range(frame, g, low, high)) for g in gammas)))
    yield View(
        "strong_best", "Strong damping: the most accurate fixed-step method at equal cost",
        f"Median error in each range of γh per evaluation, oscillator; methods within a factor of {ALIKE:g} are named "
        f"together. {DASH}: no error below one.",
        (Head("γh per evaluation", words=True), *(Head(h.label, words=True) for h in heads)), tuple(ranges),
        "strong_damping.csv",
    )  # fmt: skip
    yield figures.strong(frame, gammas)


def in_range(frame: pd.DataFrame, gamma: float, low: float, high: float) -> pd.Series:
    """Median error of every method in a range of damping per evaluation."""
    inside = frame["damping_per_evaluation"].between(low, high, inclusive="left")
    part = frame[(frame["gamma"] == gamma) & inside].assign(error=lambda f: f["error"].fillna(np.inf))
    return part.groupby("method", sort=False)["error"].median()


def sections(frames: Frames) -> list[Part]:
    rates = frames["damping_rates"]
    views = [*creep_views(rates), fading_view(rates)]
    parts: list[Part] = [Section("Rates of damping", tuple(view for view in views if view is not None))]
    if strong := tuple(strong_parts(frames["strong_damping"])):
        parts.append(Section("Strong damping", strong))
    tables = (DAMPING_RATES, STRONG_DAMPING)
    return [*parts, *(raw(table, frames[table.name]) for table in tables if len(frames[table.name]))]


ROOMS.add(
    Room(
        "damping", "Damping", "measured damping rates, and fixed-step methods as damping gets strong", 54,
        ("damping_rates", "strong_damping"), sections,
    )
)  # fmt: skip
