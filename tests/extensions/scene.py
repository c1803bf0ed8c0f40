"""A scene of one's own: a quartic well."""

import contactbench as cb

cb.SCENES.add(
    cb.Mechanical(
        name="quartic",
        about="H = ½p² + ¼q⁴ + γs",
        potential=lambda q: q[0] * q[0] * q[0] * q[0] / 4,
        gradient=lambda q: (q[0] * q[0] * q[0],),
        hessian=lambda q: ((3 * q[0] * q[0],),),
        gamma=0.1,
        q=(1.0,),
        p=(0.0,),
        t_end=5.0,
    )
)
