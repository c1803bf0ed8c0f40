"""What the experiments share: which methods, which step sizes, what to save, what a row says."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any
from zlib import crc32

from contactbench.methods import METHODS
from contactbench.methods.prepared import IMPLICIT
from contactbench.plugins import OWN
from contactbench.scene import Scene
from contactbench.scenes import scenes_of
from contactbench.solution import Counts, Solution, Status, setting_key

type Row = dict[str, Any]
#: in the smoke profile what is soon compiled on one scene, and on every other one of our methods and one of theirs
SMOKE, EVERYWHERE = "particle", ("contact-strang", "rk4")


def cells(ladder: Any, times: Any = None) -> Callable[..., Any]:
    """Attach to a test the function that lists its cells for a profile.

    times : the untimed test of the same cells to whose rows this one adds times; a run without a clock leaves this one
    out.  The tables a test writes are written by no other file: when all cells of a file are done, other rows go.
    """

    def attach(test: Any) -> Any:
        test.cells, test.times = ladder, times
        return test

    return attach


def pairs(profile: Any, experiment: str, methods: Iterable[str]) -> list[tuple[str, str]]:
    """The scenes and methods of an experiment: all of them, in the smoke profile a few on scenes but one."""
    return [
        (scene.name, method)
        for scene in scenes_of(experiment)
        for method in contestants(experiment, scene, methods)
        if profile.points > 1 or small(scene.name, method)
    ]


def small(scene: str, method: str, main: str = SMOKE, everywhere: Iterable[str] = EVERYWHERE) -> bool:
    """Whether the smoke profile has a cell: a few methods on all scenes, on a main one what is soon compiled or new."""
    soon = METHODS[method].engines[0] not in DEAR or method not in OWN
    return method in everywhere or (scene == main and soon)


#: what XLA compiles and what calls back into Python takes seconds on every scene
DEAR = ("jax", "python")
#: where it runs nevertheless, of the scenes that not every experiment runs
FORCED = ("scipy-dop853", "diffrax-tsit5", "diffrax-dopri8")
DEAR_CELLS = {("laws", "forced_oscillator", name) for name in FORCED}


def contestants(experiment: str, scene: Scene, methods: Iterable[str]) -> list[str]:
    """Which of some methods an experiment runs on a scene: all of them where every experiment runs it."""

    def runs(method: str) -> bool:
        dear = bool(scene.experiments) and METHODS[method].engines[0] in DEAR
        return not dear or (experiment, scene.name, method) in DEAR_CELLS

    return list(filter(runs, methods))


#: on callbacks a rival is timed on that scene alone: elsewhere compiled, and by its evaluations
RIVALS = ("contact-yoshida6", "contact-rkn6a", "contact-rkn8b", "gauss4", "gauss6", "discrete-gradient")
RIVALS += ("quinlan-tremaine8", "quinlan-tremaine12", "stormer12")
#: of the other scenes a method is timed on one in so many by the smoke profile
SOME = 3


def engines(scene: Scene, profile: Any) -> list[tuple[str, str]]:
    """Every (method, engine) to be timed on a scene.

    A method's first engine, and what calls back into Python; others (the cross-checks) on one scene only.  Of a scene
    that not every experiment runs, the first engine, unless it is dear.  The smoke profile has everything on that one
    scene but few of the cross-checks, and elsewhere a part without JAX.  What a user brings no profile leaves out.
    """

    def chosen(name: str, engine: str) -> bool:
        first, here = engine == METHODS[name].engines[0], scene.name == SMOKE
        if scene.experiments and (not first or engine in DEAR):
            return False
        if name in RIVALS and not (first or here):
            return False
        brought = scene.name not in OWN or name not in OWN
        if profile.points > 1 or here or brought:
            cross_checked = here and (profile.points > 1 or brought or engine != "jax" or name in EVERYWHERE)
            return first or "python" in engine or cross_checked
        part = name in EVERYWHERE or crc32(f"{scene.name} {name}".encode()) % SOME == 0
        return part and engine != "jax" and (first or "python" in engine)

    every = [(name, engine) for name, method in METHODS.items() for engine in method.engines]
    return [each for each in every if chosen(*each)]


#: the profile's budget is meant for scenes up to this long; longer ones get more, but not without end
LONG, LONGEST = 800.0, 2000.0


def step_budget(profile: Any, scene: Scene, method: Any, engine: str) -> int | None:
    """Steps that keep one run below a second: a cell that would take longer ends as `budget`."""
    if method.refuses(scene):
        return None
    evaluations = round(profile.callback_evaluations * max(1.0, min(scene.t_end, LONGEST) / LONG))
    each = method.step_cost(scene, engine)
    return None if each is None else evaluations // each


def controlled(control: str, value: float, variant: str = "") -> Row:
    setting = f"{variant} {setting_key(control, value)}".strip()
    return {"control": control, "value": value, "variant": variant, "setting": setting}


def key(scene: str, method: str, engine: str, control: str, value: float, variant: str = "") -> Row:
    family = METHODS[method].family if method in METHODS else "limit"
    own = {"scene": scene, "method": method, "family": family, "engine": engine}
    return own | controlled(control, value, variant)


def outcome(solution: Solution, counts: Counts | None = None, variant: str = "") -> Row:
    counts, method = counts or solution.counts, METHODS[solution.method]
    row = key(solution.scene.name, method.name, solution.engine, solution.control, solution.value, variant)
    row |= {"status": str(solution.status), "message": solution.message, "evaluation_kind": counts.kind}
    row |= {name: getattr(counts, name) for name in ("steps", "evaluations", "rhs_equivalents", "jacobians")}
    return row | {"rejected": counts.rejected if method.adaptive else None}


# -- settings at which methods cost the same -------------------------------------------------------
#: a tolerance is taken whose cost is this near to the one asked for, or the nearest met
NEAR = 0.02
#: tolerances have this many significant digits, and are told apart by this much in log10(rtol)
DIGITS, RESOLUTION = 3, 2e-3


def right_hand_sides(solution) -> float:
    """What `tolerance_at` bisects: right-hand sides of a run, 0 for a bad end, inf for a spent budget."""
    if solution.ok:
        known = solution.counts.rhs_equivalents
        return IMPLICIT * solution.counts.steps if known is None else known
    return math.inf if solution.status is Status.budget else 0.0


def tolerance_at(cost: Callable[[float], float], target: float, rtol_range: tuple[float, float]) -> float:
    """The tolerance at which a run costs `target`, by bisection in log(rtol).

    cost : evaluations at a tolerance; 0 for a run that came to a bad end, inf for one that spent its budget.
    Of the tolerances looked at, the one whose cost is nearest, as a ratio, the tightest of equals.  A method that costs
    more at its loosest tolerance gets the tightest that costs hardly more than that: the loosest buys nothing.
    """
    low, high = (math.log10(rtol) for rtol in rtol_range)
    costs: dict[float, float] = {}

    def looked_at(exponent: float) -> float:
        rtol = min(max(float(f"{10**exponent:.{DIGITS - 1}e}"), rtol_range[0]), rtol_range[1])
        costs[rtol] = cost(rtol)
        return costs[rtol]

    target = max(target, (1 + 2 * NEAR) * looked_at(high))
    while high - low > RESOLUTION:
        middle = (low + high) / 2
        found = looked_at(middle)
        if abs(found / target - 1) < NEAR:
            break
        low, high = (low, middle) if found < target else (middle, high)
    if not any(found >= target for found in costs.values()):  # the tightest costs less, or was not tried
        looked_at(math.log10(rtol_range[0]))
    off = {rtol: abs(math.log(found / target)) for rtol, found in costs.items() if 0 < found < math.inf}
    return min(off or costs, key=lambda rtol: (off.get(rtol, math.inf), rtol))


def step_at(method, scene, target: float, part: int = 1) -> float:
    """The step, t_end over a multiple of `part`, at which a run to the end costs nearest to `target`.

    target : evaluations on the scale of one right-hand side.
    """
    scale = 0.5 if method.kind_on(scene) == "rotation" else 1.0
    each = scale * method.per_step(scene)
    once = scale * method.counts(scene, 1) - each  # what a run costs beside its steps: a processor
    n = max(1, round((target - once) / each / part)) * part
    return scene.t_end / n
