"""Markdown: chapters written as documents.  It knows no question and no table."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

from contactbench.report.chapters import Answer, Fold, Part, Section, Text
from contactbench.report.drawing import Figure
from contactbench.report.views import Cell, Mark, View

#: how a mark is written
WRITTEN = {Mark.best: "**{}**", Mark.kept: "**{}**", Mark.tie: "*{}*", Mark.exception: "{} !"}
#: a longer cell is not worth lining its column up for
PADDED = 20


def without_html(text: str) -> str:
    """Return inline Markdown in which nothing is HTML: the texts of tables are a user's, or anybody's."""
    return re.sub(r"`[^`]*`|<", lambda found: "&lt;" if found[0] == "<" else found[0], text)  # code stays


def escaped(text: str) -> str:
    return " ".join(without_html(text).replace("|", "\\|").split())


def grid(header: Iterable[str], rows: Iterable[Iterable[object]], words: Iterable[bool]) -> str:
    """Return a GitHub table, its columns padded to line up in the source unless a cell is longer than PADDED."""
    lines = [list(header), *([str(cell) for cell in row] for row in rows)]
    left = [True, *list(words)[1:]]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    widths = [width if width <= PADDED else 0 for width in widths]
    rule = [f":{'-' * (w + 1)}" if l else f"{'-' * (w + 1)}:" for w, l in zip(widths, left, strict=True)]

    def aligned(line: list[str]) -> str:
        cells = (c.ljust(w) if l else c.rjust(w) for c, w, l in zip(line, widths, left, strict=True))
        return f"| {' | '.join(cells)} |"

    return "\n".join([aligned(lines[0]), f"|{'|'.join(rule)}|", *map(aligned, lines[1:])])


def cell(item: Cell) -> str:
    text = escaped(item.text)
    return WRITTEN[item.mark].format(text) if text and item.mark in WRITTEN else text


def table(item: View) -> str:
    words = [head.words for head in item.columns]
    labels = [escaped(f"{head.group}: {head.label}" if head.group else head.label) for head in item.columns]
    return grid(labels, [map(cell, row) for row in item.rows], words)


def view(item: View, depth: int) -> str:
    title = heading(item.title, depth) if item.title else ""
    return "\n\n".join(filter(None, [title, without_html(item.legend), table(item)]))


def text(item: Text, depth: int) -> str:
    lines = "\n".join(f"- {' '.join(without_html(entry).split())}" for entry in item.items)
    return "\n\n".join(filter(None, [without_html(item.body), lines]))


def figure(item: Figure, depth: int) -> str:
    image = f"![{escaped(item.title)}](figures/{item.name}.svg)"
    return f"{image}\n\n{without_html(item.caption)}" if item.caption else image


def fold(item: Fold, depth: int) -> str:
    return f"<details><summary>{item.title}</summary>\n\n```python\n{item.code}\n```\n\n</details>"


def section(item: Section, depth: int) -> str:
    return "\n\n".join([heading(item.title, depth), parts(item.parts, depth + 1)])


def heading(title: str, depth: int) -> str:
    return f"{'#' * min(depth, 6)} {' '.join(without_html(title).split())}"


WRITERS: dict[type, Callable[..., str]] = {
    Section: section,
    View: view,
    Text: text,
    Figure: figure,
    Fold: fold,
}


def parts(items: Iterable[Part | None], depth: int = 2) -> str:
    return "\n\n".join(filter(None, (WRITERS[type(item)](item, depth) for item in items)))


def answers(items: Iterable[Answer]) -> str:
    rows = [[escaped(text) for text in (item.question, item.answer, item.count)] for item in items]
    return grid(["question", "answer", "count"], rows, [True] * 3) if rows else ""


def document(title: str, summary: Iterable[Answer], items: Iterable[Part | None]) -> str:
    return "\n\n".join(filter(None, [f"# {title}", answers(summary), parts(items)])) + "\n"
