"""Compiled code between CyRK's C++ solvers and a scene's C functions; every call makes and frees a result."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import CyRK
import numpy as np
from CyRK import get_error_message
from CyRK.cy.pyhelpers import find_ode_method_int
from CyRK.nb import numba_c_api

from contactbench.peers.abi import external, join, kept, split
from contactbench.peers.compiled import KNOWN, RHS_CALLS, SUCCESS, TOO_MANY_STEPS, TOO_MANY_STEPS_SO_FAR

__all__ = ["at_times", "find_ode_method_int", "get_error_message", "to_end"]

#: the version whose C interface is known
INTERFACE = "0.20."
if not CyRK.__version__.startswith(INTERFACE):
    why = f"CyRK {CyRK.__version__} may have another C interface than {INTERFACE}, which this is written for"
    raise ImportError(why)


def function(name: str, word: str) -> Callable[..., Any]:
    return external(f"contactbench_cyrk_{name}", getattr(numba_c_api, f"get_{name}_func_ptr")(), word)


integrate = function("solve", "ppddpzizzpzzzbpzppzpzpzddb")
status_of, size_of, steps_of = function("status", "ip"), function("size", "zp"), function("steps_taken", "zp")
states_of, time_of, free = function("y", "ap"), function("t_now", "dp"), function("free", "vp")
arguments_of = external("contactbench_cyrk_arguments", numba_c_api.get_args_ptr_func_ptr(), "ap")
state_of = external("contactbench_cyrk_state", numba_c_api.get_y_now_ptr_func_ptr(), "ap")

#: no limit on memory but the number of steps; megabytes
UNLIMITED = 1_000_000
#: what CyRK is not given: an expected size, extra outputs, a function before the right-hand side, events
NOTHING = 0


@kept
def solve(rhs, method, start, data, times, end, rtol, atol, max_steps):  # type: ignore[no-untyped-def]
    """Return CyRK's result; times : of saved states, none for every step; rtol, atol : arrays, atol (1,) or (d,)."""
    state = (rhs, 0.0, end, start.ctypes.data, len(start))
    problem = (*state, method, NOTHING, NOTHING, data.ctypes.data, data.size * 8)
    saves = (max_steps, UNLIMITED, False, times.ctypes.data, times.size, NOTHING, NOTHING, NOTHING)
    # no bound on the step, the first chosen by the solver, which is kept: it knows where it stopped
    steps = (rtol.ctypes.data, 1, atol.ctypes.data, atol.size, np.inf, 0.0, True)
    return integrate(*(problem + saves + steps))


@kept
def facts(result, y, data, clock, saved):  # type: ignore[no-untyped-def]
    """`FACTS` and the state reached; frees the result.  CyRK counts a step that failed, and no rejected ones."""
    out = np.empty(KNOWN + len(y) + (clock >= 0))
    status = status_of(result)
    failed = status != SUCCESS and status != TOO_MANY_STEPS and status != TOO_MANY_STEPS_SO_FAR
    out[0], out[1], out[2], out[3] = status, time_of(result), saved, steps_of(result) - failed
    out[4] = arguments_of(result)[RHS_CALLS]  # CyRK works on a copy of the data
    out[5], out[6] = 0.0, np.nan
    join(state_of(result), out[1], data, clock, out[KNOWN:])
    free(result)
    return out


@kept
def separate(start, data, clock):  # type: ignore[no-untyped-def]
    """Return what CyRK is given of a packed state: the vector less the time, and data of the run's own with it."""
    y, own = np.empty(len(start) - (clock >= 0)), data.copy()
    split(start, y, own, clock)
    return y, own


@kept
def to_end(start, rhs, method, data, clock, end, rtol, atol, max_steps):  # type: ignore[no-untyped-def]
    y, own = separate(start, data, clock)
    result = solve(rhs, method, y, own, np.empty(0), end, rtol, atol, max_steps)
    return facts(result, y, own, clock, status_of(result) == SUCCESS)


@kept
def at_times(start, times, out, rhs, method, data, clock, end, rtol, atol, max_steps):  # type: ignore[no-untyped-def]
    """Put states at increasing times > 0 into out (k, d), interpolated; returns `FACTS` and the state reached."""
    y, own = separate(start, data, clock)
    d, row = len(y), np.empty(len(y))
    result = solve(rhs, method, y, own, times, end, rtol, atol, max_steps)
    saved: Any = min(np.int64(size_of(result)), len(times))
    states = states_of(result)
    for k in range(saved):
        for i in range(d):
            row[i] = states[k * d + i]
        join(row, times[k], own, clock, out[k])
    if saved == len(times):  # the last time is the solver's own, no interpolation
        join(state_of(result), times[-1], own, clock, out[saved - 1])
    return facts(result, y, own, clock, saved)
