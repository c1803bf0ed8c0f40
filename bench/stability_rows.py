"""What the stability experiment runs in its worker processes: one row of a table per call.

What a row says follows from what is counted; the clock is read for `time_s` alone.
"""

from __future__ import annotations

import contextlib
import math
from time import perf_counter

import numpy as np

import contactbench as cb
from cells import outcome
from contactbench.boundary import UserError
from contactbench.measure.clock import seconds
from contactbench.measure.deviation import MEANINGFUL
from contactbench.measure.ladder import save_times
from contactbench.measure.laws import row as law_columns
from contactbench.measure.stability import slow_rate
from contactbench.results.tables import DAMPING_RATES
from contactbench.solution import keywords
from contactbench.truth import blow_up_time, condition_number
from equal_cost import right_hand_sides, tolerance_at


class SolverError(Exception):
    """A solver raised; whatever else raises in here is a fault of the experiment."""


@contextlib.contextmanager
def blamed_on_solver():
    try:
        yield
    except UserError as error:  # a plug-in's solver
        raise SolverError(str(error)) from error
    except cb.BadInput:  # a question nobody should have asked
        raise
    except Exception as error:
        raise SolverError(f"{type(error).__name__}: {error}") from error


def solve(scene, method, **options):
    with blamed_on_solver():
        return cb.solve(scene, method, **options)


#: seconds: of a call shorter than QUICK the fastest of several is taken; to one longer than LONG what only the first
#: call does adds nothing
QUICK, LONG, CALLS = 0.01, 0.3, 5


def stability_row(scene, method, engine, kind, value, max_steps):
    """A row of the table `stability`."""
    scene = cb.SCENES[scene]
    with blamed_on_solver():
        options = {"engine": engine, "save_at": save_times(scene), "max_steps": max_steps}
        run = cb.prepare(scene, method, **options, **keywords(kind, value))
        start = perf_counter()
        solution = run()
        first = perf_counter() - start
    found = blow_up_time(scene) if solution.status is not cb.Status.unsupported else None
    row = outcome(solution) | {
        "saved_times": len(solution.t),
        "end_time": solution.end_time,
        "blow_up_time": float(found[0]) if found else math.nan,
        "condition_number": condition_number(scene) or math.nan,
    }
    if not solution.ok:
        return row
    row["time_s"] = time_of(run, first)
    row["end_error"] = end_error(solution)
    by_runs = cb.METHODS[method].adaptive and cb.METHODS[method].family != "contact"
    return row | law_columns(
        solution, "by many runs of the solver, on the standard scenes only" if by_runs else ""
    )


def time_of(run, first):
    """Seconds of a call, `first` those of the first one, which imports and allocates."""
    if first > LONG:
        return first
    with blamed_on_solver():
        return min(seconds(run, 1) for _ in range(CALLS if first < QUICK else 1))


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
    solution = solve(scene, method, save_at=ends, carry=(), max_steps=max_steps, **keywords(kind, value))
    row = rate_row("overdamped", solution, scene.t_end, slow_rate(scene.gamma))
    row["damping_per_step"] = scene.gamma * value if kind == "step" else math.nan
    if solution.ok:
        with np.errstate(divide="ignore"):
            size = np.log(np.abs(solution.q[:, 0]))
        row |= rates((size[0] - size[1]) / (ends[1] - ends[0]), row["true_rate"])
        truth = cb.reference(scene, ends, ()).y
        row["q_error"], row["p_error"] = np.abs(solution.y[-1] / truth[-1] - 1).tolist()
    return row


def rate_row(experiment, solution, t_end, true_rate):
    common = outcome(solution)
    keep = {name: value for name, value in common.items() if name in DAMPING_RATES.columns}
    return keep | {"experiment": experiment, "t_end": t_end, "true_rate": true_rate}


def rates(rate, true_rate):
    ratio = rate / true_rate
    return {"rate": rate, "ratio": ratio, "rate_error": abs(ratio - 1)}


