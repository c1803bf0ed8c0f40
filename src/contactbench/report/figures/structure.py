"""Structure against accuracy: one point a run, its error and its deviation from a law."""

from __future__ import annotations

import pandas as pd

from contactbench.report.curves import above, floats, number_axis, round_off
from contactbench.report.drawing import Curve, Figure, Panel
from contactbench.report.look import look
from contactbench.results.contest import CONTACT

#: the scene, and the law: of the contact form, of the derivative of the map
SCENE, LAW = "central", "contact_drift"
LABELS = {
    "contact": "contact methods",
    "adaptive": "contact, adaptive steps",
    "rk4": "RK4",
    "herglotz": "Herglotz",
    "scipy": "SciPy",
    "sundials": "SUNDIALS",
    "cyrk": "CyRK",
    "diffrax": "diffrax",
    "heyoka": "heyoka (Taylor)",
    "other": "others",
}
#: markers of the families: that of a typical method
MARKERS = {
    "contact": "contact-strang",
    "adaptive": "contact-rkn6",
    "rk4": "rk4",
    "herglotz": "herglotz1",
    "scipy": "scipy-dop853",
    "sundials": "cvode-bdf",
    "cyrk": "cyrk-dop853",
    "diffrax": "diffrax-tsit5",
    "heyoka": "heyoka-taylor",
}


def structure(frame: pd.DataFrame, scene: str = SCENE, law: str = LAW) -> Figure | None:
    """Return the figure of a law on a scene: contact methods at round-off whatever the error, the others as accurate
    as they are."""
    rows = frame[(frame["scene"] == scene) & (frame["status"] == "ok") & frame[law].notna()]
    if not len(rows):
        return None
    own = rows[f"{law}_claimed"].eq(True)
    families = [
        "adaptive" if family == CONTACT and not claims else look(str(method), str(family)).family
        for method, family, claims in zip(rows["method"], rows["family"], own, strict=True)
    ]
    curves = [
        Curve(
            floats(own["solution_error"]),
            above(own[law]),
            LABELS.get(str(name), LABELS["other"]),
            MARKERS.get(str(name), "other"),
            line=False,
        )
        for name, own in rows.groupby(families, sort=False)
    ]
    panel = Panel(
        "",
        number_axis("error of the solution (more accurate to the right)", inverted=True),
        number_axis("deviation of the contact form" if law == LAW else f"deviation: {law}"),
        tuple(curves),
        spans=(round_off("y"),),
    )
    return Figure(
        "structure", message(rows, law), (panel,), f"Every method and setting on `{scene}`. Shaded: round-off.",
        source="laws.csv",
    )  # fmt: skip


def message(rows: pd.DataFrame, law: str) -> str:
    """Return the title: in how many of the runs that claim the law it is kept."""
    kept = rows[rows[f"{law}_claimed"].eq(True)][f"{law}_kept"].dropna()
    if not len(kept):
        return "Structure against accuracy"
    return (
        f"Contact methods keep the contact form at any error ({int(kept.sum())} of {len(kept)} runs), "
        "others lose it with accuracy"
    )
