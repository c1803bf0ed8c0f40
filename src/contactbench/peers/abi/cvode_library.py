"""CVODE's own C library, the one that scikit-sundae's wheel ships, driven by compiled code.

Reference: the CVODE user guide, https://sundials.readthedocs.io/en/latest/cvode (C interface, version 7).
The solver's memory is made once and reinitialised for every run; vectors are read through
`N_VGetArrayPointer`, so that nothing depends on how SUNDIALS lays its structures out.
"""

from __future__ import annotations

import ctypes
import sys
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_long, c_void_p
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

#: the major version whose interface is written below
MAJOR = 7
ADAMS, BDF = 1, 2
#: integration tasks
NORMAL, ONE_STEP = 1, 2
#: results of CVode
TOO_MUCH_WORK = -1
#: what the compiled calls return of a run, followed by the state reached
FACTS = ("flag", "reached", "saved", "steps", "evaluations", "jacobians", "rejected")
KNOWN = len(FACTS)


#: what the library's file may be called
PATTERNS = ("libsundials_cvode-*", "libsundials_cvode.so*", "libsundials_cvode*.dylib")


class Unavailable(Exception):
    """Why the library cannot be used."""


def _library_file() -> Path:
    """Where CVODE is: beside the package in a repaired wheel, or among the environment's libraries."""
    package = find_spec("sksundae")
    if package is None or package.origin is None:
        raise Unavailable("scikit-sundae is not installed")
    folder = Path(package.origin).parent
    places = (folder.parent / "scikit_sundae.libs", folder / ".dylibs", Path(sys.prefix) / "lib")
    for place in places:
        for pattern in PATTERNS:
            for found in sorted(place.glob(pattern)):
                return found
    raise Unavailable(f"scikit-sundae's CVODE library is not in {', '.join(map(str, places))}")


class Library:
    """The functions of the library, with their types; `index` is the type SUNDIALS counts with."""

    def __init__(self) -> None:
        path = _library_file()
        from sksundae._cy_common import config  # how the library was built

        if config["SUNDIALS_FLOAT_TYPE"] != "double":
            raise Unavailable(f"SUNDIALS was built with {config['SUNDIALS_FLOAT_TYPE']} numbers")
        index = c_int if config["SUNDIALS_INT_TYPE"] == "int" else ctypes.c_int64
        try:
            self.handle = ctypes.CDLL(str(path))
            self._declare(index)
        except (OSError, AttributeError) as error:
            raise Unavailable(f"{path.name}: {error}") from error
        major, minor, patch = c_int(), c_int(), c_int()
        label = ctypes.create_string_buffer(16)
        self.SUNDIALSGetVersionNumber(byref(major), byref(minor), byref(patch), label, len(label))
        self.version = f"{major.value}.{minor.value}.{patch.value}"
        if major.value != MAJOR:
            raise Unavailable(f"SUNDIALS {self.version}: its C interface is known for version {MAJOR} only")

    def _declare(self, index: Any) -> None:
        pointer = c_void_p
        functions: tuple[tuple[Any, ...], ...] = (
            ("SUNDIALSGetVersionNumber", c_int, *[POINTER(c_int)] * 3, c_char_p, c_int),
            ("SUNContext_Create", c_int, c_int, POINTER(pointer)),
            ("SUNContext_ClearErrHandlers", c_int, pointer),
            ("SUNContext_Free", c_int, POINTER(pointer)),
            ("N_VMake_Serial", pointer, index, pointer, pointer),
            ("N_VGetArrayPointer", pointer, pointer),
            ("N_VDestroy", None, pointer),
            ("SUNDenseMatrix", pointer, index, index, pointer),
            ("SUNDenseMatrix_Data", pointer, pointer),
            ("SUNMatDestroy", None, pointer),
            ("SUNLinSol_Dense", pointer, pointer, pointer, pointer),
            ("SUNLinSolFree", c_int, pointer),
            ("CVodeCreate", pointer, c_int, pointer),
            ("CVodeInit", c_int, pointer, pointer, c_double, pointer),
            ("CVodeReInit", c_int, pointer, c_double, pointer),
            ("CVodeSStolerances", c_int, pointer, c_double, c_double),
            ("CVodeSetUserData", c_int, pointer, pointer),
            ("CVodeSetLinearSolver", c_int, pointer, pointer, pointer),
            ("CVodeSetJacFn", c_int, pointer, pointer),
            ("CVodeSetMaxNumSteps", c_int, pointer, c_long),
            ("CVodeSetMinStep", c_int, pointer, c_double),
            ("CVodeSetMaxStep", c_int, pointer, c_double),
            ("CVodeSetStopTime", c_int, pointer, c_double),
            ("CVode", c_int, pointer, c_double, pointer, pointer, c_int),
            ("CVodeGetDky", c_int, pointer, c_double, c_int, pointer),
            ("CVodeGetNumSteps", c_int, pointer, pointer),
            ("CVodeGetNumRhsEvals", c_int, pointer, pointer),
            ("CVodeGetNumJacEvals", c_int, pointer, pointer),
            ("CVodeGetNumErrTestFails", c_int, pointer, pointer),
            ("CVodeGetNumStepSolveFails", c_int, pointer, pointer),
            ("CVodeFree", None, POINTER(pointer)),
        )
        for name, result, *arguments in functions:
            function = getattr(self.handle, name)
            function.restype, function.argtypes = result, arguments
            setattr(self, name, function)

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(name)  # the functions declared above; for the type checker

    def address(self, name: str) -> int:
        value = ctypes.cast(getattr(self, name), c_void_p).value
        assert value is not None
        return value


@cache
def library() -> Library | Unavailable:
    """The library, or why there is none."""
    try:
        return Library()
    except Unavailable as why:
        return why
