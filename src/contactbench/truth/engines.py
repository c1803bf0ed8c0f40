"""High-precision numbers, the digits on which two computations agree, and two independent engines.

The engines are heyoka's Taylor series and extrapolation.

mpmath is imported when it is first used: its import would be a quarter of the command line's start.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from decimal import Decimal, localcontext
from functools import partial
from importlib.util import find_spec
from itertools import pairwise
from threading import Thread
from time import perf_counter, thread_time
from typing import TYPE_CHECKING, Any

import numpy as np

from contactbench.errors import BadInput
from contactbench.numbers.protocol import Arithmetic
from contactbench.numbers.series import NO_SERIES, equations
from contactbench.scene import Scene

if TYPE_CHECKING:
    import heyoka
    from mpmath import MPContext

Rows = list[list[Arithmetic]]  #: one list of components per time


def scales(rows: Rows) -> list[Arithmetic]:
    """Return the largest |entry| of every column (1 for a column of zeros)."""
    return [max(abs(x) for x in column) or 1.0 for column in zip(*rows, strict=True)]


def distance(a: Sequence[Arithmetic], b: Sequence[Arithmetic]) -> Arithmetic:
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


def disagreement(a: Rows, b: Rows) -> list[Arithmetic]:
    return [distance(p, q) for p, q in zip(zip(*a, strict=True), zip(*b, strict=True), strict=True)]


def agreeing_digits(a: Rows, b: Rows, at_most: int) -> int:
    """Return the number of digits on which two computations agree, relative to the scale of the worst column."""
    worst = max(e / scale for e, scale in zip(disagreement(a, b), scales(b), strict=True))
    return matching_digits(worst, at_most)


def matching_digits(error: Arithmetic, at_most: int) -> int:
    import mpmath

    return at_most if error == 0 else max(0, min(at_most, int(mpmath.floor(-mpmath.log10(error)))))


def rounded(value: Arithmetic, places: int) -> str:
    """Return a number to a number of decimal places (half to even), in plain or scientific notation."""
    import mpmath

    with localcontext() as context:
        context.prec = 200
        exact = Decimal(mpmath.nstr(value, 100))
        return str(exact.quantize(Decimal(1).scaleb(-places)))


def place(value: Arithmetic, digits: int) -> int:
    """Return the decimal place of the last of `digits` significant digits of value."""
    import mpmath

    return digits if value == 0 else digits - 1 - int(mpmath.floor(mpmath.log10(abs(value))))


#: functions with a cost that grows with their argument, and the binary logarithm of their largest argument: beyond it
#: mpmath would exhaust the memory
GROWING, LARGEST = ("exp", "expm1", "sinh", "cosh", "tanh", "sin", "cos", "tan"), 1000


def decimal_context(digits: int) -> MPContext:
    """Return a new mpmath context, whose functions raise `OverflowError` for huge arguments."""
    import mpmath

    context = mpmath.MPContext()
    context.dps = digits
    largest = context.ldexp(1, LARGEST)

    def bounded(function: Callable[..., Arithmetic]) -> Callable[..., Arithmetic]:
        def apply(x: Arithmetic, **options: object) -> Arithmetic:
            if abs(x) > largest:
                raise OverflowError(f"{function.__name__}(x), |x| > 2^{LARGEST}")
            return function(x, **options)

        return apply

    for name in GROWING:
        setattr(context, name, bounded(getattr(context, name)))
    return context


def with_decimals(scene: Scene, number: Callable[[str], Arithmetic]) -> Scene:
    """Return the scene with every float x, initial data included, replaced by ``number(repr(x))``."""

    def convert(value: Any) -> Any:
        return tuple(map(convert, value)) if isinstance(value, tuple) else number(repr(float(value)))

    start = {name: convert(getattr(scene, name)) for name in scene.initial_fields}
    return scene.with_numbers([convert(x) for x in scene.numbers()])._replaced(**start)


# -- limits of time ---------------------------------------------------------------------------------
#: no deadline, on the clock of `perf_counter`
NEVER = math.inf
#: seconds of work after which the remaining time is extrapolated
FORESEEN = 2.0
MAX_STEPS = 1_000_000
#: a step below this part of the longest one, or of the span before the first step, means a singularity ahead
COLLAPSE, NO_STEP = 1e-12, 1e-36
#: number of states at which two evaluations of the equations are compared
LOOKS = 100
#: a step that moves a state further than this, relative to 1 + its size, has failed
BEYOND = 1e30


def no_reference(scene: Scene, why: str) -> str:
    return f"no reference for scene {scene.name!r}: {why}"


class BlowUp(BadInput):
    """The trajectory reaches infinity at `time`, an mpmath number."""

    def __init__(self, scene: Scene, time: Arithmetic) -> None:
        super().__init__(no_reference(scene, f"the trajectory blows up at t = {float(time):.6g}"))
        self.time = time


def jump_at(scene: Scene, time: float) -> BadInput:
    jump = f"its force or damping jumps at t = {time:.6g} after the start: name the time in breaks="
    return BadInput(no_reference(scene, jump))


def of_bends(scene: Scene) -> str:
    """Return a hint for the refusal of a scene whose force or damping depends on time."""
    bends = "; where a force or damping bends or jumps, name the times in breaks="
    return "" if scene.clock is None else bends


class OutOfTime(BadInput):
    """Report that a computation needs more time than it has; needed : the extrapolated seconds."""

    def __init__(self, message: str, needed: float = math.inf) -> None:
        super().__init__(message)
        self.needed = needed


class DoublesOnly(BadInput):
    """Report that equations can be evaluated in double precision only."""


class Stopwatch:
    """Measure the time of a computation; by extrapolation to its end it may take `patience` times its budget."""

    def __init__(self, scene: Scene, span: float, deadline: float, patience: float = 1.0) -> None:
        self.scene, self.span, self.deadline, self.patience = scene, span, deadline, patience
        self.begun, self.worked = perf_counter(), thread_time()

    def is_over(self, t: float) -> bool:
        """Return whether the deadline has passed, or by extrapolation from t will pass before the end."""
        worked = thread_time() - self.worked  # a busy machine may stand still for seconds
        hopeless = worked * self.span > self.patience * (self.deadline - self.begun) * t
        return perf_counter() > self.deadline or (worked > FORESEEN and t > 0 and hopeless)

    def check(self, t: float) -> None:
        if self.is_over(t):
            faster = "" if find_spec("heyoka") else ", or install heyoka, which is much faster"
            needed = (perf_counter() - self.begun) * self.span / t if t > 0 else math.inf
            raise OutOfTime(
                f"no reference for scene {self.scene.name!r} in the time it was given (t = {t:.3g} of "
                f"{self.span:.3g} so far): allow it more, or choose an earlier t_end{faster}"
                f"{of_bends(self.scene)}",
                needed,
            )


def within[Made](make: Callable[[], Made], watch: Stopwatch) -> Made:
    """Return the result of `make`, a compilation, which goes on in its thread; raise `OutOfTime` at the deadline."""
    if watch.deadline == NEVER:
        return make()
    from concurrent.futures import Future  # loaded when it is used

    made = Future[Made]()

    def work() -> None:
        try:
            made.set_result(make())
        except BaseException as error:
            made.set_exception(error)

    Thread(target=work).start()
    try:
        return made.result(max(0.0, watch.deadline - perf_counter()))
    except TimeoutError:
        watch.check(0.0)
        raise


# -- Taylor series -----------------------------------------------------------------------------------
#: to optimise calls of MPFR would gain nothing, and takes four fifths of the compilation
MANY_DIGITS = {"compact_mode": True, "opt_level": 0}


def taylor_system(
    scene: Scene, carry: tuple[str, ...], bits: int
) -> tuple[list[tuple[heyoka.expression, heyoka.expression]], list[heyoka.real]]:
    """Return the scene as heyoka expressions with numbers of `bits` bits, and its initial state."""
    import heyoka

    twin = with_decimals(scene, lambda text: heyoka.real(text, bits))
    variables = heyoka.make_vars(*(f"y{i}" for i in range(len(scene.labels(carry)))))
    slopes = equations(twin, variables, carry)
    return list(zip(variables, slopes, strict=True)), twin.pack(twin.initial(carry))


def taylor(
    scene: Scene,
    times: list[str],
    carry: tuple[str, ...],
    bits: int,
    collapse: float = COLLAPSE,
    start: list[str] | None = None,
    deadline: float = NEVER,
    stops: Sequence[float] = (),
) -> Rows:
    """Return states at increasing times ≥ 0 (decimal strings) by heyoka's Taylor series, as mpmath numbers.

    start : decimal strings, by default the scene's own.  stops : times at which a step must end.  Raises `BlowUp` if a
    step falls below `collapse` times the longest one, and `OutOfTime` after the deadline (of `perf_counter`).
    """
    import heyoka

    system, own = taylor_system(scene, carry, bits)
    origin_state = own if start is None else [heyoka.real(x, bits) for x in start]
    kind = MANY_DIGITS | {"fp_type": heyoka.real, "prec": bits}
    end, watch, longest, steps = float(times[-1]), Stopwatch(scene, float(times[-1]), deadline), 0.0, 0
    integrator = within(lambda: heyoka.taylor_adaptive(system, np.array(origin_state), **kind), watch)
    context, limits, due = decimal_context(bits * 3 // 10 + 5), heyoka.taylor_outcome, 0.0

    def keep_going(integrator: heyoka.taylor_adaptive) -> bool:
        nonlocal longest
        t, last = float(integrator.time), float(integrator.last_h)
        longest = max(longest, last)
        return not watch.is_over(t) and (t >= due or last > collapse * longest)

    ends, rows, left = {*stops, end}, list[np.ndarray](), list[str]()
    for time in times:
        left += [time] if float(time) else []
        if float(time) not in ends:
            continue
        grid, due = np.array([integrator.time, *(heyoka.real(t, bits) for t in left)]), float(time)
        outcome, *_, taken, _, states = integrator.propagate_grid(
            grid, callback=keep_going, max_steps=MAX_STEPS - steps
        )
        steps += taken
        if outcome == limits.step_limit or steps >= MAX_STEPS:
            raise BadInput(no_reference(scene, f"more than {MAX_STEPS} Taylor steps needed"))
        if outcome != limits.time_limit:
            watch.check(float(integrator.time))
            if math.isnan(float(integrator.time)):
                why = f"its Taylor series is not finite at the start; {NO_SERIES}"
                raise BadInput(no_reference(scene, why))
            raise BlowUp(scene, context.mpf(str(integrator.time)))
        rows += list(states[len(rows) > 0 :])
        left = []
    return [[context.mpf(str(x)) for x in row] for row in rows[len(rows) - len(times) :]]


def heyoka_reads_rhs(scene: Scene, rows: Rows, carry: tuple[str, ...]) -> bool:
    """Return whether heyoka's right-hand side agrees with mpmath's to 35 digits; that of x / 3 does not."""
    import heyoka

    bits = 160
    variables, slopes = zip(*taylor_system(scene, carry, bits)[0], strict=True)
    compiled = heyoka.cfunc(slopes, vars=variables, fp_type=heyoka.real, prec=bits, **MANY_DIGITS)
    context = decimal_context(48)
    twin = with_decimals(scene, context.mpf)
    states = [[context.mpf(x) for x in row] for row in rows[:: -(-len(rows) // LOOKS)]]
    between = [[(a + b) / 2 for a, b in zip(*two, strict=True)] for two in pairwise(states)]
    for state in [*states, *between]:
        theirs = compiled(np.array([heyoka.real(str(x), bits) for x in state]))
        ours = twin.pack(twin.rhs(twin.unpack(state, carry)))
        gap = distance([context.mpf(str(x)) for x in theirs], ours)
        if not gap <= 1e-35 * max(map(abs, [*ours, *state])):
            return False
    return True


# -- extrapolation -----------------------------------------------------------------------------------
def extrapolation(
    scene: Scene,
    times: list[str],
    carry: tuple[str, ...],
    digits: int,
    collapse: float = COLLAPSE,
    deadline: float = NEVER,
) -> Rows:
    """Return states at increasing times ≥ 0 (decimal strings) by the Gragg–Bulirsch–Stoer method in mpmath.

    The midpoint rule is extrapolated in h² until two agree to `digits`: Hairer, Nørsett, Wanner I, §II.9.
    """
    context = decimal_context(digits + 15)  # extrapolation amplifies round-off
    twin = with_decimals(scene, context.mpf)

    slope, y0, origin = initial_value_problem(twin, carry)
    watch, breaks = Stopwatch(scene, float(times[-1]), deadline), scene.breaks_until(float(times[-1]))

    limits = {"most": 4 + digits // 2, "tolerance": context.mpf(10) ** -digits}
    solve = partial(extrapolate, slope, watch=watch, collapse=collapse, **limits)
    saved = list(map(context.mpf, times))
    rows = across_breaks(solve, slope, y0, saved, breaks)
    return [list(twin.with_clock(y.tolist(), origin + t)) for t, y in zip(saved, rows, strict=True)]


#: f(t, y): t since the start, y a packed state less the time
Slope = Callable[[Arithmetic, np.ndarray], np.ndarray]


def initial_value_problem(scene: Scene, carry: tuple[str, ...]) -> tuple[Slope, np.ndarray, Arithmetic]:
    """Return y' = f(t, y), y(0), and the time at the start: t is exact, as a jump of a force needs it."""
    start = scene.pack(scene.initial(carry))
    origin = 0.0 if scene.clock is None else start[scene.clock]

    def slope(t: Arithmetic, y: np.ndarray) -> np.ndarray:
        return np.asarray(scene.slopes(origin + t, scene.entries(y), carry))

    return slope, np.array(scene.without_clock(start)), origin


