"""How the commands print: a label and a text, wrapped at the width of the terminal."""

from __future__ import annotations

import shutil
import textwrap

#: columns at least that a text has beside its label, and columns where there is no terminal: lines stay whole
NARROWEST, WHOLE = 20, 100_000


def print_item(label: str, text: object, column: int) -> None:
    """Print a label and its text, which begins at a column and goes on there; words are not cut."""
    width = shutil.get_terminal_size((WHOLE, 0)).columns
    lines = textwrap.wrap(
        str(text),
        max(width - column, NARROWEST),
        break_long_words=False,
        break_on_hyphens=False,
    )
    for start, line in zip([label, *[""] * len(lines)], lines or [""], strict=False):
        print(f"{start:{column}}{line}".rstrip())
