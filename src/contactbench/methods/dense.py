"""Dense output: a run takes its own steps, and states at saved times between them are interpolated.

Each component is a Hermite polynomial through its values, slopes and, where known, second derivatives at the nearest
ends of steps on one side of the breaks; the momentum follows from the position where it is its derivative.  Polynomials
through fewer nodes estimate the error.  Where it is too large, a step of a part of the length from the last end of a
step gives another node, or the saved state itself.  Such states are ends of steps, like all that are not interpolated.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from contactbench.methods.dates import dates
from contactbench.methods.hermite import NODES, Components, interpolate
from contactbench.methods.prepared import METHODS, NO_NUMBER, Outcome, Prepared, Request, stopwatch
from contactbench.methods.scaled import RunByTolerance
from contactbench.numbers.dual import Dual, slope
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import AnyState
from contactbench.scene.base import Numeric
from contactbench.solution import Counts, Status

#: rounds in which intervals are halved; after the last one every state that is not accurate has a step of its own
ROUNDS = 6
#: the error of interpolation that is allowed, over the error of a step
ALLOWED = 2.0
#: the largest relative error of interpolation that is allowed in any case
LARGEST = 1e-3
#: relative error of a state that is as good as exact
ROUND_OFF = 1e-13
#: saved times by which pilots are compared, and steps whose runs are kept
PILOTED, KEPT = 5, 8
#: calls by which two ways to the same states are compared
TRIALS = 5
#: a time counts as the end of a step if they differ by less than this part of the step plus so many units in the last
#: place
SAME, ULPS = 1e-13, 4


class Nodes(NamedTuple):
    """Ends of steps: times (n,), packed states (n, d), and the number of the piece between two breaks.

    A break is the end of one piece and the start of another.  slopes : those of the states, where a method knows them.
    """

    t: np.ndarray
    y: np.ndarray
    piece: np.ndarray
    slopes: np.ndarray | None = None


def on_grid(times: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Return the numbers of the times on an increasing grid that are ends of its steps, and −1 for the others."""
    near = np.clip(np.searchsorted(grid, times), 1, len(grid) - 1)
    width = grid[near] - grid[near - 1]
    near = near - (times - grid[near - 1] < width / 2)
    return np.where(np.abs(grid[near] - times) <= SAME * width + ULPS * np.spacing(times), near, -1)


class Source(ABC):
    """The steps of a method, for dense output: the run that saves at their ends, and what a part of a step costs."""

    run: Prepared
    #: the run that saves at ends of steps, by which laws of structure are judged; None where it is as cheap anew
    judged: Prepared | None = None
    #: evaluations of a `step`
    cost: int
    #: the kind of evaluations, as of `Counts`
    kind: str

    @abstractmethod
    def steps(self, y0: np.ndarray) -> tuple[Nodes, Counts] | None:
        """Return the ends of all steps and their cost; None where the run does not end well."""

    @abstractmethod
    def step(
        self, y0: np.ndarray, y: np.ndarray, begin: float, end: float, finer: bool = False
    ) -> tuple[np.ndarray, int]:
        """Return the state a part of a step after an end of a step, and the evaluations; finer : by half steps."""

    def allowed(self, scales: np.ndarray) -> np.ndarray | None:
        """Return the errors that states may have; None if the steps have to tell."""
        return None


