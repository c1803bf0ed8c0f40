"""Registries: dicts in table order whose missing keys suggest the nearest name."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, ClassVar

from contactbench.errors import BadInput, excerpt, unknown_name
from contactbench.notebook import html_table

#: a name is also a key in tables, a part of file names and a word on the command line
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]*")


def import_modules(package: str, first: Sequence[str] = (), without: Sequence[str] = ()) -> None:
    """Import the modules of a package, which register their items: `first` in this order, then the others by name."""
    there = iter_modules(sys.modules[package].__path__)
    others = sorted(module.name for module in there if not module.ispkg)
    for name in dict.fromkeys((*first, *others)):
        if name not in without:
            import_module(f"{package}.{name}")


class Registry(dict[str, Any]):
    """Hold items by name in the order of tables: a dict whose missing keys raise `UnknownName`.

    Parameters
    ----------
    kind
        The word for an item in messages.
    of
        The class that an item must have.

    Raises
    ------
    UnknownName
        For an unknown key; the message suggests the nearest one.
    BadInput
        For an item of another class, and for a name that is taken or not allowed.
    """

    #: all registries
    every: ClassVar[list[Registry]] = []

    def __init__(self, kind: str, of: type = object) -> None:
        super().__init__()
        self.every.append(self)
        self.kind, self.of = kind, of

    def _repr_html_(self) -> str:
        return html_table({name: getattr(item, "about", "") for name, item in self.items()}, self.kind)

    def __getitem__(self, name: object) -> Any:
        if not isinstance(name, str) or name not in self:  # perhaps something that cannot be a key at all
            raise unknown_name(self.kind, name, self)
        return super().__getitem__(name)

    def add[Item](self, item: Item) -> Item:
        """Register `item` under its name and return it; raises `BadInput` for a bad or taken name or a wrong class."""
        name = getattr(item, "name", None)
        if isinstance(name, str) and name in self:
            raise BadInput(f"{self.kind} {name!r} is already registered")
        self[name] = item
        return item

    def __setitem__(self, name: object, item: object) -> None:
        """Register `item` under its own name, replacing any other; raises `BadInput` for a bad name or wrong class."""
        own = getattr(item, "name", None)
        if not isinstance(item, self.of) or own is None:
            raise BadInput(f"{excerpt(item)} cannot be registered: it is no {self.kind}")
        if not isinstance(own, str) or not NAME.fullmatch(own):
            raise BadInput(f"{self.kind} name {excerpt(own)}: must be letters, digits, '_', '.', '+', '-'")
        if name != own:
            raise BadInput(f"{self.kind} name {excerpt(name)}: must be the item's own, {own!r}")
        super().__setitem__(name, item)
