"""The one exception users see for bad input, and the checks that raise it."""

from __future__ import annotations

import math
import re
import reprlib
from collections.abc import Iterable
from contextlib import suppress
from typing import Any, ClassVar

import numpy as np

#: characters of a message at most
LONGEST = 300
#: of those, the last ones that are kept of a longer message: what is allowed stands at the end
KEPT = 120
#: characters at most of a value that is shown in a message
SHOWN = 80


class BadInput(ValueError):
    """A value the library cannot work with; the message, one line, names it and what is allowed."""

    def __init__(self, message: object) -> None:
        super().__init__(one_line(message))

    def __str__(self) -> str:  # KeyError, a base of UnknownName, would print its repr
        return str(self.args[0])


class UnknownName(BadInput, KeyError):
    """A name that is in no registry; the message suggests the nearest one."""


def one_line(message: object, longest: int = LONGEST) -> str:
    """Text without line breaks or control characters, its middle left out where it is longer."""
    text = "".join(c if c.isprintable() else " " for c in str(message))
    text = " ".join(text.split())
    if len(text) <= longest:
        return text
    kept = KEPT * longest // LONGEST
    return f"{text[: longest - kept - 3]} … {text[-kept:]}"


_SHORT = reprlib.Repr(maxlevel=3, maxtuple=8, maxlist=8, maxdict=4, maxset=4, maxstring=SHOWN, maxother=SHOWN)


def excerpt(value: object) -> str:
    """The repr of any value, short and on one line, whatever it is."""
    try:
        return one_line(_SHORT.repr(value), SHOWN)
    except Exception:  # an int of thousands of digits, an object whose repr fails
        return f"<{type(value).__name__}>"


def unknown_name(kind: str, name: object, allowed: Iterable[str]) -> UnknownName:
    from difflib import get_close_matches

    names = list(allowed)
    plain = {known.lower(): known for known in names}
    near = get_close_matches(name.lower(), plain, n=1, cutoff=0.5) if isinstance(name, str) else []
    hint = f"did you mean {plain[near[0]]!r}? " if near else ""
    return UnknownName(f"unknown {kind} {excerpt(name)}: {hint}choose from {', '.join(names)}")


#: a name is also a key in tables, a part of file names and a word on the command line
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]*")

#: line breaks, other control characters, halves of characters
CONTROL = re.compile("[\\x00-\\x1f\\x7f-\\x9f\\u2028\\u2029\\ud800-\\udfff]")


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

    def __getitem__(self, name: Any) -> Any:
        if not isinstance(name, str):  # perhaps something that cannot be a key at all
            raise unknown_name(self.kind, name, self)
        return super().__getitem__(name)

    def __missing__(self, name: object) -> Any:
        raise unknown_name(self.kind, name, self)

    def add(self, item: Any) -> Any:
        """Register `item` under ``item.name`` and return it.

        Raises `BadInput` for a name that is taken or not a word, and for what is no such item.
        """
        name = getattr(item, "name", None)
        if isinstance(name, str) and name in self:
            raise BadInput(f"{self.kind} {name!r} is already registered")
        self[name] = item
        return item

    def __setitem__(self, name: Any, item: Any) -> None:
        """Register `item` under its own name, in place of what had it; raises `BadInput` as `add` does."""
        own = getattr(item, "name", None)
        if not isinstance(item, self.of) or own is None:
            raise BadInput(f"{excerpt(item)} cannot be registered: it is no {self.kind}")
        if not isinstance(own, str) or not NAME.fullmatch(own):
            raise BadInput(f"{self.kind} name {excerpt(own)}: must be letters, digits, '_', '.', '+', '-'")
        if name != own:
            raise BadInput(f"{self.kind} name {excerpt(name)}: must be the item's own, {own!r}")
        super().__setitem__(name, item)


