"""How many trajectories a second?  One cell: a method at one setting, on a number of trajectories and cores.

Four questions: the same arithmetic as C loops (1024 trajectories over 200 000 gradients and more, so that the
call does not count); the cost of a trajectory at equal error; how throughput depends on the number of trajectories;
and on the number of cores.  What is timed is the whole call, from initial to final states on the host.
More than one core takes a process of its own, because this one is bound to one.
"""

from __future__ import annotations

from functools import cache
from time import perf_counter

import numpy as np
import pytest

import contactbench as cb
from c_loops import KERNELS, SHAPES
from cells import cells, controlled
from clock import usable_cores
from contactbench.ensembles import ENGINES
from contactbench.measure.clock import Call, Part
from contactbench.results.tables import ENSEMBLE_TABLE
from ensemble_peers import prepared

pytestmark = pytest.mark.timed

SAMPLE = 4
#: of the trajectories: a second call, which tells what every call costs from what every trajectory does
FEWER = 1 / 4
STEPS = {
    "contact-strang": (0.1, 0.02, 0.004, 0.001),
    "contact-bm4": (0.8, 0.4, 0.16, 0.05),
    "contact-rkn6": (1.25, 0.8, 0.4, 0.16, 0.08),
    "contact-rkn8": (1.25, 0.8, 0.4, 0.2, 0.16),
    "rk4": (0.2, 0.08, 0.04, 0.01),
}
PEERS = [
    *((f"diffrax-{solver}", "jax", shape) for solver in ("tsit5", "dopri8") for shape in ("vmap", "shared")),
    ("heyoka-taylor", "llvm", "batch"),
    ("cyrk-dop853", "c++", "loop"),
    ("cyrk-vern8", "c++", "loop"),
    ("cvode-adams", "c", "loop"),
]
#: trajectories of a peer that takes one after the other: more of them take no less each
LOOPED = 256
#: steps with which both methods evaluate so often that a call's own millisecond is lost
ARITHMETIC = {"contact-strang": 0.01, "contact-rkn6": 0.1}
RTOLS = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
OURS = "contact-rkn6"
#: (method, variant, value) of the smoke profile
SMOKE = {
    (OURS, "", 0.1),
    (OURS, "", 0.4),
    ("limit-c", f"{OURS} plain", 0.1),
    ("heyoka-taylor", "batch", 1e-6),
}


def core_counts():
    total = len(usable_cores())
    return [*(2**k for k in range(total.bit_length()) if 2**k < total), total]


def ladder(profile):
    """(question, scene, method, engine, variant, control, value, trajectories, cores)."""
    smoke, rows = profile.points == 1, []
    for method in KERNELS:
        step = ARITHMETIC[method]
        rows += [("arithmetic", "particle_long", method, e, "", "step", step, 1024, 1) for e in ENGINES]
        rows += [
            ("arithmetic", "particle_long", "limit-c", "c", f"{method} {shape}", "step", step, 1024, 1)
            for shape in SHAPES
        ]
    for method, steps in STEPS.items():
        rows += [("error", "particle", method, ENGINES[0], "", "step", h, 4096, 1) for h in steps]
    for method, engine, variant in PEERS:
        n = LOOPED if variant == "loop" else 4096
        rows += [("error", "particle", method, engine, variant, "rtol", rtol, n, 1) for rtol in RTOLS]
    if smoke:  # one kernel, one setting of two methods; how many cores there are is the machine's affair
        return [row for row in rows if (row[2], row[4], row[6]) in SMOKE]
    sizes = [10**k for k in range(3, 8 if profile.name == "full" else 7)]
    rows += [("size", "particle", OURS, ENGINES[0], "", "step", 0.4, n, 1) for n in sizes]
    rows += [("cores", "particle", OURS, ENGINES[0], "", "step", 0.1, 200_000, k) for k in core_counts()]
    return rows


def initial(scene, n):
    """States spread by 5 % about the scene's own, (d, n); the first few do not depend on n."""
    own = np.array(scene.pack(scene.initial(())))
    return own[:, None] + 0.05 * np.random.default_rng(7).normal(size=(n, len(own))).T


@cache
def truth(scene_name):
    scene = cb.SCENES[scene_name]
    starts = (scene.unpack(tuple(y), ())._asdict() for y in initial(scene, SAMPLE).T.tolist())
    return np.array([cb.reference(scene.with_(q=x["q"], p=x["p"]), [scene.t_end], ()).y[0] for x in starts]).T


def error(y, exact):
    return np.linalg.norm(y[:, :SAMPLE] - exact, axis=0).max() / np.linalg.norm(exact, axis=0).max()


#: evaluations that the runs of all members, each by itself, may take together
SINGLE_WORK = 4e6
#: what members are run with where the method chooses its steps, maybe for several members at once
BY_ITSELF = ("heyoka-taylor", 2.3e-16)


def member_deviation(scene, method, control, value, start, y):
    """max ‖y − y₁‖ / max ‖y₁‖ over all members, y₁ the run of each by itself with the same fixed steps.

    Of a method that chooses its steps y₁ is the most accurate run of another one.
    """
    if control != "step":
        (method, value), control = BY_ITSELF, "rtol"
    run = cb.prepare(scene, method, save_at=[scene.t_end], carry=(), **{control: value})
    alone = np.array([run.integrate(np.array(one)).y[-1] for one in start.T.tolist()]).T
    return np.linalg.norm(y - alone, axis=0).max() / np.linalg.norm(alone, axis=0).max()


def prepared_row(cell, exact):
    """The row of a cell without its times, and what is to be timed, if it can be run.

    exact : the true final states of the first few trajectories, None for a row without errors.
    """
    question, name, method, engine, variant, control, value, n, cores = cell
    scene = cb.SCENES[name]
    row = {"question": question, "scene": name, "method": method, "engine": engine}
    row |= {**controlled(control, value, variant), "trajectories": n, "cores": cores}
    row |= {"family": cb.METHODS[method].family if method in cb.METHODS else "limit"}
    made = prepared(scene, method, engine, variant, value, initial(scene, n))
    if isinstance(made, str):
        return row | {"status": "unsupported", "message": made}, None
    run, costs = made
    start = perf_counter()
    y = run()
    row |= {"status": "ok", "message": "", "first_call_s": perf_counter() - start}
    y = np.asarray(y)
    steps, evaluations, kind = costs()
    if exact is not None:
        row["solution_error"] = error(y, np.asarray(exact))
        short = 0 < (evaluations or steps or 0) * n < SINGLE_WORK
        if question == "error" and method in cb.METHODS and short:
            row["member_deviation"] = member_deviation(scene, method, control, value, initial(scene, n), y)
    row |= {"steps": steps, "evaluations": evaluations, "evaluation_kind": kind}
    if question not in ("error", "size"):
        return row, Call(run)
    fewer, _ = prepared(scene, method, engine, variant, value, initial(scene, round(n * FEWER)))
    return row, Call(run, Part(fewer, FEWER, n))


@cells(ladder)
def test_ensemble(cell, clock):
    exact = None if cell[0] == "arithmetic" else truth(cell[1]).tolist()
    if cell[-1] == 1:
        clock.time(ENSEMBLE_TABLE, {}, prepared_row, cell, exact)
    else:
        clock.time_on(usable_cores()[-cell[-1] :], ENSEMBLE_TABLE, prepared_row, cell, exact)
