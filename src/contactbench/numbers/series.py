"""heyoka's expressions, with small powers written as products and quotients to all digits.

heyoka expands x**n by the recurrence of a real power, which divides by x: from n = 3 on the series at x = 0, where
nothing happens to the motion, is nan.  A product has a series everywhere.  A quotient x / 3 is to heyoka a product with
the reciprocal, to the precision that the number is given in.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from contactbench.numbers.protocol import LARGEST_POWER, CannotRecord, Numbers, Unknown

#: hint for a run without any step
NO_SERIES = "heyoka has no series of the root and other fractional powers of x, nor of |x|, at x = 0"


#: bits of a number that divides, more than any run has
BITS = 1024


def _without_comparison(*_: object) -> NoReturn:
    asked = "a comparison, in `if` or cb.math.where, of a number that is known only when the program runs"
    raise CannotRecord(f"{asked}: a Taylor series has none, take another method")


class Series(Unknown):
    """A heyoka expression, `expression`, under arithmetic."""

    __slots__ = ("expression",)
    __array_ufunc__ = None  # NumPy's scalars leave the arithmetic to this class

    def __init__(self, expression: Any) -> None:
        self.expression = expression

    @property
    def numbers(self) -> SeriesNumbers:
        return SeriesNumbers(type(self))

    def __pow__(self, exponent: float | Series) -> Series:
        if isinstance(exponent, Series):
            return type(self)(self.expression**exponent.expression)
        n = float(exponent)
        if n != int(n) or not 3 <= n <= LARGEST_POWER:  # a square has a recurrence of its own
            return type(self)(self.expression**exponent)
        half: Any = self ** (n // 2) if n >= 4 else self
        power: Series = half * half * self if n % 2 else half * half
        return power

    def __rpow__(self, base: float) -> Series:
        import heyoka

        return type(self)(heyoka.expression(base) ** self.expression)

    def __truediv__(self, other: float | Series) -> Series:
        if isinstance(other, int | float) and other:
            import heyoka

            other = heyoka.real(float(other), BITS)
        return type(self)(self.expression / expression_of(other))

    def __rtruediv__(self, other: float) -> Series:
        return type(self)(other / self.expression)

    def __neg__(self) -> Series:
        return type(self)(-self.expression)

    def __pos__(self) -> Series:
        return self

    def __abs__(self) -> Series:
        raise CannotRecord("heyoka has no |x|")

    __bool__ = __eq__ = __ne__ = __lt__ = __le__ = __gt__ = __ge__ = _without_comparison  # type: ignore[assignment]
    __hash__ = None  # type: ignore[assignment]


class LongSeries(Series):
    """A `Series` whose derivatives have no rounded constants, for high precision."""

    __slots__ = ()


def expression_of(x: object) -> Any:
    """Return heyoka's expression; a number is returned as it is."""
    return x.expression if isinstance(x, Series) else x


def _arithmetic(apply: Callable[..., object]) -> tuple[Callable[..., Series], Callable[..., Series]]:
    def forward(self: Series, other: float | Series) -> Series:
        return type(self)(apply(self.expression, expression_of(other)))

    def reflected(self: Series, other: float | Series) -> Series:
        return type(self)(apply(other, self.expression))

    return forward, reflected


for _name in ("add", "sub", "mul"):
    _forward, _reflected = _arithmetic(getattr(operator, _name))
    setattr(Series, f"__{_name}__", _forward)
    setattr(Series, f"__r{_name}__", _reflected)


class SeriesNumbers(Numbers):
    def __init__(self, kind: type[Series] = Series) -> None:
        self.kind = kind

    def __getattr__(self, name: str) -> Callable[..., Series]:
        import heyoka

        function = getattr(heyoka, name, None)
        if function is None:
            raise CannotRecord(f"heyoka has no function {name!r}")
        return lambda *numbers: self.kind(function(*map(expression_of, numbers)))


def equations(system: Any, variables: Sequence[object], carry: tuple[str, ...]) -> list[object]:
    """Return the right-hand side of a scene as heyoka's expressions, on its variables."""
    x = system.unpack([LongSeries(variable) for variable in variables], carry)
    return [expression_of(slope) for slope in system.pack(system.rhs(x))]
