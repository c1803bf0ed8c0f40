"""Chapters: each answers one question from the tables, in one line and then in views and figures.

A renderer (markdown.py, page/) writes every part the same way and knows no question, no table and no method.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import cast

import pandas as pd

from contactbench.errors import Registry
from contactbench.report.drawing import Figure
from contactbench.report.views import View

#: table name → its rows
Frames = Mapping[str, pd.DataFrame]


class Tables(dict[str, pd.DataFrame]):
    """Frames that remember what chapters have computed from them."""

    def __init__(self, frames: Frames) -> None:
        super().__init__(frames)
        self.computed: dict[Callable[[Frames], object], object] = {}


def once[T](compute: Callable[[Frames], T], frames: Frames) -> T:
    """Return ``compute(frames)``, computed when the first of several chapters asks for it."""
    if not isinstance(frames, Tables):
        return compute(frames)
    if compute not in frames.computed:
        frames.computed[compute] = compute(frames)
    return cast(T, frames.computed[compute])


@dataclass(frozen=True)
class Text:
    """A paragraph, or a list where `items` is given (body: what stands before it, may be empty)."""

    body: str = ""
    items: tuple[str, ...] = ()


@dataclass(frozen=True)
class Section:
    """Parts under a heading.

    choice : neighbouring sections with the same choice ("scene") are alternatives: a page may show one at a time; a
        document writes one after the other.
    """

    title: str
    parts: tuple[Part, ...]
    choice: str = ""


Part = Text | View | Figure | Section

#: columns of a summary
QUESTION, ANSWER, COUNT = "question", "answer", "count"


def summary(*rows: tuple[str, str, str]) -> pd.DataFrame:
    """Return questions, their answers and their counts as a frame."""
    return pd.DataFrame(list(rows), columns=[QUESTION, ANSWER, COUNT])


@dataclass(frozen=True)
class Chapter:
    """One question.

    name : its document is NAME.md.  title : its heading.  question : in one line.  order : its place.
    tables : the tables it reads; it has something to say when the first has rows.
    parts(frames) : its views, figures, texts and sections.
    summary(frames) : a frame of QUESTION, ANSWER and COUNT, a line or a few.
    """

    name: str
    title: str
    question: str
    order: int
    tables: tuple[str, ...]
    parts: Callable[[Frames], Sequence[Part]]
    summary: Callable[[Frames], pd.DataFrame] = field(default=lambda frames: summary())
    document: str = ""

    @property
    def file(self) -> str:
        """The name of its document."""
        return self.document or f"{self.name}.md"


CHAPTERS = Registry("chapter", Chapter)


@dataclass(frozen=True)
class Contents:
    """A chapter as the tables fill it: what renderers are handed."""

    chapter: Chapter
    summary: pd.DataFrame
    parts: tuple[Part, ...]


def chapters(frames: Frames) -> list[Chapter]:
    """Return the chapters that have something to say, in their order."""
    return sorted((c for c in CHAPTERS.values() if len(frames[c.tables[0]])), key=lambda c: c.order)


def contents(frames: Frames) -> list[Contents]:
    """Return every chapter that has something to say, filled."""
    return [
        Contents(chapter, once(chapter.summary, frames), tuple(chapter.parts(frames)))
        for chapter in chapters(frames)
    ]


def figures(parts: Iterable[Part]) -> Iterable[Figure]:
    """Yield every figure of some parts, nested ones included."""
    for part in parts:
        if isinstance(part, Section):
            yield from figures(part.parts)
        elif isinstance(part, Figure):
            yield part


def slug(title: str) -> str:
    """Return the anchor that GitHub gives a heading."""
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
