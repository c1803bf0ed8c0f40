"""Settings at which methods cost the same: a step from the evaluations of a step, a tolerance by bisection."""

from __future__ import annotations

import math
from collections.abc import Callable

from contactbench.solution import Status

#: a tolerance is taken whose cost is this near to the one asked for, or the nearest met
NEAR = 0.02
#: tolerances have this many significant digits, and are told apart by this much in log10(rtol)
DIGITS, RESOLUTION = 3, 2e-3


def right_hand_sides(solution) -> float:
    """What `tolerance_at` bisects: right-hand sides of a run, 0 for a bad end, inf for a spent budget."""
    if solution.ok:
        return solution.counts.rhs_equivalents
    return math.inf if solution.status is Status.budget else 0.0


def tolerance_at(cost: Callable[[float], float], target: float, rtol_range: tuple[float, float]) -> float:
    """The tolerance at which a run costs `target`, by bisection in log(rtol).

    cost : evaluations at a tolerance, more for less, but for jumps; 0 for a run that came to a bad end, which
    so loose a tolerance may lead to, inf for one that spent its budget.
    Of the tolerances looked at, the one whose cost is nearest, as a ratio, the tightest of equals.  A method
    that costs more at its loosest tolerance gets the tightest that costs hardly more than that: the loosest
    buys nothing.
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
    ended = {rtol: found for rtol, found in costs.items() if 0 < found < math.inf}
    return min(ended or costs, key=lambda rtol: (distance(costs[rtol], target), rtol))


def distance(cost: float, target: float) -> float:
    """|log(cost/target)|, inf for a bad end."""
    return abs(math.log(cost / target)) if 0 < cost < math.inf else math.inf


def step_at(method, scene, target: float, part: int = 1) -> float:
    """The step, t_end over a multiple of `part`, at which a run to the end costs nearest to `target`.

    target : evaluations on the scale of one right-hand side.
    """
    scale = 0.5 if method.kind_on(scene) == "rotation" else 1.0
    each = scale * method.per_step(scene)
    once = scale * method.counts(scene, 1) - each  # what a run costs beside its steps: a processor
    n = max(1, round((target - once) / each / part)) * part
    return scene.t_end / n
