"""CVODE's C library, which scikit-sundae's wheel ships, and compiled code between it and a scene's C functions.

Reference: the CVODE user guide, https://sundials.readthedocs.io/en/latest/cvode (C interface, version 7).
Vectors are read through `N_VGetArrayPointer`, so that nothing depends on how SUNDIALS lays its structures out.
Importing it loads the library, and raises `ImportError` where it cannot be used.
"""

from __future__ import annotations

import ctypes
import importlib.util
import sys
import weakref
from collections.abc import Callable
from ctypes import byref, c_int, c_void_p
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.base import BaseContext
from numba.extending import intrinsic

from contactbench.checks import missing
from contactbench.peers.abi import LETTERS, external, join, kept, kept_c, split
from contactbench.peers.compiled import (
    JACOBIAN_CALLS,
    KNOWN,
    MAJOR,
    RHS_CALLS,
    TOO_MUCH_WORK,
    CFunctions,
)

#: linear multistep methods, and integration tasks
METHODS = {"Adams": 1, "BDF": 2}
NORMAL, ONE_STEP = 1, 2
#: what the library's file may be called
PATTERNS = ("libsundials_cvode-*", "libsundials_cvode.so*", "libsundials_cvode*.dylib")
#: the functions used, by their signatures as words; n is the type SUNDIALS counts with
SIGNATURES = {
    "iip": "SUNContext_Create",
    "ip": "SUNContext_ClearErrHandlers SUNContext_Free SUNLinSolFree",
    "vp": "N_VDestroy SUNMatDestroy CVodeFree",
    "pp": "N_VGetArrayPointer SUNDenseMatrix_Data",
    "pnpp": "N_VMake_Serial",
    "pnnp": "SUNDenseMatrix",
    "pppp": "SUNLinSol_Dense",
    "pip": "CVodeCreate",
    "ippdp": "CVodeInit",
    "ipdd": "CVodeSStolerances",
    "ipdp": "CVodeReInit CVodeSVtolerances",
    "ipp": "CVodeSetUserData CVodeSetJacFn CVodeGetNumSteps CVodeGetNumErrTestFails "
    "CVodeGetNumStepSolveFails",
    "ippp": "CVodeSetLinearSolver",
    "ipl": "CVodeSetMaxNumSteps",
    "ipd": "CVodeSetMinStep CVodeSetMaxStep CVodeSetStopTime",
    "ipdppi": "CVode",
    "ipdip": "CVodeGetDky",
    "ippppi": "SUNDIALSGetVersionNumber",
}


def library_file() -> Path:
    """Return the path of CVODE: beside the package in a repaired wheel, or among the environment's libraries."""
    package = importlib.util.find_spec("sksundae")
    if package is None or package.origin is None:
        raise ImportError(missing("sksundae"))
    folder = Path(package.origin).parent
    places = (folder.parent / "scikit_sundae.libs", folder / ".dylibs", Path(sys.prefix) / "lib")
    for place in places:
        for pattern in PATTERNS:
            for found in sorted(place.glob(pattern)):
                return found
    raise ImportError(f"scikit-sundae's CVODE library is not in {', '.join(map(str, places))}")


def load() -> tuple[ctypes.CDLL, Callable[[str], Any]]:
    """Load the library; return it, and a function from names to functions for compiled code."""
    path = library_file()
    from sksundae._cy_common import config  # how the library was built

    if config["SUNDIALS_FLOAT_TYPE"] != "double":
        raise ImportError(f"SUNDIALS was built with {config['SUNDIALS_FLOAT_TYPE']} numbers")
    index = "i" if config["SUNDIALS_INT_TYPE"] == "int" else "q"
    words = {name: word.replace("n", index) for word, names in SIGNATURES.items() for name in names.split()}
    try:
        library = ctypes.CDLL(str(path))
        for name, word in words.items():
            function = getattr(library, name)
            function.restype, *function.argtypes = (LETTERS[letter][0] for letter in word)
    except (OSError, AttributeError) as error:
        raise ImportError(f"{path.name}: {error}") from error
    version, label = [c_int(), c_int(), c_int()], ctypes.create_string_buffer(16)
    library.SUNDIALSGetVersionNumber(*map(byref, version), label, len(label))
    if version[0].value != MAJOR:
        found = ".".join(str(part.value) for part in version)
        raise ImportError(f"SUNDIALS {found}: its C interface is known for version {MAJOR} only")

    def function_of(name: str) -> Callable[..., Any]:
        address = ctypes.cast(getattr(library, name), c_void_p).value
        return external(f"contactbench_{path.stem.partition('.')[0]}_{name}", address, words[name])

    return library, function_of


