"""Print the summary of a benchmark run: answers, and the document to read."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from pathlib import Path

from contactbench.questions import mission, write

WIDTH = 100
NO_MARKDOWN = str.maketrans("", "", "`*")


def ending(results: Path) -> str:
    """Return the answers of a folder of tables, and the document to read, as text."""
    read = [f"{results / 'README.md'}: all tables"] * (results / "README.md").exists()
    return "\n".join([*answers(results), "", *read])


def answers(results: Path) -> Iterator[str]:
    frames = write.tables(results)
    runs = frames["runs"]
    yield f"Of {runs['method'].nunique()} methods on {runs['scene'].nunique()} scenes:"
    for answer in mission.answers(frames):
        yield textwrap.fill(answer.question.translate(NO_MARKDOWN), WIDTH)
        found = f"    {answer.answer}: {answer.count}".translate(NO_MARKDOWN)
        yield textwrap.fill(found, WIDTH, subsequent_indent="    ", break_on_hyphens=False)
