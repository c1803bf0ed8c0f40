"""Time cells of one revision on request of speed.py, which runs this file with that revision on PYTHONPATH.

It uses only public calls of the revision, and the clock of the judging tree.  Requests and answers are lines of JSON:
first all cells, answered by the path of the timed code and the refused cells; then the number of one cell at a time,
answered by a list of seconds per call.
"""

from __future__ import annotations

import gc
import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from inspect import signature
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import contactbench as cb

if TYPE_CHECKING:
    from contactbench.measure import clock
else:
    spec = importlib.util.spec_from_file_location("clock", Path(__file__).parents[1] / "measure" / "clock.py")
    sys.modules["clock"] = clock = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(clock)

#: seconds filled by repeated calls, long against the resolution of the clock
ROUND_SECONDS = 1e-3


def call(cell: Mapping[str, Any]) -> Callable[[], object]:
    name, method, value = cell["scene"], cell["method"], cell["value"]
    scene, engines = cb.SCENES[name], cb.METHODS[method].engines
    engine = (
        cell["engine"] if cell["engine"] in engines else engines[0]
    )  # an older revision names it otherwise
    match cell["call"]:
        case "solve":
            return lambda: cb.solve(name, method, step=value, engine=engine)
        case "new scene":  # each call records and compiles another force
            factors = (1 + 2.0**-20 * k for k in count(1))
            return lambda: cb.solve(quartic(next(factors)), method, step=value, engine=engine)
        case "reference":  # each call has another damping, so that no cache answers
            rates = (scene.gamma * (1 + 1e-6 * k) for k in count(1))
            return lambda: cb.reference(scene.with_(gamma=next(rates)), [0.01])
        case "import":
            return lambda: subprocess.run([sys.executable, "-P", "-c", "import contactbench"], check=True)
    # older revisions without `begins` take times since the start
    times = [scene.t_end * k / cell["saves"] for k in range(1, cell["saves"] + 1)]
    times = [getattr(scene, "begins", 0.0) + time for time in times]
    setting = {cell["control"]: value} if cell["control"] in ("step", "rtol") else {}
    carry = tuple(field for field in ("R",) if field in scene.optional)
    # steps end at saved times, which is all that older revisions know
    ended: dict[str, Any] = {"dense": False} if "dense" in signature(cb.prepare).parameters else {}
    run = cb.prepare(scene, method, engine=engine, save_at=times, carry=carry, **setting, **ended)
    if cell["call"] == "bare":
        packed = run.start
        return lambda: run.bare(packed)
    start = {"q": tuple(0.9 * float(x) for x in scene.q)} if cell["call"] == "run(q=…)" else {}
    return lambda: run(**start)


def quartic(c: float) -> cb.Mechanical:
    force = lambda q: c * (q[0] ** 4 + q[1] ** 2)  # noqa: E731
    return cb.Mechanical(name="own", potential=force, gamma=0.1, q=(1.0, 0.5), p=(0.0, 0.0), t_end=1.0)


def ready(cell: Mapping[str, Any]) -> clock.Call:
    run = call(cell)
    solution = run()
    if isinstance(solution, cb.Solution) and not solution.ok:
        raise RuntimeError(f"{solution.status} {solution.message}")
    timed = clock.Call(run, round_seconds=ROUND_SECONDS)
    timed.warm_up()
    return timed


def main() -> None:
    request = json.loads(sys.stdin.readline())
    calls, refused = {}, {}
    for i, cell in request.items():
        try:
            calls[int(i)] = ready(cell)
        except Exception as error:  # the other cells are still timed
            refused[i] = f"{type(error).__name__}: {error}"
    if hasattr(os, "sched_getaffinity"):
        core = max(os.sched_getaffinity(0))  # the processes of both revisions share one core
        for thread in os.listdir("/proc/self/task"):  # JAX has threads of its own
            os.sched_setaffinity(int(thread), {core})
    gc.collect()
    gc.freeze()
    print(json.dumps({"code": cb.__file__, "refused": refused}), flush=True)
    for line in sys.stdin:
        print(json.dumps(calls[json.loads(line)].visit().whole), flush=True)


if __name__ == "__main__":
    main()