class Polynomials:
    """Data at nodes, and the polynomials through them; every node has its data computed once."""

    def __init__(self, request: Request, nodes: Nodes, y0: np.ndarray) -> None:
        self.scene, self.carry, self.y0 = request.scene, request.carry, y0
        self.t, self.piece, self.bounds = nodes.t, nodes.piece, None
        if self.scene.clock is not None:  # a node at a break has the force of its side
            ends = np.append(np.flatnonzero(np.diff(nodes.piece)), len(nodes.t) - 1)
            begins = np.append(0, ends[:-1] + 1)
            self.bounds = dates(self.scene, nodes.t[begins], nodes.t[ends])[:, 1:]
        #: whether the momentum follows from the position; right-hand sides computed at nodes
        self.follows, self.made = False, 0
        self.data = self.data_at(nodes)

    def data_at(self, nodes: Nodes) -> np.ndarray:
        """Return value, slope and second derivative of each component, nan where it is not known, (n, 3, d)."""
        scene, y = self.scene, nodes.y
        if self.bounds is not None:
            y = y.copy()
            low, high = self.bounds[nodes.piece].T
            y[:, scene.clock] = self.y0[scene.clock] + np.clip(nodes.t, low, high)
        data = np.full((len(y), 3, y.shape[1]), math.nan)
        data[:, 0] = nodes.y
        x = scene.unpack(list(y.T), self.carry)
        f = scene.rhs(x) if nodes.slopes is None else scene.unpack(list(nodes.slopes.T), self.carry)
        fill(data[:, 1], scene.pack(f))
        known = scene.bend(x, f)
        self.follows = known is not None
        self.made += len(y) * (nodes.slopes is None)
        with suppress(CannotRecord, TypeError, *NO_NUMBER):
            if known is None:
                along = scene.unpack(list(map(Dual, y.T, data[:, 1].T)), self.carry)
                known = list(map(slope, scene.pack(scene.rhs(along))))
                self.made += len(y)
            fill(data[:, 2], known)
        return data

    def add(self, nodes: Nodes) -> None:
        t, piece = np.append(self.t, nodes.t), np.append(self.piece, nodes.piece)
        order = np.lexsort((t, piece))
        data = np.concatenate([self.data, self.data_at(nodes)])[order]
        self.t, self.piece, self.data = t[order], piece[order], data

    @property
    def nodes(self) -> Nodes:
        return Nodes(self.t, self.data[:, 0], self.piece)

    @cached_property
    def components(self) -> Components:
        d = self.data.shape[2]
        data, leaders, rates = np.where(np.isnan(self.data[:, 2]).all(axis=0), 2.0, 3.0), *np.zeros((2, d))
        if self.follows:
            n = len(self.scene.q)  # type: ignore[attr-defined]
            data[n : 2 * n], leaders[n : 2 * n] = 0, np.arange(n)
            rates[n : 2 * n] = 1 / np.array(self.scene.velocity((1.0,) * n))  # type: ignore[attr-defined]
        return Components(data, leaders, rates)

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the interval, the state and estimates of its errors at each of increasing times."""
        where, y, error = interpolate(self.t, self.piece, self.data, self.components, times)
        return where, self.scene.settled(y, self.carry), error


@dataclass
class Interpolated(RunByTolerance):
    """Save states between steps, by tolerance or not.

    plain : the run whose steps end at the saved times, for structure and for what does not end well.
    """

    plain: Prepared

    def remade(self, request: Request) -> Prepared:
        return densely(self.method_, request, self.method_.prepare(request))

    def __reduce__(self) -> tuple[object, ...]:
        return dense_again, (self.method, self.request)

    @property
    def judged(self) -> Prepared:
        """Return the run that is judged for structure: all of its saved states are ends of steps."""
        return self.plain

    def bare_call(self) -> Callable[[], np.ndarray]:
        """Return the faster way to the saved states: between steps, or by steps that end at them."""
        return min(super().bare_call(), self.plain.bare_call(), key=seconds)

    @property
    def composed(self) -> bool:
        return self.judged.composed

    def modified_hamiltonian(self, x: AnyState) -> Numeric:
        return self.judged.modified_hamiltonian(x)


@dataclass
class Dense(Interpolated):
    """Save states between the steps of a method."""

    source: Source

    def __post_init__(self) -> None:
        super().__post_init__()
        self.compile_s, self.steps_taken = self.source.run.compile_s, self.source.run.steps_taken
        self.moving = np.delete(np.arange(len(self.start)), [] if self._clock is None else self._clock)

    @property
    def judged(self) -> Prepared:
        return self.source.judged or self.plain

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return np.asarray(self._dated(y0, self.integrate(y0).y)[-1])

    def scales(self, y0: np.ndarray) -> np.ndarray:
        compiled = self.scaled if self.request.engine == "llvm" else None
        return super().scales(y0) if compiled is None else compiled(y0)

    def integrate(self, y0: np.ndarray) -> Outcome:
        self.require_size(y0)
        with np.errstate(all="ignore"):
            made = self.source.steps(y0)
        if made is None:
            return self.plain.integrate(y0)
        nodes, counts = made
        with np.errstate(all="ignore"):
            y, between, evaluations = self.states(y0, nodes)
        counts = counts._replace(evaluations=(counts.evaluations or 0) + evaluations)
        out = self.finish(y0, self.from_start(y0, y), counts)
        if out.status is not Status.ok:
            return self.plain.integrate(y0)
        out.interpolated = np.append(False, between) if self.saves_start else between
        return out

    def states(self, y0: np.ndarray, nodes: Nodes) -> tuple[np.ndarray, np.ndarray, int]:
        """Return the states at the saved times > 0, whether they are interpolated, and the evaluations."""
        t, source, spent = self.later, self.source, 0
        y, between = np.empty((len(t), len(y0))), np.ones(len(t), dtype=bool)
        left = self.known(nodes, np.arange(len(t)), y, between)
        if len(left) * source.cost <= len(nodes.t) * (nodes.slopes is None):  # too few to interpolate
            return y, between, self.single(y0, nodes, left, y, between)
        scales = self.scales(y0)
        rounding = ROUND_OFF * scales
        found, allowed = Polynomials(self.request, nodes, y0), source.allowed(scales)
        for last in [*[False] * ROUNDS, True]:
            inside, states, error = found.at(t[left])
            first = np.flatnonzero(np.append(True, inside[1:] > inside[:-1]))
            intervals, number = inside[first], np.append(first[1:], len(inside)) - first
            each = np.repeat(np.arange(len(first)), number)
            worst = np.maximum.reduceat(error[:, self.moving], first)
            worst[np.isnan(worst)] = math.inf
            middle, better = None, False
            if allowed is None and (worst > rounding).any():
                k = intervals[np.argmax((worst / scales).max(axis=1))]
                middle, part, more = self.measured(y0, found, k, scales)
                allowed, spent = np.maximum(part * scales, rounding), spent + more
                better = np.abs(intervals - k) < NODES  # polynomials that the middle belongs to
            good = (worst <= (rounding if allowed is None else allowed)).all(axis=1)
            y[left[good[each]]] = states[good[each]]
            alone = ~(good | better) & ((number == 1) | last)
            spent += self.single(y0, found.nodes, left[alone[each]], y, between)
            halved = ~(good | better | alone)
            left = left[~(good | alone)[each]]
            if not left.size:
                break
            spent += self.halve(y0, found, intervals[halved])
            if middle is not None:
                found.add(middle)
            left = self.known(found.nodes, left, y, between)
            if not left.size:
                break
        return y, between, spent + found.made * (2 if source.kind == "rotation" else 1)

    def known(self, nodes: Nodes, rows: np.ndarray, y: np.ndarray, between: np.ndarray) -> np.ndarray:
        """Save the states that are nodes; return the numbers of the others."""
        begins = np.append(True, nodes.t[1:] > nodes.t[:-1])  # of two nodes at a break the first
        near = on_grid(self.later[rows], nodes.t[begins])
        same = near >= 0
        if same.any():
            y[rows[same]], between[rows[same]] = nodes.y[begins][near[same]], False
        return rows[~same]

    def single(
        self, y0: np.ndarray, nodes: Nodes, rows: np.ndarray, y: np.ndarray, between: np.ndarray
    ) -> int:
        """Save states by a step of their own, and return the evaluations."""
        spent = 0
        for row, k in zip(rows, place(nodes.t, self.later[rows]), strict=True):
            y[row], more = self.source.step(y0, nodes.y[k], nodes.t[k], self.later[row])
            spent += more
        between[rows] = False
        return spent

    def halve(self, y0: np.ndarray, found: Polynomials, intervals: np.ndarray) -> int:
        """Add nodes in the middle of some intervals, and return the evaluations."""
        nodes, made, spent = found.nodes, [], 0
        middle = (nodes.t[intervals] + nodes.t[intervals + 1]) / 2
        for k, time in zip(intervals, middle, strict=True):
            y, more = self.source.step(y0, nodes.y[k], nodes.t[k], time)
            made.append(y)
            spent += more
        if made:
            found.add(Nodes(middle, np.array(made), nodes.piece[intervals]))
        return spent

    def measured(
        self, y0: np.ndarray, found: Polynomials, k: int, scales: np.ndarray
    ) -> tuple[Nodes, float, int]:
        """Return the middle of an interval, the error that its step allows, in parts of the scales, and evaluations.

        Ends of equal steps lie on a smooth path, which the error of a step bends away from the motion: in the middle
        by half of it.
        """
        nodes = found.nodes
        (begin, end), (before, after) = nodes.t[k : k + 2], nodes.y[k : k + 2]
        time = (begin + end) / 2
        middle, spent = self.source.step(y0, before, begin, time, finer=True)
        y, more = self.source.step(y0, middle, time, end, finer=True)
        off = (after - y)[self.moving]
        middle[self.moving] += off / 2
        part = float(np.abs(off / scales).max())
        own = Nodes(np.array([time]), middle[None], nodes.piece[k : k + 1])
        return own, min(ALLOWED * part, LARGEST), spent + more


def place(nodes: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return the numbers of the last nodes before times that are no nodes."""
    return np.searchsorted(nodes, t, side="right") - 1


