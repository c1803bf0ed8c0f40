"""How large a motion becomes, from its start alone: what divergence and absolute tolerances are measured against."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from contactbench.numbers.protocol import Vector

#: a size between these counts as 1: a scene in sensible units keeps them
LEAST, MOST = 1e-2, 1e3
#: spans that are tried, each so many times as long as the one before
SPANS, RATIO = 18, 8.0


def in_order(sizes: object) -> np.ndarray:
    """Return sizes, 1 where they are of order one or not known."""
    sizes = np.asarray(sizes, dtype=float)
    known = np.isfinite(sizes) & (sizes > 0) & ~((sizes >= LEAST) & (sizes <= MOST))
    return np.where(known, sizes, 1.0)


def size(vector: Vector) -> float:
    """Return the largest magnitude among some numbers, nan if one of them is."""
    total: Any = sum(vector)
    largest: Any = max(map(abs, vector))
    return float(largest) if total == total else math.nan


def reach(scene: Any, x: Any, end: float) -> tuple[float, float]:
    """Return how large coordinates and velocities become.

    A body is thrown from x with its first acceleration, over the longest of some spans up to `end` in which the
    change of the force does not outweigh what it has: a fraction of a period, or all the time of a free body.
    """

    def pull(after: float, q: Vector) -> Vector:
        there = x._replace(q=q) if scene.clock is None else x._replace(q=q, t=x.t + after)
        try:
            accelerations: Vector = scene.velocity(tuple(-g for g in scene.gradient_at(there)))
        except Exception:  # a user's function, where it is not defined
            return tuple(np.nan * c for c in q)
        return accelerations

    v, a = scene.velocity(x.p), pull(0.0, x.q)
    far, fast, force = size(x.q), size(v), size(a)
    spans = [end / RATIO**k for k in reversed(range(SPANS))]
    if scene.clock is not None:  # a force that is yet to come
        force = np.fmax.reduce([force, *(size(pull(span, x.q)) for span in spans)])

    def fits(span: float) -> bool:
        thrown = tuple(c + span * (d + span / 2 * e) for c, d, e in zip(x.q, v, a, strict=True))
        here = a if scene.clock is None else pull(span, x.q)
        change = size(tuple(there - c for there, c in zip(pull(span, thrown), here, strict=True)))
        return bool(change * span <= fast + force * span / 2)

    longest = 0.0
    for span in spans:
        if not fits(span):
            break
        longest = span
    if not longest > 0:
        return float(np.fmax(far, 0.0)), fast
    return float(np.fmax(far, longest * (fast + longest / 2 * force))), fast + longest * force
