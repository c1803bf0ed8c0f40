"""A motion: its orbit after many turns, and its energy, by two methods at equal cost beside the truth."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from contactbench.report.chapters import chart
from contactbench.report.curves import floats
from contactbench.report.drawing import Axis, Curve, Figure, Panel
from contactbench.results.tables import ORBIT, TRUTH


def figure(rows: pd.DataFrame) -> Figure | None:
    if not len(rows):
        return None
    late = rows[rows["t"] >= rows["t"].max() - ORBIT - 1e-9]
    energy = Panel("energy", Axis("time t"), Axis(r"$H_0$"), tuple(curves(rows, "t", "energy", True)))
    axes = Axis("$q_1$"), Axis("$q_2$")
    orbit = Panel("the orbit at the end", *axes, tuple(curves(late, "q1", "q2", False)), equal=True)
    methods = rows[rows["method"] != TRUTH]
    counts = methods.groupby("method", sort=False)["evaluations"].first()
    other = str(counts.index[-1]).upper()
    return chart("motion", [energy, orbit], evaluations=int(counts.max()), other=other, turns=ORBIT)


def curves(rows: pd.DataFrame, x: str, y: str, line: bool) -> Iterator[Curve]:
    """Yield the truth as a line, below the methods, each a line or points."""
    for name, own in sorted(rows.groupby("method", sort=False), key=lambda each: each[0] != TRUTH):
        truth = name == TRUTH
        points, lined = (floats(own[x]), floats(own[y])), truth or line
        method, role = ("", TRUTH) if truth else (str(name), "")
        yield Curve(*points, str(name), method, role, lined, not lined)
