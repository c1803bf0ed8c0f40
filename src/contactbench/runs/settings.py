"""Choose the settings at which methods run, coarse to fine: halving steps, tolerances by decades."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from contactbench.methods.base import Method
from contactbench.methods.multistep import Multistep
from contactbench.methods.prescribed import geometric_steps
from contactbench.scene import Scene
from contactbench.solution import EXACT, GROWING, keywords

#: saved times per run: few enough to be step boundaries of every step size of the ladder
SAVES = 25
#: those of the `CURVE` saved times of a curve at which its error is measured
LOOKED_AT = slice(7, None, 20)
#: number of end times, each of a separate run, for the largest error
ENDS = 5
#: the coarsest step; ladders halve it, and divide it by about √2 from order HIGH_ORDER on
COARSEST, HIGH_ORDER = 0.8, 6
#: most evaluations of a run in a ladder
DEAREST = 2**18
#: runs along the motion: the coarsest rung takes t_end/PARTS per evaluation, the others BY_FOUR of it, and orders up
#: to LOW_ORDER have one more; the tolerances are ALONG and the finest that a method takes
PARTS, BY_FOUR, LOW_ORDER = 400, (1.0, 1 / 4, 1 / 16, 1 / 64), 2
ALONG = (1e-4, 1e-7, 1e-10)
#: tolerances of methods that choose their step by pilots
PILOTED = [10.0**-k for k in range(3, 13)]
RTOLS = [10.0**-k for k in range(3, 15)]
#: beside the tolerances of `RTOLS`: some methods are a thousand times more accurate than asked
LOOSEST = 1e-1
#: below 1e-13, and for methods that choose their order: from one decade to the next their cost doubles or falls
BETWEEN = [3e-14, 3e-15, 1e-15]


def halving_steps(scene: Scene, count: int) -> list[float]:
    """Return halving steps t_end/(25·2^k), the coarsest not above 0.8 or, of a slow stiff motion, its pace."""
    n = SAVES
    while scene.t_end / n > max((COARSEST, *slow_pace(scene))):
        n *= 2
    return [scene.t_end / (n * 2**k) for k in range(count)]


def slow_pace(scene: Scene) -> tuple[float, ...]:
    """Return the steps that suit a stiff scene and are longer than those of the others."""
    return tuple(step for step in scene.pace if scene.stiff and step > COARSEST)


def steps(scene: Scene, method: Method) -> list[float]:
    """Return about ten steps t_end/n, n a multiple of 5: halving from 0.8 or 4, from order 6 on by about √2 from 3.2.

    That is from errors of 10⁻² or 10⁻³ on; high orders need not go as far down, and go on by `finer_steps` where they
    do.  Steps of one evaluation are an eighth of theirs.
    """
    if (method.order or 1) < HIGH_ORDER:
        fine = halving_steps(scene, 9)
        longer = "body" in scene.kind or scene.slows_after is not None or slow_pace(scene)
        return [fine[0] * 5, fine[0] * 2.5, *fine] if longer else fine
    coarse = halving_steps(scene, 1)[0] * (0.5 if isinstance(method, Multistep) else 4)
    counts = [ENDS * max(1, round(scene.t_end / coarse / ENDS * 2 ** (k / 2))) for k in range(11)]
    return [scene.t_end / n for n in dict.fromkeys(counts)]


def finer_steps(scene: Scene, method: Method, dearest: float = DEAREST) -> list[float]:
    """Return steps that halve below those, as long as a run costs no more evaluations than that."""
    halved = [steps(scene, method)[-1]]
    while scene.t_end / halved[-1] * 2 * evaluations_of_step(scene, method) <= dearest:
        halved.append(halved[-1] / 2)
    return halved[1:]


def evaluations_of_step(scene: Scene, method: Method) -> float:
    """Return the cost of a fixed step in right-hand sides; two rotations count as one."""
    own: Any = method
    each: float = own.per_step(scene)
    return each / 2 if own.kind_on(scene) == "rotation" else each


def tolerances(method: Method) -> list[float]:
    low, high = method.rtol_range
    rungs = [LOOSEST, *RTOLS, *(BETWEEN if method.order is None else [])]
    return [*sorted((rtol for rtol in rungs if low < rtol <= high), reverse=True), low]


def ladder(scene: Scene, method: Method, control: str, dearest: float) -> tuple[list[float], list[float]]:
    """Return the settings at which a method may be run, coarse to fine, and those among them that are enough.

    dearest : evaluations of a run by steps at most.
    """
    if control == EXACT:
        return [0.0], [0.0]
    if control == "rtol":
        every = tolerances(method) if method.adaptive else PILOTED
        first = 1 if method.adaptive else 0  # the loosest is decades from the next
        return every, [*every[:first], *every[first::2]]
    if method.refuses(scene):  # a single run says why
        return [scene.t_end], [scene.t_end]
    coarse, finer = steps(scene, method), finer_steps(scene, method, dearest)
    enough = [*coarse[::2], *(finer if (method.order or 1) >= HIGH_ORDER else finer[1::2])]
    shortest = scene.t_end * evaluations_of_step(scene, method) / dearest
    every = [step for step in (*coarse, *finer) if step >= shortest] or coarse[:1]
    return every, [step for step in every if step in enough]


def rungs_of_equal_cost(scene: Scene, method: Method) -> list[float]:
    """Return the settings of the runs saved along the motion, coarse to fine.

    Steps are as many times longer as they have evaluations, so that a rung costs every method the same; low orders
    have one more.
    """
    if method.control == EXACT:
        return [0.0]
    if method.adaptive:
        finest = method.rtol_range[0]
        return [*(rtol for rtol in ALONG if rtol > finest), finest]
    paces = scene.pace or (scene.t_end / PARTS,)
    if len(paces) == 1:
        paces = tuple(paces[0] * part for part in BY_FOUR)
    if (method.order or 1) <= LOW_ORDER:
        paces = (*paces, paces[-1] / 4)
    longest = scene.t_end / SAVES  # no step straddles a saved time
    each = 1.0 if method.refuses(scene) else evaluations_of_step(scene, method)
    return list(dict.fromkeys(min(pace * each, longest) for pace in paces))


def control_of(scene: Scene, method: Method) -> str:
    """Return the kind of setting of a method on a scene: "step", "growing", "rtol" or "exact"."""
    grows = method.control == "step" and method.one_step and scene.slows_after is not None
    return GROWING if grows else method.control


def setting_to(end: float, scene: Scene, control: str, value: float) -> dict[str, Any]:
    """Return the keywords of `prepare` for a run to an end; growing steps have their mean over the scene's span."""
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
