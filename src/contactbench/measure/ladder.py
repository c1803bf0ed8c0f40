"""The settings a method is tried at: steps that halve, tolerances by decades, from coarse to fine."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from contactbench.methods.base import Method
from contactbench.methods.prescribed import geometric_steps
from contactbench.scene import Scene
from contactbench.solution import keywords

#: saved times per run: few enough to be step boundaries of every step size of the ladder
SAVES = 25
#: end times over whose runs the largest error is taken
ENDS = 5
#: coarsest step; below it a ladder halves
COARSEST = 0.8
RTOLS = [10.0**-k for k in range(3, 15)]
#: beside the tolerances of `RTOLS`: some methods are a thousand times more accurate than asked
LOOSEST = 1e-1
#: below 1e-13, and for methods that choose their order: from one decade to the next their cost doubles or falls
BETWEEN = [3e-14, 3e-15, 1e-15]


def steps(scene: Scene, count: int) -> list[float]:
    """Halving steps t_end/(25·2^k), the coarsest not above 0.8."""
    n = SAVES
    while scene.t_end / n > COARSEST:
        n *= 2
    return [scene.t_end / (n * 2**k) for k in range(count)]


def work_ladder(scene: Scene, order: int) -> list[float]:
    """About ten steps t_end/n, n a multiple of 5: halving from 0.8 or 4, from order 6 on by about √2 from 3.2.

    That is from errors of 10⁻² or 10⁻³ on; high orders go not as far down, because finer steps meet round-off.
    """
    if order < 6:
        fine = steps(scene, 9)
        longer = "body" in scene.kind or scene.slows_after is not None
        return [fine[0] * 5, fine[0] * 2.5, *fine] if longer else fine
    coarse = steps(scene, 1)[0] * 4
    counts = [ENDS * max(1, round(scene.t_end / coarse / ENDS * 2 ** (k / 2))) for k in range(11)]
    return [scene.t_end / n for n in dict.fromkeys(counts)]


#: what is set of a fixed-step method on a scene that slows down: the mean of steps that grow
GROWING = "growing"


def control_of(scene: Scene, method: Method) -> str:
    """Return what a race sets of a method on a scene: "step", "growing", "rtol" or "exact"."""
    grows = method.control == "step" and method.one_step and scene.slows_after is not None
    return GROWING if grows else method.control


def setting_to(end: float, scene: Scene, control: str, value: float) -> dict[str, Any]:
    """Return the keywords of `prepare` for a run to an end; the mean of growing steps is that over the scene's span."""
    if control != GROWING:
        return keywords(control, value)
    a = scene.slows_after
    assert a is not None
    share = math.log1p(end / a) / math.log1p(scene.t_end / a)
    return {"step": geometric_steps(end, max(1, round(share * scene.t_end / value)), a)}


def tolerances(method: Any) -> list[float]:
    low, high = method.rtol_range
    rungs = [LOOSEST, *RTOLS, *(BETWEEN if method.order is None else [])]
    return [*sorted((rtol for rtol in rungs if low < rtol <= high), reverse=True), low]


def save_times(scene: Scene) -> np.ndarray:
    """The 25 times every ladder has in common, on the grid of the frozen references."""
    return scene.t_end * np.arange(1, SAVES + 1) / SAVES


def stepping(method: Any) -> str:
    return "exact" if method.exact else "adaptive" if method.adaptive else "fixed"


def fields(scene: Scene, method: Method, carry: tuple[str, ...]) -> list[str]:
    kept = (name for name, part in scene.initial(carry)._asdict().items() if part is not None)
    return [name for name in kept if not (name == "t" and method.own_time)]


def carry_of(scene: Scene) -> tuple[str, ...]:
    """The optional fields that a run needs where only the motion counts: R where J = R M is measured, s if it acts."""
    return scene.carry(("R",) if "R" in scene.optional and scene.conformal_rate is not None else ())
