"""What a room hands to the renderers: views, figures, texts and findings as data.

A room answers one question (convergence, laws, …): it reads frames of the result tables and hands over
a sequence of parts.  A renderer (markdown.py, draw.py, page/) writes every part down the same way and
knows no question, no table and no method.

Texts (`Text.body`, `View.meaning`, `Figure.caption`, `Finding.sentence`, exceptions, cell texts) are inline
Markdown of four kinds only: `code`, **strong**, *emphasis* and [text](address).  An address is a file name
relative to results/, or #anchor inside the document.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import cast

import pandas as pd

from contactbench.errors import Registry
from contactbench.report.cells import View
from contactbench.report.drawing import Figure

#: table name → its rows
Frames = Mapping[str, pd.DataFrame]


class Tables(dict[str, pd.DataFrame]):
    """Frames that remember what rooms have computed of them."""

    def __init__(self, frames: Frames) -> None:
        super().__init__(frames)
        self.known: dict[Callable[[Frames], object], object] = {}


def once[T](compute: Callable[[Frames], T], frames: Frames) -> T:
    """``compute(frames)``, the first time that one of several rooms asks for it."""
    if not isinstance(frames, Tables):
        return compute(frames)
    if compute not in frames.known:
        frames.known[compute] = compute(frames)
    return cast(T, frames.known[compute])


@dataclass(frozen=True)
class Text:
    """A paragraph, or a list where `items` is given (body: what stands before it, may be empty)."""

    body: str = ""
    items: tuple[str, ...] = ()


@dataclass(frozen=True)
class Finding:
    """A computed sentence: what it says, over what, and its exceptions with their cause.

    title : in a word or two ("Structure").  covers : rows, scenes and methods it was computed over.
    """

    name: str
    title: str
    sentence: str
    covers: str
    exceptions: tuple[str, ...] = ()


def spoken(found: Iterable[Finding], elsewhere: str = "") -> Text:
    """Findings as a list: sentence, exceptions, what it covers.  elsewhere : address of the exceptions, if not here."""
    items = []
    for finding in found:
        said = f"**{finding.title}.** {finding.sentence}"
        if finding.exceptions:
            told = (
                f"[Exceptions]({elsewhere})" if elsewhere else f"Exceptions: {'; '.join(finding.exceptions)}"
            )
            said += f" {told}."
        items.append(f"{said} *({finding.covers}.)*")
    return Text(items=tuple(items))


@dataclass(frozen=True)
class Section:
    """Parts under a heading.

    choice : neighbouring sections with the same choice ("scene") are alternatives: a page may show one
        at a time; a document writes one after the other.
    anchor : to be linked to; by default made of the title.
    """

    title: str
    parts: tuple[Part, ...]
    choice: str = ""
    anchor: str = ""

    @property
    def address(self) -> str:
        return self.anchor or slug(self.title)


Part = Text | View | Figure | Section


@dataclass(frozen=True)
class Room:
    """One question.

    name : its document is NAME.md (README.md for the headline).  about : a line for the list of documents.
    tables : what it reads; it has something to say when the first has rows.
    order : its place.
    tab : its title in a word, for a row of links.
    sections(frames) : its parts.  findings(frames) : its computed sentences, for itself and the headline.
    """

    name: str
    title: str
    about: str
    order: int
    tables: tuple[str, ...]
    sections: Callable[[Frames], Sequence[Part]]
    findings: Callable[[Frames], Sequence[Finding]] = field(default=lambda frames: ())
    document: str = ""
    tab: str = ""

    @property
    def file(self) -> str:
        return self.document or f"{self.name}.md"

    def speaks(self, frames: Frames) -> bool:
        """Whether there is anything to say."""
        return bool(len(frames[self.tables[0]]))


ROOMS = Registry("room", Room)


def rooms(frames: Frames) -> list[Room]:
    """The rooms that have something to say, in their order."""
    return sorted((room for room in ROOMS.values() if room.speaks(frames)), key=lambda room: room.order)


def figures(parts: Iterable[Part]) -> Iterable[Figure]:
    """Every figure of some parts, nested ones included."""
    for part in parts:
        if isinstance(part, Section):
            yield from figures(part.parts)
        elif isinstance(part, Figure):
            yield part


def slug(title: str) -> str:
    """The anchor GitHub gives a heading."""
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
