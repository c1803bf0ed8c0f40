"""What does round-off grow to in a run that is taken back?  One cell: a damping, a step, a force, a span."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np

import contactbench as cb
from contactbench.results.tables import REVERSIBILITY
from contactbench.study.choice import key
from contactbench.study.experiment import Cell, Profile, Recorded, Row, experiment
from contactbench.study.gradient import FORCED, FORWARD, REVERSIBLE, arguments, distance, program, ways

#: the method of runs taken back; γ and step, of an oscillation and an overdamped motion; the force on either; γT
BACK, RATES, FORCES, SPANS = "contact-strang", ((0.1, 1 / 8), (4.0, 1 / 16)), (0.0, 0.3), (1, 5, 10, 20, 30)

type Packed = tuple[float, ...]


@cache
def steps_of(method: str) -> Callable[..., Packed]:
    """Return the compiled ``(n, h, y, γ, force) -> y``: n steps of size h, which may be negative."""
    from contactbench.xla import jax

    def steps(n: int, h: float, y: Packed, gamma: float, force: float) -> Packed:
        end: Packed = jax.lax.fori_loop(0, n, lambda _, y: step(y, h, gamma=gamma, force=force), y)
        return end

    step = cb.step_map(FORCED, method, carry=())
    return jax.jit(steps)


def taken_back(gamma: float, h: float, force: float, span: float) -> Row:
    """Return the row of a run that is taken back: how far its start is off, and the derivative."""
    end, changed, start = span / gamma, {"gamma": gamma, "force": force}, (1.0, 0.0, 0.0)
    y: Packed = start
    for size in (h, -h):
        y = steps_of(BACK)(round(end / h), size, y, gamma, force)
    given = arguments(FORCED, end, h, **changed)
    back, kept = (np.array(program(FORCED, BACK, how)(*given)[0]) for how in (REVERSIBLE, FORWARD))
    row = key(FORCED, BACK, "jax", "step", h) | changed | {"t_end": end, "status": "ok", "message": ""}
    row |= {"growth": math.exp(span), "start_error": math.dist(y, start)}
    return row | {"gradient_error": distance(back, kept)}


@experiment(lambda profile: [(*rate, f, s) for rate in RATES for f in FORCES for s in SPANS if ways(profile)])
def reversibility(cell: Cell, profile: Profile) -> Recorded:
    yield REVERSIBILITY, taken_back(*cell)
