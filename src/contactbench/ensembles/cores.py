"""Trajectories side by side, by the loop numba compiles: a thread on every core."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np

from contactbench.ensembles.devices import Result
from contactbench.ensembles.measures import Watch
from contactbench.methods.fixed_step_run import FixedStepRun, Loop
from contactbench.trace.compiled import compile_function

#: trajectories a compiled loop integrates side by side: with fewer each waits for its own last operation
LANES = 32
#: chunks begun for every core before the first of them is asked for
AHEAD = 2


def on_cores(
    run: FixedStepRun, loop: Loop, names: Sequence[str], y0: np.ndarray, cores: int, chunk: int
) -> Iterator[Result]:
    """Yield the results of one chunk after the other, a thread on every core.

    No core waits for another before the end: all chunks are of one size, so many that they share out evenly,
    and a few are always begun ahead of the one that is asked for.
    """
    many = compile_function(loop.program.many, LANES)
    rows, shape = loop.rows(np.array(run.request.scene.numbers()), run.h, run.n)
    share = equal_share(y0.shape[1], cores, chunk)
    ahead: deque[Future[Result]] = deque()
    threads = ThreadPoolExecutor(cores)
    try:
        for first in range(0, y0.shape[1], share):
            part = y0[:, first : first + share]
            ahead.append(threads.submit(side_by_side, run, many, rows, shape, names, part))
            if len(ahead) > AHEAD * cores:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()
    finally:  # begin no other where one has failed or the rest is not wanted
        threads.shutdown(cancel_futures=True)


def equal_share(n: int, cores: int, chunk: int) -> int:
    """Return the size of the fewest chunks of at most `chunk`, a multiple of `cores`; whole tiles if they fit."""
    share = -(-n // (cores * -(-n // (cores * chunk))))
    whole = LANES * -(-share // LANES)
    return whole if whole <= chunk else share


def side_by_side(
    run: FixedStepRun, many: Any, rows: np.ndarray, shape: np.ndarray, names: Sequence[str], y0: np.ndarray
) -> Result:
    """Return final states (d, m), measures (·, m) and end times (m,) of some trajectories, on one core.

    rows, shape : as `Loop.rows` gives them.
    """
    r, m = run.request, y0.shape[1]
    y = np.pad(y0, ((0, 0), (0, -m % LANES)), mode="edge")  # the last trajectory again and again
    part, place = np.array([0, y.shape[1] // LANES]), len(shape) - len(run.n)
    with np.errstate(all="ignore"):
        watch = Watch(r.scene, r.carry, names, run._motion, y0)
        marks = watch.begun
        for which, t in zip(shape[place:], run.later, strict=True):
            after = np.empty((1, *y.shape))
            many(y, rows, np.append(shape[:place], which), after, part)
            y = after[0]
            x = r.scene.unpack(tuple(y[:, :m]), r.carry)
            marks = watch.at(marks, x, y[:, :m], t)
        return watch.result(marks, x, y[:, :m])
