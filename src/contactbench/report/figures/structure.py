"""Structure against accuracy: one point a run, its error and its deviation from a law."""

from __future__ import annotations

import pandas as pd

from contactbench.report.curves import ROUND_OFF, above, floats, number_axis
from contactbench.report.drawing import Curve, Figure, Panel
from contactbench.report.look import look
from contactbench.results.contest import CONTACT

#: the scene, and the law: of the contact form, of the derivative of the map
SCENE, LAW = "central", "contact_drift"
#: families: the label, and the method whose marker stands for it
FAMILIES = {
    "contact": ("contact methods", "contact-strang"),
    "adaptive": ("contact, adaptive steps", "contact-rkn6"),
    "rk4": ("RK4", "rk4"),
    "herglotz": ("Herglotz", "herglotz1"),
    "scipy": ("SciPy", "scipy-dop853"),
    "sundials": ("SUNDIALS", "cvode-bdf"),
    "cyrk": ("CyRK", "cyrk-dop853"),
    "diffrax": ("diffrax", "diffrax-tsit5"),
    "heyoka": ("heyoka (Taylor)", "heyoka-taylor"),
}


def structure(frame: pd.DataFrame) -> Figure | None:
    """Return the figure: contact methods at round-off whatever the error, the others as accurate as they are."""
    rows = frame[(frame["scene"] == SCENE) & (frame["status"] == "ok") & frame[LAW].notna()]
    if not len(rows):
        return None
    own = rows[f"{LAW}_claimed"].eq(True)
    families = [
        "adaptive" if family == CONTACT and not claims else look(str(method), str(family)).family
        for method, family, claims in zip(rows["method"], rows["family"], own, strict=True)
    ]
    curves = tuple(
        Curve(
            floats(own["solution_error"]),
            above(own[LAW]),
            *FAMILIES.get(name, ("others", "other")),
            line=False,
        )
        for name, own in rows.groupby(families, sort=False)
    )
    x = number_axis("error of the solution (more accurate to the right)", inverted=True)
    panel = Panel("", x, number_axis("deviation of the contact form"), curves, (ROUND_OFF,))
    caption = f"Every method and setting on `{SCENE}`. Shaded: round-off."
    return Figure("structure", message(rows), (panel,), caption)


def message(rows: pd.DataFrame) -> str:
    """Return the title: in how many of the runs that claim the law it is kept."""
    kept = rows[rows[f"{LAW}_claimed"].eq(True)][f"{LAW}_kept"].dropna()
    if not len(kept):
        return "Structure against accuracy"
    return (
        f"Contact methods keep the contact form at any error ({int(kept.sum())} of {len(kept)} runs), "
        "others only as well as they solve"
    )
