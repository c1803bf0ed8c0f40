"""Laws: who keeps which law of the motion, where one is broken, and all of them at equal cost."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
import pandas as pd

from contactbench.questions.answers import share
from contactbench.questions.contest import CONTACT
from contactbench.questions.judgement import SAVED, at_cost, law_label, law_rows, met_cost, structural_laws
from contactbench.questions.orders import order_of
from contactbench.report.chapters import PROSE, Answer, Frames, Part, chapter, chart, view
from contactbench.report.curves import ROUND_OFF, above, floats
from contactbench.report.drawing import Axis, Curve, Figure, Panel
from contactbench.report.look import look
from contactbench.report.numbers import count, names, scientific
from contactbench.report.views import Mark, Show, View, as_cell, frame_of, matrix
from contactbench.solution import EXACT
from contactbench.tables.declared import RUNS

#: the scenes of the mission
SCENES: list[str] = PROSE["README"]["scenes"]
KEPT = "runs[(runs.status == 'ok') & runs.{0}_claimed].{0}_kept"


@lru_cache(2)
def structural_rows(frames: Frames) -> pd.DataFrame:
    return pd.concat([law_rows(frames["runs"], law) for law in structural_laws()], ignore_index=True)


def kept(frames: Frames, law: str, question: str) -> Answer | None:
    query = KEPT.format(law)
    return share(frames, question, "decided runs", f"{query}.dropna()", idle=f"{query}.isna()")


def answers(frames: Frames) -> Iterator[Answer]:
    for law in structural_laws():
        if answer := kept(frames, law, f"{law_label(law)}: at round-off wherever a method claims it?"):
            yield answer


# -- who keeps what --------------------------------------------------------------------------------
def counts(rows: pd.DataFrame) -> str:
    idle = {"undecided": int(rows["undecided"].sum()), "not judged": int((~rows["judged"]).sum())}
    beside = ", ".join(f"{number} {word}" for word, number in idle.items() if number)
    decided = int((rows["judged"] & ~rows["undecided"]).sum())
    return f"{int(rows['kept'].sum())} of {decided}" + (f" ({beside})" if beside else "")


def claims_view(rows: pd.DataFrame) -> View:
    contact = rows["family"].eq(CONTACT)
    groups = contact.map({True: "contact methods, not claimed", False: "others, not claimed"})
    rows = rows.assign(who=groups.where(~rows["claimed"], "claimed"), label=rows["law"].map(law_label))
    rows = rows.sort_values("claimed", ascending=False, kind="stable")
    rows = rows.rename(columns={"label": "law or drift"})
    return view("law_claims", matrix(rows, "law or drift", "who", counts))


def broken_view(rows: pd.DataFrame) -> View:
    lines = []
    broken = rows[rows["claimed"] & rows["broken"]]
    for (law, scene), own in broken.groupby(["law", "scene"], sort=False):
        worst, methods = own.loc[own["value"].idxmax()], names(list(dict.fromkeys(own["method"])), 3)
        setting = f"{worst['method']}, {worst['control']}={worst['setting']:.3g}"
        lines.append(
            (law_label(law), f"`{scene}`", methods, len(own), worst["value"], worst["bound"], setting)
        )
    labels = ["law or drift", "scene", "methods", "runs", "deviation", "round-off", "worst"]
    show: dict[str, Show] = {"deviation": scientific, "round-off": scientific}
    return view("law_exceptions", frame_of(lines, labels), show)


# -- at equal cost ---------------------------------------------------------------------------------
def laws_on(rows: pd.DataFrame) -> list[str]:
    """Return the laws that a table at equal cost shows: those of the map where claimed, the others where measured."""
    of_the_map = structural_laws()
    others = [law for law, column in RUNS.columns.items() if column.label and law not in of_the_map]
    shown = [law for law in others if rows[law].notna().any()]
    return shown + [law for law in of_the_map if rows[f"{law}_claimed"].any()]


def equal_cost_view(frames: Frames, scene: str) -> View | None:
    rows = frames["runs"]
    rows = rows[(rows["scene"] == scene) & (rows["saved"] == SAVED)]
    if not (rows["status"] == "ok").any():
        return None
    cost, laws, lines = met_cost(rows), laws_on(rows), []
    for method, own in rows.groupby("method", sort=False):
        if (found := at_cost(own, cost, ["error", *laws])) is not None:
            spent = "any" if EXACT in set(own["control"]) else count(found["evaluations"])
            marks = [Mark.kept if found.get(f"{law}_kept") else None for law in laws]
            drifts = [as_cell(found[law], scientific, mark) for law, mark in zip(laws, marks, strict=True)]
            order = order_of(frames, scene, str(method))
            lines.append((method, spent, order, as_cell(found["error"], scientific), *drifts))
    labels = ["method", "evaluations", "order", "error", *map(law_label, laws)]
    title, legend = f"{scene}: at {count(cost)} evaluations", PROSE["laws"]["equal"]
    return View(f"equal_cost_{scene}", title, frame_of(lines, labels), legend)


@chapter("laws", answers)
def parts(frames: Frames) -> list[Part | None]:
    rows = structural_rows(frames)
    equal = [equal_cost_view(frames, scene) for scene in SCENES]
    return [claims_view(rows), broken_view(rows), structure(frames["runs"]), *equal]


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
    groups = np.where(rows["family"].eq(CONTACT) & ~claims, "contact, steps that follow the motion", families)
    curves = []
    for name, own in rows.groupby(groups, sort=False):
        points = floats(own["error"]), above(own[LAW])
        curves.append(Curve(*points, str(name), str(own["method"].iloc[0]), line=False))
    x = Axis("error of the solution (more accurate to the right)", "log", inverted=True)
    panel = Panel("", x, Axis("relative deviation of the contact form", "log"), tuple(curves), (ROUND_OFF,))
    return chart("structure", [panel], kept=int(kept.sum()), runs=len(kept), scene=SCENE)
