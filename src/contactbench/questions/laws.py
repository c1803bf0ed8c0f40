"""Decay laws and drifts: who keeps which law, at equal cost, law by law, and along time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import pandas as pd

from contactbench.measure.law import DECIDABLE, STRUCTURE, UNSURE
from contactbench.measure.statistics import ALIKE, ties
from contactbench.questions.contest import CONTACT
from contactbench.questions.judgement import law_rows, laws_at_equal_cost, structural_laws
from contactbench.report.chapters import PROSE, Answer, Frames, Part, Section, Text, chapter, chart, view
from contactbench.report.curves import ROUND_OFF, above, by_method, choose, floats, only
from contactbench.report.drawing import Axis, Curve, Figure, Panel
from contactbench.report.look import look
from contactbench.report.numbers import DASH, count, how_often, names, power, scientific, times
from contactbench.report.views import Cell, Mark, Show, View, as_cell, frame_of, matrix
from contactbench.tables.declared import LAWS_TABLE

DAGGER, DOUBLE_DAGGER = "†", "‡"
LEGEND: str = PROSE["laws"]["legend"]


@lru_cache(2)
def structural_rows(frames: Frames) -> pd.DataFrame:
    rows = [law_rows(frames, law).assign(law=law, label=law_label(law)) for law in structural_laws()]
    return pd.concat(rows, ignore_index=True)


def kept_of(rows: pd.DataFrame) -> tuple[int, int]:
    return int(rows["kept"].sum()), int((rows["judged"] & ~rows["undecided"]).sum())


def counts(rows: pd.DataFrame) -> str:
    kept, decided = kept_of(rows)
    idle = {"undecided": int(rows["undecided"].sum()), "not judged": int((~rows["judged"]).sum())}
    beside = ", ".join(f"{number} {word}" for word, number in idle.items() if number)
    return f"{kept} of {decided} runs" + (f" ({beside})" if beside else "")


def answers(frames: Frames) -> Iterator[Answer]:
    rows = structural_rows(frames)
    for label, own in rows[rows["claimed"]].groupby("label", sort=False):
        yield Answer(f"{label}: at round-off where claimed?", how_often(*kept_of(own)), counts(own))


# -- cells -----------------------------------------------------------------------------------------
def law_label(law: str) -> str:
    known = LAWS_TABLE.columns.get(law)
    return known.label if known and known.label else law.replace("_", " ")


def drift_cell(row: pd.Series, law: str) -> Cell:
    def number(name: str) -> float:
        value = row.get(name)
        return 0.0 if value is None or pd.isna(value) else float(value)

    if pd.isna(row.get(law)):
        return Cell(DASH)
    value, error, limit = (number(name) for name in (law, f"{law}_uncertainty", f"{law}_bound"))
    ill = number(f"{law}_undecided") > 0 and limit > DECIDABLE
    unsure = error > 0 and value <= UNSURE * error
    bar = f" ± {scientific(error, 0)}" if not unsure and 0 < value / 10 <= error else ""
    signs = (DAGGER if number(f"{law}_clamped") > 0 else "") + (DOUBLE_DAGGER if ill else "")
    text = f"{'≤ ' if unsure else ''}{scientific(value)}{bar}{signs}"
    return Cell(text, value, Mark.kept if number(f"{law}_kept") else None)


def cost_cells(frames: Frames, row: pd.Series, laws: Sequence[str]) -> list[Cell]:
    if row["status"] != "ok":
        return [Cell(str(row["status"])), *[Cell(DASH)] * (len(laws) + 1)]
    spent = as_cell(row["rhs_equivalents"], count)
    return [spent, order_cell(frames, row), *(drift_cell(row, law) for law in laws)]


def order_cell(frames: Frames, row: pd.Series) -> Cell:
    if row["control"] != "step":
        return Cell({"rtol": "adaptive"}.get(row["control"], str(row["control"])))
    orders = frames["convergence"]
    here = orders[(orders["method"] == row["method"]) & (orders["scene"] == row["scene"])]
    return as_cell(here["order"].iloc[0] if len(here) else None, "{:.2f}".format)


# -- views -----------------------------------------------------------------------------------------
def claims_view(rows: pd.DataFrame) -> View:
    contact = rows["family"].eq(CONTACT)
    groups = contact.map({True: "contact methods, not claimed", False: "others, not claimed"})
    rows = rows.assign(who=groups.where(~rows["claimed"], "claimed"))
    rows = rows.sort_values("claimed", ascending=False, kind="stable")
    rows = rows.rename(columns={"label": "law or drift"})
    return view("law_claims", matrix(rows, "law or drift", "who", counts))


def broken_view(rows: pd.DataFrame) -> View:
    lines = []
    broken = rows[rows["claimed"] & rows["broken"]]
    broken = broken.assign(over=broken["value"] / broken["bound"])
    for (label, scene), own in broken.groupby(["label", "scene"], sort=False):
        worst, methods = own.loc[own["over"].idxmax()], names(list(dict.fromkeys(own["method"])), 3)
        found = worst["over"], worst["value"], f"{worst['method']}, {worst['setting']}"
        lines.append((label, f"`{scene}`", methods, len(own), *found))
    labels = ["law or drift", "scene", "methods", "runs", "over the bound", "deviation", "worst"]
    show: dict[str, Show] = {"over the bound": times, "deviation": scientific}
    return view("law_exceptions", frame_of(lines, labels), show)


def most_met_cost(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the rows at the cost that most methods have met, the largest of several."""
    met = frame[frame["status"] == "ok"].groupby("cost").size()
    return frame[frame["cost"] == met[met == met.max()].index.max()] if len(met) else frame.iloc[:0]


