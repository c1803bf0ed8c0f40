"""The distance of two pilots of one problem, which is about the error of the coarser one."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import accumulate

import numpy as np

from contactbench.methods.prepared import Request
from contactbench.scene.scales import gaps, sizes_of
from contactbench.trace.kernel import Kernel


@Kernel
def squares(start, coarse, fine, after):  # type: ignore[no-untyped-def]
    """Compute the squares of max ‖coarse − fine‖ and max ‖fine‖ of a vector over all rows of states and the start.

    after : the number of rows, the place and the length of the vector, and then the two results, nan if not finite.
    """
    width = len(start)
    at = int(after[1])
    length = int(after[2])
    size = 0.0
    for i in range(length):
        size += start[at + i] * start[at + i]
    gap = 0.0
    lost = size - size
    for _row in range(int(after[0])):
        apart = 0.0
        large = 0.0
        for i in range(length):
            difference = coarse[at + i] - fine[at + i]
            apart += difference * difference
            large += fine[at + i] * fine[at + i]
        gap = apart if apart > gap else gap
        size = large if large > size else size
        lost += (apart - apart) + (large - large)
        at += width
    after[3] = gap + lost
    after[4] = size


def distance(
    request: Request, start: np.ndarray, coarse: np.ndarray, fine: np.ndarray
) -> Callable[[], float]:
    """Return a function that computes the error of `coarse` against `fine` from the present content of the arrays.

    The arrays are packed states, (d,) and (k, d); the start belongs to both runs.  Infinite unless all are finite.
    """
    scene, carry = request.scene, request.carry
    acting = "s" in scene.carry(())
    if request.engine == "llvm" and not (scene.mixed or acting or scene.scale is not None or "R" in carry):
        return compiled(list(scene.vectors), start, coarse, fine)

    def distance() -> float:
        with np.errstate(all="ignore"):
            rows = np.vstack([start, fine])
            gap = float(gaps(scene, coarse, fine, sizes_of(scene, rows, carry), carry).max())
        return gap if math.isfinite(gap) and np.isfinite(fine).all() else math.inf

    return distance


def compiled(
    lengths: list[int], start: np.ndarray, coarse: np.ndarray, fine: np.ndarray
) -> Callable[[], float]:
    """Return the same, compiled; each vector counts relative to its largest norm, or to 1 if it is always zero."""
    calls = []
    for begins, length in zip(accumulate(lengths, initial=0), lengths, strict=False):
        after = np.array([len(fine), begins, length, 0.0, 0.0])
        calls.append((squares.native.closed(start, coarse.reshape(-1), fine.reshape(-1), after), after))

    def distance() -> float:
        largest = 0.0
        for call, after in calls:
            call()
            *_, gap, size = after.tolist()
            if not (gap < math.inf and size < math.inf):
                return math.inf
            largest = max(largest, gap / size if size > 0 else gap)
        return math.sqrt(largest)

    return distance
