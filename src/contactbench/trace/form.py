"""The intermediate form of recorded programs.

A `Function` is a list of statements on scalars and on the elements of arrays.  Every name is assigned once, by an
`Assign`; what changes in a loop is a variable, set by `Update`.  An operand is a name or a constant.  Nothing in it
knows a back end: `python.py` prints it, `llvm.py` turns it into instructions.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple

from contactbench.numbers.dual import leaves

#: the name of a value, or a constant
Operand = str | float
#: one operand, or nested tuples of them
Results = Any
#: functions of one number that a program may call, by their names in `math`
FUNCTIONS = (
    *("exp", "expm1", "log", "log1p", "log2", "log10", "sqrt", "floor", "ceil", "erf", "erfc"),
    *("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
)


class Operation(NamedTuple):
    """A function of operands: "add", "lt", "where", …, or a name of `math`; "len" of an array."""

    function: str
    operands: tuple[Operand, ...]


class Element(NamedTuple):
    """An element of an array, `shift` places beyond its last index.

    kind : what the floating-point number there stands for: "f" itself, "i" a whole number, "b" a truth value.
    """

    array: str
    indices: tuple[Operand, ...]
    shift: Operand = 0
    kind: str = "f"


class Assign(NamedTuple):
    target: str
    value: Operation | Element


class Update(NamedTuple):
    """Variables set to new values, all at once."""

    variables: tuple[str, ...]
    values: tuple[Operand, ...]


class Store(NamedTuple):
    element: Element
    value: Operand


class Loop(NamedTuple):
    """Statements repeated for counter = 0, 1, …, times − 1."""

    counter: str
    times: Operand
    body: tuple[Any, ...]


class While(NamedTuple):
    """``while (test; condition): body``."""

    test: tuple[Any, ...]
    condition: Operand
    body: tuple[Any, ...]


class Unpack(NamedTuple):
    """Names for all entries of a sequence; in Python only."""

    targets: tuple[str, ...]
    sequence: str


@dataclass(frozen=True, eq=False)
class Digested:
    """A thing that is compared and hashed by all that it computes: `parts`, its fields."""

    def parts(self) -> tuple[Any, ...]:
        return tuple(getattr(self, field.name) for field in fields(self) if field.compare)

    @cached_property
    def digest(self) -> str:
        return digest(*self.parts())

    def __eq__(self, other: object) -> bool:
        return self.digest == other.digest if isinstance(other, type(self)) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.digest)


@dataclass(frozen=True, eq=False)
class Function(Digested):
    """A recorded function of arrays and numbers.

    result : an operand; in Python nested tuples of operands, too.
    """

    name: str
    arguments: tuple[str, ...]
    body: tuple[Any, ...]
    result: Results = 0


def digest(*parts: Any) -> str:
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def text(operand: Operand) -> str:
    """A name, or a constant as Python writes it."""
    if isinstance(operand, str):
        return operand
    if isinstance(operand, int):
        return str(operand)
    if math.isfinite(operand):
        return f"({operand!r})" if math.copysign(1.0, operand) < 0 else repr(operand)
    return "nan" if math.isnan(operand) else "inf" if operand > 0 else "(-inf)"


def read_by(statement: Any) -> set[Operand]:
    """The operands that an assignment or a store reads."""
    if isinstance(statement, Assign) and isinstance(statement.value, Operation):
        return {*statement.value.operands}
    element = statement.element if isinstance(statement, Store) else statement.value
    value = {statement.value} if isinstance(statement, Store) else set()
    return {*element.indices, element.shift, *value}


def prune(statements: list[Any], result: Results) -> tuple[Any, ...]:
    """Straight-line assignments without those that the result does not need."""
    kept, read = [], {*leaves(result)}
    for statement in reversed(statements):
        if statement.target in read:
            kept.append(statement)
            read |= read_by(statement)
    return tuple(kept[::-1])
