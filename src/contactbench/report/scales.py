"""Ranges and ticks of axes; the page's script has the same rules."""

from __future__ import annotations

import math
from collections.abc import Iterable

from contactbench.report.drawing import Axis, Curve
from contactbench.report.numbers import SUPERSCRIPTS

PARTS = {0.7: (1, 1.5, 2, 3, 5, 7), 1.5: (1, 2, 5)}


def spanned(axis: Axis, values: Iterable[float]) -> tuple[float, float]:
    """Low and high end: the limits, else what the values need, ended where `within` says if any is left then."""
    log = axis.scale == "log"
    known = [v for v in values if math.isfinite(v) and (v > 0 or not log)]
    bottom, top = (-math.inf if axis.within[0] is None else axis.within[0]), (axis.within[1] or math.inf)
    inside = [v for v in known if bottom <= v <= top]
    cut = bool(inside) and len(inside) < len(known)
    use = [math.log10(v) if log else v for v in (inside or known)]
    low, high = (min(use), max(use)) if use else (0.0, 1.0)
    pad = max(0.1 if log else 1e-12 * abs(high), 0.04 * (high - low)) or 0.5
    low, high = low - pad, high + pad
    if cut and any(v > top for v in known):
        high = math.log10(top) if log else top
    if cut and any(v < bottom for v in known):
        low = math.log10(bottom) if log else bottom
    ends = [10.0**low, 10.0**high] if log else [low, high]
    given = axis.limits or (None, None)
    first, last = (end if fixed is None else fixed for fixed, end in zip(given, ends, strict=True))
    return first, last


def points(curves: Iterable[Curve], which: str, other: Axis, across: str) -> list[float]:
    """What the curves have on one axis, error bars included, where the other axis does not end before."""
    low, high = ((-math.inf if other.within[0] is None else other.within[0]), (other.within[1] or math.inf))
    return [
        v
        for c in curves
        for values in ([c.x] if which == "x" else [c.y, *([] if c.muted else [c.low, c.high])])
        for v, o in zip(values, getattr(c, across), strict=False)  # without bars there are none
        if low <= o <= high
    ]


def power(k: int) -> str:
    return {0: "1", 1: "10"}.get(k, "10" + str(k).translate(SUPERSCRIPTS))


def written(value: float) -> str:
    k = math.floor(math.log10(value) + 1e-9)
    part = float(f"{value / 10.0**k:.2g}")
    if abs(k) < 3:
        return f"{value:.2g}" if value < 100 else f"{value:.0f}"
    return power(k) if part == 1 else f"{part:g}·{power(k)}"


def decades(low: float, high: float, room: float) -> list[tuple[float, str]]:
    """Ticks of a logarithmic axis, at most about `room`."""
    first, last = math.log10(low), math.log10(high)
    step = max(1, math.ceil((last - first) / room))
    parts = next((p for width, p in PARTS.items() if last - first < width), (1,))
    found = [
        part * 10.0**k
        for k in range(math.floor(first), math.ceil(last) + 1)
        for part in (parts if len(parts) > 1 else (1,) if k % step == 0 else ())
    ]
    words = written if len(parts) > 1 else lambda v: power(round(math.log10(v)))
    return [(v, words(v)) for v in found if low <= v * (1 + 1e-9) and v <= high * (1 + 1e-9)]
