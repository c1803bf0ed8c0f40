"""A process that times cells on request, for speed.py: run by path, with the revision to be timed on PYTHONPATH.

It asks nothing of the revision but ``contactbench.prepare``.  In come lines of JSON: first
``{"core": c, "later": d, "cells": [...]}``, then one index of a cell at a time; out go the file of the
code that is timed with the cells it refused, then lists of seconds per call.
"""

from __future__ import annotations

import gc
import json
import os
import sys
from collections.abc import Callable
from time import perf_counter
from typing import Any

#: calls are repeated to fill this, so that the clock's resolution plays no part
FILL = 1e-3
REPEATS = 3


def pin(core: int | None) -> None:
    """Every thread of this process on one core (where the system can)."""
    if core is not None and hasattr(os, "sched_setaffinity"):
        for thread in os.listdir("/proc/self/task"):
            os.sched_setaffinity(int(thread), {core})


def prepared(cell: dict[str, Any]) -> tuple[Callable[[], Any], int]:
    """A warm prepared call, and how many of it fill a repeat."""
    import contactbench as cb
    from contactbench.solution import keywords

    scene, options = cb.SCENES[cell["scene"]], keywords(cell["control"], cell["value"])
    run = cb.prepare(
        scene, cell["method"], engine=cell["engine"], carry=cell["carry"], save_at=[scene.t_end], **options
    )
    solution = run()
    if not solution.ok:
        raise RuntimeError(f"{solution.status} {solution.message}")
    start = perf_counter()
    run()
    return run, max(1, round(FILL / (perf_counter() - start)))


def seconds(run: Callable[[], Any], calls: int) -> list[float]:
    """Seconds per call, repeat by repeat."""
    found = []
    for _ in range(REPEATS):
        start = perf_counter()
        for _ in range(calls):
            run()
        found.append((perf_counter() - start) / calls)
    return found


def main() -> None:
    request = json.loads(sys.stdin.readline())
    pin(request["core"])
    import contactbench

    runs, refused = {}, {}
    for i, cell in enumerate(request["cells"]):
        try:
            runs[i] = prepared(cell)
        except Exception as error:  # one cell that fails stops no other
            refused[i] = f"{type(error).__name__}: {error}"
    pin(request["later"])
    gc.collect()
    gc.freeze()
    gc.disable()
    print(json.dumps({"code": contactbench.__file__, "refused": refused}), flush=True)
    for line in sys.stdin:
        print(json.dumps(seconds(*runs[int(line)])), flush=True)


if __name__ == "__main__":
    main()
