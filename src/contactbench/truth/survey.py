"""Find all places where a motion changes fast: an engine of any order may step over a pulse.

DOP853 follows the motion.  On each step the slopes along the interpolant are sampled on a fine grid, and the step is
cut, first at the worst sample, until polynomials fit all samples.  The integral of the slopes must agree with the
change of the state: a step that missed a feature is repeated in the pieces.  Every component is compared on its own
scale at that time, since a small component may decide on the motion.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from contactbench.errors import BadInput
from contactbench.scene import Scene
from contactbench.truth.engines import (
    DoublesOnly,
    OutOfTime,
    Stopwatch,
    across_breaks,
    initial_value_problem,
    jump_at,
    no_reference,
    of_bends,
    sides,
)

if TYPE_CHECKING:
    from scipy.integrate import DenseOutput

#: relative tolerance of a step, and of its change against the integral of the slopes
STEP, OFF = 1e-10, 1e-7
EPSILON = np.finfo(float).eps
#: most samples of a motion: numbers for a function of arrays, calls for one of floats; least samples on a step
SAMPLES, ONE_BY_ONE, LEAST = 2**19, 2**14, 16
#: allowed deviation of samples from the polynomial, relative to the slopes and to their change with the state
RESOLVED = 1e-8
#: rounding of times and states; the shortest piece, relative to the span, that is cut at a fixed state
ROUNDING, FINEST = 1e-14, 1e-7
#: halvings along the motion of the scale of a component that was large; the least scale relative to the largest
HALVINGS, FAINT = 100, 1e-24
#: largest change of the motion by rounding of its force, relative to the largest component
LOST = 1e-10
#: number of times at which slopes are compared with slopes one rounding later
BLURRED = 64
#: slopes below this part of the largest count as zero: their squares underflow
NONE = 1e-100
#: most pieces of a motion; the shortest piece relative to the span
PIECES, SHORTEST = 20_000, 1e-13
#: largest ratio of the distance of two stops to the shortest piece between them
LONGER = 2.0
#: largest ratio of neighbouring distances between stops
GRADED = 2.0

_angles = math.pi * (np.arange(12) + 0.5) / 12
#: Chebyshev's points on [0, 1], their barycentric weights, and the weights of Fejér's quadrature
NODES, BARYCENTRIC = (1 - np.cos(_angles)) / 2, np.sin(_angles) * (-1.0) ** np.arange(12)
FEJER = [(1 - 2 * sum(math.cos(2 * k * a) / (4 * k * k - 1) for k in range(1, 6))) / 12 for a in _angles]

#: f(t, y) of k times and states (d, k)
Slopes = Callable[[np.ndarray, np.ndarray], np.ndarray]


def of_many_times(scene: Scene, carry: tuple[str, ...]) -> tuple[Slopes, bool]:
    """Return f(t, y) for k times and states (d, k), and whether it is vectorised."""
    one, start, origin = initial_value_problem(scene, carry)

    def together(t: np.ndarray, y: np.ndarray) -> np.ndarray:
        rows = scene.slopes(origin + t, tuple(y), carry)
        return np.array([np.broadcast_to(row, t.shape) for row in rows], dtype=float)

    def one_by_one(t: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.array([one(*pair) for pair in zip(t.tolist(), y.T, strict=True)], dtype=float).T

    try:
        if np.array_equal(together(np.zeros(2), np.array([start, start]).T)[:, 0], one(0.0, start)):
            return together, True
    except Exception:  # a function of floats only
        pass
    return one_by_one, False


@dataclass
class Survey:
    """The motion of a scene to a time, in pieces on which its slopes are polynomials."""

    scene: Scene
    carry: tuple[str, ...]
    end: float
    deadline: float = math.inf
    #: whether the motion was too long to be followed
    unseen: bool = False
    #: why it was not followed to its end
    ended: DoublesOnly | None = None

    def __post_init__(self) -> None:
        self.slope, self.start, self.origin = initial_value_problem(self.scene, self.carry)
        self.slopes, arrays = of_many_times(self.scene, self.carry)
        self.samples = SAMPLES // len(self.start) if arrays else ONE_BY_ONE
        # range of the slopes over time at a fixed state
        self.varying = np.zeros_like(self.start)
        self.largest = max(np.abs(self.start).max(), np.abs(self.slope(0.0, self.start)).max())
        if self.scene.clock is not None:
            t = np.linspace(0.0, self.end, self.samples)
            with np.errstate(all="ignore"):
                waiting = np.nan_to_num(self.slopes(t, np.tile(self.start[:, None], len(t))))
            self.varying = np.ptp(waiting, axis=1)
            self.largest = max(self.largest, np.abs(waiting).max())
        self.largest = self.largest or 1.0
        self.precision = max(STEP, 10 * self.blur)
        self.off = max(OFF, 10 * self.precision)
        self.signs = np.random.default_rng(0).choice([-1.0, 1.0], (len(self.start), len(NODES)))
        #: states at the ends of steps, and their errors
        self.known: dict[float, tuple[np.ndarray, np.ndarray]] = {}
        self.breaks = self.scene.breaks_until(self.end)
        self.sides = sides(self.breaks, self.end)

    @cached_property
    def blur(self) -> float:
        """Return the relative change of the slopes over one rounding of the time, which matters far from 0."""
        if not float(self.origin):
            return 0.0
        t = np.linspace(0.0, self.end, BLURRED)
        y = np.tile(self.start[:, None], BLURRED)
        with np.errstate(all="ignore"):
            near = self.slopes(t + np.spacing(abs(float(self.origin)) + t), y) - self.slopes(t, y)
        return float(np.median(np.abs(np.nan_to_num(near)), axis=1).max() / self.largest)

    @cached_property
    def stops(self) -> list[float]:
        """Return times that no step may straddle; none, or for a driven force `OutOfTime`, if time is short."""
        ends = [0.0]
        try:
            self.follow([self.end], None, ends)
        except DoublesOnly as why:  # perhaps a singularity, which other engines resolve
            self.ended = why
        except OutOfTime:
            if self.scene.clock is not None:
                raise
            self.unseen, ends = True, [0.0]
        return sorted({*stops_between(ends), *self.sides})

    def check(self, times: Sequence[float], states: np.ndarray) -> None:
        """Raise `BadInput` unless states (k, d) at increasing times, stops included, agree with the motion."""
        if self.ended:
            raise self.ended
        if self.scene.clock is not None:
            states = np.delete(states, self.scene.clock, axis=1)
        pairs = ((*self.known[t], y) for t, y in zip(times, states, strict=True) if t in self.known)
        if self.unseen or all(np.all(np.abs(y - other) <= error) for y, error, other in pairs):
            return
        self.follow(times, states, [0.0])  # piece by piece: the motion may be sensitive

    def follow(self, times: Sequence[float], states: np.ndarray | None, ends: list[float]) -> None:
        """Append the ends of the pieces; raise `BadInput` if one of the states (k, d) does not lead to the next."""
        watch, y = Stopwatch(self.scene, self.end, self.deadline), self.start
        given = {} if states is None else dict(zip(times, states, strict=True))
        self.recent = self.scale = np.maximum(np.abs(y), FAINT * self.largest)
        self.least, self.lost = self.precision * self.scale, np.zeros_like(y)
        for bound in sorted({*times, *self.sides} - {0.0}):
            with np.errstate(all="ignore"):
                y = self.piece(ends, y, bound, watch)
            if bound in given:
                if not np.all(np.abs(y - given[bound]) <= self.known[ends[-1]][1]):
                    why = f"two engines disagree before t = {bound:g}"
                    raise BadInput(no_reference(self.scene, why))
                y, self.lost = given[bound], np.zeros_like(y)

    def motion(self, t: float, y: np.ndarray) -> np.ndarray:
        try:
            slope = self.slope(t, y)
        except OverflowError:  # the step is too long
            return np.full_like(y, np.inf)
        return np.where(np.abs(slope) < NONE * self.largest, 0.0, slope)

    def piece(self, ends: list[float], y: np.ndarray, bound: float, watch: Stopwatch) -> np.ndarray:
        """Follow the motion from the last of `ends` to a bound, append the ends, and return the state there."""
        from scipy.integrate import DOP853

        due = [bound]
        while due:
            if any(time - m <= ends[-1] and due[-1] <= time + m for time, m in self.breaks):
                (y,) = across_breaks(lambda *_, **__: [], self.slope, y, [due[-1]], self.breaks, ends[-1])
                ends.append(due.pop())
                continue
            solver = DOP853(self.motion, ends[-1], y, due[-1], rtol=self.precision, atol=self.least)
            while solver.status == "running":
                watch.check(solver.t)
                if not math.isfinite(solver.h_abs) or solver.step() is not None:
                    if np.all(self.least >= self.precision * self.largest):
                        raise DoublesOnly(no_reference(self.scene, "it cannot be followed"))
                    self.least = np.maximum(self.least, self.precision * self.largest)
                    break  # repeat with a coarser tolerance for small components
                step, size = solver.t - solver.t_old, np.maximum(np.abs(y), np.abs(solver.y))
                recent = np.maximum(size, self.recent * 2 ** (-HALVINGS * step / self.end))
                cuts, integral, coupled = self.cut(solver.t_old, solver.t, solver.dense_output(), recent)
                # includes the change of a component by others and by a force that is rounding
                scale = np.maximum(recent, step * np.maximum(coupled, ROUNDING / self.off * self.varying))
                if len(cuts) > 1 and np.any(np.abs(solver.y - y - integral) > self.off * scale):
                    due = sorted({*due, *cuts}, reverse=True)
                    break  # repeat in pieces
                y, self.recent, self.scale = solver.y, np.maximum(recent, FAINT * self.largest), scale
                self.lose(solver.t_old + step / 2, step, solver.dense_output())
                self.known[solver.t] = y, 10 * self.off * scale + np.abs(self.lost)
                solver.atol = self.least = self.precision * scale + ROUNDING * step * self.varying
                ends += cuts
                if len(ends) > PIECES:
                    rough = f"it is too rough at t = {ends[-1]:.6g}{of_bends(self.scene)}"
                    raise DoublesOnly(no_reference(self.scene, rough))
            else:
                due.pop()
        return y

    def lose(self, t: float, step: float, path: DenseOutput) -> None:
        """Add the error due to rounding of the force, to first order."""
        y = path(t)
        drift = self.slope(t, y + self.lost) - self.slope(t, y) + 4 * EPSILON * self.varying
        most = LOST * self.largest
        self.lost = np.clip(self.lost + step * np.nan_to_num(drift), -most, most)

    def cut(
        self, a: float, b: float, path: DenseOutput, sizes: np.ndarray
    ) -> tuple[list[float], np.ndarray, np.ndarray]:
        """Return the ends of the pieces of a step, the integral of the slopes, and their change with the state."""
        ends, integral, left = list[float](), np.zeros_like(self.start), [(a, b)]
        steepest = coupled = np.zeros_like(self.start)
        timed, moved = self.scene.clock is not None, self.signs * sizes[:, None]
        while left:
            a, b = left.pop()
            x, weights = samples_of(LEAST + int(self.samples * ((b - a) / self.end)))
            every = a + (b - a) * x
            nodes, states = every[: len(NODES)], path(every)
            fixed = np.tile(path((a + b) / 2)[:, None], len(x) * timed)
            near = states[:, : len(NODES)]
            later = nodes + ROUNDING * (nodes + abs(float(self.origin)))
            t = [every, nodes, later, every[: len(x) * timed]]
            y = [states, near + RESOLVED * moved, path(later) + ROUNDING * moved, fixed]
            bounds = np.cumsum([part.size for part in t])[:-1]
            values, shifted, rounded, frozen = np.split(
                self.slopes(np.concatenate(t), np.concatenate(y, axis=1)), bounds, axis=1
            )
            at_nodes = values[:, : len(NODES)]
            steepest = np.maximum(steepest, np.abs(np.nan_to_num(values)).max(axis=1))
            coupled = np.maximum(coupled, np.abs(shifted - at_nodes).max(axis=1) / RESOLVED)
            noise = 4 * (np.abs(rounded - at_nodes).max(axis=1) + EPSILON * (self.varying + steepest))
            allowed = RESOLVED * np.maximum(steepest, coupled) + noise
            off = excess(values, weights, allowed)
            resolved = np.all(off <= 1)
            if resolved and timed and b - a > FINEST * self.end:
                off = excess(frozen, weights, noise)
            if np.all(off <= 1) or b - a <= SHORTEST * self.end:
                if not resolved and timed:
                    raise jump_at(self.scene, b)
                ends.append(b)
                integral += (b - a) * (at_nodes @ FEJER)
                continue
            worst = every[len(NODES) + int(np.argmax(off))]
            if not a + 0.1 * (b - a) < worst < b - 0.1 * (b - a):
                worst = (a + b) / 2
            left += [(worst, b), (a, worst)]
            if len(left) > PIECES:
                break
        return ends, integral, coupled


@lru_cache(64)
def samples_of(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes and `count` samples on [0, 1], and the weights that interpolate from nodes to samples."""
    x = np.linspace(0.0, 1.0, count)
    weights = BARYCENTRIC / (x[:, None] - NODES + 1e-300)
    return np.concatenate([NODES, x]), (weights / weights.sum(axis=1)[:, None]).T


