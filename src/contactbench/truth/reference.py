"""The truth: a closed form, a frozen file, or a live high-precision solution, in that order.

Numbers of a scene and times are taken as the decimals they print as (0.1 means one tenth), so that
the truth does not depend on a float's binary expansion.  No method under test is imported here.
"""

from __future__ import annotations

import csv
import hashlib
import importlib.util
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from decimal import Decimal, localcontext
from functools import lru_cache
from pathlib import Path
from typing import Any

import mpmath
import numpy as np

from contactbench.errors import BadInput
from contactbench.scene import Scene

Rows = list[list[Any]]  #: one list of components per time


class BlowUp(BadInput):
    """The trajectory reaches infinity at `time`, an mpmath number."""

    def __init__(self, scene: Scene, time: Any) -> None:
        super().__init__(
            f"no reference for scene {scene.name!r}: the trajectory blows up at t = {float(time):.6g}"
        )
        self.time = time


CLOSED_FORM_DIGITS = 50
#: bits of the lower of two precisions, tried in turn until enough digits agree
LIVE_BITS = (140, 300, 600)
MAX_STEPS = 1_000_000
#: a step this small against the whole span means a singularity ahead, not a fast motion
COLLAPSE = 1e-12


@dataclass(frozen=True)
class Reference:
    """The true states of a scene at given times.

    t : (k,).  y : (k, d) float64, correctly rounded, columns as in ``scene.labels(carry)``.
    decimals : the same numbers as k rows of d decimal strings with every digit that is known.
    digits : decimal digits known to be right, relative to the largest entry of a column, the
    worst column.  source : "closed form", "frozen" or "live".
    """

    scene: Scene
    carry: tuple[str, ...]
    t: np.ndarray
    y: np.ndarray
    decimals: list[list[str]]
    digits: int
    source: str

    def states(self) -> Any:
        """The states as one NamedTuple of arrays over time."""
        return self.scene.unpack(tuple(self.y.T), self.carry)


_cache: dict[Any, Reference] = {}


def reference(scene: Scene, times: Any, carry: Sequence[str] | None = None) -> Reference:
    """The truth of a scene at `times` (k,), any order, t ≥ 0; `carry` as in `solve`, default all.

    A time within 4 units in the last place of a frozen grid time means that grid time.
    Raises `BadInput` for times that are negative or not finite, and when no reference can be
    computed: the trajectory blows up before the last time, or too few digits can be had.
    """
    carry = scene.carry(carry)
    t = checked_times(times)
    key = (digest(scene), scene.structure, scene.exact, carry, t.tobytes())
    if key not in _cache:
        found = closed_form(scene, t, carry) or frozen(scene, t, carry) or live(scene, t, carry)
        decimals, digits, source = found
        y = np.array([[float(x) for x in row] for row in decimals])
        t.setflags(write=False)
        y.setflags(write=False)  # shared by every caller through the cache
        _cache[key] = Reference(scene, carry, t, y, decimals, digits, source)
    return _cache[key]


def checked_times(times: Any) -> np.ndarray:
    """`times` as a new float array of shape (k,), k ≥ 1, or `BadInput`."""
    try:
        t = np.atleast_1d(np.array(times, dtype=float))
    except (TypeError, ValueError):
        raise BadInput(f"times = {times!r}: must be finite numbers ≥ 0") from None
    if t.ndim != 1 or not t.size:
        raise BadInput(f"times: must be one number or a flat list of numbers, not of shape {t.shape}")
    for wrong in t[~(np.isfinite(t) & (t >= 0))][:1].tolist():
        raise BadInput(f"times contain {wrong!r}: must be finite numbers ≥ 0")
    return t


# -- a scene with other numbers, and its fingerprint -----------------------------------------------
def with_decimals(scene: Scene, number: Callable[[str], Any]) -> Scene:
    """The scene with every float x, initial data included, replaced by ``number(repr(x))``."""

    def convert(value: Any) -> Any:
        return tuple(map(convert, value)) if isinstance(value, tuple) else number(repr(float(value)))

    start = {name: convert(getattr(scene, name)) for name in scene.initial_fields}
    return scene.with_numbers([convert(x) for x in scene.numbers()])._replaced(**start)


