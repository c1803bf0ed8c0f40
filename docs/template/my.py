"""A method and a scene of one's own."""

import contactbench as cb

cb.SCENES.add(
    cb.Mechanical(
        name="double-well",
        potential=lambda q: q[0] ** 4 / 4 - q[0] ** 2 / 2,
        gamma=0.2,
        q=(1.5,),
        p=(0.0,),
        t_end=20.0,
    )
)


@cb.fixed_step("my-method", order=2, evaluations=2, about="the explicit midpoint rule")
def midpoint(scene, x, h, xp):
    half = cb.shifted(x, h / 2, scene.rhs(x))
    return cb.shifted(x, h, scene.rhs(half))
