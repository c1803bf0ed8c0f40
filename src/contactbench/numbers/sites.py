"""What sites do together, on every kind of field: sums, neighbours, pairs.

A field is an array whose first axis counts the sites, a recorded field (`trace.fields`) or a dual number of two.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from contactbench.numbers.dual import Dual, slope, value
from contactbench.numbers.functions import namespace
from contactbench.numbers.protocol import Unknown

#: what is beyond the ends
BOUNDARIES = ("ring", "fixed", "free")


def total(x: Any) -> Any:
    """Return the sum over all sites, pairwise: its round-off hardly grows with their number."""
    if isinstance(x, Dual):
        return Dual(total(x.a), total(x.b))
    if isinstance(x, Unknown):
        return x.tape.total(x)  # type: ignore[attr-defined]
    if namespace(x) is np and x.ndim > 1:
        x = np.ascontiguousarray(np.moveaxis(x, 0, -1))  # NumPy sums in pairs along the last axis alone
        return x.sum(axis=-1)
    return x.sum(axis=0)


def neighbour(x: Any, places: int, boundary: str) -> Any:
    """Return the value at the next site (places = 1) or the one before (−1); beyond an end 0, or the last if free."""
    if isinstance(x, Dual):
        return Dual(neighbour(x.a, places, boundary), neighbour(x.b, places, boundary))
    if isinstance(x, Unknown):
        return x.tape.shift(x, places)  # type: ignore[attr-defined]
    xp = namespace(x)
    if boundary == "ring":
        return xp.roll(x, -places, axis=0)
    end = x[-1:] if places > 0 else x[:1]
    end = 0 * end if boundary == "fixed" else end
    return xp.concatenate([x[1:], end] if places > 0 else [end, x[:-1]])


def pairs(function: Callable[..., tuple[Any, ...]], x: tuple[Any, ...], *weights: Any) -> tuple[Any, ...]:
    """Return Σ_{j ≠ i} function(x_i − x_j, w_i, w_j, …) at every site i, for each of its results; nothing at r = 0."""
    first = value(x[0])
    if isinstance(first, Unknown):
        return first.tape.pairs(function, x, weights)  # type: ignore[attr-defined]
    xp = namespace(first)

    def against(f: Any) -> tuple[Any, Any]:
        f = f.reshape(*f.shape, *(1,) * (first.ndim - f.ndim))
        return f[:, None], f[None]

    def difference(f: Any) -> Any:
        if isinstance(f, Dual):
            return Dual(difference(f.a), difference(f.b))
        mine, other = against(f)
        return mine - other

    apart = tuple(map(difference, x))
    distance = sum(value(d) * value(d) for d in apart)
    # a compiler may round the place of a site in two ways, and find it away from itself
    itself = xp.eye(len(first), dtype=bool).reshape(*(len(first),) * 2, *(1,) * (first.ndim - 1))
    same = itself | (distance == 0)
    # a place of their own for what is at one: nothing divides by zero
    apart = (apart[0] + xp.where(same, 1.0, 0.0), *apart[1:])
    found = function(apart, *(side for w in weights for side in against(w)))

    def summed(f: Any) -> Any:
        if isinstance(f, Dual):
            return Dual(summed(f.a), summed(f.b))
        return xp.where(same, 0.0, f).sum(axis=1)

    return tuple(map(summed, found))


def parts(x: Any) -> tuple[Any, ...]:
    """Return a number, or value and derivative of a dual one."""
    return (value(x), slope(x)) if isinstance(x, Dual) else (x,)
