"""The one exception users see for bad input, the checks that raise it, and the calls of other people's code."""

from __future__ import annotations

import itertools
import linecache
import math
import os
import re
import reprlib
import signal
import sys
import sysconfig
import threading
import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType, FunctionType
from typing import Any, ClassVar, NoReturn

import numpy as np

from contactbench.notebook import html_table

#: characters at most of a message, and of a value that is shown in it
LONGEST, SHOWN = 300, 80


class BadInput(ValueError):
    """A value the library cannot work with; the message, one line, names it and what is allowed."""

    def __init__(self, message: object) -> None:
        super().__init__(one_line(message))

    def __str__(self) -> str:  # KeyError, a base of UnknownName, would print its repr
        return str(self.args[0])


class UnknownName(BadInput, KeyError):
    """A name that is in no registry; the message suggests the nearest one."""


def one_line(message: object, longest: int = LONGEST) -> str:
    """Text without line breaks or control characters, its middle left out where it is longer."""
    text = " ".join("".join(c if c.isprintable() else " " for c in str(message)).split())
    end = 2 * longest // 5  # what is allowed stands there
    return text if len(text) <= longest else f"{text[: longest - end - 3]} … {text[-end:]}"


_SHORT = reprlib.Repr(maxlevel=3, maxtuple=8, maxlist=8, maxdict=4, maxset=4, maxstring=SHOWN, maxother=SHOWN)


def excerpt(value: object) -> str:
    """The repr of any value, short and on one line, whatever it is."""
    try:
        return one_line(_SHORT.repr(value), SHOWN)
    except Exception:  # an int of thousands of digits, an object whose repr fails
        return f"<{type(value).__name__}>"


def unknown_name(kind: str, name: object, allowed: Iterable[str]) -> UnknownName:
    from difflib import get_close_matches

    names = list(allowed)
    plain = {known.lower(): known for known in names}
    near = get_close_matches(name.lower(), plain, n=1, cutoff=0.5) if isinstance(name, str) else []
    hint = f"did you mean {plain[near[0]]!r}? " if near else ""
    return UnknownName(f"unknown {kind} {excerpt(name)}: {hint}choose from {', '.join(names)}")


#: a name is also a key in tables, a part of file names and a word on the command line
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]*")

#: line breaks, other control characters, halves of characters
CONTROL = re.compile("[\\x00-\\x1f\\x7f-\\x9f\\u2028\\u2029\\ud800-\\udfff]")


class Registry(dict):
    """A dict in table order whose missing keys raise `UnknownName`; kind : its items in messages; of : their class."""

    #: all registries there are
    every: ClassVar[list[Registry]] = []

    def __init__(self, kind: str, of: type = object) -> None:
        super().__init__()
        self.every.append(self)
        self.kind, self.of = kind, of

    def _repr_html_(self) -> str:
        return html_table({name: getattr(item, "about", "") for name, item in self.items()}, self.kind)

    def __getitem__(self, name: Any) -> Any:
        if not isinstance(name, str) or name not in self:  # perhaps something that cannot be a key at all
            raise unknown_name(self.kind, name, self)
        return super().__getitem__(name)

    def add(self, item: Any) -> Any:
        """Register `item` under its name and return it; raises `BadInput` for a taken or bad name, or no such item."""
        name = getattr(item, "name", None)
        if isinstance(name, str) and name in self:
            raise BadInput(f"{self.kind} {name!r} is already registered")
        self[name] = item
        return item

    def __setitem__(self, name: Any, item: Any) -> None:
        """Register `item` under its own name, in place of what had it; raises `BadInput` as `add` does."""
        own = getattr(item, "name", None)
        if not isinstance(item, self.of) or own is None:
            raise BadInput(f"{excerpt(item)} cannot be registered: it is no {self.kind}")
        if not isinstance(own, str) or not NAME.fullmatch(own):
            raise BadInput(f"{self.kind} name {excerpt(own)}: must be letters, digits, '_', '.', '+', '-'")
        if name != own:
            raise BadInput(f"{self.kind} name {excerpt(name)}: must be the item's own, {own!r}")
        super().__setitem__(name, item)


