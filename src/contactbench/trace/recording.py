"""Numbers that record what is computed with them, as the source of straight-line scalar code.

A scene, a flow or a step map that is run on recorded numbers leaves the list of its operations behind:
each becomes one assignment, equal operations become one (common subexpressions), numbers known at
recording time are folded by Python itself, and what does not change in a loop is computed before it.
`RecordedNumbers` is the namespace that goes with them, in place of `math` or `jax.numpy`.

The value of a recorded number is not known.  What asks for it, as ``if x > 0`` does, raises
`CannotRecord`; ``xp.where(x > 0, a, b)`` chooses by value.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np

from contactbench.boundary import place, plain_function
from contactbench.numbers.dual import Dual
from contactbench.numbers.nested import leaves, rebuilt
from contactbench.numbers.protocol import LARGEST_POWER, CannotRecord, Numbers, Unknown


class Block:
    """Assignments in their order: a program, or the body of a loop in one.

    depth : how many blocks it is in.  known : the name of every expression assigned so far, by its text.
    """

    def __init__(self, parent: Block | None = None, indent: int | None = None) -> None:
        self.parent = parent
        self.depth: int = parent.depth + 1 if parent else 0
        self.indent: int = indent if indent is not None else parent.indent + 1 if parent else 1
        self.lines: list[str] = []
        self.known: dict[str, str] = {}

    def add(self, *lines: str) -> None:
        self.lines += ["    " * self.indent + line for line in lines]

    def within(self, other: Block) -> bool:
        """Whether it is the other block or a part of it."""
        block: Block | None = self
        while block is not None and block is not other:
            block = block.parent
        return block is other


class Tape:
    """A recording: names of values, and the block that is being written."""

    def __init__(self) -> None:
        self.root = self.block = Block()
        self.count = 0

    def name(self, kind: str = "f") -> str:
        self.count += 1
        return f"{kind}{self.count}"

    def assign(self, text: str, kind: str, block: Block) -> Recorded:
        """The value of an expression, assigned in a block unless it has been."""
        if text not in block.known:
            block.known[text] = self.name(kind)
            block.add(f"{block.known[text]} = {text}")
        return Recorded(self, block.known[text], kind, block)

    def operation(self, form: str, kind: str, *operands: Any) -> Recorded:
        """`form` with its operands filled in, assigned in the outermost block that knows them all."""
        block = self.root
        for x in operands:
            if isinstance(x, Recorded) and x.block.depth > block.depth:
                block = x.block
        of = "i" if kind == "i" else "f"
        return self.assign(form.format(*(self.read(x, block, of) for x in operands)), kind, block)

    def read(self, x: Any, block: Block, kind: str = "f") -> str:
        """The text of a number where it is used, in a block."""
        if isinstance(x, Recorded) and not block.within(x.block):
            raise CannotRecord("vectors of different origin are combined")
        return text_of(x, kind)

    def repeat(self, n: Any, body: Callable[[Any], Any], x: Any) -> Any:
        """n-fold application, recorded as a loop."""
        outer = self.block
        start = leaves(x)
        kinds = ["i" if isinstance(v, int) else kind_of(v) for v in start]
        inner = Block(outer)
        names = [self.name(kind) for kind in kinds]
        carried = [Recorded(self, name, kind, inner) for name, kind in zip(names, kinds, strict=True)]
        self.block = inner
        try:
            end = leaves(body(rebuilt(x, carried)))
        finally:
            self.block = outer
        if len(end) != len(start):
            raise CannotRecord("a loop whose body returns a state of another shape")
        before, after = (
            [self.read(v, block, kind) for v, kind in zip(values, kinds, strict=True)]
            for values, block in ((start, outer), (end, inner))
        )
        outer.add(*map("{} = {}".format, names, before))
        outer.add(f"for _ in range({self.read(n, outer, 'i')}):")
        inner.add(f"{', '.join(names)} = {', '.join(after)}")
        outer.lines += inner.lines
        return rebuilt(
            x, [Recorded(self, name, kind, outer) for name, kind in zip(names, kinds, strict=True)]
        )


def kind_of(x: Any) -> str:
    """f for floating-point numbers, i for whole ones that are recorded, b for truth values."""
    return x.kind if isinstance(x, Recorded) else "f"


def text_of(x: Any, kind: str = "f") -> str:
    """A number as it is written in the program."""
    if isinstance(x, Recorded):
        return x.name
    if isinstance(x, bool | np.bool_):
        return str(bool(x))
    if kind == "i":
        return str(operator.index(x))
    try:
        value = float(x)
    except (TypeError, ValueError):
        raise CannotRecord(f"{x!r} of type {type(x).__name__} is not a number") from None
    if math.isfinite(value):
        return f"({value!r})" if math.copysign(1.0, value) < 0 else repr(value)
    return "nan" if math.isnan(value) else "inf" if value > 0 else "(-inf)"


def _comparison(sign: str) -> Callable[..., Any]:
    def compare(self: Recorded, other: Any) -> Any:
        if isinstance(other, Dual):
            return NotImplemented
        return self.tape.operation(f"{{0}} {sign} {{1}}", "b", self, other)

    return compare


class Recorded(Unknown):
    """A value of the recorded program, known by its name there."""

    __slots__ = ("block", "kind", "name", "tape")

    def __init__(self, tape: Tape, name: str, kind: str, block: Block) -> None:
        self.tape, self.name, self.kind, self.block = tape, name, kind, block

    def __repr__(self) -> str:
        return f"<recorded {self.name}>"

    @property
    def numbers(self) -> RecordedNumbers:
        return RecordedNumbers(self.tape)

    # -- arithmetic --------------------------------------------------------------------------------
    def _binary(self, sign: str, a: Any, b: Any, commutes: bool = False) -> Any:
        if isinstance(a, Dual | np.ndarray) or isinstance(b, Dual | np.ndarray):
            return NotImplemented
        if self.kind == "i" and all(isinstance(x, int) or kind_of(x) == "i" for x in (a, b)):
            a, b = (int(x) if isinstance(x, int) else x for x in (a, b))
            return self.tape.operation(f"{{0}} {sign} {{1}}", "i", a, b)
        if commutes and text_of(b) < text_of(a):
            a, b = b, a
        return self.tape.operation(f"{{0}} {sign} {{1}}", "f", a, b)

    def __add__(self, other: Any) -> Any:
        return self._binary("+", self, other, commutes=True)

    def __sub__(self, other: Any) -> Any:
        return self if is_constant(other, 0) else self._binary("-", self, other)

    def __rsub__(self, other: Any) -> Any:
        return self._binary("-", other, self)

    def __mul__(self, other: Any) -> Any:
        return self if is_constant(other, 1) else self._binary("*", self, other, commutes=True)

    def __truediv__(self, other: Any) -> Any:
        return self if is_constant(other, 1) else self._binary("/", self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return self._binary("/", other, self)

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self) -> Any:
        return self.tape.operation("-{0}", self.kind, self)

    def __pos__(self) -> Any:
        return self

    def __abs__(self) -> Any:
        return self.tape.operation("abs({0})", self.kind, self)

    def __pow__(self, exponent: Any) -> Any:
        return power(self, exponent)

    def __rpow__(self, base: Any) -> Any:
        return self.tape.operation("{0} ** {1}", "f", base, self)

    # -- truth values ------------------------------------------------------------------------------
    __eq__ = _comparison("==")  # type: ignore[assignment]
    __ne__ = _comparison("!=")  # type: ignore[assignment]
    __lt__, __le__, __gt__, __ge__ = map(_comparison, ("<", "<=", ">", ">="))

    def __and__(self, other: Any) -> Any:
        return self.tape.operation("{0} and {1}", "b", self, other)

    def __or__(self, other: Any) -> Any:
        return self.tape.operation("{0} or {1}", "b", self, other)

    def __invert__(self) -> Any:
        return self.tape.operation("not {0}", "b", self)

    __rand__, __ror__ = __and__, __or__
    __hash__ = None  # type: ignore[assignment]

    # -- what cannot be recorded -------------------------------------------------------------------
    def __array__(self, *_: Any, **__: Any) -> Any:
        raise CannotRecord("an array cannot hold a number that is known only when the program runs")

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        """NumPy's functions, so that ``np.sin(q)`` and ``np.float64(2) * q`` in a force are recorded."""
        name = ufunc.__name__
        if method != "__call__" or options or any(isinstance(x, np.ndarray) and x.ndim for x in inputs):
            raise CannotRecord(f"numpy.{name} of arrays cannot be recorded")
        inputs = tuple(x.item() if isinstance(x, np.generic | np.ndarray) else x for x in inputs)
        if name in OPERATORS:
            return OPERATORS[name](*inputs)
        function = getattr(RecordedNumbers(self.tape), name, None)
        if function is None:
            raise CannotRecord(f"numpy.{name} cannot be recorded")
        return function(*inputs)


