"""Evaluations against error on the hard scenes, and how runs end whose motion reaches infinity."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from contactbench.report.curves import by_method
from contactbench.report.drawing import Axis, Curve, Figure, Panel, Span
from contactbench.report.escape import NO_FURTHER, OUT_OF_SCALE, escapes
from contactbench.report.figures.best import best_of_each
from contactbench.report.figures.work_precision import COLOURS, COUNTS, cost_axis, panel

#: scenes of a figure; those that are named nowhere share one more
FIGURES = {
    "damping": ("overdamped", "critical", "weak_damping", "weak_damping_particle", "antidamping", "large_step"),
    "bodies": ("tumbling", "needle", "singular_damping_1", "singular_damping_2", "singular_damping_3", "underflow"),
    "particles": ("stiff_spring", "kepler_drag", "saddle_edge", "escape"),
}  # fmt: skip
#: what stands below the title of a panel of runs that escape
REMARKS = {
    OUT_OF_SCALE: "loops of this suite: beyond 10⁶ times the scene's scale",
    NO_FURTHER: "solvers of others: until they can go no further",
}


def hard(frame: pd.DataFrame) -> Iterator[Figure]:
    """Cost against error, a figure for each kind of scene; where the true motion escapes, against the time told."""
    scenes = list(dict.fromkeys(frame["scene"]))
    others = tuple(s for s in scenes if not any(s in some for some in FIGURES.values()))
    for name, some in {**FIGURES, "others": others}.items():
        panels = [p for s in some if s in scenes for p in scene_panels(frame[frame["scene"] == s], s)]
        if panels:
            yield Figure(
                f"hard_{name}", f"Hard scenes, {name}: evaluations against error", tuple(panels),
                f"Runs that ended as the true motion does. More accurate to the right, cheaper below. {COLOURS}",
                3, source="stability.csv", size=(5.0, 4.1),
            )  # fmt: skip


def scene_panels(rows: pd.DataFrame, scene: str) -> list[Panel]:
    """Cost against error where there is one, else when runs are told to have escaped."""
    rows = rows[rows["rhs_equivalents"].notna()]
    ok = rows[(rows["status"] == "ok") & rows["solution_error"].notna()]
    if len(ok):
        return [panel(ok.sort_values("rhs_equivalents", kind="stable"), scene, COUNTS)]
    out = escapes(rows).sort_values("rhs_equivalents", kind="stable")
    parts = [(how, out[out["criterion"] == how]) for how in REMARKS]
    return [escape_panel(part, scene, how) for how, part in parts if len(part)]


def escape_panel(out: pd.DataFrame, scene: str, how: str) -> Panel:
    """When runs are told to have diverged, beside the true time; of one criterion."""
    x = Axis("told early (−) or late (+), % of the time of blow-up")
    return Panel(
        f"{scene}: {how}", x, cost_axis(out, COUNTS),
        best_of_each(by_method(out, "off", "rhs_equivalents"), nearest),
        spans=(Span("x", 0.0, 0.0),), remark=REMARKS[how],
    )  # fmt: skip


def nearest(curve: Curve, own: Sequence[Curve]) -> float:
    return -float(np.median(np.abs(curve.x)))
