"""Measure the energy left in a weakly damped chaotic ring; a cell is a method, a damping and a span.

Trajectories diverge, so methods are compared by the energy left, without the centre of mass, and its decay rate.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import bootstrap

import contactbench as cb
from contactbench.measure.clock import Call
from contactbench.methods.base import CALLBACKS, PACKAGES, Method
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.prepared import Prepared
from contactbench.numbers.protocol import Arithmetic, Vector
from contactbench.questions.contest import ALLOWED, TIMED_SPAN
from contactbench.runs.experiment import Cell, Profile, Recorded, Row, Timing, experiment, timed
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.solution import Solution, keywords
from contactbench.tables.declared import RING

NAME, N, SAVES = "chaotic_ring", 16, 20
#: damping and span of every method, the long span, and other dampings
GAMMA, SPAN, LONG_SPAN, OTHERS = 1e-5, 1e4, 1e5, (1e-4, 1e-3)
#: further dampings and spans of the full profile
MORE = ((1e-4, LONG_SPAN), (GAMMA, 1e6))
#: starts of a run, and the probability that the true median lies in its interval
STARTS, AMPLITUDE, SEED, CONFIDENCE = 6, 1e-2, 1, 0.95
TRUTH, BESIDE = ("contact-rkn8", {"step": 0.2}), ("rkn12", {"step": 0.8})
MOST_STEPS = 10**8


# -- methods and cells -----------------------------------------------------------------------------
#: steps and tolerances, coarse to fine
STEPS = (2.2, 1.6, 1.1, 0.8, 0.56, 0.4, 0.28, 0.2, 0.14, 0.1, 0.07, 0.05, 0.035, 0.025, 0.018, 0.0125)
RTOLS = tuple(10.0**-k for k in range(3, 10))
#: range of evaluations per unit of time
FEWEST, MOST = 2.0, 200.0
#: error of a lost motion, and error at which a ladder ends, below the allowed one
LOST, END = 0.5, 2e-3


def methods() -> list[Method]:
    """Return the methods that evaluate only forces, and compiled non-stiff solvers."""
    scene, found = ring(GAMMA, SPAN), []
    for method in cb.METHODS.values():
        compiled = method.engines[0] not in (*CALLBACKS, *PACKAGES)
        other = method.stiff or method.iterates or method.follows or method.expands
        if method.refuses(scene) or not compiled or other:
            continue
        if method.package or (isinstance(method, FixedStep) and is_suited(method, scene)):
            found.append(method)
    return found


def is_suited(method: FixedStep, scene: Scene) -> bool:
    return method.mission or method.kind_on(scene) == "gradient"


def cells(profile: Profile) -> list[Cell]:
    """Return (scene, method, γ, span); structure-preserving methods and the mission's have several dampings.

    Order 1, which needs tiny steps, is the paper's alone; long runs leave it and solvers of variable order out.
    """
    full = profile.reaches("full")
    every = [m for m in methods() if full or m.mission or m.order != 1]
    stand_ins = {method.like for method in cb.METHODS.values() if method.mission}
    known = [m for m in every if m.mission or m.name in stand_ins]
    some = [m for m in every if m in known or m.family != "established"]
    if profile.brief:
        return [(NAME, some[0].name, GAMMA, SPAN)]
    usual = [m for m in every if m.order or m in known or full]
    far = [m for m in usual if full or ((m.order or 0) > 1 and (m in known or not m.package))]
    found = [(NAME, m.name, GAMMA, SPAN) for m in usual] + [(NAME, m.name, GAMMA, LONG_SPAN) for m in far]
    found += [(NAME, m.name, gamma, SPAN) for gamma in OTHERS for m in some if m.order or full]
    return found + ([(NAME, m.name, *case) for case in MORE for m in some] if full else [])


def ladder(method: Method) -> list[float]:
    if not isinstance(method, FixedStep):
        return [rtol for rtol in RTOLS if method.rtol_range[0] <= rtol]
    each = method.per_step(ring(GAMMA, SPAN))
    return [h for h in STEPS if FEWEST <= each / h <= MOST]


# -- the ring --------------------------------------------------------------------------------------
def quartic_bond(r: Arithmetic, beta: Arithmetic) -> Arithmetic:
    """W = ½ r² + ¼ β r⁴: the β-chain of Fermi, Pasta, Ulam and Tsingou."""
    square = r * r  # of the forms of W, the one whose derivative is shortest
    return square * (0.5 + beta / 4 * square)


def ring_potential(q: Vector, beta: Arithmetic) -> Arithmetic:
    """V = Σ W(q_{i+1} − q_i) around the ring."""
    V: Arithmetic = 0.0
    for a, b in pairwise((*q, q[0])):
        V = V + quartic_bond(b - a, beta)
    return V


def waves() -> np.ndarray:
    """Return q, a long wave, and p, two of half its length and a drift, (2, N)."""
    angle = 2 * np.pi * np.arange(N) / N
    return np.array([np.sin(angle), 0.3 + 0.5 * np.cos(2 * angle)])


@cache
def ring(gamma: float, span: float) -> Scene:
    q, p = map(tuple, waves().tolist())
    given: Row = {"gamma": gamma, "parameters": {"beta": 1.0}, "t_end": span}
    return cb.Mechanical(name=NAME, potential=ring_potential, q=q, p=p, **given)


def starts() -> np.ndarray:
    """Return initial data: those of the scene, and others near them."""
    off = AMPLITUDE * np.random.default_rng(SEED).normal(size=(STARTS, 2, N))
    off[0] = 0
    return waves() + off


def energy_left(q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return H0 minus the energy of the centre of mass; sites along the first axis."""
    bonds: Any = quartic_bond(np.roll(q, -1, axis=0) - q, 1.0)
    total: np.ndarray = (p * p).sum(axis=0) / 2 + bonds.sum(axis=0)
    return total - p.sum(axis=0) ** 2 / (2 * len(q))


