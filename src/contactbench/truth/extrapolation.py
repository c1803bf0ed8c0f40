"""Gragg–Bulirsch–Stoer extrapolation in mpmath: a second engine that shares nothing with Taylor series."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from contactbench.scene import Scene
from contactbench.truth.base import NEVER, BlowUp, Stopwatch, with_decimals
from contactbench.truth.digits import Rows, decimal_context, distance
from contactbench.truth.taylor import COLLAPSE


def extrapolation(
    scene: Scene,
    times: list[str],
    carry: tuple[str, ...],
    digits: int,
    collapse: float = COLLAPSE,
    deadline: float = NEVER,
) -> Rows:
    """Return states at increasing times ≥ 0 (decimal strings) by the Gragg–Bulirsch–Stoer method in mpmath.

    Raises `BlowUp` when a step falls below `collapse` of the span, `OutOfTime` after the deadline (a time of
    `perf_counter`).

    Modified midpoint rule with 2, 4, 6, … substeps, extrapolated in h² until two neighbours agree
    to `digits` digits: no Taylor series and no heyoka, only evaluations of ``scene.rhs``.
    Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, §II.9.
    """
    context = decimal_context(digits + 15)  # extrapolation amplifies round-off
    twin = with_decimals(scene, context.mpf)
    most = 4 + digits // 2
    tolerance = context.mpf(10) ** -digits

    def slope(y: list[Any]) -> list[Any]:
        return twin.pack(twin.rhs(twin.unpack(y, carry)))

    now, y = context.mpf(0), twin.pack(twin.initial(carry))
    shortest, trial = collapse * context.mpf(times[-1]), context.mpf(times[-1])
    rows, watch = [], Stopwatch(scene, float(times[-1]), deadline)
    for time in map(context.mpf, times):
        while now < time:
            watch.check(float(now))
            step = min(trial, time - now)
            try:
                column, result = extrapolated(slope, y, step, most, tolerance)
            except ArithmeticError:  # it lands on a singularity
                column, result = most, None
            if result is None:
                trial = step / 2
                if trial < shortest:
                    raise BlowUp(scene, now)
                continue
            now, y = (time if step == time - now else now + step), result
            if column < 0.7 * most:
                trial = max(trial, step * 3 / 2)
        rows.append(list(y))
    return rows


def extrapolated(
    slope: Callable[[list[Any]], list[Any]], y: list[Any], step: Any, most: int, tolerance: Any
) -> tuple[int, list[Any] | None]:
    """Return one extrapolated step and the number of columns it took; None if `most` are not enough."""
    first = slope(y)
    previous: Rows = []
    for j in range(1, most + 1):
        h = step / (2 * j)
        old, mid = y, [a + h * f for a, f in zip(y, first, strict=True)]
        for _ in range(2 * j - 1):
            old, mid = mid, [a + 2 * h * f for a, f in zip(old, slope(mid), strict=True)]
        row = [mid]
        for k, below in enumerate(previous, start=1):  # Aitken–Neville in h²
            weight = (step * 0 + j * j) / (j - k) ** 2 - 1
            row.append([a + (a - b) / weight for a, b in zip(row[-1], below, strict=True)])
        if j > 2 and distance(row[-1], row[-2]) <= tolerance * max(map(abs, y)):
            return j, row[-1]
        if max(map(abs, mid)) > 1e6 * (1 + max(map(abs, y))):
            return j, None  # hopeless at this step, and the numbers would only grow
        previous = row
    return most, None