Breaks = Sequence[tuple[float, float]]  #: times, each with its uncertainty


def sides(breaks: Breaks, end: float) -> list[float]:
    """Return the times just before and just after each break, between 0 and an end."""
    return [side for time, exact in breaks for side in (time - exact, time + exact) if 0 < side < end]


def lost_at_breaks(slope: Slope, breaks: Breaks, times: Sequence[float], states: np.ndarray) -> float:
    """Return the error of a motion due to the uncertainty of its breaks; states (k, d) at times."""
    lost = 0.0
    for time, exact in breaks:
        y = states[min(int(np.searchsorted(times, time)), len(times) - 1)]
        before, behind = (slope(max(time + way * exact, 0.0), y) for way in (-1, 1))
        lost += exact * float(np.abs(behind - before).max())
    return lost


def across_breaks(
    solve: Callable[..., list[np.ndarray]],
    slope: Slope,
    y: np.ndarray,
    times: Sequence[Arithmetic],
    breaks: Breaks,
    begin: Arithmetic = 0.0,
) -> list[np.ndarray]:
    """Return states at increasing times by `solve(y, times, begin=…)`, over breaks by the mean of both slopes."""
    rows, begin, group = list[np.ndarray](), begin + 0 * times[-1], list[Arithmetic]()
    for time in times:
        before = group[-1] if group else begin
        if before < time and any(b - m <= float(before) and float(time) <= b + m for b, m in breaks):
            rows += solve(y, group, begin=begin)
            y = rows[-1] if rows else y
            here = slope(before, y)
            y = y + (time - before) / 2 * (here + slope(time, y + (time - before) * here))
            rows.append(y)
            begin, group = time, []
        else:
            group.append(time)
    return rows + solve(y, group, begin=begin)


