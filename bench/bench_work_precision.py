"""What does accuracy cost?  One cell: a method on an engine, on a scene, at one setting.

Timed by pytest-benchmark: compiled and warmed up before, garbage collection off, cells in shuffled
order, results on the host before the clock stops.  What is timed is one call of a prepared solver
that returns the final state.  Its error is the largest over five end times, each the end of a run of
its own: interpolation between steps, of lower order than the method for Radau and Kvaerno5, plays no
part in it.
"""

from __future__ import annotations

from time import perf_counter

import numpy as np
import pytest

import contactbench as cb
from cells import RTOLS, cells, engines, outcome, step_budget, timed, work_ladder
from contactbench.measure.laws import absolute_error
from contactbench.results.tables import WORK_PRECISION
from contactbench.scenes import standard_scenes
from limit import KERNELS, kernel

pytestmark = pytest.mark.timed

ENDS = 5
#: a fixed-step method that is also run to tolerances, its pilots counted and timed
CHOSEN, CHOSEN_ON, CHOSEN_RTOLS = "contact-rkn6", ("particle", "particle_long"), [1e-4, 1e-6, 1e-8, 1e-10]
#: beside the tolerances of `RTOLS`: some methods are a thousand times more accurate than asked
LOOSEST = 1e-1


def ladder(profile):
    rows = []
    for scene in standard_scenes():
        for name, engine in engines():
            method = cb.METHODS[name]
            kind = "rtol" if method.adaptive else "step"
            if method.adaptive:
                values = profile.choose([rtol for rtol in RTOLS if rtol >= method.rtol_range[0]])
                if profile.points > 1 and method.rtol_range[1] >= LOOSEST:
                    values = [LOOSEST, *values]
            else:
                values = profile.choose(work_ladder(scene, method.order))
            rows += [(scene.name, name, engine, f"{kind}={value:.6g}") for value in values]
    for scene in CHOSEN_ON:
        rows += [(scene, CHOSEN, "jax", f"rtol={rtol:.6g}") for rtol in profile.choose(CHOSEN_RTOLS)]
    return rows


def limits(profile):
    """The C loops, on the finest and the middle step of the ladder."""
    return [
        (scene, method, f"{work_ladder(cb.SCENES[scene], cb.METHODS[method].order)[k]:.6g}")
        for scene in ("particle", "particle_long")
        for method in KERNELS
        for k in ((-1, -3) if profile.points > 1 else (-3,))
    ]


def carried(scene):
    """The question asks for the motion: no s, and the attitude only where J = R M is measured."""
    return ("R",) if "R" in scene.optional and scene.conformal_rate is not None else ()


def error(solutions):
    """max ‖y − y*‖ / max ‖y*‖ over the ends of several runs."""
    pairs = [absolute_error(solution) for solution in solutions]
    return max(error[-1] for error, _ in pairs) / max(size for _, size in pairs)


@cells(ladder)
def test_work_precision(cell, profile, record, benchmark):
    scene, method, engine = cb.SCENES[cell[0]], cb.METHODS[cell[1]], cell[2]
    kind, _, value = cell[3].partition("=")
    value = float(value)
    if kind == "step":
        value = exact_step(work_ladder(scene, method.order), value)
    options = {
        kind: value,
        "engine": engine,
        "carry": carried(scene),
        "max_steps": step_budget(profile, scene, method, engine),
    }
    run = cb.prepare(scene, method.name, save_at=[scene.t_end], **options)
    start = perf_counter()
    solution = run()
    first = perf_counter() - start
    row = {
        "track": "adaptive" if method.adaptive else "fixed" if kind == "step" else "chosen",
        "carried": " ".join(
            [*scene.initial_fields[: 1 if "M" in scene.initial_fields else 2], *carried(scene)]
        ),
        "compile_s": run.compile_s,
        "first_call_s": first,
    }
    if not solution.ok:
        record(WORK_PRECISION, **outcome(solution), **row)
        return
    earlier = [scene.t_end * k / ENDS for k in range(1, ENDS)]
    shorter = [cb.solve(scene, method.name, save_at=[t], **options) for t in earlier]
    row["solution_error"] = error([*shorter, solution])
    counts = outcome(solution, run.count(solution.counts))
    record(WORK_PRECISION, **counts, **row, **timed(run, profile, benchmark, scene.name))


@cells(limits)
def test_limit(cell, profile, record, benchmark):
    """The same arithmetic as a C loop: what a compiled kernel is compared with."""
    scene, method = cb.SCENES[cell[0]], cell[1]
    step = exact_step(work_ladder(scene, cb.METHODS[method].order), float(cell[2]))
    row = {
        "scene": scene.name, "method": "limit-c", "engine": "c", "setting": f"{method} step={cell[2]}",
        "track": "limit", "carried": "q p", "jacobians": 0, "evaluation_kind": "gradient",
    }  # fmt: skip
    made = kernel(method, scene, step)
    if isinstance(made, str):
        record(WORK_PRECISION, **row, status="unsupported", message=made)
        return
    run, evaluations = made
    start = perf_counter()
    end = run()
    first = perf_counter() - start
    truth = cb.reference(scene, [scene.t_end], ()).y[0]
    record(
        WORK_PRECISION, **row, status="ok", message="", steps=round(scene.t_end / step),
        evaluations=evaluations, rhs_equivalents=float(evaluations), compile_s=0.0, first_call_s=first,
        solution_error=float(np.linalg.norm(end - truth) / np.linalg.norm([*scene.q, *scene.p])),
        **timed(run, profile, benchmark, scene.name),
    )  # fmt: skip


def exact_step(ladder, printed):
    """The step of the ladder that was printed with six digits."""
    return min(ladder, key=lambda h: abs(h - printed))
