"""What does accuracy cost?  One cell: a method on an engine, on a scene, at one setting.

Timed by pytest-benchmark: compiled and warmed up before, garbage collection off, cells in shuffled
order, results on the host before the clock stops.  What is timed is one call of a prepared solver
that returns the final state.  Its error is the largest over five end times, each the end of a run of
its own: interpolation between steps, of lower order than the method for Radau and Kvaerno5, plays no
part in it.
"""

from __future__ import annotations

from time import perf_counter

import contactbench as cb
from cells import RTOLS, cells, engines, outcome, setting, step_budget, steps
from contactbench.laws import absolute_error
from contactbench.table import WORK_PRECISION

STEPS = 9
ENDS = 5
ROUND_SECONDS = 1e-3
MOST_ROUNDS = 40


def ladder(profile):
    rows = []
    for scene in cb.SCENES.values():
        for name, engine in engines():
            adaptive = cb.METHODS[name].adaptive
            values = (
                [r for r in RTOLS if r >= cb.METHODS[name].rtol_range[0]] if adaptive else steps(scene, STEPS)
            )
            for value in profile.choose(values):
                rows.append((scene.name, name, engine, f"{'rtol' if adaptive else 'step'}={value:.6g}"))
    return rows


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
    value = float(cell[3].partition("=")[2])
    if not method.adaptive:  # the exact step, not its six printed digits
        value = min(steps(scene, STEPS), key=lambda h: abs(h - value))
    options = {
        **setting(method, value),
        "engine": engine,
        "carry": carried(scene),
        "max_steps": step_budget(profile, scene, method, engine),
    }
    run = cb.prepare(scene, method.name, save_at=[scene.t_end], **options)
    start = perf_counter()
    solution = run()
    first = perf_counter() - start
    row = {
        "track": "adaptive" if method.adaptive else "fixed",
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
    start = perf_counter()
    run()
    once = perf_counter() - start
    iterations = max(1, round(ROUND_SECONDS / once))
    rounds = min(MOST_ROUNDS, max(profile.rounds, round(profile.seconds / (iterations * once))))
    benchmark.group = scene.name
    benchmark.pedantic(run, rounds=rounds, iterations=iterations, warmup_rounds=1)
    stats = benchmark.stats.stats
    record(
        WORK_PRECISION,
        **outcome(solution, run.count()),
        **row,
        time_min_s=stats.min,
        time_median_s=stats.median,
        time_iqr_s=stats.iqr,
        rounds=stats.rounds,
        iterations=iterations,
    )
