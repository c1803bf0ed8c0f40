"""Order and decay laws at equal cost: the table of the mission, and one table per scene and cost."""

from __future__ import annotations

import pandas as pd

from contactbench.report.chapters import Frames
from contactbench.report.law_cells import drift_cell, law_label, order_cell, with_bounds
from contactbench.report.numbers import DASH, count, scientific
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of
from contactbench.results.judgement import law_rows, laws_at_equal_cost

SOURCE = "decay_laws.csv"
#: the scenes of the mission, and the methods that a reader knows
SCENES = ("oscillator", "particle", "rigid_body")
METHODS = [
    "contact-printed",
    "contact-strang",
    "contact-rkn4",
    "contact-rkn8",
    "contact-o8",
    "herglotz2",
    "rk4",
]
METHODS += [
    "scipy-dop853",
    "scipy-radau",
    "cvode-adams",
    "cvode-bdf",
    "cyrk-vern8",
    "diffrax-dopri8",
    "heyoka-taylor",
]
#: the laws of the mission; that of J where a method claims it
LAWS = ("energy_law", "momentum_law", "contact_drift")


def most_met_cost(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the cost that most methods can meet; of equals the largest."""
    met = frame[frame["status"] == "ok"].groupby("cost").size()
    return frame[frame["cost"] == met[met == met.max()].index.max()] if len(met) else frame.iloc[:0]


def mission_view(frames: Frames) -> View | None:
    """Return order and laws of known methods on the scenes of the mission, side by side, at equal cost."""
    rows = with_bounds(most_met_cost(frames["decay_laws"]))
    rows = rows[rows["scene"].isin(SCENES) & rows["method"].isin(METHODS)]
    if not len(rows):
        return None
    momentum = law_rows(frames, "momentum_law")
    claimed = set(momentum[momentum["claimed"]]["scene"])
    there = [scene for scene in SCENES if scene in set(rows["scene"])]
    laws = {scene: [law for law in LAWS if law != "momentum_law" or scene in claimed] for scene in there}
    by_pair = {(row["method"], row["scene"]): row for row in rows.to_dict("records")}
    lines = []
    for method in sorted(set(rows["method"]), key=METHODS.index):
        cells: list[Cell] = []
        for scene in there:
            row = by_pair.get((method, scene), {"status": DASH})
            ran = row["status"] == "ok"
            cells.append(order_cell(frames, row) if ran else Cell(str(row["status"])))
            cells += [drift_cell(row, law) if ran else Cell(DASH) for law in laws[scene]]
        lines.append((method, *cells))
    labels = [(s, name) for s in there for name in ("order", *map(law_label, laws[s]))]
    steps = rows[(rows["status"] == "ok") & (rows["control"] == "step")].groupby("scene", sort=False)
    spent = ", ".join(f"`{scene}` about {count(n)}" for scene, n in steps["rhs_equivalents"].median().items())
    legend = (
        f"Largest deviation over the run, every method at the same number of evaluations ({spent}) or as near as its "
        "steps and tolerances allow. Bold: at round-off. ≤: an upper bound, by differences of the solver. "
        "[All methods, scenes and costs](laws.md#at-equal-cost)."
    )
    return View(
        "mission", "Order and laws at equal cost", frame_of(lines, [("", "method"), *labels]), legend, SOURCE
    )


def equal_cost_view(part: pd.DataFrame, frames: Frames) -> View:
    """Return one scene at one cost, with the setting taken and what it came to."""
    scene, cost = str(part["scene"].iloc[0]), part["cost"].iloc[0]
    laws = [law for law in laws_at_equal_cost() if law in part and part[law].notna().any()]
    rows = []
    for row in with_bounds(part).to_dict("records"):
        lead = (row["method"], row["engine"], row["setting"])
        if row["status"] != "ok":
            rows.append((*lead, Cell(str(row["status"]), mark=Mark.none), *[Cell("")] * (len(laws) + 2)))
            continue
        evaluations, error = (
            as_cell(row["rhs_equivalents"], count),
            as_cell(row["solution_error"], scientific),
        )
        rows.append(
            (*lead, evaluations, order_cell(frames, row), error, *(drift_cell(row, law) for law in laws))
        )
    labels = ["method", "engine", "setting", "evaluations", "order", "solution error", *map(law_label, laws)]
    title = f"{scene}, {cost:g} evaluations per unit of time"
    return View(f"equal_cost_{scene}_{cost:g}", title, frame_of(rows, labels), "", SOURCE)
