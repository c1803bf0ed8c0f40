"""What does keeping the structure buy?  One cell: a method at one setting, on a chaotic ring with weak damping.

Nobody follows such a trajectory for long; what is compared is the energy left, less the centre of mass's, and its rate.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import bootstrap

import contactbench as cb
from contactbench.measure.clock import Call
from contactbench.methods.prepared import Prepared
from contactbench.numbers.protocol import Arithmetic, Vector
from contactbench.runs.choice import EVERYWHERE, key
from contactbench.runs.experiment import Cell, Profile, Recorded, Row, Timing, experiment, timed_experiment
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.solution import Solution, keywords
from contactbench.tables.declared import STRUCTURE_BUYS

RING, QUADRATIC = "chaotic_ring", "chaotic_ring_quadratic"
#: of the scene whose damping has a quadratic term
KAPPA = 1e-7
LOW, MIDDLE, HIGH = (0.8, 0.56, 0.4, 0.28, 0.2, 0.14, 0.1, 0.07), (1.6, 1.1, 0.8, 0.56, 0.4, 0.28), (2.2, 1.6)
#: steps from where a run is lost
STEPS = {
    "contact-strang": LOW,
    "herglotz2": LOW,
    "contact-rkn4": MIDDLE,
    "contact-rkn6": MIDDLE,
    "contact-rkn8": (*HIGH, *MIDDLE[1:]),
    "rkn8": MIDDLE,
    "rkn12": (*HIGH, *MIDDLE[1:4]),
    "quinlan-tremaine8": (0.16, 0.14, 0.12, 0.1, 0.08, 0.06),
    "rk4": (0.28, 0.2, 0.14, 0.1, 0.07, 0.05, 0.035, 0.025),
}
#: tolerances from the loosest that a method holds, as powers of ten
POWERS = {"cyrk-dop853": (4, 8), "cyrk-vern8": (3, 8), "cvode-adams": (4, 8), "heyoka-taylor": (4, 9)}
LADDERS = STEPS | {name: tuple(10.0**-k for k in range(a, b + 1)) for name, (a, b) in POWERS.items()}
#: at weak damping and over the first of the long spans those around an error of 1 %, where each is dear
LONG_SPAN = 1e5
AROUND = {
    "contact-strang": (0.4, 0.28, 0.2, 0.14),
    "herglotz2": (0.4, 0.28, 0.2, 0.14),
    "contact-rkn4": (0.56, 0.4),
    "contact-rkn6": (1.1, 0.8),
    "quinlan-tremaine8": (0.12, 0.1),
    "rk4": (0.07, 0.05, 0.035),
    "rkn8": (0.8, 0.56, 0.4),
    "rkn12": (1.6, 1.1),
    "cyrk-dop853": (1e-6, 1e-7),
    "cyrk-vern8": (1e-5, 1e-6),
}
#: left to the full profile at those: a run from 16 starts takes half a minute of each, 61 and 97 times the best
LOST_LONG = {"cvode-adams", "heyoka-taylor"}
N, GAMMA, SPAN, SAVES = 16, 1e-5, 1e4, 20
#: other dampings and lengths of a run, by the profile from which on they are run
MORE = {
    "standard": [(GAMMA, LONG_SPAN), (1e-4, SPAN), (1e-3, SPAN)],
    "full": [(1e-4, 1e5), (GAMMA, 1e6)],
}
FEW = ("contact-strang", "contact-rkn4", "rk4", "cyrk-vern8")
#: starts of a run, and the probability that the true median lies in its interval
STARTS, AMPLITUDE, SEED, CONFIDENCE = 16, 1e-2, 1, 0.95
TRUTH, BESIDE = ("contact-rkn8", {"step": 0.2}), ("cyrk-vern8", {"rtol": 1e-8})
#: the method without long runs
BRIEF = {"contact-rkn8"}
MOST_STEPS = 10**8
#: what is timed is so much of a run
TIMED = 500.0


def ladder(profile: Profile) -> list[Cell]:
    """(scene, method, engine, γ, end, value)."""
    if profile.brief:
        return [cell for name in EVERYWHERE for cell in rungs(RING, name, GAMMA, SPAN)[3:5]]
    rows = [cell for name in LADDERS for cell in rungs(RING, name, GAMMA, SPAN)]
    rows += [cell for name in FEW for cell in rungs(QUADRATIC, name, GAMMA, SPAN)]
    full = profile.reaches("full")
    for case in MORE["standard"] + (MORE["full"] if full else []):
        chosen = set(LADDERS) - BRIEF - (set() if full else LOST_LONG) if case[0] == GAMMA else FEW
        rows += [cell for name in LADDERS if name in chosen for cell in rungs(RING, name, *case)]
    return rows


def rungs(scene: str, name: str, gamma: float, span: float) -> list[Cell]:
    """Return the cells of a method; beside the main ones without the first, which is lost, and the last, dear one."""
    around = AROUND if (gamma, span) == (GAMMA, LONG_SPAN) else {}
    main = (scene, gamma, span) == (RING, GAMMA, SPAN)
    values = LADDERS[name] if main else around.get(name, LADDERS[name][1:-1])
    return [(scene, name, cb.METHODS[name].engines[0], gamma, span, value) for value in values]


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
def ring_of(name: str, gamma: float, span: float) -> Scene:
    """Return the ring; the one named `QUADRATIC` has a damping quadratic in s as well."""
    q, p = map(tuple, waves().tolist())
    kappa = KAPPA if name == QUADRATIC else 0.0
    given: Row = {"gamma": gamma, "kappa": kappa, "parameters": {"beta": 1.0}, "t_end": span}
    return cb.Mechanical(name=name, potential=ring_potential, q=q, p=p, **given)


def starts() -> np.ndarray:
    """Return initial data: those of the scene, and others near them."""
    off = AMPLITUDE * np.random.default_rng(SEED).normal(size=(STARTS, 2, N))
    off[0] = 0
    return waves() + off


def energy_left(q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return H0 less that of the centre of mass; sites along the first axis."""
    bonds: Any = quartic_bond(np.roll(q, -1, axis=0) - q, 1.0)
    total: np.ndarray = (p * p).sum(axis=0) / 2 + bonds.sum(axis=0)
    return total - p.sum(axis=0) ** 2 / (2 * len(q))