#: NumPy's names of what Python has operators for
OPERATORS: dict[str, Callable[..., Any]] = {
    "add": operator.add, "subtract": operator.sub, "multiply": operator.mul, "divide": operator.truediv,
    "negative": operator.neg, "power": operator.pow, "float_power": operator.pow, "absolute": operator.abs,
    "equal": operator.eq, "not_equal": operator.ne, "less": operator.lt, "less_equal": operator.le,
    "greater": operator.gt, "greater_equal": operator.ge,
    "square": lambda x: x * x, "reciprocal": lambda x: 1 / x,
}  # fmt: skip


def is_constant(x: Any, value: float) -> bool:
    """Whether x is this number, known when recording."""
    return not isinstance(x, Recorded | Dual | np.ndarray) and x == value


def power(x: Recorded, exponent: Any) -> Any:
    """x to a power: products and square roots for multiples of ½, which are faster than the library's pow."""
    if isinstance(exponent, Recorded) or exponent * 2 != int(exponent * 2) or abs(exponent) > LARGEST_POWER:
        return x.tape.operation("{0} ** {1}", "f", x, exponent)
    if exponent < 0:
        return 1 / power(x, -exponent)
    whole = int(exponent)
    result: Any = RecordedNumbers(x.tape).sqrt(x) if exponent != whole else 1.0
    square: Any = x
    while whole:
        if whole & 1:
            result = square * result
        whole >>= 1
        square = square * square if whole else square
    return result


