"""Calls in a worker process, each with a time limit: a call that hangs or dies costs its own result only.

The worker runs many calls one after another, so that what it has compiled stays warm; it is killed and
replaced when a call exceeds its time or takes the process down.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

#: seconds a process may take to come up and import what it needs
STARTUP = 120.0


class TimedOut(Exception):
    """The call took longer than its limit and was killed."""


class Died(Exception):
    """The call took its process down."""


class Worker:
    """A process that makes calls; it starts with the first of them.

    Close it, or use it as a context manager: no process is left behind.
    """

    def __init__(self) -> None:
        self.running: tuple[BaseProcess, Connection] | None = None

    def call(self, limit: float, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return what a function returns, and raise what it raises; both, and the arguments, must be picklable.

        Raises `TimedOut` after so many seconds, and `Died`.
        """
        if self.running is None:
            self.running = start()
        process, pipe = self.running
        try:
            pipe.send((function, arguments))
            fine, value = receive(pipe, limit)
        except (EOFError, ConnectionError):
            process.join(5)
            code = process.exitcode
            self.close()
            by = f"signal {-code}" if code is not None and code < 0 else f"exit status {code}"
            raise Died(f"the solver took its process down ({by})") from None
        except BaseException:  # the next call gets a new process
            self.close()
            raise
        if not fine:
            raise value
        return value

    def close(self) -> None:
        """End the process."""
        if self.running is not None:
            process, pipe = self.running
            process.kill()
            process.join()
            pipe.close()
            self.running = None

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()


def start() -> tuple[BaseProcess, Connection]:
    """Return a process that is ready for calls, and the pipe to it."""
    context = multiprocessing.get_context("spawn")
    near, far = context.Pipe()
    process = context.Process(target=serve, args=(far,), daemon=True)
    process.start()
    far.close()
    receive(near, STARTUP)
    return process, near


def receive(pipe: Connection, limit: float) -> Any:
    if not pipe.poll(limit):
        raise TimedOut(f"no result after {limit:g} s")
    return pipe.recv()


# -- in the process --------------------------------------------------------------------------------
def serve(pipe: Connection) -> None:
    """Receive calls, and send back the result or the exception of each."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=follow_parent, daemon=True).start()
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
    """Return the exception with its traceback as a note; a RuntimeError that names it where it cannot be pickled."""
    where = "".join(traceback.format_exception(error))
    try:
        same = pickle.loads(pickle.dumps(error))
        assert isinstance(same, Exception)
    except Exception:
        same = RuntimeError(f"{type(error).__name__}: {error}")
    same.add_note(f"in the worker process:\n{where}")
    return same
