"""The numbers that scenes and flows run on, and the functions that go with each kind.

A kind of number comes with its `Namespace`: `math`, `numpy`, `jax.numpy`, an mpmath context, or a `Numbers` of this
package.  `abilities` says what that kind can do.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, NamedTuple, NoReturn, Protocol, TypeGuard


class Arithmetic(Protocol):
    """A number that a scene is written in: a float, an array, one of JAX, mpmath, heyoka or this package.

    A comparison is a bool, an array or a traced value; numbers without a value refuse it.
    """

    def __add__(self, other: Any, /) -> Arithmetic: ...
    def __radd__(self, other: Any, /) -> Arithmetic: ...
    def __sub__(self, other: Any, /) -> Arithmetic: ...
    def __rsub__(self, other: Any, /) -> Arithmetic: ...
    def __mul__(self, other: Any, /) -> Arithmetic: ...
    def __rmul__(self, other: Any, /) -> Arithmetic: ...
    def __truediv__(self, other: Any, /) -> Arithmetic: ...
    def __rtruediv__(self, other: Any, /) -> Arithmetic: ...
    def __pow__(self, other: Any, /) -> Arithmetic: ...
    def __neg__(self) -> Arithmetic: ...
    def __abs__(self) -> Arithmetic: ...
    def __lt__(self, other: Any, /) -> Condition: ...
    def __le__(self, other: Any, /) -> Condition: ...
    def __gt__(self, other: Any, /) -> Condition: ...
    def __ge__(self, other: Any, /) -> Condition: ...
    def __float__(self) -> float: ...


#: a comparison of numbers: a bool, an array of them, or a traced or recorded value
Condition = Any
#: the components of a vector
Vector = tuple[Arithmetic, ...]
#: a number of steps or stages, perhaps a traced one
Count = int | Arithmetic


class Column(Protocol):
    """Constants of the stages: a tuple, or an array that a loop takes the i-th of."""

    def __getitem__(self, i: Any, /) -> Arithmetic: ...


class Namespace(Protocol):
    """The elementary functions of one kind of number, usually written ``xp``; `math` is the smallest of them."""

    pi: float
    inf: float

    def exp(self, x: Any, /) -> Arithmetic: ...
    def expm1(self, x: Any, /) -> Arithmetic: ...
    def log(self, x: Any, /) -> Arithmetic: ...
    def log1p(self, x: Any, /) -> Arithmetic: ...
    def sqrt(self, x: Any, /) -> Arithmetic: ...
    def sin(self, x: Any, /) -> Arithmetic: ...
    def cos(self, x: Any, /) -> Arithmetic: ...
    def atan(self, x: Any, /) -> Arithmetic: ...
    def atan2(self, y: Any, x: Any, /) -> Arithmetic: ...
    def hypot(self, x: Any, y: Any, /) -> Arithmetic: ...
    def floor(self, x: Any, /) -> Arithmetic: ...


class ChoosingNamespace(Namespace, Protocol):
    """The namespace of numbers whose values are unknown: `where` chooses between two of them."""

    @property
    def where(self) -> Callable[..., Arithmetic]: ...
    @property
    def maximum(self) -> Callable[..., Arithmetic]: ...
    @property
    def minimum(self) -> Callable[..., Arithmetic]: ...


#: a function that makes, joins or compares arrays
ArrayFunction = Any


class ArrayNamespace(Namespace, Protocol):
    """`numpy` or `jax.numpy`: elementary functions, and functions that make, join and compare arrays."""

    where: ArrayFunction
    multiply: Any
    asarray: ArrayFunction
    zeros: ArrayFunction
    maximum: ArrayFunction
    minimum: ArrayFunction
    abs: ArrayFunction
    linalg: ModuleType


class ExactNamespace(Namespace, Protocol):
    """An mpmath context, with any number of digits."""

    dps: int

    def mpf(self, x: float, /) -> Arithmetic: ...
    def quad(self, f: Callable[[Arithmetic], Arithmetic], span: Sequence[Arithmetic], /) -> Arithmetic: ...


class Abilities(NamedTuple):
    """The abilities of a kind of number.

    branch : a comparison is a bool, so that `if` chooses; otherwise ``where`` chooses, entry by entry.
    vectors : ``asarray`` and ``multiply.outer`` make one vector of the constants of many stages.
    digits : as many as wanted: ``mpf``, ``dps`` and ``quad`` of mpmath.
    traced : by JAX, whose loops and barriers are to be used.
    """

    branch: bool = False
    vectors: bool = False
    digits: bool = False
    traced: bool = False


#: largest power that is written as a product
LARGEST_POWER = 16
#: of the namespaces that are not ours, by their package; of all others, arrays
FOREIGN = {"math": Abilities(branch=True), "mpmath": Abilities(branch=True, digits=True)}
ARRAYS = Abilities(vectors=True)


class Numbers:
    """A namespace of this package: functions of one kind of number, and what that kind can do."""

    abilities = Abilities()


class ChoosingNumbers(Numbers):
    """A namespace whose ``where`` chooses the larger and the smaller number, too."""

    where: Callable[..., Arithmetic]

    def maximum(self, a: Arithmetic, b: Arithmetic) -> Arithmetic:
        return self.where(a >= b, a, b)

    def minimum(self, a: Arithmetic, b: Arithmetic) -> Arithmetic:
        return self.where(a <= b, a, b)


def abilities(xp: Namespace) -> Abilities:
    if isinstance(xp, Numbers):
        return xp.abilities
    package = getattr(xp, "__name__", type(xp).__module__).partition(".")[0]
    return FOREIGN.get(package, ARRAYS)


def has_where(xp: Namespace) -> TypeGuard[ChoosingNamespace]:
    return not abilities(xp).branch


def has_arrays(xp: Namespace) -> TypeGuard[ArrayNamespace]:
    return abilities(xp).vectors


def has_digits(xp: Namespace) -> TypeGuard[ExactNamespace]:
    return abilities(xp).digits


class Number:
    __slots__ = ()

    @property
    @abstractmethod
    def numbers(self) -> Numbers:
        """Return the namespace that goes with it."""


class CannotRecord(TypeError):
    """A computation depends on a number that is known only when the recorded program runs."""


def _refuse(question: str) -> Callable[..., Any]:
    def refuse(self: object, *_: object) -> NoReturn:
        why = "a number that is known only when the program runs (cb.math.where chooses)"
        raise CannotRecord(f"{question} {why}")

    return refuse


#: hint for functions of time that jump
JUMPS = "and cb.Driven is told the times of jumps by breaks="


def _refuse_remainder(self: object, *_: object) -> NoReturn:
    """`%`, `//`, divmod() and round()."""
    raise CannotRecord(
        f"`%`, `//` or round() of a number: use cb.math.floor, x % y = x - y * floor(x / y), {JUMPS}"
    )


class Unknown(Number):
    """A number that stands for a value: whatever asks for the value raises `CannotRecord`."""

    __slots__ = ()

    __bool__ = _refuse("`if`, `and`, `min` or `max` asks for the truth of")
    __float__ = _refuse("a function of `math`, or float(), asks for the value of")
    __int__ = _refuse("int() asks for the value of")
    __index__ = _refuse("an index or range() asks for the value of")
    __complex__ = _refuse("complex arithmetic asks for the value of")
    __iter__ = _refuse("a loop asks for the components of")
    __eq__ = __ne__ = __lt__ = __le__ = __gt__ = __ge__ = __bool__  # type: ignore[assignment]
    __mod__ = __rmod__ = __floordiv__ = __rfloordiv__ = __divmod__ = __rdivmod__ = _refuse_remainder
    __round__ = __trunc__ = __floor__ = __ceil__ = _refuse_remainder
    __hash__ = None  # type: ignore[assignment]
