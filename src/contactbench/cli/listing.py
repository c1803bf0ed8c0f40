"""``contactbench list``: scenes, methods, laws and claims."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from contactbench.cli.parsing import Command


def listing(arguments: argparse.Namespace) -> int:
    """Print scenes, methods, laws and claims, or one kind without heading and indentation."""
    import contactbench as cb
    from contactbench.measure.ladder import stepping

    def method(item: Any) -> str:
        kind = {"fixed": "fixed step"}.get(stepping(item), stepping(item))
        order = [f"order {item.order}"] if item.order else ["variable order"] if item.adaptive else []
        return f"{', '.join([*order, kind, '/'.join(item.engines)])}: {item.about}"

    def claims() -> dict[str, str]:
        from contactbench.claims import CLAIMS

        return {name: f"{item.where}: {item.says}" for name, item in CLAIMS.items()}

    kinds: dict[str, Callable[[], dict[str, str]]] = {
        "scenes": lambda: {name: scene.about for name, scene in cb.SCENES.items()},
        "methods": lambda: {name: method(item) for name, item in cb.METHODS.items()},
        "laws": lambda: {name: law.definition for name, law in cb.LAWS.items()},
        "claims": claims,
    }
    for kind in [arguments.kind] if arguments.kind else kinds:
        if not arguments.kind:
            print(kind)
        indent = "" if arguments.kind else "  "
        for name, about in kinds[kind]().items():
            print(f"{indent}{name:24} {about}")
    return 0


def add(command: Command) -> None:
    """The command and its options."""
    show = command(
        "list", listing, "scenes, methods, laws and claims",
        """examples:
  contactbench list
  contactbench list methods | grep adaptive
  contactbench list scenes --plugin my.py""",
    )  # fmt: skip
    show.add_argument("kind", nargs="?", choices=["scenes", "methods", "laws", "claims"], help="only these")