library, function = load()
array_of, entries_of = function("N_VGetArrayPointer"), function("SUNDenseMatrix_Data")
reinitialise, set_stop_time = function("CVodeReInit"), function("CVodeSetStopTime")
set_max_steps, integrate, interpolate = map(function, ("CVodeSetMaxNumSteps", "CVode", "CVodeGetDky"))
steps_of, error_failures_of = function("CVodeGetNumSteps"), function("CVodeGetNumErrTestFails")
newton_failures_of = function("CVodeGetNumStepSolveFails")
pointer, integer, real = types.intp, types.int32, types.float64


@intrinsic
def _call(
    typing: object, function: object, out: object, t: object, y: object, data: object
) -> tuple[object, object]:
    """``function(out, t, y, data)`` of a C function known by its address, all pointers as integers."""
    signature = types.void(pointer, pointer, real, pointer, pointer)

    def generate(
        context: BaseContext, builder: ir.IRBuilder, _: object, arguments: list[ir.Value]
    ) -> ir.Value:
        function, out, t, y, data = arguments
        place = ir.PointerType(ir.DoubleType())
        kind = ir.FunctionType(ir.VoidType(), [place, ir.DoubleType(), place, place])
        target = builder.inttoptr(function, ir.PointerType(kind))
        out, y, data = (builder.inttoptr(p, place) for p in (out, y, data))
        builder.call(target, [out, t, y, data])
        return context.get_dummy_value()

    return signature, generate


call: Callable[..., object] = _call  # compiled code calls it without the typing context
_user = types.CPointer(types.intp)


@kept_c(integer(real, pointer, pointer, _user))
def _rhs(t, y, dy, user):  # type: ignore[no-untyped-def]
    call(user[0], array_of(dy), t, array_of(y), user[2])
    return np.int32(0)


@kept_c(integer(real, pointer, pointer, pointer, _user, pointer, pointer, pointer))
def _jacobian(t, y, dy, J, user, work1, work2, work3):  # type: ignore[no-untyped-def]
    call(user[1], entries_of(J), t, array_of(y), user[2])
    return np.int32(0)


@kept
def restart(start, memory, vector, y, data, clock, end):  # type: ignore[no-untyped-def]
    split(start, y, data, clock)
    data[RHS_CALLS] = data[JACOBIAN_CALLS] = 0.0
    reinitialise(memory, 0.0, vector)
    set_stop_time(memory, end)


@kept
def facts(memory, y, data, clock, flag, reached, saved):  # type: ignore[no-untyped-def]
    """`FACTS` and the state reached, in one vector: a call returns one array sooner than two."""
    out = np.empty(KNOWN + len(y) + (clock >= 0))
    count = np.zeros(3, np.int64)
    place = count.ctypes.data
    steps_of(memory, place)
    error_failures_of(memory, place + 8)
    newton_failures_of(memory, place + 16)
    out[0], out[1], out[2], out[3] = flag, reached, saved, count[0]
    out[4], out[5], out[6] = data[RHS_CALLS], data[JACOBIAN_CALLS], count[1] + count[2]
    join(y, reached, data, clock, out[KNOWN:])
    return out


@kept
def on_to_end(memory, vector, y, data, clock, end, max_steps):  # type: ignore[no-untyped-def]
    """Take so many more steps of a run that `to_end` has begun, at most: they are those of a single call."""
    set_max_steps(memory, max_steps)
    reached = np.zeros(1)
    flag = integrate(memory, end, vector, reached.ctypes.data, NORMAL)
    return facts(memory, y, data, clock, flag, reached[0], flag >= 0)