def digest(scene: Scene) -> str:
    """SHA-256 of what determines the trajectory: kind, functions, numbers and initial data.

    The scene's own name, its end time, and the Hessian and closed form (which follow from the rest)
    do not count.
    """
    functions = [
        [f.name, getattr(value, "__module__", ""), getattr(value, "__qualname__", repr(value))]
        for f in fields(scene)
        if f.name not in ("exact", "hessian") and callable(value := getattr(scene, f.name))
    ]
    kind = type(scene)
    package = ".".join(kind.__module__.split(".")[:2])  # where it is imported from, not where it is written
    definition = [
        f"{package}.{kind.__qualname__}",
        functions,
        list(getattr(scene, "parameters", {})),
        [repr(float(x)) for x in scene.numbers()],
        [[repr(float(x)) for x in np.ravel(getattr(scene, name))] for name in scene.initial_fields],
    ]
    return hashlib.sha256(json.dumps(definition).encode()).hexdigest()


# -- agreement of two computations -----------------------------------------------------------------
def scales(rows: Rows) -> list[Any]:
    """The largest |entry| of every column (1 for a column of zeros)."""
    return [max(abs(x) for x in column) or 1 for column in zip(*rows, strict=True)]


def disagreement(a: Rows, b: Rows) -> list[Any]:
    """max_k |a − b| of every column."""
    pairs = zip(zip(*a, strict=True), zip(*b, strict=True), strict=True)
    return [max(abs(x - y) for x, y in zip(p, q, strict=True)) for p, q in pairs]


def agreeing_digits(a: Rows, b: Rows, at_most: int) -> int:
    """Decimal digits to which two computations agree, relative to the scale of the worst column."""
    worst = max(e / scale for e, scale in zip(disagreement(a, b), scales(b), strict=True))
    return matching_digits(worst, at_most)


def matching_digits(error: Any, at_most: int) -> int:
    """Whole decimal digits that a relative error leaves."""
    return at_most if error == 0 else max(0, min(at_most, int(mpmath.floor(-mpmath.log10(error)))))


def rounded(value: Any, places: int) -> str:
    """A number to a number of decimal places (half to even), in plain or scientific notation."""
    with localcontext() as context:
        context.prec = 200
        exact = Decimal(mpmath.nstr(value, 100))
        return str(exact.quantize(Decimal(1).scaleb(-places)))


def place(value: Any, digits: int) -> int:
    """The decimal place of the last of `digits` significant digits of value."""
    return digits if value == 0 else digits - 1 - int(mpmath.floor(mpmath.log10(abs(value))))


def print_columns(rows: Rows, digits: int) -> list[list[str]]:
    """Every column to `digits` digits of its scale."""
    places = [place(scale, digits) for scale in scales(rows)]
    return [[rounded(x, p) for x, p in zip(row, places, strict=True)] for row in rows]


# -- closed form -----------------------------------------------------------------------------------
def closed_form(scene: Scene, t: np.ndarray, carry: tuple[str, ...]) -> tuple | None:
    """Decimals, digits and source from the scene's closed form, or None if it lacks a field."""
    probe = closed_form_columns(scene, t[:1], carry)  # elliptic functions at every time are slow
    if probe is None or None in probe or (columns := closed_form_columns(scene, t, carry)) is None:
        return None
    digits = min(known for _, known in columns)
    return [list(row) for row in zip(*(c for c, _ in columns), strict=True)], digits, "closed form"


def closed_form_columns(scene: Scene, t: np.ndarray, carry: tuple[str, ...]) -> list | None:
    """Decimals and digits of every column of the closed form; None for a column it lacks.

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
    """The closed form in mpmath numbers of so many digits, None for what it does not know."""
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
    """Whether the closed form starts at the initial data and obeys the right-hand side.

    Central differences of step 10⁻²⁰ at 65 digits, so a right formula passes with room to spare.
    """
    if scene.conformal_rate is None:  # κ ≠ 0 or a matrix D: no closed form of ours covers it
        return False
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


def distance(a: Sequence[Any], b: Sequence[Any]) -> Any:
    """max |a − b|."""
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


def decimal_context(digits: int) -> Any:
    """An mpmath context of its own, so that nobody's global precision is touched."""
    context = mpmath.MPContext()
    context.dps = digits
    return context


