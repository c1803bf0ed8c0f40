"""Files and folders that a command will write: refused before the work begins, not after it."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from contactbench.errors import BadInput

#: what a figure is drawn as
PICTURES = (".svg", ".png", ".pdf")


def output(text: str) -> Path:
    """A file that can be written, for argparse; one that is there is left as it is, one that is not is not made."""
    path = Path(text)
    try:
        there = path.exists()
        with path.open("ab"):
            pass
        if not there:
            path.unlink()
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise argparse.ArgumentTypeError(f"{text}: cannot be written: {why}") from None
    return path


def picture(text: str) -> Path:
    """The same for a figure."""
    if Path(text).suffix not in PICTURES:
        raise argparse.ArgumentTypeError(f"{text}: must end in {', '.join(PICTURES)}")
    return output(text)


def writable(folder: Path) -> None:
    """Raises `BadInput` where no file can be made in a folder."""
    try:
        with tempfile.NamedTemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise BadInput(f"{folder}: cannot be written: {error.strerror}") from None
