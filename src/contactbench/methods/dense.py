"""Dense output: a run takes its own steps, and states at saved times between them are interpolated.

Each component is a Hermite polynomial through its values, slopes and, where known, second derivatives at the nearest
ends of steps on one side of the breaks; the momentum follows from the position where it is its derivative.  Polynomials
through fewer nodes estimate the error.  Where it is too large, a step of a part of the length from the last end of a
step gives another node, or the saved state itself.  Such states are ends of steps, like all that are not interpolated.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from contactbench.methods.dates import dates
from contactbench.methods.hermite import weights
from contactbench.methods.prepared import METHODS, NO_NUMBER, Outcome, Prepared, Request
from contactbench.numbers.dual import Dual, slope
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import Scene
from contactbench.solution import Counts, Status

#: most nodes of a polynomial; those of the polynomials that estimate its error are fewer by FEWER and twice FEWER
NODES, FEWER = 8, 2
#: rounds in which intervals are halved; after the last one every state that is not accurate has a step of its own
ROUNDS = 5
DEBUG = False
#: the error of interpolation that is allowed, over the error of a step
ALLOW = 2.0
#: relative error of a state that is as good as exact
ROUND_OFF = 1e-13
#: a time within this part of a step from its end is that end
SAME = 1e-9


class Nodes(NamedTuple):
    """Ends of steps: times (n,), packed states (n, d), and the number of the piece between two breaks.

    A break is the end of one piece and the start of another.
    """

    t: np.ndarray
    y: np.ndarray
    piece: np.ndarray

    def merged(self, *more: Any) -> Nodes:
        order = np.lexsort((np.append(self.t, more[0]), piece := np.append(self.piece, more[2])))
        return Nodes(np.append(self.t, more[0])[order], np.vstack([self.y, more[1]])[order], piece[order])


def on_grid(times: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Return the numbers of the times on an increasing grid that are ends of its steps, and −1 for the others."""
    near = np.clip(np.searchsorted(grid, times), 1, len(grid) - 1)
    width = grid[near] - grid[near - 1]
    near = near - (times - grid[near - 1] < width / 2)
    return np.where(np.abs(grid[near] - times) <= SAME * width, near, -1)


