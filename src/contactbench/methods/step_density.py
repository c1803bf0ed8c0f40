"""The step density ρ of `contact-adaptive` (see there), on every kind of number."""

from __future__ import annotations

from typing import Any

from contactbench.numbers.dual import Dual, slope, value
from contactbench.scene import Mechanical, Vector

#: the density may fall by this factor in one step, at most: with a tolerance so loose that it would
#: otherwise become negative, symmetry is lost
SLOWEST = 0.25


def squared_curvature(scene: Mechanical, q: Vector, v: Vector) -> Dual:
    """‖∇²V‖²_F at q and its rate of change along v."""
    if scene.hessian is not None:
        rows = scene.hessian(tuple(map(Dual, q, v)), **scene.parameters)
        entries = [entry for row in rows for entry in row]
    else:
        moving, entries = tuple(map(Dual, q, v)), []
        for j in range(len(q)):
            column = scene.dV(tuple(Dual(x, float(i == j)) for i, x in enumerate(moving)))
            entries += [slope(entry) for entry in column]
    total = Dual(0.0, 0.0)
    for entry in entries:
        total = total + entry * entry
    return Dual(value(total), slope(total))


def frequency(scene: Mechanical, x: Any, span: Any) -> tuple[Any, Any]:
    """ω, and d ln ω/dt along the motion."""
    square = scene.inverse_mass * scene.inverse_mass
    curvature = squared_curvature(scene, x.q, tuple(p * scene.inverse_mass for p in x.p))
    damping = scene.gamma * scene.gamma / 64
    fourth = curvature.a * square + damping * damping + 1 / (span * span * span * span)
    return fourth**0.25, curvature.b * square / (4 * fourth)


def first_density(scene: Mechanical, x: Any, epsilon: Any, span: Any, largest: Any) -> Any:
    """ρ of the first step."""
    omega, growth = frequency(scene, x, span)
    return largest(omega + epsilon * growth / 2, SLOWEST * omega)


def next_density(scene: Mechanical, x: Any, density: Any, epsilon: Any, span: Any, largest: Any) -> Any:
    """ρ of the step after x."""
    return largest(density + epsilon * frequency(scene, x, span)[1], SLOWEST * density)
