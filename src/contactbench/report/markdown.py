"""Markdown: rooms written down as documents.  It knows no question and no table."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence

from contactbench.report.cells import Cell, Head, Mark, View
from contactbench.report.drawing import Figure
from contactbench.report.rooms import Finding, Part, Room, Section, Text, spoken

#: marks that are seen in a document
STRONG = (Mark.best, Mark.kept)
SLANTED = (Mark.tie,)
FLAGGED = (Mark.exception,)
#: a longer cell is not worth lining its column up for
PADDED = 40
#: columns in a table; groups of columns that would make it wider are written one below the other
WIDEST = 14


def without_html(text: str) -> str:
    """Inline Markdown in which nothing is HTML: what tables say is a user's, or anybody's."""
    parts = re.split(r"(`[^`]*`)", text)  # code is shown as it is
    return "".join(part if i % 2 else part.replace("<", "&lt;") for i, part in enumerate(parts))


def escaped(text: str) -> str:
    """Inline Markdown that stays in its cell or entry: one line, no column ends in it, no HTML."""
    return " ".join(without_html(text).replace("|", "\\|").split())


def grid(header: Iterable[str], rows: Iterable[Iterable[object]], words: Iterable[bool] = ()) -> str:
    """A GitHub table; the first column and columns of words left, the others right aligned.

    Columns are padded to line up in the source unless a cell is longer than PADDED.
    """
    lines = [list(header), *([str(cell) for cell in row] for row in rows)]
    left = [i == 0 or word for i, word in enumerate([*words, *[False] * len(lines[0])][: len(lines[0])])]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    widths = [width if width <= PADDED else 0 for width in widths]
    rule = [f":{'-' * (w + 1)}" if l else f"{'-' * (w + 1)}:" for w, l in zip(widths, left, strict=True)]

    def written(line: list[str]) -> str:
        cells = (c.ljust(w) if l else c.rjust(w) for c, w, l in zip(line, widths, left, strict=True))
        return f"| {' | '.join(cells)} |"

    return "\n".join([written(lines[0]), f"|{'|'.join(rule)}|", *map(written, lines[1:])])


def cell(item: Cell) -> str:
    """The text as its marks say: bold what is best or kept, slanted a tie, ! an exception."""
    text = escaped(item.text)
    if not text:
        return ""
    if item.link:
        text = f"[{text}]({item.link})"
    if item.marks & set(FLAGGED):
        text += " !"
    if item.marks & set(STRONG) and "**" not in text:
        return f"**{text}**"
    if item.marks & set(SLANTED):
        return f"*{text}*"
    return text


def label(head: Head, grouped: bool) -> str:
    named = f"{head.group}: {head.label}" if grouped and head.group else head.label
    return escaped(named)


def table(columns: Sequence[Head], rows: Sequence[Sequence[Cell]]) -> str:
    return grid(
        (label(h, True) for h in columns), (map(cell, row) for row in rows), (h.words for h in columns)
    )


def split(view: View) -> list[list[int]]:
    """Indices of columns, one list per table: those without a group in each, groups as they fit."""
    own = [i for i, h in enumerate(view.columns) if not h.group]
    groups: dict[str, list[int]] = {}
    for i, head in enumerate(view.columns):
        if head.group:
            groups.setdefault(head.group, []).append(i)
    if len(view.columns) <= WIDEST or len(groups) < 2:
        return [list(range(len(view.columns)))]
    tables: list[list[int]] = []
    for indices in groups.values():
        if tables and len(own) + len(tables[-1]) + len(indices) <= WIDEST:
            tables[-1] += indices
        else:
            tables.append(list(indices))
    return [[own[0], *indices] if n else [*own, *indices] for n, indices in enumerate(tables)]


def view(item: View, depth: int) -> str:
    if item.detail:
        said = without_html(item.meaning)
        return f"{heading(item.title, depth)}\n\nIn [{item.source}]({item.source}). {said}"
    parts = [heading(item.title, depth)]
    if item.meaning:
        parts.append(without_html(item.meaning))
    if not item.rows:
        return "\n\n".join([*parts, "None."])
    for indices in split(item):
        parts.append(
            table([item.columns[i] for i in indices], [[row[i] for i in indices] for row in item.rows])
        )
    return "\n\n".join(parts)


def text(item: Text, depth: int = 0) -> str:
    lines = "\n".join(f"- {' '.join(without_html(entry).split())}" for entry in item.items)
    return "\n\n".join(filter(None, [without_html(item.body), lines]))


def figure(item: Figure, depth: int) -> str:
    shown = f"![{escaped(item.title)}](figures/{item.name}.svg)"
    return f"{shown}\n\n{without_html(item.caption)}" if item.caption else shown


def section(item: Section, depth: int) -> str:
    return "\n\n".join([heading(item.title, depth), parts(item.parts, depth + 1)])


def heading(title: str, depth: int) -> str:
    return f"{'#' * min(depth, 6)} {' '.join(without_html(title).split())}"


WRITERS: dict[type, Callable[..., str]] = {Section: section, View: view, Text: text, Figure: figure}


def parts(items: Iterable[Part], depth: int = 2) -> str:
    """Parts one below the other; headings from `depth` down."""
    return "\n\n".join(filter(None, (WRITERS[type(item)](item, depth) for item in items)))


def document(room: Room, items: Iterable[Part], found: Sequence[Finding] = ()) -> str:
    """Title, what was found, the parts."""
    said = parts([spoken(found)]) if found else ""
    return "\n\n".join(filter(None, [f"# {room.title}", said, parts(items)])) + "\n"
