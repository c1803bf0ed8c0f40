"""Where do integrators break, and how?  One cell: a method on a hard scene, or a question of stability.

Solvers run in worker processes, each call with a budget of steps, counted from evaluations, so that no row depends on
how fast the machine is: a crash, a hang or a result that is no number is a row and stops nothing.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from time import perf_counter
from typing import cast

import numpy as np

import contactbench as cb
from contactbench.blame import UserError
from contactbench.measure import stability as linear
from contactbench.measure.clock import Call, least
from contactbench.measure.isolation import Died, TimedOut, Worker
from contactbench.measure.law import MEANINGFUL
from contactbench.measure.laws import row as laws_row
from contactbench.methods.base import Method
from contactbench.methods.fixed_step import FixedStep
from contactbench.runs.choice import controlled, key, left_to_full, outcome, small, step_budget
from contactbench.runs.experiment import Cell, Profile, Recorded, Row, experiment
from contactbench.runs.search import right_hand_sides, step_at, tolerance_at
from contactbench.runs.settings import SAVES, times
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.scene.scales import sizes_of
from contactbench.scenes import scenes_of
from contactbench.solution import EXACT, Solution, keywords
from contactbench.tables.declared import DAMPING_RATES, STABILITY, STABILITY_LIMITS, STRONG_DAMPING
from contactbench.truth import blow_up_time, condition_number

#: seconds after which a call hangs; the dearest, over 10⁵ units of time, takes about twenty
LIMIT = 900.0
#: time per evaluation at the coarsest setting.  A step is as many times longer as it has evaluations, so that
#: one rung costs every fixed-step method the same.
COARSEST = {
    "overdamped": 0.5,
    **dict.fromkeys(("antidamping", "singular_damping_2"), 0.2),
    **dict.fromkeys(("weak_damping", "tumbling"), 0.25),
    "saddle_edge": 0.1,
    "kepler_drag": 0.008,
} | {"stiff_spring": 0.0025, "needle": 0.0125, "escape": 0.0004, "large_step": 2.1}
#: rungs where a factor of four would miss the point: γh = 25, 5, 1; both sides of the stability limit
RUNGS = {"overdamped": (1.0, 0.2, 0.04, 0.01), "large_step": (1.0, 2 / 3, 0.25, 1 / 16)}
#: elsewhere, by four: the finest reaches the errors of tight tolerances, with one rung more for low orders
BY_FOUR, LOW_ORDER = (1.0, 1 / 4, 1 / 16, 1 / 64), 2
#: and each method's own finest tolerance
TOLERANCES = (1e-4, 1e-7, 1e-10)
#: of the smoke profile: what is soon compiled on the scene where nothing ends ok, which compiles no derivative,
#: and two methods on every scene
SMOKE, EVERYWHERE = "escape", ("contact-strang", "heyoka-taylor")
CREEP_RTOLS = (1e-3, 1e-6, 1e-9)
DAMPING_PER_STEP = (1.0, 5.0, 25.0)
SPANS = (1e4, 1e5)


def settings(scene: Scene, method: Method) -> list[tuple[str, float]]:
    if method.control == EXACT:
        return [(EXACT, 0.0)]
    if method.adaptive:
        finest = method.rtol_range[0]
        return [("rtol", rtol) for rtol in (*(r for r in TOLERANCES if r > finest), finest)]
    if method.refuses(scene):
        return [("step", COARSEST.get(scene.name, scene.t_end / 100))]
    method = cast(FixedStep, method)  # or a library's, which says the same
    each = method.per_step(scene) / (2 if method.kind_on(scene) == "rotation" else 1)
    rungs: tuple[float, ...] = RUNGS.get(scene.name, BY_FOUR)
    if method.order <= LOW_ORDER:
        rungs = (*rungs, rungs[-1] / 4)
    longest = scene.t_end / SAVES  # no step straddles a saved time
    steps = (min(COARSEST.get(scene.name, scene.t_end / 400) * part * each, longest) for part in rungs)
    return [("step", step) for step in dict.fromkeys(steps)]


def ladder(profile: Profile) -> list[Cell]:
    return [
        (scene.name, method)
        for scene in scenes_of("stability")
        for method in contestants(profile, scene)
        if not profile.brief or small(scene.name, method, SMOKE, EVERYWHERE)
    ]


def contestants(profile: Profile, scene: Scene) -> list[str]:
    return [name for name in cb.METHODS if not left_to_full("stability", scene, name, profile)]


def questions(profile: Profile) -> list[Cell]:
    if profile.brief:
        return [(which, EVERYWHERE[0]) for which in ("overdamped", f"weak_damping {SPANS[0]:.0e}")]
    every = ["overdamped", *(f"weak_damping {span:.0e}" for span in SPANS)]
    return [
        (which, method)
        for which in every
        for method in contestants(profile, cb.SCENES[which.partition(" ")[0]])
    ]


#: the row of a call that ends badly, and the call
type Asked = tuple[Row, Callable[..., Row], tuple[object, ...]]


def calls(cell: Cell, profile: Profile) -> Iterator[Asked]:
    scene, method = cb.SCENES[cell[0]], cb.METHODS[cell[1]]
    engine, budget = method.engines[0], budget_of(profile, scene, method)
    for kind, value in settings(scene, method):
        row = key(scene.name, method.name, engine, kind, value) | {"status": "failed"}
        yield row, stability_row, (scene.name, method.name, engine, kind, value, budget)


def rate_calls(cell: Cell, profile: Profile) -> Iterator[Asked]:
    name, _, span = cell[0].partition(" ")
    scene, method = cb.SCENES[name], cb.METHODS[cell[1]]
    row = {"method": method.name, "engine": method.engines[0], "status": "failed", "scene": name}
    if span:
        row |= {"experiment": "weak", "setting": "", "t_end": float(span)}
        yield row, weak_row, (name, method.name, float(span))
        return
    row |= {"experiment": "overdamped", "t_end": scene.t_end}
    steps = [damping / scene.gamma for damping in DAMPING_PER_STEP]
    budget = budget_of(profile, scene, method)
    for value in {"step": steps, "rtol": CREEP_RTOLS, EXACT: [0.0]}[method.control]:
        setting = method.control, value
        yield row | controlled(*setting), overdamped_row, (method.name, *setting, budget)


def budget_of(profile: Profile, scene: Scene, method: Method) -> int | None:
    """Return three times the evaluations of a timed run: these are hard."""
    steps = step_budget(profile, scene, method, method.engines[0])
    if steps is None:
        return None if method.control == "step" else 1_000_000
    return 3 * steps


# -- in a worker: one row of a table a call --------------------------------------------------------
# What a row says follows from what is counted; the clock is read for `time_s` alone.
class SolverError(Exception):
    """A solver raised; whatever else raises in here is a fault of the experiment."""


@contextlib.contextmanager
def blamed_on_solver() -> Iterator[None]:
    try:
        yield
    except UserError as error:  # a plug-in's solver
        raise SolverError(str(error)) from error
    except cb.BadInput:  # a question nobody should have asked
        raise
    except Exception as error:
        raise SolverError(f"{type(error).__name__}: {error}") from error


def solve(scene: Scene, method: str, **options: object) -> Solution:
    with blamed_on_solver():
        return cb.solve(scene, method, **options)


#: seconds: to a call longer than this what only the first call does adds nothing
LONG = 0.3


def stability_row(name: str, method: str, engine: str, kind: str, value: float, max_steps: int | None) -> Row:
    scene = cb.SCENES[name]
    with blamed_on_solver():
        given: Row = {"engine": engine, "save_at": Elapsed(times(scene)), **keywords(kind, value)}
        run = cb.prepare(scene, method, max_steps=max_steps, **given)
        start = perf_counter()
        solution = run()
        first = perf_counter() - start
    found = blow_up_time(scene) if solution.status is not cb.Status.unsupported else None
    row = outcome(solution) | {"saved_times": len(solution.t), "end_time": solution.end_time}
    row |= {"blow_up_time": float(found[0]) if found else math.nan}
    row |= {"condition_number": condition_number(scene) or math.nan}
    if not solution.ok:
        return row
    with blamed_on_solver():  # the first call imports and allocates
        row["time_s"] = first if first > LONG else least([Call(run).visit()])
    row["end_error"] = end_error(solution)
    by_runs = cb.METHODS[method].adaptive and cb.METHODS[method].family != "contact"
    without = "on the standard scenes only" if by_runs else ""
    return row | laws_row(solution, without)


def end_error(solution: Solution) -> float:
    """Return the error of (q, p) or M at the end in parts of what is left, each in its unit; 0 where both underflow."""
    scene, carry = solution.scene, solution.carry
    truth = cb.reference(scene, Elapsed(solution.elapsed), carry).y
    sizes = sizes_of(scene, np.vstack([solution.y0, truth]), carry)[: len(scene.vectors)]
    units = np.repeat(sizes, scene.vectors)
    found, left = (scene.without_clock(y[-1])[: scene.motion] / units for y in (solution.y, truth))
    return float(np.linalg.norm(found - left) / max(np.linalg.norm(left), MEANINGFUL))


# -- overdamped ------------------------------------------------------------------------------------
def overdamped_row(method: str, kind: str, value: float, max_steps: int | None) -> Row:
    """Return the rate of creep between t_end/2 and t_end over the true slow rate."""
    scene = cb.SCENES["overdamped"]
    ends = [scene.t_end / 2, scene.t_end]
    solution = solve(
        scene, method, save_at=Elapsed(ends), carry=(), max_steps=max_steps, **keywords(kind, value)
    )
    row = rate_row("overdamped", solution, scene.t_end, linear.slow_rate(scene.gamma))
    row["damping_per_step"] = scene.gamma * value if kind == "step" else math.nan
    if solution.ok:
        with np.errstate(divide="ignore"):
            size = np.log(np.abs(solution.y[:, 0]))
        row |= beside((size[0] - size[1]) / (ends[1] - ends[0]), row["true_rate"])
        truth = cb.reference(scene, ends, ()).y
        row["q_error"], row["p_error"] = np.abs(solution.y[-1] / truth[-1] - 1).tolist()
    return row


def rate_row(experiment: str, solution: Solution, t_end: float, true_rate: float) -> Row:
    keep = {name: value for name, value in outcome(solution).items() if name in DAMPING_RATES.columns}
    return keep | {"experiment": experiment, "t_end": t_end, "true_rate": true_rate}


def beside(rate: float, true_rate: float) -> Row:
    return {"rate": rate, "ratio": rate / true_rate, "rate_error": abs(rate / true_rate - 1)}


# -- weak damping ----------------------------------------------------------------------------------
#: evaluations per unit of time, for every method alike; adaptive ones are matched over a shorter span
COST, PILOT = 8.0, 200.0
#: times at which H0 is looked at, of a method and of the truth alike.  They are close enough together for
#: the oscillation of H0 not to be mistaken for a slow one
SAMPLES = 1000


def energy_rate(t: np.ndarray, energy: np.ndarray) -> float:
    """Return the mean rate at which log H0 falls: its slope by least squares, weighted by a bump over the span.

    The weight is flat at both ends with all its derivatives, so that oscillations of H0 hardly count (Das, Saiki,
    Sander, Yorke, Nonlinearity 30, 4111 (2017), doi:10.1088/1361-6544/aa84c2).
    """
    n = len(t)
    u = np.arange(1, n + 1) / (n + 1)
    weight = np.exp(-1 / (u * (1 - u)))
    lever = weight * (t - np.average(t, weights=weight))
    return float(-(lever @ np.log(energy)) / (lever @ t))


def weak_row(name: str, method: str, t_end: float) -> Row:
    """Return the damping rate over t_end, every method at about COST evaluations per unit of time."""
    scene = cb.SCENES[name].with_(t_end=t_end)
    chosen = cb.METHODS[method]
    if chosen.refuses(scene) is not None:
        value = chosen.rtol_range[1] if chosen.adaptive else 1 / COST
        setting = keywords(chosen.control, value)
        return rate_row("weak", solve(scene, method, **setting), t_end, math.nan)
    times = t_end * np.arange(1, SAMPLES + 1) / SAMPLES

    def pilot_cost(rtol: float) -> float:
        return right_hand_sides(solve(scene, method, rtol=rtol, save_at=Elapsed([PILOT]), carry=()))

    if chosen.adaptive:
        value = tolerance_at(pilot_cost, COST * PILOT, chosen.rtol_range)
    else:
        value = step_at(chosen, scene, COST * t_end, SAMPLES)
    setting = keywords(chosen.control, value)
    solution = solve(scene, method, save_at=Elapsed(times), carry=(), **setting)
    row = rate_row("weak", solution, t_end, math.nan)
    if not solution.ok:
        return row
    if "python" not in solution.engine:  # the cost without what it takes to save
        row["evaluations"] = solve(
            scene, method, save_at=Elapsed(times[-1:]), carry=(), **setting
        ).counts.evaluations
    row["true_rate"] = energy_rate(times, scene.energy(scene.unpack(cb.reference(scene, times, ()).y.T, ())))
    return row | beside(energy_rate(times, scene.energy(solution.states())), row["true_rate"])


# -- workers ---------------------------------------------------------------------------------------
@cache
def worker() -> Worker:
    """Return the process that all cells of this one share."""
    return Worker()


def rows_of(calls: Iterable[Asked], worker: Worker) -> list[Row]:
    """Return the row of each call, coarse to fine; how it ended where there is none.

    Where a tolerance spent the budget a tighter one would spend it too, and is not run.
    """
    rows: list[Row] = []
    spent = ""
    for row, function, arguments in calls:
        if spent:
            rows.append(row | {"status": "budget", "message": f"not run: {spent} spent the budget"})
            continue
        try:
            rows.append(worker.call(LIMIT, function, *arguments))
        except TimedOut as error:
            rows.append(row | {"status": "timeout", "message": str(error)})
        except (Died, SolverError) as error:  # anything else is a fault of ours, and fails the cell
            rows.append(row | {"message": " ".join(str(error).split())[:200]})
        if rows[-1]["status"] == "budget" and row["setting"].startswith("rtol="):
            spent = row["setting"]
    return rows


@experiment(ladder)
def stability(cell: Cell, profile: Profile) -> Recorded:
    yield from ((STABILITY, row) for row in rows_of(calls(cell, profile), worker()))


@experiment(questions)
def rates(cell: Cell, profile: Profile) -> Recorded:
    yield from ((DAMPING_RATES, row) for row in rows_of(rate_calls(cell, profile), worker()))


# -- linear stability ------------------------------------------------------------------------------
GAMMAS, OMEGAS = (0.0, 0.1, 0.3, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0), (0.5, 1.0, 2.0, 10.0)
STRONG = (0.1, 1.0, 10.0, 50.0)
PER_EVALUATION = np.geomspace(1e-3, 30.0, 30)


def methods(profile: Profile) -> list[Cell]:
    names = [method.name for method in linear.fixed_step_methods()]
    some = {names[0], *(name for name in names if linear.is_processed(cb.METHODS[name]))}
    return [(name,) for name in names if not profile.brief or name in some]


@experiment(methods)
def linear_stability(cell: Cell, profile: Profile) -> Recorded:
    method = cb.METHODS[cell[0]]
    yield from ((STABILITY_LIMITS, limits(method, gamma, omega)) for gamma in GAMMAS for omega in OMEGAS)
    yield from ((STRONG_DAMPING, row) for gamma in STRONG for row in errors(method, gamma))


def limits(method: FixedStep, gamma: float, omega: float) -> Row:
    theory, both = linear.THEORY.get(method.name), linear.is_processed(method)
    found = linear.stability(linear.kernel(method), gamma, omega)
    row = {"method": method.name, "gamma": gamma, "omega": omega, "limit": found.limit, "last": found.last}
    row |= {"windows": "; ".join(f"{start:.7g}…{end:.7g}" for start, end in found.windows)}
    row |= {"theory": theory(gamma, omega) if theory else np.nan}
    row |= {"per_evaluation": found.limit / method.per_step(cb.SCENES["oscillator"])}
    saved = linear.stability(method, gamma, omega).limit if both else np.nan
    return row | {"limit_kernel": found.limit if both else np.nan, "limit_saved": saved}


def errors(method: FixedStep, gamma: float) -> Iterator[Row]:
    each = method.per_step(cb.SCENES["oscillator"])
    for between in PER_EVALUATION:
        h = between / gamma * each
        row = {"method": method.name, "gamma": gamma, "damping_per_evaluation": between, "step": h}
        yield row | {"error": linear.propagation_error(method, gamma, h)}
