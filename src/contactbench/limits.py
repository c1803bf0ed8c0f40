"""Limits of time for other people's code."""

from __future__ import annotations

import itertools
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from contactbench.errors import BadInput

#: seconds that importing a plug-in, and every first evaluation of a user's function, may take; 0: any time.  Where it
#: is not set there is no limit, a timer needs a signal handler; the command line sets it
VARIABLE = "CONTACTBENCH_PLUGIN_TIMEOUT"
#: how often `Overrun` is raised, and the seconds in between
RINGS, AGAIN = 3, 0.5


class Overrun(BaseException):
    """The time limit is over.  It is no `Exception`, so that user code does not catch it."""


def limit() -> float:
    """Return the limit in seconds of a first evaluation, 0 for no limit."""
    try:
        seconds = float(os.environ.get(VARIABLE, 0.0))
    except ValueError:
        seconds = -1.0
    if not 0 <= seconds < 1e9:
        raise BadInput(f"{VARIABLE} = {os.environ[VARIABLE]}: must be seconds ≥ 0")
    return seconds


def allowed() -> float:
    """Return `limit`, and 0 where it is not set to a time, which whoever loads a plug-in is told."""
    with suppress(BadInput):
        return limit()
    return 0.0


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """Raise `Overrun` inside after so many seconds, in the main thread, unless an outer limit is running.

    Code that catches it and goes on ends with the process.
    """
    possible = hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread()
    if not seconds or not possible or signal.getitimer(signal.ITIMER_REAL)[0]:
        yield
        return

    alarms = itertools.count(1)

    def over(_: int, frame: FrameType | None) -> None:
        if next(alarms) > RINGS:
            where = f"{frame.f_code.co_filename}, line {frame.f_lineno}: " if frame else ""
            message = f"contactbench: {where}goes on after {seconds:g} s, the time it was given"
            print(message, file=sys.stderr, flush=True)
            os._exit(2)
        raise Overrun

    before = signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, seconds, AGAIN)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
