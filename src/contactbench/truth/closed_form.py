"""The truth of a scene that carries a closed form."""

from __future__ import annotations

from typing import Any

import numpy as np

from contactbench.scene import Scene
from contactbench.truth.base import with_decimals
from contactbench.truth.digits import Rows, agreeing_digits, decimal_context, distance, place, rounded

CLOSED_FORM_DIGITS = 50


def closed_form(scene: Scene, t: np.ndarray, carry: tuple[str, ...]) -> tuple | None:
    """Return decimals, digits and source from the scene's closed form, or None if it lacks a field."""
    probe = closed_form_columns(scene, t[:1], carry)  # elliptic functions at every time are slow
    if probe is None or None in probe or (columns := closed_form_columns(scene, t, carry)) is None:
        return None
    digits = min(known for _, known in columns)
    return [list(row) for row in zip(*(c for c, _ in columns), strict=True)], digits, "closed form"


def closed_form_columns(scene: Scene, t: np.ndarray, carry: tuple[str, ...]) -> list | None:
    """Return decimals and digits of every column of the closed form; None for a column it lacks.

    Evaluated at two precisions; every entry keeps its own agreeing significant digits.  None where
    the scene has no closed form, or has one that does not solve its equations (as after a change
    of a parameter the formula leaves out).
    """
    if scene.exact is None or not solves_equations(scene, float(t.max())):
        return None
    low, high = (closed_form_rows(scene, t, carry, CLOSED_FORM_DIGITS + extra) for extra in (0, 15))
    columns: list = []
    for a, b in zip(zip(*low, strict=True), zip(*high, strict=True), strict=True):
        if b[0] is None:
            columns.append(None)
            continue
        pairs = list(zip(a, b, strict=True))
        known = [agreeing_digits([[x]], [[y]], CLOSED_FORM_DIGITS) for x, y in pairs]
        decimals = [rounded(y, place(y, max(n, 1))) for y, n in zip(b, known, strict=True)]
        columns.append((decimals, agreeing_digits([[x] for x in a], [[y] for y in b], CLOSED_FORM_DIGITS)))
    return columns


def closed_form_rows(scene: Scene, t: np.ndarray, carry: tuple[str, ...], digits: int) -> Rows:
    """Return the closed form in mpmath numbers of so many digits, None for what it does not know."""
    context = decimal_context(digits)
    twin = with_decimals(scene, context.mpf)
    start = twin.initial(carry)
    rows = []
    for time in t.tolist():
        state = twin.exact(twin, context.mpf(repr(time)), context)  # type: ignore[misc]
        row: list[Any] = []
        for known, part in zip(state, start, strict=True):
            if part is not None:  # carried
                row += [None] * len(twin.pack((part,))) if known is None else twin.pack((known,))
        rows.append(row)
    return rows


def solves_equations(scene: Scene, end: float) -> bool:
    """Return whether the closed form starts at the initial data and obeys the right-hand side.

    Central differences of step 10⁻²⁰ at 65 digits, so a right formula passes with room to spare.
    """
    if scene.conformal_rate is None and scene.clock is None:
        return False  # κ ≠ 0 or a matrix D: no closed form of ours covers it
    context = decimal_context(CLOSED_FORM_DIGITS + 15)
    twin = with_decimals(scene, context.mpf)
    exact = lambda t: twin.exact(twin, t, context)  # type: ignore[misc]  # noqa: E731
    step = context.mpf(10) ** -20
    start = [0 if part is None else part for part in twin.initial(scene.optional)]
    for known, part in zip(exact(context.mpf(0)), start, strict=True):
        if known is not None and distance(twin.pack((known,)), twin.pack((part,))) > step:
            return False
    for time in (end / 3, end):
        t = context.mpf(repr(time))
        slope = twin.pack(twin.rhs(exact(t)))
        before, after = twin.pack(exact(t - step)), twin.pack(exact(t + step))
        difference = [(b - a) / (2 * step) for a, b in zip(before, after, strict=True)]
        if distance(slope, difference) > 1e-15 * max(map(abs, slope)):
            return False
    return True
