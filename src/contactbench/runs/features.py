"""Estimate features of a problem, such as frequency and damping, by a short pilot run in Python without compilation."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np

from contactbench.blame import their_code
from contactbench.methods.prepared import NO_NUMBER, furthest
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import Scene
from contactbench.trace.form import FUNCTIONS
from contactbench.trace.formula import Formula, formula

#: cost of a division, an elementary function and a function that cannot be recorded, in additions
DIVISION, FUNCTION, UNKNOWN = 4.0, 12.0, 1000.0
COSTS = dict.fromkeys(("div", "sqrt"), DIVISION) | dict.fromkeys(
    (*FUNCTIONS, "pow", "atan2", "hypot"), FUNCTION
)
#: most steps and seconds of a pilot, its tolerance, and the step of differences
STEPS, SECONDS, RTOL, STEP = 100, 1.2, 1e-5, 1e-6
#: most components whose part of the divergence is computed
SAMPLE = 64
#: steps shorter than this part of the longest are ignored: the change of the force is rounding
SHORT = 1e-3
#: least angle of a motion; motions that do not oscillate use the time span
SLOWEST = 0.1


@dataclass(frozen=True)
class Features:
    """Hold features of a problem.  omega : rate at which the force changes along the motion, as an angular frequency.

    damping : over omega.  span : in periods 2π/omega.  spread : largest of these rates over their mean.  cost : of a
    right-hand side, in additions.  size : components.  kind : of the scene.
    """

    omega: float
    damping: float
    span: float
    spread: float
    cost: float
    size: int
    kind: str


def recorded_slopes(scene: Scene) -> Formula | None:
    """Return the right-hand side at (t, y) as a formula, None where it cannot be recorded."""
    scene, carry = scene.recorded(), scene.carry(())
    size = len(scene.without_clock(scene.labels(carry)))
    try:
        return formula(lambda t, y: tuple(scene.slopes(t, y, carry)), (0, size), ())
    except CannotRecord:
        return None


def force_cost(scene: Scene, slopes: Formula | None = None) -> float:
    """Return the cost of a right-hand side in additions, counted in its recorded form."""
    slopes = slopes or recorded_slopes(scene)
    if slopes is None:
        return UNKNOWN
    return sum(COSTS.get(getattr(step.value, "function", ""), 1.0) for step in slopes.body)


def features(scene: Scene) -> Features:
    """Return the features found by a pilot run; raise `BadInput` if a function fails."""
    from scipy.integrate import DOP853  # takes long to load

    scene, carry = scene.recorded(), scene.carry(())
    recorded = recorded_slopes(scene)
    begin = scene.initial(carry)
    packed = np.array(scene.pack(begin), dtype=float)
    start, y0 = scene.split_clock(packed)

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        given = y.tolist()
        found = recorded(start + t, given) if recorded else scene.slopes(start + t, given, carry)
        return np.array(found, dtype=float)

    def attempt(t: float, y: np.ndarray) -> np.ndarray:
        with suppress(*(NO_NUMBER if t > 0 else ())):  # where a step leaves all numbers a shorter one follows
            return slope(t, y)
        return np.full(len(y), math.nan)

    def pull(t: float, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return position and acceleration without friction; for systems without coordinates state and slope."""
        if not scene.separable:
            return y / units, slope(t, y) / units
        x: Any = scene.unpack(scene.with_clock(y.tolist(), start + t), carry)
        own: Any = scene
        acceleration = np.array(own.velocity(own.gradient_at(x)), dtype=float)
        return np.array(x.q, dtype=float) / units[: len(x.q)], acceleration / units[: len(x.q)]

    passed, until = list[tuple[float, float, float]](), process_time() + SECONDS
    with np.errstate(all="ignore"), their_code(f"scene {scene.name!r}"):
        most, units = furthest(scene, carry, packed, scene.t_end), np.ones(len(y0))
        scale = max(1e-30, np.abs(y0).max() or scene.scales(begin, scene.t_end).max())
        if scene.mixed:
            scale = units = scene.scales(begin, scene.t_end)
        solver = DOP853(attempt, 0.0, y0, scene.t_end, rtol=RTOL, atol=RTOL * scale)
        q, force = pull(0.0, y0)
        while len(passed) < STEPS and solver.status == "running" and process_time() < until:
            if not (math.isfinite(solver.h_abs) and np.all(np.abs(solver.y[: len(most)]) <= most)):
                break
            before = solver.t
            solver.step()
            old_q, old, (q, force) = q, force, pull(solver.t, solver.y)
            way, change = float(np.linalg.norm(q - old_q)), float(np.linalg.norm(force - old))
            passed.append((way, change, solver.t - before))
        damping = loss(slope, solver.t, solver.y, units, len(y0) // 2 if scene.canonical else len(y0))
    ways, changes, lengths = np.array(passed or [(0.0, 0.0, 0.0)]).T
    seen = (ways > SHORT * ways.max()) & np.isfinite(changes)
    rates = (changes[seen] / ways[seen]) ** (0.5 if scene.separable else 1.0)
    omega = float(np.average(rates, weights=lengths[seen])) if seen.any() else 0.0
    omega = max(omega, SLOWEST / scene.t_end)
    size = len(y0) // 2 if scene.canonical else len(y0)
    spread = float(max([omega, *rates])) / omega
    span = scene.t_end * omega / (2 * math.pi)
    cost = force_cost(scene, recorded)
    return Features(omega, max(damping, 0.0) / omega, span, spread, cost, size, scene.kind)


def loss(slope: Any, t: float, y: np.ndarray, units: np.ndarray, momenta: int) -> float:
    """Return the mean decay rate of the momenta from the divergence of the field, sampled if there are many."""
    there, total = slope(t, y), 0.0
    some = np.unique(np.linspace(0, len(y) - 1, min(len(y), SAMPLE)).round().astype(int))
    for i in some:
        shifted = y.copy()
        shifted[i] += STEP * max(units[i], abs(y[i]))
        total += (slope(t, shifted)[i] - there[i]) / (shifted[i] - y[i])
    return -total / momenta * len(y) / len(some)
