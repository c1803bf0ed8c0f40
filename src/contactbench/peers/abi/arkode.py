"""ARKODE's SPRKStep, in the library that sundials4py ships, and compiled code between it and a scene's C functions.

Reference: https://sundials.readthedocs.io/en/latest/arkode/Usage/SPRKStep (C interface, version 7).
"""

from __future__ import annotations

import importlib.util
import weakref
from ctypes import byref, c_void_p
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from contactbench.checks import missing
from contactbench.peers.abi import kept, kept_c
from contactbench.peers.abi.cvode import (
    NORMAL,
    _user,
    bind,
    call,
    free,
    integer,
    pointer,
    real,
    require_major,
)

#: no interpolation: a run ends on a step
NO_INTERPOLANT = -1
SIGNATURES = {
    "iip": "SUNContext_Create",
    "ip": "SUNContext_ClearErrHandlers SUNContext_Free",
    "vp": "N_VDestroy ARKodeFree",
    "pp": "N_VGetArrayPointer",
    "pnpp": "N_VMake_Serial",
    "pppdpp": "SPRKStepCreate",
    "ipp": "SPRKStepSetMethodName ARKodeSetUserData",
    "ipi": "ARKodeSetInterpolantType",
    "ipl": "ARKodeSetMaxNumSteps",
    "ipd": "ARKodeSetFixedStep ARKodeSetStopTime",
    "ipdp": "ARKodeReset",
    "ipdppi": "ARKodeEvolve",
}

place = importlib.util.find_spec("sundials4py")
if place is None or place.origin is None:
    raise ImportError(missing("sundials4py"))
require_major(version("sundials4py"))
library, function = bind(Path(place.origin), SIGNATURES, "q")

array_of, reset, evolve = map(function, ("N_VGetArrayPointer", "ARKodeReset", "ARKodeEvolve"))
set_fixed_step, set_stop_time = function("ARKodeSetFixedStep"), function("ARKodeSetStopTime")


@kept_c(integer(real, pointer, pointer, _user))
def _kick(t, y, dy, user):  # type: ignore[no-untyped-def]
    call(user[0], array_of(dy), t, array_of(y), user[1])
    return np.int32(0)


@kept_c(integer(real, pointer, pointer, _user))
def _drift(t, y, dy, user):  # type: ignore[no-untyped-def]
    call(user[2], array_of(dy), t, array_of(y), user[3])
    return np.int32(0)


@kept
def stretch(state, over_m, gamma, clock, y: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
    """A packed state of the scene as (z, τ, origin, z', e^{γτ}(s − q·p/2)) at τ = 0; no origin without a clock."""
    n, timed, product = len(over_m), clock >= 0, 0.0
    for i in range(n):
        q, p = state[i], state[n + i]
        y[i], y[n + 1 + timed + i] = q, p * over_m[i] + gamma / 2 * q
        product += q * p
    y[n] = 0.0
    if timed:
        y[n + 1] = state[clock]
    if len(state) > 2 * n + timed:
        y[-1] = state[-1] - product / 2
    return y


@kept
def unstretch(y, over_m, gamma, clock, state: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
    """The packed state of the scene again."""
    n, timed, product = len(over_m), clock >= 0, 0.0
    shrunk = np.exp(-gamma * y[n] / 2)
    for i in range(n):
        q = shrunk * y[i]
        p = (shrunk * y[n + 1 + timed + i] - gamma / 2 * q) / over_m[i]
        state[i], state[n + i] = q, p
        product += q * p
    if timed:
        state[clock] = y[n + 1] + y[n]
    if len(state) > 2 * n + timed:
        state[-1] = shrunk * shrunk * y[-1] + product / 2
    return state


@kept
def take(h, n, y, memory, vector):  # type: ignore[no-untyped-def]
    """n steps of h from y, the array of the vector, on."""
    reset(memory, 0.0, vector)
    set_fixed_step(memory, h)
    set_stop_time(memory, n * h)
    if evolve(memory, n * h, vector, np.zeros(1).ctypes.data, NORMAL) < 0:
        y[:] = np.nan


@kept
def advance(state, over_m, gamma, clock, h, n, y, memory, vector):  # type: ignore[no-untyped-def]
    stretch(state, over_m, gamma, clock, y)
    take(h, n, y, memory, vector)
    return unstretch(y, over_m, gamma, clock, np.empty(len(state)))


class Memory:
    """ARKODE's memory, freed with the object; y : the vector it works on."""

    def __init__(self, method: str, kick: Any, drift: Any, numbers: list[float], size: int) -> None:
        self.y, self.functions = np.zeros(size), (kick, drift)
        self.data = [part.data(numbers) for part in self.functions]
        addresses = [(part.rhs, own.ctypes.data) for part, own in zip(self.functions, self.data, strict=True)]
        self.user = np.array(addresses, dtype=np.intp)
        context = c_void_p()
        library.SUNContext_Create(0, byref(context))
        library.SUNContext_ClearErrHandlers(context)
        self.vector = library.N_VMake_Serial(size, self.y.ctypes.data, context)
        self.memory = library.SPRKStepCreate(_kick.address, _drift.address, 0.0, self.vector, context)
        weakref.finalize(self, free, library, "ARKodeFree", self.memory, {}, self.vector, context)
        library.SPRKStepSetMethodName(self.memory, method.encode())
        library.ARKodeSetUserData(self.memory, self.user.ctypes.data)
        library.ARKodeSetInterpolantType(self.memory, NO_INTERPOLANT)
        library.ARKodeSetMaxNumSteps(self.memory, -1)

    def take(self, h: float, n: int) -> None:
        take(h, n, self.y, self.memory, self.vector)
