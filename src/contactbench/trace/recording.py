"""Numbers that record the operations on them, as straight-line scalar code.

Equal operations become one, numbers known at recording time are folded by Python itself, and what does not change in a
loop is computed before it.  The value of a recorded number is not known: what asks for it, as ``if x > 0`` does, raises
`CannotRecord`; ``xp.where(x > 0, a, b)`` chooses by value.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Hashable
from typing import Any

import numpy as np

from contactbench.blame import place, plain_function
from contactbench.numbers.dual import Dual, DualNumbers, leaves, rebuild
from contactbench.numbers.protocol import (
    JUMPS,
    LARGEST_POWER,
    Arithmetic,
    CannotRecord,
    ChoosingNumbers,
    Condition,
    Count,
    Unknown,
)
from contactbench.trace import form
from contactbench.trace.form import Assign, Element, Operand, Operation, Results, Statement, Update, text


class Block:
    """Statements in their order; depth : in how many blocks; known : the names of values, by what they are."""

    def __init__(self, parent: Block | None = None) -> None:
        self.parent = parent
        self.depth: int = parent.depth + 1 if parent else 0
        self.statements: list[Any] = []
        self.known: dict[Hashable, str] = {}

    def within(self, other: Block) -> bool:
        return self is other or (self.parent is not None and self.parent.within(other))


class Tape:
    def __init__(self) -> None:
        self.root = self.block = Block()
        self.count = 0

    def name(self, kind: str = "f") -> str:
        self.count += 1
        return f"{kind}{self.count}"

    def assign(self, value: Operation | Element, kind: str, block: Block) -> Recorded:
        # by text, since -0.0 == 0.0 and 1 == 1.0
        key = (value.function, *map(text, value.operands)) if isinstance(value, Operation) else value
        if key not in block.known:
            block.known[key] = self.name(kind)
            block.statements.append(Assign(block.known[key], value))
        return Recorded(self, block.known[key], kind, block)

    def operation(self, function: str, kind: str, *operands: object) -> Recorded:
        """Return a function of operands, assigned in the outermost block that knows them all."""
        block = self.root
        for x in operands:
            if isinstance(x, Recorded) and x.block.depth > block.depth:
                block = x.block
        of = "i" if kind == "i" else "f"
        return self.assign(Operation(function, tuple(self.read(x, block, of) for x in operands)), kind, block)

    def read(self, x: object, block: Block, kind: str = "f") -> Operand:
        if isinstance(x, Recorded) and not block.within(x.block):
            raise CannotRecord("vectors of different origin are combined")
        return operand_of(x, kind)

    def results(self, numbers: object) -> Results:
        if isinstance(numbers, tuple | list):
            return tuple(map(self.results, numbers))
        return self.read(numbers, self.root)

    def repeat[X](self, n: Count, body: Callable[[X], X], x: X) -> X:
        return self._loop(x, body, lambda inner: form.Loop("_", self.read(n, self.block, "i"), tuple(inner)))

    def repeat_while[X](self, condition: Callable[[X], Condition], body: Callable[[X], X], x: X) -> X:
        tests: list[Any] = []

        def turn(x: X) -> X:
            more = self.read(condition(x), self.block)
            tests.extend([len(self.block.statements), more])
            return body(x)

        def loop(inner: list[Statement]) -> Statement:
            size, more = tests
            return form.While(tuple(inner[:size]), more, tuple(inner[size:]))

        return self._loop(x, turn, loop)

    def _loop[X](self, x: X, body: Callable[[X], X], make: Callable[[list[Statement]], Statement]) -> X:
        outer, start = self.block, leaves(x)
        kinds = ["i" if isinstance(v, int) else v.kind if isinstance(v, Recorded) else "f" for v in start]
        inner, names = Block(outer), tuple(map(self.name, kinds))

        def state(block: Block) -> X:
            return rebuild(x, [Recorded(self, *each, block) for each in zip(names, kinds, strict=True)])

        def update(values: list[object], block: Block) -> Update:
            return Update(names, tuple(self.read(v, block, k) for v, k in zip(values, kinds, strict=True)))

        self.block = inner
        try:
            end = leaves(body(state(inner)))
        finally:
            self.block = outer
        if len(end) != len(start):
            raise CannotRecord("a loop whose body returns a state of another shape")
        inner.statements.append(update(end, inner))
        outer.statements += [update(start, outer), make(inner.statements)]
        return state(outer)


def operand_of(x: Any, kind: str = "f") -> Operand:
    """Return a number as an operand; raise `CannotRecord` for whatever is none."""
    if isinstance(x, Recorded):
        return x.name
    if isinstance(x, bool | np.bool_):
        return bool(x)
    try:
        return operator.index(x) if kind == "i" else float(x)
    except (TypeError, ValueError):
        raise CannotRecord(f"{x!r} of type {type(x).__name__} is not a number") from None


def _arithmetic(
    function: str, neutral: float | None = None, reflected: bool = False, commutes: bool = False
) -> Callable[..., Recorded]:
    """Return an operator; neutral : the operand that changes nothing."""

    def apply(self: Recorded, other: Arithmetic) -> Recorded:
        if isinstance(other, Dual | np.ndarray):
            return NotImplemented  # type: ignore[no-any-return]
        if neutral is not None and is_constant(other, neutral):
            return self
        if "b" in (self.kind, getattr(other, "kind", "f")):
            raise CannotRecord(f"a comparison is no number: cb.math.where(t > 1, a, b) chooses, {JUMPS}")
        a, b = (other, self) if reflected else (self, other)
        if self.kind == "i" and (isinstance(other, int) or getattr(other, "kind", "f") == "i"):
            return self.tape.operation(function, "i", a, b)
        if commutes and text(operand_of(b)) < text(operand_of(a)):
            a, b = b, a
        return self.tape.operation(function, "f", a, b)

    return apply


def _truth(function: str) -> Callable[..., Recorded]:
    def compare(self: Recorded, other: object) -> Recorded:
        if isinstance(other, Dual):
            return NotImplemented  # type: ignore[no-any-return]
        return self.tape.operation(function, "b", self, other)

    return compare


class Recorded(Unknown):
    """A value of the program, known by its name; kind : f floating-point, i whole number, b truth value."""

    __slots__ = ("block", "kind", "name", "tape")

    def __init__(self, tape: Tape, name: str, kind: str, block: Block) -> None:
        self.tape, self.name, self.kind, self.block = tape, name, kind, block

    def __repr__(self) -> str:
        return f"<recorded {self.name}>"

    numbers = property(lambda self: RecordedNumbers(self.tape))

    # -- arithmetic --------------------------------------------------------------------------------
    __add__ = __radd__ = _arithmetic("add", commutes=True)
    __mul__ = __rmul__ = _arithmetic("mul", neutral=1, commutes=True)
    __sub__, __rsub__ = _arithmetic("sub", neutral=0), _arithmetic("sub", reflected=True)
    __truediv__, __rtruediv__ = _arithmetic("div", neutral=1), _arithmetic("div", reflected=True)

    def __neg__(self) -> Recorded:
        return self.tape.operation("neg", self.kind, self)

    def __pos__(self) -> Recorded:
        return self

    def __abs__(self) -> Recorded:
        return self.tape.operation("abs", self.kind, self)

    def __pow__(self, exponent: Arithmetic) -> Arithmetic:
        return power(self, exponent)

    def __rpow__(self, base: Arithmetic) -> Recorded:
        return self.tape.operation("pow", "f", base, self)

    # -- truth values ------------------------------------------------------------------------------
    __eq__, __ne__ = map(_truth, ("eq", "ne"))  # type: ignore[assignment]
    __lt__, __le__, __gt__, __ge__ = map(_truth, ("lt", "le", "gt", "ge"))
    __and__, __or__, __rand__, __ror__ = map(_truth, ("and", "or", "and", "or"))

    def __invert__(self) -> Recorded:
        return self.tape.operation("not", "b", self)

    __hash__ = None  # type: ignore[assignment]

    # -- what cannot be recorded -------------------------------------------------------------------
    def __array__(self, *_: object, **__: object) -> np.ndarray:
        raise CannotRecord("an array cannot hold a number that is known only when the program runs")

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: object, **options: object) -> Arithmetic:
        """NumPy's functions, so that ``np.sin(q)`` and ``np.float64(2) * q`` in a force are recorded."""
        name = ufunc.__name__
        if method != "__call__" or options or any(isinstance(x, np.ndarray) and x.ndim for x in inputs):
            raise CannotRecord(f"numpy.{name} of arrays cannot be recorded")
        inputs = tuple(x.item() if isinstance(x, np.generic | np.ndarray) else x for x in inputs)
        if name in OPERATORS:
            return OPERATORS[name](*inputs)
        function: Callable[..., Arithmetic] | None = getattr(RecordedNumbers(self.tape), name, None)
        if function is None:
            raise CannotRecord(f"numpy.{name} cannot be recorded")
        return function(*inputs)


