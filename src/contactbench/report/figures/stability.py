"""Stability: limits, spectral radii, strong damping."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from contactbench.report.curves import by_method, floats, number_axis
from contactbench.report.drawing import Axis, Curve, Figure, Panel, Span
from contactbench.report.figures.best import best_of_each, cheapest, family_and_order, highest
from contactbench.report.numbers import names, scientific
from contactbench.results.tables import STRONG_DAMPING

SHOWN = "In colour: the best of each family and order; thin and grey: the others."
#: steps below this are stable for everybody
FIRST_STEP = 0.03


def limits(frame: pd.DataFrame) -> Figure:
    """First unstable step against damping, per step and per evaluation."""
    rows = frame[frame["gamma"] > 0].assign(ratio=lambda f: f["gamma"] / f["omega"])
    rows = rows.sort_values("ratio", kind="stable").drop_duplicates(["method", "ratio"])
    rows = rows.assign(
        scaled=rows["limit"] * rows["omega"], each=rows["per_evaluation"] * rows["omega"],
        known=rows["theory"] * rows["omega"]
    )  # fmt: skip
    theory = tuple(
        Curve(floats(line["ratio"]), floats(line["known"]), "theory", role="guide", markers=False)
        for _, line in rows[rows["known"].notna()].groupby("method", sort=False)
    )

    def panel(title: str, column: str, label: str, more: tuple[Curve, ...] = ()) -> Panel:
        curves = best_of_each(by_method(rows, "ratio", column), highest, family_and_order)
        return Panel(title, number_axis("γ/ω"), number_axis(label), (*curves, *more))

    return Figure(
        "stability_map", "First loss of stability of $q'' + γq' + ω^2q = 0$",
        (panel("per step", "scaled", "ω × first unstable step", theory),
         panel("per evaluation", "each", "ω × first unstable step / evaluations")),
        f"Larger is better. Curves that end: no limit found. {SHOWN}", 2,
        source="stability_limits.csv", size=(6.6, 4.8),
    )  # fmt: skip


def near(exact: Curve, curve: Curve, within: float = 0.05) -> float:
    """At how many steps the curve is the exact one, or close to it."""
    known = dict(zip(exact.x, exact.y, strict=True))
    pairs = zip(curve.x, curve.y, strict=True)
    return float(sum(abs(y - known.get(x, math.nan)) < within for x, y in pairs))


def radius(frame: pd.DataFrame) -> Figure:
    """Spectral radius of the one-step map, a panel for each damping."""
    frame = frame[frame["step"] >= FIRST_STEP]
    panels = []
    for gamma in [g for g in (0.0, 0.1, 1.0, 10.0, 50.0) if g in set(frame["gamma"])]:
        part = frame[frame["gamma"] == gamma].sort_values("step", kind="stable")
        truth = part.drop_duplicates("step")
        exact = Curve(floats(truth["step"]), floats(truth["true_radius"]), "exact flow", role="truth",
                      markers=False)  # fmt: skip

        def close(curve: Curve, own: Sequence[Curve], exact: Curve = exact) -> float:
            return near(exact, curve)

        curves = best_of_each(by_method(part, "step", "radius", every=6), close, family_and_order)
        panels.append(
            Panel(f"γ = {gamma:g}", Axis("step size h", "log"), Axis("largest |eigenvalue|", limits=(0, 2)),
                  (exact, *curves), spans=(Span("y", 1.0, 1.0),))
        )  # fmt: skip
    return Figure(
        "one_step", "Spectral radius of the one-step map of the oscillator", tuple(panels),
        f"Below the exact flow: numerical damping; above: antidamping; above one: unstable. {SHOWN}",
        source="one_step.csv",
    )  # fmt: skip


#: a curve jumps from an error below the first to one above the second
JUMP = (1e-3, 1.0)


def jumps(frame: pd.DataFrame) -> str:
    """Where an error jumps because the step passes the limit of stability, in words."""
    said = []
    for (method, gamma), part in frame.groupby(["method", "gamma"], sort=False):
        part = part.sort_values("step", kind="stable")
        before, after = part.iloc[:-1], part.iloc[1:]
        jump = (before["error"].to_numpy() < JUMP[0]) & (after["error"].to_numpy() > JUMP[1])
        crosses = (before["radius"].to_numpy() <= 1) & (after["radius"].to_numpy() > 1)
        for k in np.flatnonzero(jump & crosses):
            (h, r, e), (h2, r2, e2) = (
                line[["step", "radius", "error"]] for line in (before.iloc[k], after.iloc[k])
            )
            said.append(
                f"`{method}` at γ = {gamma:g} from {scientific(e)} (h = {h:.3g}, spectral radius {r:.3f}) to "
                f"{scientific(e2)} (h = {h2:.3g}, {r2:.3f})"
            )
    if not said:
        return ""
    return (
        f" A curve jumps where its step passes the limit of stability: {names(said)}. As soon as its step is "
        "stable such a curve resolves the motion, which has only its slow decay left."
    )


def strong(frame: pd.DataFrame, gammas: list[float]) -> Figure:
    """Evaluations in the time 1/γ against the error they buy."""
    frame = frame.assign(spent=1 / frame["damping_per_evaluation"])
    panels = []
    for gamma in gammas:
        part = frame[frame["gamma"] == gamma].sort_values("spent", kind="stable")
        curves = by_method(part, "error", "spent", every=4)
        panels.append(
            Panel(f"γ = {gamma:g}", Axis("relative error", "log", inverted=True, within=(1e-16, 2.0)),
                  number_axis("evaluations in a time 1/γ"), best_of_each(curves, cheapest, family_and_order))
        )  # fmt: skip
    return Figure(
        "strong_damping", "Cost against error under strong damping", tuple(panels),
        f"{STRONG_DAMPING.columns['error'].meaning}. One evaluation in 1/γ: γh per evaluation is one. {SHOWN}"
        f"{jumps(frame)}", 2,
        source="strong_damping.csv", size=(6.2, 4.6),
    )  # fmt: skip
