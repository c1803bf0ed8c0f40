"""Runge–Kutta pairs by tolerance: the loop with step control, recorded and compiled like the loops of fixed steps.

An attempt is accepted if the two formulas of the pair differ by e with Σ(e_i/(atol_i + rtol |y_i|))² ≤ 1.  Steps grow
by a PI controller (Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations II, §IV.2), unless the change is
small, and shrink only after a rejection.  Equal steps form an inner loop in which the numbers that depend on the step,
such as exponentials of the damping, are constants.  Steps end at saved times.  The first step is the one at which
y' = λy or z'' = −λ²z has the error aimed at, with λ estimated by a short step.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from contactbench.methods import dates
from contactbench.methods.base import METHODS, SHORTEST, Adaptive
from contactbench.methods.dates import division, from_origin
from contactbench.methods.dense import Nodes, Source
from contactbench.methods.loops import Loop, watch_of
from contactbench.methods.parts import Parts
from contactbench.methods.prepared import (
    NO_NUMBER,
    Outcome,
    Pilot,
    Prepared,
    Request,
    stopwatch,
)
from contactbench.methods.runge_kutta import (
    RKN8,
    RKN12,
    Factors,
    Tableau,
    Undamped,
    damped,
    explicit_step,
    factors_of,
    looped,
    masses,
    nystrom_step,
    pull,
    read_tableau,
    refusal,
    runge_kutta,
    undamped,
    undamped_twin,
)
from contactbench.methods.scaled import RunByTolerance
from contactbench.numbers.control import Repeat, repeat, repeat_while, when
from contactbench.numbers.dual import leaves, rebuild, value
from contactbench.numbers.protocol import (
    Abilities,
    Arithmetic,
    CannotRecord,
    ChoosingNamespace,
    ChoosingNumbers,
    Condition,
    Namespace,
    Vector,
    abilities,
)
from contactbench.scene import Cache, Mechanical, Scene, State, key
from contactbench.scene.algebra import DrivenState, scaled
from contactbench.scene.base import OwnState
from contactbench.scene.flow import damped_time
from contactbench.solution import DIVERGENCE, Counts, Solution, Status
from contactbench.trace.form import Assign, Element, Statement, Update, execute
from contactbench.trace.program import Program, record

#: the part of the tolerance that a step aims at; the least and the largest factor by which it changes
AIM, LEAST, MOST = 0.03, 0.2, 5.0
#: the first step over the step of a linear equation
START = 0.85
#: the step does not grow by less than STAY; the last step may be longer by STRETCH
STAY, STRETCH = 1.1, 1.1
#: the weight of the previous error over the weight of the error
PROPORTIONAL = 0.5
#: relative change of the state over the short step that estimates λ
NUDGE = 1e-5
#: numbers after the packed state: step, log of the previous error, attempts, rejected attempts, time not covered
BESIDE = 5
#: the place of the attempts, from the end, in the numbers of every such loop
ATTEMPTS = -3
#: attempts of the first call for dense output; the part of the tolerance that interpolation may add
CHUNK, ALLOWED = 64, 0.1
#: numbers below this count as zero
TINY = 1e-30

#: slope of the motion at a state, where it is known
Slope = Vector | None
#: variables of the loop: state, slope, factors and their step, time left, step, previous error, attempts, rejected
Carried = tuple[Any, ...]
#: variables of the loop over equal steps: state and slope before and after a step, sizes after it, time left before
#: and after it, attempts, the square of the error, whether another step follows
EqualSteps = tuple[Any, ...]


@dataclass(frozen=True)
class Explicit[S: Scene]:
    """The operations of a pair for y' = f(y) that the loop needs."""

    tableau: Tableau

    def enter(self, scene: S, x: OwnState) -> OwnState:
        return x

    leave = enter

    def slope(self, scene: S, y: OwnState, xp: Namespace) -> Vector:
        return tuple(leaves(scene.rhs(y)))

    def factors(self, scene: S, h: Arithmetic, xp: Namespace) -> Factors | None:
        return None

    def attempt(
        self,
        scene: S,
        y: OwnState,
        h: Arithmetic,
        xp: Namespace,
        first: Slope,
        factors: Factors | None,
        loop: Repeat | None = None,
    ) -> tuple[OwnState, Slope, Sequence[Arithmetic]]:
        """Return the state after a step, its slope if the pair evaluates it, and the error estimate."""
        tableau = self.tableau
        after, slopes = explicit_step(tableau, scene, y, h, xp, len(tableau.nodes), loop, first)
        error = rebuild(y, slopes(tableau.estimate[0]))
        return after, None, scene.without_clock(scene.pack(error))

    def rate(
        self, scene: S, y: OwnState, slope: Vector, size: Arithmetic, units: Vector, xp: Namespace
    ) -> Arithmetic:
        """Return the relative rate of change of the slope along itself: |λ| of y' = λy."""

        def length(v: Vector) -> Arithmetic:
            return norm([a / unit for a, unit in zip(scene.without_clock(v), units, strict=True)], xp)

        time = NUDGE * size / (length(slope) + TINY)
        nudged = rebuild(y, [a + time * b for a, b in zip(leaves(y), slope, strict=True)])
        change = tuple(a - b for a, b in zip(self.slope(scene, nudged, xp), slope, strict=True))
        return length(change) / (NUDGE * size)


