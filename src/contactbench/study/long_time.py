"""What do long runs of a chaotic scene average to, and at what cost?  One cell: a method at all its settings.

Trajectories start anywhere in both wells and settle; then energy and exponents are averaged: of fixed steps by one run
with tangents, of a solver that chooses its steps the energy by a plain run.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

import contactbench as cb
from contactbench.measure.statistics import Average, blocks, jackknife
from contactbench.methods.base import Method
from contactbench.methods.fixed_step import FixedStep
from contactbench.results.tables import DIMENSION, ENERGY, EXPONENT, LONG_TIME, SUM
from contactbench.solution import keywords
from contactbench.study.choice import key
from contactbench.study.experiment import Cell, Profile, Recorded, Row, experiment

SCENE = cb.SCENES["duffing"]
PERIOD = 2 * math.pi / SCENE.parameters["drive"]
FIXED = ("contact-strang", "contact-rkn4", "contact-rkn6", "herglotz2", "rk4")
ADAPTIVE = ("cyrk-dop853", "cyrk-vern8", "cvode-adams")
#: in the full profile alone: of lower order than the others, it takes the most evaluations
FULL = ("cyrk-tsit5",)
#: multistep: the variational equations begin anew after every orthonormalisation
WITHOUT_TANGENTS = ("cvode-adams",)
#: evaluations in a period that fixed steps are chosen for, and tolerances
EVALUATIONS, RTOLS = (12, 16, 24, 32, 48, 64, 96, 192), (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
TRAJECTORIES, PERIODS, SETTLE, SEED = 128, 400, 50, 1
#: another engine than those compared, and finer: with what the others are compared
REFERENCE, REFERENCE_RTOL, REFERENCE_TRAJECTORIES = "cyrk-dop853", 1e-8, 512


def starts(count: int) -> dict[str, tuple[np.ndarray]]:
    rng = np.random.default_rng(SEED)
    return {"q": (rng.uniform(-1.5, 1.5, count),), "p": (rng.uniform(-1, 1, count),)}


def settings(method: Method) -> list[tuple[str, float]]:
    if method.adaptive:
        return [("rtol", rtol) for rtol in RTOLS]
    assert isinstance(method, FixedStep)
    each = method.per_step(SCENE, ())
    return [("step", PERIOD / n) for n in dict.fromkeys(max(1, round(e / each)) for e in EVALUATIONS)]


def with_tangents(method: Method, kind: str, value: float, count: int = TRAJECTORIES) -> Iterator[Row]:
    span = {"every": PERIOD, "intervals": PERIODS, "settle": SETTLE, "initial_conditions": starts(count)}
    found = cb.lyapunov(SCENE, method.name, **span, **keywords(kind, value))
    largest = Average(found.exponents.value[0], found.exponents.error[0])
    total = found.total._replace(value=found.total.value + SCENE.gamma)
    averages = {ENERGY: found.energy, EXPONENT: largest, DIMENSION: found.dimension, SUM: total}
    defect = found.rates.sum(axis=1) + SCENE.gamma
    for quantity, average in averages.items():
        made = row(method, kind, value, quantity, average, (found.evaluations, 0.0), found.diverged, count)
        if quantity == SUM and not found.diverged:
            made["pairing_defect"] = math.sqrt(np.mean(defect * defect))
        yield made


def plain(method: Method, kind: str, value: float) -> Row:
    """Return the row of the energy of runs without tangents, saved once in a period."""
    times = PERIOD * np.arange(1, SETTLE + PERIODS + 1)
    run = cb.prepare(SCENE, method.name, save_at=times, carry=(), **keywords(kind, value))
    given = starts(TRAJECTORIES)
    runs = [run(q=(q,), p=(p,)) for q, p in zip(given["q"][0], given["p"][0], strict=True)]
    energy = np.array([SCENE.energy(solution.states())[SETTLE:] for solution in runs])
    average = jackknife(blocks(energy.T[:, None]), np.sum)
    spent = np.mean([(each.counts.evaluations, each.counts.jacobians) for each in runs], axis=0) / times[-1]
    return row(method, kind, value, ENERGY, average, spent, sum(not solution.ok for solution in runs))


def row(
    method: Method,
    kind: str,
    value: float,
    quantity: str,
    average: Average,
    spent: Sequence[float],
    lost: int,
    count: int = TRAJECTORIES,
) -> Row:
    """Return one row, without numbers where a trajectory was lost, which would leave an average over the others.

    spent : evaluations and Jacobians per unit of time.
    """
    made = key(SCENE.name, method.name, method.engines[0], kind, value)
    made |= {"quantity": quantity, "reference": count > TRAJECTORIES, "trajectories": count}
    made |= {
        "periods": PERIODS,
        "evaluation_kind": method.kind_on(SCENE) if isinstance(method, FixedStep) else "rhs",
    }
    if lost:
        message = f"{lost} of {count} trajectories left the scene's scale"
        return made | {"status": "diverged", "message": message}
    made |= {"status": "ok", "message": "", "mean": float(average.value), "error": float(average.error)}
    return made | {"evaluations_per_time": float(spent[0]), "jacobians_per_time": float(spent[1])}


def cells(profile: Profile) -> list[Cell]:
    every = (*FIXED, *ADAPTIVE, *(FULL if profile.reaches("full") else ()))
    one = FIXED[1:2]  # it has rows of every kind
    return [(SCENE.name, method) for method in (one if profile.brief else every)]


@experiment(cells)
def long_time(cell: Cell, profile: Profile) -> Recorded:
    method = cb.METHODS[cell[1]]
    rows = []
    for kind, value in settings(method):
        if kind == "rtol":
            rows.append(plain(method, kind, value))
        if method.name not in WITHOUT_TANGENTS:
            found = with_tangents(method, kind, value)
            rows += [each for each in found if kind == "step" or each["quantity"] != ENERGY]
    if method.name == REFERENCE:
        rows += with_tangents(method, "rtol", REFERENCE_RTOL, REFERENCE_TRAJECTORIES)
    yield from ((LONG_TIME, each) for each in rows)
