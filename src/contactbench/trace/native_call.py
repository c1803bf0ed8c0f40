"""Calls of compiled programs from Python: by ctypes, with one pointer to a block of where their arrays are."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

#: a program, which runs without the interpreter's lock; with types of arguments a call would take half as long again
PROGRAM = ctypes.CFUNCTYPE(ctypes.c_int64)
#: the same where nobody asks for what it returns
QUIET = ctypes.CFUNCTYPE(None)
DOUBLE = np.dtype(np.float64)
#: the type of an array and its number of dimensions
Kind = tuple[np.dtype, int]
#: what a block says of an array: its address, its length, the length of a row
WORDS = 3
#: what lies at an address
ANYTHING = ctypes.c_char * 0
#: doubles up to which the memory of a call is kept for the next one
SMALL = 2**12


def words(array: np.ndarray, kind: Kind) -> tuple[int, int, int]:
    """Return what a block says of a contiguous array; raise `TypeError` for any other."""
    if type(array) is not np.ndarray or (array.dtype, array.ndim) != kind or not array.flags.c_contiguous:
        raise TypeError(f"a contiguous array of {kind[0]} in {kind[1]} dimensions is needed")
    shape = array.shape
    return address(array), shape[0], shape[-1]


def address(array: np.ndarray) -> int:
    if not array.flags.writeable:
        return int(array.ctypes.data)
    return ctypes.addressof(ANYTHING.from_buffer(array))  # three times as fast


def block_of(words: Sequence[int]) -> Any:
    """Return a pointer to a block, which lives as long."""
    return ctypes.byref((ctypes.c_int64 * len(words))(*words))


class Native:
    """A compiled program of arrays, the last of which it writes to; it may be called from several threads.

    Parameters
    ----------
    at
        The address of a C function ``int64_t (const int64_t *block)``.
    kinds
        Of its arrays.
    """

    def __init__(self, at: int, kinds: Sequence[Kind]) -> None:
        self.program, self.quiet, self.kinds = PROGRAM(at), QUIET(at), tuple(kinds)

    def __call__(self, *arrays: np.ndarray) -> int:
        """Return what the program does; raise `TypeError` for arrays that it does not take."""
        if len(arrays) != len(self.kinds):
            raise TypeError(f"{len(arrays)} arrays: the program takes {len(self.kinds)}")
        block = [word for array, kind in zip(arrays, self.kinds, strict=True) for word in words(array, kind)]
        if not arrays[-1].flags.writeable:
            raise TypeError("the last array is written to, and this one is read-only")
        result: int = self.program(block_of(block))
        return result

    def bind(
        self, d: int, w: np.ndarray, shape: np.ndarray, size: int, part: slice, flagged: bool
    ) -> Callable[[np.ndarray], Any]:
        """Return a program of (start, w, shape, after) as the fastest function there is of the start, d doubles.

        It returns a part of both (d doubles of the start, then `size` of what is after it), as a new array, and where
        it is `flagged` what the program returns too; it raises `TypeError` for any other start.
        """
        program: Callable[[object], Any] = self.program if flagged else self.quiet
        double, small = DOUBLE, d + size <= SMALL
        spare: list[tuple[np.ndarray, Callable[[], np.ndarray], Any]] = []

        def memory() -> tuple[np.ndarray, Callable[[], np.ndarray], Any]:
            y = np.empty(d + size)
            at, found = address(y), y[part]
            given = *words(w, self.kinds[1]), *words(shape, self.kinds[2])
            block = block_of((at, d, d, *given, at + y.itemsize * d, size, size))
            return y[:d], found.copy if small else lambda: found, block

        def call(y0: np.ndarray) -> Any:
            if (y0.dtype is not double and y0.dtype != double) or len(y0) != d:
                raise TypeError(f"a state is an array of {d} doubles")
            try:
                own = spare.pop()  # no other thread has it meanwhile
            except IndexError:
                own = memory()
            start, take, block = own
            start[...] = y0
            result = program(block)
            found = take()
            if small:
                spare.append(own)
            return (found, result) if flagged else found

        return call
