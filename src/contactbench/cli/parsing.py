"""How the commands read their arguments."""

from __future__ import annotations

import argparse
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from contactbench.errors import BadInput


class Parser(argparse.ArgumentParser):
    """Keeps the layout of its examples; bad usage is one line and exit status 2."""

    def __init__(self, **options: Any) -> None:
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **options)
        self._negative_number_matcher = re.compile(r"-\.?\d")  # -1e-3 is a value too, and told as a bad one

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {' '.join(message.split())} (see {self.prog} --help)\n")


class Intermixed(Parser):
    """Takes positional arguments among the options."""

    _within = False

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse by `parse_known_intermixed_args`, which calls this method in its turn."""
        if self._within:
            return super().parse_known_args(args, namespace)
        self._within = True
        try:
            return self.parse_known_intermixed_args(args, namespace)
        finally:
            self._within = False


def writable(option: str, path: Path | None, kinds: tuple[str, ...] = ()) -> None:
    """Raise `BadInput` unless a file can be written there, before anything is computed for it.

    A file that is there is left as it is, one that is not is not made.
    """
    if path is None:
        return
    if not path.parent.is_dir():
        raise BadInput(f"{option} {path}: there is no folder {path.parent}")
    if path.is_dir():
        raise BadInput(f"{option} {path}: is a folder")
    if kinds and path.suffix.lower() not in kinds:
        raise BadInput(f"{option} {path}: must end in {', '.join(kinds)}")
    there = path.exists()
    try:
        with path.open("ab"):
            pass
    except OSError as error:
        raise BadInput(f"{option} {path}: cannot be written: {error.strerror}") from None
    if not there:
        path.unlink()


def writable_folder(option: str, folder: Path) -> None:
    """Raise `BadInput` unless files can be made in a folder."""
    try:
        with tempfile.NamedTemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise BadInput(f"{option} {folder}: cannot be written: {error.strerror}") from None


#: what a plot can be saved as
PICTURES = (".svg", ".png", ".pdf")

#: taken from anywhere on the line and loaded first, so that every command knows what it brings
PLUGIN = Parser(prog="contactbench", add_help=False, allow_abbrev=False)
PLUGIN.add_argument(
    "--plugin", action="append", default=[], metavar="FILE", type=Path,
    help="Python file that registers methods or scenes of your own; may be repeated",
)  # fmt: skip

PLUGIN.add_argument(
    "--plugin-timeout", metavar="SECONDS",
    help="for importing a plug-in and for each first evaluation of what it brings (default: 60; 0: any time)",
)  # fmt: skip
PLUGIN.add_argument("--traceback", action="store_true", help="show where an error comes from")

#: ``command(name, run, about, examples) -> parser`` makes one more command
Command = Callable[..., Any]
