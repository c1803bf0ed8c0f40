"""The truth: a closed form, a frozen file, a live high-precision solution, or two solvers in double precision.

The first one that exists is used.  Numbers of a scene and times are read as decimals (0.1 means one tenth), so that
the truth does not depend on binary expansions.  No method under test is imported here.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from contactbench.blame import is_ours, plain_function, their_code
from contactbench.blame import place as place_of
from contactbench.checks import is_real, real_array
from contactbench.errors import BadInput, excerpt, one_line
from contactbench.numbers.protocol import Arithmetic, Namespace
from contactbench.scene import AnyState, Cache, Scene, key, verify
from contactbench.scene.base import Elapsed, OwnState, scene_of, time_between
from contactbench.scene.definition import verify_along
from contactbench.truth.engines import (
    LOOKS,
    NEVER,
    BlowUp,
    DoublesOnly,
    OutOfTime,
    Rows,
    agreeing_digits,
    decimal_context,
    disagreement,
    distance,
    extrapolation,
    heyoka_reads_rhs,
    lost_at_breaks,
    matching_digits,
    no_reference,
    place,
    rounded,
    scales,
    taylor,
    with_decimals,
)
from contactbench.truth.frozen import digest, entries, frozen
from contactbench.truth.survey import Survey
from contactbench.truth.two_solvers import doubles

#: bits of the lower of two precisions; the next pair is tried if too few digits agree
LIVE_BITS = (140, 300, 600)
#: right-hand sides in numbers of LIVE_DIGITS digits that take as long as the first step of a Taylor series
FIRST_STEP, LIVE_DIGITS = 100, 50
#: default limit of seconds for a live reference
LIVE_SECONDS = 300.0
#: allowed error of a closed form in double precision
CLOSE = 1e-6
#: the part of the time for high precision, the rest is for two solvers; the part of either for the survey
HIGH, SURVEY = 0.5, 0.3


@dataclass(frozen=True, repr=False)
class Reference:
    """Hold the true states of a scene at given times.

    Attributes
    ----------
    scene, carry
        What was solved, and which of s and R the states contain.
    t, y
        Times since the start, (k,), and states, (k, d), correctly rounded, columns as in ``scene.labels(carry)``.
    decimals
        The same numbers as k rows of d decimal strings with all known digits.
    digits
        Number of correct decimal digits relative to the largest entry of a column, for the worst column.
    source
        "closed form", "frozen", "live", or "two solvers", which has no decimals.
    """

    scene: Scene
    carry: tuple[str, ...]
    t: np.ndarray
    y: np.ndarray
    decimals: list[list[str]]
    digits: int
    source: str

    def __repr__(self) -> str:
        end = self.t.max() + self.scene.begins
        what = f"{len(self.t)} states to t = {end:.10g}, {self.digits} digits, {self.source}"
        return f"<Reference of {self.scene.name}: {what}>"

    def states(self) -> OwnState:
        """Return the states as one NamedTuple of arrays over time."""
        return self.scene.unpack(self.y.T, self.carry)


def checked_times(scene: Scene, times: object) -> np.ndarray:
    """Return times of the scene's clock, or `Elapsed`, as times since its start, (k,), k ≥ 1, or `BadInput`."""
    given, start = (times.times, 0.0) if isinstance(times, Elapsed) else (times, scene.begins)
    least = f"finite numbers ≥ {start:.10g}"
    t = np.array(real_array("times", given, least), ndmin=1)  # a copy
    if t.ndim != 1 or not t.size:
        raise BadInput(f"times: must be one number or a flat list of numbers, not of shape {t.shape}")
    for wrong in t[~(np.isfinite(t) & (t >= start))][:1].tolist():
        raise BadInput(f"times contain {wrong!r}: must be {least}")
    return np.array([time_between(start, time) for time in t.tolist()]) if start else t


#: rows of decimals, the number of correct digits, and their source
type Stored = tuple[list[list[str]], int, str]

_cache: Cache[Reference] = Cache(1024)


