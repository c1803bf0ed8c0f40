"""Dual numbers a + bε, ε² = 0: the derivative of plain arithmetic along one direction.

Components may be any numbers a scene runs on, dual numbers included (nested: second derivatives).
"""

from __future__ import annotations

from typing import Any


class Dual:
    """Value `a` and derivative `b`."""

    __slots__ = ("a", "b")
    __array_ufunc__ = None  # NumPy arrays leave mixed arithmetic to us

    def __init__(self, a: Any, b: Any) -> None:
        self.a, self.b = a, b

    def __add__(self, other: Any) -> Dual:
        return Dual(self.a + value(other), self.b + slope(other))

    def __neg__(self) -> Dual:
        return Dual(-self.a, -self.b)

    def __sub__(self, other: Any) -> Dual:
        return Dual(self.a - value(other), self.b - slope(other))

    def __rsub__(self, other: Any) -> Dual:
        return -self + other

    def __mul__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.a * other.a, self.a * other.b + self.b * other.a)
        return Dual(self.a * other, self.b * other)

    def __truediv__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            ratio = self.a / other.a
            return Dual(ratio, (self.b - ratio * other.b) / other.a)
        return Dual(self.a / other, self.b / other)

    def __rtruediv__(self, other: Any) -> Dual:
        ratio = other / self.a
        return Dual(ratio, -ratio * self.b / self.a)

    def __pow__(self, exponent: Any) -> Dual:
        return Dual(self.a**exponent, exponent * self.a ** (exponent - 1) * self.b)

    __radd__, __rmul__ = __add__, __mul__


def value(x: Any) -> Any:
    """x without its derivative."""
    return x.a if isinstance(x, Dual) else x


def slope(x: Any) -> Any:
    """The derivative of x, zero for a plain number."""
    return x.b if isinstance(x, Dual) else 0.0
