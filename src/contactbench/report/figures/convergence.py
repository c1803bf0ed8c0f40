"""Error against step size, with guides of the claimed orders."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from contactbench.report.curves import by_method, floats
from contactbench.report.drawing import Axis, Curve, Figure, Panel
from contactbench.report.figures.best import best_of_each, family_and_order, in_colour, lowest

#: the scene that is drawn; the table has them all
SCENE = "particle"
#: below this an error is rounding, and no guide follows it
ROUNDING = 1e-14
#: a guide runs so far below its curve
BELOW = 0.15


def guides(rows: pd.DataFrame, methods: list[str]) -> Iterator[Curve]:
    """Yield a line of the claimed slope below one curve of each order."""
    part = rows[rows["method"].isin(methods) & (rows["solution_error"] > ROUNDING)]
    for order, own in part.groupby("order_nominal"):
        line = own[own["method"] == own["method"].iloc[0]].sort_values("step")
        line = line.iloc[: max(2, len(line) - 2)]  # the coarsest are not asymptotic
        steps = line["step"].to_numpy(dtype=float)
        middle = len(line) // 2
        slope = BELOW * line["solution_error"].iloc[middle] * (steps / steps[middle]) ** float(order)
        yield Curve(floats(steps), floats(slope), role="guide", markers=False)


def figure(frame: pd.DataFrame) -> Figure | None:
    """Return the convergence of every fixed-step method on one scene."""
    ok = frame[(frame["status"] == "ok") & frame["solution_error"].notna()]
    if not len(ok):
        return None
    scene = SCENE if (ok["scene"] == SCENE).any() else str(ok["scene"].iloc[0])
    rows = ok[ok["scene"] == scene]
    curves = best_of_each(by_method(rows, "step", "solution_error"), lowest, family_and_order)
    x = Axis("step size h (smaller to the right)", "log", inverted=True)
    panel = Panel("", x, Axis("error of the solution", "log"), (*guides(rows, in_colour(curves)), *curves))
    caption = "Dotted: the claimed slopes. In colour: the most accurate of each family and order."
    return Figure("convergence", message(rows, scene), (panel,), caption)


def message(rows: pd.DataFrame, scene: str) -> str:
    """Return the title: how many measured orders are the claimed ones, and how close."""
    first = rows.drop_duplicates("method")
    first = first[first["order"].notna() & first["order_nominal"].notna()]
    if not len(first):
        return f"{scene}: error against step size"
    off = (first["order"] - first["order_nominal"]).abs()
    return f"{scene}: {len(off)} methods converge at their claimed order, to within {off.max():.1g}"
