"""What is not public in the libraries of the peers: the symbols of CVODE, the C interface of CyRK.

A C signature is written as a word, a letter for the result and one for every argument; ctypes and numba read the
same word.  Imported where a peer is first run, and only then: importing it loads numba.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

import llvmlite.binding
from numba import types

from contactbench.peers import compiled
from contactbench.peers.by_numba import keep, keep_c
from contactbench.peers.compiled import ORIGIN
from contactbench.trace.form import digest

#: v void, p pointer, a array of doubles, d double, b bool, i int, l long, q 64-bit int, z size_t
#: as ctypes has them, and as numba does
LETTERS: dict[str, tuple[type | None, types.Type]] = {
    "v": (None, types.none),
    "p": (ctypes.c_void_p, types.intp),
    "a": (ctypes.c_void_p, types.CPointer(types.float64)),
    "d": (ctypes.c_double, types.float64),
    "b": (ctypes.c_bool, types.boolean),
    "i": (ctypes.c_int, types.int32),
    "l": (ctypes.c_long, types.long_),
    "q": (ctypes.c_int64, types.int64),
    "z": (ctypes.c_size_t, types.uintp),
}

#: the compiled code here depends on all of it
SOURCES = digest(
    *(path.read_bytes() for path in (*sorted(Path(__file__).parent.glob("*.py")), Path(compiled.__file__)))
)


def kept[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """Compile as numba's `njit` does, and keep the program."""
    made: Callable[P, R] = keep(function, SOURCES, nogil=True)
    return made


def kept_c(*signature: Any) -> Any:
    """Compile as numba's `cfunc` does, and keep the program."""
    return lambda function: keep_c(function, *signature, SOURCES)


def external(name: str, address: int | None, word: str) -> Callable[..., Any]:
    llvmlite.binding.add_symbol(name, address)
    result, *arguments = (LETTERS[letter][1] for letter in word)
    return types.ExternalFunction(name, result(*arguments))


# -- packed states without the time; number by number: numba takes seconds to compile the first assignment of a slice
@kept
def split(state, y, data, clock):  # type: ignore[no-untyped-def]
    """Put a packed state into a solver's vector, its time, where it has one (clock ≥ 0), into `data`."""
    for i in range(len(y)):
        y[i] = state[i + (0 <= clock <= i)]
    if clock >= 0:
        data[ORIGIN] = state[clock]


@kept
def join(y, t, data, clock, state):  # type: ignore[no-untyped-def]
    """Put together the packed state of a solver's vector, t after it began."""
    for i in range(len(state) - (clock >= 0)):
        state[i + (0 <= clock <= i)] = y[i]
    if clock >= 0:
        state[clock] = data[ORIGIN] + t
