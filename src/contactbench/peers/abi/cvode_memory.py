"""CVODE's memory: allocated, set up and freed."""

from __future__ import annotations

import weakref
from ctypes import byref, c_void_p
from typing import Any

import numpy as np

from contactbench.peers.abi import cvode_calls
from contactbench.peers.abi.cvode import Library, library
from contactbench.peers.c_functions import CFunctions


class Memory:
    """CVODE's memory for one scene, method and tolerance; freed with the object.

    functions, data : the scene's C functions and their argument; size : of the state; shortest, longest : bounds
    on the step.
    """

    def __init__(
        self,
        kind: int,
        functions: CFunctions,
        data: np.ndarray,
        size: int,
        tolerances: tuple[float, float],
        shortest: float,
        longest: float,
    ) -> None:
        lib = library()
        assert isinstance(lib, Library)
        self.y, self.data, self.functions = np.zeros(size), data, functions
        self.user = np.array([functions.rhs, functions.jacobian, data.ctypes.data], dtype=np.intp)
        context = c_void_p()
        _check(lib.SUNContext_Create(0, byref(context)), "SUNContext_Create")
        _check(lib.SUNContext_ClearErrHandlers(context), "SUNContext_ClearErrHandlers")
        self.vector = lib.N_VMake_Serial(size, self.y.ctypes.data, context)
        self.memory = lib.CVodeCreate(kind, context)
        matrix = lib.SUNDenseMatrix(size, size, context)
        linear = lib.SUNLinSol_Dense(self.vector, matrix, context)
        if not (self.vector and self.memory and matrix and linear):
            raise MemoryError("CVODE could not allocate its memory")
        weakref.finalize(self, _free, lib, self.memory, linear, matrix, self.vector, context)
        settings: tuple[tuple[Any, ...], ...] = (
            ("CVodeInit", cvode_calls.RHS, 0.0, self.vector),
            ("CVodeSStolerances", *tolerances),
            ("CVodeSetUserData", self.user.ctypes.data),
            ("CVodeSetLinearSolver", linear, matrix),
            *([("CVodeSetJacFn", cvode_calls.JACOBIAN)] if functions.jacobian else []),
            ("CVodeSetMinStep", shortest),
            ("CVodeSetMaxStep", longest),
        )
        for name, *values in settings:
            _check(getattr(lib, name)(self.memory, *values), name)


def _check(flag: int, call: str) -> None:
    if flag:
        raise RuntimeError(f"{call} returned {flag}")


def _free(lib: Library, memory: int, linear: int, matrix: int, vector: int, context: c_void_p) -> None:
    lib.CVodeFree(byref(c_void_p(memory)))
    lib.SUNLinSolFree(linear)
    lib.SUNMatDestroy(matrix)
    lib.N_VDestroy(vector)
    lib.SUNContext_Free(byref(context))