@dataclass(frozen=True)
class Nystrom(Explicit[Mechanical]):
    """The operations of a pair for z'' = f(t, z) that the loop needs."""

    def enter(self, scene: Mechanical, x: State | DrivenState) -> Undamped:
        return undamped(scene, x)

    def leave(self, scene: Mechanical, y: Undamped) -> OwnState:
        return damped(scene, y)

    def slope(self, scene: Mechanical, y: Undamped, xp: Namespace) -> Vector:
        return tuple(pull(scene, y.q, y.t, y.action is not None))

    def factors(self, scene: Mechanical, h: Arithmetic, xp: Namespace) -> Factors | None:
        return None if scene.rate_changes else factors_of(self.tableau, scene, None, h, xp)

    def attempt(
        self,
        scene: Mechanical,
        y: Undamped,
        h: Arithmetic,
        xp: Namespace,
        first: Slope,
        factors: Factors | None,
        loop: Repeat | None = None,
    ) -> tuple[Undamped, Slope, Sequence[Arithmetic]]:
        tableau, d = self.tableau, len(y.q)
        factors = factors or factors_of(tableau, scene, y.t, h, xp)
        stages = len(tableau.nodes)
        after, slopes, slope = nystrom_step(tableau, scene, y, h, xp, stages, loop, first, factors)
        keep, half = 1 - factors.loss, scene.damping_at(self.leave(scene, after)) / 2
        way, change = map(slopes, tableau.estimate)
        q, v = scaled(keep * h, way[:d]), scaled(keep, change[:d])
        p = (m * (b - half * a) for m, a, b in zip(masses(scene, y.q), q, v, strict=True))
        action = [] if y.action is None else [keep * keep * change[d]]
        return after, None if slope is None else tuple(slope), [*q, *p, *action]

    def rate(
        self, scene: Mechanical, y: Undamped, slope: Vector, size: Arithmetic, units: Vector, xp: Namespace
    ) -> Arithmetic:
        """Return ω of z'' = −ω²z, from the change of the force along itself and the velocity."""
        force = slope[: len(y.q)]
        in_units = lambda v: [a / unit for a, unit in zip(v, units, strict=False)]  # noqa: E731
        ways = (in_units(way) for way in (force, y.u))
        parts = [
            scaled(share / (norm(way, xp) + TINY), way) for share, way in zip((1.0, 0.5), ways, strict=True)
        ]
        way = tuple(NUDGE * size * (a + b) for a, b in zip(*parts, strict=True))
        moved = tuple(a + b * unit for a, b, unit in zip(y.q, way, units, strict=False))
        there = self.slope(scene, y._replace(q=moved), xp)
        change = norm(in_units(a - b for a, b in zip(there, force, strict=False)), xp)
        return xp.sqrt(change / (norm(way, xp) + TINY))