def excess(values: np.ndarray, weights: np.ndarray, allowed: np.ndarray) -> np.ndarray:
    """Return the deviation of samples from the polynomial through the nodes over the allowed one, worst component."""
    off = np.abs(values[:, : len(NODES)] @ weights - values[:, len(NODES) :])
    return np.where(off == 0, 0.0, off / allowed[:, None]).max(axis=0)


def stops_between(ends: list[float]) -> list[float]:
    """Return some of the ends of pieces; no distance is much longer than its neighbours or a piece in it."""
    stops, shortest = [0.0], math.inf
    for before, end in itertools.pairwise(ends):
        shortest = min(shortest, end - before)
        if end - stops[-1] > LONGER * shortest and before > stops[-1]:
            stops.append(before)
            shortest = end - before
    if len(stops) == 1:
        return []
    stops.append(ends[-1])
    graded = stops[:1]
    for k, end in enumerate(stops[1:], 1):
        left = graded[-1] - graded[-2] if len(graded) > 1 else math.inf
        right = stops[k + 1] - end if k + 1 < len(stops) else math.inf
        rising, falling = list[float](), list[float]()
        at, step = stops[k - 1], GRADED * left
        back, behind = end, GRADED * right
        while back - at > min(step, behind) * GRADED:
            if step <= behind:
                at += step
                rising.append(at)
                step *= GRADED
            else:
                back -= behind
                falling.append(back)
                behind *= GRADED
        graded += [*rising, *reversed(falling), end]
    return graded[1:-1]
