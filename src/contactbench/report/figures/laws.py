"""Deviations from the laws: along time, and against accuracy."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from contactbench.report.curves import by_method, number_axis, round_off
from contactbench.report.drawing import Axis, Curve, Figure, Panel
from contactbench.report.figures.best import best_of_each, like, lowest, structure_class

DECAYED = r"e^{-\int\Gamma'} η"
#: columns of the table along time: panel and axis
ALONG_TIME = {
    "energy_deviation": ("energy $H_0$", r"$|H_0 / H_0^\ast - 1|$"),
    "hamiltonian_deviation": ("contact Hamiltonian $H$", r"$|e^{\int\Gamma'} H - H(0)| \,/\, |H(0)|$"),
    "momentum_deviation": ("momentum map $J$", r"$\Vert e^{\int\Gamma'} J - J(0)\Vert \,/\, \Vert J(0)\Vert$"),
    "contact_deviation": ("contact form $η$", rf"$\Vert Φ^\ast η - {DECAYED}\Vert \,/\, \Vert {DECAYED}\Vert$"),
}  # fmt: skip
#: a law on a scene, against the error of the same runs
STRUCTURE = (
    ("contact_drift", "central", "contact form: deviation"),
    ("momentum_law", "rigid_body", "momentum map $J$: deviation"),
)
#: whose best stand in colour
CLASSES = "contact methods of order 1, 2 and higher, RK4, Herglotz, SUNDIALS, heyoka, and the other adaptive solvers"
COLOURS = f"In colour: the closest to the true $H_0$ of {CLASSES}; thin and grey: the others."


def along_time(frame: pd.DataFrame, scene: str) -> Figure:
    """The deviations from the H0, H, J and contact laws along time."""
    rows = frame[(frame["scene"] == scene) & (frame["status"] == "ok")]
    closest = best_of_each(by_method(rows, "t", "energy_deviation"), lowest, structure_class)
    panels = tuple(
        Panel(
            title, Axis("t"), number_axis(label), like(closest, by_method(rows, "t", column, every=4)),
            spans=(round_off("y"),),
        )
        for column, (title, label) in ALONG_TIME.items() if rows[column].notna().any()
    )  # fmt: skip
    settings = ", ".join(dict.fromkeys(rows["setting"]))
    return Figure(
        f"laws_{scene}", f"{scene}: deviation from each law along time", panels,
        f"Settings: {settings}. Shaded: round-off. Asterisk: the true motion. {COLOURS}", 2,
        source="laws_time.csv", size=(6.2, 4.2),
    )  # fmt: skip


def structure(frame: pd.DataFrame) -> Figure | None:
    """Structure against accuracy, same runs."""
    ok = frame[frame["status"] == "ok"]
    panels = []
    for law, scene, label in STRUCTURE:
        rows = ok[(ok["scene"] == scene) & ok[law].notna()]
        if len(rows):
            curves = best_of_each(by_method(rows, "solution_error", law), most_accurate, structure_class)
            x = number_axis("solution error", inverted=True)
            panels.append(Panel(scene, x, number_axis(label), curves, spans=(round_off("y"),)))
    if not panels:
        return None
    return Figure(
        "structure", "Structure against accuracy, same runs", tuple(panels),
        "A law that is kept by construction does not depend on the error. Shaded: round-off. In colour: the most "
        f"accurate of {CLASSES}; thin and grey: the others.", 2, source="laws.csv", size=(6.2, 4.6),
    )  # fmt: skip


def most_accurate(curve: Curve, own: Sequence[Curve]) -> float:
    """By the least error it reaches."""
    return -math.log10(min(curve.x))
