"""Ensembles: time per trajectory against error."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd

from contactbench.report.curves import by_method
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.report.figures.best import best_of_each, cheapest, contest_ends, family
from contactbench.report.figures.work_precision import ERRORS
from contactbench.report.numbers import count
from contactbench.results.contest import CONTACT, LIMIT

#: whether trajectories that are integrated together share the steps that a solver chooses
STEPS = {"vmap": "own steps", "shared": "shared steps", "batch": "own steps"}


def figure(frame: pd.DataFrame) -> Figure | None:
    """Return the time per trajectory against the error, a curve for each way to run a method."""
    rows = frame[(frame["family"] != LIMIT) & (frame["question"] == "error")]
    curves = [
        replace(curve, label=", ".join(filter(None, [curve.label, STEPS.get(str(variant), "")])))
        for (_, _, variant), own in rows.groupby(["method", "engine", "variant"], sort=False, dropna=False)
        for curve in by_method(own, "solution_error", "each", 1e6)
    ]
    if not curves:
        return None
    x = Axis("error of the solution (more accurate to the right)", "log", inverted=True, within=ERRORS)
    y = contest_ends(Axis("time per trajectory, µs", "log"), curves, 100.0)
    panel = Panel("", x, y, best_of_each(curves, cheapest, family))
    caption = "One core; fixed-step methods share one step size. In colour: the cheapest of each family."
    return Figure("ensemble", message(rows), (panel,), caption)


def message(rows: pd.DataFrame) -> str:
    """Return the title: the least time per trajectory of the contact methods, and of the others."""
    trajectories = count(float(rows["trajectories"].max()))
    fine = rows[rows["solution_error"] < 1e-6]
    least = fine.groupby(fine["family"] == CONTACT)["each"].min()
    if len(least) < 2:
        return f"{trajectories} trajectories on one core"
    return (
        f"{trajectories} trajectories on one core, errors below 10⁻⁶: {1e6 * least[True]:.2g} µs each by a contact "
        f"method, {1e6 * least[False]:.2g} µs by another"
    )
