"""Handle Ctrl-C during the imports of the command line: one line and status 130.  Imported before all else."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType


def is_command() -> bool:
    """Return whether this process is ``contactbench …`` or ``python -m contactbench …``."""
    name, line = (getattr(sys, "argv", None) or [""])[0], sys.orig_argv
    module = name == "-m" and line[line.index("-m") + 1 :][:1] == [__package__]
    return module or os.path.splitext(os.path.basename(name))[0] == __package__


def leave(_: int, __: FrameType | None) -> None:
    os.write(2, b"contactbench: interrupted\n")
    os._exit(130)


def begin() -> None:
    if is_command() and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, leave)


def end() -> None:
    """Restore Ctrl-C to raise `KeyboardInterrupt`."""
    if signal.getsignal(signal.SIGINT) is leave:
        signal.signal(signal.SIGINT, signal.default_int_handler)


begin()