def fill(rows: np.ndarray, numbers: Any) -> None:
    for c, column in enumerate(numbers):
        rows[:, c] = column


def seconds(call: Callable[[], object]) -> float:
    """Return how long a call takes, the least of a few."""
    taken = []
    for _ in range(TRIALS):
        elapsed = stopwatch()
        call()
        taken.append(elapsed())
    return min(taken)


def dense_again(method: str, request: Request) -> Prepared:
    return densely(METHODS[method], request, METHODS[method].prepare(request))


@dataclass
class Piloted(Interpolated):
    """Choose a step by pilots that save few of the states, and take it with dense output."""

    pilots: Prepared

    def __post_init__(self) -> None:
        super().__post_init__()
        self.compile_s, self.run_of = self.pilots.compile_s, lru_cache(KEPT)(self.run_with)

    def run_with(self, step: float) -> Prepared:
        return self.remade(replace(self.request, step=step, rtol=None, atol=None))

    def integrate(self, y0: np.ndarray) -> Outcome:
        self.require_size(y0)
        found = self.pilots.integrate(y0)
        if found.status is not Status.ok or found.steps is None:
            return self.plain.integrate(y0)
        run = self.run_of(found.steps[1])
        out = run.integrate(y0)
        if out.status is not Status.ok:
            return self.plain.integrate(y0)
        spent = (found.counts.evaluations or 0) + (out.counts.evaluations or 0)
        return replace(out, counts=out.counts._replace(evaluations=spent), steps=run.steps_taken)


def densely(method: Any, request: Request, run: Prepared) -> Prepared:
    """Return the run, with dense output where the method has it and saved times would shorten its steps."""
    saved = request.save_at
    if method.control == "step" and request.rtol is not None and not method.follows:
        if len(saved) <= PILOTED:
            return run
        few = saved[(np.arange(1, PILOTED + 1) / PILOTED * (len(saved) - 1)).round().astype(int)]
        return Piloted(method.name, request, method, run, method.prepare(replace(request, save_at=few)))
    source = method.source(request) if len(saved) > 1 else None
    return run if source is None else Dense(method.name, request, method, run, source)
