"""How fast does the error fall with the step?  One cell: a fixed-step method on a scene."""

from __future__ import annotations

import math

import contactbench as cb
from cells import cells, outcome, save_times, setting, steps
from contactbench.analysis import fit_order
from contactbench.table import CONVERGENCE

POINTS = 9
#: below this, relative to the solution, an error is round-off
FLOOR = 1e-12


def ladder(profile):
    return [
        (scene, name) for scene in cb.SCENES for name, method in cb.METHODS.items() if not method.adaptive
    ]


@cells(ladder)
def test_convergence(cell, profile, record):
    scene, method = cb.SCENES[cell[0]], cb.METHODS[cell[1]]
    hs = steps(scene, POINTS if profile.points > 1 else 4)
    solutions = [
        cb.solve(scene, method.name, save_at=save_times(scene), carry=(), **setting(method, h)) for h in hs
    ]
    errors = [cb.LAWS["solution_error"](solution) for solution in solutions]
    fit = fit_order(hs, errors, FLOOR)
    for i, (h, solution) in enumerate(zip(hs, solutions, strict=True)):
        record(
            CONVERGENCE,
            **outcome(solution),
            step=h,
            solution_error=errors[i],
            pairwise_order=fit.pairwise[i],
            in_fit=bool(fit.used[i]),
            order=fit.order,
            order_low=fit.low,
            order_high=fit.high,
            order_nominal=method.order,
        )
    assert all(s.ok or s.message for s in solutions)
    assert math.isnan(fit.order) or fit.order > 0
