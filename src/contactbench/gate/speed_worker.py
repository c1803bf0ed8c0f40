"""A process that times cells on request, for speed.py: run by path, with the revision to be timed on PYTHONPATH.

It asks nothing of the revision but the public calls (`CALLS`).  In come lines of JSON: first
``{"core": c, "later": d, "cells": [...], "seconds": s}``, then an index of a cell at a time, or "costs"; out
go the file of the code that is timed with the cells it refused, then lists of seconds per call, and for
"costs" seconds of compilation and bytes left behind of each cell, and the peak of the process.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import json
import os
import resource
import subprocess
import sys
from collections.abc import Callable
from itertools import count
from time import perf_counter
from typing import Any, NamedTuple

#: calls are repeated to fill this, so that the clock's resolution plays no part
FILL = 1e-3
REPEATS = 3
#: what is left behind is measured over so many runs, or over as many as this takes at most, in seconds, in three goes
RUNS, RUNS_SECONDS, GOES = 300, 0.1, 3
#: a call that takes longer, in seconds, is not repeated
LONG = 0.05
#: a scene that is not timed, so that its programs are no other's
WARM = "critical"


def pin(core: int | None) -> None:
    """Every thread of this process on one core (where the system can)."""
    if core is not None and hasattr(os, "sched_setaffinity"):
        for thread in os.listdir("/proc/self/task"):
            os.sched_setaffinity(int(thread), {core})


def used() -> float:
    """Seconds of processor time of this process and its children: what else the machine does plays no part."""
    mine, theirs = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return mine.ru_utime + mine.ru_stime + theirs.ru_utime + theirs.ru_stime


def prepared(cell: dict[str, Any], **start: Any) -> Callable[[], Any]:
    import contactbench as cb

    scene, n = cb.SCENES[cell["scene"]], cell["saves"]
    options = {cell["control"]: cell["value"]} if cell["control"] in ("step", "rtol") else {}
    save_at = [scene.t_end * k / n for k in range(1, n + 1)]
    run = cb.prepare(
        scene, cell["method"], engine=cell["engine"], carry=cell["carry"], save_at=save_at, **options
    )
    return lambda: run(**start)


def from_elsewhere(cell: dict[str, Any]) -> Callable[[], Any]:
    import contactbench as cb

    return prepared(cell, q=tuple(0.9 * float(x) for x in cb.SCENES[cell["scene"]].q))


def solved(cell: dict[str, Any]) -> Callable[[], Any]:
    import contactbench as cb

    return lambda: cb.solve(cell["scene"], cell["method"], engine=cell["engine"], step=cell["value"])


def many_solved(cell: dict[str, Any]) -> Callable[[], Any]:
    """Eight trajectories."""
    import contactbench as cb

    q = cb.SCENES[cell["scene"]].q
    start = {"q": ([q[0] * (0.9 + 0.02 * k) for k in range(8)], *q[1:])}
    options = {"step": cell["value"], "engine": cell["engine"], "progress": False}
    return lambda: cb.ensemble(cell["scene"], cell["method"], start, **options)


def referred(cell: dict[str, Any]) -> Callable[[], Any]:
    """A reference that is neither frozen nor kept, of other numbers with every call: a closed form, or live."""
    import contactbench as cb

    scene, k = cb.SCENES[cell["scene"]], count(1)
    return lambda: cb.reference(scene.with_(gamma=scene.gamma * (1 + 1e-6 * next(k))), [0.01])


def imported(cell: dict[str, Any]) -> Callable[[], Any]:
    """The package, by a process of its own."""
    command = [sys.executable, "-P", "-c", "import contactbench"]
    return lambda: subprocess.run(command, check=True)


CALLS: dict[str, Callable[[dict[str, Any]], Callable[[], Any]]] = {
    "prepared": prepared,
    "solve": solved,
    "run(q=…)": from_elsewhere,
    "ensemble": many_solved,
    "reference": referred,
    "live reference": referred,
    "import": imported,
}


class Ready(NamedTuple):
    """A warm call, seconds it takes, and the processor time of its first with its compilation."""

    run: Callable[[], Any]
    once: float
    compiled: float


def ready(cell: dict[str, Any]) -> Ready:
    start = used()
    run = CALLS[cell["call"]](cell)
    solution = run()
    compiled = used() - start
    if hasattr(solution, "message") and not solution.ok:
        raise RuntimeError(f"{solution.status} {solution.message}")
    begun = perf_counter()
    run()
    return Ready(run, perf_counter() - begun, compiled)


def seconds(run: Callable[[], Any], once: float) -> list[float]:
    """Seconds per call, repeat by repeat; `once` : what one takes, roughly."""
    calls, found = max(1, round(FILL / once)), []
    for _ in range(REPEATS if once < LONG else 1):
        start = perf_counter()
        for _ in range(calls):
            run()
        found.append((perf_counter() - start) / calls)
    return found


def resident() -> int:
    """Bytes of memory this process has now."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()


