"""The glossary: methods, scenes and columns, from what their registries say of themselves; and what scenes and
methods were when the tables were made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from contactbench.measure.ladder import stepping
from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part, Section
from contactbench.report.views import View, frame_of
from contactbench.results.schema import TABLES

#: the caller hands over the registries: the report itself knows no solvers
Registries = Mapping[str, Mapping[str, Any]]


def methods_view(methods: Mapping[str, Any]) -> View:
    rows = [
        (name, m.family, str(m.order or "variable"), stepping(m), ", ".join(m.engines), m.about)
        for name, m in methods.items()
    ]
    labels = ["method", "family", "order", "steps", "engines", "what it is"]
    return View("methods", "Methods", frame_of(rows, labels))


def scenes_view(scenes: Mapping[str, Any]) -> View:
    rows = [(name, scene.about) for name, scene in scenes.items()]
    return View("scenes", "Scenes", frame_of(rows, ["name", "what it is"]))


def columns_view(name: str) -> View:
    table = TABLES[name]
    rows = [(f"`{label}`", column.type, column.meaning) for label, column in table.columns.items()]
    about = f"{table.about[:1].upper()}{table.about[1:]}."
    return View(f"columns_{name}", f"{name}.csv", frame_of(rows, ["column", "type", "meaning"]), about)


REGISTERED = {"methods": methods_view, "scenes": scenes_view}


def glossary(registries: Registries) -> tuple[Part, ...]:
    """Return methods, scenes and columns."""
    known = [view(registries[name]) for name, view in REGISTERED.items() if name in registries]
    return *known, Section("Columns", tuple(columns_view(name) for name in TABLES))


# -- the chapter of definitions ----------------------------------------------------------------------
def definitions_view(frame: pd.DataFrame, kind: str) -> View:
    own = frame[frame[kind].fillna("") != ""]
    code = {name: "`" + own[name] + "`" for name in ("digest", "declared")}
    legend = "Declared, and a digest of what it does, in 50-digit arithmetic: the same on every machine."
    table = pd.DataFrame({kind: own[kind], **code})
    return View(f"defined_{kind}s", f"{kind.capitalize()}s", table, legend, "definitions.csv")


def parts(frames: Frames) -> list[Part]:
    return [definitions_view(frames["definitions"], kind) for kind in ("scene", "method")]


QUESTION = "What was every scene and method when the tables were made?"
CHAPTERS.add(Chapter("definitions", "Definitions", QUESTION, 85, ("definitions",), parts))