class PlainNumbers(ChoosingNumbers):
    """The namespace of floats."""

    abilities = Abilities(branch=True)

    def __getattr__(self, name: str) -> Any:
        return getattr(math, name)

    def where[X](self, condition: Condition, a: X, b: X) -> X:
        return a if condition else b


@cache
def unit_error(form: Explicit[Any]) -> float:
    """Return the largest error of a step of length one of an oscillator of frequency one."""
    scene, xp = (
        Mechanical(name="unit", potential=lambda q: q[0] * q[0] / 2, q=(1.0,), p=(0.0,), t_end=1.0),
        PlainNumbers(),
    )
    starts = (form.enter(scene, State((q,), (1.0 - q,))) for q in (0.0, 1.0))
    found = (form.attempt(scene, y, 1.0, xp, None, form.factors(scene, 1.0, xp))[2] for y in starts)
    return float(max(abs(error) for errors in found for error in errors))


def norm(v: Sequence[Arithmetic], xp: Namespace) -> Arithmetic:
    return xp.sqrt(sum((c * c for c in v[1:]), v[0] * v[0]))


def march[S: Scene](
    form: Explicit[S],
    scene: S,
    x: OwnState,
    beside: Sequence[Arithmetic],
    span: Arithmetic,
    most: Arithmetic,
    tolerances: Sequence[Arithmetic],
    xp: ChoosingNamespace,
    repeat: Repeat,
) -> tuple[OwnState, list[Any]]:
    """Return the state after a span and the numbers of `BESIDE`; most : attempts of the whole run at most."""
    rtol, *atol = tolerances
    tableau, power = form.tableau, 1.0 / (form.tableau.lower_order + 1)
    reuses, loop = tableau.first_same_as_last, looped(repeat, len(tableau.nodes), scene, x)
    #: the square of the error below which a step grows
    grows = (AIM * STAY ** (-1 / power)) ** 2

    def sizes(y: OwnState) -> Vector:
        return tuple(map(abs, scene.without_clock(scene.pack(form.leave(scene, y)))))

    def scales(before: Vector, after: Vector) -> list[Arithmetic]:
        return [a + rtol / 2 * (b + c) for a, b, c in zip(atol, before, after, strict=True)]

    def first_step(y: OwnState) -> Arithmetic:
        sized = sizes(y)
        weighed = [a / b for a, b in zip(sized, scales(sized, sized), strict=True)]
        #: momenta may have another size than coordinates; without an atol no units are known
        units = tuple(xp.where((a > 0) & (atol[0] > 0), a / atol[0], 1.0) for a in atol)
        moved = y.q if isinstance(form, Nystrom) else sized
        size = norm([a / unit for a, unit in zip(moved, units, strict=False)], xp) + atol[0] / rtol
        rate = form.rate(scene, y, form.slope(scene, y, xp), size, units, xp)
        error = unit_error(form) * (norm(weighed, xp) + 1)
        return START * xp.exp(power * xp.log(AIM / error)) / (rate + TINY)

    y, (step, past, tried, rejected, lag) = form.enter(scene, x), beside
    left = xp.where(lag > 0, 0.0, span)
    step = when(step <= 0, lambda _, y: first_step(y), step, xp, y)
    first = form.slope(scene, y, xp) if reuses else None
    factors = rebuild(known := form.factors(scene, span, xp), [0 * span] * len(leaves(known)))

    def going(carried: Carried) -> Condition:
        _, _, _, _, left, step, _, tried, _ = carried
        return (left > 0) & (tried < most) & (step > SHORTEST * span)

    def turn(carried: Carried) -> Carried:
        y, first, factors, at, left, step, past, tried, rejected = carried
        h = when(left < 2 * step, last_steps, step, xp, left)
        if scene.dated:  # a multiple of a rounding of the span, so that the time left is exact
            h = (span + h) - span
        factors = factors and when(h != at, lambda _, h: form.factors(scene, h, xp), factors, xp, h)

        def attempt(row: EqualSteps) -> EqualSteps:
            _, _, y, first, before, _, left, tried, _, _ = row
            if scene.dated:
                y = y._replace(t=span - left)
            try:
                after, slope, error = form.attempt(scene, y, h, xp, first, factors, loop)
            except NO_NUMBER:
                if not abilities(xp).branch:
                    raise
                after, slope, error = y, first, [math.inf]
            size = sizes(after)
            weighed = (e / c for e, c in zip(error, scales(before, size), strict=False))
            square, rest = value(sum(e * e for e in weighed)), left - h
            alike = (square >= grows) & (square <= 1) & (rest >= 2 * h) & (tried + 1 < most)
            more = xp.where(alike, 1.0, 0.0)
            return y, first, after, slope if reuses else None, size, left, rest, tried + 1, square, more

        row: EqualSteps = y, first, y, first, sizes(y), left, left, tried, 0 * span, 1.0 + 0 * span
        row = repeat_while(lambda row: row[-1] > 0, attempt, row, xp)
        y, first, after, slope, _, left, rest, last, square, _ = row
        past = xp.where(last > tried + 1, 0.0, past)

        def advance(_: object) -> tuple[OwnState, Slope, Arithmetic, Arithmetic, Arithmetic]:
            return after, slope, rest, xp.where(step > h, step, h), rejected

        kept = y, first, left, step, rejected + 1
        y, first, left, step, rejected = when(square <= 1, advance, kept, xp)
        within = (square >= grows) & (square <= 1)
        step, past = when(xp.where(within, 0.0, 1.0) > 0, changed, (step, 0.0), xp, h, square, past)
        return y, first, factors, h, left, step, past, last, rejected

    def last_steps(step: Arithmetic, left: Arithmetic) -> Arithmetic:
        return xp.where(left <= STRETCH * step, left, left / 2)

    def changed(step_and_past: Vector, h: Arithmetic, square: Arithmetic, past: Arithmetic) -> Vector:
        step, _ = step_and_past
        log = xp.log(xp.maximum(square, TINY)) / 2 - math.log(AIM)
        log = xp.where(square <= 1 / TINY, log, -math.log(TINY))  # covers nan
        change = xp.where(square <= 1, PROPORTIONAL * past - (1 + PROPORTIONAL) * log, -log)
        change = xp.maximum(xp.minimum(xp.exp(power * change), MOST), LEAST)
        longest = xp.where((square <= 1) & (step > h * change), step, h * change)
        return longest, xp.where(square <= 1, log, past)

    before = y, first, factors, 0 * span, left, step, past, tried, rejected
    y, _, _, _, left, step, past, tried, rejected = repeat_while(going, turn, before, xp)
    lag = xp.where(lag > 0, lag + span, left)
    return form.leave(scene, y), [step, past, tried, rejected, lag]