def reference(
    scene: Scene | str, times: ArrayLike, carry: Sequence[str] | None = None, seconds: float = LIVE_SECONDS
) -> Reference:
    """Return the true states of a scene at given times.

    Parameters
    ----------
    scene
        A scene, or the name of a registered one.
    times
        Times from the scene's t on (from 0 on where nothing depends on the time), in any order, (k,), or one number.
        A time within 4 units in the last place of a frozen grid time means that grid time.
    carry
        Which of s and R to give; by default all the scene has.
    seconds
        Limit of time for a live computation; it ends sooner if it would need far more.

    Returns
    -------
    Reference
        The states, (k, d), correctly rounded, and all known digits as strings.

    Raises
    ------
    BadInput
        For times before the start or not finite, and if no reference can be computed: the trajectory blows up before
        the last time, or too few digits are known.
    OutOfTime
        A `BadInput`, if it would take too long.

    Examples
    --------
    >>> import contactbench as cb
    >>> cb.reference("oscillator", [1.0, 2.0], carry=()).y.shape
    (2, 2)
    """
    begun, scene = perf_counter(), scene_of(scene)
    if not is_real(seconds) or not hasattr(seconds, "__float__") or seconds != seconds:
        raise BadInput(f"seconds = {excerpt(seconds)}: must be a number")
    carry = scene.carry(carry)
    t = checked_times(scene, times)
    verify(scene)
    verify_along(scene)

    def make() -> Reference:
        stored = closed_form(scene, t, carry, begun + HIGH * seconds) or frozen(scene, t, carry)
        decimals, digits, source = stored or live(scene, t, carry, begun + HIGH * seconds)
        y = np.array([[float(x) for x in row] for row in decimals])
        t.setflags(write=False)
        y.setflags(write=False)  # shared by every caller through the cache
        return Reference(scene, carry, t, y, decimals, digits, source)

    identity = scene.identity if scene.exact is None or is_ours(scene.exact) else None
    try:
        return _cache.get(key(identity, digest(scene), scene.exact, carry, t.tobytes()), make)
    except (OutOfTime, DoublesOnly):
        pass
    try:  # high precision, which may compile for long, does not use up the time of the two solvers
        return by_two_solvers(scene, t, carry, max(begun + seconds, perf_counter() + (1 - HIGH) * seconds))
    except OutOfTime as why:
        raise OutOfTime(str(why), why.needed / (1 - HIGH)) from why


def by_two_solvers(scene: Scene, t: np.ndarray, carry: tuple[str, ...], deadline: float) -> Reference:
    unique, back = np.unique(t, return_inverse=True)
    survey = surveyed(scene, carry, float(unique[-1]), deadline)
    y, digits = doubles(scene, unique, carry, deadline, survey.stops, 10 * survey.blur)
    if survey.ended and scene.clock is not None:  # both may have stepped over a pulse
        raise survey.ended
    return Reference(scene, carry, t, y[back], [], digits, "two solvers")


# -- closed forms ------------------------------------------------------------------------------------
CLOSED_FORM_DIGITS = 50
#: for every column its decimals and the number of correct digits; None for an unknown column
type Columns = list[tuple[list[str], int] | None]


def exact_state(scene: Scene, t: Arithmetic, xp: Namespace) -> AnyState:
    """Return the closed form of a scene at t; raise an error inside as a `UserError`."""
    assert scene.exact is not None
    with their_code(f"scene {scene.name!r}: its closed form"):
        state: AnyState = scene.exact(scene, t, xp)
        return state


def closed_form(
    scene: Scene, t: np.ndarray, carry: tuple[str, ...], deadline: float = NEVER
) -> Stored | None:
    """Return decimals, digits and source from the scene's closed form, or None if it lacks a field."""
    columns = closed_form_columns(scene, t, carry, deadline, whole=True)
    if columns is None:
        return None
    decimals, digits = zip(*filter(None, columns), strict=True)
    return [list(row) for row in zip(*decimals, strict=True)], min(digits), "closed form"


def closed_form_columns(
    scene: Scene, t: np.ndarray, carry: tuple[str, ...], deadline: float = NEVER, whole: bool = False
) -> Columns | None:
    """Return decimals and digits of every column of the closed form, by two precisions; None for a missing column.

    Return None if no closed form solves the equations, or, if `whole`, if a column is missing.
    """
    if scene.exact is None or not solves_equations(scene, carry, float(t.max()), deadline):
        return None
    if whole and None in closed_form_rows(scene, t[:1], carry, CLOSED_FORM_DIGITS)[0]:
        return None  # known from one time: elliptic functions are slow
    low, high = (closed_form_rows(scene, t, carry, CLOSED_FORM_DIGITS + extra) for extra in (0, 15))
    columns: Columns = []
    for a, b in zip(zip(*low, strict=True), zip(*high, strict=True), strict=True):
        if b[0] is None:
            columns.append(None)
            continue
        digits = [agreeing_digits([[x]], [[y]], CLOSED_FORM_DIGITS) for x, y in zip(a, b, strict=True)]
        decimals = [rounded(y, place(y, max(n, 1))) for y, n in zip(b, digits, strict=True)]
        columns.append((decimals, agreeing_digits([[x] for x in a], [[y] for y in b], CLOSED_FORM_DIGITS)))
    return columns