class MallInfo(ctypes.Structure):
    """What glibc's `mallinfo2` says; `hblkhd` and `uordblks` are what is in use."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in (
            "arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost",
        )
    ]  # fmt: skip


def handed_out() -> int:
    """Bytes that the C library has handed out and not got back; 0 where it does not say."""
    library = ctypes.pythonapi  # as every process has it
    if not hasattr(library, "mallinfo2"):
        return 0
    library.mallinfo2.restype = MallInfo
    info = library.mallinfo2()
    return info.uordblks + info.hblkhd


def left_behind(run: Callable[[], Any], once: float) -> float:
    """Bytes that `RUNS` runs leave behind; of longer ones, of `once` seconds, from fewer of them.

    The middle one of three goes: what is allocated once plays no part.  Of each the larger of two: what the process
    has grown by, which holes in its memory may have taken in, and what the C library has handed out, which is not
    where Python keeps its small objects.
    """
    runs = min(RUNS, int(RUNS_SECONDS / once)) // GOES
    if not runs or not os.path.exists("/proc/self/statm"):
        return 0.0
    grown = []
    gc.collect()
    for _ in range(GOES):
        before = resident(), handed_out()
        for _ in range(runs):
            run()
        gc.collect()
        grown.append(max(resident() - before[0], handed_out() - before[1]))
    return sorted(grown)[GOES // 2] * RUNS / runs


def costs(runs: dict[int, Ready]) -> dict[str, Any]:
    """What is measured once; the peak on Linux in bytes.

    Objects from before the timing stay out of the garbage collector's sight: it takes half a second to look through
    them, and would twice a cell.
    """
    return {
        "compile": {i: each.compiled for i, each in runs.items()},
        "leaked": {i: left_behind(each.run, each.once) for i, each in runs.items()},
        "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024.0,
    }


def main() -> None:
    request = json.loads(sys.stdin.readline())
    pin(request["core"])
    import contactbench

    runs, refused, begun = {}, {}, perf_counter()
    warm: set[str] = set()
    for i, cell in enumerate(request["cells"]):
        if request["seconds"] is not None and perf_counter() - begun > request["seconds"]:
            refused[i] = "no time left"
            continue
        if cell["engine"] not in warm:  # what an engine imports and sets up once is no compilation
            warm.add(cell["engine"])
            with contextlib.suppress(Exception):
                ready({**cell, "scene": WARM, "carry": [], "saves": 1, "call": "prepared"})
        try:
            runs[i] = ready(cell)
        except Exception as error:  # one cell that fails stops no other
            refused[i] = f"{type(error).__name__}: {error}"
    pin(request["later"])
    gc.collect()
    gc.freeze()
    gc.disable()
    print(json.dumps({"code": contactbench.__file__, "refused": refused}), flush=True)
    for line in sys.stdin:
        asked = json.loads(line)
        if asked == "costs":
            pin(request["core"])  # no times are taken any more, and the other process does the same
            print(json.dumps(costs(runs)), flush=True)
        else:
            print(json.dumps(seconds(runs[asked].run, runs[asked].once)), flush=True)


if __name__ == "__main__":
    main()
