"""The numbers in a nested state, taken out and put back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from contactbench.numbers.dual import Dual


def leaves(x: Any) -> list[Any]:
    """The numbers of a nested state, in order."""
    if x is None:
        return []
    if isinstance(x, Dual):
        return leaves(x.a) + leaves(x.b)
    if isinstance(x, tuple | list):
        return [leaf for part in x for leaf in leaves(part)]
    return [x]


def rebuild(x: Any, values: Sequence[Any]) -> Any:
    """A nested state like x of other numbers."""
    supply = iter(values)

    def again(x: Any) -> Any:
        if x is None:
            return None
        if isinstance(x, Dual):
            return Dual(again(x.a), again(x.b))
        if isinstance(x, tuple | list):
            parts = [again(part) for part in x]
            return type(x)(*parts) if hasattr(x, "_fields") else type(x)(parts)
        return next(supply)

    return again(x)
