"""Limit the time of plug-ins and of users' functions."""

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

#: variable with the seconds for importing a plug-in, and for the first evaluation of each user's function; 0 or unset:
#: no limit, since a limit takes over the signal handler.  The command line sets it
VARIABLE = "CONTACTBENCH_PLUGIN_TIMEOUT"
#: number of times that `Overrun` is raised, and seconds between them
RINGS, AGAIN = 3, 0.5


class Overrun(BaseException):
    """Report that the time limit is over; not an `Exception`, so that users' code does not catch it."""


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
    """Return `limit`, or 0 if it is not a time; loading a plug-in reports that error."""
    with suppress(BadInput):
        return limit()
    return 0.0


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """Raise `Overrun` in the block after some seconds, in the main thread only, unless an outer limit is running.

    If the code catches `Overrun` three times and goes on, the process ends.
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
