"""How large a motion becomes, from its start alone: what divergence and absolute tolerances are measured against."""

from __future__ import annotations

from functools import reduce
from typing import Any

import numpy as np

from contactbench.numbers.protocol import Condition, Vector

#: a size between these counts as 1: a scene in sensible units keeps them
LEAST, MOST = 1e-2, 1e3
#: spans that are tried, each so many times as long as the one before
SPANS, RATIO = 18, 8.0
#: numbers up to which all spans are tried at once
FEW = 2**16


def in_order(sizes: object) -> np.ndarray:
    """Return sizes, 1 where they are of order one or not known."""
    sizes = np.asarray(sizes, dtype=float)
    known = np.isfinite(sizes) & (sizes > 0) & ~((sizes >= LEAST) & (sizes <= MOST))
    return np.where(known, sizes, 1.0)


def reach(scene: Any, x: Any, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Return how large coordinates and velocities become: of many trajectories at once, one of each for all.

    A body is thrown from x with its first acceleration, over the longest of some spans up to `end` in which the
    change of the force does not outweigh what it has: a fraction of a period, or all the time of a free body.
    """

    def size(vector: Any) -> Any:
        if all(isinstance(c, float) for c in vector):
            return max(map(abs, vector)) if sum(vector) == sum(vector) else np.nan
        return reduce(np.maximum, map(np.abs, vector))

    def pull(after: float | np.ndarray, q: Vector) -> Any:
        there = x._replace(q=q) if scene.clock is None else x._replace(q=q, t=x.t + after)
        try:
            return scene.velocity(tuple(-g for g in scene.gradient_at(there)))
        except Exception:  # a user's function, where it is not defined
            return tuple(np.nan * c for c in q)

    v, a = scene.velocity(x.p), pull(0.0, x.q)
    far, fast, force = size(x.q), size(v), size(a)
    spans = [end / RATIO**k for k in reversed(range(SPANS))]
    if scene.clock is not None:  # a force that is yet to come
        force = np.fmax.reduce([force, *(size(pull(span, x.q)) for span in spans)])

    def fits(span: float | np.ndarray) -> Condition:
        thrown = tuple(c + span * (d + span / 2 * e) for c, d, e in zip(x.q, v, a, strict=True))
        here = a if scene.clock is None else pull(span, x.q)
        change = size([there - c for there, c in zip(pull(span, thrown), here, strict=True)])
        return change * span <= fast + force * span / 2

    longest = 0.0 * fast
    if np.ndim(fast) == 1 and SPANS * len(fast) <= FEW:
        each = np.array(spans)[:, None]
        longest = np.where(np.logical_and.accumulate(fits(each)), each, 0.0).max(axis=0)
    else:
        going = True
        for span in spans:
            going = going & fits(span)
            if not np.any(going):
                break
            longest = np.where(going, span, longest)
    way, gain = longest * (fast + longest / 2 * force), longest * force
    return np.fmax(far, np.where(longest > 0, way, 0.0)), fast + np.where(longest > 0, gain, 0.0)
