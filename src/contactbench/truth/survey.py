"""Where a motion changes fast, found by looking everywhere along it: an engine of any order may step over a pulse.

A motion is followed by steps of DOP853.  On each, the slopes along its interpolant are sampled on a fine grid, and the
step is cut, at the worst sample first, until a polynomial has them all.  Their integral is what the state should have
changed by: a step that did not see what the samples show is taken again, in the pieces it was cut into.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
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
    sides,
)

if TYPE_CHECKING:
    from scipy.integrate import DenseOutput

#: relative tolerance of a step, and by how much its change may be off the integral of the slopes, against the motion
STEP, OFF = 1e-10, 1e-7
#: samples of a motion: numbers at most, of a function that takes arrays or not; and on a step at least
SAMPLES, ONE_BY_ONE, LEAST = 2**19, 2**14, 16
#: how far samples may be off a polynomial, against the largest slope
RESOLVED = 1e-8
#: pieces of a motion at most, and the shortest of them against the span
PIECES, SHORTEST = 20_000, 1e-13
#: a stop comes before an engine could take a step so many times as long as a piece in it
LONGER = 8.0

_angles = math.pi * (np.arange(12) + 0.5) / 12
#: Chebyshev's points on [0, 1], their barycentric weights, and the weights of Fejér's quadrature
NODES, BARYCENTRIC = (1 - np.cos(_angles)) / 2, np.sin(_angles) * (-1.0) ** np.arange(12)
FEJER = [(1 - 2 * sum(math.cos(2 * k * a) / (4 * k * k - 1) for k in range(1, 6))) / 12 for a in _angles]

#: f(t, y) of k times and states (d, k)
Slopes = Callable[[np.ndarray, np.ndarray], np.ndarray]


def of_many_times(scene: Scene, carry: tuple[str, ...]) -> tuple[Slopes, bool]:
    """Return f(t, y) for k times and states (d, k), and whether it takes them all at once."""
    one, start, origin = initial_value_problem(scene, carry)

    def together(t: np.ndarray, y: np.ndarray) -> np.ndarray:
        rows = scene.slopes(origin + t, tuple(y), carry)
        return np.array([np.broadcast_to(row, t.shape) for row in rows], dtype=float)

    def one_by_one(t: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.array([one(*pair) for pair in zip(t.tolist(), y.T, strict=True)], dtype=float).T

    try:
        if np.array_equal(together(np.zeros(2), np.array([start, start]).T)[:, 0], one(0.0, start)):
            return together, True
    except Exception:  # whatever a function of floats says of arrays
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

    def __post_init__(self) -> None:
        self.slope, self.start, _ = initial_value_problem(self.scene, self.carry)
        self.slopes, arrays = of_many_times(self.scene, self.carry)
        self.density = (SAMPLES / len(self.start) if arrays else ONE_BY_ONE) / (self.end or 1.0)
        # the scale of every component: what it is at the start, or has been since; all alike as long as it is none
        self.sizes, self.steepest = np.abs(self.start), np.zeros_like(self.start)
        if self.scene.clock is not None:  # a force that is rounding now may be large later
            t = np.linspace(0.0, self.end, int(self.density * self.end))
            with np.errstate(all="ignore"):
                waiting = self.slopes(t, np.tile(self.start[:, None], len(t)))
            self.steepest = np.abs(np.nan_to_num(waiting)).max(axis=1)
        self.known = dict[float, np.ndarray]()  # states at the ends of steps
        self.breaks = self.scene.breaks_until(self.end)
        self.sides = sides(self.breaks, self.end)

    @cached_property
    def stops(self) -> list[float]:
        """Times that no step of an engine is to straddle, the end not among them.

        None where there is no time to find them, unless a force depends on it.
        """
        ends = [0.0]
        try:
            self.follow([self.end], None, ends)
        except DoublesOnly:  # a singularity, whose time other engines know
            pass
        except OutOfTime:
            if self.scene.clock is not None:
                raise
            self.unseen, ends = True, [0.0]
        return sorted({*stops_between(ends), *self.sides})

    def check(self, times: Sequence[float], states: np.ndarray) -> None:
        """Raise `BadInput` unless states (k, d) at increasing times, the stops among them, lead to each other."""
        if self.scene.clock is not None:
            states = np.delete(states, self.scene.clock, axis=1)
        pairs = ((self.known[t], y) for t, y in zip(times, states, strict=True) if t in self.known)
        if self.unseen or all(self.agree(*pair) for pair in pairs):
            return
        self.follow(times, states, [0.0])  # piece by piece: the motion may be sensitive

    def agree(self, a: np.ndarray, b: np.ndarray) -> bool:
        return bool(np.all(np.abs(a - b) <= 10 * OFF * self.scale()))

    def follow(self, times: Sequence[float], states: np.ndarray | None, ends: list[float]) -> None:
        """Add to the ends of the pieces; raise `BadInput` where one of the states (k, d) does not lead to the next."""
        watch, y = Stopwatch(self.scene, self.end, self.deadline), self.start
        known = {} if states is None else dict(zip(times, states, strict=True))
        for bound in sorted({*times, *self.sides} - {0.0}):
            with np.errstate(all="ignore"):
                y = self.piece(ends, y, bound, watch)
            if bound in known:
                if not self.agree(y, known[bound]):
                    raise BadInput(
                        f"no reference for scene {self.scene.name!r}: two engines disagree before t = {bound:g}"
                    )
                y = known[bound]

    def scale(self) -> np.ndarray:
        return np.maximum(self.sizes, 1e-3 * self.sizes.max() or 1.0)

    def piece(self, ends: list[float], y: np.ndarray, bound: float, watch: Stopwatch) -> np.ndarray:
        """Follow the motion from the last of `ends` to a bound, adding to them; return the state there."""
        from scipy.integrate import DOP853

        due, shortest = [bound], SHORTEST * self.end
        while due:
            if any(time - m <= ends[-1] and due[-1] <= time + m for time, m in self.breaks):
                (y,) = across_breaks(lambda *_, **__: [], self.slope, y, [due[-1]], self.breaks, ends[-1])
                ends.append(due.pop())
                continue
            solver = DOP853(self.slope, ends[-1], y, due[-1], rtol=STEP, atol=STEP * self.scale().min())
            while solver.status == "running":
                watch.check(solver.t)
                if not math.isfinite(solver.h_abs) or solver.step() is not None:
                    raise DoublesOnly(f"no reference for scene {self.scene.name!r}: it cannot be followed")
                cuts, integral = self.cut(solver.t_old, solver.t, solver.dense_output(), shortest)
                off = np.abs(solver.y - y - integral)
                if len(cuts) > 1 and np.any(off > OFF * self.scale()):
                    due = sorted({*due, *cuts}, reverse=True)
                    break  # again, in pieces
                y = self.known[solver.t] = solver.y
                self.sizes = np.maximum(self.sizes, np.abs(y))
                ends += cuts
                if len(ends) > PIECES:
                    raise DoublesOnly(f"no reference for scene {self.scene.name!r}: it is too rough")
            else:
                due.pop()
        return y

    def cut(self, a: float, b: float, path: DenseOutput, shortest: float) -> tuple[list[float], np.ndarray]:
        """Return the ends of the pieces that a step is cut into, and the integral of the slopes over it."""
        ends, integral, left = list[float](), np.zeros_like(self.start), [(a, b)]
        while left:
            a, b = left.pop()
            nodes = a + (b - a) * NODES
            count = LEAST + int((b - a) * self.density)
            t = np.linspace(a, b, count)
            values = self.slopes(every := np.concatenate([nodes, t]), path(every))
            at_nodes, sampled = values[:, : len(NODES)], values[:, len(NODES) :]
            self.steepest = np.maximum(self.steepest, np.abs(np.nan_to_num(values)).max(axis=1))
            weights = BARYCENTRIC / (t[:, None] - nodes + 1e-300)
            fitted = at_nodes @ (weights / weights.sum(axis=1)[:, None]).T
            least = 1e-3 * self.steepest.max() or 1.0
            off = (np.abs(fitted - sampled) / np.maximum(self.steepest, least)[:, None]).max(axis=0)
            if (resolved := np.all(off <= RESOLVED)) or b - a <= shortest:
                if not resolved and self.scene.clock is not None:
                    raise BadInput(
                        f"no reference for scene {self.scene.name!r}: its force or damping jumps at t = {b:.6g} after "
                        "the start: name the time in breaks="
                    )
                ends.append(b)
                integral += (b - a) * (at_nodes @ FEJER)
                continue
            worst = t[int(np.argmax(off))]
            if not a + 0.1 * (b - a) < worst < b - 0.1 * (b - a):
                worst = (a + b) / 2
            left += [(worst, b), (a, worst)]
            if len(left) > PIECES:
                break
        return ends, integral


def stops_between(ends: list[float]) -> list[float]:
    """Return some of the ends of pieces, so that no distance is much longer than the shortest piece in it."""
    stops, shortest = [0.0], math.inf
    for before, end in itertools.pairwise(ends):
        shortest = min(shortest, end - before)
        if end - stops[-1] > LONGER * shortest and before > stops[-1]:
            stops.append(before)
            shortest = end - before
    return stops[1:]
