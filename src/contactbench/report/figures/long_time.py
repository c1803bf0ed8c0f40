"""Averages over long runs against their cost, and the defect of pairs."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from contactbench.report.curves import by_method, floats, hints, number_axis, round_off
from contactbench.report.drawing import Axis, Curve, Figure, Panel, Span
from contactbench.results.long_time import DIMENSION, ENERGY, EXPONENT, SUM

COST = "evaluations per unit of time"
#: how far an average may be off, as a part of it
ALLOWED = {ENERGY: 0.1, EXPONENT: 0.05, DIMENSION: 0.01}
#: how far a panel shows beyond the reference, in parts of that
SHOWN = 2.5


def of(frame: pd.DataFrame, quantity: str) -> pd.DataFrame:
    """The rows of a quantity with a number, cheap to dear."""
    rows = frame[(frame["quantity"] == quantity) & (frame["status"] == "ok")]
    return rows.sort_values("evaluations_per_time", kind="stable")


def averages(frame: pd.DataFrame) -> Iterator[Figure]:
    """Each average with its error bars, and the reference as a band."""
    panels = []
    for quantity in (ENERGY, EXPONENT, DIMENSION):
        rows = of(frame, quantity)
        reference = rows[rows["reference"]]
        if len(reference):
            panels.append(panel(quantity, rows[~rows["reference"]], reference.iloc[0]))
    if panels:
        yield Figure(
            "long_time", "Averages over long chaotic runs against their cost", tuple(panels),
            "Error bars: one standard error. Shaded: as far as an average may be off the reference. Points far off are "
            "outside the panels.", 3, source="long_time.csv", size=(5.0, 4.4),
        )  # fmt: skip


def panel(quantity: str, rows: pd.DataFrame, true: pd.Series) -> Panel:
    middle = float(true["mean"])
    allowed = ALLOWED[quantity] * abs(middle)
    ends = middle - SHOWN * allowed, middle + SHOWN * allowed
    curves = tuple(
        Curve(
            floats(own["evaluations_per_time"]), floats(own["mean"]), str(method), str(method), hints=hints(own),
            low=floats(own["mean"] - own["error"]), high=floats(own["mean"] + own["error"]),
            family=str(own["family"].iloc[0]),
        ) for method, own in rows.groupby("method", sort=False)
    )  # fmt: skip
    band = Span("y", middle - allowed, middle + allowed, "allowed")
    return Panel(quantity, number_axis(COST), Axis(quantity, within=ends), curves, spans=(band,))


def pairs(frame: pd.DataFrame) -> Iterator[Figure]:
    """The defect of pairs, and what it adds up to beside the noise of the largest exponent."""
    rows, noise = of(frame, SUM), of(frame, EXPONENT)
    rows = rows[~rows["reference"]].assign(total=lambda f: f["mean"].abs())
    if not len(rows):
        return
    bar = float(noise["error"].median())
    defect = number_axis("pairing defect per unit of time")
    total = number_axis("|λ₁ + λ₂ + γ|")
    yield Figure(
        "pairing", "Pairs of exponents: off by how much, and where it stops mattering",
        (
            Panel("in one period, r.m.s.", number_axis(COST), defect,
                  by_method(rows, "evaluations_per_time", "pairing_defect"), spans=(round_off("y"),)),
            Panel("over the whole run", number_axis(COST), total, by_method(rows, "evaluations_per_time", "total"),
                  spans=(round_off("y"), Span("y", bar, bar, "error bar of the largest exponent"))),
        ),
        "Below the line what the pairs are off hides in the noise of the average.", 2,
        source="long_time.csv", size=(6.2, 4.6),
    )  # fmt: skip