def refuse(name: str, value: Any, wanted: str) -> NoReturn:
    raise BadInput(f"{name} = {excerpt(value)}: must be {wanted}") from None


def finite(name: str, value: Any) -> float:
    """`value` as a finite float, or `BadInput`: a real number, neither text nor an array."""
    number = value if type(value) is float else math.nan
    if type(value) is not float and is_real(value):
        with suppress(TypeError, ValueError, OverflowError):
            number = float(value)
    return number if math.isfinite(number) else refuse(name, value, "a finite number")


def is_real(value: Any) -> bool:
    """Whether a value is one real number: no text, no complex number, no date, no array."""
    if isinstance(value, np.ndarray | np.generic):
        return value.ndim == 0 and value.dtype.kind in "fiubO"
    return not isinstance(value, str | bytes | bytearray | complex)


def is_number(value: Any) -> bool:
    return is_real(value) and hasattr(value, "__float__")


def require_number(name: str, value: Any) -> None:
    if not is_number(value):
        raise BadInput(f"{name}: must return a real number; it returns {excerpt(value)}")


def positive(name: str, value: Any) -> float:
    number = finite(name, value)
    return number if number > 0 else refuse(name, value, "> 0")


def whole(name: str, value: Any, most: int, least: int = 1) -> int:
    """`value` as an int from `least` to `most`, or `BadInput`."""
    number = 0.0 if isinstance(value, bool) else finite(name, value)
    if not least <= number <= most or number != int(number):
        refuse(name, value, f"a whole number ≥ {least}, at most {most:g}")
    return int(number)


def array(name: str, value: Any, wanted: str) -> np.ndarray:
    """`value` as an array of floats, itself if it is one, or `BadInput` (for complex numbers and dates, too)."""
    try:
        given = np.asarray(value)
        if given.dtype.kind in "fiubO" and (given.dtype.kind != "O" or all(map(is_real, given.flat))):
            return given.astype(float, copy=False)
    except (TypeError, ValueError, OverflowError):
        pass
    refuse(name, value, wanted)


def vector(name: str, value: Any, length: int | None = None) -> tuple[float, ...]:
    """`value` as a tuple of finite floats (of the given length), or `BadInput`."""
    try:
        items = () if isinstance(value, str | bytes | dict | set) else tuple(value)
    except TypeError:
        items = (value,)
    if not items or length not in (None, len(items)):
        refuse(name, value, "a sequence of numbers" if length is None else f"{length} numbers")
    return tuple(finite(f"{name}[{i}]", item) for i, item in enumerate(items))


def items_of(name: str, value: Any, wanted: str) -> list[Any]:
    """The items of `value`, or `BadInput`, which says what is `wanted`; a string is no list of letters."""
    try:
        return refuse(name, value, wanted) if isinstance(value, str | bytes) else list(value)
    except TypeError:
        refuse(name, value, wanted)


def function(name: str, value: Any) -> Any:
    return value if callable(value) else refuse(name, value, "a function")


def text(name: str, value: Any) -> str:
    if not isinstance(value, str) or CONTROL.search(value):
        refuse(name, value, "a string of one line, without control characters")
    return value


def switch(name: str, value: Any) -> bool:
    return bool(value) if isinstance(value, bool | np.bool_) else refuse(name, value, "True or False")


