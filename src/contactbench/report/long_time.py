"""Averages over long runs of a chaotic scene: who has them right, for how many evaluations; and what the pairs do."""

from __future__ import annotations

import numpy as np
import pandas as pd

from contactbench.measure.round_off import STRUCTURE
from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part, summary
from contactbench.report.figures import long_time as figures
from contactbench.report.numbers import DASH, names, scientific
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of, matrix, pick
from contactbench.results.tables import DIMENSION, ENERGY, EXPONENT, SUM

SOURCE = "long_time.csv"
#: how far an average may be off, as a part of it
ALLOWED = {ENERGY: 0.1, EXPONENT: 0.05, DIMENSION: 0.01}
AVERAGES = (ENERGY, EXPONENT, DIMENSION)
#: error bars on either side of an average in which the true one surely is
SURE = 2.0
#: settings stand up to so far apart: methods whose least cost differs by less tie
RUNG = 1.5


def deviations(frame: pd.DataFrame, quantity: str) -> pd.DataFrame:
    """Return the rows of a quantity that are not the reference, cheap to dear.

    off, bar : the difference from the reference and its error bar, in parts of what is allowed.
    """
    part = figures.of(frame, quantity)
    reference, own = part[part["reference"]], part[~part["reference"]]
    if not len(reference) or quantity not in ALLOWED:
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
    """Return the evaluations from which on each method has an average right, the fewest first.

    surely : from where it is, its noise taken against it; perhaps : the noise taken for it.  bound : 1 where that is
    its cheapest setting.  first : 1 where neither a rung nor the noise tells it from the cheapest.
    """
    found = {
        name: {
            "surely": (surely := right_from(own, own["off"] + SURE * own["bar"] <= 1)),
            "perhaps": right_from(own, own["off"] - SURE * own["bar"] <= 1),
            "bound": surely == own["evaluations_per_time"].iloc[0],
        }
        for name, own in deviations(frame, quantity).groupby("method", sort=False)
    }
    columns = ["surely", "perhaps", "bound"]
    costs = pd.DataFrame.from_dict(found, orient="index", columns=columns).astype(float).dropna()
    costs = costs.sort_values(["surely", "perhaps"], kind="stable")
    return costs.assign(first=costs["perhaps"] <= RUNG * costs["surely"].min())


def cost_text(cost: pd.Series) -> str:
    """Return 7.8; 7.8 to 15 where the noise does not tell; ≤ 7.8 where nothing cheaper was measured."""
    low, high = f"{cost['perhaps']:.2g}", f"{cost['surely']:.2g}"
    return f"≤ {low}" if cost["bound"] else low if low == high else f"{low} to {high}"


def pairing(frame: pd.DataFrame) -> pd.Series:
    """Return the largest pairing defect of each method."""
    rows = figures.of(frame, SUM)
    worst = rows.groupby("method")["pairing_defect"].max()
    return worst.reindex([m for m in dict.fromkeys(frame["method"]) if m in worst.index])


def answers(frames: Frames) -> pd.DataFrame:
    frame, lines = frames["long_time"], []
    for quantity in AVERAGES:
        costs = least(frame, quantity)
        if len(costs):
            first = [str(name) for name in costs.index[costs["first"]]]
            cost = f"{cost_text(costs.iloc[0])} evaluations per unit of time"
            lines.append((f"Who has the {quantity} right for the fewest evaluations?", names(first, 4), cost))
    defects = pairing(frame)
    if len(defects):
        kept = [str(name) for name in defects.index[defects <= STRUCTURE]]
        count = f"{len(kept)} of {len(defects)} methods"
        lines.append(("Who keeps the pairs of exponents to round-off?", names(kept) or "nobody", count))
    return summary(*lines)


# -- views -----------------------------------------------------------------------------------------
def costs_view(frame: pd.DataFrame) -> View:
    """Return the evaluations from which on each method has each average right."""
    found = pd.concat(
        [least(frame, q).rename_axis("method").reset_index().assign(average=q) for q in AVERAGES]
    )

    def cell(rows: pd.DataFrame) -> Cell:
        cost = rows.iloc[0]
        alone = found[found["average"] == cost["average"]]["first"].sum() == 1
        mark = (Mark.best if alone else Mark.tie) if cost["first"] else None
        return Cell(cost_text(cost), float(cost["surely"]), mark)

    allowed = names([f"{100 * part:g} % ({quantity})" for quantity, part in ALLOWED.items()])
    true = frame[frame["reference"]]
    reference = f" ({true['method'].iloc[0]}, {true['setting'].iloc[0]})" if len(true) else ""
    legend = (
        f"Evaluations per unit of time from which on an average stays within {allowed} of the reference{reference}; "
        f"two numbers where {SURE:g} error bars decide; ≤: at its cheapest setting. A factor {RUNG:g} is a tie. "
        f"{DASH}: wrong at every setting, or not measured. [How to read it](../docs/reading.md#long-chaotic-runs)."
    )
    table = matrix(found, "method", "average", cell)
    return View("long_time_costs", "The least that has the averages right", table, legend, SOURCE)


def calm_view(frame: pd.DataFrame) -> View:
    """Return the settings at which a map is on the whole not chaotic."""
    rows = figures.of(frame, EXPONENT)
    labels = {"method": "method", "setting": "setting", "evaluations_per_time": "evaluations per time"}
    labels |= {"mean": "largest exponent", "error": "error bar"}
    table = pick(rows[rows["mean"] <= SURE * rows["error"]], labels)
    legend = "Most or all trajectories of the coarse map end on a periodic orbit."
    return View("long_time_calm", "Exceptions: no chaos", table, legend, SOURCE)


def pairs_view(frame: pd.DataFrame) -> View:
    """Return the pairing defect of each method, and from where on its sum is below the noise."""
    rows = []
    for method in pairing(frame).index:
        own = frame[frame["method"] == method]
        sums, bars = figures.of(own, SUM), figures.of(own, EXPONENT).set_index("setting")["error"]
        kept = Mark.kept if (sums["pairing_defect"] <= STRUCTURE).all() else None
        ends = (as_cell(sums["pairing_defect"].iloc[k], scientific, kept) for k in (0, -1))
        hidden = right_from(sums, sums["mean"].abs() <= sums["setting"].map(bars))
        rows.append((method, *ends, as_cell(hidden, "{:.2g}".format)))
    labels = ["method", "defect, cheapest setting", "defect, dearest setting", "hidden from"]
    legend = (
        "Deviation of σ₁σ₂ from e^{−γt}. Hidden from: evaluations per unit of time from which on the sum of the "
        "exponents is off by less than the error bar of the largest."
    )
    return View("long_time_pairs", "Pairs of exponents", frame_of(rows, labels), legend, SOURCE)


def parts(frames: Frames) -> list[Part]:
    frame = frames["long_time"]
    return [costs_view(frame), calm_view(frame), pairs_view(frame), *figures.pairs(frame)]


TITLE, QUESTION = "Long chaotic runs", "Which averages of long chaotic runs are right, and at what cost?"
CHAPTERS.add(Chapter("long_time", TITLE, QUESTION, 58, ("long_time",), parts, answers))
