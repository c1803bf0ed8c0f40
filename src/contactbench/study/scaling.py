"""How does cost grow with the size of the problem?  One cell: a method on so many degrees of freedom and cores.

A ring has the data of `PERIOD` sites again and again, and so their motion: truth, steps and errors are the same at any
length.  Every method has the setting that reaches the error on the short ring at the least cost.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numba
import numpy as np

import contactbench as cb
from contactbench.measure.clock import Call
from contactbench.measure.isolation import usable_cores
from contactbench.methods.prepared import Prepared
from contactbench.results.tables import SCALING
from contactbench.scene.many import Many
from contactbench.solution import keywords
from contactbench.study.c_loops import ring_kernel
from contactbench.study.choice import EVERYWHERE, key, left_to_full, methods_of, outcome
from contactbench.study.experiment import Cell, Profile, Recorded, Row, Timing, experiment, timed_experiment
from contactbench.study.search import Question, Search, step_at
from contactbench.study.settings import ENDS, times
from contactbench.study.timetable import last_cores
from contactbench.truth import Reference
from contactbench.truth.engines import NEVER
from contactbench.truth.reference import by_two_solvers

MAIN, RINGS, PERIOD, ERROR = "fput", ("fput", "linear_ring"), 16, 1e-6
#: lengths of rings, by the profile from which on they are run
SIZES = {"smoke": (PERIOD,), "standard": (1024, 10_000), "full": (128, 100_000, 1_000_000)}
#: the methods on other scenes than the main one; the one that is run by all of its engines
FEW: tuple[str, ...] = ("contact-strang", "contact-rkn6", "rk4", "scipy-dop853", "cvode-adams", "cyrk-dop853")
FEW += ("ias15", "whfast")
CROSS_CHECKED = "contact-rkn6"
#: sites from which on compiled sweeps are run by two cores too
SHARED = 100_000
#: the C loop, and whose steps it takes
LOOP, STEPS_OF = "limit-c", "contact-strang"
#: evaluations of a run at most, times sites, and evaluations that are always allowed
WORK, ALLOWED = 3e8, 1000


def ladder(profile: Profile) -> list[Cell]:
    """(scene, method, engine, degrees of freedom, cores)."""
    if profile.brief:
        return [(MAIN, method, cb.METHODS[method].engines[0], PERIOD, 1) for method in EVERYWHERE]
    sizes = [n for name, each in SIZES.items() if profile.reaches(name) for n in each]
    rows: list[Cell] = []
    for scene in (s for s in cb.SCENES.values() if "scaling" in s.experiments):
        main = scene.name == MAIN
        names = [
            name
            for name in (methods_of(profile) if main else FEW)
            if not left_to_full("scaling", scene, name, profile)
        ]
        methods = [
            m for m in map(cb.METHODS.__getitem__, names) if m.refuses(sized(scene.name, PERIOD)) is None
        ]
        for n in sizes if scene.name in RINGS else [scene.motion // 2]:
            for method in methods:
                engines = method.engines if main and method.name == CROSS_CHECKED else method.engines[:1]
                rows += [(scene.name, method.name, engine, n, 1) for engine in engines]
            shared = methods if main and n >= SHARED and len(usable_cores()) > 1 else []
            rows += [(scene.name, m.name, "numba", n, 2) for m in shared if m.engines[0] == "numba"]
            rows += [(scene.name, LOOP, "c", n, 1)] if main else []
    return rows


def sized(name: str, n: int) -> Many:
    """Return a scene with so many degrees of freedom: a ring of copies; another one is as it is."""
    scene: Many = cb.SCENES[name]
    if name not in RINGS:
        return scene
    short = scene.with_(n=PERIOD)
    return short.with_(n=n, **{field: np.tile(getattr(short, field), n // PERIOD) for field in "qp"})


@cache
def truth(name: str) -> Reference:
    """Return what errors of 10⁻⁶ are told by: where there is no closed form by two solvers, not to fifty digits."""
    short = sized(name, PERIOD)
    saved = times(short, ENDS)
    return by_two_solvers(short, saved, (), NEVER) if short.exact is None else cb.reference(short, saved, ())


@cache
def found(name: str, method: str) -> float:
    """Return the value of the cheapest setting that reaches the error on the short ring, or of the finest."""
    search = Search(Question(truth(name).scene, truth(name), (ERROR,), 60.0), method)
    for _ in search.turns():
        pass
    return (search.best(ERROR) or min((a for a in search.attempts if a.ok), key=lambda a: a.value)).value


def value(name: str, method: str, n: int) -> float:
    chosen = cb.METHODS[STEPS_OF if method == LOOP else method]
    reached, most = found(name, chosen.name), max(ALLOWED, WORK / n)
    return reached if chosen.adaptive else max(reached, step_at(chosen, sized(name, n), most))


# -- memory, where the system says it: on Linux -------------------------------------------------------
PROCESS = Path("/proc/self")


def peak_memory(run: Callable[[], object]) -> float:
    """Return by how many bytes the resident memory grows at most during a call; nan where the system does not say."""
    try:
        ctypes.CDLL(None).malloc_trim(0)  # what was given back before must not hide what is taken now
        (PROCESS / "clear_refs").write_text("5")  # the peak begins anew
    except (OSError, AttributeError):
        return math.nan
    before = resident("VmRSS")
    run()
    return float(resident("VmHWM") - before)


def resident(which: str) -> int:
    lines = (PROCESS / "status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(f"{which}:"))


# -- rows ------------------------------------------------------------------------------------------
def loop(scene: Many, chosen: float) -> tuple[Row, Callable[[], np.ndarray] | None]:
    """Return how the C loop ends and its run, None where there is no compiler."""
    assert isinstance(scene, cb.Lattice)
    made = ring_kernel(STEPS_OF, scene, chosen)
    if isinstance(made, str):
        return {"status": "unsupported", "message": made, "evaluations": None}, None
    run, evaluations = made
    counts = {"steps": round(scene.t_end / chosen), "evaluations": evaluations, "evaluation_kind": "gradient"}
    return {"status": "ok", "message": ""} | counts, run


def prepared(cell: Cell, chosen: float) -> Prepared:
    name, method, engine, n, cores = cell
    numba.set_num_threads(cores)  # it saw all of them if it was loaded before this process was bound to one
    scene, setting = sized(name, n), keywords(cb.METHODS[method].control, chosen)
    return cb.prepare(scene, method, save_at=[scene.t_end], carry=(), engine=engine, **setting)


def errors(cell: Cell) -> Row:
    """Return the row of a cell but for what is timed."""
    name, method, _, n, cores = cell
    chosen, scene = value(name, method, n), sized(name, n)
    if method == LOOP:
        row = key(name, LOOP, "c", "step", chosen, STEPS_OF) | {"n": n, "cores": cores}
        ended, run = loop(scene, chosen)
        row |= ended
        if run is None:
            return row
        row["memory_MB"], y = peak_memory(run) / 1e6, run()
    else:
        # this process may have one core; no result depends on how many there are
        most: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
        own = (*cell[:-1], min(cores, most))
        made = prepared(own, chosen)
        solution = made()
        row = outcome(solution) | {"n": n, "cores": cores, "compile_s": made.compile_s}
        if not solution.ok:
            return row
        y = solution.y[-1]
        peak = peak_memory(lambda: prepared(own, chosen)())
        row["memory_MB"] = max(peak - y.nbytes, 0.0) / 1e6
    exact = truth(name).y
    copies = 2 * n // exact.shape[1]
    true = np.tile(exact[-1].reshape(2, -1), copies).ravel()
    start = scene.pack(scene.initial(()))
    size = max(math.sqrt(copies) * np.linalg.norm(exact, axis=1).max(), np.linalg.norm(start))
    return row | {"solution_error": float(np.linalg.norm(y - true) / size)}


def call(cell: Cell, chosen: float) -> tuple[Row, Call]:
    name, method, _, n, _ = cell
    if method == LOOP:
        run = loop(sized(name, n), chosen)[1]
        assert run is not None  # else its row says so
        return {}, Call(run)
    made = prepared(cell, chosen)
    return {}, Call(partial(made.bare, made.start))


def shares(row: Row) -> Row:
    """Return the columns that follow from the time of a run."""
    time, evaluations = row["time_min_s"], row["n"] * (row["evaluations"] or 0)
    found = {"site_ns": 1e9 * time / evaluations} if evaluations else {}
    return found | ({"reach_s": time} if row["solution_error"] <= ERROR else {})


@experiment(ladder)
def scaling_errors(cell: Cell, profile: Profile) -> Recorded:
    yield SCALING, errors(cell)


@timed_experiment(ladder, scaling_errors)
def scaling(cell: Cell, profile: Profile, row: Row) -> Timing:
    return Timing(SCALING, call, (cell, row["value"]), last_cores(cell[-1]), shares)
