"""Print a label and a text, wrapped at the width of the terminal."""

from __future__ import annotations

import shutil
import textwrap

#: least columns of a text beside its label
NARROWEST = 20


def print_item(label: str, text: object, column: int) -> None:
    """Print a label and a text indented to a column; lines break between words."""
    width = shutil.get_terminal_size().columns  # 80 without a terminal
    lines = textwrap.wrap(
        str(text),
        max(width - column, NARROWEST),
        break_long_words=False,
        break_on_hyphens=False,
    )
    for start, line in zip([label, *[""] * len(lines)], lines or [""], strict=False):
        print(f"{start:{column}}{line}".rstrip())
