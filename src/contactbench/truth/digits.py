"""High-precision numbers, and how many digits of two computations agree.

mpmath is imported when it is first used: its import would be a quarter of the command line's start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from decimal import Decimal, localcontext
from typing import Any

import numpy as np

from contactbench.scene import Scene

Rows = list[list[Any]]  #: one list of components per time


def scales(rows: Rows) -> list[Any]:
    """Return the largest |entry| of every column (1 for a column of zeros)."""
    return [max(abs(x) for x in column) or 1 for column in zip(*rows, strict=True)]


def distance(a: Sequence[Any], b: Sequence[Any]) -> Any:
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


def disagreement(a: Rows, b: Rows) -> list[Any]:
    return [distance(p, q) for p, q in zip(zip(*a, strict=True), zip(*b, strict=True), strict=True)]


def agreeing_digits(a: Rows, b: Rows, at_most: int) -> int:
    """Return the decimal digits to which two computations agree, relative to the scale of the worst column."""
    worst = max(e / scale for e, scale in zip(disagreement(a, b), scales(b), strict=True))
    return matching_digits(worst, at_most)


def matching_digits(error: Any, at_most: int) -> int:
    """Return the whole decimal digits that a relative error leaves."""
    import mpmath

    return at_most if error == 0 else max(0, min(at_most, int(mpmath.floor(-mpmath.log10(error)))))


def rounded(value: Any, places: int) -> str:
    """Return a number to a number of decimal places (half to even), in plain or scientific notation."""
    import mpmath

    with localcontext() as context:
        context.prec = 200
        exact = Decimal(mpmath.nstr(value, 100))
        return str(exact.quantize(Decimal(1).scaleb(-places)))


def place(value: Any, digits: int) -> int:
    """Return the decimal place of the last of `digits` significant digits of value."""
    import mpmath

    return digits if value == 0 else digits - 1 - int(mpmath.floor(mpmath.log10(abs(value))))


def decimal_context(digits: int) -> Any:
    """Return an mpmath context of its own, so that nobody's global precision is touched."""
    import mpmath

    context = mpmath.MPContext()
    context.dps = digits
    return context


def with_decimals(scene: Scene, number: Callable[[str], Any]) -> Scene:
    """Return the scene with every float x, initial data included, replaced by ``number(repr(x))``."""

    def convert(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return np.array([convert(x) for x in value], dtype=object)
        return tuple(map(convert, value)) if isinstance(value, tuple) else number(repr(float(value)))

    start = {name: convert(getattr(scene, name)) for name in scene.initial_fields}
    return scene.with_numbers([convert(x) for x in scene.numbers()])._replaced(**start)
