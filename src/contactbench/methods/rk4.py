"""The classical Runge–Kutta method, applied to the contact equations as the paper does."""

from __future__ import annotations

from contactbench.methods.fixed_step import fixed_step
from contactbench.numbers.protocol import Arithmetic, Namespace
from contactbench.scene import AnyState, Scene, shifted


@fixed_step(
    "rk4",
    order=4,
    evaluations=4,
    about="classical Runge–Kutta; Kutta, Z. Math. Phys. 46, 435 (1901); Hairer–Nørsett–Wanner I, table 1.2",
)
def rk4[X: AnyState](scene: Scene, x: X, h: Arithmetic, xp: Namespace) -> X:
    k1 = scene.rhs(x)
    k2 = scene.rhs(shifted(x, h / 2, k1))
    k3 = scene.rhs(shifted(x, h / 2, k2))
    k4 = scene.rhs(shifted(x, h, k3))
    for weight, slope in ((h / 6, k1), (h / 3, k2), (h / 3, k3), (h / 6, k4)):
        x = shifted(x, weight, slope)
    return x
