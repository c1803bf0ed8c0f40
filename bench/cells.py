"""What the experiments share: which methods, which step sizes, what to save, what a row says."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from contactbench.methods import METHODS
from contactbench.scene import RigidBody, Scene
from contactbench.scenes import standard_scenes
from contactbench.solution import Counts, Solution, keywords, printed_setting

#: saved times per run: few enough to be step boundaries of every step size of the ladder
SAVES = 25
#: coarsest step; below it a ladder halves
COARSEST = 0.8
#: scenes of the experiments other than work–precision in the smoke profile
SMOKE = ("particle",)
RTOLS = [10.0**-k for k in range(3, 14)]


def cells(ladder: Any, group: Callable[[tuple], str] | None = None, visits: int = 1) -> Callable[..., Any]:
    """Attach to a test the function that lists its cells for a profile.

    group : names the cells that one process should run; by default those of one scene and method.
    visits : how often a run that is timed comes to a cell, at places of its own in the shuffled order.
    The tables a test writes are written by no other file: when all cells of a file are done, rows of its
    tables that none of them has made are removed.
    """

    def attach(test: Any) -> Any:
        test.cells, test.group, test.visits = ladder, group or (lambda cell: "-".join(cell[:2])), visits
        return test

    return attach


def scenes(profile: Any) -> list[str]:
    """The scenes of an experiment: all standard ones, or one in the smoke profile."""
    return list(SMOKE) if profile.points == 1 else [scene.name for scene in standard_scenes()]


def steps(scene: Scene, count: int) -> list[float]:
    """Halving steps t_end/(25·2^k), the coarsest not above 0.8."""
    n = SAVES
    while scene.t_end / n > COARSEST:
        n *= 2
    return [scene.t_end / (n * 2**k) for k in range(count)]


def work_ladder(scene: Scene, order: int) -> list[float]:
    """About ten steps t_end/n, n a multiple of 5, over the range that matters to a method of this order.

    Halving from 0.8, on a body from 4; from order 6 on by √2 from 3.2 at most: where errors are 10⁻² or
    10⁻³.  High orders go not as far down, because finer steps meet round-off.
    """
    if order < 6:
        fine = steps(scene, 9)
        return [fine[0] * 5, fine[0] * 2.5, *fine] if isinstance(scene, RigidBody) else fine
    coarse = steps(scene, 1)[0] * 4
    counts = [5 * max(1, round(scene.t_end / coarse / 5 * 2 ** (k / 2))) for k in range(11)]
    return [scene.t_end / n for n in dict.fromkeys(counts)]


def save_times(scene: Scene) -> np.ndarray:
    """The 25 times every ladder has in common, on the grid of the frozen references."""
    return scene.t_end * np.arange(1, SAVES + 1) / SAVES


def setting(method: Any, value: float) -> dict[str, float]:
    return keywords(method.control, value)


#: where an engine that is nobody's first choice is timed too
CROSS_CHECKED = "particle"


def engines(scene: Scene) -> list[tuple[str, str]]:
    """Every (method, engine) to be timed on a scene.

    A method's first engine, and what calls back into Python; others (fixed steps on jax, the cross-check of
    numba) on one scene only.
    """
    return [
        (name, engine)
        for name, method in METHODS.items()
        for engine in method.engines
        if engine == method.engines[0] or "python" in engine or scene.name == CROSS_CHECKED
    ]


#: right-hand sides an adaptive method spends per step, where its step budget limits the run
PER_STEP = {"scipy-dop853": 13, "scipy-radau": 9, "cvode-adams": 2, "cvode-bdf": 2, "contact-adaptive": 12}
#: an implicit step compiled by XLA takes about as long as two right-hand sides in Python
IMPLICIT = {"diffrax-kvaerno5": 2}


#: the profile's budget is meant for scenes up to this long; longer ones get more, but not without end
LONG, LONGEST = 800.0, 2000.0


def step_budget(profile: Any, scene: Scene, method: Any, engine: str) -> int | None:
    """Steps that keep one run below a second: a cell that would take longer ends as `budget`."""
    if method.refuses(scene):
        return None
    if "python" in engine:
        per_step = method.per_step(scene) if method.control == "step" else PER_STEP.get(method.name, 1)
    else:
        per_step = IMPLICIT.get(method.name)
    evaluations = round(profile.callback_evaluations * max(1.0, min(scene.t_end, LONGEST) / LONG))
    return evaluations // per_step if per_step else None


def family(method: Any) -> str:
    """What a method is compared as; a plug-in that does not say is an established one."""
    return getattr(method, "family", "established")


def controlled(control: str, value: float, variant: str = "") -> dict[str, Any]:
    """The columns that say what was set: control, value, variant, and all of them printed."""
    printed = printed_setting(control, value)
    return {
        "control": control, "value": value, "variant": variant, "setting": f"{variant} {printed}".strip(),
    }  # fmt: skip


def outcome(solution: Solution, counts: Counts | None = None, variant: str = "") -> dict[str, Any]:
    """The columns every row has: key, status, counts."""
    counts = counts or solution.counts
    return {
        "scene": solution.scene.name,
        "method": solution.method,
        "family": family(METHODS[solution.method]),
        "engine": solution.engine,
        **controlled(solution.control, solution.value, variant),
        "status": str(solution.status),
        "message": solution.message,
        "steps": counts.steps,
        "evaluations": counts.evaluations,
        "evaluation_kind": counts.kind,
        "rhs_equivalents": counts.rhs_equivalents,
        "jacobians": counts.jacobians,
    }
