"""Choose a fixed step from a tolerance: run pilots at ever shorter steps until one has the requested error.

The step is constant along a run, so that a contact method keeps its structure.  Two pilots with the same saved times
and steps of ratio r give the error of the finer one as gap/(r^p − 1) (Richardson), if the errors fall with the order p.
A third pilot tests that: the ratio of two successive gaps must be the one predicted by p.  If the two disagree, the
error is multiplied by a power of the disagreement.  The next step is predicted only if they agree.  The first pilot
whose error is small enough is the run.

Saved times shorten steps, so the ratio of two pilots is the ratio of their numbers of steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from contactbench.methods.base import METHODS, prepare
from contactbench.methods.distance import distance
from contactbench.methods.loops import StepLoop
from contactbench.methods.prepared import NO_NUMBER, Outcome, Pilot, Prepared
from contactbench.numbers.control import choose
from contactbench.numbers.protocol import Arithmetic, CannotRecord, Namespace
from contactbench.scene import Cache, Scene
from contactbench.scene.base import Elapsed
from contactbench.solution import Counts, Solution, Status
from contactbench.trace.compiled import compile_function
from contactbench.trace.form import Assign, Element, Function, Store
from contactbench.trace.formula import argument_names, formula

#: the accepted error and the error aimed at, as parts of the tolerance
ENOUGH, AIM = 0.7, 0.4
#: steps of the first pilot over the span, or between two breaks
FIRST = 4
#: the steps are the longest one divided by powers of 2^(1/8), so that calls share their prepared runs
RUNGS = 8
#: number of prepared runs kept, and of numbers in the states of their pilots
KEPT, KEPT_NUMBERS = 64, 2**22
#: largest product of the damping and the first step
DAMPED = 8.0
#: a gap above the first (relative to the motion) is not asymptotic; below the second the order is trusted
LOST, TRUSTED = 1.0, 0.1
#: the first pilot's step is at most about a period of the motion at the start for an order ≥ HIGH, and shorter in
#: proportion for lower orders: pilots with longer steps diverge alike, and their errors do not fall with the order
PERIOD, HIGH = 6.0, 4
#: number of times at which `push` evaluates the force, spaced by golden sections over the span
LOOKS, GOLDEN = 8, 0.6180339887498949
#: it evaluates the force again after this part of the span, or after this many roundings of the time if longer
NEXT, APART = 1e-9, 2.0**10
#: the first pilot's step over the time scale of the force, at most
PUSHED = 2.0
#: right-hand sides for the period of the motion, and their distance relative to the motion
PROBES, BESIDE = 3, 1e-6
#: gaps are rounding errors if, once below ROUNDED, their slopes change by a factor between STUCK and GROWN
ROUNDED, STUCK, GROWN = 1e-6, 0.7, 20.0
#: a gap agrees with the predicted one if they differ by at most this factor
AGREE = 2.0
#: powers of the disagreement by which the error grows: gap larger, and smaller, than predicted
ABOVE, BELOW = 3, 2
#: where gaps fall, the error is at most this multiple of the slope of the gap
MOST = 2.0
#: with more saved states than this, two pilots that agree need no third one
MANY = 32
#: a gap below this is round-off
ROUND_OFF = 1e-13
#: most steps of a first pilot, plus a hundredth of it per time unit of the motion; octaves of further steps
WILD, SPENT = 1e4, 6
#: for methods that follow the motion: pilots took different paths if their step numbers are off by this factor
OTHER = 1.25
#: after this many diverging pilots in a row, the adaptive method WITNESS decides whether the motion diverges
BLOWN, WITNESS, WITNESS_RTOL = 3, "rk8-7", 1e-8
#: the search ends at LAST steps after 2·BLOWN diverging pilots, or OCTAVES octaves below the first step
LAST, OCTAVES = 10**6, 20
#: largest ratio of the steps of successive pilots: after one agreement, and after several
NEAR, FAR = 4.0, 32.0


class Choice(NamedTuple):
    """The accepted pilot and its states, or the outcome if no pilot is accepted; the evaluations of all pilots."""

    evaluations: int
    pilot: Pilot | None = None
    y: Any = None
    outcome: Outcome | None = None


class Room:
    """Memory for the pilots from one start, for one call at a time; the step is the longest over 2^(rung/8)."""

    def __init__(self, chosen: ChosenStep) -> None:
        self.chosen, self.start = chosen, np.empty(len(chosen.start))
        self.time_scale = chosen.time_scale_at(self.start)
        self.states: dict[int, np.ndarray] = {}
        #: the last rung with the same steps: the longest step taken may be far below the allowed one
        self.rungs: dict[int, int] = {}
        self.prepared, self.compared = cache(self.prepare), cache(self.compare)

    def pilot(self, rung: int) -> Pilot:
        return self.prepared(rung)()

    def gap(self, coarse: int, fine: int) -> float:
        return self.compared(coarse, fine)()

    def compare(self, coarse: int, fine: int) -> Callable[[], float]:
        return distance(self.chosen.request, self.start, self.states[coarse], self.states[fine])

    def prepare(self, rung: int) -> Callable[[], Pilot]:
        """Return the pilot as a function without arguments that works on memory allocated once."""
        run = self.chosen.run_at(rung)
        octaves = math.log2(self.chosen.first / run.steps_taken[1])
        self.rungs[rung] = max(rung, math.floor(RUNGS * octaves))
        y = self.states[rung] = np.empty((len(self.chosen.later), len(self.start)))
        call = run.into(self.start, y.reshape(-1))
        if call is not None:
            ended = self.chosen.attributes(
                Status.ok, "", run.totals, float(run.request.save_at[-1]), run.steps_taken
            )
            bad, fine = Pilot(run, y, run.totals, False), Pilot(run, y, run.totals, True, ended=ended)
            return lambda: fine if call() < 0 else bad

        def take() -> Pilot:
            pilot: Pilot = run.pilot(self.start.copy())
            y[:] = pilot.y
            return pilot

        return take


class Gap(NamedTuple):
    """The distance of two pilots relative to the motion, the ratio > 1 of their steps, and slope = size/(ratio − 1)."""

    size: float = math.inf
    ratio: float = 2.0
    slope: float = math.inf


def error_of(gap: Gap, wider: Gap, order: int) -> tuple[float, bool]:
    """Return the relative error of the finest of three pilots, and whether the gaps agree with the order."""
    size, ratio, slope = gap
    before, longer, steeper = wider
    if not before <= LOST or (slope >= steeper and size >= ROUND_OFF):
        return math.inf, False
    if size < ROUND_OFF:
        return size, False
    finer = ratio**order
    off = size * finer * (longer**order - 1) / (before * (finer - 1))
    error = size / (finer - 1) * (off**ABOVE if off > 1 else off**-BELOW)
    if slope <= steeper / 2:
        error = min(error, MOST * slope)
    return error, 1 / AGREE <= off <= AGREE


@dataclass
class ChosenStep(Prepared):
    """Run a fixed-step method to a tolerance on the error of the run; every call runs its pilots."""

    #: a small change of the state does not change the chosen step
    steps_follow_state = False

    #: a `FixedStep`
    method_: Any
    loop: StepLoop[Any] | None

    def __post_init__(self) -> None:
        super().__post_init__()
        # a step as long as the distance of two breaks would miss what happens between them
        times = [0.0, *(time for time, _ in self.breaks if 0 < time < self._end), self._end]
        self.first = min(float(np.diff(times).min()) / FIRST, self.method_.longest)
        rate = self.request.scene.conformal_rate
        if isinstance(rate, float) and rate:
            # pilots with steps far longer than the damping time all agree that nothing is left
            self.first = min(self.first, DAMPED / abs(rate))
        #: the units of the components of the motion
        self.units = np.array(self.scales(self.start)[: self._motion], dtype=float)
        #: a step is no time where the method follows the motion
        self.probes = 0 if self.method_.follows else PROBES
        if self.request.scene.clock is not None:
            self.first = min(self.first, PUSHED * self.push())
            self.probes += 2 * LOOKS
        #: most steps of a first pilot that follows the motion: their number is unbounded on a wrong path
        self.limit = WILD + WILD / 100 * self._end / self.time_scale_at(self.start)()
        #: prepared runs, by rung
        self.runs: Cache[Any] = Cache(KEPT)
        #: a `FixedStepRun`; for a method that follows the motion a `ToleranceRun`, with the same interface
        self.run = self.run_at(0)
        self.compile_s, self.sensitivity_source = self.run.compile_s, self.run.sensitivity_source
        self.rooms: list[Room] = []
        if self.request.engine == "llvm" and not self.method_.follows and not self.method_.iterates:
            self.at_once = self.chosen_at_once

    def run_at(self, rung: int) -> Any:
        """Return the run at the longest step over 2^(rung/8)."""

        def make() -> Any:
            shorter, r = 2.0 ** (rung / RUNGS), self.request
            most = min(r.max_steps, int(self.limit * shorter)) if self.method_.follows else r.max_steps
            request = replace(r, step=self.first / shorter, max_steps=most)
            return self.method_.run_of(request, self.loop)

        return self.runs.get(rung, make)

    def chosen_at_once(self, y0: np.ndarray) -> Solution:
        choice = self.choose(y0)
        pilot, y = choice.pilot, choice.y
        if pilot is None or pilot.ended is None:
            return self.solved(y0, lambda y0: self.ending(y0, choice))
        counts = Counts(pilot.counts.steps, choice.evaluations, 0, 0, pilot.counts.kind)
        if self.saves_start:
            y = self.from_start(y0, y)
        ended = pilot.ended | {"counts": counts}
        if self._clock is not None:
            ended["t"], y = self.times_from(y0), self._dated(y0, y)
        return Solution.of(ended, y, y0)

    def integrate(self, y0: np.ndarray) -> Outcome:
        self.require_size(y0)
        return self.ending(y0, self.choose(y0))

    def ending(self, y0: np.ndarray, choice: Choice) -> Outcome:
        """Return the outcome of a choice, with the evaluations of all its pilots."""
        pilot, out = choice.pilot, choice.outcome
        if pilot is not None:
            out = pilot.run.outcome(y0, choice.y, pilot.counts)
            out.steps = pilot.run.steps_taken
        assert out is not None
        return replace(out, counts=out.counts._replace(evaluations=choice.evaluations))

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        pilot = self.choose(y0).pilot
        run = self.run if pilot is None else pilot.run
        found: np.ndarray = run.sensitivity(y0)
        return found

    @property
    def composed(self) -> bool:
        composed: bool = self.run.composed
        return composed

    def choose(self, y0: np.ndarray) -> Choice:
        """Run pilots until one is accurate enough or the search ends."""
        try:
            room = self.rooms.pop()  # no other thread has it meanwhile
        except IndexError:
            room = Room(self)
        room.start[...] = y0
        choice = self.choose_in(room, y0)
        if len(room.states) * self._saves * len(y0) <= KEPT_NUMBERS:
            self.rooms.append(room)
        return choice

    def choose_in(self, room: Room, y0: np.ndarray) -> Choice:
        r, order = self.request, self.method_.order
        assert r.rtol is not None
        enough, aim = ENOUGH * r.rtol, AIM * r.rtol
        longest = PERIOD * min(order / HIGH, 1.0) * room.time_scale() if self.probes else math.inf
        first = max(math.ceil(RUNGS * math.log2(self.first / longest)), 0) if longest < self.first else 0
        evaluations, rung, last = self.probes, first, -1
        # many states agree only if both pilots follow the motion
        gap = Gap(LOST, math.inf, LOST) if len(self.later) > MANY else Gap()
        blown, stuck, asked, agreed = 0, 0, False, False
        while True:
            pilot = room.pilot(rung)
            evaluations += pilot.counts.evaluations or 0
            if pilot.spent and self.is_over(pilot.run, rung - first):
                return Choice(evaluations, outcome=self.beyond(pilot.run))
            before, last = last, rung
            # the watching loop is stricter than `is_sound`
            if not (pilot.fine or self.is_sound(y0, pilot)):
                blown, last, gap, rung = blown + 1, -1, Gap(), rung + RUNGS
                if blown >= BLOWN and not asked:
                    asked = True
                    end, more = self.end_of(y0)
                    evaluations += more
                    if end is not None:
                        return self.until(y0, end, pilot, evaluations)
                many = (pilot.counts.steps or 0) > LAST and blown > 2 * BLOWN
                if many or rung > first + RUNGS * OCTAVES:
                    return Choice(evaluations, outcome=self.failed(y0, pilot))
                continue
            blown = 0
            rung = room.rungs[rung]
            if before < 0:
                coarse, rung = pilot, rung + RUNGS
                continue
            wider, gap, coarse = gap, self.compare(room, before, last, coarse, pilot), pilot
            error, agree = error_of(gap, wider, order)
            # large gaps may agree with the order by chance: predict a next step, but do not accept
            if error <= enough and (wider.size <= TRUSTED or gap.slope <= enough):
                return Choice(evaluations, pilot, pilot.y.copy())
            stuck += wider.size <= ROUNDED and STUCK < gap.slope / wider.slope < GROWN
            if stuck == BLOWN:
                if gap.size <= enough:
                    return Choice(evaluations, pilot, pilot.y.copy())
                return Choice(evaluations, outcome=self.rounded(pilot, gap.size))
            if agree and error < math.inf:
                reach, agreed = FAR if agreed else NEAR, True
                further = self.rungs_to(error / aim, reach)
                if (self.run_at(rung + further).needed or 0) > r.max_steps:
                    further = self.rungs_to(error / enough, reach)
                rung += further
            else:
                agreed = False
                rung += RUNGS // 2 if gap.size <= enough else RUNGS

    def rungs_to(self, factor: float, reach: float) -> int:
        """Return the number of rungs that lowers the error by a factor, at most for steps `reach` times shorter."""
        octaves = math.log2(min(max(factor, 1.0) ** (1 / self.method_.order), reach))
        return max(math.ceil(RUNGS * octaves), 2)

    def is_over(self, run: Any, rungs: int) -> bool:
        """Return whether a pilot with too many steps ends the search; rungs : distance to the first pilot."""
        return run.request.max_steps >= self.request.max_steps or rungs > RUNGS * SPENT

    def is_sound(self, y0: np.ndarray, pilot: Pilot) -> bool:
        """Return whether a pilot reaches the end within the scale of the motion."""
        if pilot.spent or not np.isfinite(pilot.y[-1]).all():
            return False
        out = self.finish(y0, self.from_start(y0, pilot.y), pilot.counts)
        return self.audit(y0, out).status is Status.ok

    def compare(self, room: Room, before: int, rung: int, coarse: Pilot, fine: Pilot) -> Gap:
        ratio = (fine.counts.steps or 1) / (coarse.counts.steps or 1)
        if self.method_.follows:
            shorter = 2.0 ** ((rung - before) / RUNGS)
            if not 1 / OTHER < ratio / shorter < OTHER:  # they took different paths
                return Gap()
            ratio = shorter
        size = room.gap(before, rung)
        return Gap(size, ratio, size / (ratio - 1))

    # -- no pilot is accepted ------------------------------------------------------------------------
    def nothing(self, counts: Counts, status: Status, message: str, end: float = 0.0) -> Outcome:
        y = np.full((self._saves, len(self.start)), math.nan)
        return Outcome(y, counts, status, message, end)

    def beyond(self, run: Any) -> Outcome:
        r, step = self.request, run.steps_taken[0]
        message = (
            f"rtol = {r.rtol:g} needs a step of {step:.3g} or less, more steps than max_steps = {r.max_steps}"
        )
        return self.nothing(Counts(kind=self.method_.kind_on(r.scene)), Status.budget, message)

    def rounded(self, pilot: Pilot, error: float) -> Outcome:
        message = f"rounding errors are {error:.2g} of the motion: no step gives rtol = {self.request.rtol:g}"
        return self.nothing(pilot.counts, Status.failed, message)

    def failed(self, y0: np.ndarray, pilot: Pilot) -> Outcome:
        """Return the outcome of the last pilot where the search is given up, with a message about rtol."""
        out: Outcome = pilot.run.integrate(y0)
        step, rtol = pilot.run.steps_taken[0], self.request.rtol
        if out.status is Status.failed:
            out.message = f"no step down to {step:.3g} leads beyond t = {out.end_time:.6g} (rtol = {rtol:g})"
        elif out.status is Status.diverged:
            out.message += f", with steps down to {step:.3g} (rtol = {rtol:g})"
        return replace(out, steps=pilot.run.steps_taken)

    def end_of(self, y0: np.ndarray) -> tuple[Outcome | None, int]:
        """Return the outcome of an adaptive solver, None unless it diverges, and its evaluations."""
        r, witness = self.request, METHODS[WITNESS]
        if witness.refuses(r.scene) is not None:
            return None, 0
        run = prepare(r.scene, witness, rtol=WITNESS_RTOL, save_at=Elapsed([r.save_at[-1]]), carry=r.carry)
        out = run.integrate(y0)
        return out if out.status is Status.diverged else None, out.counts.evaluations or 0

    def until(self, y0: np.ndarray, end: Outcome, pilot: Pilot, evaluations: int) -> Choice:
        """Solve up to the last saved time before the motion diverges; return these states as `diverged`."""
        before = self.request.save_at[self.request.save_at < end.end_time]
        out = self.nothing(pilot.counts, Status.diverged, end.message, end.end_time)
        if len(before) and before[-1] > 0:
            run = self.method_.prepare(replace(self.request, save_at=before))
            found = run.integrate(y0)
            evaluations += found.counts.evaluations or 0
            if found.status is not Status.ok:
                return Choice(evaluations, outcome=found)
            out.y[: len(before)] = found.y
            out.counts, out.steps = found.counts, found.steps
        return Choice(evaluations, outcome=out)

    # -- the first pilot -------------------------------------------------------------------------------
    def push(self) -> float:
        """Return the time scale of an explicitly time-dependent force at the start, of which pilots need all phases."""
        scene, span, begins = self.request.scene, self._end, self.request.scene.begins
        near = max(NEXT * span, APART * math.ulp(abs(begins) + span))

        def slope(time: float) -> np.ndarray:
            x = scene.unpack(scene.entries(self.start), self.request.carry)._replace(t=begins + time)
            return np.asarray(np.array(scene.pack(scene.rhs(x))[: self._motion], dtype=float) / self.units)

        with suppress(*NO_NUMBER), np.errstate(all="ignore"):
            times = [span * (k * GOLDEN % 1.0) for k in range(1, LOOKS + 1)]
            here, there = (np.array([slope(time + after) for time in times]) for after in (0.0, near))
            fast = np.linalg.norm(there - here, axis=1).max() / near
            swing = np.linalg.norm(here - here[0], axis=1).max() / 2
            if swing > (self.request.rtol or 0.0) * np.linalg.norm(here, axis=1).max() and fast > 0:
                return float(swing / fast)
        return math.inf

    def time_scale_at(self, y: np.ndarray) -> Callable[[], float]:
        """Return a function that computes 1/ω at the present content of the state y; ω² = ‖J²f‖/‖f‖, in any units."""
        scene, carry, units = self.request.scene, self.request.carry, self.units.tolist()
        own, d, found = np.array([scene.numbers()], dtype=float), len(y), np.zeros(2)

        def of_numbers(y: Sequence[Arithmetic], *given: Any) -> tuple[Arithmetic, Arithmetic]:
            *numbers, xp = given
            return curvature(scene.with_numbers(numbers), y, carry, units, xp)

        def call() -> object:
            found[:] = 0.0
            with suppress(*NO_NUMBER), np.errstate(all="ignore"):
                found[:] = curvature(scene, scene.entries(y), carry, units, math)
            return found

        if self.request.engine == "llvm":
            with suppress(CannotRecord):
                made = formula(of_numbers, (d, *[0] * own.size, "xp"), ())
                names = argument_names(made.arguments, ())
                loads = [Assign(name, Element("start", (i,))) for i, name in enumerate(names[:d])]
                loads += [Assign(name, Element("w", (0, i))) for i, name in enumerate(names[d:])]
                stores = [Store(Element("after", (i,)), value) for i, value in enumerate(made.results)]
                whole = Function("curvature", ("start", "w", "after"), (*loads, *made.body, *stores))
                call = compile_function(whole).closed(y, own, found)

        def time_scale() -> float:
            call()
            fast, slow = found.tolist()
            return math.sqrt(slow / fast) if 0 < fast < math.inf and slow > 0 else math.inf

        return time_scale


def curvature(
    scene: Scene, y: Sequence[Arithmetic], carry: Sequence[str], units: Sequence[float], xp: Namespace
) -> tuple[Arithmetic, Arithmetic]:
    """Return ‖J²f‖ and ‖f‖ of the motion at a packed state, in units; f excludes a constant damping, which is slow."""
    rate, motion = scene.conformal_rate, len(units)
    momenta = motion // 2 if hasattr(scene.unpack(y, carry), "q") else 0
    damped = range(momenta, 0 if rate is None else motion)

    def slope(y: Sequence[Arithmetic]) -> list[Arithmetic]:
        f = scene.pack(scene.rhs(scene.unpack(y, carry)))
        return [c + rate * y[i] if i in damped else c for i, c in enumerate(f)]

    def size(w: Sequence[Arithmetic]) -> Arithmetic:
        first, *others = (c / unit for c, unit in zip(w, units, strict=False))
        return xp.sqrt(sum((c * c for c in others), first * first))

    def bent(w: Sequence[Arithmetic]) -> list[Arithmetic]:
        near = BESIDE * choose(whole > 0, whole, 1.0, xp) / choose(size(w) > 0, size(w), 1.0, xp)
        there = slope([a + near * b for a, b in zip(y, w, strict=True)])
        return [(a - b) / near for a, b in zip(there, first, strict=True)]

    whole, first = size(y), slope(y)
    return size(bent(bent(first))), size(first)
