"""Compiled code between CyRK's C++ solvers and a scene's C functions.  Importing it loads CyRK and numba.

Numbers are copied one by one: an assignment of a slice takes numba seconds to compile the first time, most of
them for the text of the error that arrays of different lengths raise.

`to_end` is the bare call: a state in, the state at the end out.  Every call makes and frees a result of its own.
"""

from __future__ import annotations

from typing import Any

import llvmlite.binding
import numba
import numpy as np
from CyRK import get_error_message
from CyRK.cy.pyhelpers import find_ode_method_int
from CyRK.nb import numba_c_api
from numba import types

from contactbench.peers.abi.cyrk_interface import GETTERS, KNOWN
from contactbench.peers.abi.native_time import join, split
from contactbench.peers.c_functions import RHS_CALLS

pointer, size, real, flag = types.intp, types.uintp, types.float64, types.boolean
doubles = types.CPointer(types.float64)


def _function(name: str, address: int, result: Any, *arguments: Any) -> Any:
    symbol = f"contactbench_cyrk_{name}"
    llvmlite.binding.add_symbol(symbol, address)
    return types.ExternalFunction(symbol, result(*arguments))


def _getter(name: str, result: Any) -> Any:
    return _function(name, getattr(numba_c_api, GETTERS[name][0])(), result, pointer)


integrate = _function(
    "solve", numba_c_api.get_solve_func_ptr(), pointer,
    pointer, real, real, pointer, size, types.int32, size, size, pointer, size, size, size, flag, pointer, size,
    pointer, pointer, size, pointer, size, pointer, size, real, real, flag,
)  # fmt: skip
status_of, size_of, steps_of = _getter("status", types.int32), _getter("size", size), _getter("steps", size)
states_of, arguments_of = _getter("states", doubles), _getter("arguments", doubles)
time_of, state_of = _getter("time", real), _getter("state", doubles)
free = _getter("free", types.void)

#: no limit on memory but the number of steps; megabytes
UNLIMITED = 1_000_000


@numba.njit(cache=True)
def solve(rhs, method, start, data, times, end, rtol, atol, max_steps):  # type: ignore[no-untyped-def]
    """CyRK's result; times : where states are wanted, none for every step."""
    tolerances = np.array([rtol, atol])
    place = tolerances.ctypes.data
    return integrate(
        rhs, 0.0, end, start.ctypes.data, len(start), method,
        0, 0,  # expected size, extra outputs
        data.ctypes.data, data.size * 8,
        max_steps, UNLIMITED,
        False, times.ctypes.data, times.size,
        0, 0, 0,  # no function before the right-hand side, no events
        place, 1, place + 8, 1,
        np.inf, 0.0,  # longest step; first step, chosen by the solver
        True,  # keep the solver, which knows where it stopped
    )  # fmt: skip


@numba.njit(cache=True)
def told(result, y, data, clock, saved):  # type: ignore[no-untyped-def]
    """How a run ended and what it took, in the order of `FACTS`, and the state reached; frees the result."""
    facts = np.empty(KNOWN + len(y) + (clock >= 0))
    facts[0], facts[1], facts[2], facts[3] = status_of(result), time_of(result), saved, steps_of(result)
    facts[4] = arguments_of(result)[RHS_CALLS]  # CyRK works on a copy of the data
    join(state_of(result), facts[1], data, clock, facts[KNOWN:])
    free(result)
    return facts


@numba.njit(cache=True)
def begun(start, data, clock):  # type: ignore[no-untyped-def]
    """What CyRK is given of a packed state: the vector less the time, and data of the run's own with it."""
    y, own = np.empty(len(start) - (clock >= 0)), data.copy()
    split(start, y, own, clock)
    return y, own


@numba.njit(cache=True)
def to_end(rhs, method, start, data, clock, end, rtol, atol, max_steps):  # type: ignore[no-untyped-def]
    """`FACTS` and the state at the end, in one vector."""
    y, own = begun(start, data, clock)
    result = solve(rhs, method, y, own, np.empty(0), end, rtol, atol, max_steps)
    return told(result, y, own, clock, status_of(result) == 1)


@numba.njit(cache=True)
def in_a_loop(rhs, method, starts, data, clock, end, rtol, atol, max_steps):  # type: ignore[no-untyped-def]
    """`to_end` for one start (n, d) after the other, a row each."""
    out = np.empty((len(starts), KNOWN + starts.shape[1]))
    for k in range(len(starts)):
        row = to_end(rhs, method, starts[k], data, clock, end, rtol, atol, max_steps)
        for i in range(len(row)):
            out[k, i] = row[i]
    return out


@numba.njit(cache=True)
def at_times(rhs, method, start, data, clock, times, rtol, atol, max_steps, out):  # type: ignore[no-untyped-def]
    """States at increasing times > 0 into out (k, d), interpolated; returns `FACTS` and the state reached."""
    y, own = begun(start, data, clock)
    d, row = len(y), np.empty(len(y))
    result = solve(rhs, method, y, own, times, times[-1], rtol, atol, max_steps)
    saved: Any = min(np.int64(size_of(result)), len(times))
    states = states_of(result)
    for k in range(saved):
        for i in range(d):
            row[i] = states[k * d + i]
        join(row, times[k], own, clock, out[k])
    if saved == len(times):  # the last time is the solver's own, no interpolation
        join(state_of(result), times[-1], own, clock, out[saved - 1])
    return told(result, y, own, clock, saved)


def number(method: str) -> int:
    """CyRK's number of a method."""
    return int(find_ode_method_int(method))


def message(status: int) -> str:
    """What a status means, in CyRK's words."""
    return str(get_error_message(status)).rstrip(".")
