"""Run calls in a process of their own, so that one that hangs or crashes loses only its own result."""

from __future__ import annotations

import gc
import hashlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from multiprocessing.process import BaseProcess

from llvmlite.binding import get_host_cpu_features, get_host_cpu_name

from contactbench.trace.kept import folder

#: longest start of a process with its imports, in seconds
STARTUP = 120.0
#: new objects after which a process that runs cells collects garbage: by default it looks through all prepared runs
#: and programs so often that this takes 7 % of the time (measured)
OBJECTS = 100_000


class TimedOut(Exception):
    """Report that a call took longer than its limit and was killed."""


class Died(Exception):
    """Report that a call ended its process."""


class Worker(AbstractContextManager["Worker"]):
    """Make calls in one other process, bound to given cores.

    The process starts with the first call and ends with `close` or the with block; compiled programs stay in it.  After
    a call that runs too long or crashes, the next call starts a new process.
    """

    def __init__(self, cores: Iterable[int] = ()) -> None:
        self.cores = list(cores)
        self.running: tuple[ProcessPoolExecutor, BaseProcess] | None = None

    def submit[T](self, function: Callable[..., T], *arguments: object) -> Future[T]:
        """Queue a call; the function, its arguments and its result must be picklable."""
        if self.running is None:
            spawn = multiprocessing.get_context("spawn")
            pool = ProcessPoolExecutor(1, spawn, initializer=begin, initargs=(self.cores,))
            pid = pool.submit(os.getpid).result(STARTUP)
            self.running = pool, next(p for p in multiprocessing.active_children() if p.pid == pid)
        return self.running[0].submit(function, *arguments)

    def call[T](self, limit: float, function: Callable[..., T], *arguments: object) -> T:
        return self.result(self.submit(function, *arguments), limit)

    def result[T](self, call: Future[T], limit: float | None = None) -> T:
        """Return the result of a call or raise its exception.

        Raises `TimedOut` after `limit` seconds, and `Died` if the process ended.
        """
        try:
            return call.result(limit)
        except BrokenProcessPool:
            raise Died(f"the solver took its process down ({self.close()})") from None
        except BaseException as error:
            if call.done():
                raise
            self.close()  # the process still computes
            if isinstance(error, TimeoutError):
                raise TimedOut(f"no result after {limit:g} s") from None
            raise

    def close(self) -> str:
        if self.running is None:
            return ""
        (pool, process), self.running = self.running, None
        process.kill()
        pool.shutdown()
        code = process.exitcode or 0
        return f"signal {-code}" if code < 0 else f"exit status {code}"

    def __exit__(self, kind: object, *_: object) -> None:
        """Wait for the queued calls and end the process; after an error kill it."""
        if kind is None and self.running is not None:
            self.running[0].shutdown()
            self.running = None
        self.close()


def settle() -> None:
    """Set one thread for every library and JAX's cache folder in the environment, unless the user has set them.

    Libraries read them at their first import, here and in child processes.  The name of the cache folder holds the
    processor, since JAX would load programs compiled for another one.
    """
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    processor = f"{get_host_cpu_name()} {get_host_cpu_features().flatten()}"
    programs, jax = folder("xla"), {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    jax |= {"JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1"}
    if programs is not None:
        key = hashlib.sha256(processor.encode()).hexdigest()[:16]
        jax |= {"JAX_COMPILATION_CACHE_DIR": str(programs / key)}
    os.environ.update(dict.fromkeys(names, "1") | jax | os.environ)


def bind(cores: Iterable[int]) -> None:
    """Bind a process that runs cells to the given cores, if there are any, and collect garbage more rarely.

    XLA sizes its thread pool by the cores of the process, and passing a small program to another thread takes longer
    than running it (up to 70 µs per call, measured).
    """
    gc.set_threshold(OBJECTS)
    if cores := set(cores):
        os.sched_setaffinity(0, cores)


def usable_cores() -> list[int]:
    """Return all cores that this process could be bound to; none where the system does not tell."""
    if not hasattr(os, "sched_getaffinity"):
        return []
    bound = os.sched_getaffinity(0)
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    try:
        return sorted(os.sched_getaffinity(0))
    finally:
        os.sched_setaffinity(0, bound)


def begin(cores: list[int]) -> None:
    """Prepare a worker process: ignore Ctrl-C, end with the parent, and bind to the cores."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=follow_parent, daemon=True).start()
    bind(cores)


def follow_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