def closed_form_rows(scene: Scene, t: np.ndarray, carry: tuple[str, ...], digits: int) -> Rows:
    """Return the closed form in mpmath numbers of so many digits, None for missing components."""
    context = decimal_context(digits)
    twin = with_decimals(scene, context.mpf)
    start = twin.initial(carry)
    rows = []
    for time in t.tolist():
        state = exact_state(twin, context.mpf(repr(time)), context)
        row: list[Any] = []
        for known, part in zip(state, start, strict=True):
            if part is not None:  # carried
                row += [None] * len(twin.pack((part,))) if known is None else twin.pack((known,))
        rows.append(row)
    return rows


def solves_equations(scene: Scene, carry: tuple[str, ...], end: float, deadline: float = NEVER) -> bool:
    """Return whether the closed form starts at the initial data and satisfies the equations, by differences.

    A user's closed form for a scene with time is tested in all pieces of the motion: it may miss a pulse.
    """
    if scene.conformal_rate is None and scene.clock is None:
        return False  # κ ≠ 0 or a matrix D: no closed form of ours covers it
    context = decimal_context(CLOSED_FORM_DIGITS + 15)
    twin = with_decimals(scene, context.mpf)
    exact = lambda t: exact_state(twin, t, context)  # noqa: E731
    step = context.mpf(10) ** -20
    start = [0 if part is None else part for part in twin.initial(scene.optional)]
    for known, part in zip(exact(context.mpf(0)), start, strict=True):
        if known is not None and distance(twin.pack((known,)), twin.pack((part,))) > step:
            return False
    times = [end / 3, end]
    if scene.clock is not None and not is_ours(scene.exact):
        with suppress(BadInput):
            stops = [0.0, *surveyed(scene, carry, end, deadline).stops]
            middle = [(a + b) / 2 for a, b in pairwise([*stops, end])]
            times += [*stops[1 :: 1 + len(stops) // LOOKS], *middle[:: 1 + len(middle) // LOOKS]]
    for time in times:
        t = context.mpf(repr(float(time)))
        slope = twin.pack(twin.rhs(exact(t)))
        before, after = twin.pack(exact(t - step)), twin.pack(exact(t + step))
        difference = [(b - a) / (2 * step) for a, b in zip(before, after, strict=True)]
        if distance(slope, difference) > 1e-15 * max(map(abs, slope)):
            return False
    return True


_surveys: Cache[Survey] = Cache(64)


def surveyed(scene: Scene, carry: tuple[str, ...], end: float, deadline: float) -> Survey:
    """Return the survey of a motion, with its stops computed."""

    def make() -> Survey:
        now, share = perf_counter(), SURVEY if scene.clock is None else 1.0
        survey = Survey(scene, carry, end, now + share * (deadline - now))
        survey.stops  # noqa: B018
        return survey

    survey = _surveys.get(key(scene.identity, digest(scene), carry, end), make)
    survey.deadline = deadline
    return survey


#: most digits of a motion that has breaks, which are known to double precision, or that was not surveyed
BROKEN = 14


# -- live --------------------------------------------------------------------------------------------
def live(scene: Scene, t: np.ndarray, carry: tuple[str, ...], deadline: float = NEVER) -> Stored:
    """Return decimals, digits and source from two precisions of heyoka or, without it, extrapolation.

    It needs 20 digits of every column and of the smallest state, relative to at least 10⁻⁶⁰ of the largest state.
    If entries decay below 10⁻²⁰, columns with a closed form are taken from it.
    """
    unique, back = np.unique(t, return_inverse=True)
    survey = surveyed(scene, carry, float(unique[-1]), deadline)
    every = np.union1d(unique, survey.stops)
    times, saved = [repr(x) for x in every.tolist()], np.searchsorted(every, unique).tolist()
    start = scene.pack(scene.initial(carry))
    exact: Columns | None = None
    for pair in computations(scene, times, carry, deadline, survey.stops):
        rows, other = ([part[k] for k in saved] for part in pair)
        size = max(abs(x) for row in [*rows, start] for x in row)
        if exact is None:
            faint = any(0 < abs(x) < 1e-20 * size for row in rows for x in row)
            known = closed_form_columns(scene, unique, carry, deadline) if faint else None
            exact = known or [None] * len(start)
        floor, smallest = 1e-60 * size, min(max(map(abs, row)) for row in rows)
        sizes = [max(scale, floor) for scale in scales(rows)]
        errors = disagreement(other, rows)
        wanted = [1e-20 * max(min(scale, smallest), floor) for scale in sizes]
        if all(e <= w or x for e, w, x in zip(errors, wanted, exact, strict=True)):
            break
    else:
        why = "two high precisions disagree, the trajectory is too sensitive to its initial data"
        raise BadInput(f"no reference for scene {scene.name!r} at t = {t.max():g}: {why}")
    states = np.array(pair[0], dtype=float)
    survey.check(every.tolist(), states)
    moving = states if scene.clock is None else np.delete(states, scene.clock, axis=1)
    lost = lost_at_breaks(survey.slope, survey.breaks, every.tolist(), moving)
    most = BROKEN if survey.breaks or survey.unseen else 40
    columns = []
    for given, column, error, scale in zip(exact, zip(*rows, strict=True), errors, sizes, strict=True):
        digits = matching_digits((error + lost) / scale, most)
        columns.append(given or ([rounded(x, place(scale, digits)) for x in column], digits))
    decimals = list(zip(*(column for column, _ in columns), strict=True))
    return [list(decimals[k]) for k in back], min(digits for _, digits in columns), "live"


def computations(
    scene: Scene, times: list[str], carry: tuple[str, ...], deadline: float, stops: Sequence[float]
) -> Iterator[tuple[Rows, Rows]]:
    """Yield pairs (more precise, less precise) of solutions with increasing precision."""

    def half() -> float:
        """Return the deadline of the first solution of a pair: the other takes about as long."""
        return (perf_counter() + deadline) / 2

    def foresee() -> None:
        """Raise `OutOfTime` if the first step, which cannot be interrupted, would take too long."""
        twin, begun, spent = with_decimals(scene, decimal_context(LIVE_DIGITS).mpf), perf_counter(), NEVER
        for _ in range(2):  # the first one may be disturbed
            now = perf_counter()
            with suppress(ArithmeticError):
                twin.rhs(twin.initial(carry))
            spent = min(spent, perf_counter() - now)
        if FIRST_STEP * spent > half() - begun:
            raise OutOfTime(f"no reference for scene {scene.name!r} in high precision: a step takes too long")

    try:
        foresee()
        if importlib.util.find_spec("heyoka") is not None:
            for bits in LIVE_BITS:
                rows = taylor(scene, times, carry, bits + bits // 4, deadline=half(), stops=stops)
                if not heyoka_reads_rhs(scene, rows, carry):
                    break
                yield rows, taylor(scene, times, carry, bits, deadline=deadline, stops=stops)
        for digits in (28, 70):
            rows = extrapolation(scene, times, carry, digits + 8, deadline=half())
            yield rows, extrapolation(scene, times, carry, digits, deadline=deadline)
    except BadInput:
        raise
    except Exception as error:
        better = plain_function(error)
        says = better or f"{type(error).__name__}: {one_line(error, 150)}"
        why = f"its equations fail in high precision{place_of(error)}: {says}"
        raise (BadInput if better else DoublesOnly)(no_reference(scene, why)) from error


def confirmed(found: Reference, seconds: float = NEVER) -> int | None:
    """Return the number of digits (≤ 20) that extrapolation confirms; None if it is the source or takes too long."""
    if not found.decimals or (found.source == "live" and importlib.util.find_spec("heyoka") is None):
        return None
    scene = found.scene
    digits, deadline = 20, perf_counter() + seconds
    try:
        stops = surveyed(scene, found.carry, float(found.t.max()), deadline).stops
        every = np.union1d(found.t, stops)
        times = [repr(x) for x in every.tolist()]
        computed = extrapolation(scene, times, found.carry, digits, deadline=deadline)
    except BadInput:
        return None
    rows = [computed[k] for k in np.searchsorted(every, found.t).tolist()]
    context = decimal_context(digits + 15)
    own = [[context.mpf(x) for x in row] for row in found.decimals]
    return agreeing_digits(rows, own, digits)


#: relative size of a step at which the time of blow-up is known to about 45 digits
BLOW_UP_COLLAPSE = 1e-45


def blow_up_time(scene: Scene) -> tuple[str, int] | None:
    """Return the time of blow-up as a decimal string, and its digits; None if the motion is finite to t_end."""
    if scene.exact is not None:
        return None
    for entry in entries(scene):
        found = entry.get("blow_up")
        return (found["time"], found["digits"]) if found else None
    low, high = (taylor_blow_up(scene, bits) for bits in (200, 260))
    if low is None or high is None:
        return None
    digits = agreeing_digits([[low]], [[high]], 40)
    return rounded(high, place(high, digits)), digits


def taylor_blow_up(scene: Scene, bits: int) -> Arithmetic | None:
    try:
        taylor(scene, [repr(scene.t_end)], scene.carry(), bits, BLOW_UP_COLLAPSE)
    except BlowUp as found:
        return found.time
    return None
