"""The settings a method is tried at, coarse to fine: steps that halve, tolerances by decades."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from contactbench.methods.base import Method
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.multistep import Multistep
from contactbench.methods.prescribed import geometric_steps
from contactbench.scene import Scene
from contactbench.solution import GROWING, keywords

#: saved times per run: few enough to be step boundaries of every step size of the ladder
SAVES = 25
#: end times over whose runs the largest error is taken
ENDS = 5
#: coarsest step; below it a ladder halves
COARSEST = 0.8
#: evaluations that a run of a ladder may cost below its last step
DEAREST = 2**18
RTOLS = [10.0**-k for k in range(3, 15)]
#: beside the tolerances of `RTOLS`: some methods are a thousand times more accurate than asked
LOOSEST = 1e-1
#: below 1e-13, and for methods that choose their order: from one decade to the next their cost doubles or falls
BETWEEN = [3e-14, 3e-15, 1e-15]


def halving_steps(scene: Scene, count: int) -> list[float]:
    """Return halving steps t_end/(25·2^k), the coarsest not above 0.8."""
    n = SAVES
    while scene.t_end / n > COARSEST:
        n *= 2
    return [scene.t_end / (n * 2**k) for k in range(count)]


def steps(scene: Scene, method: Method) -> list[float]:
    """Return about ten steps t_end/n, n a multiple of 5: halving from 0.8 or 4, from order 6 on by about √2 from 3.2.

    That is from errors of 10⁻² or 10⁻³ on; high orders need not go as far down, and go on by `finer_steps` where they
    do.  Steps of one evaluation are an eighth of theirs.
    """
    if (method.order or 1) < 6:
        fine = halving_steps(scene, 9)
        longer = "body" in scene.kind or scene.slows_after is not None
        return [fine[0] * 5, fine[0] * 2.5, *fine] if longer else fine
    coarse = halving_steps(scene, 1)[0] * (0.5 if isinstance(method, Multistep) else 4)
    counts = [ENDS * max(1, round(scene.t_end / coarse / ENDS * 2 ** (k / 2))) for k in range(11)]
    return [scene.t_end / n for n in dict.fromkeys(counts)]


def finer_steps(scene: Scene, method: Method) -> list[float]:
    """Return steps that halve below those, as long as a run costs no more than `DEAREST` evaluations."""
    each = method.per_step(scene) if isinstance(method, FixedStep) else 1
    halved = [steps(scene, method)[-1]]
    while scene.t_end / halved[-1] * 2 * each <= DEAREST:
        halved.append(halved[-1] / 2)
    return halved[1:]


def tolerances(method: Method) -> list[float]:
    low, high = method.rtol_range
    rungs = [LOOSEST, *RTOLS, *(BETWEEN if method.order is None else [])]
    return [*sorted((rtol for rtol in rungs if low < rtol <= high), reverse=True), low]


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


def times(scene: Scene, count: int = SAVES) -> np.ndarray:
    """Return equidistant times up to the end; the 25 are on the grid of the frozen references."""
    return scene.t_end * np.arange(1, count + 1) / count


def carry_of(scene: Scene) -> tuple[str, ...]:
    """Return the optional fields that are part of the motion: R unless a body's user says no, and s if it acts."""
    return scene.carry(("R",) if "R" in scene.optional and scene.attitude else ())
