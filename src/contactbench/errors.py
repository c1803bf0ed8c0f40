"""The one exception users see for bad input, and the registry that raises it for unknown names."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable
from typing import Any, ClassVar


class BadInput(ValueError):
    """A value the library cannot work with; the message names it and what is allowed."""

    def __str__(self) -> str:  # KeyError, a base of UnknownName, would print its repr
        return str(self.args[0]) if self.args else ""


class UnknownName(BadInput, KeyError):
    """A name that is in no registry; the message suggests the nearest one."""


def unknown_name(kind: str, name: object, allowed: Iterable[str]) -> UnknownName:
    names = list(allowed)
    near = difflib.get_close_matches(str(name), names, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return UnknownName(f"unknown {kind} {name!r}: {hint}choose from {', '.join(names)}")


#: a name is also a key in tables, a part of file names and a word on the command line
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]*")


class Registry(dict):
    """A dict in table order whose missing keys raise `UnknownName` with a suggestion.

    kind : what its items are called in messages; of : the class or protocol they follow.
    """

    #: all registries there are
    every: ClassVar[list[Registry]] = []

    def __init__(self, kind: str, of: type = object) -> None:
        super().__init__()
        self.every.append(self)
        self.kind = kind
        self.of: Any = of

    def __missing__(self, name: object) -> Any:
        raise unknown_name(self.kind, name, self)

    def add(self, item: Any) -> Any:
        """Register `item` under ``item.name`` and return it.

        Raises `BadInput` for a name that is taken or not a word, and for what is no such item.
        """
        name = getattr(item, "name", None)
        if not isinstance(item, self.of) or name is None:
            raise BadInput(f"{item!r} cannot be registered: it is no {self.kind}")
        if not isinstance(name, str) or not NAME.fullmatch(name):
            raise BadInput(f"{self.kind} name {name!r}: must be letters, digits, '_', '.', '+', '-'")
        if item.name in self:
            raise BadInput(f"{self.kind} {item.name!r} is already registered")
        self[item.name] = item
        return item


def finite(name: str, value: Any) -> float:
    """`value` as a finite float, or `BadInput`."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise BadInput(f"{name} = {value!r}: must be a finite number") from None
    if not math.isfinite(number):
        raise BadInput(f"{name} = {value!r}: must be a finite number")
    return number


def positive(name: str, value: Any) -> float:
    """`value` as a finite float > 0, or `BadInput`."""
    number = finite(name, value)
    if number <= 0:
        raise BadInput(f"{name} = {value!r}: must be > 0")
    return number


def vector(name: str, value: Any, length: int | None = None) -> tuple[float, ...]:
    """`value` as a tuple of finite floats (of the given length), or `BadInput`."""
    try:
        items = tuple(value) if not isinstance(value, str) else None
    except TypeError:
        items = (value,)
    if items is None or (length is not None and len(items) != length) or not items:
        wanted = f"{length} numbers" if length is not None else "a sequence of numbers"
        raise BadInput(f"{name} = {value!r}: must be {wanted}")
    return tuple(finite(f"{name}[{i}]", item) for i, item in enumerate(items))
