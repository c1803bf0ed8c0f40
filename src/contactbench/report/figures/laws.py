"""Deviations from the laws along time."""

from __future__ import annotations

import math
from collections.abc import Callable

import pandas as pd

from contactbench.report.curves import ROUND_OFF, by_method, number_axis
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.report.figures.best import best_of_each, in_colour, like, lowest, structure_class
from contactbench.report.numbers import power
from contactbench.results.contest import CONTACT

DECAYED = r"e^{-\int\Gamma'} η"
#: columns of the table along time: panel, axis, and the quantity in the title
ALONG_TIME = {
    "energy_deviation": ("energy $H_0$", r"$|H_0 / H_0^\ast - 1|$"),
    "hamiltonian_deviation": ("contact Hamiltonian $H$", r"$|e^{\int\Gamma'} H - H(0)| \,/\, |H(0)|$"),
    "momentum_deviation": (
        "momentum map $J$",
        r"$\Vert e^{\int\Gamma'} J - J(0)\Vert \,/\, \Vert J(0)\Vert$",
    ),
    "contact_deviation": (
        "contact form $η$",
        rf"$\Vert Φ^\ast η - {DECAYED}\Vert \,/\, \Vert {DECAYED}\Vert$",
    ),
}
#: structural laws by their column along time: the column that says who claims them, and their name
STRUCTURAL = {
    "momentum_deviation": ("momentum_law_claimed", "J"),
    "contact_deviation": ("contact_drift_claimed", "the contact form"),
}


def along_time(frame: pd.DataFrame, scene: str, laws: pd.DataFrame) -> Figure:
    """Return the deviations from the H0, H, J and contact laws along time, a panel each.

    laws : the table that says which method claims which law.
    """
    rows = frame[(frame["scene"] == scene) & (frame["status"] == "ok")]
    closest = in_colour(best_of_each(by_method(rows, "t", "energy_deviation"), lowest, structure_class))
    panels = tuple(
        Panel(
            title,
            Axis("t"),
            number_axis(label),
            like(closest, by_method(rows, "t", column)),
            spans=(ROUND_OFF,),
        )
        for column, (title, label) in ALONG_TIME.items()
        if rows[column].notna().any()
    )
    caption = (
        f"Settings: {', '.join(dict.fromkeys(rows['setting']))}. Shaded: round-off. Asterisk: the true motion. In "
        "colour: the closest to the true $H_0$ of contact methods of order 1, 2 and higher, RK4, Herglotz, SUNDIALS, "
        "heyoka and the other adaptive solvers."
    )
    return Figure(f"laws_{scene}", message(rows, laws[laws["scene"] == scene], scene), panels, caption)


def message(rows: pd.DataFrame, laws: pd.DataFrame, scene: str) -> str:
    """Return the title: to what the methods that claim a law keep it, and the best of the others; without such a law
    who is closest to the true energy."""
    kept = []
    for column, (claimed, name) in STRUCTURAL.items():
        worst = rows.groupby(["family", "method"])[column].max().dropna()
        methods = laws[laws[claimed].eq(True)]["method"]
        contact = worst.index.get_level_values("family") == CONTACT
        ours, theirs = worst[worst.index.isin(methods, level="method")], worst[~contact]
        if len(ours) and len(theirs) and ours.max() > 0:
            kept.append(
                f"{name} to {decade(ours.max(), math.ceil)} (others at best {decade(theirs.min(), math.floor)})"
            )
    if kept:
        return f"{scene}, these settings: contact methods of fixed steps keep {' and '.join(kept)}"
    worst = rows.groupby("method")["energy_deviation"].max().dropna()
    if not len(worst):
        return f"{scene}: laws along time"
    return f"{scene}: {worst.idxmin()} stays closest to the true energy, to {decade(worst.min(), math.ceil)}"


def decade(value: float, ends: Callable[[float], int]) -> str:
    """Return the power of ten at the upper (`math.ceil`) or lower (`math.floor`) end of a value's decade."""
    return power(10.0 ** ends(math.log10(value))) if value > 0 else "0"
