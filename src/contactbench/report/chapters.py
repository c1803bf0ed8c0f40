"""Chapters: each answers one question from the tables, in one line and then in views and figures.

markdown.py writes every part the same way and knows no question, no table and no method.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import files
from typing import Any

import pandas as pd

from contactbench.registry import Registry, import_modules
from contactbench.report.drawing import Figure, Panel
from contactbench.report.views import Show, View

#: table name → its rows
Frames = Mapping[str, pd.DataFrame]


class Tables(dict[str, pd.DataFrame]):
    """Tables by name, told apart by identity: what several chapters need of them is computed once (`functools`)."""

    __hash__ = object.__hash__  # type: ignore[assignment]


@dataclass(frozen=True)
class Text:
    """A paragraph, or a list where `items` is given (body: what stands before it, may be empty)."""

    body: str = ""
    items: tuple[str, ...] = ()


@dataclass(frozen=True)
class Fold:
    """Python code behind a line that opens it."""

    title: str
    code: str


@dataclass(frozen=True)
class Section:
    title: str
    parts: tuple[Part | None, ...]


Part = Text | View | Figure | Fold | Section


@dataclass(frozen=True)
class Answer:
    """A line of a summary.

    count : of how many rows it is true; inline Markdown, as `View.legend`.  queries : the lines of pandas that count.
    """

    question: str
    answer: str
    count: str
    queries: tuple[str, ...] = ()


@dataclass(frozen=True)
class Chapter:
    """One question.

    name : its own.  document : its place is DOCUMENT.md, by default NAME.md; the first of a document gives its title.
    title : its heading.  question : in one line.  order : its place.
    tables : the tables it reads; it has something to say when the first has rows.
    parts(frames) : its views, figures, texts and sections; views without rows, empty sections and None are left out.
    answers(frames) : its summary, a line or a few.
    """

    name: str
    title: str
    question: str
    order: int
    tables: tuple[str, ...]
    parts: Callable[[Frames], Iterable[Part | None]]
    answers: Callable[[Frames], Iterable[Answer]] = lambda frames: ()
    document: str = ""

    @property
    def file(self) -> str:
        return f"{self.document or self.name}.md"

    @lru_cache(64)  # noqa: B019 - a chapter lives as long as the process, and the story shows figures of others
    def fill(self, frames: Frames) -> tuple[Part, ...]:
        return tuple(shown(self.parts(frames)))


CHAPTERS = Registry("chapter", Chapter)


#: where the questions are
QUESTIONS = "contactbench.questions"


# -- the chapters of this package: their prose is data -------------------------------------------------
PROSE: dict[str, dict[str, Any]] = tomllib.loads(
    files(QUESTIONS).joinpath("chapters.toml").read_text(encoding="utf-8")
)
#: the entries of all chapters, by name
VIEWS, CHARTS = (
    {name: entry for own in PROSE.values() for name, entry in own.get(kind, {}).items()}
    for kind in ("views", "charts")
)

type Parts = Callable[[Frames], Iterable[Part | None]]


def chapter(
    name: str, answers: Callable[[Frames], Iterable[Answer]] = lambda frames: ()
) -> Callable[[Parts], Parts]:
    """Return a decorator that registers the parts of a chapter of chapters.toml."""

    def register(parts: Parts) -> Parts:
        title, question, order, tables = (PROSE[name][f] for f in ("title", "question", "order", "tables"))
        document = PROSE[name].get("document", "")
        CHAPTERS.add(Chapter(name, title, question, order, tuple(tables), parts, answers, document))
        return parts

    return register


def view(name: str, frame: pd.DataFrame, show: Mapping[str, Show] | None = None, **values: object) -> View:
    """Return a table to read with the title and legend of chapters.toml, `values` filled into the legend."""
    prose = VIEWS[name]
    return View(name, prose["title"], frame, filled(prose, "legend", values), show or {})


def chart(
    prose: str, panels: Iterable[Panel], name: str = "", across: int = 2, **values: object
) -> Figure | None:
    """Return a figure with the title and caption of chapters.toml, `values` filled in; None without panels.

    name : of the figure, where it is one of several with the same prose.
    """
    title, caption = (filled(CHARTS[prose], part, values) for part in ("title", "caption"))
    drawn = tuple(panels)
    return Figure(name or prose, title, drawn, caption, across) if drawn else None


def filled(prose: Mapping[str, str], part: str, values: Mapping[str, object]) -> str:
    return " ".join(prose.get(part, "").split()).format(**values)


def shown(parts: Iterable[Part | None]) -> Iterator[Part]:
    for part in parts:
        if isinstance(part, Section):
            part = replace(part, parts=tuple(shown(part.parts)))
            if part.parts:
                yield part
        elif part is not None and not (isinstance(part, View) and not part.rows):
            yield part


def discovered() -> dict[str, Chapter]:
    """Return every chapter; the modules of this package are imported for it."""
    import_modules(QUESTIONS, without=("write",))  # these need matplotlib, which takes long to load
    return CHAPTERS


def chapters(frames: Frames) -> list[Chapter]:
    return sorted((c for c in discovered().values() if len(frames[c.tables[0]])), key=lambda c: c.order)


def every[P: Part](kind: type[P], parts: Iterable[Part | None]) -> Iterator[P]:
    for part in parts:
        if isinstance(part, Section):
            yield from every(kind, part.parts)
        elif isinstance(part, kind):
            yield part