# -- where other people's code is called ---------------------------------------------------------------
#: seconds that importing a plug-in, and every first evaluation of a user's function, may take; 0: any time.  Where it
#: is not set there is no limit, a timer needs a signal handler; the command line sets it
VARIABLE = "CONTACTBENCH_PLUGIN_TIMEOUT"
#: how often `Overrun` is raised, and the seconds in between
RINGS, AGAIN = 3, 0.5
#: characters of another's message that are repeated
REPEATED = 120
#: the functions of one number that `cb.math` has, by their names in `math`
FUNCTIONS: tuple[str, ...] = ("exp", "log", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan")
FUNCTIONS += ("sinh", "cosh", "tanh", "asinh", "acosh", "atanh")
#: and those of several
SEVERAL = ("atan2", "hypot", "where")
#: where no user's code is: this package, Python's library, installed packages
_OURS = str(Path(__file__).parent) + os.sep
_PATHS = [sysconfig.get_path(name) + os.sep for name in ("stdlib", "platstdlib", "purelib", "platlib")]
_NOT_USERS = (_OURS, *_PATHS, "<frozen")
#: nor in generated programs
_GENERATED = ("contactbench", "<contactbench", "program_")


class UserError(BadInput):
    """An error in a user's function or plug-in; the exception itself is its `__cause__`."""


class Overrun(BaseException):
    """The time limit is over.  Not an `Exception`, so that the code it ends does not catch it."""


def is_ours(function: Any) -> bool:
    """Whether a function, or a class, was written in this package: it computes the same tomorrow.

    Where one that wraps another was written is told by its globals; what it has captured must not change either.
    """
    if not isinstance(function, FunctionType):
        return isinstance(function, type) and _is_package(function.__module__)
    captured = [cell.cell_contents for cell in function.__closure__ or ()]
    return _is_package(function.__globals__.get("__name__")) and all(
        is_ours(each) or is_ours(type(each)) or isinstance(each, int | float | str) for each in captured
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
    """What to write in place of a function of `math` or NumPy that was given a number it does not know."""
    frame = frame_of(error)
    math = os.path.join(_OURS, "numbers", "functions.py")  # cb.math itself was called, and is not to blame
    if frame is None or any(last.filename == math for last in traceback.extract_tb(error.__traceback__)):
        return None
    line = linecache.getline(frame.filename, frame.lineno or 0).encode()
    failing = line[frame.colno : frame.end_colno].decode(errors="ignore")
    called = re.match(r"(?:(?:math|numpy|np)\.)?(\w+)\(", failing)
    if called is None:
        return None
    written, name = called[0][:-1], called[1].replace("arc", "a", 1)  # NumPy's arcsin
    if name in (*FUNCTIONS, *SEVERAL):
        return f"{written} takes plain numbers only: use cb.math.{name}"
    if written == name:
        return None
    return f"{written} takes plain numbers only: use cb.math, which has {', '.join((*FUNCTIONS, *SEVERAL))}"


def user_error(what: str, error: BaseException) -> UserError:
    """The error as a line: whose it is, where it happened, what it says."""
    if isinstance(error, Overrun):
        says = f"ended after {limit():g} s, the time it was given (--plugin-timeout, {VARIABLE})"
    else:
        says = plain_function(error) or f"{type(error).__name__}: {one_line(error, REPEATED)}"
    made = UserError(f"{what}{place(error)}: {says}")
    made.__cause__ = error
    return made


def place(error: BaseException) -> str:
    """Where in a user's code an error happened: ", function (file, line n)"; empty where it did not."""
    frame = frame_of(error)
    if frame is None:
        return ""
    return f", {frame.name} ({os.path.basename(frame.filename)}, line {frame.lineno})"


def blame(what: str, error: BaseException) -> BaseException:
    """The error as a `UserError` where it comes from a user's own code, else as it is."""
    passed = isinstance(error, BadInput | KeyboardInterrupt | GeneratorExit)
    return error if passed or frame_of(error) is None else user_error(what, error)


@contextmanager
def their_code(what: str) -> Iterator[None]:
    """Raise a `UserError` that names `what` for an error, an exit or an endless loop inside."""
    try:
        with within(limit()):
            yield
    except (BadInput, KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException as error:
        raise user_error(what, error) from error


def limit() -> float:
    """Return the seconds that a first evaluation may take, 0 for any time."""
    try:
        seconds = float(os.environ.get(VARIABLE, 0.0))
    except ValueError:
        seconds = -1.0
    if not 0 <= seconds < 1e9:
        raise BadInput(f"{VARIABLE} = {os.environ[VARIABLE]}: must be seconds ≥ 0")
    return seconds


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
