"""What the stability experiment runs in its worker processes: one row of a table per call."""

from __future__ import annotations

import contextlib
import math
from time import perf_counter

import numpy as np

import contactbench as cb
from cells import outcome, save_times
from contactbench.measure.deviation import MEANINGFUL
from contactbench.measure.laws import row as law_columns
from contactbench.measure.stability import slow_rate
from contactbench.truth import blow_up_time, condition_number


class SolverError(Exception):
    """A solver raised; whatever else raises in here is a fault of the experiment."""


@contextlib.contextmanager
def blamed_on_solver():
    try:
        yield
    except cb.BadInput:  # a question nobody should have asked
        raise
    except Exception as error:
        raise SolverError(f"{type(error).__name__}: {error}") from error


def solve(scene, method, **options):
    with blamed_on_solver():
        return cb.solve(scene, method, **options)


#: one call is timed where it takes longer than this, seconds; several where it takes less
PATIENCE, QUICK = 2.0, 0.2


def stability_row(scene, method, engine, kind, value, max_steps):
    """A row of the table `stability`."""
    scene = cb.SCENES[scene]
    with blamed_on_solver():
        run = cb.prepare(
            scene, method, engine=engine, save_at=save_times(scene), max_steps=max_steps, **{kind: value}
        )
        times = [perf_counter()]
        solution = run()
        times.append(perf_counter())
        while (
            solution.ok
            and len(times) < (6 if times[-1] - times[-2] < QUICK else 3)
            and times[1] - times[0] < PATIENCE
        ):
            run()  # the second call may be much shorter: the first imports and allocates
            times.append(perf_counter())
    found = blow_up_time(scene) if solution.status is not cb.Status.unsupported else None
    row = outcome(solution) | {
        "end_time": solution.end_time,
        "blow_up_time": float(found[0]) if found else math.nan,
        "condition_number": condition_number(scene) or math.nan,
    }
    if not solution.ok:
        return row
    row["time_s"] = min(np.diff(times))
    row["end_error"] = end_error(solution)
    return row | law_columns(solution)


def end_error(solution):
    """‖y − y*‖ / ‖y*‖ at the end, of (q, p) or M; 0 where both have underflowed."""
    size = len(solution.scene.labels(()))
    truth = cb.reference(solution.scene, solution.t[-1:], solution.carry).y[0, :size]
    gap, length = np.linalg.norm(solution.y[-1, :size] - truth), np.linalg.norm(truth)
    return float(gap / max(length, MEANINGFUL))


# -- overdamped ------------------------------------------------------------------------------------
def overdamped_row(method, kind, value, max_steps):
    """The rate of creep between t_end/2 and t_end over the true slow rate."""
    scene = cb.SCENES["overdamped"]
    ends = [scene.t_end / 2, scene.t_end]
    solution = solve(scene, method, save_at=ends, carry=(), max_steps=max_steps, **{kind: value})
    row = rate_row("overdamped", solution, scene.t_end, slow_rate(scene.gamma))
    row["damping_per_step"] = scene.gamma * value if kind == "step" else math.nan
    if solution.ok:
        with np.errstate(divide="ignore"):
            size = np.log(np.abs(solution.q[:, 0]))
        row |= rates((size[0] - size[1]) / (ends[1] - ends[0]), row["true_rate"])
    return row


def rate_row(experiment, solution, t_end, true_rate):
    common = outcome(solution)
    keep = ("scene", "method", "engine", "setting", "status", "message", "evaluations")
    return {k: common[k] for k in keep} | {"experiment": experiment, "t_end": t_end, "true_rate": true_rate}


def rates(rate, true_rate):
    ratio = rate / true_rate
    return {"rate": rate, "ratio": ratio, "rate_error": abs(ratio - 1)}


# -- weak damping ----------------------------------------------------------------------------------
#: evaluations per unit of time, for every method alike
COST = 8.0
PILOT = 200.0
SAMPLES, WINDOW = 1000, 0.2


def energy_rate(t, energy):
    """The mean rate at which log H0 falls, from its averages over the first and the last fifth.

    The averages are weighted by a bump, which damps the oscillation of H0 within a window faster than
    any power of its length (Das, Saiki, Sander, Yorke, Nonlinearity 30, 4111 (2017),
    doi:10.1088/1361-6544/aa84c2).
    """
    n = round(len(t) * WINDOW)
    u = np.arange(1, n + 1) / (n + 1)
    weight = np.exp(-1 / (u * (1 - u)))
    log = np.log(energy)
    means = [
        np.average(np.array([t, log])[:, part], axis=1, weights=weight)
        for part in (slice(n), slice(-n, None))
    ]
    (t0, log0), (t1, log1) = means
    return (log0 - log1) / (t1 - t0)


def weak_row(scene, method, t_end):
    """The damping rate over t_end, every method at about COST evaluations per unit of time."""
    scene = cb.SCENES[scene].with_(t_end=t_end)
    chosen = cb.METHODS[method]
    if chosen.refuses(scene) is not None:
        return rate_row("weak", solve(scene, method, **first(chosen, scene)), t_end, math.nan)
    options = {"rtol": matching_tolerance(scene, chosen)} if chosen.adaptive else first(chosen, scene)
    solution = solve(scene, method, save_at=t_end * np.arange(1, SAMPLES + 1) / SAMPLES, carry=(), **options)
    grid = t_end * np.arange(1, 201) / 200
    truth = cb.reference(scene, grid, ())
    true_rate = energy_rate(grid, scene.energy(truth.states()))
    row = rate_row("weak", solution, t_end, true_rate)
    if solution.ok:
        row |= rates(energy_rate(solution.t, scene.energy(solution.states())), true_rate)
    return row


def first(method, scene):
    """The step that costs COST, or any tolerance where the method refuses the scene."""
    if method.adaptive:
        return {"rtol": 1e-3}
    return {"step": (1 if method.refuses(scene) else method.per_step(scene)) / COST}


def matching_tolerance(scene, method):
    """The whole power of ten at which an adaptive method costs about COST, by bisection on short runs."""

    def cost(k):
        with blamed_on_solver():
            run = cb.prepare(scene, method.name, rtol=10.0**-k, save_at=[PILOT], carry=())
            solution = run()
        return run.count(solution.counts).rhs_equivalents / PILOT if solution.ok else math.inf

    low, high = 1, min(13, math.floor(-math.log10(method.rtol_range[0])))
    costs = {}
    while high - low > 1:
        middle = (low + high) // 2
        costs[middle] = cost(middle)
        low, high = (middle, high) if costs[middle] < COST else (low, middle)
    for k in (low, high):
        costs.setdefault(k, cost(k))
    return 10.0 ** -min((low, high), key=lambda k: abs(math.log(costs[k] / COST)))