# -- frozen files ----------------------------------------------------------------------------------
def frozen_folder() -> Path | None:
    """Where the frozen files are: beside the sources, or inside the installed package."""
    here = Path(__file__).resolve()
    for folder in (here.parents[3] / "references", here.parents[1] / "_references"):
        if (folder / "MANIFEST.json").is_file():
            return folder
    return None


@lru_cache
def manifest(folder: Path) -> dict[str, dict[str, Any]]:
    """The manifest's entries by scene name."""
    return json.loads((folder / "MANIFEST.json").read_text(encoding="utf-8"))["scenes"]


@lru_cache
def table(path: Path, sha256: str) -> tuple[list[str], list[list[str]]]:
    """Header and rows of decimal strings of a frozen file; `BadInput` if it is not what it was."""
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != sha256:
        raise BadInput(f"{path.name}: does not match its SHA-256 in MANIFEST.json; restore the file")
    header, *rows = csv.reader(content.decode().splitlines())
    return header, rows


def frozen(scene: Scene, t: np.ndarray, carry: tuple[str, ...]) -> tuple | None:
    """Decimals, digits and source from the frozen file of this very scene, if it has these times."""
    folder = frozen_folder()
    wanted = digest(scene)
    for entry in manifest(folder).values() if folder else ():
        if entry["scene_digest"] != wanted:
            continue
        header, rows = table(folder / entry["file"], entry["sha256"])  # type: ignore[operator]
        grid = np.array([float(row[0]) for row in rows])
        nearest = np.searchsorted((grid[1:] + grid[:-1]) / 2, t)
        labels = scene.labels(carry)
        if set(labels) <= set(header) and np.all(np.abs(grid[nearest] - t) <= 4 * np.spacing(t)):
            columns = [header.index(label) for label in labels]
            return [[rows[k][j] for j in columns] for k in nearest], entry["digits"], "frozen"
    return None


def frozen_entry(scene: Scene) -> dict[str, Any] | None:
    """The manifest's entry of this very scene, whatever its name, or None."""
    folder, wanted = frozen_folder(), digest(scene)
    entries = manifest(folder).values() if folder else ()
    return next((entry for entry in entries if entry["scene_digest"] == wanted), None)


def condition_number(scene: Scene) -> float | None:
    """max_t ‖∂x(t)/∂x(0)‖₂ along the true trajectory: what errors grow to.  None where it is not stored."""
    entry = frozen_entry(scene)
    return entry.get("condition_number") if entry else None


# -- blow-up ---------------------------------------------------------------------------------------
#: a step this small against the span tells the time of blow-up to as many digits, less a few
BLOW_UP_COLLAPSE = 1e-45


