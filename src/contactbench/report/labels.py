"""Names written at the curves of a panel, each where it hides least; a name that fits nowhere is left to the legend."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

#: pixels between samples of a curve
SAMPLED = 5.0
#: a name may lie on so many samples, no more
HIDES = 4.0
#: away from the ends of its curve a name must hide so much less, point by point
FAR = 0.1
#: pixels between a name and its point, and around a name
AWAY, ROOM = 7.0, 2.0


@dataclass(frozen=True)
class Box:
    """Pixels, y upwards."""

    left: float
    bottom: float
    right: float
    top: float

    def meets(self, other: Box) -> bool:
        return (
            self.left < other.right + ROOM and other.left < self.right + ROOM
            and self.bottom < other.top + ROOM and other.bottom < self.top + ROOM
        )  # fmt: skip

    def inside(self, other: Box) -> bool:
        return (
            self.left >= other.left and self.right <= other.right
            and self.bottom >= other.bottom and self.top <= other.top
        )  # fmt: skip

    def holds(self, points: np.ndarray) -> int:
        """How many of the points (n × 2) lie in it."""
        x, y = points[:, 0], points[:, 1]
        return int(np.sum((x > self.left) & (x < self.right) & (y > self.bottom) & (y < self.top)))


def sampled(points: np.ndarray) -> np.ndarray:
    """Points along the polygon, SAMPLED pixels apart; nan interrupts it."""
    parts = [np.empty((0, 2))]
    for a, b in pairwise(points):
        if np.isfinite([a, b]).all():
            t = np.linspace(0, 1, min(400, int(np.hypot(*(b - a)) / SAMPLED) + 2))[:, None]
            parts.append(a + t * (b - a))
    return np.concatenate([*parts, points[np.isfinite(points).all(axis=1)]])


def places(
    panel: Box, lines: Sequence[np.ndarray], sizes: Sequence[tuple[float, float] | None],
    faint: Sequence[np.ndarray] = (), taken: Sequence[Box] = (),
) -> list[Box | None]:  # fmt: skip
    """A box for the name of each line, or None.

    lines : points in pixels (n × 2).  sizes : of the names, None for a line without one.
    faint : lines that may be written over.  taken : boxes already written in.
    """
    dense = [sampled(line) for line in lines]
    behind = np.concatenate([np.empty((0, 2)), *map(sampled, faint)])
    found: list[Box | None] = []
    used = list(taken)
    for k, (line, size) in enumerate(zip(lines, sizes, strict=True)):
        best: tuple[float, Box] | None = None
        if size is not None:
            others = np.concatenate([np.empty((0, 2)), *(d for i, d in enumerate(dense) if i != k)])
            w, h = size
            for n, (x, y) in enumerate(along(line)):
                for left, bottom in (
                    (x + AWAY, y - h / 2), (x - AWAY - w, y - h / 2), (x - w / 2, y + AWAY),
                    (x - w / 2, y - AWAY - h), (x + AWAY, y + AWAY / 2), (x - AWAY - w, y + AWAY / 2),
                    (x + AWAY, y - AWAY / 2 - h), (x - AWAY - w, y - AWAY / 2 - h),
                ):  # fmt: skip
                    box = Box(left, bottom, left + w, bottom + h)
                    if not box.inside(panel) or any(box.meets(b) for b in used):
                        continue
                    hidden = 2.0 * box.holds(others) + box.holds(dense[k]) + 0.05 * box.holds(behind)
                    hidden += FAR * n
                    if best is None or hidden < best[0]:
                        best = hidden, box
        chosen = best[1] if best is not None and best[0] <= HIDES else None
        found.append(chosen)
        if chosen is not None:
            used.append(chosen)
    return found


def along(line: np.ndarray, most: int = 14) -> np.ndarray:
    """Points a name may stand at: both ends first."""
    known = line[np.isfinite(line).all(axis=1)]
    if len(known) <= 2:
        return known
    order = np.unique(np.linspace(0, len(known) - 1, most).astype(int))
    return known[[order[-1], order[0], *order[1:-1]]]