# -- runs ------------------------------------------------------------------------------------------
def prepared(method: str, gamma: float, span: float, end: float, saves: int, **setting: float) -> Prepared:
    given: Row = {"save_at": Elapsed(end * np.arange(1, saves + 1) / saves), "carry": (), **setting}
    return cb.prepare(ring(gamma, span), method, max_steps=MOST_STEPS, dense=False, **given)


def runs(
    method: str, gamma: float, span: float, setting: dict[str, float], some: slice = slice(None)
) -> tuple[list[Solution], np.ndarray]:
    """Return the solutions from all starts or some, until one ends badly, and the energies left along them."""
    run = prepared(method, gamma, span, span, SAVES, **setting)
    found: list[Solution] = []
    for q, p in starts()[some]:
        found.append(run(q=q, p=p))
        if not found[-1].ok:
            break
    return found, np.array([energy_left(each.y.T[:N], each.y.T[N : 2 * N]) for each in found])


@cache
def truth(gamma: float, span: float) -> tuple[np.ndarray, float]:
    """Return the energy left from every start, and its difference to another accurate method."""
    left, beside = (runs(name, gamma, span, setting)[1] for name, setting in (TRUTH, BESIDE))
    return left, float(np.abs(beside / left - 1).max())


def interval(errors: np.ndarray) -> tuple[float, float]:
    """Return the percentile bootstrap interval of the median over the starts; of a single one its own error."""
    if len(errors) == 1:
        return float(errors[0]), float(errors[0])
    options: Row = {"method": "percentile", "rng": np.random.default_rng(SEED)}
    found = bootstrap((errors,), np.median, confidence_level=CONFIDENCE, **options)
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


@cache
def row_of(method: str, gamma: float, span: float, value: float) -> Row:
    control, (true, floor) = cb.METHODS[method].control, truth(gamma, span)
    setting = keywords(control, value)
    found, left = runs(method, gamma, span, setting, slice(1))
    # a setting with a far too large error from one start is not run from the others
    if found[0].ok and np.abs(left / true[:1] - 1).max() < 2 * LOST:
        others = runs(method, gamma, span, setting, slice(1, None))
        found, left = found + others[0], np.concatenate([left, others[1]])
    last = found[-1]
    row: Row = {"scene": NAME, "method": method, "control": control, "setting": value}
    row |= {"gamma": gamma, "t_end": span, "status": str(last.status), "note": last.message, "floor": floor}
    if not last.ok:
        return row
    true = true[: len(left)]
    error = np.abs(left / true - 1).max(axis=1)
    start = energy_left(*starts()[: len(left)].transpose(1, 2, 0))
    loss = np.log(left[:, -1] / start) / np.log(true[:, -1] / start)
    low, high = interval(error)
    row |= {"energy_left": np.median(true[:, -1] / start), "energy_error": np.median(error)}
    row |= {"low": low, "high": high, "rate_error": np.median(np.abs(loss - 1))}
    return row | {"evaluations": np.mean([each.counts.rhs_equivalents for each in found]) / span}


def is_lost(row: Row) -> bool:
    return not row.get("energy_error", math.inf) < LOST


def rungs(method: Method, gamma: float, span: float, end: float) -> Iterator[Row]:
    """Yield rows from the first setting that follows the motion to a small error; only the last one if all are lost."""
    row: Row = {}
    for value in ladder(method):
        row = row_of(method.name, gamma, span, value)
        if not is_lost(row):
            yield row
        if row.get("energy_error", math.inf) <= end:
            return
    if is_lost(row):
        yield row


def long_rungs(method: Method, gamma: float, span: float) -> Iterator[Row]:
    """Yield rows around the setting with the allowed error, starting at the setting that has it over the usual span."""
    every = ladder(method)
    *_, usual = rungs(method, gamma, SPAN, ALLOWED)
    first = every.index(usual["setting"])
    finer = [row_of(method.name, gamma, span, every[first])]
    for value in every[first + 1 :]:
        if finer[-1].get("energy_error", math.inf) <= ALLOWED:
            break
        finer.append(row_of(method.name, gamma, span, value))
    if len(finer) == 1 and first:
        yield row_of(method.name, gamma, span, every[first - 1])
    yield from finer


@experiment(cells)
def ring_energy(cell: Cell, profile: Profile) -> Recorded:
    _, name, gamma, span = cell
    method = cb.METHODS[name]
    end = END if gamma == GAMMA and method.control == "step" else ALLOWED
    found = rungs(method, gamma, span, end) if span == SPAN else long_rungs(method, gamma, span)
    yield from ((RING, row) for row in found)


# -- times -----------------------------------------------------------------------------------------
def beginning(method: str, setting: dict[str, float]) -> tuple[Row, Call]:
    """Return the call to time, the beginning of a run."""
    return {}, Call(prepared(method, GAMMA, SPAN, TIMED_SPAN, 1, **setting).bare_call())


@timed(ring_energy)
def ring_time(row: Row) -> Timing | None:
    if is_lost(row) or row["gamma"] != GAMMA or row["t_end"] not in (SPAN, LONG_SPAN):
        return None
    engine = cb.METHODS[row["method"]].engines[0]
    key = {name: row[name] for name in ("scene", "method", "control", "setting")}
    setting = keywords(row["control"], row["setting"])
    return Timing(
        key | {"engine": engine, "saved": 1}, beginning, (row["method"], setting), row["energy_error"]
    )
