"""Where do integrators break, and how?  One cell: a method on a hard scene, or a question of stability.

Solvers run in worker processes, each call with a budget of steps, counted from evaluations: a crash, a hang
or a result that is no number is a row and stops nothing.  The budget ends a run within seconds; the limit
on time is many times longer and there for a solver that hangs, so that no row depends on how fast or how
busy the machine is.
"""

from __future__ import annotations

import numpy as np
import pytest

import contactbench as cb
from cells import cells, controlled, small, step_budget
from contactbench.measure.isolation import Died, TimedOut, Worker
from contactbench.measure.ladder import SAVES
from contactbench.measure.stability import (
    THEORY,
    fixed_step_methods,
    is_processed,
    kernel,
    propagation_error,
    spectral_radius,
    stability,
    true_radius,
)
from contactbench.results.tables import DAMPING_RATES, ONE_STEP, STABILITY, STABILITY_LIMITS, STRONG_DAMPING
from contactbench.scenes import scenes_of
from contactbench.solution import EXACT
from stability_rows import SolverError, overdamped_row, stability_row, weak_row

#: seconds after which a call hangs; the dearest, over 10⁵ units of time, takes about twenty
LIMIT = 900.0
#: time per evaluation at the coarsest setting.  A step is as many times longer as it has evaluations, so that
#: one rung costs every fixed-step method the same.
COARSEST = {
    "overdamped": 0.5,
    **dict.fromkeys(("critical", "antidamping"), 0.2),
    **{f"singular_damping_{k}": 0.2 for k in (1, 2, 3)},
    **dict.fromkeys(("weak_damping", "weak_damping_particle", "tumbling"), 0.25),
    **dict.fromkeys(("saddle_edge", "underflow"), 0.1),
} | {"stiff_spring": 0.0025, "needle": 0.0125, "escape": 0.0004, "kepler_drag": 0.008, "large_step": 2.1}
#: rungs where a factor of four would miss the point: γh = 25, 5, 1; both sides of the stability limit
RUNGS = {"overdamped": (1.0, 0.2, 0.04, 0.01), "large_step": (1.0, 2 / 3, 0.25, 1 / 16)}
#: elsewhere, by four: the finest reaches the errors of tight tolerances, with one rung more for low orders
BY_FOUR, LOW_ORDER = (1.0, 1 / 4, 1 / 16, 1 / 64), 2
#: and each method's own finest tolerance
TOLERANCES = (1e-4, 1e-7, 1e-10, 1e-13)
#: of the smoke profile: what is soon compiled on the scene where nothing ends ok, which compiles no derivative,
#: and two methods on every scene
SMOKE, EVERYWHERE = "escape", ("contact-strang", "heyoka-taylor")
CREEP_RTOLS = (1e-3, 1e-6, 1e-9)
DAMPING_PER_STEP = (1.0, 5.0, 25.0)
SPANS = (1e4, 1e5)


def brief(profile):
    return profile.points == 1


def settings(scene, method):
    """(kind, value) of each rung of a method's ladder."""
    if method.control == EXACT:
        return [(EXACT, 0.0)]
    if method.adaptive:
        finest = method.rtol_range[0]
        return [("rtol", rtol) for rtol in (*(r for r in TOLERANCES if r > finest), finest)]
    if method.refuses(scene):
        return [("step", COARSEST.get(scene.name, scene.t_end / 100))]
    each = method.per_step(scene) / (2 if method.kind_on(scene) == "rotation" else 1)
    rungs = RUNGS.get(scene.name, BY_FOUR)
    if method.order <= LOW_ORDER:
        rungs = (*rungs, rungs[-1] / 4)
    longest = scene.t_end / SAVES  # no step straddles a saved time
    steps = (min(COARSEST.get(scene.name, scene.t_end / 400) * part * each, longest) for part in rungs)
    return [("step", step) for step in dict.fromkeys(steps)]


def ladder(profile):
    return [
        (scene.name, method)
        for scene in scenes_of("stability")
        for method in cb.METHODS
        if not brief(profile) or small(scene.name, method, SMOKE, EVERYWHERE)
    ]


def questions(profile):
    """Rates: the overdamped oscillator for every method, weak damping over both spans."""
    if brief(profile):
        return [(which, EVERYWHERE[0]) for which in ("overdamped", f"weak_damping {SPANS[0]:.0e}")]
    weak = [("weak_damping", span) for span in SPANS] + [("weak_damping_particle", SPANS[0])]
    return [("overdamped", method) for method in cb.METHODS] + [
        (f"{scene} {span:.0e}", method) for scene, span in weak for method in cb.METHODS
    ]


def calls(cell, profile):
    """What a cell runs: (row without its result, function, arguments) for each of its rows."""
    which, method = cell[0], cb.METHODS[cell[1]]
    engine = method.engines[0]
    key = {"method": method.name, "engine": engine, "status": "failed"}
    scene = cb.SCENES[which]
    budget = budget_of(profile, scene, method)
    for kind, value in settings(scene, method):
        row = key | {"scene": which, **controlled(kind, value)}
        yield row, stability_row, (which, method.name, engine, kind, value, budget)


