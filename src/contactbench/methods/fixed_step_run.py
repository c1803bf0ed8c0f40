"""Runs of fixed-step methods: the division of time into steps, which a loop takes."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from contactbench.methods.dates import dates, division, from_origin
from contactbench.methods.dense import Nodes, on_grid
from contactbench.methods.loops import StepLoop, is_fixed, total
from contactbench.methods.parts import Parts
from contactbench.methods.prepared import Outcome, Pilot, Prepared, Request
from contactbench.methods.prescribed import EQUAL, UNCOUNTED, ends_between, plateaus, steps_in
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import AnyState
from contactbench.scene.base import Numeric
from contactbench.solution import Counts, Solution, Status

if TYPE_CHECKING:
    from contactbench.methods.fixed_step import FixedStep


#: a state is ordinary if its size is below this part of the bound of divergence
ORDINARY = 1e-4


@dataclass
class FixedStepRun(Prepared):
    """Run a `FixedStep` by a loop over intervals of equal steps.

    Parameters
    ----------
    method, request, compile_s
        As of `Prepared`.
    method_
        The `FixedStep` itself.
    loop
        The loop that takes the steps.
    """

    method_: FixedStep
    loop: StepLoop[Any]

    def __post_init__(self) -> None:
        super().__post_init__()
        r = self.request
        #: ends of the intervals of equal steps, and the numbers of the intervals that end at saved times
        self.ends = self.later
        self.saves: slice | np.ndarray = slice(None)
        if self.breaks:
            self.ends, self.saves = division(r.scene, self.later)
        self.marks = self.ends.copy()
        self.marks[1:] -= self.ends[:-1]
        self.first_step = self.method_.counts(r.scene, 1, r.carry)
        self.each_step = self.method_.counts(r.scene, 2, r.carry) - self.first_step
        self.kind = self.method_.kind_on(r.scene)
        self.divide(r.step or math.nan)  # a fixed-step request always has one
        #: whether the loop gives the saved states alone, within the budget of steps
        self.simple = isinstance(self.saved, slice) and self.needed <= r.max_steps
        self.sensitivity_source, self.compile_s = self.loop.derivative, self.loop.seconds
        if not is_fixed(self.method_):  # a user's map may change before its derivative is needed
            with suppress(CannotRecord):
                self.loop.tangents  # noqa: B018, recorded now
        self.shorten()

    def shorten(self) -> None:
        """Precompute closures for the common case."""
        self.bare = self.loop.last(self.ready)  # type: ignore
        states = self.loop.watched(self.ready, self.needed, self.saves_start) if self.simple else None
        if states is None:
            return
        of, date, dated, first = Solution.of, self._dated, self._clock is not None, int(self.saves_start)
        times = self.times_from
        ended = self.attributes(Status.ok, "", self.totals, self._end, self.steps_taken)

        def at_once(y0: np.ndarray) -> Solution:
            y, fine = states(y0)
            if fine:
                return of(ended | {"t": times(y0)}, date(y0, y), y0) if dated else of(ended, y, y0)
            return self.solved(y0, lambda y0: self.outcome(y0, y[first:], self.totals))

        self.at_once = at_once

    def divide(self, step: float) -> None:
        scene, ends = self.request.scene, self.ends
        #: numbers of the intervals that end at saved times
        self.saved = self.saves
        if self.request.steps is not None:
            self.h, self.n, reached = plateaus(self.request.steps, ends)
            self.saved = reached[self.saves]
            ends = ends_between(self.h * self.n, reached, ends)
        else:
            self.n = steps_in(self.marks, ends, step)
            self.h = self.marks / self.n
        #: the `dates` of the intervals; None for a scene without a time
        self.since = dates(scene, np.append(0.0, ends[:-1]), ends) if scene.keeps_dates else None
        self.steps_taken = step, float(np.maximum.reduce(self.h))
        self.totals, self.needed = self.cost(self.n), total(self.n)
        self.ready = self.loop.ready(self.h, self.n, self.since)

    def cost(self, n: np.ndarray) -> Counts:
        """Return the counts of intervals of n[k] steps; every interval starts anew; no evaluations if steps iterate."""
        steps = total(n)
        evaluations = len(n) * self.first_step + (steps - len(n)) * self.each_step
        return Counts(steps, None if self.method_.iterates else evaluations, 0, 0, self.kind)

    def part(self, y0: np.ndarray, y: np.ndarray, h: Any, n: Any, since: np.ndarray | None) -> np.ndarray:
        """Return packed states after each of some intervals, (k, d), from y on, in a run from y0."""
        ready = self.loop.ready(np.array(h), np.array(n), since)
        return self.loop.take(from_origin(self.request.scene, y, y0), ready)[0]

    def take(self, y0: np.ndarray) -> tuple[np.ndarray, Counts]:
        """Return the packed states after each interval, and the counts."""
        y, made = self.loop.take(y0, self.ready)
        return y, self.totals._replace(evaluations=made) if self.method_.iterates else self.totals

    def bare_states(self, y0: np.ndarray) -> np.ndarray:
        return self.take(y0)[0][self.saved]

    def into(self, start: np.ndarray, after: np.ndarray) -> Callable[[], int] | None:
        """Return the run on fixed memory, see `StepLoop.into`; None if it needs more than the loop."""
        return self.loop.into(self.ready, self.needed, start, after) if self.simple else None

    def pilot(self, y0: np.ndarray) -> Pilot:
        """Run as a pilot, unless that takes too many steps."""
        if self.needed > self.request.max_steps:
            return Pilot(self, np.full((len(self.later), len(y0)), math.nan), Counts(), spent=True)
        y, counts = self.take(y0)
        return Pilot(self, y[self.saved], counts)

    def integrate(self, y0: np.ndarray) -> Outcome:
        self.require_size(y0)
        r = self.request
        if self.needed > r.max_steps:
            needed = str(self.needed) if self.needed < UNCOUNTED else f"more than {UNCOUNTED:.0e}"
            message = f"{needed} steps needed, max_steps = {r.max_steps}"
            return self.finish(y0, np.empty((0, len(y0))), Counts(), Status.budget, message)
        y, counts = self.take(y0)
        return self.outcome(y0, y[self.saved], counts)

    def outcome(self, y0: np.ndarray, y: np.ndarray, counts: Counts) -> Outcome:
        out = self.finish(y0, self.from_start(y0, y), counts)
        return out if out.status is not Status.diverged else self._locate(y0, out)

    def _locate(self, y0: np.ndarray, out: Outcome) -> Outcome:
        """Return the outcome with the step at which the run diverges, found by bisecting its interval."""
        r = self.request
        k = int(np.argmax(np.isnan(out.y).all(axis=1)))  # the first saved time not reached
        good, time = (out.y[k - 1], float(r.save_at[k - 1])) if k else (y0, 0.0)
        ends = np.append(0, np.arange(1, len(self.n) + 1)[self.saved])
        i, end = ends[k - int(self.saves_start) :][:2]
        i = min(i, end - 1)
        if i + 1 < end:  # several intervals lead there
            rows = slice(i, end)
            since = None if self.since is None else self.since[rows]
            y = self.part(y0, good, self.h[rows], self.n[rows], since)
            reached = self.first_divergence(y0, y)
            assert reached is not None
            good = y[reached - 1] if reached else good
            time += float(self.h[i : i + reached] @ self.n[i : i + reached])
            i += reached
        h, left, taken = self.h[i], int(self.n[i]), 0
        while left > 1:
            half = left // 2
            y = self.part(y0, good, [h], [half], self.dated(i, taken))
            if self.first_divergence(y0, y) is None:
                good, time, taken, left = y[0], time + float(half * h), taken + half, left - half
            else:
                left = half
        end = time + float(h)
        counts = self.cost(np.append(self.n[:i], taken + 1))
        if self.method_.unsolved and self.lacks_a_step(y0, good, float(h), self.dated(i, taken)):
            message = (
                f"{self.method_.unsolved} at t = {time:.6g}, of a step of {h:.6g}: a smaller one is needed"
            )
            return Outcome(out.y, counts, Status.failed, message, time)
        message = f"left the scene's scale by a factor 1e6 at t = {end:.6g}"
        return Outcome(out.y, counts, Status.diverged, message, end)

    def dated(self, i: int, taken: int) -> np.ndarray | None:
        """Return the dates of one interval that begins after some steps of the i-th."""
        return None if self.since is None else self.since[i : i + 1] + np.array([taken * self.h[i], 0.0, 0.0])

    def lacks_a_step(self, y0: np.ndarray, good: np.ndarray, h: float, since: np.ndarray | None) -> bool:
        """Return whether the iteration of a step of this size fails at a state of ordinary size."""
        most = ORDINARY * self.bounds(y0)
        after = self.part(y0, good, [h], [1], since)[0]
        return bool(np.isnan(after).any() and (np.abs(good[: len(most)]) <= most).all())

    # -- the map ---------------------------------------------------------------------------------------
    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        tangents = self.tangents(y0)
        steps = self.h, self.n, self.since
        columns = [self.loop.tangent(y0, v, *steps)[self.saved] for v in tangents]
        return self.from_start(np.array(tangents).T, np.stack(columns, axis=-1))

    @property
    def composed(self) -> bool:
        return self.method_.composed(self.request.scene)

    def modified_hamiltonian(self, x: AnyState) -> Numeric:
        """Return H̃ as in `Prepared`, if all steps have one size: H̃ depends on it."""
        if np.ptp(self.h) > EQUAL * self.h[0]:
            return None
        return self.method_.modified_hamiltonian(self.request.scene, x, float(self.h[0]))


#: evaluations that may be spent on saving states at the ends of steps, in parts of those of the steps
SHARE = 0.15
#: least number of nodes between two breaks, where there are as many steps
LEAST = 24


class EqualSteps(Parts):
    """Equal steps between breaks, with nodes at every k-th of them."""

    def __init__(self, run: FixedStepRun, method: FixedStep, piece: np.ndarray, longest: float) -> None:
        super().__init__(method, run.request, longest)
        self.run = run
        self.judged = run if run.method_ is method else None  # its derivative begins anew at every saved time
        self.piece = piece
        self.t = np.append(0.0, run.ends)

    @staticmethod
    def of(method: FixedStep, request: Request) -> EqualSteps | None:
        """Return the steps; None if all saved times are ends of steps."""
        scene, saved = request.scene, request.save_at
        later = saved[saved > 0]
        marks = np.append(0.0, division(scene, later[-1:])[0])
        n = steps_in(np.diff(marks), marks[1:], request.step or math.nan)
        if total(n) > request.max_steps:
            return None
        each, keeping = method.per_step(scene, request.carry), method.keeping(scene)
        more = keeping.cost_of_saving(scene, request.carry) + method.one_step
        grids, whole = [], []
        for begin, end, count in zip(marks, marks[1:], n.tolist(), strict=False):
            k = max(1, min(math.ceil(more / (SHARE * each)), count // LEAST))
            whole.append(np.append(np.arange(count) * ((end - begin) / count) + begin, end))
            grids.append(np.append(whole[-1][:-1:k], end))
        if (on_grid(later, np.unique(np.concatenate(whole))) >= 0).all():
            return None
        piece = [np.full(len(grid), number) for number, grid in enumerate(grids)]
        nodes = np.concatenate([grids[0], *(grid[1:] for grid in grids[1:])])
        run: Any = keeping.prepare(replace(request, save_at=nodes))
        source = EqualSteps(run, method, np.concatenate(piece), float(np.max(np.diff(marks) / n)))
        source.t = np.concatenate(grids)
        return source

    def steps(self, y0: np.ndarray) -> tuple[Nodes, Counts] | None:
        found = self.run.audit(y0, self.run.integrate(y0))
        if found.status is not Status.ok:
            return None
        again = np.append(0, np.cumsum(np.diff(self.piece) == 0))  # a break is two nodes
        return Nodes(self.t, found.y[again], self.piece), found.counts
