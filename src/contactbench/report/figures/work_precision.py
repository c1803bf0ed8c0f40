"""Cost against error, scene by scene."""

from __future__ import annotations

import pandas as pd

from contactbench.report.contest import KINDS, contestants
from contactbench.report.curves import by_method, number_axis
from contactbench.report.drawing import Figure, Panel

SOURCE = "work_precision.csv"


def figure(work: pd.DataFrame, scene: str) -> Figure | None:
    """Cost against error for one scene, a panel for each kind of comparison."""
    rows = contestants(work)
    rows = rows[(rows["scene"] == scene) & (rows["status"] == "ok")]
    panels = []
    for kind in KINDS:
        part = rows[kind.engines(rows["engine"])]
        if not kind.timed:  # the same counts on every engine: one curve
            part = part.drop_duplicates(["method", "setting"])
        part = part[part[kind.cost].notna()]
        if len(part):
            label = "median time per solve, ms" if kind.timed else "right-hand sides or equivalents"
            curves = by_method(part, "solution_error", kind.cost, ("engine",), 1e3 if kind.timed else 1.0)
            panels.append(Panel(kind.title, number_axis("solution error", True), number_axis(label), curves))
    if not panels:
        return None
    caption = "More accurate to the right, cheaper below. Engines of different panels are not compared."
    return Figure(
        f"work_precision_{scene}", f"{scene}: cost against error", tuple(panels), caption, source=SOURCE
    )