def rate_calls(cell, profile):
    which, method = cell[0], cb.METHODS[cell[1]]
    key = {"method": method.name, "engine": method.engines[0], "status": "failed"}
    if which != "overdamped":
        name, _, span = which.partition(" ")
        row = key | {"experiment": "weak", "scene": name, "setting": "", "t_end": float(span)}
        yield row, weak_row, (name, method.name, float(span))
        return
    scene, kind = cb.SCENES[which], method.control
    steps = [damping / scene.gamma for damping in DAMPING_PER_STEP]
    key |= {"experiment": "overdamped", "scene": which, "t_end": scene.t_end}
    for value in {"step": steps, "rtol": CREEP_RTOLS, EXACT: [0.0]}[kind]:
        arguments = (method.name, kind, value, budget_of(profile, scene, method))
        yield key | controlled(kind, value), overdamped_row, arguments


def budget_of(profile, scene, method):
    """Three times the evaluations of a timed run: these are hard."""
    steps = step_budget(profile, scene, method, method.engines[0])
    if steps is None:
        return None if method.control == "step" else 1_000_000
    return 3 * steps


# -- workers ---------------------------------------------------------------------------------------
@pytest.fixture(scope="session")
def worker():
    """A process beside this one, on the same core, that keeps what it has compiled."""
    with Worker() as one:
        yield one


def rows_of(calls, worker):
    """The row of each call, coarse to fine; how it ended where there is none.

    Where a tolerance spent the budget a tighter one would spend it too, and is not run.
    """
    rows, spent = [], ""
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


@cells(ladder)
def test_stability(cell, profile, worker, record_all):
    rows = rows_of(calls(cell, profile), worker)
    record_all(STABILITY, rows)
    assert rows
    assert all(row["status"] == "ok" or row["message"] for row in rows)


@cells(questions)
def test_rates(cell, profile, worker, record_all):
    rows = rows_of(rate_calls(cell, profile), worker)
    record_all(DAMPING_RATES, rows)
    assert all(row["status"] == "ok" or row["message"] for row in rows)


# -- linear stability ------------------------------------------------------------------------------
GAMMAS, OMEGAS = (0.0, 0.1, 0.3, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0), (0.5, 1.0, 2.0, 10.0)
STEPS = np.geomspace(0.01, 20.0, 60)
STRONG = (0.1, 1.0, 10.0, 50.0)
PER_EVALUATION = np.geomspace(1e-3, 30.0, 40)


def linear(profile):
    names = [method.name for method in fixed_step_methods()]
    some = {names[0], *(name for name in names if is_processed(cb.METHODS[name]))}
    return [(name,) for name in names if not brief(profile) or name in some]


@cells(linear)
def test_linear_stability(cell, record_all):
    method = cb.METHODS[cell[0]]
    record_all(STABILITY_LIMITS, [limits(method, gamma, omega) for gamma in GAMMAS for omega in OMEGAS])
    record_all(ONE_STEP, [row for gamma in GAMMAS for row in radii(method, gamma)])
    record_all(STRONG_DAMPING, [row for gamma in STRONG for row in errors(method, gamma)])


def limits(method, gamma, omega):
    theory, both = THEORY.get(method.name), is_processed(method)
    found = stability(kernel(method), gamma, omega)
    row = {"method": method.name, "gamma": gamma, "omega": omega, "limit": found.limit, "last": found.last}
    row |= {"windows": printed_windows(found), "theory": theory(gamma, omega) if theory else np.nan}
    row |= {"per_evaluation": found.limit / method.per_step(cb.SCENES["oscillator"])}
    saved = stability(method, gamma, omega).limit if both else np.nan
    return row | {"limit_kernel": found.limit if both else np.nan, "limit_saved": saved}


def radii(method, gamma):
    radius = spectral_radius(kernel(method), gamma, 1.0, STEPS)
    saved = (
        spectral_radius(method, gamma, 1.0, STEPS) if is_processed(method) else np.full(len(STEPS), np.nan)
    )
    for h, r, r_saved in zip(STEPS.tolist(), radius.tolist(), saved.tolist(), strict=True):
        row = {"method": method.name, "gamma": gamma, "step": h, "true_radius": true_radius(gamma, 1.0, h)}
        yield row | {"radius": r, "radius_saved": r_saved}


def errors(method, gamma):
    both, each = is_processed(method), method.per_step(cb.SCENES["oscillator"])
    for between in PER_EVALUATION:
        h = between / gamma * each
        row = {"method": method.name, "gamma": gamma, "damping_per_evaluation": between, "step": h}
        row |= {
            "radius": spectral_radius(kernel(method), gamma, 1.0, h),
            "error": propagation_error(method, gamma, h),
        }
        yield row | {"error_saved": propagation_error(method, gamma, h, every_step=True) if both else np.nan}


def printed_windows(found):
    """The windows of instability, "3.134248…3.150828; …"."""
    return "; ".join(f"{start:.7g}…{end:.7g}" for start, end in found.windows)
