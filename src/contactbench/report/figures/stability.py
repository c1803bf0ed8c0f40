"""Stability: hard scenes, limits, spectral radii, strong damping."""

from __future__ import annotations

import pandas as pd

from contactbench.report.curves import by_method, floats, number_axis
from contactbench.report.drawing import Axis, Curve, Figure, Panel, Span
from contactbench.results.tables import STRONG_DAMPING


# -- figures ---------------------------------------------------------------------------------------
def hard(frame: pd.DataFrame) -> Figure | None:
    ok = frame[(frame["status"] == "ok") & frame["solution_error"].notna()]
    panels = []
    for scene in dict.fromkeys(ok["scene"]):
        part = ok[ok["scene"] == scene].sort_values("rhs_equivalents", kind="stable")
        curves = by_method(part, "rhs_equivalents", "solution_error")
        panels.append(
            Panel(
                str(scene),
                number_axis("evaluations"),
                Axis("solution error", "log", limits=(1e-16, 1e6)),
                curves,
            )
        )
    if not panels:
        return None
    return Figure(
        "hard_scenes",
        "Hard scenes: error against evaluations",
        tuple(panels),
        "Runs that ended ok.",
        4,
        source="stability.csv",
    )


def limits(frame: pd.DataFrame) -> Figure:
    rows = frame[frame["gamma"] > 0].assign(ratio=lambda f: f["gamma"] / f["omega"])
    rows = rows.sort_values("ratio", kind="stable").drop_duplicates(["method", "ratio"])
    rows = rows.assign(
        scaled=rows["limit"] * rows["omega"], each=rows["per_evaluation"] * rows["omega"],
        known=rows["theory"] * rows["omega"]
    )  # fmt: skip
    theory = [
        Curve(
            floats(line["ratio"]),
            floats(line["known"]),
            "theory",
            role="reference",
            markers=False,
            dashed=True,
        )
        for _, line in rows[rows["known"].notna()].groupby("method", sort=False)
    ]
    x = number_axis("γ/ω")
    panels = (
        Panel("per step", x, number_axis("ω × first unstable step"), (*by_method(rows, "ratio", "scaled"), *theory)),
        Panel("per evaluation", x, number_axis("ω × first unstable step per evaluation"), by_method(rows,
            "ratio", "each")),
    )  # fmt: skip
    return Figure(
        "stability_map", "First loss of stability of q'' + γq' + ω²q = 0", panels,
        "Larger is better. Curves that end: no limit found.", 2, source="stability_limits.csv",
    )  # fmt: skip


def radius(frame: pd.DataFrame) -> Figure:
    panels = []
    for gamma in [g for g in (0.0, 0.1, 1.0, 10.0, 50.0) if g in set(frame["gamma"])]:
        part = frame[frame["gamma"] == gamma].sort_values("step", kind="stable")
        truth = part.drop_duplicates("step")
        exact = Curve(
            floats(truth["step"]),
            floats(truth["true_radius"]),
            "exact flow",
            role="truth",
            markers=False,
            dashed=True,
        )
        panels.append(
            Panel(f"γ = {gamma:g}", Axis("step size h", "log"), Axis("largest |eigenvalue|", limits=(0, 2)),
                  (*by_method(part, "step", "radius", every=8), exact), spans=(Span("y", 1.0, 1.0),))
        )  # fmt: skip
    return Figure(
        "one_step", "Spectral radius of the one-step map of the oscillator", tuple(panels),
        "Below the exact flow: numerical damping; above: antidamping.", source="one_step.csv",
    )  # fmt: skip


def strong(frame: pd.DataFrame, gammas: list[float]) -> Figure:
    panels = []
    for gamma in gammas:
        part = frame[(frame["gamma"] == gamma) & (frame["error"] < 1e4)].sort_values(
            "damping_per_evaluation", kind="stable"
        )
        panels.append(
            Panel(f"γ = {gamma:g}", Axis("γh per evaluation", "log"), Axis("relative error", "log",
                limits=(1e-16, 1e2)),
                  by_method(part, "damping_per_evaluation", "error", every=4))
        )  # fmt: skip
    return Figure(
        "strong_damping",
        "Equal cost under strong damping",
        tuple(panels),
        STRONG_DAMPING.columns["error"].meaning,
        2,
        source="strong_damping.csv",
    )