def prepared(method: str, case: Cell, end: float, saves: int, **setting: float) -> Prepared:
    given: Row = {"save_at": Elapsed(end * np.arange(1, saves + 1) / saves), "carry": (), **setting}
    return cb.prepare(ring_of(*case), method, max_steps=MOST_STEPS, **given)


def runs(method: str, case: Cell, **setting: float) -> tuple[list[Solution], np.ndarray]:
    """Return the solutions from all starts, until one ends badly, and the energies left along them."""
    run = prepared(method, case, case[2], SAVES, **setting)
    found: list[Solution] = []
    for q, p in starts():
        found.append(run(q=q, p=p))
        if not found[-1].ok:
            break
    return found, np.array([energy_left(each.y.T[:N], each.y.T[N : 2 * N]) for each in found])


@cache
def truth(*case: object) -> tuple[np.ndarray, float]:
    """Return the energy left from every start, and by how much it differs from another accurate method's."""
    (method, setting), (other, tolerance) = TRUTH, BESIDE
    left, beside = (runs(name, case, **keys)[1] for name, keys in ((method, setting), (other, tolerance)))
    return left, float(np.abs(beside / left - 1).max())


def interval(errors: np.ndarray) -> tuple[float, float]:
    """Return the bootstrap's interval of the median over the starts (percentiles)."""
    options: Row = {"method": "percentile", "rng": np.random.default_rng(SEED)}
    found = bootstrap((errors,), np.median, confidence_level=CONFIDENCE, **options)
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


def errors(cell: Cell) -> Row:
    """Return the row of a cell but for what is timed."""
    name, method, engine, gamma, span, value = cell
    case, control = (name, gamma, span), cb.METHODS[method].control
    found, left = runs(method, case, **keywords(control, value))
    last, (true, floor) = found[-1], truth(*case)
    row = key(name, method, engine, control, value) | {"gamma": gamma, "t_end": span, "n": N}
    row |= {"starts": STARTS, "floor": floor}
    row |= {"status": str(last.status), "message": last.message, "evaluation_kind": last.counts.kind}
    if not last.ok:
        return row
    error = np.abs(left / true - 1).max(axis=1)
    start = energy_left(*starts().transpose(1, 2, 0))
    loss = np.log(left[:, -1] / start) / np.log(true[:, -1] / start)
    numbers = {"energy_left": np.median(true[:, -1] / start), "energy_error": np.median(error)}
    low, high = interval(error)
    numbers |= {"energy_error_low": low, "energy_error_high": high}
    numbers |= {"energy_error_least": error.min(), "energy_error_most": error.max()}
    numbers |= {"rate_error": np.median(np.abs(loss - 1))}
    numbers |= {"evaluations_per_time": np.mean([each.counts.evaluations for each in found]) / span}
    return row | {name: float(value) for name, value in numbers.items()}


def beginning(cell: Cell) -> tuple[Row, Call]:
    """Return what is timed of a run: its beginning."""
    name, method, _, gamma, span, value = cell
    case, control = (name, gamma, span), cb.METHODS[method].control
    run = prepared(method, case, TIMED, 1, **keywords(control, value))
    return {"timed_evaluations": run().counts.evaluations}, Call(run.bare_call())


@experiment(ladder)
def structure_errors(cell: Cell, profile: Profile) -> Recorded:
    yield STRUCTURE_BUYS, errors(cell)


@timed_experiment(
    lambda profile: [c for c in ladder(profile) if c[0] == RING and c[3] == GAMMA and c[4] == SPAN],
    structure_errors,
)
def structure(cell: Cell, profile: Profile, row: Row) -> Timing:
    return Timing(STRUCTURE_BUYS, beginning, (cell,))
