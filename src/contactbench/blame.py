"""Calls of users' code: find the origin and the place of an error, and describe it."""

from __future__ import annotations

import linecache
import os
import re
import sysconfig
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FunctionType

from contactbench.errors import BadInput, one_line

#: most characters of a foreign message that are repeated
REPEATED = 120
#: functions of one number in `cb.math`
FUNCTIONS: tuple[str, ...] = ("exp", "expm1", "log", "log1p", "sqrt")
FUNCTIONS += ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh")
#: functions of several numbers in `cb.math`
SEVERAL = ("atan2", "hypot", "where")
#: folders without users' code: this package, Python's library, installed packages
_OURS = str(Path(__file__).parent) + os.sep
_PATHS = [sysconfig.get_path(name) + os.sep for name in ("stdlib", "platstdlib", "purelib", "platlib")]
_NOT_USERS = (_OURS, *_PATHS, "<frozen")
#: nor in generated programs
_GENERATED = ("contactbench", "<contactbench", "program_")


class UserError(BadInput):
    """An error in a user's function or plug-in; the exception itself is its `__cause__`."""


def is_ours(function: object, asked: tuple[object, ...] = ()) -> bool:
    """Return whether a function or class is of this package, by its globals and captured values; asked : outer ones."""
    if any(function is each for each in asked):
        return True
    if not isinstance(function, FunctionType):
        return isinstance(function, type) and _is_package(function.__module__)
    captured = [cell.cell_contents for cell in function.__closure__ or ()]
    return _is_package(function.__globals__.get("__name__")) and all(
        is_ours(each, (*asked, function)) or is_ours(type(each)) or isinstance(each, int | float | str)
        for each in captured
    )


def _is_package(module: object) -> bool:
    return str(module).partition(".")[0] == "contactbench"


def frame_of(error: BaseException) -> traceback.FrameSummary | None:
    theirs = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if not frame.filename.startswith(_NOT_USERS)
        and not os.path.basename(frame.filename).startswith(_GENERATED)
        and (frame.filename, frame.name) != ("<string>", "__init__")  # what `dataclass` writes
    ]
    return theirs[-1] if theirs else None


def plain_function(error: BaseException) -> str | None:
    """Return a hint for a function of `math` or NumPy that does not know the given kind of number."""
    frame = frame_of(error)
    math = os.path.join(_OURS, "numbers", "functions.py")  # cb.math itself was called, and is not to blame
    if frame is None or any(last.filename == math for last in traceback.extract_tb(error.__traceback__)):
        return None
    line = linecache.getline(frame.filename, frame.lineno or 0).encode()
    failing = line[frame.colno : frame.end_colno].decode(errors="ignore")
    called = re.match(r"(?:(?:math|numpy|np)\.)?(?:linalg\.)?(\w+)\(", failing)
    if called is None:
        return None
    written, name = called[0][:-1], called[1].replace("arc", "a", 1)  # NumPy's arcsin
    if name in (*FUNCTIONS, *SEVERAL):
        return f"{written} takes plain numbers only: use cb.math.{name}"
    if written == name:
        return None
    if name == "norm":
        return f"{written} takes plain numbers only: use cb.math.sqrt(sum(c * c for c in …))"
    return f"{written} takes plain numbers only: use cb.math, which has {', '.join((*FUNCTIONS, *SEVERAL))}"


def user_error(what: str, error: BaseException) -> UserError:
    """Return the error as one line with its origin, place and message."""
    says = plain_function(error) or f"{type(error).__name__}: {one_line(error, REPEATED)}{lengths(error)}"
    made = UserError(f"{what}{place(error)}: {says}")
    made.__cause__ = error
    return made


def lengths(error: BaseException) -> str:
    """Return how many numbers each argument of the function has in which an index is out of range, else nothing."""
    frame, step, given = frame_of(error), error.__traceback__, dict[str, int]()
    while step is not None and frame is not None and isinstance(error, IndexError):
        code, values = step.tb_frame.f_code, step.tb_frame.f_locals
        if (code.co_filename, step.tb_lineno) == (frame.filename, frame.lineno):
            names = (*code.co_varnames[: code.co_argcount], *code.co_freevars)
            given = {name: len(values[name]) for name in names if type(values.get(name)) is tuple}
        step = step.tb_next
    return "".join(
        f"; {name} has {n} component{'s' * (n != 1)}, from {name}[0] on" for name, n in given.items()
    )


def place(error: BaseException) -> str:
    """Return the place of an error in users' code, ", function (file, line n)", or an empty string."""
    frame = frame_of(error)
    if frame is None:
        return ""
    return f", {frame.name} ({os.path.basename(frame.filename)}, line {frame.lineno})"


def blame(what: str, error: BaseException) -> BaseException:
    """Return the error as a `UserError` if it comes from a user's code, else unchanged."""
    passed = isinstance(error, BadInput | KeyboardInterrupt | GeneratorExit)
    return error if passed or frame_of(error) is None else user_error(what, error)


@contextmanager
def their_code(what: str) -> Iterator[None]:
    """Raise a `UserError` that names `what` for an error or an exit inside."""
    try:
        yield
    except (BadInput, KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException as error:
        raise user_error(what, error) from error
