"""Settings at which methods cost the same: a tolerance by bisection, a step from the evaluations it takes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from contactbench.methods.prepared import IMPLICIT
from contactbench.scene import Scene
from contactbench.solution import Solution, Status

#: a tolerance is taken whose cost is this near to the one asked for, or the nearest met
NEAR = 0.02
#: tolerances have this many significant digits, and are told apart by this much in log10(rtol)
DIGITS, RESOLUTION = 3, 2e-3


def right_hand_sides(solution: Solution) -> float:
    """What `tolerance_at` bisects: right-hand sides of a run, 0 for a bad end, inf for a spent budget."""
    if solution.ok:
        known = solution.counts.rhs_equivalents
        return IMPLICIT * (solution.counts.steps or 0) if known is None else known
    return math.inf if solution.status is Status.budget else 0.0


def tolerance_at(cost: Callable[[float], float], target: float, rtol_range: tuple[float, float]) -> float:
    """The tolerance at which a run costs `target`, by bisection in log(rtol).

    cost : evaluations at a tolerance; 0 for a run that came to a bad end, inf for one that spent its budget.
    Of the tolerances looked at, the one whose cost is nearest, as a ratio, the tightest of equals.  A method that costs
    more at its loosest tolerance gets the tightest that costs hardly more than that: the loosest buys nothing.
    """
    low, high = (math.log10(rtol) for rtol in rtol_range)
    costs: dict[float, float] = {}

    def looked_at(exponent: float) -> float:
        rtol = min(max(float(f"{10**exponent:.{DIGITS - 1}e}"), rtol_range[0]), rtol_range[1])
        costs[rtol] = cost(rtol)
        return costs[rtol]

    target = max(target, (1 + 2 * NEAR) * looked_at(high))
    while high - low > RESOLUTION:
        middle = (low + high) / 2
        found = looked_at(middle)
        if abs(found / target - 1) < NEAR:
            break
        low, high = (low, middle) if found < target else (middle, high)
    if not any(found >= target for found in costs.values()):  # the tightest costs less, or was not tried
        looked_at(math.log10(rtol_range[0]))
    off = {rtol: abs(math.log(found / target)) for rtol, found in costs.items() if 0 < found < math.inf}
    return min(off or costs, key=lambda rtol: (off.get(rtol, math.inf), rtol))


def step_at(method: Any, scene: Scene, target: float, part: int = 1) -> float:
    """The step, t_end over a multiple of `part`, at which a run to the end costs nearest to `target`.

    target : evaluations on the scale of one right-hand side.
    """
    scale = 0.5 if method.kind_on(scene) == "rotation" else 1.0
    each = scale * method.per_step(scene)
    once = scale * method.counts(scene, 1) - each  # what a run costs beside its steps: a processor
    n = max(1, round((target - once) / each / part)) * part
    return scene.t_end / n
