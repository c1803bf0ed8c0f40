"""Deviations from the laws: along time, and against accuracy."""

from __future__ import annotations

import pandas as pd

from contactbench.report.curves import by_method, number_axis, round_off
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.results.tables import LAWS_TIME

# -- figures ---------------------------------------------------------------------------------------
#: columns of the table along time
ALONG_TIME = {
    "energy_deviation": "H0",
    "hamiltonian_deviation": "contact Hamiltonian H",
    "momentum_deviation": "momentum map J",
    "contact_deviation": "contact form η",
}


def along_time(frame: pd.DataFrame, scene: str) -> Figure:
    """The deviations from the H0, H, J and contact laws along time."""
    rows = frame[(frame["scene"] == scene) & (frame["status"] == "ok")]
    panels = tuple(
        Panel(
            title, Axis("t"), number_axis(LAWS_TIME.columns[column].meaning),
            by_method(rows, "t", column, every=4), spans=(round_off("y"),),
        )
        for column, title in ALONG_TIME.items() if rows[column].notna().any()
    )  # fmt: skip
    caption = "Settings: " + ", ".join(dict.fromkeys(rows["setting"])) + ". Shaded: round-off."
    return Figure(
        f"laws_{scene}",
        f"{scene}: deviation from each law along time",
        panels,
        caption,
        len(panels),
        source="laws_time.csv",
    )


def structure(frame: pd.DataFrame) -> Figure | None:
    """Structure against accuracy, same runs."""
    ok = frame[frame["status"] == "ok"]
    wanted = (("contact_drift", "central", "contact drift"), ("momentum_law", "rigid_body", "J law"))
    panels = []
    for law, scene, label in wanted:
        rows = ok[(ok["scene"] == scene) & ok[law].notna()]
        if len(rows):
            panels.append(
                Panel(scene, number_axis("solution error", inverted=True), number_axis(label),
                      by_method(rows, "solution_error", law), spans=(round_off("y"),))
            )  # fmt: skip
    if not panels:
        return None
    return Figure(
        "structure", "Structure against accuracy, same runs", tuple(panels),
        "A law that is kept by construction does not depend on the error. Shaded: round-off.", 2, source="laws.csv",
    )  # fmt: skip
