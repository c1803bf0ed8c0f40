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
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from contactbench.methods.dates import dates
from contactbench.methods.hermite import newton
from contactbench.methods.prepared import METHODS, NO_NUMBER, Outcome, Prepared, Request
from contactbench.methods.scaled import RunByTolerance
from contactbench.numbers.dual import Dual, slope
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import AnyState
from contactbench.scene.base import Numeric
from contactbench.solution import Counts, Status

#: most nodes of a polynomial; the one that estimates its error has FEWER nodes less
NODES, FEWER = 8, 2
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
#: a time within this part of a step from its end is that end
SAME = 1e-9


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
    return np.where(np.abs(grid[near] - times) <= SAME * width, near, -1)


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
        #: components whose second derivative is not known
        self.short = np.isnan(self.data[:, -1]).all(axis=0)

    def data_at(self, nodes: Nodes) -> np.ndarray:
        """Return value, slope and, where it can be computed, second derivative of each component, (n, r, d)."""
        scene, y = self.scene, nodes.y.copy()
        if self.bounds is not None:
            low, high = self.bounds[nodes.piece].T
            y[:, scene.clock] = self.y0[scene.clock] + np.clip(nodes.t, low, high)
        x = scene.unpack(list(y.T), self.carry)
        f = scene.rhs(x) if nodes.slopes is None else scene.unpack(list(nodes.slopes.T), self.carry)
        known = scene.bend(x, f)
        data = [nodes.y, columns(scene.pack(f), len(y))]
        self.follows = known is not None
        with suppress(CannotRecord, TypeError, *NO_NUMBER):
            if known is None:
                along = scene.unpack(list(map(Dual, y.T, data[1].T)), self.carry)
                known = list(map(slope, scene.pack(scene.rhs(along))))
            data.append(columns(known, len(y)))
        self.made += len(y) * ((nodes.slopes is None) + (len(data) == 3 and not self.follows))
        return np.stack(data, axis=1)

    def add(self, nodes: Nodes) -> None:
        t, piece = np.append(self.t, nodes.t), np.append(self.piece, nodes.piece)
        order = np.lexsort((t, piece))
        data = np.concatenate([self.data, self.data_at(nodes)])[order]
        self.t, self.piece, self.data = t[order], piece[order], data

    @property
    def nodes(self) -> Nodes:
        return Nodes(self.t, self.data[:, 0], self.piece)

    def at(self, t: np.ndarray, each: np.ndarray, intervals: np.ndarray, most: int) -> list[np.ndarray]:
        """Return the states at times by polynomials through ever more nodes, at most `most`.

        intervals : the nodes that begin them, in one piece with as many nodes at least.  each : that of every time.
        """
        first, end = (np.searchsorted(self.piece, self.piece[intervals], side) for side in ("left", "right"))
        which = np.clip(intervals - most // 2 + 1, first, end - most)[:, None] + np.arange(most)
        order = np.argsort(np.abs(which - intervals[:, None] - 0.5), axis=1, kind="stable")
        which, r = np.take_along_axis(which, order, axis=1), self.data.shape[1]
        counts = [most - FEWER, most] if most > FEWER + 1 else [most]
        # times since the begin of each interval have all their digits
        begins, nodes, data = self.t[intervals], self.t[which], self.data[which]
        t, nodes = t - begins[each], nodes - begins[:, None]
        made = newton(nodes, np.where(self.short, 0.0, data)).at(t, each, [r * count for count in counts])
        found, n = [], len(getattr(self.scene, "q", ()))
        for value, rising in made:
            if self.follows:
                value[:, n : 2 * n] = rising[:, :n] / np.array(self.scene.velocity((1.0,) * n))  # type: ignore[attr-defined]
            found.append(value)
        if self.follows and (rest := np.flatnonzero(self.short[2 * n :]) + 2 * n).size:
            less = newton(nodes, data[:, :, :2, rest]).at(t, each, [2 * count for count in counts])
            for value, (own, _) in zip(found, less, strict=True):
                value[:, rest] = own
        return found


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
            inside = place(found.t, t[left])
            intervals, first, each, number = np.unique(inside, True, True, True)
            states, error = self.interpolated(found, t[left], each, intervals)
            worst = np.maximum.reduceat(error, first)
            if allowed is None and (worst > rounding).any():
                k = np.argmax((worst / scales).max(axis=1))
                middle, part, more = self.measured(y0, found, intervals[k], scales)
                allowed, spent = np.maximum(part * scales, rounding), spent + more
                if (worst[k] > allowed).any():
                    found.add(middle)
                    left = self.known(found.nodes, left, y, between)
                    continue
            good = (worst <= (rounding if allowed is None else allowed)).all(axis=1)
            y[left[good[each]]] = states[good[each]]
            alone = ~good & ((number == 1) | last)
            spent += self.single(y0, found.nodes, left[alone[each]], y, between)
            halved = ~(good | alone)
            if not halved.any():
                break
            spent += self.halve(y0, found, intervals[halved])
            left = self.known(found.nodes, left[halved[each]], y, between)
        return y, between, spent + found.made * (2 if source.kind == "rotation" else 1)

    def known(self, nodes: Nodes, rows: np.ndarray, y: np.ndarray, between: np.ndarray) -> np.ndarray:
        """Save the states that are nodes; return the numbers of the others."""
        times, first = np.unique(nodes.t, return_index=True)
        near = on_grid(self.later[rows], times)
        same = near >= 0
        y[rows[same]], between[rows[same]] = nodes.y[first[near[same]]], False
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

    def interpolated(
        self, found: Polynomials, t: np.ndarray, each: np.ndarray, intervals: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return states at times in some intervals and estimates of their errors, for the components but the time."""
        y, error = np.empty((len(t), found.data.shape[2])), np.full((len(t), len(self.moving)), math.inf)
        size = np.minimum(np.bincount(found.piece)[found.piece[intervals]], NODES)
        for most in np.unique(size[each]).tolist():
            own, rows = np.flatnonzero(size == most), np.flatnonzero(size[each] == most)
            *fewer, y[rows] = found.at(t[rows], np.searchsorted(own, each[rows]), intervals[own], most)
            if fewer:
                error[rows] = np.abs(y[rows] - fewer[0])[:, self.moving]
        return self.request.scene.settled(y, self.request.carry), np.nan_to_num(error, nan=math.inf)

    def halve(self, y0: np.ndarray, found: Polynomials, intervals: np.ndarray) -> int:
        """Add nodes in the middle of some intervals, and return the evaluations."""
        nodes, made, spent = found.nodes, [], 0
        middle = (nodes.t[intervals] + nodes.t[intervals + 1]) / 2
        for k, time in zip(intervals, middle, strict=True):
            y, more = self.source.step(y0, nodes.y[k], nodes.t[k], time)
            made.append(y)
            spent += more
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


def columns(numbers: Any, n: int) -> np.ndarray:
    return np.stack([np.broadcast_to(np.asarray(c, dtype=float), n) for c in numbers], axis=1)


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
