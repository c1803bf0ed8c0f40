"""What sites do together, on every kind of field: sums, neighbours, pairs.

A field is an array whose first axis counts the sites, a recorded field (`trace.fields`) or a dual number of two.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from contactbench.numbers.dual import linear, value
from contactbench.numbers.functions import namespace
from contactbench.numbers.protocol import Arithmetic, Unknown, Vector

#: what is beyond the ends
BOUNDARIES = ("ring", "fixed", "free")


@linear
def total(x: Any) -> Any:
    """Return the sum over all sites, pairwise: its round-off hardly grows with their number."""
    if isinstance(x, Unknown):
        return x.tape.total(x)  # type: ignore[attr-defined]
    if namespace(x) is np and x.ndim > 1:  # NumPy sums in pairs along the last axis alone
        return np.ascontiguousarray(np.moveaxis(x, 0, -1)).sum(axis=-1)
    return x.sum(axis=0)


@linear
def neighbour(x: Any, places: int, boundary: str) -> Any:
    """Return the value at the next site (places = 1) or the one before (−1); beyond an end 0, or the last if free."""
    if isinstance(x, Unknown):
        return x.tape.shift(x, places)  # type: ignore[attr-defined]
    xp = namespace(x)
    if boundary == "ring":
        return xp.roll(x, -places, axis=0)
    end = x[-1:] if places > 0 else x[:1]
    end = 0 * end if boundary == "fixed" else end
    return xp.concatenate([x[1:], end] if places > 0 else [end, x[:-1]])


def pairs(function: Callable[..., Vector], x: Vector, *weights: Arithmetic) -> Vector:
    """Return Σ_{j ≠ i} function(x_i − x_j, w_i, w_j, …) at every site i, for each of its results; nothing at r = 0."""
    first: Any = value(x[0])
    if isinstance(first, Unknown):
        recorded: Vector = first.tape.pairs(function, x, weights)  # type: ignore[attr-defined]
        return recorded
    xp = namespace(first)

    def against(f: Any) -> Vector:
        f = f.reshape(*f.shape, *(1,) * (first.ndim - f.ndim))
        return f[:, None], f[None]

    @linear
    def difference(f: Arithmetic) -> Arithmetic:
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

    @linear
    def summed(f: Arithmetic) -> Any:
        return xp.where(same, 0.0, f).sum(axis=1)

    return tuple(map(summed, found))
