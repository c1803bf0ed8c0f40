"""Calls in a process of its own: one that hangs or dies costs its own result only."""

from __future__ import annotations

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

#: seconds a process may take to come up and import what it needs
STARTUP = 120.0


class TimedOut(Exception):
    """The call took longer than its limit and was killed."""


class Died(Exception):
    """The call took its process down."""


class Worker(AbstractContextManager["Worker"]):
    """A process that makes calls, on some cores; it starts with the first and ends with `close`, or its block.

    What it has compiled stays warm.  A call that exceeds its time, or takes it down, costs it; the next gets a new one.
    """

    def __init__(self, cores: Iterable[int] = ()) -> None:
        self.cores = list(cores)
        self.running: tuple[ProcessPoolExecutor, BaseProcess] | None = None

    def submit[T](self, function: Callable[..., T], *arguments: object) -> Future[T]:
        """Begin a call after those before it; function, arguments and what comes of it must be picklable."""
        if self.running is None:
            spawn = multiprocessing.get_context("spawn")
            pool = ProcessPoolExecutor(1, spawn, initializer=begin, initargs=(self.cores,))
            pid = pool.submit(os.getpid).result(STARTUP)
            self.running = pool, next(p for p in multiprocessing.active_children() if p.pid == pid)
        return self.running[0].submit(function, *arguments)

    def call[T](self, limit: float, function: Callable[..., T], *arguments: object) -> T:
        return self.result(self.submit(function, *arguments), limit)

    def result[T](self, call: Future[T], limit: float | None = None) -> T:
        """Return what a call returns, and raise what it raises; `TimedOut` after so many seconds, and `Died`."""
        try:
            return call.result(limit)
        except BrokenProcessPool:
            raise Died(f"the solver took its process down ({self.close()})") from None
        except BaseException as error:
            if call.done():
                raise
            self.close()  # it still computes: the next call gets a new process
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
        """Let it do what it was asked for and end by itself, with what it has started; after an error kill it."""
        if kind is None and self.running is not None:
            self.running[0].shutdown()
            self.running = None
        self.close()


def settle() -> None:
    """Set one thread for every engine and where JAX keeps its programs, beside numba's, unless that is chosen already.

    Both are read when the libraries are first imported, here and in processes started from here.  JAX itself does not
    tell processors apart, as numba does: the folder's name does.
    """
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    processor = f"{get_host_cpu_name()} {get_host_cpu_features().flatten()}"
    programs, jax = folder("xla"), {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    jax |= {"JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1"}
    if programs is not None:  # JAX runs whatever lies there
        key = hashlib.sha256(processor.encode()).hexdigest()[:16]
        jax |= {"JAX_COMPILATION_CACHE_DIR": str(programs / key)}
    os.environ.update(dict.fromkeys(names, "1") | jax | os.environ)


def bind(cores: Iterable[int]) -> None:
    """Stay on some cores, where there are any.

    XLA sizes its thread pool by the cores it may use, and handing parts of a small program to another thread costs
    more than running them (up to 70 µs a call, measured).
    """
    if cores := set(cores):
        os.sched_setaffinity(0, cores)


def usable_cores() -> list[int]:
    """The cores the machine lets us use, though this process may be bound to fewer; none where that is not known."""
    if not hasattr(os, "sched_getaffinity"):
        return []
    bound = os.sched_getaffinity(0)
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    try:
        return sorted(os.sched_getaffinity(0))
    finally:
        os.sched_setaffinity(0, bound)


def begin(cores: list[int]) -> None:
    """Prepare the process: it leaves Ctrl-C to the one that asks, and ends with it, however that ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=follow_parent, daemon=True).start()
    bind(cores)


def follow_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
