"""An integrator of one's own: Heun's method."""

import contactbench as cb


@cb.fixed_step("heun", order=2, evaluations=2, about="Heun, Z. Math. Phys. 45, 23 (1900)")
def heun(scene, x, h, xp):
    first = scene.rhs(x)
    second = scene.rhs(cb.shifted(x, h, first))
    return cb.shifted(cb.shifted(x, h / 2, first), h / 2, second)