class Source(ABC):
    """The steps of a method, for dense output: the run that saves at their ends, and what a part of a step costs."""

    run: Prepared
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
    """Data at nodes, and the polynomials through them."""

    def __init__(self, request: Request, nodes: Nodes, y0: np.ndarray) -> None:
        scene, carry = request.scene, request.carry
        self.scene, self.nodes, y = scene, nodes, nodes.y.copy()
        if scene.clock is not None:  # a node at a break has the force of its side
            ends = np.append(np.flatnonzero(np.diff(nodes.piece)), len(nodes.t) - 1)
            begins = np.append(0, ends[:-1] + 1)
            low, high = dates(scene, nodes.t[begins], nodes.t[ends])[nodes.piece, 1:].T
            y[:, scene.clock] = y0[scene.clock] + np.clip(nodes.t, low, high)
        x = scene.unpack(list(y.T), carry)
        f = scene.rhs(x)
        known = scene.bend(x, f)
        data = [nodes.y, self.columns(scene.pack(f))]
        self.follows = known is not None  # the momentum follows from the position
        with suppress(CannotRecord, TypeError, *NO_NUMBER):
            if known is None:
                along = scene.unpack(list(map(Dual, y.T, data[1].T)), carry)
                known = list(map(slope, scene.pack(scene.rhs(along))))
            data.append(self.columns(known))
        self.data = np.stack(data, axis=1)
        #: evaluations at a node
        self.each = len(data) - 1 if not self.follows else 1
        #: components whose second derivative is not known
        self.short = np.isnan(data[-1]).all(axis=0)

    def columns(self, numbers: Any) -> np.ndarray:
        n = len(self.nodes.t)
        return np.stack([np.broadcast_to(np.asarray(c, dtype=float), n) for c in numbers], axis=1)

    def at(self, t: np.ndarray, inside: np.ndarray, count: int) -> np.ndarray:
        """Return the states at times in the intervals after some nodes, by `count` nodes."""
        piece = self.nodes.piece
        first, end = (np.searchsorted(piece, piece[inside], side) for side in ("left", "right"))
        which = np.clip(inside - count // 2 + 1, first, end - count)[:, None] + np.arange(count)
        data = self.data
        by_all = weights(t, self.nodes.t, which, data.shape[1])
        found = by_all.value(np.where(self.short, 0.0, data))
        if self.follows:
            n = len(self.scene.q)  # type: ignore[attr-defined]
            unit = np.array(self.scene.velocity((1.0,) * n))  # type: ignore[attr-defined]
            found[:, n : 2 * n] = by_all.slope(data[:, :, :n]) / unit
            rest = np.flatnonzero(self.short)
            if (rest := rest[rest >= 2 * n]).size:
                found[:, rest] = weights(t, self.nodes.t, which, 2).value(data[:, :2, rest])
        return found


@dataclass
class Dense(Prepared):
    """Save states between the steps of a method."""

    method_: Any
    source: Source

    def __post_init__(self) -> None:
        super().__post_init__()
        self.compile_s, self.steps_taken = self.source.run.compile_s, self.source.run.steps_taken
        self.moving = np.delete(np.arange(len(self.start)), [] if self._clock is None else self._clock)

    def __reduce__(self) -> tuple[object, ...]:
        return dense_again, (self.method, self.request)

    @cached_property
    def plain(self) -> Prepared:
        """The run whose steps end at the saved times, for what does not end well."""
        run: Prepared = self.method_.prepare(replace(self.request, dense=False))
        return run

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
        left = self.known(nodes, y, between)
        scales = self.scales(y0)
        allowed = source.allowed(scales)
        rounding = ROUND_OFF * scales
        found, round_ = None, 0
        while len(left):
            inside = self.place(nodes, t[left])
            intervals, each = np.unique(inside, return_inverse=True)
            number = np.bincount(each)
            if found is None and len(left) * source.cost <= len(nodes.t):  # too few to interpolate
                single = np.ones(len(intervals), dtype=bool)
            else:
                found = Polynomials(self.request, nodes, y0)
                states, error = self.interpolated(found, t[left], inside)
                worst = np.zeros((len(intervals), error.shape[1]))
                np.fmax.at(worst, each, np.nan_to_num(error, nan=math.inf))
                if allowed is None and (worst > rounding).any():
                    nodes, allowed, more = self.measured(y0, nodes, intervals, worst / scales)
                    spent += more
                    continue
                bad = (worst > (rounding if allowed is None else np.maximum(allowed, rounding))).any(axis=1)
                good = ~bad[each]
                y[left[good]] = states[good]
                single = bad & ((number == 1) | (round_ == ROUNDS))
                halved = intervals[bad & ~single]
                round_ += 1
            for k in left[single[each]]:
                place = self.place(nodes, t[k : k + 1])[0]
                y[k], more = source.step(y0, nodes.y[place], nodes.t[place], t[k])
                between[k], spent = False, spent + more
            if found is None or not len(halved):
                break
            left = left[np.isin(inside, halved)]
            nodes, more = self.halved(y0, nodes, halved)
            spent += more
            left = self.known(nodes, y, between, left)
        if found is not None:
            unit = 2 if source.kind == "rotation" else 1
            spent += len(nodes.t) * found.each * unit
        return y, between, spent

    def known(self, nodes: Nodes, y: np.ndarray, between: np.ndarray, left: Any = None) -> np.ndarray:
        """Save the states that are nodes; return the numbers of the others (of those left)."""
        rows = np.arange(len(self.later)) if left is None else left
        times, first = np.unique(nodes.t, return_index=True)
        near = on_grid(self.later[rows], times)
        same = near >= 0
        y[rows[same]], between[rows[same]] = nodes.y[first[near[same]]], False
        return rows[~same]

    def place(self, nodes: Nodes, t: np.ndarray) -> np.ndarray:
        """Return the numbers of the last nodes before times that are no nodes."""
        return np.searchsorted(nodes.t, t, side="right") - 1

    def interpolated(self, found: Polynomials, t: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return states at times and estimates of their errors, for the components but the time."""
        piece = found.nodes.piece
        y, error = np.empty((len(t), found.data.shape[2])), np.full((len(t), len(self.moving)), math.inf)
        size = np.bincount(piece)[piece[inside]]
        for most in np.unique(np.minimum(size, NODES)):
            rows = np.flatnonzero(np.minimum(size, NODES) == most)
            if most < 2 * FEWER + 2:
                y[rows] = found.at(t[rows], inside[rows], most)
                continue
            best, fewer, least = (
                found.at(t[rows], inside[rows], most - k * FEWER) for k in range(3)
            )
            y[rows] = best
            gap, before = (np.abs(a - b)[:, self.moving] for a, b in ((best, fewer), (fewer, least)))
            error[rows] = gap * np.minimum(1.0, gap / np.maximum(before, 1e-300))
        return self.request.scene.settled(y, self.request.carry), error

    def halved(
        self, y0: np.ndarray, nodes: Nodes, intervals: np.ndarray, finer: bool = False
    ) -> tuple[Nodes, int]:
        """Return the nodes with others in the middle of some intervals, and the evaluations."""
        made, spent = [], 0
        middle = (nodes.t[intervals] + nodes.t[intervals + 1]) / 2
        for k, time in zip(intervals, middle, strict=True):
            y, more = self.source.step(y0, nodes.y[k], nodes.t[k], time, finer)
            made.append(y)
            spent += more
        return nodes.merged(middle, np.array(made), nodes.piece[intervals]), spent

    def measured(self, y0: np.ndarray, nodes: Nodes, intervals: np.ndarray, worst: np.ndarray) -> Any:
        """Halve the interval where interpolation is worst; return the nodes, the error of its step, and the evaluations.
        """
        k = intervals[np.argmax(worst.max(axis=1))]
        after = nodes.y[k + 1]
        nodes, spent = self.halved(y0, nodes, np.array([k]), finer=True)
        y, more = self.source.step(y0, nodes.y[k + 1], nodes.t[k + 1], nodes.t[k + 2], finer=True)
        off = np.abs(y - after)[self.moving] / self.scales(y0)
        if DEBUG: print('   delta',off.max(),'worst',np.sort(worst.max(axis=1))[::-1][:6],len(worst))
        return nodes, ALLOW * np.full(len(off), off.max()) * self.scales(y0), spent + more


def dense_again(method: str, request: Request) -> Prepared:
    return densely(METHODS[method], request, METHODS[method].prepare(request))


def densely(method: Any, request: Request, run: Prepared) -> Prepared:
    """Return the run, with dense output where the method has it and saved times would shorten its steps."""
    source = method.source(request) if request.dense and len(request.save_at) > 1 else None
    return run if source is None else Dense(method.name, request, method, source)
