"""The glossary: methods, scenes and columns, from what their registries say of themselves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from contactbench.measure.ladder import stepping
from contactbench.report.cells import Head, View, word
from contactbench.report.numbers import upper
from contactbench.report.rooms import Part, Section
from contactbench.results.schema import TABLES

#: one who asks for the glossary hands over the registries: the report itself knows no solvers
Registries = Mapping[str, Mapping[str, Any]]


def methods_view(methods: Mapping[str, Any]) -> View:
    rows = tuple(
        (
            word(name), word(item.family), word(item.order or "variable"),
            word(stepping(item)), word(", ".join(item.engines)), word(item.about),
        )
        for name, item in methods.items()
    )  # fmt: skip
    heads = tuple(
        Head(label, words=True) for label in ("method", "family", "order", "steps", "engines", "what it is")
    )
    meaning = (
        "Family: *contact*, a composition of exact contact flows; *variational*, from a discrete "
        "action; *established*, "
        "a solver in use. The engine is what runs it."
    )
    return View("methods", "Methods", meaning, heads, rows)


def named_view(name: str, title: str, entries: Iterable[tuple[str, str]]) -> View:
    heads = (Head("name", words=True), Head("what it is", words=True))
    return View(name, title, "", heads, tuple((word(key), word(about)) for key, about in entries))


def columns_view(name: str) -> View:
    table = TABLES[name]
    about = upper(table.about)
    rows = tuple(
        (word(f"`{c}`"), word(column.type), word(column.meaning)) for c, column in table.columns.items()
    )
    heads = (Head("column", words=True), Head("type", words=True), Head("meaning", words=True))
    return View(f"columns_{name}", f"{name}.csv", f"{about}.", heads, rows, f"{name}.csv")


def sections(registries: Registries) -> list[Part]:
    parts: list[Part] = []
    if "methods" in registries:
        parts.append(methods_view(registries["methods"]))
    if "scenes" in registries:
        parts.append(named_view("scenes", "Scenes", ((n, s.about) for n, s in registries["scenes"].items())))
    parts.append(Section("Columns", tuple(columns_view(name) for name in TABLES)))
    return parts
