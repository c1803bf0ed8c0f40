"""Call compiled programs from Python by ctypes: the one argument points to a block with the addresses of the arrays."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

#: the C function; it runs without the interpreter's lock. Declared argument types would make a call half as long again
PROGRAM = ctypes.CFUNCTYPE(ctypes.c_int64)
#: the same function, its result ignored
QUIET = ctypes.CFUNCTYPE(None)
DOUBLE = np.dtype(np.float64)
#: the dtype of an array and its number of dimensions
Kind = tuple[np.dtype, int]
#: words of the block for each array: its address, its length, the length of a row
WORDS = 3
#: a ctypes object of no bytes, to find the address of a buffer
ANYTHING = ctypes.c_char * 0
#: results of up to so many doubles are copied, and their buffer serves the next call
SMALL = 2**12


def words(array: np.ndarray, kind: Kind) -> tuple[int, int, int]:
    """Return the words of the block for a contiguous array; raise `TypeError` for any other."""
    if type(array) is not np.ndarray or (array.dtype, array.ndim) != kind or not array.flags.c_contiguous:
        raise TypeError(f"a contiguous array of {kind[0]} in {kind[1]} dimensions is needed")
    shape = array.shape
    return address(array), shape[0], shape[-1]


def address(array: np.ndarray) -> int:
    if not array.flags.writeable:
        return int(array.ctypes.data)
    return ctypes.addressof(ANYTHING.from_buffer(array))  # three times as fast


def block_of(words: Sequence[int]) -> Any:
    """Return a pointer to a new block; the pointer keeps the block alive."""
    return ctypes.byref((ctypes.c_int64 * len(words))(*words))


class Native:
    """A compiled program that works on arrays and writes to the last one; several threads may call it.

    Parameters
    ----------
    at
        The address of a C function ``int64_t (const int64_t *block)``.
    kinds
        The dtype and the number of dimensions of each array.
    """

    def __init__(self, at: int, kinds: Sequence[Kind]) -> None:
        self.program, self.quiet, self.kinds = PROGRAM(at), QUIET(at), tuple(kinds)

    def __call__(self, *arrays: np.ndarray) -> int:
        """Return the result of the program; raise `TypeError` for arrays of another kind."""
        if len(arrays) != len(self.kinds):
            raise TypeError(f"{len(arrays)} arrays: the program takes {len(self.kinds)}")
        block = [word for array, kind in zip(arrays, self.kinds, strict=True) for word in words(array, kind)]
        if not arrays[-1].flags.writeable:
            raise TypeError("the last array is written to, and this one is read-only")
        result: int = self.program(block_of(block))
        return result

    def closed(self, *arrays: np.ndarray) -> Callable[[], int]:
        """Return the call on these arrays, which it keeps: what they hold may change."""
        program, pairs = self.program, zip(arrays, self.kinds, strict=True)
        block = block_of([word for array, kind in pairs for word in words(array, kind)])
        return lambda arrays=arrays: program(block)  # type: ignore[misc]

    def bind(
        self, d: int, given: Sequence[np.ndarray], size: int, part: slice, flagged: bool
    ) -> Callable[[np.ndarray], Any]:
        """Return a function of the start alone, d doubles, of a program of (start, *given, after).

        `after` has `size` doubles.  The function joins start and `after`, and returns `part` of them as a new array,
        with the result of the program too if it is `flagged`.  It raises `TypeError` for any other start.
        """
        program: Callable[[object], Any] = self.program if flagged else self.quiet
        double, small = DOUBLE, d + size <= SMALL
        spare: list[tuple[np.ndarray, Callable[[], np.ndarray], Any]] = []

        def memory() -> tuple[np.ndarray, Callable[[], np.ndarray], Any]:
            y = np.empty(d + size)
            at, found = address(y), y[part]
            pairs = zip(given, self.kinds[1:-1], strict=True)
            middle = [word for array, kind in pairs for word in words(array, kind)]
            block = block_of((at, d, d, *middle, at + y.itemsize * d, size, size))
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
