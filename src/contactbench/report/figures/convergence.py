"""Error against step size."""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd

from contactbench.report.curves import by_method, number_axis
from contactbench.report.drawing import Figure, Panel


def figure(frame: pd.DataFrame) -> Figure | None:
    ok = frame[frame["status"] == "ok"]
    panels = []
    for scene in dict.fromkeys(ok["scene"]):
        part = ok[ok["scene"] == scene]
        orders = dict(zip(part["method"], part["order"], strict=True))
        curves = tuple(
            curve if math.isnan(orders[curve.method]) else replace(curve, note=f"{orders[curve.method]:.2f}")
            for curve in by_method(part, "step", "solution_error")
        )
        panels.append(Panel(scene, number_axis("step size h"), number_axis("solution error"), curves))
    if not panels:
        return None
    caption = "The number at each curve is its extrapolated order."
    return Figure("convergence", "Error against step size", tuple(panels), caption, source="convergence.csv")
