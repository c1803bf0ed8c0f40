"""Taylor series of high order in high precision, by heyoka."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from contactbench.errors import BadInput
from contactbench.numbers.series import NO_SERIES, equations
from contactbench.scene import Scene
from contactbench.truth.base import NEVER, BlowUp, Stopwatch, with_decimals
from contactbench.truth.digits import Rows, decimal_context, distance

MAX_STEPS = 1_000_000


#: a step this small against the whole span means a singularity ahead, not a fast motion
COLLAPSE = 1e-12


def taylor_system(scene: Scene, carry: tuple[str, ...], bits: int, heyoka: Any) -> tuple[list, list]:
    """Return the scene as heyoka expressions with numbers of `bits` bits, and its initial state."""
    twin = with_decimals(scene, lambda text: heyoka.real(text, bits))
    variables = heyoka.make_vars(*(f"y{i}" for i in range(len(scene.labels(carry)))))
    slopes = equations(twin, variables, carry)
    return list(zip(variables, slopes, strict=True)), twin.pack(twin.initial(carry))


def taylor(
    scene: Scene,
    times: list[str],
    carry: tuple[str, ...],
    bits: int,
    collapse: float = COLLAPSE,
    start: list[str] | None = None,
    deadline: float = NEVER,
) -> Rows:
    """Return states at increasing times ≥ 0 (decimal strings) by heyoka's Taylor series, as mpmath numbers.

    start : packed initial state as decimal strings, by default the scene's own.  Raises `BlowUp` when
    a step falls below `collapse` of the span, `OutOfTime` after the deadline (a time of `perf_counter`).
    Biscani, Izzo, Mon. Not. R. Astron. Soc. 504, 2614 (2021), doi:10.1093/mnras/stab1032.
    """
    import heyoka

    system, own = taylor_system(scene, carry, bits, heyoka)
    origin_state = own if start is None else [heyoka.real(x, bits) for x in start]
    integrator = heyoka.taylor_adaptive(
        system, np.array(origin_state), fp_type=heyoka.real, prec=bits, compact_mode=True
    )
    origin = [] if float(times[0]) == 0 else ["0.0"]
    grid = np.array([heyoka.real(t, bits) for t in [*origin, *times]])
    shortest = collapse * float(times[-1])
    watch = Stopwatch(scene, float(times[-1]), deadline)

    def keep_going(integrator: Any) -> bool:
        if watch.is_over(float(integrator.time)):
            return False
        almost_there = float(times[-1]) - float(integrator.time) <= shortest
        return almost_there or float(integrator.last_h) > shortest

    context = decimal_context(bits * 3 // 10 + 5)
    outcome, *_, states = integrator.propagate_grid(grid, callback=keep_going, max_steps=MAX_STEPS)
    if outcome == heyoka.taylor_outcome.step_limit:
        raise BadInput(f"no reference for scene {scene.name!r}: more than {MAX_STEPS} Taylor steps needed")
    if outcome != heyoka.taylor_outcome.time_limit:
        watch.check(float(integrator.time))
        if math.isnan(float(integrator.time)):
            raise BadInput(
                f"no reference for scene {scene.name!r}: its Taylor series is not finite at the start; {NO_SERIES}"
            )
        raise BlowUp(scene, context.mpf(str(integrator.time)))
    return [[context.mpf(str(x)) for x in row] for row in states[len(origin) :]]


def heyoka_reads_rhs(scene: Scene, y: list[Any], carry: tuple[str, ...]) -> bool:
    """Return whether heyoka and mpmath evaluate the same right-hand side at y to 35 digits.

    They do not where a force divides by an integer that is no power of two: heyoka turns ``x / 3``
    into a product with the double nearest to 1/3.
    """
    import heyoka

    bits = 160
    system, _ = taylor_system(scene, carry, bits, heyoka)
    variables, slopes = zip(*system, strict=True)
    compiled = heyoka.cfunc(slopes, vars=variables, fp_type=heyoka.real, prec=bits, compact_mode=True)
    context = decimal_context(48)
    state = [context.mpf(x) for x in y]
    theirs = compiled(np.array([heyoka.real(str(x), bits) for x in state]))
    twin = with_decimals(scene, context.mpf)
    ours = twin.pack(twin.rhs(twin.unpack(state, carry)))
    return distance([context.mpf(str(x)) for x in theirs], ours) <= 1e-35 * max(map(abs, [*ours, *state]))