#: NumPy's names of operators, and Python's
NUMPY = "add subtract multiply divide power float_power negative equal not_equal less less_equal greater greater_equal"
PYTHON = "add sub mul truediv pow pow neg eq ne lt le gt ge"
OPERATORS: dict[str, Callable[..., Arithmetic]] = {
    **{name: getattr(operator, of) for name, of in zip(NUMPY.split(), PYTHON.split(), strict=True)},
    "square": lambda x: x * x,
    "reciprocal": lambda x: 1 / x,
}


def is_constant(x: object, value: float) -> bool:
    return not isinstance(x, Recorded | Dual | np.ndarray) and x == value


def power(x: Recorded, exponent: Any) -> Arithmetic:
    """x to a power: products and square roots for multiples of ½, which are faster than the library's pow."""
    if isinstance(exponent, Recorded) or exponent * 2 != int(exponent * 2) or abs(exponent) > LARGEST_POWER:
        return x.tape.operation("pow", "f", x, exponent)
    if exponent < 0:
        return 1 / power(x, -exponent)
    whole = int(exponent)
    result: Arithmetic = RecordedNumbers(x.tape).sqrt(x) if exponent != whole else 1.0
    square: Arithmetic = x
    while whole:
        if whole & 1:
            result = square * result
        whole >>= 1
        square = square * square if whole else square
    return result


