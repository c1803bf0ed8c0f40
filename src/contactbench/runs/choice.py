"""What the experiments share: which methods, which step sizes, what to save, what a row says."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple
from zlib import crc32

from contactbench.methods import METHODS
from contactbench.methods.base import Method
from contactbench.plugins import OWN
from contactbench.runs.experiment import Profile, Row
from contactbench.scene import Scene
from contactbench.scenes import scenes_of
from contactbench.solution import Solution, setting_key

#: in the smoke profile what is soon compiled on one scene, and on every other one of our methods and one of theirs
SMOKE, EVERYWHERE = "particle", ("contact-strang", "rk4")


def pairs(profile: Profile, experiment: str, methods: Iterable[str]) -> list[tuple[str, str]]:
    """Return the scenes and methods of an experiment: all of them, in the smoke profile a few on scenes but one."""
    return [
        (scene.name, method)
        for scene in scenes_of(experiment)
        for method in contestants(experiment, scene, methods, profile)
        if not profile.brief or small(scene.name, method)
    ]


def small(scene: str, method: str, main: str = SMOKE, everywhere: Iterable[str] = EVERYWHERE) -> bool:
    """Return whether the smoke profile has a cell: a few methods on all scenes, on one what is soon compiled or new."""
    soon = METHODS[method].engines[0] not in DEAR or method not in OWN
    return method in everywhere or (scene == main and soon)


#: what XLA compiles and what calls back into Python takes seconds on every scene
DEAR = ("jax", "python")
#: the scenes on which callbacks and XLA are timed: CyRK has SciPy's tableaux compiled
TIMED_DEAR = ("oscillator", "particle", "rigid_body")
#: where some run nevertheless
DEAR_CELLS = {
    ("laws", "forced_oscillator", name) for name in ("scipy-dop853", "diffrax-tsit5", "diffrax-dopri8")
}
#: where stiffness asks for implicit solvers
STIFF = ("overdamped", "stiff_spring", "steep_wall", "large_step")
#: those of which a run takes seconds: elsewhere CyRK's and CVODE's, compiled, stand for them
IMPLICIT = ("scipy-radau", "diffrax-kvaerno5")
#: where laws of all methods are measured
VARIED = (*TIMED_DEAR, "central", "kepler", "forced_oscillator", "quadratic_damping")
#: others of a kind, by whose laws nothing is learnt on every scene: of pairs, multistep methods.
#: None of them is closest to the true energy on a scene where it is left out, which would be said of another then
ALIKE = ("cvode-bdf", "cyrk-lsoda", "cyrk-vern8", "rk8-7", "rkn8-6", "rkn12-10", "quinlan-tremaine12")


class Left(NamedTuple):
    """What only the full profile runs, so that the standard one takes minutes.

    experiments, methods : those concerned, all where there are none; but : not these.  scenes : on these; apart : or
    on all but these.
    """

    experiments: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    scenes: tuple[str, ...] = ()
    apart: tuple[str, ...] = ()
    but: tuple[str, ...] = ()

    def has(self, experiment: str, scene: str, method: str) -> bool:
        concerned = experiment in (self.experiments or [experiment]) and method in (self.methods or [method])
        concerned = concerned and method not in self.but
        return concerned and scene in (self.scenes or [scene]) and scene not in self.apart


LEFT = (
    Left(methods=IMPLICIT, apart=STIFF + TIMED_DEAR),
    Left(methods=("cvode-bdf", "cyrk-radau"), scenes=("particle_long", "kepler")),  # the longest, none stiff
    Left(("stability",), ("diffrax-tsit5", "diffrax-dopri8")),
    Left(("stability",), ("diffrax-kvaerno5",), apart=("overdamped", "stiff_spring")),
    Left(("stability",), ("scipy-dop853",), apart=STIFF),  # its tableau is compiled by CyRK and here
    Left(("convergence",), ("contact-gauss6",), apart=(*TIMED_DEAR, "central")),  # 50 digits by iteration
    Left(("laws",), ("diffrax-kvaerno5",), apart=("particle",)),  # seconds of compilation each
    Left(("laws",), ALIKE, apart=VARIED),
    Left(("laws", "convergence"), scenes=("duffing",), but=(*EVERYWHERE, "contact-rkn8", "rkn12")),
)
#: the tightest tolerance of `IMPLICIT` where laws are measured, but for the full profile
DEAREST = 1e-9


def left_to_full(experiment: str, scene: Scene, method: str, profile: Profile) -> bool:
    """Return whether an experiment runs a method on a scene in the full profile alone."""
    left = any(left.has(experiment, scene.name, method) for left in LEFT)
    return left and not profile.reaches("full") and scene.name in OWN and method in OWN


def affordable(rtols: list[float], method: str, profile: Profile) -> list[float]:
    """Return tolerances, of what is dear every second one, but for those that only the full profile gives a method."""
    dear = METHODS[method].engines[0] in DEAR and method in OWN
    if not dear or profile.reaches("full"):
        return rtols
    return [rtol for rtol in rtols[1::2] if rtol >= DEAREST or method not in IMPLICIT]


def contestants(experiment: str, scene: Scene, methods: Iterable[str], profile: Profile) -> list[str]:
    """Return which of some methods an experiment runs on a scene: what is dear on a few, and on those of users."""

    def runs(method: str) -> bool:
        dear = METHODS[method].engines[0] in DEAR and scene.name in OWN and method in OWN
        here = scene.name in TIMED_DEAR or (experiment, scene.name, method) in DEAR_CELLS
        left = left_to_full(experiment, scene, method, profile)
        return (here or not dear or profile.reaches("full")) and not left

    return list(filter(runs, methods))


#: of the other scenes a method is timed on one in so many by the smoke profile
SOME = 3


def is_rival(method: Method) -> bool:
    """Return whether a method of ours is timed on callbacks on one scene alone: elsewhere compiled."""
    ours = method.name in OWN and not method.package and method.name not in EVERYWHERE
    return ours and (method.iterates or method.family == "established")


def engines(scene: Scene, profile: Profile) -> list[tuple[str, str]]:
    """Return every (method, engine) to be timed on a scene.

    A method's first engine, and on some scenes what calls back into Python.  Elsewhere the first engine, unless it is
    dear.  The smoke profile has everything on one scene, and elsewhere a part without JAX.  What a user brings no
    profile leaves out.
    """

    def chosen(name: str, engine: str) -> bool:
        first, here = engine == METHODS[name].engines[0], scene.name == SMOKE
        if not first and METHODS[name].lacks(engine):
            return False
        if left_to_full("work_precision", scene, name, profile):
            return False
        brought = scene.name not in OWN or name not in OWN
        if scene.name not in TIMED_DEAR and not brought and (not first or engine in DEAR):
            return False
        if is_rival(METHODS[name]) and not (first or here):
            return False
        if not profile.brief or here or brought:
            return True
        part = name in EVERYWHERE or crc32(f"{scene.name} {name}".encode()) % SOME == 0
        return part and engine != "jax"

    every = [(name, engine) for name, method in METHODS.items() for engine in method.engines]
    return [each for each in every if chosen(*each)]


#: the profile's budget is meant for scenes up to this long; longer ones get more, but not without end
LONG, LONGEST = 800.0, 2000.0


def step_budget(profile: Profile, scene: Scene, method: Method, engine: str) -> int | None:
    """Return the steps that keep one run below a second: a cell that would take longer ends as `budget`."""
    if method.refuses(scene):
        return None
    evaluations = round(profile.callback_evaluations * max(1.0, min(scene.t_end, LONGEST) / LONG))
    each = method.step_cost(scene, engine)
    return None if each is None else int(evaluations // each)


def controlled(control: str, value: float, variant: str = "") -> Row:
    setting = f"{variant} {setting_key(control, value)}".strip()
    return {"control": control, "value": value, "variant": variant, "setting": setting}


def key(scene: str, method: str, engine: str, control: str, value: float, variant: str = "") -> Row:
    own = {"scene": scene, "method": method, "family": METHODS[method].family, "engine": engine}
    return own | controlled(control, value, variant)


def outcome(solution: Solution, variant: str = "") -> Row:
    counts, method = solution.counts, METHODS[solution.method]
    row = key(solution.scene.name, method.name, solution.engine, solution.control, solution.value, variant)
    row |= {"status": str(solution.status), "message": solution.message, "evaluation_kind": counts.kind}
    row |= {name: getattr(counts, name) for name in ("steps", "evaluations", "rhs_equivalents", "jacobians")}
    return row | {"rejected": counts.rejected if method.adaptive else None}
