"""Compiled code between CVODE's C library and a scene's C functions.  Importing it loads both numba and the library.

Numbers are copied one by one: numba takes seconds to compile the first assignment of a slice, for the text of the
error that arrays of different lengths raise.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from contactbench.peers.abi import KNOWN
from contactbench.peers.abi.cvode import FUNCTIONS, NORMAL, ONE_STEP, TOO_MUCH_WORK, Library, library
from contactbench.peers.abi.native import external, join, split
from contactbench.peers.c_functions import JACOBIAN_CALLS, RHS_CALLS

_found = library()
assert isinstance(_found, Library), _found
_library: Library = _found

pointer, integer, real = types.intp, types.int32, types.float64


def _function(name: str) -> Any:
    return external(name, _library.address(name), FUNCTIONS[name])


array_of = _function("N_VGetArrayPointer")
entries_of = _function("SUNDenseMatrix_Data")
reinitialise = _function("CVodeReInit")
set_stop_time = _function("CVodeSetStopTime")
set_max_steps = _function("CVodeSetMaxNumSteps")
advance = _function("CVode")
interpolate = _function("CVodeGetDky")
steps_of = _function("CVodeGetNumSteps")
error_failures_of = _function("CVodeGetNumErrTestFails")
newton_failures_of = _function("CVodeGetNumStepSolveFails")


@intrinsic
def _call(typing: Any, function: Any, out: Any, t: Any, y: Any, data: Any) -> Any:
    """``function(out, t, y, data)`` of a C function known by its address, all pointers as integers."""
    signature = types.void(pointer, pointer, real, pointer, pointer)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        function, out, t, y, data = arguments
        place = ir.PointerType(ir.DoubleType())
        kind = ir.FunctionType(ir.VoidType(), [place, ir.DoubleType(), place, place])
        target = builder.inttoptr(function, ir.PointerType(kind))
        out, y, data = (builder.inttoptr(p, place) for p in (out, y, data))
        builder.call(target, [out, t, y, data])
        return context.get_dummy_value()

    return signature, generate


call: Any = _call  # compiled code calls it without the typing context

_user = types.CPointer(types.intp)


@numba.cfunc(integer(real, pointer, pointer, _user), cache=True)
def _rhs(t, y, dy, user):  # type: ignore[no-untyped-def]
    call(user[0], array_of(dy), t, array_of(y), user[2])
    return np.int32(0)


@numba.cfunc(integer(real, pointer, pointer, pointer, _user, pointer, pointer, pointer), cache=True)
def _jacobian(t, y, dy, J, user, work1, work2, work3):  # type: ignore[no-untyped-def]
    call(user[1], entries_of(J), t, array_of(y), user[2])
    return np.int32(0)


#: what CVodeInit and CVodeSetJacFn are given
RHS, JACOBIAN = _rhs.address, _jacobian.address


@numba.njit(cache=True)
def restart(start, memory, vector, y, data, clock, end):  # type: ignore[no-untyped-def]
    """Back to t = 0 and a state; the calls counted from zero."""
    split(start, y, data, clock)
    data[RHS_CALLS] = data[JACOBIAN_CALLS] = 0.0
    reinitialise(memory, 0.0, vector)
    set_stop_time(memory, end)


@numba.njit(cache=True)
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


@numba.njit(cache=True)
def to_end(start, memory, vector, y, data, clock, end, max_steps):  # type: ignore[no-untyped-def]
    """`FACTS` and the state at the end."""
    restart(start, memory, vector, y, data, clock, end)
    set_max_steps(memory, max_steps)
    reached = np.zeros(1)
    flag = advance(memory, end, vector, reached.ctypes.data, NORMAL)
    return facts(memory, y, data, clock, flag, reached[0], flag >= 0)


@numba.njit(cache=True)
def in_a_loop(starts, memory, vector, y, data, clock, end, max_steps):  # type: ignore[no-untyped-def]
    """`to_end` for one start (n, d) after the other, a row each."""
    out = np.empty((len(starts), KNOWN + starts.shape[1]))
    for k in range(len(starts)):
        row = to_end(starts[k], memory, vector, y, data, clock, end, max_steps)
        for i in range(len(row)):
            out[k, i] = row[i]
    return out


@numba.njit(cache=True)
def at_times(start, times, out, memory, vector, y, data, clock, end, max_steps):  # type: ignore[no-untyped-def]
    """States at increasing times > 0 into out (k, d), interpolated; returns `FACTS` and the state reached.

    One internal step at a time, so that the steps are those of `to_end`: in CVODE's other mode the first
    step depends on the first time asked for.
    """
    restart(start, memory, vector, y, data, clock, end)
    saved, flag, now = 0, np.int32(TOO_MUCH_WORK), np.zeros(1)
    for _ in range(max_steps):
        flag = advance(memory, end, vector, now.ctypes.data, ONE_STEP)
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
