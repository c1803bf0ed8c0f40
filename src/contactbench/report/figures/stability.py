"""The stability map: the first unstable step against damping."""

from __future__ import annotations

import numpy as np
import pandas as pd

from contactbench.report.curves import by_method
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.report.figures.best import best_of_each, family_and_order, highest


def limits(frame: pd.DataFrame) -> Figure:
    """Return the first unstable step per evaluation of a damped oscillator against its damping."""
    rows = frame[frame["gamma"] > 0].assign(ratio=lambda f: f["gamma"] / f["omega"])
    rows = rows.sort_values("ratio", kind="stable").drop_duplicates(["method", "ratio"])
    rows = rows.assign(scaled=rows["per_evaluation"] * rows["omega"])
    curves = best_of_each(by_method(rows, "ratio", "scaled"), highest, family_and_order)
    x, y = Axis("γ/ω", "log"), Axis("ω × first unstable step / evaluations", "log")
    caption = (
        "$q'' + γq' + ω^2q = 0$. Larger is better; a curve that ends: no limit found. In colour: the best of each "
        "family and order."
    )
    panel = Panel("", x, y, curves)
    return Figure("stability_map", message(rows), (panel,), caption)


def message(rows: pd.DataFrame) -> str:
    """Return the title: which method takes the largest steps per evaluation under the strongest damping."""
    last = rows[rows["ratio"] == rows["ratio"].max()]
    if not len(last) or last["scaled"].isna().all():
        return "First loss of stability"
    finite = last[np.isfinite(last["scaled"])]
    best = finite.loc[finite["scaled"].idxmax()]
    free = ", ".join(last[np.isinf(last["scaled"])]["method"])
    return (
        f"At γ = {best['ratio']:g} ω {best['method']} is stable to {best['scaled']:.3g}/ω an evaluation, the median "
        f"method to {last['scaled'].median():.2g}/ω" + (f"; {free} at any step" if free else "")
    )
