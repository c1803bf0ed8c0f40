"""Parse the arguments of the commands; help.toml has their help and options."""

from __future__ import annotations

import argparse
import json
import re
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any, NoReturn

from contactbench.errors import BadInput


class Parser(argparse.ArgumentParser):
    def __init__(self, **options: Any) -> None:
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **options)
        self._negative_number_matcher = re.compile(r"-\.?\d")  # -1e-3 is a value too, and told as a bad one

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {' '.join(message.split())} (see {self.prog} --help)\n")


def writable(option: str, path: Path | None, kinds: tuple[str, ...] = ()) -> None:
    """Raise `BadInput` unless the path can be written; an existing file keeps its content, and none is left behind."""
    if path is None:
        return
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


def print_json(value: object, arguments: argparse.Namespace) -> None:
    print(json.dumps(value, allow_nan=False), file=arguments.stdout)


def assignments(pairs: list[str]) -> dict[str, object]:
    """Parse ``name=value`` arguments; each value is JSON, a number or a list of numbers."""
    changes = {}
    for pair in pairs:
        name, _, text = pair.partition("=")
        try:
            changes[name] = json.loads(text)
        except (ValueError, RecursionError):
            allowed = "must be name=value, the value a number or [list, of, numbers]"
            raise BadInput(f"--set {pair}: {allowed}") from None
        if isinstance(changes[name], list):
            changes[name] = tuple(changes[name])
    return changes


#: purpose, options and epilog of each command
HELP: dict[str, dict[str, Any]] = tomllib.loads(
    files(__package__).joinpath("help.toml").read_text(encoding="utf-8")
)
#: the names of types in help.toml
TYPES: dict[str, type] = {"int": int, "float": float, "path": Path}


def add_options(parser: argparse.ArgumentParser, name: str) -> None:
    for flag, given in HELP[name].get("options", {}).items():
        parser.add_argument(flag, **given | ({"type": TYPES[given["type"]]} if "type" in given else {}))


#: parsed first, anywhere on the line, so that every command knows the user's methods and scenes
PLUGIN = Parser(prog="contactbench", add_help=False, allow_abbrev=False)
add_options(PLUGIN, "plugin")
