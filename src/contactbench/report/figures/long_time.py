"""What structure buys in long chaotic runs: the defect of pairs of Lyapunov exponents against cost."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pandas as pd

from contactbench.report.curves import ROUND_OFF, by_method
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.report.figures.laws import decade
from contactbench.results.contest import CONTACT
from contactbench.results.tables import SUM


def of(frame: pd.DataFrame, quantity: str) -> pd.DataFrame:
    """Return the rows of a quantity that have a number, cheap to dear."""
    rows = frame[(frame["quantity"] == quantity) & (frame["status"] == "ok")]
    return rows.sort_values("evaluations_per_time", kind="stable")


def pairs(frame: pd.DataFrame) -> Iterator[Figure]:
    """Yield the defect of pairs in one period against the cost, where the table has one."""
    rows = of(frame, SUM)
    rows = rows[~rows["reference"] & rows["pairing_defect"].notna()]
    if len(rows):
        curves = by_method(rows, "evaluations_per_time", "pairing_defect")
        x, y = Axis("evaluations per unit of time", "log"), Axis("pairing defect per unit of time", "log")
        panel = Panel("", x, y, curves, spans=(ROUND_OFF,))
        caption = "Root mean square of $λ_1 + λ_2 + γ$ over one period. Shaded: round-off."
        yield Figure("pairing", message(rows), (panel,), caption)


def message(rows: pd.DataFrame) -> str:
    """Return the title: the defect of contact methods, and the least of the others."""
    own = rows["family"] == CONTACT
    if own.all() or not own.any():
        return "Pairs of Lyapunov exponents: their defect"
    ours, theirs = rows[own]["pairing_defect"].max(), rows[~own]["pairing_defect"].min()
    return (
        f"Contact methods pair the Lyapunov exponents to {decade(ours, math.ceil)} at any cost, "
        f"others to {decade(theirs, math.floor)} at best, but for the reference"
    )