# -- weak damping ----------------------------------------------------------------------------------
#: evaluations per unit of time, for every method alike; adaptive ones are matched over a shorter span
COST, PILOT = 8.0, 200.0
#: times at which H0 is looked at, of a method and of the truth alike.  They are close enough together for
#: the oscillation of H0 not to be mistaken for a slow one, which on the 200 times of the frozen references it is
SAMPLES, FROZEN = 1000, 200
#: how far the truth, integrated from one frozen time to the next, may be from it
GAP = 1e-12


def energy_rate(t, energy):
    """The mean rate at which log H0 falls: its slope by least squares, weighted by a bump over the span.

    The weight is flat at both ends with all its derivatives, so that what an oscillation of H0 adds to the
    slope falls faster than any power of the number of its periods (Das, Saiki, Sander, Yorke, Nonlinearity
    30, 4111 (2017), doi:10.1088/1361-6544/aa84c2).
    """
    n = len(t)
    u = np.arange(1, n + 1) / (n + 1)
    weight = np.exp(-1 / (u * (1 - u)))
    lever = weight * (t - np.average(t, weights=weight))
    return float(-(lever @ np.log(energy)) / (lever @ t))


def carried(state):
    """The fields a state has, by name."""
    return {name: value for name, value in state._asdict().items() if value is not None}


def truth_at(scene, times):
    """The true (q, p) at equidistant times up to t_end, a multiple of the frozen ones, as states.

    Between frozen times by Taylor series in double precision, afresh from each frozen state, and checked
    against the next.  Raises `AssertionError` where they do not meet.
    """
    if scene.exact is not None:
        return cb.reference(scene, times, ()).states()
    between = len(times) // FROZEN
    frozen = cb.reference(scene, times[between - 1 :: between], ())
    starts = np.vstack([scene.pack(scene.initial(())), frozen.y[:-1]])
    run = cb.prepare(scene, "heyoka-taylor", rtol=2.3e-16, save_at=times[:between], carry=())
    pieces = np.array([run(**carried(scene.unpack(tuple(y), ()))).y for y in starts])
    assert np.abs(pieces[:, -1] - frozen.y).max() < GAP
    pieces[:, -1] = frozen.y
    return scene.unpack(tuple(np.concatenate(pieces).T), ())


def against_truth(scene, t, states):
    """Rate of H0 of the states at times t, true rate, their ratio and its error, both sampled alike."""
    true_rate = energy_rate(t, scene.energy(truth_at(scene, t)))
    return {"true_rate": true_rate} | rates(energy_rate(t, scene.energy(states)), true_rate)


def weak_row(scene, method, t_end):
    """The damping rate over t_end, every method at about COST evaluations per unit of time."""
    scene = cb.SCENES[scene].with_(t_end=t_end)
    chosen = cb.METHODS[method]
    if chosen.refuses(scene) is not None:
        value = chosen.rtol_range[1] if chosen.adaptive else 1 / COST
        setting = keywords(chosen.control, value)
        return rate_row("weak", solve(scene, method, **setting), t_end, math.nan)
    times = t_end * np.arange(1, SAMPLES + 1) / SAMPLES
    if chosen.adaptive:
        setting = {"rtol": tolerance_at(pilot_cost(scene, method), COST * PILOT, chosen.rtol_range)}
    else:  # whole steps between samples
        setting = {"step": times[0] / max(1, round(times[0] * COST / chosen.per_step(scene)))}
    solution = solve(scene, method, save_at=times, carry=(), **setting)
    row = rate_row("weak", solution, t_end, math.nan)
    if not solution.ok:
        return row
    if "python" not in solution.engine:  # the cost without what it takes to save
        row["evaluations"] = solve(scene, method, save_at=times[-1:], carry=(), **setting).counts.evaluations
    return row | against_truth(scene, times, solution.states())


def pilot_cost(scene, method):
    """The function tolerance → evaluations over the pilot span, as `tolerance_at` wants it."""

    def cost(rtol):
        with blamed_on_solver():
            run = cb.prepare(scene, method, rtol=rtol, save_at=[PILOT], carry=())
            return right_hand_sides(run())

    return cost
