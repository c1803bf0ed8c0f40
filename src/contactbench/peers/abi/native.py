"""Compiled code around the solvers: C functions by their address, and packed states without the time."""

from __future__ import annotations

from typing import Any

import llvmlite.binding
import numba
from numba import types

from contactbench.peers.abi import LETTERS
from contactbench.peers.c_functions import ORIGIN


def type_of(letter: str) -> Any:
    return types.CPointer(types.float64) if letter == "a" else getattr(types, LETTERS[letter][1])


def external(name: str, address: int, word: str) -> Any:
    """Return a C function that compiled code can call."""
    llvmlite.binding.add_symbol(name, address)
    result, *arguments = map(type_of, word)
    return types.ExternalFunction(name, result(*arguments))


@numba.njit(cache=True)
def split(state, y, data, clock):  # type: ignore[no-untyped-def]
    """A packed state into a solver's vector, its time, where it has one (clock ≥ 0), into `data`."""
    for i in range(len(y)):
        y[i] = state[i + (0 <= clock <= i)]
    if clock >= 0:
        data[ORIGIN] = state[clock]


@numba.njit(cache=True)
def join(y, t, data, clock, state):  # type: ignore[no-untyped-def]
    """The packed state of a solver's vector, t after it began."""
    for i in range(len(state) - (clock >= 0)):
        state[i + (0 <= clock <= i)] = y[i]
    if clock >= 0:
        state[clock] = data[ORIGIN] + t
