"""Order and decay laws of every method at equal cost: the table that stands first, and one per scene and cost."""

from __future__ import annotations

import pandas as pd

from contactbench.report.cells import DASH, Cell, Head, Mark, View, marks, number, word
from contactbench.report.kept import MEANINGS, at_equal_cost, bounded, called, drift_cell, numbers
from contactbench.report.numbers import count, scientific
from contactbench.report.rooms import Frames
from contactbench.results.round_off import STRUCTURE
from contactbench.results.tables import DECAY_LAWS, LAWS_TABLE

#: scenes of the table that stands first, and the scene whose order is quoted where only one is
FIRST = ("central", "rigid_body")


#: what stands instead of an order, by what sets a method
WITHOUT = {"rtol": "adaptive", "exact": "exact"}


def order_cell(frames: Frames, scene: str, row: pd.Series) -> Cell:
    """The extrapolated order of a row's method on a scene; why not, where there is none."""
    if row["control"] in WITHOUT:
        return Cell(WITHOUT[row["control"]])
    method = row["method"]
    orders = frames.get("convergence", pd.DataFrame())
    here = orders[(orders["method"] == method) & (orders["scene"] == scene)] if len(orders) else orders
    if not len(here):
        return Cell(DASH)
    first = here.iloc[0]
    if pd.isna(first["order"]):
        return Cell(str(first["status"]) if first["status"] != "ok" else "no range")
    return number(first["order"], "{:.2f}".format)


def chosen_cost(frame: pd.DataFrame) -> pd.DataFrame:
    """Of the costs every method was asked for, the rows of the one that most can meet; of equals the largest."""
    met = frame[frame["status"] == "ok"].groupby("cost").size()
    return frame[frame["cost"] == met[met == met.max()].index.max()] if len(met) else frame.iloc[:0]


def overview(frames: Frames, scenes: tuple[str, ...] = FIRST) -> View | None:
    """Order and decay laws of every method at equal cost: the table that stands first."""
    rows_of = chosen_cost(frames["decay_laws"])
    scenes = tuple(scene for scene in scenes if scene in set(rows_of["scene"]))
    if not scenes:
        return None
    part = rows_of[rows_of["scene"].isin(scenes)]
    shown = {
        scene: [
            law for law in at_equal_cost() if law in part and part[part["scene"] == scene][law].notna().any()
        ]
        for scene in scenes
    }
    heads = [Head("method", words=True)]
    for scene in scenes:
        heads.append(Head("order", "order of convergence, extrapolated", group=scene))
        heads += [Head(called(law), LAWS_TABLE.columns[law].meaning, group=scene) for law in shown[scene]]
    part = bounded(part)
    rows = []
    for method in dict.fromkeys(part["method"]):
        cells = [word(method)]
        for scene in scenes:
            here = part[(part["method"] == method) & (part["scene"] == scene)]
            cells.append(order_cell(frames, scene, here.iloc[0]) if len(here) else Cell(DASH))
            for law in shown[scene]:
                if not len(here) or here["status"].iloc[0] == "unsupported":
                    cells.append(Cell(DASH))
                elif here["status"].iloc[0] != "ok":
                    cells.append(Cell(str(here["status"].iloc[0]), marks=marks(Mark.none)))
                else:
                    cells.append(drift_cell(here.iloc[0], law))
        rows.append(tuple(cells))
    return View(
        "overview",
        "Order and decay laws at equal cost",
        equal_cost(part),
        tuple(heads),
        tuple(rows),
        "decay_laws.csv",
    )


def equal_cost(part: pd.DataFrame) -> str:
    """What equal cost was, scene by scene, and how to read the entries."""
    spent = []
    for scene, rows in part[part["status"] == "ok"].groupby("scene", sort=False):
        cost = numbers(rows, "rhs_equivalents").dropna()
        low, high = count(cost.min()), count(cost.max())
        spent.append(f"`{scene}` {low if low == high else f'{low} to {high}'}")
    return (
        "Largest deviation over the run, every method at the same number of evaluations, or as near to it as its "
        f"steps and tolerances allow ({', '.join(spent)}); one with far fewer is exact or at its tightest tolerance. "
        "Order: measured, extrapolated; *exact*: a closed form without steps. "
        f"Bold, J law and contact drift only: at round-off, that is at most {scientific(STRUCTURE, 0)}, or ε times the "
        "evaluations (for η times the growth of the map) where that is more. A method that preserves the law is there "
        "at every step size, one that does not only where its error is as small. "
        "H0 is compared with the true H0, the others with their decay e^{−∫Γ'} (J with the true J where a torque "
        "acts). ≤ or ±: by differences of the solver, which resolve nothing below their error bar. "
        f"{MEANINGS['dagger']}. {MEANINGS['undecided']}."
    )


def equal_cost_view(part: pd.DataFrame, frames: Frames) -> View:
    """One scene at one cost, with the setting taken and what it came to."""
    scene, cost = str(part["scene"].iloc[0]), part["cost"].iloc[0]
    part = bounded(part)
    shown = [law for law in at_equal_cost() if law in part and part[law].notna().any()]
    rows = []
    for _, row in part.iterrows():
        lead = (word(row["method"]), word(row["engine"]), word(row["setting"]))
        if row["status"] != "ok":
            blanks = (
                Cell(str(row["status"]), marks=marks(Mark.none)),
                *(Cell("") for _ in range(len(shown) + 2)),
            )
            rows.append((*lead, *blanks))
            continue
        rows.append((
            *lead, number(row["rhs_equivalents"], count), order_cell(frames, scene, row),
            number(row["solution_error"], scientific), *(drift_cell(row, law) for law in shown),
        ))  # fmt: skip
    heads = (
        Head("method", words=True), Head("engine", words=True), Head("setting", words=True),
        Head("evaluations", DECAY_LAWS.columns["rhs_equivalents"].meaning), Head("order"),
        Head("solution error", DECAY_LAWS.columns["solution_error"].meaning),
        *(Head(called(law), LAWS_TABLE.columns[law].meaning) for law in shown),
    )  # fmt: skip
    title = f"{scene}, {cost:g} evaluations per unit of time"
    return View(f"equal_cost_{scene}_{cost:g}", title, equal_cost(part), heads, tuple(rows), "decay_laws.csv")
