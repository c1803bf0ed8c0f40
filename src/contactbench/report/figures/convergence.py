"""Error against step size, with guides of the claimed orders."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from contactbench.report.curves import by_method, number_axis
from contactbench.report.drawing import Curve, Figure, Panel
from contactbench.report.figures.best import best_of_each, family_and_order, lowest

#: below this an error is rounding, and no guide follows it
ROUNDING = 1e-14
#: a guide runs so far below its curve
BELOW = 0.15


def guides(curves: tuple[Curve, ...], claimed: dict[str, int]) -> Iterator[Curve]:
    """A line of the claimed slope below one curve of each order."""
    drawn = set()
    for curve in curves:
        order = claimed.get(curve.method)
        if curve.muted or order is None or order in drawn:
            continue
        drawn.add(order)
        known = sorted((h, e) for h, e in zip(curve.x, curve.y, strict=True) if not math.isnan(e))
        points = [(h, e) for h, e in known if e > ROUNDING]
        points = points[: max(2, len(points) - 2)]  # the coarsest are not asymptotic
        anchor = points[len(points) // 2] if points else known[-1]
        h = np.array([h for h, _ in (points if len(points) > 1 else known[-2:])])
        line = BELOW * anchor[1] * (h / anchor[0]) ** order
        yield Curve(
            tuple(h.tolist()), tuple(line.tolist()), role="guide", markers=False, note=f"slope {order}"
        )


def figure(frame: pd.DataFrame) -> Figure | None:
    """A panel for each scene; at each curve its extrapolated order."""
    ok = frame[frame["status"] == "ok"]
    claimed = {m: int(p) for m, p in zip(ok["method"], ok["order_nominal"], strict=True) if pd.notna(p)}
    panels = []
    for scene in dict.fromkeys(ok["scene"]):
        part = ok[ok["scene"] == scene]
        orders = dict(zip(part["method"], part["order"], strict=True))
        curves = best_of_each(by_method(part, "step", "solution_error"), lowest, family_and_order)
        curves = tuple(
            curve if pd.isna(orders[curve.method]) else replace(curve, note=f"{orders[curve.method]:.2f}")
            for curve in curves
        )
        panels.append(
            Panel(
                scene,
                number_axis("step size h"),
                number_axis("solution error"),
                (*guides(curves, claimed), *curves),
            )
        )
    if not panels:
        return None
    return Figure(
        "convergence", "Error against step size", tuple(panels),
        "The number at a curve is its extrapolated order; dotted: the slope of the claimed one. In colour: the most "
        "accurate of each family and order; thin and grey: the others.", 3,
        source="convergence.csv", size=(5.6, 4.6),
    )  # fmt: skip
