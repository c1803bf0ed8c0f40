"""Measure borders of linear stability, errors under strong damping, and numerical damping rates.

A cell is a method, or a method and a rate.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

import contactbench as cb
from contactbench.measure import stability as linear
from contactbench.methods.base import CALLBACKS, PACKAGES, Method
from contactbench.methods.fixed_step import FixedStep
from contactbench.runs.experiment import Cell, Profile, Recorded, Row, experiment
from contactbench.runs.search import right_hand_sides, step_at, tolerance_at
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.solution import EXACT, Solution, keywords
from contactbench.tables.declared import LIMITS

# -- linear stability ------------------------------------------------------------------------------
#: dampings in units of the frequency: of the borders, and of the errors under strong damping
GAMMAS, STRONG = (0.0, 0.1, 0.3, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0), (0.1, 1.0, 10.0, 50.0)
#: γh over the evaluations of a step
PER_EVALUATION = np.geomspace(1e-3, 30.0, 30)


def fixed_step_cells(profile: Profile) -> list[Cell]:
    """Return the methods with a step map; in the smoke profile the first one and the processed ones."""
    first, *others = linear.fixed_step_methods()
    return [(m.name,) for m in (first, *others) if not profile.brief or m is first or linear.is_processed(m)]


@experiment(fixed_step_cells)
def borders(cell: Cell, profile: Profile) -> Recorded:
    method = cb.METHODS[cell[0]]
    each = method.per_step(linear.oscillator(0.0))
    own: Row = {"scene": "oscillator", "method": method.name, "status": "ok", "evaluations": each}
    for gamma in GAMMAS:
        yield from ((LIMITS, own | {"gamma": gamma} | row) for row in stable_steps(method, gamma))
    for gamma in STRONG:
        for damping in PER_EVALUATION:
            error = linear.propagation_error(method, gamma, damping / gamma * each)
            row = {"question": "strong", "gamma": gamma, "setting": damping, "error": error}
            yield LIMITS, own | row


def stable_steps(method: FixedStep, gamma: float) -> Iterator[Row]:
    """Yield the border of stability of a method; for a processed one a second row if every step is saved."""
    theory = linear.THEORY.get(method.name)
    kinds = {"stability": linear.kernel(method)}
    if linear.is_processed(method):
        kinds["stability saved"] = method
    for question, own in kinds.items():
        found = linear.stability(own, gamma, 1.0)
        windows = "; ".join(f"{start:.7g}…{end:.7g}" for start, end in found.windows)
        row: Row = {"question": question, "measured": found.limit, "note": windows}
        yield row | {"true": theory(gamma, 1.0) if theory else None}


# -- rates of damping ------------------------------------------------------------------------------
#: overdamped oscillator: tolerances, and steps times the damping
CREEP_RTOLS, DAMPING_PER_STEP = (1e-3, 1e-6, 1e-9), (1.0, 5.0, 25.0)
#: spans for weak damping
SPANS = (1e4, 1e5)
#: most steps of a compiled solver, and most right-hand sides in Python, for the slow creep
MOST_STEPS, MOST_CALLS = 1_000_000, 120_000


def rate_cells(profile: Profile) -> list[Cell]:
    """Return (rate, method, span): creep for stiff and quickly compiled methods, weak damping for compiled ones."""
    creep = cb.SCENES["overdamped"].t_end
    if profile.brief:
        first = next(iter(cb.METHODS))
        return [("creep", first, creep), ("weak", first, SPANS[0])]
    full = profile.reaches("full")
    able = (m for m in cb.METHODS.values() if not m.solves(cb.SCENES["overdamped"]))
    soon = {m.name: full or m.engines[0] not in PACKAGES for m in able}
    found = [
        ("creep", name, creep)
        for name, soon_compiled in soon.items()
        if soon_compiled or cb.METHODS[name].stiff
    ]
    compiled = [name for name, each in soon.items() if each and cb.METHODS[name].engines[0] not in CALLBACKS]
    return [*found, *(("weak", name, span) for span in SPANS for name in compiled)]


@experiment(rate_cells)
def rates(cell: Cell, profile: Profile) -> Recorded:
    question, method, span = cell
    rows = creep_rows(cb.METHODS[method]) if question == "creep" else [weak_row(cb.METHODS[method], span)]
    yield from ((LIMITS, {"question": question, "method": method, "t_end": span} | row) for row in rows)


def rate_row(solution: Solution) -> Row:
    scene: Any = solution.scene
    row: Row = {"scene": scene.name, "gamma": scene.gamma, "status": str(solution.status)}
    return row | {"evaluations": solution.counts.rhs_equivalents, "note": solution.message}


def beside(rate: float, true: float) -> Row:
    return {"measured": rate, "error": abs(rate / true - 1)}


# -- how the rate depends on the step --------------------------------------------------------------
#: a body that falls with drag, in seconds; steps a second, and dampings per second
FALLING = cb.Mechanical(
    name="falling_body",
    potential=lambda q, g: g * q[0],
    q=(0.0,),
    p=(0.0,),
    t_end=1.0,
    parameters={"g": 9.81},
)
TICKS, DRAGS = (30, 60, 120), (0.1, 0.3, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 50.0)


def ticking(profile: Profile) -> list[Cell]:
    """Return the one-step methods that evaluate one force a step, as a game engine does."""
    own = [m for m in cb.METHODS.values() if isinstance(m, FixedStep) and m.one_step and not m.iterates]
    fit = [m for m in own if m.refuses(FALLING) is None and not m.solves(FALLING)]
    found = [(m.name,) for m in fit if m.per_step(FALLING) == 1]
    return found[:1] if profile.brief else found


@experiment(ticking)
def ticks(cell: Cell, profile: Profile) -> Recorded:
    """Yield the rates at which a falling body comes to its final speed."""
    own: Row = {"question": "tick", "scene": FALLING.name, "method": cell[0], "evaluations": 1}
    for gamma in DRAGS:
        for tick in TICKS:
            h = 1 / tick
            solution = cb.solve(
                FALLING.with_(gamma=gamma), cell[0], step=h, save_at=[0.0, h, 2 * h], carry=()
            )
            first, second = np.diff(solution.states().p[0])
            kept = second / first
            rate = -math.log(kept) / h if kept > 0 else math.inf  # it stops at once, or swings
            row = {"gamma": gamma, "setting": tick, "status": str(solution.status), "true": gamma}
            yield LIMITS, own | row | beside(rate, gamma)


# -- overdamped ------------------------------------------------------------------------------------
def creep_rows(method: Method) -> Iterator[Row]:
    """Yield the decay rate of an overdamped motion between t_end/2 and t_end, with the true slow rate."""
    scene = cb.SCENES["overdamped"]
    true = linear.slow_rate(scene.gamma)
    steps = tuple(damping / scene.gamma for damping in DAMPING_PER_STEP)
    most, each = MOST_STEPS, method.step_cost(scene, method.engines[0])
    if each is not None:
        most = int(MOST_CALLS // each)
    ends = [scene.t_end / 2, scene.t_end]
    for value in {"step": steps, "rtol": CREEP_RTOLS, EXACT: (0.0,)}[method.control]:
        given: Row = {"save_at": Elapsed(ends), "carry": (), "max_steps": most, "dense": False}
        solution = cb.solve(scene, method, **given, **keywords(method.control, value))
        row = rate_row(solution) | {"setting": value, "true": true}
        if solution.ok:
            with np.errstate(divide="ignore"):
                size = np.log(np.abs(solution.y[:, 0]))
            row |= beside((size[0] - size[1]) / (ends[1] - ends[0]), true)
        yield row


# -- weak damping ----------------------------------------------------------------------------------
#: evaluations per unit of time, for every method alike; adaptive ones are matched over a shorter span
COST, PILOT = 8.0, 200.0
#: number of times at which H0 of a method and of the truth is read, dense enough to resolve the oscillation of H0
SAMPLES = 1000


def energy_rate(t: np.ndarray, energy: np.ndarray) -> float:
    """Return the mean decay rate of H0: the weighted least-squares slope of log H0 over the span.

    The weight is flat at both ends with all its derivatives, so that oscillations of H0 hardly count (Das, Saiki,
    Sander, Yorke, Nonlinearity 30, 4111 (2017), doi:10.1088/1361-6544/aa84c2).
    """
    n = len(t)
    u = np.arange(1, n + 1) / (n + 1)
    weight = np.exp(-1 / (u * (1 - u)))
    lever = weight * (t - np.average(t, weights=weight))
    return float(-(lever @ np.log(energy)) / (lever @ t))


def weak_row(method: Method, span: float) -> Row:
    """Return the damping rate over a span, every method at about COST evaluations per unit of time."""
    scene = cb.SCENES["weak_damping"].with_(t_end=span)
    if method.refuses(scene) is not None:
        return rate_row(cb.solve(scene, method, **refused(method))) | {"setting": span}
    value = setting_at_cost(scene, method)
    times, setting = span * np.arange(1, SAMPLES + 1) / SAMPLES, keywords(method.control, value)
    solution = cb.solve(scene, method, save_at=Elapsed(times), carry=(), dense=False, **setting)
    row = rate_row(solution) | {"setting": span}
    if not solution.ok:
        return row
    # the cost without saved times
    ended = cb.solve(scene, method, save_at=Elapsed(times[-1:]), carry=(), **setting)
    row["evaluations"] = ended.counts.rhs_equivalents
    truth = scene.unpack(cb.reference(scene, times, ()).y.T, ())
    rate, true = (energy_rate(times, scene.energy(x)) for x in (solution.states(), truth))
    return row | {"true": true} | beside(rate, true)


def refused(method: Method) -> dict[str, float]:
    return keywords(method.control, method.rtol_range[1] if method.adaptive else 1 / COST)


def setting_at_cost(scene: Scene, method: Method) -> float:
    def cost(rtol: float) -> float:
        return right_hand_sides(cb.solve(scene, method, rtol=rtol, save_at=Elapsed([PILOT]), carry=()))

    if method.adaptive:
        return tolerance_at(cost, COST * PILOT, method.rtol_range)
    own: Any = method
    return step_at(own, scene, COST * scene.t_end, SAMPLES) if method.control == "step" else 0.0