def extrapolate(
    slope: Slope,
    y: np.ndarray,
    times: Sequence[Arithmetic],
    most: int,
    tolerance: Arithmetic,
    watch: Stopwatch,
    collapse: float = COLLAPSE,
    begin: Arithmetic = 0.0,
    least: float = 0.0,
) -> list[np.ndarray]:
    """Return the states at increasing times, of any kind of numbers; least : lower bound for the size of a state."""
    if not times:
        return []
    now, trial, rows, longest = begin + 0 * times[-1], times[-1] - begin, [], NO_STEP / collapse * times[-1]
    for time in times:
        while now < time:
            step = min(trial, time - now)
            check = partial(watch.check, float(now + step))
            try:
                column, result = extrapolated(slope, now, y, step, most, tolerance, check, least)
            except ArithmeticError:  # it lands on a singularity
                column, result = most, None
            if result is None:
                trial = step / 2
                if trial < collapse * longest:
                    raise BlowUp(watch.scene, now)
                continue
            now, y, longest = (time if step == time - now else now + step), result, max(longest, step)
            if column < 0.7 * most:
                trial = max(trial, step * 3 / 2)
        rows.append(y)
    return rows


def extrapolated(
    slope: Slope,
    t: Arithmetic,
    y: np.ndarray,
    step: Arithmetic,
    most: int,
    tolerance: Arithmetic,
    check: Callable[[], None],
    least: float = 0.0,
) -> tuple[int, np.ndarray | None]:
    """Return the number of columns and the result of an extrapolated step, None if it needs more than `most`."""
    first, far = slope(t, y), BEYOND * (1 + np.abs(y).max())
    previous: list[np.ndarray] = []
    for j in range(1, most + 1):
        h = step / (2 * j)
        old, mid = y, y + h * first
        for k in range(1, 2 * j):
            check()
            old, mid = mid, old + 2 * h * slope(t + k * h, mid)
            if not np.abs(mid).max() <= far:  # it diverges, and mpmath numbers would grow without end
                return j, None
        row = [mid]
        for k, below in enumerate(previous, start=1):  # Aitken–Neville in h²
            weight = (step * 0 + j * j) / (j - k) ** 2 - 1
            row.append(row[-1] + (row[-1] - below) / weight)
        size = max(np.abs(y).max(), np.abs(row[-1]).max(), least)  # a start may be all zeros
        if j > 2 and distance(row[-1], row[-2]) <= tolerance * size:
            return j, row[-1]
        if np.abs(mid).max() > 1e6 * (1 + size):
            return j, None  # hopeless at this step
        previous = row
    return most, None
