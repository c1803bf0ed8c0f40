"""Functions sin, exp, … of all kinds of numbers that scenes run on (``cb.math``).

A scene is written once and runs on floats, NumPy arrays, JAX tracers, mpmath numbers, heyoka's expressions and reals,
dual and recorded numbers.  Each kind has its own arithmetic and powers; the functions here call the implementation
that fits their argument::

    potential=lambda q: -cb.math.cos(q[0]), gradient=lambda q: (cb.math.sin(q[0]),)

They are total, as NumPy's are: outside its domain a function of floats is nan, beyond the range of floats inf.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from contactbench.numbers.protocol import Arithmetic, ChoosingNamespace, Condition, Number
from contactbench.xla import jnp

__all__ = ["acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cos", "cosh", "exp", "expm1"]
__all__ += ["hypot", "log", "log1p", "pi", "sin", "sinh", "sqrt", "tan", "tanh", "where"]

pi = math.pi


#: where logarithms are −∞
POLES = {"log": 0, "log1p": -1}


def namespace(x: object) -> Any:
    """Return the namespace with the functions of a number."""
    if isinstance(x, int | float):
        return math
    if isinstance(x, Number):
        return x.numbers
    package = type(x).__module__.partition(".")[0]
    if package in ("jax", "jaxlib"):
        return jnp
    if package == "mpmath":
        return x.context  # type: ignore[attr-defined]
    if package == "gmpy2":
        from contactbench.numbers.decimals import current

        return current()
    if package == "heyoka" and type(x).__name__ == "expression":
        import heyoka

        return heyoka
    return np


def call(name: str, own: Callable[..., Arithmetic], *numbers: Arithmetic) -> Arithmetic:
    """Call the function of that name of the numbers' own namespace, or ``own`` entry by entry of arrays of objects."""
    first = leading(*numbers)
    if isinstance(first, np.ndarray) and first.dtype == object:  # of mpmath numbers
        own = np.frompyfunc(own, len(numbers), 1)
    else:
        own = getattr(namespace(first), name, None) or INSTEAD[name]
    return own(*numbers)


def function(name: str) -> Callable[[Arithmetic], Arithmetic]:
    """Return the function with that name for all kinds of numbers."""
    plain: Callable[[float], float] = getattr(math, name)

    def apply(x: Arithmetic) -> Arithmetic:
        if isinstance(x, float):  # the common case, and the only one that raises
            try:
                return plain(x)
            except ValueError:
                return -math.inf if POLES.get(name) == x else math.nan
            except OverflowError:
                return math.copysign(math.inf, x) if name == "sinh" else math.inf
        return call(name, apply, x)

    apply.__name__ = apply.__qualname__ = name
    apply.__doc__ = f"{name}(x) of any number a scene runs on."
    return apply


# one by one, so that a type checker knows them
exp, expm1, log, log1p, sqrt = map(function, ("exp", "expm1", "log", "log1p", "sqrt"))
sin, cos, tan = map(function, ("sin", "cos", "tan"))
asin, acos, atan = map(function, ("asin", "acos", "atan"))
sinh, cosh, tanh = map(function, ("sinh", "cosh", "tanh"))
asinh, acosh, atanh = map(function, ("asinh", "acosh", "atanh"))


#: of heyoka, which has no functions of that name
INSTEAD: dict[str, Callable[..., Arithmetic]] = {"expm1": lambda x: exp(x) - 1, "log1p": lambda x: log(1 + x)}


def where(condition: Condition, a: Arithmetic, b: Arithmetic) -> Arithmetic:
    """Return a where a condition holds, else b, entry by entry for arrays; both are computed, so neither may fail."""
    if isinstance(condition, bool | np.bool_):
        return a if condition else b
    decides = next((x for x in (a, b, condition) if isinstance(x, Number)), leading(a, b, condition))
    xp: ChoosingNamespace = namespace(decides)
    return xp.where(condition, a, b)


def leading(*numbers: Arithmetic) -> Arithmetic:
    """Return the first value that is no plain number, else the first value; its type selects the functions."""
    return next((x for x in numbers if not isinstance(x, int | float)), numbers[0])


def function_of_two(name: str, about: str) -> Callable[[Arithmetic, Arithmetic], Arithmetic]:
    def apply(x: Arithmetic, y: Arithmetic) -> Arithmetic:
        return call(name, apply, x, y)

    apply.__name__ = apply.__qualname__ = name
    apply.__doc__ = about
    return apply


hypot = function_of_two("hypot", "hypot(x, y): √(x² + y²).")
atan2 = function_of_two("atan2", "atan2(y, x): the angle of (x, y), in (−π, π].")


def __getattr__(name: str) -> object:
    raise AttributeError(f"cb.math has no {name!r}: it has {', '.join(sorted(__all__))}")
