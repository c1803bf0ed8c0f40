"""Scales: the sizes of the components of a motion, and errors relative to them.

Sizes estimated from the start define absolute tolerances and the bound of divergence.  Sizes of the true motion define
all errors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from contactbench.numbers.control import choose, repeat_while
from contactbench.numbers.dual import Dual, slope
from contactbench.numbers.protocol import Arithmetic, Namespace, Vector, abilities
from contactbench.scene.algebra import rotation_matrix

#: a size between these counts as 1 if components share a unit
LEAST, MOST = 1e-2, 1e3
#: number of spans tried, and the ratio of successive spans
SPANS, RATIO = 18, 8.0
#: a size counts as at least this part of the size that the energy allows
FAINT = 1e-3


def known(sizes: np.ndarray) -> np.ndarray:
    """Return sizes, with 1 for unknown ones."""
    return np.where(np.isfinite(sizes) & (sizes > 0), sizes, 1.0)


def scale_of(size: Arithmetic, xp: Namespace) -> Arithmetic:
    """Return a size, with 1 for a size of order one and an unknown one."""
    of_order_one, unknown = (
        (size >= LEAST) & (size <= MOST),
        (size <= 0) | (size == math.inf) | (size != size),
    )
    return choose(of_order_one | unknown, 1.0, size, xp)


def larger(a: Arithmetic, b: Arithmetic, xp: Namespace) -> Arithmetic:
    """Return the larger number, the other one if one is nan."""
    return choose((a >= b) | (b != b), a, b, xp)


def size(vector: Vector, xp: Namespace) -> Arithmetic:
    """Return the largest magnitude among some numbers; nan if one of them is nan."""
    total: Any = sum(vector)
    largest = reduce(lambda a, b: larger(a, b, xp), map(abs, vector))
    return choose(total == total, largest, math.nan, xp)


def reach(scene: Any, x: Any, end: Any, lengths: Sequence[int], xp: Any) -> tuple[list[Any], list[Any]]:
    """Estimate the largest sizes of parts of the coordinates, with given lengths, and of their velocities.

    By a throw from x with the initial acceleration, over the longest span up to `end` in which the force varies little.
    """

    ends = [*accumulate(lengths)]
    cuts = [slice(end - n, end) for n, end in zip(lengths, ends, strict=True)]

    def sizes(v: Vector) -> list[Arithmetic]:
        return [size(v[cut], xp) for cut in cuts]

    def pull(after: Arithmetic, q: Vector) -> Vector:
        there = x._replace(q=q) if scene.clock is None else x._replace(q=q, t=x.t + after)
        try:
            accelerations: Vector = scene.velocity(tuple(-g for g in scene.gradient_at(there)))
        except Exception:  # a user's function is not defined there
            if not abilities(xp).branch:
                raise
            return tuple(math.nan * c for c in q)
        return accelerations

    v, a = scene.velocity(x.p), pull(0.0, x.q)
    far, fast, force = map(sizes, (x.q, v, a))
    first = end / RATIO ** (SPANS - 1)
    if scene.clock is not None:  # a later force
        for k in range(SPANS):
            force = [
                larger(*both, xp) for both in zip(force, sizes(pull(first * RATIO**k, x.q)), strict=True)
            ]

    def longer(tried: tuple[Any, ...]) -> tuple[Any, ...]:
        span, fits, longest = tried
        thrown = tuple(c + span * (d + span / 2 * e) for c, d, e in zip(x.q, v, a, strict=True))
        here = a if scene.clock is None else pull(span, x.q)
        change = sizes(tuple(there - c for there, c in zip(pull(span, thrown), here, strict=True)))
        seen = zip(fits, change, fast, force, strict=True)
        fits = [choose((fit > 0) & (c * span <= was + f * span / 2), 1.0, 0.0, xp) for fit, c, was, f in seen]
        longest = [choose(fit > 0, span, before, xp) for fit, before in zip(fits, longest, strict=True)]
        return RATIO * span, fits, longest

    begin = first, [1.0 + 0 * end] * len(cuts), [0 * end] * len(cuts)
    _, _, longest = repeat_while(lambda tried: (tried[0] <= end) & (sum(tried[1]) > 0), longer, begin, xp)
    most, faster = [larger(c, 0.0, xp) for c in far], list(fast)
    for i, span in enumerate(longest):
        thrown = larger(far[i], span * (fast[i] + span / 2 * force[i]), xp)
        most[i] = choose(span > 0, thrown, most[i], xp)
        faster[i] = choose(span > 0, fast[i] + span * force[i], fast[i], xp)
    return most, faster


# -- scales of errors --------------------------------------------------------------------------------
def curvatures(scene: Any, x: Any) -> np.ndarray:
    """Return |∂²H/∂y²| for every coordinate and momentum, (2n,): stiffnesses and inverse masses; 0 if unknown."""
    n = len(x.q)
    try:
        rows = scene.jacobian(x)
        if rows is None:
            y, carry = scene.pack(x), [name for name in scene.optional if getattr(x, name) is not None]
            moved = [Dual(c, row) for c, row in zip(y, np.eye(len(y)), strict=True)]
            found = scene.rhs(scene.unpack(moved, carry))
            rows = [slope(c) + np.zeros(len(y)) for c in (*found.q, *found.p)]
        bends = [rows[i + n if i < n else i - n][i] for i in range(2 * n)]
        return np.nan_to_num(np.abs(np.array(bends, dtype=float)), posinf=0.0)
    except Exception:  # a user's function of floats, or not defined there
        return np.zeros(2 * n)


def at_least(scene: Any, x: Any, sizes: np.ndarray) -> np.ndarray:
    """Return sizes of coordinates and momenta, (2n,), raised to `FAINT` times what the energy allows, √(2E/H'')."""
    bends, momenta = curvatures(scene, x), sizes[len(x.q) :]
    twice = np.nansum(bends[len(x.q) :] * momenta * momenta)
    room = np.sqrt(np.divide(twice, bends, out=np.zeros(len(sizes)), where=bends > 0))
    raised: np.ndarray = np.fmax(sizes, FAINT * room)
    return raised


def vectors_of(
    scene: Any, y: np.ndarray, carry: Sequence[str], whole: bool = False
) -> tuple[np.ndarray, list[int]]:
    """Return the components of packed states (k, d) that have errors, and the lengths of vectors with one unit.

    The attitude is its nine matrix entries, which do not depend on the sign of the quaternion.  The time is left out,
    and unless `whole` also an s without effect on the motion, since a constant in V could make it arbitrarily large.
    """
    lengths = scene.groups(carry)
    if scene.clock is not None:
        y = np.delete(y, scene.clock, axis=1)
    if "s" in carry and "s" not in scene.carry(()) and not whole:
        y, lengths = y[:, :-1], lengths[:-1]
    if "R" in carry:
        attitude, first = len(scene.vectors), scene.motion
        entries = np.array(rotation_matrix(tuple(y[:, first : first + lengths[attitude]].T))).reshape(9, -1)
        y = np.concatenate([y[:, :first], entries.T, y[:, first + lengths[attitude] :]], axis=1)
        lengths[attitude] = 9
    return y, lengths


def norms(v: np.ndarray, lengths: Sequence[int]) -> np.ndarray:
    """Return the norms of adjacent vectors, (k, ·), without underflow or unnecessary overflow."""
    if len(lengths) == v.shape[1]:
        return np.abs(v)
    firsts = np.cumsum(lengths) - lengths
    most = np.maximum.reduceat(np.abs(v), firsts, axis=1)
    most = np.where((most > 0) & (most < np.inf), most, 1.0)
    return np.asarray(
        most * np.sqrt(np.add.reduceat((v / np.repeat(most, lengths, axis=1)) ** 2, firsts, axis=1))
    )


def sizes_of(scene: Any, rows: np.ndarray, carry: Sequence[str], whole: bool = False) -> np.ndarray:
    """Return the scale of each of `vectors_of` in true states (k, d), the start first: its largest size, or `scale`."""
    sizes, vectors = norms(*vectors_of(scene, rows, carry, whole)).max(axis=0), scene.vectors
    motion = len(vectors)
    if "p" in getattr(scene.state, "_fields", ()) and (scene.mixed or len(sizes) > motion):
        each = np.repeat(sizes[:motion], vectors)
        if scene.mixed:
            each = at_least(scene, scene.unpack(rows[0].tolist(), carry), each)
            sizes[:motion] = each[np.cumsum(vectors) - 1]
        if len(sizes) > motion:
            sizes[-1] = np.fmax(sizes[-1], FAINT * np.multiply(*np.split(each, 2)).max())
    if scene.scale is not None:
        sizes[:motion] = scene.scale
    return known(sizes)


def gaps(
    scene: Any, y: np.ndarray, true: np.ndarray, sizes: np.ndarray, carry: Sequence[str], whole: bool = False
) -> np.ndarray:
    """Return the largest relative error of the vectors of packed states (k, d), (k,)."""
    (found, lengths), (wanted, _) = (vectors_of(scene, each, carry, whole) for each in (y, true))
    apart = norms(np.asarray(found - wanted, dtype=float), lengths)
    return np.asarray((apart / sizes).max(axis=1))


def errors(
    scene: Any, y: np.ndarray, true: np.ndarray, start: ArrayLike, carry: Sequence[str], whole: bool = False
) -> np.ndarray:
    """Return the errors (k,) of states (k, d) of any numbers, relative to the sizes of the true states."""
    rows = np.asarray(np.vstack([np.asarray(start), true]), dtype=float)
    return gaps(scene, y, true, sizes_of(scene, rows, carry, whole), carry, whole)
