"""Measure orders of convergence; a cell is a fixed-step method on a scene.

Methods up to order 4 and of other libraries run in double precision over the whole scene.  Higher orders run at 50
digits over its first part, because round-off would hide the slope.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

import contactbench as cb
from contactbench.measure.order import DIGITS, OrderFit, fit_order, march
from contactbench.methods.base import Method
from contactbench.methods.contact_log import Logarithmic
from contactbench.methods.fixed_step import FixedStep
from contactbench.plugins import OWN
from contactbench.runs.experiment import Cell, Profile, Recorded, Row, experiment
from contactbench.runs.settings import halving_steps, times
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.scene.scales import errors
from contactbench.solution import Solution, keywords
from contactbench.tables.declared import ORDERS
from contactbench.truth import decimal_context

POINTS = 9
#: smaller relative errors are round-off
FLOOR = 1e-12
#: above this order the slope is measured at 50 digits
DOUBLE = 4
#: steps at fifty digits; the first few in any case, the others one by one where these do not show an order yet
EXTENDED_TIME, EXTENDED_STEPS, FEW, EXTENDED_FLOOR = 4.0, (8, 16, 32, 64, 128, 256, 512), 5, 1e-33
#: the same for implicit steps, which take some forty iterations to fifty digits
ITERATED_TIME, ITERATED_FEW = 1.0, 4
#: methods from this order on reach the floor after a few halvings, and take fewer steps
STEEP, STEEP_STEPS = 16, (2, 3, 4, 6, 8)

#: step size, how the run ended, error
type Point = tuple[float, str, float]


def in_double_precision(scene: Scene, method: Method) -> Iterator[Point]:
    hs = halving_steps(scene, POINTS)
    if method.follows:  # between round-off and the largest steps there are few that halve
        hs = [hs[0] * 2 ** ((1 - k) / 2) for k in range(2 * POINTS)]
    if method.refuses(scene) is not None:
        hs = hs[:1]
    for h in hs:
        given: Row = {"save_at": Elapsed(times(scene)), "carry": (), **keywords(method.control, h)}
        solution = cb.solve(scene, method.name, **given)
        yield h, str(solution.status), largest_error(solution)


def largest_error(solution: Solution) -> float:
    if not solution.ok:
        return math.nan
    scene, carry = solution.scene, solution.carry
    truth = cb.reference(scene, Elapsed(solution.elapsed), carry).y
    return float(errors(scene, solution.y, truth, solution.y0, carry).max())


def at_fifty_digits(scene: Scene, method: FixedStep | Logarithmic, counts: Sequence[int]) -> Iterator[Point]:
    """Yield runs on mpmath numbers: the error at the end, in parts of the larger of the start and the truth."""
    end = ITERATED_TIME if method.iterates else EXTENDED_TIME
    carry, context = scene.optional, decimal_context(DIGITS)
    truth = [context.mpf(c) for c in cb.reference(scene, Elapsed([end]), carry).decimals[0]]
    start = scene.pack(scene.initial(carry))
    for n in counts:
        try:
            found = march(method, scene, context.mpf(repr(end)) / n, n, context)
            error = float(errors(scene, np.array([found]), np.array([truth]), start, carry)[0])
        except OverflowError:  # beyond any scale
            yield end / n, "diverged", math.nan
        else:
            yield end / n, "ok", error


def is_extended(scene: Scene, method: Method) -> bool:
    high = isinstance(method, FixedStep | Logarithmic) and method.order > DOUBLE
    return high and method.refuses(scene) is None


def cells(profile: Profile) -> list[Cell]:
    """Return scenes and methods with a step; what iterates at 50 digits is dear, and has few scenes.

    Smoke has one scene, one method on the others, and what plug-ins bring.
    """
    scenes = [scene for scene in cb.SCENES.values() if not scene.hard]
    methods = [method for method in cb.METHODS.values() if method.control == "step"]

    def runs(scene: Scene, method: Method) -> bool:
        brought = not {scene.name, method.name} <= OWN
        if method.solves(scene):
            return False
        if profile.brief and not (brought or scene is scenes[0] or method is methods[0]):
            return False
        dear = method.expands or (method.iterates and is_extended(scene, method))
        return not dear or scene.mission or profile.reaches("full")

    return [(scene.name, method.name) for scene in scenes for method in methods if runs(scene, method)]


@experiment(cells)
def orders(cell: Cell, profile: Profile) -> Recorded:
    scene, method = cb.SCENES[cell[0]], cb.METHODS[cell[1]]
    extended = is_extended(scene, method)
    few = ITERATED_FEW if method.iterates else FEW
    counts = (STEEP_STEPS if method.order >= STEEP else EXTENDED_STEPS) if extended else ()
    first, finer = counts[:few], counts[few:]
    measured = list(at_fifty_digits(scene, method, first) if extended else in_double_precision(scene, method))
    floor = EXTENDED_FLOOR if extended else FLOOR
    for n in finer:
        if math.isfinite(fit(measured, floor).order) or measured[-1][2] < floor:  # finer ones are round-off
            break
        measured += at_fifty_digits(scene, method, [n])
    found = fit(measured, floor)
    assert math.isnan(found.order) or found.order > 0
    row: Row = {
        "scene": scene.name,
        "method": method.name,
        "engine": "mpmath" if extended else method.engines[0],
    }
    row |= {"order": found.order, "order_uncertainty": found.uncertainty, "order_nominal": method.order}
    for (h, status, error), used in zip(measured, found.used, strict=True):
        yield ORDERS, row | {"step": h, "status": status, "error": error, "in_fit": bool(used)}


def fit(measured: Sequence[Point], floor: float) -> OrderFit:
    return fit_order([h for h, _, _ in measured], [error for _, _, error in measured], floor)