def blow_up_time(scene: Scene) -> tuple[str, int] | None:
    """When the trajectory reaches infinity, as a decimal string, and how many digits of it are known.

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
    """The time of blow-up by heyoka at one precision, an mpmath number, or None."""
    try:
        taylor(scene, [repr(scene.t_end)], scene.carry(), bits, BLOW_UP_COLLAPSE)
    except BlowUp as found:
        return found.time
    return None


# -- live high precision ---------------------------------------------------------------------------
def live(scene: Scene, t: np.ndarray, carry: tuple[str, ...]) -> tuple:
    """Decimals, digits and source from two precisions, keeping the digits that agree.

    heyoka's Taylor series where it is installed, else extrapolation in mpmath.  Enough means 20
    digits of every column and of the smallest state along the way, neither counted as less than
    10⁻⁶⁰ of the largest.  Where entries decay below 10⁻²⁰, columns known in closed form are taken
    from there, relative digits and all.
    """
    unique, back = np.unique(t, return_inverse=True)
    times = [repr(x) for x in unique.tolist()]
    start = scene.pack(scene.initial(carry))
    exact: list | None = None
    for rows, other in computations(scene, times, carry):
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


def computations(scene: Scene, times: list[str], carry: tuple[str, ...]) -> Iterator[tuple[Rows, Rows]]:
    """Pairs (more, less precise) of solutions, each pair more precise than the one before."""
    try:
        if importlib.util.find_spec("heyoka") is not None:
            for bits in LIVE_BITS:
                rows = taylor(scene, times, carry, bits + bits // 4)
                if not heyoka_reads_rhs(scene, rows[-1], carry):
                    break
                yield rows, taylor(scene, times, carry, bits)
        for digits in (28, 70):
            yield extrapolation(scene, times, carry, digits + 8), extrapolation(scene, times, carry, digits)
    except BadInput:
        raise
    except Exception as error:
        raise BadInput(
            f"no reference for scene {scene.name!r}: its equations fail in high precision "
            f"({type(error).__name__}: {' '.join(str(error).split())[:200]})"
        ) from error


def taylor_system(scene: Scene, carry: tuple[str, ...], bits: int, heyoka: Any) -> tuple[list, list]:
    """The scene as heyoka expressions with numbers of `bits` bits, and its initial state."""
    twin = with_decimals(scene, lambda text: heyoka.real(text, bits))
    variables = heyoka.make_vars(*(f"y{i}" for i in range(len(scene.labels(carry)))))
    slopes = twin.pack(twin.rhs(twin.unpack(variables, carry)))
    return list(zip(variables, slopes, strict=True)), twin.pack(twin.initial(carry))


def taylor(
    scene: Scene,
    times: list[str],
    carry: tuple[str, ...],
    bits: int,
    collapse: float = COLLAPSE,
    start: list[str] | None = None,
) -> Rows:
    """States at increasing times ≥ 0 (decimal strings) by heyoka's Taylor series, as mpmath numbers.

    start : packed initial state as decimal strings, by default the scene's own.  Raises `BlowUp` when
    a step falls below `collapse` of the span.
    Biscani, Izzo, Mon. Not. R. Astron. Soc. 504, 2614 (2021), doi:10.1093/mnras/stab1032.
    """
    import heyoka

    system, own = taylor_system(scene, carry, bits, heyoka)
    origin_state = own if start is None else [heyoka.real(x, bits) for x in start]
    integrator = heyoka.taylor_adaptive(
        system, np.array(origin_state), fp_type=heyoka.real, prec=bits, compact_mode=True
    )
    origin = [] if float(times[0]) == 0 else ["0.0"]
    grid = np.array([heyoka.real(t, bits) for t in [*origin, *times]])
    shortest = collapse * float(times[-1])

    def keep_going(integrator: Any) -> bool:
        almost_there = float(times[-1]) - float(integrator.time) <= shortest
        return almost_there or float(integrator.last_h) > shortest

    context = decimal_context(bits * 3 // 10 + 5)
    outcome, *_, states = integrator.propagate_grid(grid, callback=keep_going, max_steps=MAX_STEPS)
    if outcome == heyoka.taylor_outcome.step_limit:
        raise BadInput(f"no reference for scene {scene.name!r}: more than {MAX_STEPS} Taylor steps needed")
    if outcome != heyoka.taylor_outcome.time_limit:
        raise BlowUp(scene, context.mpf(str(integrator.time)))
    return [[context.mpf(str(x)) for x in row] for row in states[len(origin) :]]


def heyoka_reads_rhs(scene: Scene, y: list[Any], carry: tuple[str, ...]) -> bool:
    """Whether heyoka and mpmath evaluate the same right-hand side at y to 35 digits.

    They do not where a force divides by an integer that is no power of two: heyoka turns ``x / 3``
    into a product with the double nearest to 1/3.
    """
    import heyoka

    bits = 160
    system, _ = taylor_system(scene, carry, bits, heyoka)
    variables, slopes = zip(*system, strict=True)
    compiled = heyoka.cfunc(slopes, vars=variables, fp_type=heyoka.real, prec=bits, compact_mode=True)
    context = decimal_context(48)
    state = [context.mpf(x) for x in y]
    theirs = compiled(np.array([heyoka.real(str(x), bits) for x in state]))
    twin = with_decimals(scene, context.mpf)
    ours = twin.pack(twin.rhs(twin.unpack(state, carry)))
    return distance([context.mpf(str(x)) for x in theirs], ours) <= 1e-35 * max(map(abs, [*ours, *state]))


def extrapolation(
    scene: Scene, times: list[str], carry: tuple[str, ...], digits: int, collapse: float = COLLAPSE
) -> Rows:
    """States at increasing times ≥ 0 (decimal strings) by the Gragg–Bulirsch–Stoer method in mpmath.

    Raises `BlowUp` when a step falls below `collapse` of the span.

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
    rows = []
    for time in map(context.mpf, times):
        while now < time:
            step = min(trial, time - now)
            column, result = extrapolated(slope, y, step, most, tolerance)
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
    """One extrapolated step and the number of columns it took; None if `most` are not enough."""
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
