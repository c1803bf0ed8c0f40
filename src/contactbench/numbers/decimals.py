"""Compute with gmpy2's numbers of any number of digits, three to six times as fast as mpmath's."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import gmpy2
import mpmath

from contactbench.numbers.protocol import Abilities, Arithmetic, Numbers

#: binary logarithm of the largest number, whose reduction by π still fits into memory
LARGEST = 4000


class Decimals(Numbers):
    """The namespace of numbers of a precision in bits, inside its `context`; huge numbers raise an error."""

    abilities = Abilities(branch=True, digits=True)

    def __init__(self, precision: int) -> None:
        self.context = gmpy2.context(precision=precision, emax=LARGEST, trap_overflow=True, trap_divzero=True)
        self.mp = mpmath.MPContext()
        self.mp.prec = precision
        self.dps: int = self.mp.dps

    def mpf(self, x: Any) -> Any:
        """Return an mpmath number, a float or a string as one of these numbers."""
        return gmpy2.mpfr(self.mp.nstr(self.mp.mpf(x), self.dps + 5) if hasattr(x, "_mpf_") else x)

    def __getattr__(self, name: str) -> Any:
        return getattr(gmpy2, name)

    @property
    def pi(self) -> Any:
        return gmpy2.const_pi()

    inf = math.inf

    def quad(self, f: Callable[[Arithmetic], Arithmetic], span: Sequence[Arithmetic]) -> Any:
        """Return mpmath's quadrature."""
        ends = [self.mp.mpf(str(x)) for x in span]
        return self.mpf(self.mp.quad(lambda x: self.mp.mpf(str(f(self.mpf(x)))), ends))


@lru_cache(8)
def of_precision(precision: int) -> Decimals:
    return Decimals(precision)


def current() -> Decimals:
    """Return the namespace of gmpy2's current precision."""
    return of_precision(gmpy2.get_context().precision)