#: functions of one number, by their names in `math`, and what NumPy calls some of them
FUNCTIONS = (
    "exp", "expm1", "log", "log1p", "log2", "log10", "sqrt", "sin", "cos", "tan", "sinh", "cosh", "tanh",
    "asin", "acos", "atan", "asinh", "acosh", "atanh", "floor", "ceil", "erf", "erfc",
)  # fmt: skip
ALIASES = {
    "arcsin": "asin", "arccos": "acos", "arctan": "atan", "arcsinh": "asinh", "arccosh": "acosh",
    "arctanh": "atanh", "arctan2": "atan2",
}  # fmt: skip


class RecordedNumbers(Numbers):
    """The number namespace of recorded numbers.  Plain numbers go through `math`."""

    inf, nan, pi, e = math.inf, math.nan, math.pi, math.e

    def __init__(self, tape: Tape) -> None:
        self.tape = tape

    def __getattr__(self, name: str) -> Any:
        known = ALIASES.get(name, name)
        if known not in FUNCTIONS:
            raise AttributeError(name)

        def function(x: Any) -> Any:
            if not isinstance(x, Recorded):
                return getattr(math, known)(x)
            return self.tape.operation(f"{known}({{0}})", "f", x)

        return function

    def where(self, condition: Any, a: Any, b: Any) -> Any:
        if not isinstance(condition, Recorded):
            return a if condition else b
        return self.tape.operation("{1} if {0} else {2}", "f", condition, a, b)

    def atan2(self, y: Any, x: Any) -> Any:
        return self.tape.operation("atan2({0}, {1})", "f", y, x)

    arctan2 = atan2

    def hypot(self, x: Any, y: Any) -> Any:
        return self.tape.operation("hypot({0}, {1})", "f", x, y)

    def abs(self, x: Any) -> Any:
        return abs(x)

    fabs = absolute = abs

    def maximum(self, a: Any, b: Any) -> Any:
        return self.where(a >= b, a, b)

    def minimum(self, a: Any, b: Any) -> Any:
        return self.where(a <= b, a, b)

    def logical_and(self, a: Any, b: Any) -> Any:
        return a & b

    def logical_or(self, a: Any, b: Any) -> Any:
        return a | b

    def logical_not(self, a: Any) -> Any:
        return ~a if isinstance(a, Recorded) else not a


def recorded(function: Callable[[], Any]) -> Any:
    """What a function records; `CannotRecord` for whatever goes wrong in it."""
    try:
        return function()
    except CannotRecord as error:
        raise advised(error) from error.__cause__
    except (TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise advised(error) from error


def advised(error: BaseException) -> CannotRecord:
    """The reason, and what to write instead where that is known."""
    if (advice := plain_function(error)) is not None:
        return CannotRecord(f"{place(error)[2:]}: {advice}")
    if isinstance(error, CannotRecord):
        return error
    return CannotRecord(f"{type(error).__name__}: {str(error).partition(chr(10))[0]}")
