"""Documents and figures from the tables of a folder alone, and whether the committed ones agree with them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from contactbench.errors import BadInput
from contactbench.files import replacing
from contactbench.questions import mission, which
from contactbench.questions.answers import fold
from contactbench.report import draw, markdown
from contactbench.report.chapters import (
    Chapter,
    Frames,
    Part,
    Section,
    Tables,
    Text,
    chapters,
    discovered,
    every,
    shown,
)
from contactbench.report.drawing import Figure
from contactbench.report.views import View, frame_of
from contactbench.tables.provenance import runs
from contactbench.tables.schema import TABLES
from contactbench.tables.store import read

#: the caller hands over the registries: the report itself knows no solvers
Registries = Mapping[str, Mapping[str, Any]]
README_PART = ("<!-- computed from results/: begin -->\n", "<!-- computed from results/: end -->")
#: largest shift, in points, between drawings that count as the same
APART = 0.11
NAME = re.compile(r"\b[a-z]+[0-9a-f]{10}\b")
NUMBER = re.compile(r"(?<![\w#.])[-+]?\d+\.?\d*(?:e[-+]?\d+)?")
#: a sentence that is a link into this project's documents
TO_DOCS = re.compile(r"\s?\[[^\]]+\]\(\.\./docs/[^)]*\)\.?")


def tables(results: Path) -> Tables:
    """Return every table of a folder, those included that modules of this package declare."""
    discovered()
    return as_of(results, tuple(path.stat().st_mtime_ns for path in sorted(results.glob("*.csv"))))


@lru_cache(1)
def as_of(results: Path, written: tuple[int, ...]) -> Tables:
    """Return the tables that were written at these times: the end of a run asks for those of its report again."""
    return Tables({name: read(table, results) for name, table in TABLES.items()})


def documents(results: Path, registries: Registries, readme: Path | None) -> dict[Path, str]:
    """Return the texts of documents and figures by their paths."""
    frames, pages, drawn = tables(results), dict[str, str](), dict[str, Figure]()
    for file, own in groupby(chapters(frames), key=lambda chapter: chapter.file):
        first, *others = own
        answers = list(first.answers(frames))
        parts: list[Part] = [*first.fill(frames)]
        parts += [Section(one.title, chapter_parts(one, frames)) for one in others]
        drawn |= {figure.name: figure for figure in every(Figure, parts)}
        if first.name == mission.NAME:
            parts.append(mission.machine(runs(results)))
        if first.name == mission.NAME:  # its answers stand in the steps of the story
            pages[file] = markdown.document(first.title, (), shown([*parts, fold(answers)]))
        else:
            pages[file] = markdown.document(first.title, answers, shown([fold(answers), *parts]))
    pages["glossary.md"] = markdown.document("Glossary", (), glossary(registries))
    if not (results.parent / "docs" / "reading.md").exists():  # as in a repository of one's own
        pages = {name: TO_DOCS.sub("", text) for name, text in pages.items()}
    pages |= {f"figures/{name}.svg": draw.svg(figure) for name, figure in drawn.items()}
    paths = {results / name: text for name, text in pages.items()}
    return paths | ({readme: with_answers(readme, frames, results.name)} if readme else {})


def chapter_parts(chapter: Chapter, frames: Frames) -> tuple[Part, ...]:
    """Return a chapter as a section of another's document."""
    answers = list(chapter.answers(frames))
    summary = Text(markdown.answers(answers)) if answers else None
    return tuple(shown([summary, fold(answers), *chapter.fill(frames)]))


def with_answers(readme: Path, frames: Frames, results: str) -> str:
    around = computed_part(readme)
    if around is None:
        begin, end = README_PART
        raise BadInput(f"{readme}: needs the lines {begin.strip()!r} and {end!r}, once each")
    table = mission.overview(frames)
    found = [markdown.parts(shown([table]))]
    lines = [f"{mission.line(answer)} [→]({results}/{file})" for file, answer in mission.findings(frames)]
    found += [
        markdown.text(Text(items=tuple(lines)), 2),
        markdown.parts(shown([which.systems_view(frames)]), 3),
    ]
    return "\n".join([around[0], "\n\n".join(filter(None, found)), "", around[1]])


def computed_part(readme: Path) -> tuple[str, str] | None:
    """Return what stands before and after the part of a file that is computed; None where it has none."""
    text, (begin, end) = readme.read_text(encoding="utf-8") if readme.exists() else "", README_PART
    if text.count(begin) != 1 or text.count(end) != 1:
        return None
    return text.partition(begin)[0] + begin, end + text.partition(end)[2]


def report(results: Path, registries: Registries, readme: Path | None = None) -> list[Path]:
    """Write every document and figure the tables allow, remove other figures of a report, and return the paths.

    readme : a file whose computed part is filled in too.
    """
    texts = documents(results, registries, readme)
    (results / "figures").mkdir(exist_ok=True)
    for path, text in texts.items():
        with replacing(path) as file:
            file.write(text)
    for path in (results / "figures").glob("*.svg"):
        if path not in texts and draw.MADE_HERE in path.read_text(encoding="utf-8"):
            path.unlink()
    return [*texts]


# -- the glossary: what the registries say of methods, scenes and columns ----------------------------
def glossary(registries: Registries) -> tuple[Part, ...]:
    methods = [
        (name, m.family, str(m.order or "variable"), m.stepping, ", ".join(m.engines), m.about)
        for name, m in registries["methods"].items()
    ]
    labels = ["method", "family", "order", "steps", "engines", "what it is"]
    scenes = [(name, scene.about) for name, scene in registries["scenes"].items()]
    return (
        View("methods", "Methods", frame_of(methods, labels)),
        View("scenes", "Scenes", frame_of(scenes, ["name", "what it is"])),
        Section("Columns", tuple(columns_view(name) for name in TABLES)),
    )


def columns_view(name: str) -> View:
    table = TABLES[name]
    rows = [(f"`{label}`", column.type, column.meaning) for label, column in table.columns.items()]
    about = f"{table.about[:1].upper()}{table.about[1:]}."
    return View(f"columns_{name}", f"{name}.csv", frame_of(rows, ["column", "type", "meaning"]), about)


# -- do the committed documents and figures say what the committed tables say? -----------------------
def differing(results: Path, readme: Path | None, registries: Registries) -> list[str]:
    wanted = documents(results, registries, readme)
    lines = []
    for path, text in wanted.items():
        if not path.exists():
            lines.append(f"{path}: missing")
        elif not same(path.read_text(encoding="utf-8"), text, path.suffix == ".svg"):
            lines.append(f"{path}: not what the tables say")
    there = {path for pattern in ("*.md", "figures/*.svg") for path in results.glob(pattern)}
    return lines + [f"{path}: no table gives it" for path in sorted(there - wanted.keys())]


def same(one: str, other: str, drawn: bool) -> bool:
    """Return whether two texts are the same; in drawings coordinates may differ by `APART`."""
    if one == other or not drawn:
        return one == other
    (words, numbers), (other_words, other_numbers) = split(one), split(other)
    return words == other_words and bool(np.allclose(numbers, other_numbers, rtol=0, atol=APART))


def split(drawing: str) -> tuple[list[str], list[float]]:
    # paths that are defined once and used again have names by content; here they have numbers in order
    names: dict[str, str] = {}
    text = NAME.sub(lambda name: names.setdefault(name[0], f"name {len(names)}"), drawing)
    return NUMBER.split(text), [float(number) for number in NUMBER.findall(text)]
