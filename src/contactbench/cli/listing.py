"""``contactbench list``: scenes, methods, laws and claims."""

from __future__ import annotations

import argparse
from typing import Any

from contactbench.cli.parsing import Command


def listing(arguments: argparse.Namespace) -> int:
    """Print scenes, methods, laws and claims, or one kind without heading and indentation."""
    import contactbench as cb
    from contactbench.claims import CLAIMS
    from contactbench.measure.ladder import stepping

    def method(item: Any) -> str:
        kind = {"fixed": "fixed step"}.get(stepping(item), stepping(item))
        order = [f"order {item.order}"] if item.order else ["variable order"] if item.adaptive else []
        return f"{', '.join([*order, kind, '/'.join(item.engines)])}: {item.about}"

    kinds = {
        "scenes": {name: scene.about for name, scene in cb.SCENES.items()},
        "methods": {name: method(item) for name, item in cb.METHODS.items()},
        "laws": {name: law.definition for name, law in cb.LAWS.items()},
        "claims": {name: f"{item.where}: {item.says}" for name, item in CLAIMS.items()},
    }
    if arguments.kind:
        print("\n".join(f"{name:24} {about}" for name, about in kinds[arguments.kind].items()))
        return 0
    for kind, items in kinds.items():
        print("\n".join([kind, *(f"  {name:24} {about}" for name, about in items.items())]))
    return 0


EXAMPLES = """examples:
  contactbench list
  contactbench list methods | grep adaptive
  contactbench list scenes --plugin my.py"""


def add(command: Command) -> None:
    """Add the command and its options."""
    show = command("list", listing, "scenes, methods, laws and claims", EXAMPLES)
    show.add_argument("kind", nargs="?", choices=["scenes", "methods", "laws", "claims"], help="only these")
