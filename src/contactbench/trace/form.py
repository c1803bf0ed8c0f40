"""The intermediate form of recorded programs: statements on scalars and on the elements of arrays.

Every name is assigned once, by an `Assign`; what changes in a loop is a variable, set by `Update`.  `execute` prints a
`Function` as Python; `compiled.py` turns it into instructions.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
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
    """An array's element, `shift` beyond its last index; kind : as of `Recorded`, or "stop", which threads set."""

    array: str
    indices: tuple[Operand, ...]
    shift: Operand = 0
    kind: str = "f"


class Assign(NamedTuple):
    target: str
    value: Operation | Element


class Update(NamedTuple):
    variables: tuple[str, ...]
    values: tuple[Operand, ...]


class Store(NamedTuple):
    element: Element
    value: Operand


class Allocate(NamedTuple):
    """A local array; every number is stored before it is read."""

    array: str
    size: int


class Combine(NamedTuple):
    """``into[c] = Σ weights[shift + j] rows[j·width + c]``, j < terms, c < width; `late` first rows come last."""

    into: str
    weights: Element
    rows: str
    terms: Operand
    width: int
    late: int


class Loop(NamedTuple):
    """Statements repeated for counter = 0, 1, …, times − 1."""

    counter: str
    times: Operand
    body: tuple[Statement, ...]


class While(NamedTuple):
    """``while (test; condition): body``."""

    test: tuple[Statement, ...]
    condition: Operand
    body: tuple[Statement, ...]


class Unpack(NamedTuple):
    """Names for all entries of a sequence; in Python only."""

    targets: tuple[str, ...]
    sequence: str


type Statement = Assign | Update | Store | Allocate | Combine | Loop | While | Unpack


@dataclass(frozen=True, eq=False)
class Digested:
    """A base for classes that are compared and hashed by their fields."""

    def compared(self) -> tuple[object, ...]:
        return tuple(getattr(self, field.name) for field in fields(self) if field.compare)

    @cached_property
    def digest(self) -> str:
        return digest(*self.compared())

    def __eq__(self, other: object) -> bool:
        return self.digest == other.digest if isinstance(other, type(self)) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.digest)


@dataclass(frozen=True, eq=False)
class Function(Digested):
    """A recorded function of arrays and numbers; result : an operand, in Python also nested tuples of them."""

    name: str
    arguments: tuple[str, ...]
    body: tuple[Statement, ...]
    result: Results = 0


def digest(*parts: object) -> str:
    """Return a digest of objects by their representation."""
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def text(operand: Operand) -> str:
    if isinstance(operand, str):
        return operand
    if isinstance(operand, int):
        return str(operand)
    if math.isfinite(operand):
        return f"({operand!r})" if math.copysign(1.0, operand) < 0 else repr(operand)
    return "nan" if math.isnan(operand) else "inf" if operand > 0 else "(-inf)"


def read_by(statement: Assign | Store) -> set[Operand]:
    """Return the operands that a statement reads."""
    if isinstance(statement, Assign) and isinstance(statement.value, Operation):
        return {*statement.value.operands}
    element: Any = statement.element if isinstance(statement, Store) else statement.value
    stored = {statement.value} if isinstance(statement, Store) else set()
    return {*element.indices, element.shift, *stored}


def prune(statements: Sequence[Assign], result: Results) -> tuple[Assign, ...]:
    """Return the assignments that the result needs, in order."""
    kept, read = [], {*leaves(result)}
    for statement in reversed(statements):
        if statement.target in read:
            kept.append(statement)
            read |= read_by(statement)
    return tuple(kept[::-1])


# -- printed as Python, and run by Python itself: arrays are lists of lists there --------------------------
#: operations that are no calls
NAMES = ("add", "sub", "mul", "div", "pow", "lt", "le", "gt", "ge", "eq", "ne", "and", "or")
SIGNS = ("+", "-", "*", "/", "**", "<", "<=", ">", ">=", "==", "!=", "and", "or")
FORMS = {
    **{name: f"{{}} {sign} {{}}" for name, sign in zip(NAMES, SIGNS, strict=True)},
    "neg": "-{}",
    "not": "not {}",
    "where": "{1} if {0} else {2}",
}
#: the names that printed functions use
SCOPE = {name: getattr(math, name) for name in (*FUNCTIONS, "atan2", "hypot", "inf", "nan")}
READ = {"f": "{}", "i": "int({})", "stop": "int({})", "b": "{} != 0.0"}


def execute(
    function: Function, forms: Mapping[str, str] = FORMS, scope: Mapping[str, object] = SCOPE
) -> Callable[..., Any]:
    """Return the function, run by Python; forms : how operations are written, scope : what names stand for."""
    names: dict[str, Any] = dict(scope)
    exec(source(function, forms), names)
    made: Callable[..., Any] = names[function.name]
    return made


def source(function: Function, forms: Mapping[str, str] = FORMS) -> str:
    head = f"def {function.name}({', '.join(function.arguments)}):"
    return "\n".join([head, *lines(function.body, forms), f"    return {render(function.result)}", ""])


def render(results: Results) -> str:
    if isinstance(results, tuple):
        return f"({''.join(f'{render(part)}, ' for part in results)})"
    return text(results)


def place(element: Element) -> str:
    *rows, last = map(text, element.indices)
    if element.shift != 0:
        last = f"{last} + {text(element.shift)}"
    return "".join([element.array, *(f"[{index}]" for index in (*rows, last))])


def value(expression: Operation | Element, forms: Mapping[str, str]) -> str:
    if isinstance(expression, Element):
        return READ[expression.kind].format(place(expression))
    function, operands = expression
    template = forms.get(function) or f"{function}({', '.join(['{}'] * len(operands))})"
    return template.format(*map(text, operands))


def lines(body: Sequence[Statement], forms: Mapping[str, str] = FORMS, indent: str = "    ") -> Iterator[str]:
    within = indent + "    "
    for statement in body:
        match statement:
            case Assign(target, expression):
                yield f"{indent}{target} = {value(expression, forms)}"
            case Update(variables, values):
                yield f"{indent}{', '.join(variables)} = {', '.join(map(text, values))}"
            case Unpack(targets, sequence):
                yield f"{indent}{', '.join(targets)}, = {sequence}"
            case Store(element, stored):
                number = f"1.0 if {text(stored)} else 0.0" if element.kind == "b" else text(stored)
                yield f"{indent}{place(element)} = {number}"
            case Allocate(array, size):
                yield f"{indent}{array} = [0.0] * {size}"
            case Combine(into, weights, rows, terms, width, late):
                yield f"{indent}for c in range({width}):"
                yield f"{within}{into}[c] = 0.0"
                yield f"{within}for r in (*range({late}, {text(terms)}), *range({late})):"
                yield f"{within}    {into}[c] += {place(weights)[:-1]} + r] * {rows}[r * {width} + c]"
            case Loop(index, times, inner):
                yield f"{indent}for {index} in range({text(times)}):"
                yield from lines(inner, forms, within)
            case While(test, condition, inner):
                yield f"{indent}while True:"
                yield from lines(test, forms, within)
                yield f"{within}if not {text(condition)}:"
                yield f"{within}    break"
                yield from lines(inner, forms, within)
