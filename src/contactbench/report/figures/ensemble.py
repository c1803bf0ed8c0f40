"""Ensembles: time per trajectory against error, throughput against trajectories and cores."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd

from contactbench.report.curves import by_method, floats
from contactbench.report.drawing import Axis, Curve, Figure, Panel
from contactbench.report.figures.best import best_of_each, cheapest, contest_ends, family
from contactbench.report.figures.work_precision import error_axis
from contactbench.report.numbers import count
from contactbench.results.contest import LIMIT

SOURCE = "ensemble.csv"
#: whether trajectories that are integrated together share the steps that a solver chooses
STEPS = {"vmap": "own steps", "shared": "shared steps", "batch": "own steps"}


def steps(rows: pd.DataFrame) -> str:
    """How many steps the runs of a curve take."""
    known = [n for n in floats(rows["steps"]) if n == n]
    if not known:
        return "steps not told"
    few, many = min(known), max(known)
    return f"{few:.0f} steps" if few == many else f"{few:.0f}–{many:.0f} steps"


def error_panel(part: pd.DataFrame) -> Panel:
    """Time per trajectory against error, a curve for each way to run a method."""
    curves = []
    for (method, _, variant), rows in part.groupby(["method", "engine", "variant"], sort=False, dropna=False):
        how = STEPS.get(str(variant), "")
        label = ", ".join(filter(None, [str(method), how]))
        for curve in by_method(rows, "solution_error", "each", scale=1e6):
            told = tuple(
                f"{hint}, {n:.0f} steps" for hint, n in zip(curve.hints, floats(rows["steps"]), strict=True)
            )
            note = f"({steps(rows)})"
            curves.append(replace(curve, label=label, note=note, hints=told))
    y, beyond = contest_ends(Axis("time per trajectory, µs", "log"), curves, 100.0)
    shown = best_of_each(curves, cheapest, lambda c: (family(c), c.label.partition(", ")[2]))
    number = part["trajectories"].max()
    return Panel(
        f"{count(float(number))} trajectories, one core",
        error_axis(part[["solution_error"]]),
        y,
        shown,
        remark=beyond,
    )


def growth_panel(part: pd.DataFrame, by: str, whole: str) -> Panel:
    """Throughput against the number of something; beside it what proportional growth would be."""
    curves = []
    for (_, _, setting), rows in part.groupby(["method", "engine", "setting"], sort=False):
        (curve,) = by_method(rows, by, "gradients", scale=1e-9)
        curves.append(replace(curve, note=f"({setting.replace('step=', 'h = ')}, {steps(rows)})"))
        if by == "cores":
            ideal = rows["cores"].astype(float) * rows["gradients"].iloc[0] / float(rows["cores"].iloc[0])
            curves.append(
                Curve(
                    floats(rows["cores"]),
                    floats(1e-9 * ideal),
                    "proportional to the cores",
                    role="guide",
                    markers=False,
                )
            )
    counts = sorted(set(part[by].astype(int)))
    axis = (
        Axis(by, "log") if by == "trajectories" else Axis(by, ticks=tuple((float(c), str(c)) for c in counts))
    )
    return Panel(whole, axis, Axis("10⁹ gradients per second", limits=(0, None)), tuple(curves))


def figure(frame: pd.DataFrame) -> Figure | None:
    """Time per trajectory against error; throughput against trajectories and against cores."""
    own = frame[frame["family"] != LIMIT].assign(gradients=lambda f: f["evaluations"] * f["rate"])
    panels = []
    if len(part := own[own["question"] == "error"]):
        panels.append(error_panel(part))
    if len(part := own[own["question"] == "size"].sort_values("trajectories", kind="stable")):
        panels.append(growth_panel(part, "trajectories", "with the number of trajectories, one core"))
    if len(part := own[own["question"] == "cores"].sort_values("cores", kind="stable")):
        panels.append(
            growth_panel(part, "cores", f"with cores, {count(part['trajectories'].max())} trajectories")
        )
    if not panels:
        return None
    caption = (
        "Left: more accurate to the right, cheaper below; in colour the cheapest of each family and way to share "
        "steps. Fixed-step methods share one step size. Gradients: evaluations of all trajectories together."
    )
    return Figure(
        "ensemble", "Ensembles of the particle", tuple(panels), caption, source=SOURCE, size=(5.6, 4.4)
    )
