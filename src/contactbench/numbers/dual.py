"""Dual numbers a + bε, ε² = 0, of any numbers, dual ones too: the derivative of plain arithmetic."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any

from contactbench.numbers.functions import namespace, where
from contactbench.numbers.protocol import (
    Abilities,
    Arithmetic,
    ChoosingNamespace,
    ChoosingNumbers,
    Condition,
    Number,
    abilities,
)


def _comparison(compare: Callable[..., Condition]) -> Callable[[Dual, Arithmetic], Condition]:
    return lambda self, other: compare(self.a, value(other))


class Dual(Number):
    __slots__ = ("a", "b")
    __array_ufunc__ = None  # NumPy arrays leave mixed arithmetic to us

    def __init__(self, a: Arithmetic, b: Arithmetic) -> None:
        self.a, self.b = a, b

    @property
    def numbers(self) -> DualNumbers:
        return DualNumbers(namespace(self.a))

    def __add__(self, other: Arithmetic) -> Dual:
        return Dual(self.a + value(other), self.b + slope(other))

    def __float__(self) -> float:
        raise TypeError(f"a number is expected, not {type(self).__name__!r}")

    def __neg__(self) -> Dual:
        return Dual(-self.a, -self.b)

    def __sub__(self, other: Arithmetic) -> Dual:
        return Dual(self.a - value(other), self.b - slope(other))

    def __rsub__(self, other: Arithmetic) -> Dual:
        return -self + other

    def __mul__(self, other: Arithmetic) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.a * other.a, self.a * other.b + self.b * other.a)
        return Dual(self.a * other, self.b * other)

    def __truediv__(self, other: Arithmetic) -> Dual:
        if isinstance(other, Dual):
            ratio = self.a / other.a
            return Dual(ratio, (self.b - ratio * other.b) / other.a)
        return Dual(self.a / other, self.b / other)

    def __rtruediv__(self, other: Arithmetic) -> Dual:
        ratio = other / self.a
        return Dual(ratio, -ratio * self.b / self.a)

    def __pow__(self, exponent: Arithmetic) -> Dual:
        return Dual(self.a**exponent, exponent * self.a ** (exponent - 1) * self.b)

    def __abs__(self) -> Dual:
        return Dual(abs(self.a), where(self.a < 0, -self.b, self.b))

    __radd__, __rmul__ = __add__, __mul__

    # dual numbers are compared by their values
    __eq__ = _comparison(operator.eq)  # type: ignore[assignment]
    __ne__ = _comparison(operator.ne)  # type: ignore[assignment]
    __lt__, __le__ = _comparison(operator.lt), _comparison(operator.le)
    __gt__, __ge__ = _comparison(operator.gt), _comparison(operator.ge)
    __hash__ = None  # type: ignore[assignment]


def value(x: Arithmetic) -> Arithmetic:
    return x.a if isinstance(x, Dual) else x


def slope(x: Arithmetic) -> Arithmetic:
    return x.b if isinstance(x, Dual) else 0.0


#: derivatives of functions of one number: of (namespace, x, f(x))
DERIVATIVES: dict[str, Callable[[Any, Arithmetic, Arithmetic], Arithmetic]] = {
    "exp": lambda xp, x, f: f,
    "expm1": lambda xp, x, f: f + 1,
    "log": lambda xp, x, f: 1 / x,
    "log1p": lambda xp, x, f: 1 / (1 + x),
    "sqrt": lambda xp, x, f: 0.5 / f,
    "sin": lambda xp, x, f: xp.cos(x),
    "cos": lambda xp, x, f: -xp.sin(x),
    "tan": lambda xp, x, f: 1 + f * f,
    "sinh": lambda xp, x, f: xp.cosh(x),
    "cosh": lambda xp, x, f: xp.sinh(x),
    "tanh": lambda xp, x, f: 1 - f * f,
    "atan": lambda xp, x, f: 1 / (1 + x * x),
    "arctan": lambda xp, x, f: 1 / (1 + x * x),
    "asin": lambda xp, x, f: 1 / xp.sqrt(1 - x * x),
    "arcsin": lambda xp, x, f: 1 / xp.sqrt(1 - x * x),
    "acos": lambda xp, x, f: -1 / xp.sqrt(1 - x * x),
    "asinh": lambda xp, x, f: 1 / xp.sqrt(1 + x * x),
    "acosh": lambda xp, x, f: 1 / xp.sqrt(x * x - 1),
    "atanh": lambda xp, x, f: 1 / (1 - x * x),
    "abs": lambda xp, x, f: where(x < 0, -1.0, 1.0),
    "floor": lambda xp, x, f: 0.0,
    "ceil": lambda xp, x, f: 0.0,
}


class DualNumbers(ChoosingNumbers):
    def __init__(self, base: ChoosingNamespace) -> None:
        self.base = base

    @property
    def abilities(self) -> Abilities:  # type: ignore[override]
        return abilities(self.base)

    def __getattr__(self, name: str) -> Any:
        function: Callable[..., Arithmetic] = getattr(self.base, name)
        if name not in DERIVATIVES:
            return function

        def lifted(x: Arithmetic) -> Arithmetic:
            if not isinstance(x, Dual):
                return function(x)
            y = function(x.a)
            return Dual(y, DERIVATIVES[name](self.base, x.a, y) * x.b)

        return lifted

    def where(self, condition: Condition, a: Arithmetic, b: Arithmetic) -> Arithmetic:
        if not isinstance(a, Dual) and not isinstance(b, Dual):
            return self.base.where(condition, a, b)
        values = self.base.where(condition, value(a), value(b))
        return Dual(values, self.base.where(condition, slope(a), slope(b)))

    def atan2(self, y: Arithmetic, x: Arithmetic) -> Dual:
        a, b = value(y), value(x)
        square = a * a + b * b
        return Dual(self.base.atan2(a, b), (b * slope(y) - a * slope(x)) / square)

    def hypot(self, x: Arithmetic, y: Arithmetic) -> Dual:
        length = self.base.hypot(value(x), value(y))
        return Dual(length, (value(x) * slope(x) + value(y) * slope(y)) / length)

    arctan2 = atan2


NESTED = (tuple, list)


def leaves(x: object) -> list[Any]:
    """Return the numbers in nested tuples, lists and dual numbers, in their order; None has none."""
    found: list[Any] = []

    def collect(x: Any) -> None:
        if isinstance(x, NESTED):
            for each in x:
                collect(each)
        elif isinstance(x, Dual):
            collect(x.a)
            collect(x.b)
        elif x is not None:
            found.append(x)

    collect(x)
    return found


def rebuild[X](x: X, values: Sequence[object]) -> X:
    """Return x with its numbers replaced by others."""
    supply = iter(values)

    def again(x: Any) -> Any:
        if isinstance(x, NESTED):
            inner = [again(each) for each in x]
            return type(x)(*inner) if hasattr(x, "_fields") else type(x)(inner)
        if isinstance(x, Dual):
            return Dual(again(x.a), again(x.b))
        return None if x is None else next(supply)

    made: X = again(x)
    return made