def equal_cost_view(part: pd.DataFrame, frames: Frames) -> View:
    scene, cost = str(part["scene"].iloc[0]), part["cost"].iloc[0]
    laws = [law for law in laws_at_equal_cost() if law in part and part[law].notna().any()]
    rows = []
    for _, row in part.iterrows():
        spent, order, *drifts = cost_cells(frames, row, laws)
        error = as_cell(row["solution_error"], scientific)
        rows.append((*row[["method", "engine", "setting"]], spent, order, error, *drifts))
    labels = ["method", "engine", "setting", "evaluations", "order", "solution error", *map(law_label, laws)]
    title = f"{scene}, {cost:g} evaluations per unit of time"
    return View(f"equal_cost_{scene}_{cost:g}", title, frame_of(rows, labels))


@chapter("laws", answers)
def parts(frames: Frames) -> list[Part | None]:
    rows, time = structural_rows(frames), frames["laws_time"]
    equal = frames["decay_laws"].groupby("scene", sort=False)
    along = (Section(scene, (along_time(time, scene),)) for scene in dict.fromkeys(time["scene"]))
    shown = [equal_cost_view(at, frames) for _, part in equal if len(at := most_met_cost(part))]
    return [
        claims_view(rows),
        broken_view(rows),
        structure(frames["laws"]),
        Section("At equal cost", (Text(LEGEND), *shown)) if shown else None,
        Section("Along time", tuple(along)),
    ]


# -- structure against accuracy: one point a run ---------------------------------------------------
#: the scene, and the law: of the contact form, of the derivative of the map
SCENE, LAW = "central", "contact_drift"


def structure(frame: pd.DataFrame) -> Figure | None:
    rows = frame[(frame["scene"] == SCENE) & (frame["status"] == "ok") & frame[LAW].notna()]
    if not len(rows):
        return None
    claims = rows[f"{LAW}_claimed"].eq(True)
    kept = rows[claims][f"{LAW}_kept"].dropna()
    families = [look(*map(str, pair)).family for pair in zip(rows["method"], rows["family"], strict=True)]
    groups = np.where(rows["family"].eq(CONTACT) & ~claims, "contact, steps that follow", families)
    curves = []
    for name, own in rows.groupby(groups, sort=False):
        points = floats(own["solution_error"]), above(own[LAW])
        curves.append(Curve(*points, str(name), str(own["method"].iloc[0]), line=False))
    x = Axis("error of the solution (more accurate to the right)", "log", inverted=True)
    panel = Panel("", x, Axis("deviation of the contact form", "log"), tuple(curves), (ROUND_OFF,))
    return chart("structure", [panel], kept=int(kept.sum()), runs=len(kept), scene=SCENE)


# -- along time ------------------------------------------------------------------------------------
DECAYED = r"e^{-\int\Gamma'} η"
#: columns of the table along time: panel, axis
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


def least_errors(errors: pd.Series) -> list[str]:
    """Return the methods that tie for the least error, smallest first: all within a factor of it or at round-off."""
    errors = errors.dropna().sort_values(kind="stable")
    return list(errors.index[(errors <= STRUCTURE) | ties(errors, errors.min(), ALIKE)])


def along_time(frame: pd.DataFrame, scene: str) -> Figure | None:
    rows = frame[frame["scene"] == scene]
    drawn: list[str] = []
    panels = []
    for column, (title, label) in ALONG_TIME.items():
        if rows[column].notna().any():
            curves = by_method(rows, "t", column)
            drawn = drawn or choose(curves, lambda curve, _: -max(curve.y))
            panels.append(Panel(title, Axis("t"), Axis(label, "log"), only(curves, drawn), (ROUND_OFF,)))
    worst = rows.groupby("method")["energy_deviation"].max()
    first = least_errors(worst)
    first.sort(key=lambda method: method not in drawn)
    deviation = worst[first].max()
    least = power(10.0 ** math.ceil(math.log10(deviation))) if deviation > 0 else "0"
    known: dict[str, Any] = {"scene": scene, "settings": ", ".join(dict.fromkeys(rows["setting"]))}
    closest = names(first, sum(method in drawn for method in first))
    return chart(
        "along_time", panels, f"laws_{scene}", alike=ALIKE, methods=closest, deviation=least, **known
    )