def march_by_the_clock(
    form: Explicit[Any],
    scene: Any,
    x: OwnState,
    beside: Sequence[Arithmetic],
    span: Arithmetic,
    most: Arithmetic,
    tolerances: Sequence[Arithmetic],
    xp: ChoosingNamespace,
    repeat: Repeat,
) -> tuple[OwnState, list[Any]]:
    """Do as `march` in the slowed time of a damped body; the step and the time left stay in the time of the span."""
    gamma, lag = scene.gamma, beside[-1]
    whole = damped_time(gamma, span, xp)
    x, (step, *counts, left) = march(
        form, undamped_twin(scene), x, beside, whole, most, tolerances, xp, repeat
    )
    left = xp.where(lag > 0, whole, left)
    factor = xp.where(left > 0, 1 - gamma * (whole - left), xp.exp(-gamma * span))
    slower = xp.maximum(factor, TINY)
    passed = xp.where(gamma == 0, whole - left, -xp.log(slower) / xp.where(gamma == 0, 1.0, gamma))
    late = xp.where(left > 0, lag + span - passed, 0.0)
    return scene.decayed(x, factor), [step / slower, *counts, late]


# -- the run -------------------------------------------------------------------------------------------
def loop_program(
    method: Any, scene: Scene, carry: tuple[str, ...], settings: int, single: bool = False
) -> Program:
    """Return the loop over intervals of given spans, with at most n attempts in each.

    single : all intervals lead to the same end, and each goes on by n attempts.
    """
    d, given = len(scene.labels(carry)), len(scene.numbers())

    def advance(
        numbers: Vector,
        span: Arithmetic,
        most: Arithmetic,
        y: Sequence[Arithmetic],
        xp: Any,
        repeat: Repeat,
        *clock: Arithmetic,
    ) -> list[Arithmetic]:
        twin, x, beside = scene.with_numbers(numbers[:given]), scene.unpack(y[:d], carry), y[d:]
        if single:
            left, most = beside[-1], most + beside[ATTEMPTS]
            clock = clock and (clock[0], clock[1] + (span - left), *clock[2:])
            span, beside = left, [*beside[:-1], 0 * left]
        x, beside = marched(method, twin, x, beside, span, clock, most, numbers[given:], xp, repeat)
        return [*scene.pack(x), *beside]

    def started(statement: Statement) -> Statement:
        """Let the numbers beside the packed state begin as zeros, which no caller gives."""
        match statement:
            case Assign(target, Element("start", (int(i),))) if i >= d:
                return Update((target,), (0.0,))
        return statement

    clock = scene.clock if scene.keeps_dates else None
    watch = None if single else watch_of(scene, carry)
    program = record(advance, given + settings, d + method.beside(d), scene.motion, DIVERGENCE, watch, clock)
    body = program.run.body if single else tuple(map(started, program.run.body))
    return program._replace(run=replace(program.run, body=body))


