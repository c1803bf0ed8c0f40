"""How the commands read their arguments."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn


class Parser(argparse.ArgumentParser):
    """Keeps the layout of its examples; bad usage is one line and exit status 2."""

    def __init__(self, **options: Any) -> None:
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **options)

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {' '.join(message.split())} (see {self.prog} --help)\n")


#: taken from anywhere on the line and loaded first, so that every command knows what it brings
PLUGIN = Parser(prog="contactbench", add_help=False, allow_abbrev=False)
PLUGIN.add_argument(
    "--plugin", action="append", default=[], metavar="FILE", type=Path,
    help="Python file that registers methods or scenes of your own; may be repeated",
)  # fmt: skip

#: ``command(name, run, about, examples) -> parser`` makes one more command
Command = Callable[..., Any]
