"""Checks of arguments: each returns the value as it is kept, or raises `BadInput`."""

from __future__ import annotations

import importlib.util
import math
import re
from contextlib import suppress
from typing import Any, NoReturn, SupportsFloat, TypeGuard

import numpy as np

from contactbench.errors import BadInput, excerpt

#: line breaks, other control characters, halves of characters
CONTROL = re.compile("[\\x00-\\x1f\\x7f-\\x9f\\u2028\\u2029\\ud800-\\udfff]")
#: name of an imported package → the packages to install
INSTALLED_AS = {"sksundae": "scikit-sundae numba", "diffrax": "diffrax optimistix"}


def missing(package: str) -> str | None:
    """Return a message with the command that installs a missing package; None if it is installed."""
    if importlib.util.find_spec(package) is not None:
        return None
    name = INSTALLED_AS.get(package, package)
    return f"{name.partition(' ')[0]} is not installed: pip install {name}"


def refuse(name: str, value: object, wanted: str) -> NoReturn:
    raise BadInput(f"{name} = {excerpt(value)}: must be {wanted}") from None


def finite(name: str, value: object) -> float:
    """Return `value` as a finite float, or raise `BadInput`: a real number, neither text nor an array."""
    number = value if type(value) is float else math.nan
    if type(value) is not float and is_real(value):
        with suppress(TypeError, ValueError, OverflowError):
            number = float(value)
    return number if math.isfinite(number) else refuse(name, value, "a finite number")


def is_real(value: object) -> TypeGuard[SupportsFloat]:
    """Return whether a value is one real number: no text, no complex number, no date, no array."""
    if isinstance(value, np.ndarray | np.generic):
        return value.ndim == 0 and value.dtype.kind in "fiubO"
    return not isinstance(value, str | bytes | bytearray | complex)


def is_number(value: object) -> bool:
    return is_real(value) and hasattr(value, "__float__")


def require_number(name: str, value: object) -> None:
    if not is_number(value):
        raise BadInput(f"{name}: must return a real number; it returns {excerpt(value)}")


def positive(name: str, value: object) -> float:
    number = finite(name, value)
    return number if number > 0 else refuse(name, value, "> 0")


def whole(name: str, value: object, most: int, least: int = 1) -> int:
    """Return `value` as an int from `least` to `most`, or raise `BadInput`."""
    number = 0.0 if isinstance(value, bool) else finite(name, value)
    if not least <= number <= most or number != int(number):
        refuse(name, value, f"a whole number ≥ {least}, at most {most:g}")
    return int(number)


def real_array(name: str, value: object, wanted: str) -> np.ndarray:
    """Return `value` as an array of floats, without a copy if it is one, or raise `BadInput`."""
    try:
        given = np.asarray(value)
        if given.dtype.kind in "fiubO" and (given.dtype.kind != "O" or all(map(is_real, given.flat))):
            return given.astype(float, copy=False)
    except (TypeError, ValueError, OverflowError):
        pass
    refuse(name, value, wanted)


def vector(name: str, value: Any, length: int | None = None) -> tuple[float, ...]:
    """Return `value` as a tuple of finite floats (of the given length), or raise `BadInput`."""
    try:
        items = () if isinstance(value, str | bytes | dict | set) else tuple(value)
    except TypeError:
        items = (value,)
    if not items or length not in (None, len(items)):
        refuse(name, value, "a sequence of numbers" if length is None else f"{length} numbers")
    return tuple(finite(f"{name}[{i}]", item) for i, item in enumerate(items))


def items_of(name: str, value: Any, wanted: str) -> list[Any]:
    """Return the items of `value`, or raise `BadInput` with the text `wanted`; a string is no list of letters."""
    try:
        return refuse(name, value, wanted) if isinstance(value, str | bytes) else list(value)
    except TypeError:
        refuse(name, value, wanted)


def function(name: str, value: object) -> Any:
    return value if callable(value) else refuse(name, value, "a function")


def text(name: str, value: object) -> str:
    if not isinstance(value, str) or CONTROL.search(value):
        refuse(name, value, "a string of one line, without control characters")
    return value


def switch(name: str, value: object) -> bool:
    return bool(value) if isinstance(value, bool | np.bool_) else refuse(name, value, "True or False")
