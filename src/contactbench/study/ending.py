"""Print the summary of a benchmark run: answers, changes since the last commit, and the documents to read."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from pathlib import Path

from contactbench.errors import BadInput, one_line
from contactbench.gate import revisions
from contactbench.gate.compare import compare_folders
from contactbench.questions import mission, write

WIDTH = 100
MOST_CHANGES_SHOWN = 12
NO_MARKDOWN = str.maketrans("", "", "`*")


def ending(results: Path) -> str:
    """Return the answers of a folder of tables, the changes since the last commit, and the documents, as text."""
    return "\n".join([*answers(results), "", *moved(results), "", *documents(results)])


def answers(results: Path) -> Iterator[str]:
    frames = write.tables(results)
    runs = frames["runs"]
    yield f"Of {runs['method'].nunique()} methods on {runs['scene'].nunique()} scenes:"
    for answer in mission.answers(frames):
        yield textwrap.fill(answer.question.translate(NO_MARKDOWN), WIDTH)
        found = f"{answer.answer}: {answer.count}".translate(NO_MARKDOWN)
        yield textwrap.fill(
            found, WIDTH, initial_indent="    ", subsequent_indent="    ", break_on_hyphens=False
        )


def moved(results: Path) -> Iterator[str]:
    """Yield the differences between the committed tables and these; times are not compared."""
    try:
        root = revisions.repository(results).resolve()
        with revisions.checkout(root, revisions.base(root, "HEAD")) as tree:
            found = compare_folders(revisions.inside(tree, root, results.resolve()), results).moved
    except (BadInput, OSError, ValueError) as why:
        yield f"Not compared with the tables before it: {one_line(why)}"
        return
    count = f"{len(found)} measure{'s' * (len(found) > 1)} moved" if len(found) else "nothing moved"
    yield f"Against the committed tables, clocks aside: {count}."
    for _, row in found.head(MOST_CHANGES_SHOWN).iterrows():
        where = " ".join(filter(None, (row["table"], row["scene"], row["method"], row["setting"])))
        yield f"    {where}: {row['measure']} {row['before']} → {row['after']} ({row['rows']} rows)"
    if (more := len(found) - MOST_CHANGES_SHOWN) > 0:
        yield f"    … and {more} more: contactbench gate --only accuracy"


def documents(results: Path) -> Iterator[str]:
    if (results / "README.md").exists():
        yield f"{results / 'README.md'}: all tables"