def finite(name: str, value: Any) -> float:
    """`value` as a finite float, or `BadInput`: a real number, neither text nor an array."""
    number = math.nan
    if is_real(value):
        with suppress(TypeError, ValueError, OverflowError):
            number = float(value)
    if not math.isfinite(number):
        raise BadInput(f"{name} = {excerpt(value)}: must be a finite number")
    return number


def is_real(value: Any) -> bool:
    """Whether a value is one real number: no text, no complex number, no date, no array."""
    if isinstance(value, np.ndarray | np.generic):
        return value.ndim == 0 and value.dtype.kind in "fiubO"
    return not isinstance(value, str | bytes | bytearray | complex)


def is_number(value: Any) -> bool:
    """Whether a value is one real number that a float can be made of."""
    return is_real(value) and hasattr(value, "__float__")


def require_number(name: str, value: Any) -> None:
    """Raise `BadInput` unless what a user's function returned is a real number."""
    if not is_number(value):
        raise BadInput(f"{name}: must return a real number; it returns {excerpt(value)}")


def positive(name: str, value: Any) -> float:
    """`value` as a finite float > 0, or `BadInput`."""
    number = finite(name, value)
    if number <= 0:
        raise BadInput(f"{name} = {excerpt(value)}: must be > 0")
    return number


def whole(name: str, value: Any, most: int) -> int:
    """`value` as an int from 1 to `most`, or `BadInput`."""
    number = 0.0 if isinstance(value, bool) else finite(name, value)
    if not 1 <= number <= most or number != int(number):
        raise BadInput(f"{name} = {excerpt(value)}: must be a whole number ≥ 1, at most {most:.0e}")
    return int(number)


def array(name: str, value: Any, wanted: str) -> np.ndarray:
    """`value` as an array of floats, itself if it is one, or `BadInput`, which says what is `wanted`.

    Complex numbers and dates are refused: as floats they would lose their imaginary part or unit.
    """
    try:
        given = np.asarray(value)
        if given.dtype.kind not in "fiubO" or (given.dtype.kind == "O" and not all(map(is_real, given.flat))):
            raise TypeError
        return given.astype(float, copy=False)
    except (TypeError, ValueError, OverflowError):
        raise BadInput(f"{name} = {excerpt(value)}: must be {wanted}") from None


def vector(name: str, value: Any, length: int | None = None) -> tuple[float, ...]:
    """`value` as a tuple of finite floats (of the given length), or `BadInput`."""
    try:
        items = tuple(value) if not isinstance(value, str | bytes | dict | set) else None
    except TypeError:
        items = (value,)
    if items is None or (length is not None and len(items) != length) or not items:
        wanted = f"{length} numbers" if length is not None else "a sequence of numbers"
        raise BadInput(f"{name} = {excerpt(value)}: must be {wanted}")
    return tuple(finite(f"{name}[{i}]", item) for i, item in enumerate(items))


def items_of(name: str, value: Any, wanted: str) -> list[Any]:
    """The items of `value`, or `BadInput`, which says what is `wanted`; a string is no list of letters."""
    try:
        if isinstance(value, str | bytes):
            raise TypeError
        return list(value)
    except TypeError:
        raise BadInput(f"{name} = {excerpt(value)}: must be {wanted}") from None


def function(name: str, value: Any) -> Any:
    """`value`, or `BadInput` where it cannot be called."""
    if not callable(value):
        raise BadInput(f"{name} = {excerpt(value)}: must be a function")
    return value


def text(name: str, value: Any) -> str:
    """`value`, or `BadInput` where it is no string or has line breaks and other control characters."""
    if not isinstance(value, str) or CONTROL.search(value):
        raise BadInput(f"{name} = {excerpt(value)}: must be a string of one line, without control characters")
    return value


def switch(name: str, value: Any) -> bool:
    """`value`, or `BadInput` where it is neither True nor False."""
    if not isinstance(value, bool | np.bool_):
        raise BadInput(f"{name} = {excerpt(value)}: must be True or False")
    return bool(value)
