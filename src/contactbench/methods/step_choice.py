"""A fixed step chosen from a tolerance: pilots at ever shorter steps, until one has the error asked for.

The step is the same throughout a run, so that a contact method keeps everything it keeps.  Two pilots over the same
saved times, the steps of the coarser r times as long, give the error of the finer one, gap/(r^p − 1) (Richardson), if
errors fall as the order p says.  They are known to where a third pilot agrees: its gap to the other is the one that p
foretells.  Where it is not, the error counts as a power of the disagreement larger; and a step is foretold only where
it is.  The first pilot whose error is small enough is the run.

Saved times shorten steps: what counts is the number of those that are taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
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

#: errors that are small enough, and those a step is foretold for, as parts of the tolerance
ENOUGH, AIM = 0.7, 0.4
#: first pilot: this many steps over the whole span, or between breaks
FIRST = 4
#: steps are the longest one over powers of 2^(1/8), so that those of other calls are known
RUNGS = 8
#: prepared runs that are kept, and numbers in the states of their pilots
KEPT, KEPT_NUMBERS = 64, 2**22
#: damping times the first step at most
DAMPED = 8.0
#: gaps after one as large as the motion are not asymptotic; after smaller ones than the second the order is believed
LOST, TRUSTED = 1.0, 0.1
#: the first pilot's step is at most about a period of the motion, as the start has it, of high orders, and as much
#: less as the order is: longer ones all fly off alike, and no error falls as the order says
PERIOD, HIGH = 6.0, 4
#: `push` evaluates the force at so many times of the span, spaced by golden sections
LOOKS, GOLDEN = 8, 0.6180339887498949
#: and again after this part of the span, or after so many roundings of the time where they are longer
NEXT, APART = 1e-9, 2.0**10
#: the first pilot's step is at most so many times the time scale of the force
PUSHED = 2.0
#: right-hand sides that the period takes, and the distance between them, relative to the motion
PROBES, BESIDE = 3, 1e-6
#: gaps are rounding errors where after one below the first of these they neither fall nor grow, as slopes, beyond the
#: others
ROUNDED, STUCK, GROWN = 1e-6, 0.7, 20.0
#: gaps that differ from the one foretold by this factor at most agree
AGREE = 2.0
#: a gap that is off the one foretold by a factor makes the error larger by this power of it, above and below
ABOVE, BELOW = 3, 2
#: where gaps fall, an error is at most so many times the slope of its gap
MOST = 2.0
#: saved states from which on two pilots that agree need no third one
MANY = 32
#: a gap of this size is round-off
ROUND_OFF = 1e-13
#: steps of a first pilot at most, and a hundredth of it for every unit of the motion's time; octaves of more steps
WILD, SPENT = 1e4, 6
#: of steps that follow the motion: pilots have followed different motions if their numbers of steps are this far off
OTHER = 1.25
#: pilots in a row that leave any scale, after which a method with step control is asked whether the motion does
BLOWN, WITNESS, WITNESS_RTOL = 3, "rk8-7", 1e-8
#: the search ends at a pilot of so many steps after twice as many in a row, or so many octaves below the first
LAST, OCTAVES = 10**6, 20
#: a pilot's step is at most so many times shorter than that of the one before, where they agree once, and again
NEAR, FAR = 4.0, 32.0


class Choice(NamedTuple):
    """How pilots ended: the one that is good enough and its states, or the outcome where none is; all evaluations."""

    evaluations: int
    pilot: Pilot | None = None
    y: Any = None
    outcome: Outcome | None = None


class Room:
    """The memory of pilots from one start, by how many parts of an octave their steps are shorter than the longest.

    One call has it at a time.
    """

    def __init__(self, chosen: ChosenStep) -> None:
        self.chosen, self.start = chosen, np.empty(len(chosen.start))
        self.time_scale = chosen.time_scale_at(self.start)
        self.pilots: dict[int, Callable[[], Pilot]] = {}
        self.states: dict[int, np.ndarray] = {}
        #: the rung from whose next one on steps are shorter: the longest one taken may be far below the one allowed
        self.rungs: dict[int, int] = {}
        self.gaps: dict[tuple[int, int], Callable[[], float]] = {}

    def pilot(self, rung: int) -> Pilot:
        known = self.pilots.get(rung)
        if known is None:
            known = self.pilots[rung] = self.prepare(rung)
        return known()

    def prepare(self, rung: int) -> Callable[[], Pilot]:
        """Prepare the pilot as a function without arguments, on memory that is allocated once."""
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

    def gap(self, coarse: int, fine: int) -> float:
        known = self.gaps.get((coarse, fine))
        if known is None:
            known = self.gaps[coarse, fine] = distance(
                self.chosen.request, self.start, self.states[coarse], self.states[fine]
            )
        return known()


class Gap(NamedTuple):
    """Two pilots compared: how far they are apart, relative to the motion, and the ratio of their steps, > 1.

    slope : the gap over the part by which the steps of the coarser one are longer.
    """

    size: float = math.inf
    ratio: float = 2.0
    slope: float = math.inf


def error_of(gap: Gap, wider: Gap, order: int) -> tuple[float, bool]:
    """Return the error of the finest of three pilots, relative to the motion, and whether they agree on the order.

    wider : the gap of the two coarser ones; infinite where there are none.
    """
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
    """A fixed-step method run to a tolerance on the error of the run; its pilots are part of every call."""

    #: the state decides on a whole number of steps, which a small change of it leaves as it is
    steps_follow_state = False

    #: a `FixedStep`
    method_: Any
    loop: StepLoop[Any] | None

    def __post_init__(self) -> None:
        super().__post_init__()
        # between two breaks lies something that steps as long as their distance do not see
        times = [0.0, *(time for time, _ in self.breaks if 0 < time < self._end), self._end]
        self.first = min(float(np.diff(times).min()) / FIRST, self.method_.longest)
        rate = self.request.scene.conformal_rate
        if isinstance(rate, float) and rate:
            # over steps much longer than the damping takes all of such pilots agree, on nothing that is left
            self.first = min(self.first, DAMPED / abs(rate))
        #: what the components of the motion are measured in
        self.units = np.array(self.scales(self.start)[: self._motion], dtype=float)
        #: the step of a method that follows the motion is no time
        self.probes = 0 if self.method_.follows else PROBES
        if self.request.scene.clock is not None:
            self.first = min(self.first, PUSHED * self.push())
            self.probes += 2 * LOOKS
        #: steps of the first pilot at most that follow the motion: on a wrong way they may be ever more
        self.limit = WILD + WILD / 100 * self._end / self.time_scale_at(self.start)()
        #: by how many parts of an octave their steps are shorter
        self.runs: Cache[Any] = Cache(KEPT)
        #: a `FixedStepRun`, or a `ToleranceRun` of a method that follows the motion, which is asked the same
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
        """Return the outcome of a choice, with the evaluations of all pilots."""
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
        """Take pilots until one has an error that is small enough, or there is none."""
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
        evaluations, rung = self.probes, self.first_rung(room.time_scale())
        first, last = rung, -1
        # so many states agree only along the motion
        gap = Gap(LOST, math.inf, LOST) if len(self.later) > MANY else Gap()
        blown, stuck, asked, agreed = 0, 0, False, False
        while True:
            pilot = room.pilot(rung)
            evaluations += pilot.counts.evaluations or 0
            if pilot.spent and self.is_over(pilot.run, rung - first):
                return Choice(evaluations, outcome=self.beyond(pilot.run))
            before, last = last, rung
            # one that is watched may be all right in spite of what is seen
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
            # so large gaps may be as the order says by chance: a next one is foretold, but not the last
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
        """Return by how many rungs steps are shorter whose error is so many times smaller, within reach."""
        octaves = math.log2(min(max(factor, 1.0) ** (1 / self.method_.order), reach))
        return max(math.ceil(RUNGS * octaves), 2)

    def is_over(self, run: Any, rungs: int) -> bool:
        """Return whether a run of too many steps, so many rungs below the first one, ends the search."""
        return run.request.max_steps >= self.request.max_steps or rungs > RUNGS * SPENT

    def is_sound(self, y0: np.ndarray, pilot: Pilot) -> bool:
        """Return whether a pilot reaches the end, on the scale of the motion."""
        if pilot.spent or not np.isfinite(pilot.y[-1]).all():
            return False
        out = self.finish(y0, self.from_start(y0, pilot.y), pilot.counts)
        return self.audit(y0, out).status is Status.ok

    def compare(self, room: Room, before: int, rung: int, coarse: Pilot, fine: Pilot) -> Gap:
        ratio = (fine.counts.steps or 1) / (coarse.counts.steps or 1)
        if self.method_.follows:
            shorter = 2.0 ** ((rung - before) / RUNGS)
            if not 1 / OTHER < ratio / shorter < OTHER:  # they are on different ways
                return Gap()
            ratio = shorter
        size = room.gap(before, rung)
        return Gap(size, ratio, size / (ratio - 1))

    # -- where no pilot is good enough -----------------------------------------------------------------
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
        """Return the outcome of the last pilot of a search that is given up, its message in terms of rtol."""
        out: Outcome = pilot.run.integrate(y0)
        step, rtol = pilot.run.steps_taken[0], self.request.rtol
        if out.status is Status.failed:
            out.message = f"no step down to {step:.3g} leads beyond t = {out.end_time:.6g} (rtol = {rtol:g})"
        elif out.status is Status.diverged:
            out.message += f", with steps down to {step:.3g} (rtol = {rtol:g})"
        return replace(out, steps=pilot.run.steps_taken)

    def end_of(self, y0: np.ndarray) -> tuple[Outcome | None, int]:
        """Return how a motion ends that leaves any scale itself, as a solver with step control has it, and its cost.

        Pilots say too little: into a steep wall they all fly off, at the same time.
        """
        r, witness = self.request, METHODS[WITNESS]
        if witness.refuses(r.scene) is not None:
            return None, 0
        run = prepare(r.scene, witness, rtol=WITNESS_RTOL, save_at=Elapsed([r.save_at[-1]]), carry=r.carry)
        out = run.integrate(y0)
        return out if out.status is Status.diverged else None, out.counts.evaluations or 0

    def until(self, y0: np.ndarray, end: Outcome, pilot: Pilot, evaluations: int) -> Choice:
        """Solve for the saved times before the motion ends; return these states with the status `diverged`."""
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
    def first_rung(self, time_scale: float) -> int:
        longest = PERIOD * min(self.method_.order / HIGH, 1.0) * time_scale if self.probes else math.inf
        return max(math.ceil(RUNGS * math.log2(self.first / longest)), 0) if longest < self.first else 0

    def push(self) -> float:
        """Return the time scale on which the force at the start's position changes; infinite where it does not.

        Pilots whose steps are whole periods of the force meet it in one phase, and agree on a wrong motion.
        """
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
        """Return a function that gives 1/ω of the motion at the packed state y, read when it is called.

        ω² = ‖J²f‖/‖f‖, in any units; infinite where f is still.
        """
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
    """Return ‖J²f‖ and ‖f‖ of the motion at a packed state, in units.

    A constant damping is no part of f: what it leaves is slow, and contact steps may be longer than it takes.
    """
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
