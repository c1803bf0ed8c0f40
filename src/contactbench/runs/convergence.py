"""How fast does the error fall with the step?  One cell: a fixed-step method on a scene.

Up to order 4, and of other libraries, in double precision over the whole scene; above it at 50 digits over its first
part, because round-off would hide the slope.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

import contactbench as cb
from contactbench.measure.order import DIGITS, fit_order, march
from contactbench.methods.base import Method
from contactbench.methods.contact_log import Logarithmic
from contactbench.methods.fixed_step import FixedStep
from contactbench.runs.choice import key, outcome, pairs
from contactbench.runs.experiment import Cell, Profile, Recorded, Row, experiment
from contactbench.runs.settings import halving_steps, times
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.scene.scales import errors
from contactbench.solution import keywords
from contactbench.tables.declared import CONVERGENCE
from contactbench.truth import decimal_context

POINTS = 9
#: below this, relative to the solution, an error is round-off
FLOOR = 1e-12
#: steps at fifty digits; the first few in any case, the others one by one where these do not show an order yet
EXTENDED_TIME, EXTENDED_STEPS, FEW, EXTENDED_FLOOR = 4.0, (8, 16, 32, 64, 128, 256, 512), 5, 1e-33
#: for steps that iterate, some forty times to fifty digits
ITERATED_TIME, ITERATED_FEW = 1.0, 4


def in_double_precision(scene: Scene, method: Method) -> Iterator[tuple[Row, float, float]]:
    hs = halving_steps(scene, POINTS)
    if method.follows:  # between round-off and the largest steps there are few that halve
        hs = [hs[0] * 2 ** ((1 - k) / 2) for k in range(2 * POINTS)]
    if method.refuses(scene) is not None:  # one row says why
        hs = hs[:1]
    for h in hs:
        solution = cb.solve(
            scene, method.name, save_at=Elapsed(times(scene)), carry=(), **keywords(method.control, h)
        )
        yield outcome(solution), h, cb.LAWS["solution_error"](solution)


def at_fifty_digits(
    scene: Scene, method: FixedStep | Logarithmic, counts: Sequence[int]
) -> Iterator[tuple[Row, float, float]]:
    """Yield rows of runs on mpmath numbers: the error at the end, in parts of the larger of the start and the truth."""
    end = ITERATED_TIME if method.iterates else EXTENDED_TIME
    carry, context = scene.optional, decimal_context(DIGITS)
    truth = [context.mpf(c) for c in cb.reference(scene, Elapsed([end]), carry).decimals[0]]
    start = scene.pack(scene.initial(carry))
    for n in counts:
        h = end / n
        row = key(scene.name, method.name, "mpmath", "step", h)
        row |= {"status": "ok", "message": "", "jacobians": 0}
        row["evaluation_kind"] = method.kind_on(scene)
        count = None if method.follows or method.iterates else method.counts(scene, n)
        row |= {"steps": None if method.follows else n, "evaluations": count}
        try:
            found = march(method, scene, context.mpf(repr(end)) / n, n, context)
            error = float(errors(scene, np.array([found]), np.array([truth]), start, carry)[0])
        except OverflowError as why:  # beyond any scale
            row, error = row | {"status": "diverged", "message": str(why)}, math.nan
        yield row, h, error


def points(measured: Sequence[tuple[Row, float, float]]) -> tuple[list[float], list[float]]:
    """Return the steps and the errors."""
    return [h for _, h, _ in measured], [error for _, _, error in measured]


def ladder(profile: Profile) -> list[Cell]:
    fixed = [name for name, method in cb.METHODS.items() if method.control == "step"]
    return pairs(profile, "convergence", fixed)


@experiment(ladder)
def convergence(cell: Cell, profile: Profile) -> Recorded:
    scene, method = cb.SCENES[cell[0]], cb.METHODS[cell[1]]
    high = isinstance(method, FixedStep | Logarithmic) and method.order > 4
    extended = high and method.refuses(scene) is None
    few = ITERATED_FEW if method.iterates else FEW
    first, finer = (EXTENDED_STEPS[:few], EXTENDED_STEPS[few:]) if extended else ((), ())
    measured = list(at_fifty_digits(scene, method, first) if extended else in_double_precision(scene, method))
    floor = EXTENDED_FLOOR if extended else FLOOR
    for n in finer:
        if math.isfinite(fit_order(*points(measured), floor).order):
            break
        measured += at_fifty_digits(scene, method, [n])
    rows = [row for row, _, _ in measured]
    hs, errors = points(measured)
    fit = fit_order(hs, errors, floor)
    order = {"order": fit.order, "order_uncertainty": fit.uncertainty, "order_nominal": method.order}
    for i, row in enumerate(rows):
        point = {"step": hs[i], "solution_error": errors[i], "pairwise_order": fit.pairwise[i]}
        point |= {"in_fit": bool(fit.used[i]), "last_slope": fit.last_slope}
        yield CONVERGENCE, row | point | order
    assert math.isnan(fit.order) or fit.order > 0
