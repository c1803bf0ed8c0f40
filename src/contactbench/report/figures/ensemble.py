"""Ensembles: time per trajectory against error, throughput against trajectories and cores."""

from __future__ import annotations

import pandas as pd

from contactbench.report.contest import LIMIT
from contactbench.report.curves import by_method, floats, number_axis
from contactbench.report.drawing import Axis, Curve, Figure, Panel

SOURCE = "ensemble.csv"


def figure(frame: pd.DataFrame) -> Figure | None:
    """Time per trajectory against error; throughput against trajectories and against cores."""
    panels = []
    own = frame[frame["family"] != LIMIT]
    part = own[own["question"] == "error"]
    if len(part):
        curves = [
            Curve(c.x, c.y, c.label, c.method, dashed=str(variant) == "vmap", hints=c.hints)
            for variant, rows in part.groupby("variant", sort=False)
            for c in by_method(rows, "solution_error", "each", ("engine",), 1e6)
        ]
        panels.append(
            Panel("one core (dashed: every trajectory its own steps)", number_axis("solution error", True),
                  number_axis("time per trajectory, µs"), tuple(curves))
        )  # fmt: skip
    for question, by in (("size", "trajectories"), ("cores", "cores")):
        part = own[own["question"] == question].sort_values(by, kind="stable")
        part = part.assign(gradients=part["evaluations"] * part["rate"])
        if not len(part):
            continue
        curves = list(by_method(part, by, "gradients"))
        if question == "cores":
            for _, line in part.groupby("method", sort=False):
                number_of = line["cores"].astype(float)
                ideal = number_of * line["gradients"].iloc[0] / number_of.iloc[0]
                curves.append(
                    Curve(
                        floats(number_of),
                        floats(ideal),
                        "proportional",
                        role="reference",
                        markers=False,
                        dashed=True,
                    )
                )
        axis = Axis(by, "log" if question == "size" else "linear")
        panels.append(
            Panel(
                f"number of {by}",
                axis,
                Axis("gradients × trajectories per second", limits=(0, None)),
                tuple(curves),
            )
        )
    return Figure("ensemble", "Ensembles of the particle", tuple(panels), source=SOURCE) if panels else None