@kept
def to_end(start, memory, vector, y, data, clock, end, max_steps):  # type: ignore[no-untyped-def]
    restart(start, memory, vector, y, data, clock, end)
    return on_to_end(memory, vector, y, data, clock, end, max_steps)


@kept
def on_to_times(saved, times, out, memory, vector, y, data, clock, end, max_steps):  # type: ignore[no-untyped-def]
    """Take so many more steps of a run that `at_times` has begun and that has saved some states, at most."""
    flag, now = np.int32(TOO_MUCH_WORK), np.zeros(1)
    for _ in range(max_steps):
        flag = integrate(memory, end, vector, now.ctypes.data, ONE_STEP)
        if flag < 0:
            break
        there = y.copy()
        while saved < len(times) and times[saved] <= now[0]:
            if times[saved] < now[0]:
                interpolate(memory, times[saved], 0, vector)
            join(y, times[saved], data, clock, out[saved])
            for i in range(len(y)):
                y[i] = there[i]
            saved += 1
        if saved == len(times):
            break
        flag = np.int32(TOO_MUCH_WORK)
    return facts(memory, y, data, clock, flag, now[0], saved)


@kept
def at_times(start, times, out, memory, vector, y, data, clock, end, max_steps):  # type: ignore[no-untyped-def]
    """Put states at times > 0 into out (k, d), interpolated in the steps of `to_end`; returns `FACTS` and a state."""
    restart(start, memory, vector, y, data, clock, end)
    return on_to_times(0, times, out, memory, vector, y, data, clock, end, max_steps)


class Memory:
    """CVODE's memory, freed with the object; data : the argument of the C functions; bounds : on the step."""

    def __init__(
        self,
        method: str,
        functions: CFunctions,
        data: np.ndarray,
        size: int,
        tolerances: tuple[float, float | np.ndarray],
        bounds: tuple[float, float],
    ) -> None:
        self.y, self.data, self.functions = np.zeros(size), data, functions
        self.user = np.array([functions.rhs, functions.jacobian, data.ctypes.data], dtype=np.intp)
        context = c_void_p()
        check("SUNContext_Create", 0, byref(context))
        check("SUNContext_ClearErrHandlers", context)
        self.vector = library.N_VMake_Serial(size, self.y.ctypes.data, context)
        self.memory = memory = library.CVodeCreate(METHODS[method], context)
        check("CVodeInit", memory, _rhs.address, 0.0, self.vector)
        matrix = library.SUNDenseMatrix(size, size, context)
        linear = library.SUNLinSol_Dense(self.vector, matrix, context)
        weakref.finalize(self, free, library, memory, linear, matrix, self.vector, context)
        check("CVodeSetLinearSolver", memory, linear, matrix)
        rtol, atol = tolerances
        if isinstance(atol, np.ndarray):  # one for every component
            given = library.N_VMake_Serial(size, atol.ctypes.data, context)
            check("CVodeSVtolerances", memory, rtol, given)  # which copies it
            library.N_VDestroy(given)
        else:
            check("CVodeSStolerances", memory, rtol, atol)
        check("CVodeSetUserData", memory, self.user.ctypes.data)
        if functions.jacobian:
            check("CVodeSetJacFn", memory, _jacobian.address)
        check("CVodeSetMinStep", memory, bounds[0])
        check("CVodeSetMaxStep", memory, bounds[1])


def check(name: str, *arguments: object) -> None:
    if flag := getattr(library, name)(*arguments):
        raise RuntimeError(f"{name} returned {flag}")


def free(library: ctypes.CDLL, memory: int, linear: int, matrix: int, vector: int, context: c_void_p) -> None:
    library.CVodeFree(byref(c_void_p(memory)))
    library.SUNLinSolFree(linear)
    library.SUNMatDestroy(matrix)
    library.N_VDestroy(vector)
    library.SUNContext_Free(byref(context))