def marched(
    method: Any, scene: Scene, x: OwnState, beside: Any, span: Arithmetic, clock: Any, most: Any, *given: Any
) -> tuple[OwnState, list[Any]]:
    """Call a method's `march`; clock : an origin and a row of `dates`, for a scene with a time."""
    origin, *since = clock or (0.0,)
    if since:
        scene, x = dates.begin(scene, x, given[1], origin, since)
    x, beside = method.march(scene, x, beside, span, most, *given)
    return dates.end(x, origin, since[0]) if since else x, beside


_loops: Cache[Loop] = Cache(256)


@dataclass
class ToleranceRun(RunByTolerance):
    """Run a method whose loop decides on the number of steps to a saved time, or to a break.

    ``march(scene, x, beside, span, most, settings, xp, repeat)`` returns the state after a span and the numbers beside
    it.  A packed state has `beside(size)` of them, and the last three are attempts, rejected attempts and the time not
    covered.  The method also gives the `settings` of the loop, the number and `kind` of `evaluations`, and the message
    of a `failure`.
    """

    #: known before a run of fixed steps only
    needed, totals = None, Counts()

    def __post_init__(self) -> None:
        super().__post_init__()
        r = self.request
        self.scene: Scene = r.scene
        ends, self.saved = division(r.scene, self.later)
        self.spans, begins = np.diff(ends, prepend=0.0), np.append(0.0, ends[:-1])
        self.since = dates.dates(r.scene, begins, ends) if r.scene.keeps_dates else None
        self.settings, self.steps_taken = self.method_.settings(r, r.step), (r.step or math.nan,) * 2
        #: from a start to the states after all intervals, each with the numbers beside it, in one row
        self.states: Callable[[np.ndarray], np.ndarray] = (
            self.compiled() if r.engine == "llvm" else self.in_python()
        )

    def make(self) -> Loop:
        elapsed = stopwatch()
        program = loop_program(self.method_, self.scene, self.request.carry, len(self.settings))
        return Loop(program, elapsed())

    def rows(self, loop: Loop, attempts: int) -> tuple[np.ndarray, ...]:
        numbers = np.array([*self.scene.numbers(), *self.settings])
        return loop.rows(numbers, self.spans, np.full(len(self.spans), attempts), self.since)

    def compiled(self) -> Callable[[np.ndarray], np.ndarray]:
        """Return `states` by the compiled loop; replace `bare` by the loop alone as soon as a run is short."""
        loop = _loops.get(key(self.scene.identity, self.method_, self.request.carry), self.make)
        d, most, clock = len(self.start), self.request.max_steps, self._clock
        beside, end = loop.program.size - d, len(self.spans) * loop.program.size
        short = min(most, loop.short)  # a longer run goes on interruptibly
        briefly: Callable[[np.ndarray], np.ndarray] = loop.on(d, self.rows(loop, short), (d, d + end))
        self.compile_s = loop.seconds

        def states(y0: np.ndarray) -> np.ndarray:
            y = briefly(y0)
            if short < most and y[ATTEMPTS] >= short:
                loop.execute(y0, self.rows(loop, most), y := np.empty(end), math.inf)
            return y

        def first(y0: np.ndarray) -> np.ndarray:
            y = states(y0)
            if short == most or y[ATTEMPTS] < short:
                direct = loop.on(d, self.rows(loop, most), (end - beside, end + d - beside))
                self.bare = direct if clock is None else lambda y0: self.dated(y0, direct(y0))  # type: ignore
            return self.dated(y0, y[-d - beside : -beside])

        self.bare = first  # type: ignore
        if loop.program.watched:
            self.at_once = self.shortened(
                loop.on(d, self.rows(loop, short), (d, d + end), flagged=True), beside
            )
        return states

    def shortened(
        self, states: Callable[[np.ndarray], tuple[np.ndarray, int]], beside: int
    ) -> Callable[[np.ndarray], Solution]:
        """Return the whole call for the common case, a run that reaches its end."""
        of, date, clock, rows = Solution.of, self._dated, self._clock, len(self.spans)
        saved, d, first = self.saved, len(self.start), self.saves_start
        kind, evaluations = self.method_.kind, self.method_.evaluations
        ended = self.attributes(Status.ok, "", Counts(), self._end, self.steps_taken)

        def at_once(y0: np.ndarray) -> Solution:
            found, bad = states(y0)
            tried, rejected, lag = found[-3:].tolist()
            if bad >= 0 or lag != 0:
                return self.solved(y0, self.integrate)
            y = found.reshape(rows, d + beside)[saved, :d]
            y = np.concatenate([y0[None], y]) if first else y
            solution = of(ended, y if clock is None else date(y0, y), y0)
            solution.counts = Counts(
                int(tried - rejected), evaluations(int(tried), rows), 0, int(rejected), kind
            )
            if clock is not None:
                solution.t = self.times_from(y0)
            return solution

        return at_once

    def in_python(self) -> Callable[[np.ndarray], np.ndarray]:
        """Return `states` by the recorded loop in Python, or by the source if it cannot be recorded or overflows."""
        r, scene, recorded, rows = self.request, self.scene, None, list[Any]()
        with suppress(CannotRecord):
            loop = self.make()
            recorded = execute(loop.program.run)
            rows = [part.tolist() for part in self.rows(loop, r.max_steps)]

        def as_written(y0: np.ndarray) -> list[float]:
            x, beside = scene.unpack(y0.tolist(), r.carry), [0.0] * self.method_.beside(len(y0))
            given, after = (r.max_steps, self.settings, PlainNumbers(), repeat), list[float]()
            origin, times = scene.split_clock(y0)[0], [()] if self.since is None else self.since
            for span, since in zip(self.spans.tolist(), itertools.cycle(times)):
                x, beside = marched(self.method_, scene, x, beside, span, (origin, *since), *given)
                after += [*scene.pack(x), *beside]
            return after

        def states(y0: np.ndarray) -> np.ndarray:
            if recorded is not None:
                with suppress(*NO_NUMBER):
                    after = [0.0] * (len(self.spans) * (len(y0) + self.method_.beside(len(y0))))
                    recorded(y0.tolist(), *rows, after)
                    return np.array(after)
            return np.array(as_written(y0))

        return states

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return self.dated(y0, self.states(y0).reshape(len(self.spans), -1)[-1, : len(y0)])

    def bare_states(self, y0: np.ndarray) -> np.ndarray:
        return self.states(y0).reshape(len(self.spans), -1)[self.saved, : len(y0)]

    def dated(self, y0: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the last state with the time of the end, which is no sum of steps."""
        if self._clock is not None:
            y[self._clock] = y0[self._clock] + self._end
        return y

    def taken(self, y0: np.ndarray) -> tuple[np.ndarray, Counts]:
        """Return the packed states after each interval with the numbers beside them, and the counts."""
        y = self.states(y0).reshape(len(self.spans), -1)
        tried, rejected, _ = y[-1, -3:].tolist()
        entered = int(np.sum(y[:, -1] < self.spans))
        evaluations = self.method_.evaluations(int(tried), entered)
        return y, Counts(int(tried - rejected), evaluations, 0, int(rejected), self.method_.kind)

    def pilot(self, y0: np.ndarray) -> Pilot:
        """Run as a pilot; saved states that are not reached are nan."""
        y, counts = self.taken(y0)
        saved = np.where(y[:, -1:] == 0, y[:, : len(y0)], math.nan)[self.saved]
        return Pilot(self, saved, counts, spent=self.is_spent(y, counts))

    def into(self, start: np.ndarray, after: np.ndarray) -> None:
        """Return None, since the number of steps is not known beforehand."""

    def outcome(self, y0: np.ndarray, y: np.ndarray, counts: Counts) -> Outcome:
        return self.finish(y0, self.from_start(y0, y), counts)

    def is_spent(self, y: np.ndarray, counts: Counts) -> bool:
        tried = (counts.steps or 0) + (counts.rejected or 0)
        return bool(y[-1, -1] > 0 and tried >= self.request.max_steps)

    def integrate(self, y0: np.ndarray) -> Outcome:
        self.require_size(y0)
        r, d = self.request, len(y0)
        y, counts = self.taken(y0)
        lag = y[-1, -1]
        if lag == 0:
            return self.finish(y0, self.from_start(y0, y[self.saved, :d]), counts)
        saved = np.arange(len(y))[self.saved]
        reached = saved[y[saved, -1] == 0]
        status, message = Status.failed, self.method_.failure
        if self.is_spent(y, counts):
            status, message = Status.budget, f"max_steps = {r.max_steps} spent"
        time = self._end - lag
        states = self.from_start(y0, y[reached, :d])
        return self.finish(y0, states, counts, status, f"{message} (t = {time:.6g})", (time, y[-1, :d]))


class OwnSteps(Parts):
    """The accepted steps of a pair, attempt by attempt; parts of steps by its formula of the higher order."""

    def __init__(self, run: Any) -> None:
        r, pair = run.request, run.method_
        filler = runge_kutta(pair.name, pair.form.tableau, pair.about)
        super().__init__(filler, r, math.inf)
        self.run, self.pair = run, pair
        self.marks = np.append(0.0, division(r.scene, r.save_at[-1:])[0])
        self.since = dates.dates(r.scene, self.marks[:-1], self.marks[1:]) if r.scene.keeps_dates else None
        self.numbers = np.array([*r.scene.numbers(), *run.settings])

        def make() -> Loop:
            elapsed = stopwatch()
            program = loop_program(pair, r.scene, r.carry, len(run.settings), single=True)
            return Loop(program, elapsed())

        self.attempts = _loops.get(key(r.scene.identity, pair, r.carry, "single"), make)

    def allowed(self, scales: np.ndarray) -> np.ndarray:
        r = self.request
        return np.asarray(ALLOWED * (np.asarray(r.atol) + (r.rtol or 0.0) * scales))

    def steps(self, y0: np.ndarray) -> tuple[Nodes, Counts] | None:
        d, size, entered = len(y0), self.attempts.program.size, 0
        t, y, piece = list[Any](), list[Any](), list[Any]()
        row = np.concatenate([y0, np.zeros(size - d)])
        for number, (begin, end) in enumerate(zip(self.marks, self.marks[1:], strict=False)):
            t, y, piece = [*t, np.array([begin])], [*y, row[None, :d]], [*piece, np.array([number])]
            row = from_origin(self.request.scene, row, y0)
            row[-1] = end - begin
            many = CHUNK
            while row[-1] > 0:
                rows = self.taken(row, end - begin, many, number)
                gone = np.append(row[ATTEMPTS], rows[:, ATTEMPTS])
                if gone[-1] > self.request.max_steps or (rows[-1, -1] > 0 and gone[-1] < gone[0] + many):
                    return None
                moved = np.diff(np.append(row[-1], rows[:, -1])) < 0
                entered += int((np.diff(gone) > 0).sum())
                row = from_origin(self.request.scene, rows[-1], y0)
                after = end - rows[moved, -1]
                t, y, piece = [*t, after], [*y, rows[moved, :d]], [*piece, np.full(len(after), number)]
                many *= 2
        nodes = Nodes(np.concatenate(t), np.concatenate(y), np.concatenate(piece))
        tried, rejected = int(row[ATTEMPTS]), int(row[-2])
        evaluations = self.pair.evaluations(tried, entered)
        return nodes, Counts(tried - rejected, evaluations, 0, rejected, self.kind)

    def taken(self, row: np.ndarray, span: float, many: int, number: int) -> np.ndarray:
        """Return the rows after each of many further attempts."""
        since = None if self.since is None else np.repeat(self.since[number : number + 1], many, axis=0)
        one = np.ones(many, dtype=np.int64)
        given = self.numbers, np.full(many, span), one
        return self.attempts.after(row, *given, since=since, python=self.request.engine == "python")


@dataclass(frozen=True)
class RungeKuttaPair(Adaptive):
    """A pair of Runge–Kutta formulas with step control."""

    name: str
    order: int
    about: str
    form: Explicit[Any]
    engines: tuple[str, ...] = ("llvm", "python")
    family: str = "established"
    failure = "the step became too small"

    @property
    def kind(self) -> str:
        return "gradient" if self.form.tableau.nystrom else "rhs"

    @property
    def evaluations_per_step(self) -> int:  # type: ignore[override]
        return len(self.form.tableau.nodes)

    def refuses(self, scene: Scene) -> str | None:
        return refusal(self, self.form.tableau, scene)

    def prepare(self, request: Request) -> Prepared:
        return ToleranceRun(self.name, request, self)

    def source(self, request: Request) -> Source | None:
        try:
            return OwnSteps(self.prepare(replace(request, save_at=request.save_at[-1:])))
        except CannotRecord:
            return None

    def settings(self, request: Request, step: float | None) -> list[float]:
        moved = len(request.start) - (request.scene.clock is not None)
        return [request.rtol or math.nan, *np.broadcast_to(request.atol, moved).tolist()]

    def beside(self, size: int) -> int:
        return BESIDE

    def evaluations(self, tried: int, entered: int) -> int:
        tableau = self.form.tableau
        reuses = tableau.first_same_as_last
        return tried * (len(tableau.nodes) - reuses) + entered * reuses + 2

    def march(
        self, scene: Any, x: Any, beside: Any, span: Any, most: Any, settings: Any, xp: Any, repeat: Any
    ) -> tuple[OwnState, list[Any]]:
        run = march_by_the_clock if scene.slows_its_clock and not self.form.tableau.nystrom else march
        return run(self.form, scene, x, beside, span, most, settings, xp, repeat)


_pair = "explicit Runge–Kutta pair by tolerance"
_nystrom = "explicit Runge–Kutta–Nyström pair by tolerance, on z = e^{γt/2} q"
_form: Explicit[Any]
for _name, _about, _form in (
    ("rk8-7", _pair, Explicit(read_tableau("rk8-7"))),
    ("rkn8-6", _nystrom, Nystrom(RKN8)),
    ("rkn12-10", _nystrom, Nystrom(RKN12)),
):
    METHODS.add(RungeKuttaPair(_name, _form.tableau.order, f"{_about}; {_form.tableau.source}", _form))
