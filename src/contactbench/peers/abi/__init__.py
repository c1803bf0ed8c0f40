"""What is not public in the libraries of the peers: the symbols of CVODE, the C interface of CyRK.

A C signature is written as a word, a letter for the result and one for every argument; ctypes and numba read the
same word.
"""

from __future__ import annotations

import ctypes
from typing import Any

#: v void, p pointer, a array of doubles, d double, b bool, i int, l long, q 64-bit int, z size_t
#: as ctypes has them, and as numba calls them
LETTERS: dict[str, tuple[Any, str]] = {
    "v": (None, "none"),
    "p": (ctypes.c_void_p, "intp"),
    "a": (ctypes.c_void_p, ""),
    "d": (ctypes.c_double, "float64"),
    "b": (ctypes.c_bool, "boolean"),
    "i": (ctypes.c_int, "int32"),
    "l": (ctypes.c_long, "long_"),
    "q": (ctypes.c_int64, "int64"),
    "z": (ctypes.c_size_t, "uintp"),
}
#: what a compiled call returns of a run, followed by the packed state reached
FACTS = ("flag", "reached", "saved", "steps", "evaluations", "jacobians", "rejected")
KNOWN = len(FACTS)


def signature(word: str) -> tuple[Any, tuple[Any, ...]]:
    """Return the result and the arguments of a C function, as ctypes has them."""
    result, *arguments = (LETTERS[letter][0] for letter in word)
    return result, tuple(arguments)
