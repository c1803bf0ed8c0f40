"""Calls in worker processes, each with a time limit: what hangs or dies costs its own result only.

A worker runs many calls one after another, so that what it has compiled stays warm; it is killed and
replaced when a call exceeds its time or takes the process down.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import queue
import signal
import threading
import traceback
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from multiprocessing.connection import Connection
from typing import Any

#: seconds a worker may take to come up and import what it needs
STARTUP = 120.0


class TimedOut(Exception):
    """The call took longer than its limit and was killed."""


class Died(Exception):
    """The call took its process down."""


def serve(pipe: Connection, core: int | None) -> None:
    """A worker's life: receive a call, send back its result or its exception."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=follow_parent, daemon=True).start()
    if core is not None and hasattr(os, "sched_setaffinity"):
        with contextlib.suppress(OSError):  # no such core for this process
            os.sched_setaffinity(0, {core})
    pipe.send("ready")
    while True:
        try:
            function, arguments = pipe.recv()
        except EOFError:
            return
        try:
            answer = (True, function(*arguments))
        except BaseException as error:
            answer = (False, portable(error))
        pipe.send(answer)


def follow_parent() -> None:
    """End with the process that asks, however it ends: nobody waits for the answer any more."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def portable(error: BaseException) -> Exception:
    """The exception with its traceback as a note; a RuntimeError that names it where it cannot be pickled."""
    where = "".join(traceback.format_exception(error))
    try:
        same = pickle.loads(pickle.dumps(error))
        assert isinstance(same, Exception)
    except Exception:
        same = RuntimeError(f"{type(error).__name__}: {error}")
    same.add_note(f"in the worker process:\n{where}")
    return same


class Worker:
    """One process and the pipe to it."""

    def __init__(self, core: int | None) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, far = context.Pipe()
        self.process = context.Process(target=serve, args=(far, core), daemon=True)
        self.process.start()
        far.close()
        self.receive(STARTUP)

    def receive(self, limit: float) -> Any:
        if not self.pipe.poll(limit):
            raise TimedOut(f"no result after {limit:g} s")
        return self.pipe.recv()

    def call(
        self, function: Callable[..., Any], arguments: tuple[Any, ...], limit: float
    ) -> tuple[bool, Any]:
        """(True, what the function returned) or (False, what it raised)."""
        try:
            self.pipe.send((function, arguments))
            return self.receive(limit)
        except (EOFError, ConnectionError):
            self.process.join(5)
            code = self.process.exitcode
            by = f"signal {-code}" if code is not None and code < 0 else f"exit status {code}"
            raise Died(f"the solver took its process down ({by})") from None

    def stop(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()


class Workers:
    """A few worker processes that take calls in order: ``submit(limit, function, *arguments) -> Future``.

    A future raises `TimedOut`, `Died`, or
    what the function raised.  function and arguments must be picklable.
    Close it, or use it as a context manager: no process is left behind.
    """

    def __init__(self, cores: Iterable[int | None]) -> None:
        self.calls: queue.SimpleQueue[tuple[Any, ...] | None] = queue.SimpleQueue()
        self.closed = False
        self.threads = [threading.Thread(target=self._run, args=(core,), daemon=True) for core in cores]
        for thread in self.threads:
            thread.start()

    def submit(self, limit: float, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """The call, for the next worker that is free."""
        future: Future[Any] = Future()
        self.calls.put((future, limit, function, arguments))
        return future

    def _run(self, core: int | None) -> None:
        worker: Worker | None = None
        while (job := self.calls.get()) is not None:
            future, limit, function, arguments = job
            if self.closed or not future.set_running_or_notify_cancel():
                future.cancel()
                continue
            try:
                worker = worker or Worker(core)
                fine, value = worker.call(function, arguments, limit)
            except BaseException as error:  # the worker is lost, the next call gets a new one
                if worker is not None:
                    worker.stop()
                worker = None
                future.set_exception(error)
            else:
                future.set_result(value) if fine else future.set_exception(value)
        if worker is not None:
            worker.stop()

    def close(self) -> None:
        """Let running calls end, drop the others, stop the processes."""
        self.closed = True
        for _ in self.threads:
            self.calls.put(None)
        for thread in self.threads:
            thread.join()

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()
