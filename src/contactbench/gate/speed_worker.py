"""A process that times cells on request, for speed.py: run by path, with the revision to be timed on PYTHONPATH.

It asks nothing of the revision but the public calls (`CALLS`).  In come lines of JSON: first
``{"core": c, "cells": {...}, "seconds": s}``, then the number of a cell at a time; out go the file of the code that is
timed with the cells it refused, then lists of seconds per call.
"""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
from collections.abc import Callable
from itertools import count
from time import perf_counter
from typing import Any

import contactbench as cb

#: calls are repeated to fill this many seconds, so that the clock's resolution plays no part
FILL = 1e-3
REPEATS = 3
#: a call that takes longer, in seconds, is not repeated
LONG = 0.05

Run = Callable[[], Any]
Request = dict[str, Any]


# -- calls -----------------------------------------------------------------------------------------
def prepared(cell: Request, **start: Any) -> Run:
    """A prepared run, its last saved time the end."""
    scene, n = cb.SCENES[cell["scene"]], cell["saves"]
    options = {cell["control"]: cell["value"]} if cell["control"] in ("step", "rtol") else {}
    options |= {"save_at": [scene.t_end * k / n for k in range(1, n + 1)], "carry": cell["carry"]}
    run = cb.prepare(scene, cell["method"], engine=cell["engine"], **options)
    return lambda: run(**start)


def from_elsewhere(cell: Request) -> Run:
    """A prepared run from another point."""
    return prepared(cell, q=tuple(0.9 * float(x) for x in cb.SCENES[cell["scene"]].q))


def solve(cell: Request) -> Run:
    """A run from its name on."""
    return lambda: cb.solve(cell["scene"], cell["method"], engine=cell["engine"], step=cell["value"])


def new_scene(cell: Request) -> Run:
    """A run on a scene of the user's own, of another force with every call: what recording and compiling take."""
    factors = (1 + 2.0**-20 * k for k in count(1))

    def run() -> Any:
        c = next(factors)
        own = cb.Mechanical(
            name="own",
            potential=lambda q: c * (q[0] ** 4 + q[1] ** 2),
            gamma=0.1,
            q=(1.0, 0.5),
            p=(0.0, 0.0),
            t_end=1.0,
        )
        return cb.solve(own, cell["method"], engine=cell["engine"], step=cell["value"])

    return run


def ensemble(cell: Request) -> Run:
    """Eight trajectories."""
    q = cb.SCENES[cell["scene"]].q
    start = {"q": ([q[0] * (0.9 + 0.02 * k) for k in range(8)], *q[1:])}
    options = {"step": cell["value"], "engine": cell["engine"], "progress": False}
    return lambda: cb.ensemble(cell["scene"], cell["method"], start, **options)


def reference(cell: Request) -> Run:
    """A reference that is neither frozen nor kept, of other numbers with every call."""
    scene = cb.SCENES[cell["scene"]]
    rates = (scene.gamma * (1 + 1e-6 * k) for k in count(1))
    return lambda: cb.reference(scene.with_(gamma=next(rates)), [0.01])


def package_import(_: Request) -> Run:
    """The package, by a process of its own."""
    return lambda: subprocess.run([sys.executable, "-P", "-c", "import contactbench"], check=True)


CALLS: dict[str, Callable[[Request], Run]] = {
    "prepared": prepared,
    "solve": solve,
    "run(q=…)": from_elsewhere,
    "new scene": new_scene,
    "ensemble": ensemble,
    "reference": reference,
    "import": package_import,
}


# -- timing ----------------------------------------------------------------------------------------
def ready(cell: Request) -> tuple[Run, float]:
    """Return a warm call and the seconds it takes.  Raises an error where the run does not end well."""
    run = CALLS[cell["call"]](cell)
    solution = run()
    if isinstance(solution, cb.Solution) and not solution.ok:
        raise RuntimeError(f"{solution.status} {solution.message}")
    start = perf_counter()
    run()
    return run, perf_counter() - start


def seconds(run: Run, once: float) -> list[float]:
    """Return the seconds per call, repeat by repeat; `once` : what one takes, roughly."""
    calls, found = max(1, round(FILL / once)), []
    for _ in range(REPEATS if once < LONG else 1):
        start = perf_counter()
        for _ in range(calls):
            run()
        found.append((perf_counter() - start) / calls)
    return found


def main() -> None:
    request = json.loads(sys.stdin.readline())
    runs, refused, begun = {}, {}, perf_counter()
    for i, cell in request["cells"].items():
        if request["seconds"] is not None and perf_counter() - begun > request["seconds"]:
            refused[i] = "no time left"
            continue
        try:
            runs[int(i)] = ready(cell)
        except Exception as error:  # one cell that fails stops no other
            refused[i] = f"{type(error).__name__}: {error}"
    if request["core"] is not None:
        for thread in os.listdir("/proc/self/task"):  # all of them: JAX has its own
            os.sched_setaffinity(int(thread), {request["core"]})
    gc.collect()
    gc.freeze()
    gc.disable()
    print(json.dumps({"code": cb.__file__, "refused": refused}), flush=True)
    for line in sys.stdin:
        print(json.dumps(seconds(*runs[json.loads(line)])), flush=True)


if __name__ == "__main__":
    main()
