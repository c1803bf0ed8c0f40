"""The glossary: methods, scenes and columns, from what their registries say of themselves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from contactbench.measure.ladder import stepping
from contactbench.report.chapters import Part, Section
from contactbench.report.numbers import upper
from contactbench.report.views import View, frame_of
from contactbench.results.schema import TABLES

#: the caller hands over the registries: the report itself knows no solvers
Registries = Mapping[str, Mapping[str, Any]]


def methods_view(methods: Mapping[str, Any]) -> View:
    rows: list[tuple[object, ...]] = [
        (
            name,
            item.family,
            str(item.order or "variable"),
            stepping(item),
            ", ".join(item.engines),
            item.about,
        )
        for name, item in methods.items()
    ]
    labels = ["method", "family", "order", "steps", "engines", "what it is"]
    return View("methods", "Methods", frame_of(rows, labels))


def scenes_view(scenes: Mapping[str, Any]) -> View:
    frame = pd.DataFrame({"name": list(scenes), "what it is": [scene.about for scene in scenes.values()]})
    return View("scenes", "Scenes", frame)


def columns_view(name: str) -> View:
    columns = TABLES[name].columns.items()
    rows: list[tuple[object, ...]] = [(f"`{c}`", column.type, column.meaning) for c, column in columns]
    frame = frame_of(rows, ["column", "type", "meaning"])
    return View(f"columns_{name}", f"{name}.csv", frame, f"{upper(TABLES[name].about)}.")


def parts(registries: Registries) -> list[Part]:
    """Return methods, scenes and columns."""
    found: list[Part] = []
    if "methods" in registries:
        found.append(methods_view(registries["methods"]))
    if "scenes" in registries:
        found.append(scenes_view(registries["scenes"]))
    return [*found, Section("Columns", tuple(columns_view(name) for name in TABLES))]
