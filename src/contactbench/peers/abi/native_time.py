"""Packed states in compiled code: a solver integrates them less the time, which is its own."""

from __future__ import annotations

import numba

from contactbench.peers.c_functions import ORIGIN


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