#: what NumPy calls some of them
ALIASES = {f"arc{name}": f"a{name}" for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "tan2")}


class RecordedNumbers(ChoosingNumbers):
    """The number namespace of recorded numbers.  Plain numbers go through `math`."""

    inf, nan, pi, e = math.inf, math.nan, math.pi, math.e
    abs = fabs = absolute = staticmethod(abs)
    logical_and, logical_or = staticmethod(operator.and_), staticmethod(operator.or_)

    def __init__(self, tape: Tape) -> None:
        self.tape = tape

    def __getattr__(self, name: str) -> Callable[..., Arithmetic]:
        known = ALIASES.get(name, name)
        if known not in (*form.FUNCTIONS, "atan2", "hypot"):
            raise AttributeError(name)

        def function(*x: Arithmetic) -> Arithmetic:
            if not any(isinstance(number, Recorded) for number in x):
                plain: Callable[..., float] = getattr(math, known)
                return plain(*x)
            return self.tape.operation(known, "f", *x)

        return function

    def repeat_while[X](self, condition: Callable[[X], Condition], body: Callable[[X], X], x: X) -> X:
        return self.tape.repeat_while(condition, body, x)

    def iterate[X](self, turns: int, body: Callable[[X], X], x: X) -> X:
        return self.tape.repeat(turns, body, x)

    def where(self, condition: Condition, a: Arithmetic, b: Arithmetic) -> Arithmetic:
        if isinstance(a, Dual) or isinstance(b, Dual):
            return DualNumbers(self).where(condition, a, b)
        if not isinstance(condition, Recorded):
            return a if condition else b
        kind = "i" if all(isinstance(x, Recorded) and x.kind == "i" for x in (a, b)) else "f"
        return self.tape.operation("where", kind, condition, a, b)

    def logical_not(self, a: Condition) -> Condition:
        return ~a if isinstance(a, Recorded) else not a


def attempt[X](function: Callable[[], X]) -> X:
    """Return what a function records; `CannotRecord` for whatever goes wrong in it."""
    try:
        return function()
    except (TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise reason_of(error) from (error.__cause__ if isinstance(error, CannotRecord) else error)


def reason_of(error: BaseException) -> CannotRecord:
    if (advice := plain_function(error)) is not None:
        return CannotRecord(f"{place(error)[2:]}: {advice}")
    if isinstance(error, CannotRecord):
        return error
    return CannotRecord(f"{type(error).__name__}: {str(error).partition(chr(10))[0]}")
