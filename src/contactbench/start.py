"""What the command line needs before anything else is imported: one line for Ctrl-C, a time limit for plug-ins.

A process that imports the package for itself keeps its exception hook and its signal handlers.
"""

from __future__ import annotations

import os
import sys
from types import TracebackType

#: seconds that importing a plug-in, and every first evaluation of a user's function, may take; 0: any time.  Where it
#: is not set there is no limit: a timer needs a signal handler
VARIABLE = "CONTACTBENCH_PLUGIN_TIMEOUT"
#: what the command line sets it to
SECONDS = "60"


def is_command_line() -> bool:
    """Return whether this process was started as ``contactbench`` or ``python -m contactbench``."""
    program = sys.argv[0] if getattr(sys, "argv", None) else ""
    if program == "-m":  # as it is while Python looks for the module
        return any(part.startswith(("contactbench", "-mcontactbench")) for part in sys.orig_argv)
    return os.path.basename(program).removesuffix(".exe") == "contactbench"


def report_uncaught(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print one line for Ctrl-C and exit with 130, a traceback for all else."""
    if issubclass(kind, KeyboardInterrupt):
        print("contactbench: interrupted", file=sys.stderr)
        sys.exit(130)
    sys.__excepthook__(kind, error, trace)


if is_command_line():
    sys.excepthook = report_uncaught
    os.environ.setdefault(VARIABLE, SECONDS)
