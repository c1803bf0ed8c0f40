"""The truth: a closed form, a frozen file, or a live high-precision solution, in that order.

Numbers of a scene and times are taken as the decimals they print as (0.1 means one tenth), so that
the truth does not depend on a float's binary expansion.  No method under test is imported here.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from contactbench.boundary import is_ours, plain_function
from contactbench.boundary import place as place_of
from contactbench.errors import BadInput, excerpt, is_real, one_line
from contactbench.scene import Scene, verify
from contactbench.scene.cache import Cache, key
from contactbench.scene.definition import verify_along
from contactbench.scene.many import Many
from contactbench.scenes import scene_of
from contactbench.truth.base import NEVER, BlowUp, Reference, checked_times, digest
from contactbench.truth.closed_form import closed_form, closed_form_columns
from contactbench.truth.digits import (
    Rows,
    agreeing_digits,
    decimal_context,
    disagreement,
    matching_digits,
    place,
    rounded,
    scales,
)
from contactbench.truth.extrapolation import extrapolation
from contactbench.truth.frozen import frozen, frozen_entry
from contactbench.truth.many import FEW, doubles
from contactbench.truth.taylor import heyoka_reads_rhs, taylor

#: bits of the lower of two precisions, tried in turn until enough digits agree
LIVE_BITS = (140, 300, 600)


#: seconds that a live reference may take unless more are allowed
LIVE_SECONDS = 300.0

_cache: Cache[Reference] = Cache(1024)


def reference(
    scene: Scene | str, times: Any, carry: Sequence[str] | None = None, seconds: float = LIVE_SECONDS
) -> Reference:
    """Return the truth of a scene, itself or by name, at `times` (k,), any order, t ≥ 0; `carry` as in `solve`.

    Parameters
    ----------
    times
        A time within 4 units in the last place of a frozen grid time means that grid time.
    seconds
        How long a live computation may take; it ends sooner where it is seen to need far more.

    Raises
    ------
    BadInput
        For times that are negative or not finite, and where no reference can be computed: the trajectory blows up
        before the last time, or too few digits can be had.
    OutOfTime
        A `BadInput`, where it would take too long.
    """
    scene = scene_of(scene)
    if not is_real(seconds) or not hasattr(seconds, "__float__") or seconds != seconds:
        raise BadInput(f"seconds = {excerpt(seconds)}: must be a number")
    carry = scene.carry(carry)
    t = checked_times(times)
    verify(scene)
    verify_along(scene)

    def make() -> Reference:
        if isinstance(scene, Many):
            return of_many(scene, t, carry, seconds)
        found = closed_form(scene, t, carry) or frozen(scene, t, carry)
        found = found or live(scene, t, carry, perf_counter() + seconds)
        decimals, digits, source = found
        y = np.array([[float(x) for x in row] for row in decimals])
        t.setflags(write=False)
        y.setflags(write=False)  # shared by every caller through the cache
        return Reference(scene, carry, t, y, decimals, digits, source)

    known = scene.exact is None or is_ours(scene.exact)
    return _cache.get(
        key(scene.identity if known else None, digest(scene), scene.exact, carry, t.tobytes()), make
    )


def of_many(scene: Many, t: np.ndarray, carry: tuple[str, ...], seconds: float) -> Reference:
    """Return the truth of a scene of many sites: of few of them, component by component, to many digits."""
    if scene.motion <= FEW and scene.exact is None:
        found = reference(scene.unrolled(), t, carry, seconds)
        return replace(found, scene=scene)
    unique, back = np.unique(t, return_inverse=True)
    if scene.exact is not None:
        rows = [scene.pack(_carried(scene.exact(scene, time, np), carry)) for time in unique.tolist()]
        y, digits, source = np.array(rows), 13, "closed form"
    else:
        y, digits = doubles(scene, unique, carry, perf_counter() + seconds)
        source = "live"
    y = y[back]
    y.setflags(write=False)
    return Reference(scene, carry, t, y, [], digits, source)


def _carried(x: Any, carry: tuple[str, ...]) -> Any:
    return x if "s" in carry else x._replace(s=None)


def live(scene: Scene, t: np.ndarray, carry: tuple[str, ...], deadline: float = NEVER) -> tuple:
    """Return decimals, digits and source from two precisions, keeping the digits that agree.

    heyoka's Taylor series where it is installed, else extrapolation in mpmath.  Enough means 20
    digits of every column and of the smallest state along the way, neither counted as less than
    10⁻⁶⁰ of the largest.  Where entries decay below 10⁻²⁰, columns known in closed form are taken
    from there, relative digits and all.
    """
    unique, back = np.unique(t, return_inverse=True)
    times = [repr(x) for x in unique.tolist()]
    start = scene.pack(scene.initial(carry))
    exact: list | None = None
    for rows, other in computations(scene, times, carry, deadline):
        size = max(abs(x) for row in [*rows, start] for x in row)
        if exact is None:
            faint = any(0 < abs(x) < 1e-20 * size for row in rows for x in row)
            exact = (closed_form_columns(scene, unique, carry) if faint else None) or [None] * len(start)
        floor, smallest = 1e-60 * size, min(max(map(abs, row)) for row in rows)
        sizes = [max(scale, floor) for scale in scales(rows)]
        errors = disagreement(other, rows)
        wanted = [1e-20 * max(min(scale, smallest), floor) for scale in sizes]
        if all(e <= w or x for e, w, x in zip(errors, wanted, exact, strict=True)):
            break
    else:
        raise BadInput(
            f"no reference for scene {scene.name!r} at t = {t.max():g}: "
            "two high precisions disagree, the trajectory is too sensitive to its initial data"
        )
    columns = []
    for known, column, error, scale in zip(exact, zip(*rows, strict=True), errors, sizes, strict=True):
        digits = matching_digits(error / scale, 40)
        columns.append(known or ([rounded(x, place(scale, digits)) for x in column], digits))
    decimals = list(zip(*(column for column, _ in columns), strict=True))
    return [list(decimals[k]) for k in back], min(digits for _, digits in columns), "live"


def computations(
    scene: Scene, times: list[str], carry: tuple[str, ...], deadline: float = NEVER
) -> Iterator[tuple[Rows, Rows]]:
    """Return pairs (more, less precise) of solutions, each pair more precise than the one before."""
    try:
        if importlib.util.find_spec("heyoka") is not None:
            for bits in LIVE_BITS:
                rows = taylor(scene, times, carry, bits + bits // 4, deadline=deadline)
                if not heyoka_reads_rhs(scene, rows[-1], carry):
                    break
                yield rows, taylor(scene, times, carry, bits, deadline=deadline)
        for digits in (28, 70):
            more, fewer = (
                extrapolation(scene, times, carry, n, deadline=deadline) for n in (digits + 8, digits)
            )
            yield more, fewer
    except BadInput:
        raise
    except Exception as error:
        says = plain_function(error) or f"{type(error).__name__}: {one_line(error, 150)}"
        raise BadInput(
            f"no reference for scene {scene.name!r}: its equations fail in high precision{place_of(error)}: {says}"
        ) from error


#: digits that the second engine is asked for
CONFIRMED_DIGITS = 20


def confirmed(found: Reference, seconds: float = NEVER) -> int | None:
    """Return the digits of a reference that extrapolation, independent of Taylor series, confirms; at most 20.

    t ascending.  None where there was no time for it, or the reference is from that engine itself.
    """
    if found.source == "live" and importlib.util.find_spec("heyoka") is None:
        return None
    times = [repr(x) for x in found.t.tolist()]
    try:
        rows = extrapolation(
            found.scene, times, found.carry, CONFIRMED_DIGITS, deadline=perf_counter() + seconds
        )
    except BadInput:
        return None
    context = decimal_context(CONFIRMED_DIGITS + 15)
    own = [[context.mpf(x) for x in row] for row in found.decimals]
    return agreeing_digits(rows, own, CONFIRMED_DIGITS)


#: a step this small against the span tells the time of blow-up to as many digits, less a few
BLOW_UP_COLLAPSE = 1e-45


def blow_up_time(scene: Scene) -> tuple[str, int] | None:
    """Return when the trajectory reaches infinity, as a decimal string, and how many digits of it are known.

    Frozen where it is stored, else from heyoka's Taylor series at two precisions: steps shrink in
    proportion to the time that is left.  None if the trajectory is finite up to the scene's t_end, as
    those known in closed form are.
    """
    if scene.exact is not None:
        return None
    entry = frozen_entry(scene)
    if entry is not None:
        known = entry.get("blow_up")
        return (known["time"], known["digits"]) if known else None
    low, high = (taylor_blow_up(scene, bits) for bits in (200, 260))
    if low is None or high is None:
        return None
    digits = agreeing_digits([[low]], [[high]], 40)
    return rounded(high, place(high, digits)), digits


def taylor_blow_up(scene: Scene, bits: int) -> Any:
    """Return the time of blow-up by heyoka at one precision, an mpmath number, or None."""
    try:
        taylor(scene, [repr(scene.t_end)], scene.carry(), bits, BLOW_UP_COLLAPSE)
    except BlowUp as found:
        return found.time
    return None
