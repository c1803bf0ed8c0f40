"""What can be said of a problem in a second, without compiling anything: what a force costs."""

from __future__ import annotations

from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import Scene
from contactbench.trace.form import FUNCTIONS
from contactbench.trace.formula import formula

#: what an operation costs, in additions; the cost of a function that cannot be counted
DIVISION, FUNCTION, UNKNOWN = 4.0, 12.0, 1000.0
COSTS = dict.fromkeys(("div", "sqrt"), DIVISION) | dict.fromkeys(
    (*FUNCTIONS, "pow", "atan2", "hypot"), FUNCTION
)


def force_cost(scene: Scene) -> float:
    """Return what a right-hand side costs, in additions, counted in its recorded form."""
    scene, carry = scene.recorded(), scene.carry(())
    size = len(scene.without_clock(scene.labels(carry)))
    try:
        slopes = formula(lambda t, y: tuple(scene.slopes(t, y, carry)), (0, size), ())
    except CannotRecord:
        return UNKNOWN
    functions = (getattr(step.value, "function", "") for step in slopes.body)
    return sum(COSTS.get(name, 1.0) for name in functions)
