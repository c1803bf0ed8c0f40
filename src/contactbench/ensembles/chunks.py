"""Chunks of an ensemble: who integrates them, and what happens to one whose worker dies."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ThreadPoolExecutor,
    wait,
)
from dataclasses import dataclass
from typing import Any

import numpy as np

from contactbench.ensembles.cores import on_cores
from contactbench.ensembles.devices import CHUNK, Own, Result, on_devices
from contactbench.errors import BadInput
from contactbench.methods.base import METHODS
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.fixed_step_run import Division, FixedStepRun, loop_of
from contactbench.methods.prepared import Request
from contactbench.numbers.protocol import CannotRecord

ENGINES = ("numba", "jax")
#: trajectories in a task of an executor, whose number of workers is not known
TASK = 2**14
#: how often a chunk is given to an executor that loses it
ATTEMPTS = 3


@dataclass(frozen=True)
class Task:
    """What is done to every chunk; a worker elsewhere knows the method by its name."""

    request: Request
    method: str
    names: tuple[str, ...]
    engine: str | None

    def __call__(self, y0: np.ndarray, own: Own) -> Result | Exception:
        """Return one chunk by one core; an error of its own is its result, so that all others are its worker's."""
        try:
            chosen = METHODS[self.method]
            assert isinstance(chosen, FixedStep)
            run = Division(self.method, self.request, chosen)
            parts = list(self.chunks(run, y0, own, y0.shape[1], cores=1))
        except Exception as error:
            return error
        y, measures, end_time = (np.concatenate(arrays, axis=-1) for arrays in zip(*parts, strict=True))
        return y, measures, end_time

    def chunks(
        self, run: FixedStepRun, y0: np.ndarray, own: Own, chunk: int | None, cores: int | None = None
    ) -> Iterator[Result]:
        """Yield the results of one chunk after the other, in this process; cores : by default all it may use."""
        from contactbench.xla import jax

        devices = jax.local_devices()
        why = "" if devices[0].platform == "cpu" else f"it runs on a CPU, not on {devices[0].platform}"
        why = why or ("parameters differ from one trajectory to the next" if own else "")
        if self.engine != "jax" and not why:
            try:
                loop = loop_of(run.method_, run.request.scene, run.request.carry)
            except CannotRecord as error:
                why = str(error)
            else:
                yield from on_cores(run, loop, self.names, y0, cores or len(devices), chunk or CHUNK["cpu"])
                return
        if self.engine == "numba":
            raise BadInput(f"engine = 'numba': {why}; leave the choice open, or take 'jax'")
        yield from on_devices(run, self.names, y0, own, chunk)


def results(
    task: Task, run: FixedStepRun, y0: np.ndarray, own: Own, chunk: int | None, executor: Executor | None
) -> Iterator[tuple[int, Result]]:
    """Yield (first trajectory of a chunk, its result), every chunk once; by an executor in the order they end."""
    if executor is not None:
        yield from spread(executor, task, y0, own, chunk or TASK)
        return
    first = 0
    for result in task.chunks(run, y0, own, chunk):
        yield first, result
        first += len(result[-1])


def spread(
    executor: Executor, task: Any, y0: np.ndarray, own: Own, size: int
) -> Iterator[tuple[int, Result]]:
    """Yield the chunks by an executor; one that its worker lost is given to another, `ATTEMPTS` times in all.

    A process pool cannot be used any more once a worker of it has died: threads of this process do the rest.
    """
    lost: Counter[int] = Counter()
    pending: dict[Future[Any], int] = {}
    threads = ThreadPoolExecutor()

    def begin(k: int) -> None:
        nonlocal executor
        part = slice(k * size, (k + 1) * size)
        states, numbers = y0[:, part], {place: values[part] for place, values in own.items()}
        try:
            pending[executor.submit(task, states, numbers)] = k
        except BrokenExecutor as error:
            message = f"{type(executor).__name__} is broken: {error}; this process goes on alone"
            warnings.warn(message, RuntimeWarning, stacklevel=2)
            executor = threads
            pending[executor.submit(task, states, numbers)] = k

    try:
        for k in range(-(-y0.shape[1] // size)):
            begin(k)
        while pending:
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                k = pending.pop(future)
                try:
                    result = future.result()
                except (Exception, CancelledError) as error:
                    lost[k] += 1
                    if lost[k] == ATTEMPTS:
                        raise BadInput(f"executor: chunk {k} was lost {ATTEMPTS} times: {error!r}") from error
                    begin(k)
                    continue
                if isinstance(result, Exception):
                    raise result
                yield k * size, result
    finally:
        threads.shutdown(cancel_futures=True)
