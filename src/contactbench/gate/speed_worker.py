"""A process that times cells on request, for speed.py: run by path, with the revision to be timed on PYTHONPATH.

It asks nothing of the revision but ``contactbench.prepare``.  In come lines of JSON: first
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
import sys
from collections.abc import Callable
from time import perf_counter
from typing import Any

#: calls are repeated to fill this, so that the clock's resolution plays no part
FILL = 1e-3
REPEATS = 3
#: what is left behind is measured over so many runs, or over as many as this takes at most, in seconds, in three goes
RUNS, RUNS_SECONDS, GOES = 300, 0.1, 3
#: a scene that is not timed, so that its programs are no other's
WARM = "critical"

Ready = tuple[Callable[[], Any], int, float]


def pin(core: int | None) -> None:
    """Every thread of this process on one core (where the system can)."""
    if core is not None and hasattr(os, "sched_setaffinity"):
        for thread in os.listdir("/proc/self/task"):
            os.sched_setaffinity(int(thread), {core})


def used() -> float:
    """Seconds of processor time of this process and its children: what else the machine does plays no part."""
    mine, theirs = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return mine.ru_utime + mine.ru_stime + theirs.ru_utime + theirs.ru_stime


def prepared(cell: dict[str, Any]) -> Ready:
    """A warm prepared call, how many of it fill a repeat, and the processor time of its first with its compilation."""
    import contactbench as cb

    scene = cb.SCENES[cell["scene"]]
    options = {cell["control"]: cell["value"]} if cell["control"] in ("step", "rtol") else {}
    n = cell["saves"]
    save_at = [scene.t_end * k / n for k in range(1, n + 1)]
    start = used()
    run = cb.prepare(
        scene, cell["method"], engine=cell["engine"], carry=cell["carry"], save_at=save_at, **options
    )
    solution = run()
    compiled = used() - start
    if not solution.ok:
        raise RuntimeError(f"{solution.status} {solution.message}")
    start = perf_counter()
    run()
    return run, max(1, round(FILL / (perf_counter() - start))), compiled


def seconds(run: Callable[[], Any], calls: int) -> list[float]:
    """Seconds per call, repeat by repeat."""
    found = []
    for _ in range(REPEATS):
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


def left_behind(run: Callable[[], Any], calls: int) -> float:
    """Bytes that `RUNS` runs leave behind; of longer ones from fewer of them.

    The middle one of three goes: what is allocated once plays no part.  Of each the larger of two: what the process
    has grown by, which holes in its memory may have taken in, and what the C library has handed out, which is not
    where Python keeps its small objects.
    """
    if not os.path.exists("/proc/self/statm"):
        return 0.0
    runs = min(RUNS, int(RUNS_SECONDS / FILL * calls)) // GOES
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
        "compile": {i: compiled for i, (_, _, compiled) in runs.items()},
        "leaked": {i: left_behind(run, calls) for i, (run, calls, _) in runs.items()},
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
                prepared({**cell, "scene": WARM, "carry": [], "saves": 1})
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
        asked = json.loads(line)
        if asked == "costs":
            pin(request["core"])  # no times are taken any more, and the other process does the same
            print(json.dumps(costs(runs)), flush=True)
        else:
            print(json.dumps(seconds(*runs[asked][:2])), flush=True)


if __name__ == "__main__":
    main()
