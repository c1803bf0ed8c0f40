"""Formulas: functions recorded as lists of operations.

A user's function may change with the globals and attributes that it reads; a formula is what it computed when it was
recorded.  It is compared and hashed by its operations, pickled, run on every kind of number, and differentiated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from contactbench.errors import BadInput
from contactbench.numbers import functions
from contactbench.numbers.dual import DERIVATIVES, leaves
from contactbench.numbers.protocol import Arithmetic, CannotRecord, has_digits
from contactbench.numbers.series import LongSeries
from contactbench.trace import form
from contactbench.trace.form import FORMS, Assign, Operand, Operation, Results, Statement, execute
from contactbench.trace.recording import Recorded, RecordedNumbers, Tape, attempt, operand_of

# -- how formulas are written, for numbers that may be arrays or traced ------------------------------
WRITTEN = FORMS | {
    "where": "where({}, {}, {})",
    "and": "({0} and {1} if isinstance({0}, bool) else {0} & {1})",
    "or": "({0} or {1} if isinstance({0}, bool) else {0} | {1})",
    "not": "(not {0} if isinstance({0}, bool) else ~{0})",
}
SCOPE: dict[str, object] = {
    **{name: functions.function(name) for name in form.FUNCTIONS},
    "atan2": functions.atan2,
    "hypot": functions.hypot,
    "where": functions.where,
    "inf": math.inf,
    "nan": math.nan,
}


@dataclass(frozen=True, eq=False, repr=False)
class Formula(form.Digested):
    """The operations of a function of numbers.

    arguments : of every positional argument the length of the tuple it is, 0 for a number, "xp" for a namespace of
    numbers, which is not read.  names : keyword arguments, numbers.  body : `Operation`s, on the arguments v0, v1, …
    one after the other.  results : the operand that is returned, or nested tuples of them.
    live : the function it was recorded from.  exact : of a derivative, the same with no constant rounded.
    Raises `BadInput` for an argument of another length.
    """

    arguments: tuple[int | str, ...]
    names: tuple[str, ...]
    body: tuple[Assign, ...]
    results: Results
    live: Callable[..., object] | None = field(default=None, compare=False)
    exact: Callable[[], Formula] | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        name = getattr(self.live, "__name__", "derived" if self.live is None else type(self.live).__name__)
        return f"<formula of {name}: {len(self.body)} operations>"

    def __reduce__(self) -> tuple[type[Formula], tuple[object, ...]]:
        return Formula, self.compared()

    @cached_property
    def function(self) -> Callable[..., Any]:
        signature: list[str] = []
        body: list[Statement] = []
        supply = iter(argument_names(self.arguments, self.names))
        for i, n in enumerate(self.arguments):
            if isinstance(n, str) or not n:
                signature.append("xp" if n else next(supply))
            else:
                signature.append(f"tuple{i}")
                body.append(form.Unpack(tuple(next(supply) for _ in range(n)), f"tuple{i}"))
        # parameters go by position: one may be called as a variable of the tape is
        written = form.Function("formula", (*signature, *supply), (*body, *self.body), self.results)
        return execute(written, WRITTEN, SCOPE)

    def __call__(self, *arguments: Any, **named: Arithmetic) -> Any:
        for given, n in zip(arguments, self.arguments, strict=True):
            if isinstance(n, int) and n and len(given) != n:
                raise BadInput(f"{len(given)} components: this function was recorded for {n}")
        if self.exact is not None and all_digits_count(arguments[0]):
            return self.to_all_digits(*arguments, **named)
        if len(named) != len(self.names):
            raise TypeError(
                f"parameters {', '.join(named)}: this function takes {', '.join(self.names) or 'none'}"
            )
        return self.function(*arguments, *[named[name] for name in self.names])

    @cached_property
    def to_all_digits(self) -> Formula:
        assert self.exact is not None
        return self.exact()

    def taken[X](self, parameters: Mapping[str, X]) -> dict[str, X]:
        """Return the parameters that it takes."""
        return {name: parameters[name] for name in self.names}

    # -- derivatives -------------------------------------------------------------------------------
    def gradient(self) -> Formula:
        """Return the derivative of the result by the first argument; `CannotRecord` where it is not known."""
        return self.derive(lambda rows: rows[0])

    def hessian(self) -> Formula:
        """Return the derivative of a gradient, a row for each component: symmetric, and its zeros are constants."""
        return self.derive(
            lambda rows: [[rows[max(i, j)][min(i, j)] for j in range(len(rows))] for i in range(len(rows))]
        )

    def derive(self, choose: Callable[[list[list[Arithmetic]]], object], exact: bool = False) -> Formula:
        """Return the formula of selected derivatives of all results along the first argument.

        exact : the constants in it, which are products of those of the function, are not rounded.
        """
        if exact and self.exact is not None:
            return self.to_all_digits.derive(choose, exact)
        tape, moved = Tape(), dict[Operand, Operand]()
        for target, operation in self.body:
            assert isinstance(operation, Operation)
            there = Operation(operation.function, tuple(moved.get(x, x) for x in operation.operands))
            moved[target] = tape.assign(there, "f", tape.root).name
        results = [moved.get(x, x) for x in leaves(self.results)]
        along = argument_names(self.arguments[:1], ())
        chosen = attempt(lambda: choose(derivatives(tape, results, along, Fraction if exact else float)))
        made = make_formula(self.arguments, self.names, tape, chosen)
        return made if exact else replace(made, exact=lambda: self.derive(choose, exact=True))


# -- reverse mode ------------------------------------------------------------------------------------
#: a constant times a number, which is 1 where there is none: constants are multiplied ahead of the run
Amount = tuple[float | Fraction, Arithmetic]
#: float, or Fraction where no constant is rounded
Kind = Callable[[float], float | Fraction]
#: floats that a constant is the sum of, at most
FLOATS = 8


def all_digits_count(x: object) -> bool:
    """Return whether numbers have more digits than a float."""
    first = x[0] if isinstance(x, tuple | list) else x
    if isinstance(first, float):
        return False
    if isinstance(first, np.ndarray):
        return bool(first.dtype == object)
    return isinstance(first, LongSeries) or has_digits(functions.namespace(first))


def derivatives(
    tape: Tape, results: Sequence[Operand], along: Sequence[str], kind: Kind
) -> list[list[Arithmetic]]:
    """Return the derivatives of results along arguments, a row for each result; kind : of the constants in them.

    Griewank, Walther, Evaluating Derivatives, 2nd ed., SIAM 2008, §3.2.
    """
    operations, rows = list(tape.root.statements), []
    # the last factor has all digits, and so has a constant alone
    unit = 1.0 if kind is float else Recorded(tape, along[0], "f", tape.root) * 0.0 + 1.0
    for result in results:
        found: dict[Operand, Amount] = {result: (kind(1), unit)}
        for target, (function, operands) in reversed(operations):
            adjoint = found.pop(target, None)
            if adjoint is None:
                continue
            parts = slopes(tape, function, operands, target, adjoint, kind)
            for operand, slope in zip(operands, parts, strict=True):
                if isinstance(operand, str) and slope[0]:
                    share = slope if function == "where" else times(adjoint, slope)
                    found[operand] = plus(found[operand], share) if operand in found else share
        rows.append([number(found[name]) if name in found else 0.0 for name in along])
    return rows


def slopes(
    tape: Tape,
    function: str,
    operands: Sequence[Operand],
    target: str,
    adjoint: Amount,
    kind: Kind,
) -> Sequence[Amount]:
    """Return the derivatives of an operation along its operands; of a choice, of the result."""

    def constant(x: Arithmetic) -> Amount:
        return (kind(1), x) if isinstance(x, Recorded) else (kind(float(x)), 1.0)

    xp, y = RecordedNumbers(tape), Recorded(tape, target, "f", tape.root)
    x: list[Any] = [Recorded(tape, o, "f", tape.root) if isinstance(o, str) else o for o in operands]
    one, minus = (kind(1), 1.0), (kind(-1), 1.0)
    match function:
        case "add":
            return one, one
        case "sub":
            return one, minus
        case "neg":
            return [minus]
        case "mul":
            return constant(x[1]), constant(x[0])
        case "div" if isinstance(operands[1], str):
            inverse = 1.0 / x[1]
            return (kind(1), inverse), (kind(-1), y * inverse)
        case "div":
            return (1 / kind(x[1]), 1.0), one
        case "sqrt":
            return [(kind(0.5), 1.0 / y)]
        case "pow":
            known = not isinstance(operands[1], str)
            rounded = known and kind(x[1]) - 1 != x[1] - 1
            exponent, below = constant(x[1]), constant(y / x[0] if rounded else x[0] ** (x[1] - 1))
            return times(exponent, below), one if known else (kind(1), y * xp.log(x[0]))
        case "atan2":
            square = x[0] * x[0] + x[1] * x[1]
            return (kind(1), x[1] / square), (kind(-1), x[0] / square)
        case "hypot":
            return (kind(1), x[0] / y), (kind(1), x[1] / y)
        case "where":
            amount = number(adjoint)
            return (
                (kind(0), 1.0),
                (kind(1), xp.where(x[0], amount, 0.0)),
                (kind(1), xp.where(x[0], 0.0, amount)),
            )
    if function not in DERIVATIVES:
        raise CannotRecord(f"no derivative of {function} is known")
    return [constant(DERIVATIVES[function](xp, x[0], y))]


def times(a: Amount, b: Amount) -> Amount:
    return a[0] * b[0], a[1] * b[1]


def plus(a: Amount, b: Amount) -> Amount:
    if operand_of(a[1]) == operand_of(b[1]):
        return a[0] + b[0], a[1]
    if abs(a[0]) == abs(b[0]):
        return a[0], a[1] + b[1] if a[0] == b[0] else a[1] - b[1]
    one = Fraction(1) if isinstance(a[0], Fraction) else 1.0
    return one, number(a) + number(b)


def number(amount: Amount) -> Arithmetic:
    coefficient, x = amount
    if not coefficient:
        return 0.0
    if coefficient == -1:
        return -x
    if not isinstance(coefficient, Fraction):
        return coefficient * x
    parts, rest = list[float](), coefficient
    while rest and len(parts) < FLOATS:
        parts.append(float(rest))
        rest -= Fraction(parts[-1])
    above, below = coefficient.numerator, coefficient.denominator
    if rest and above == float(above) and below == float(below):
        return x * float(above) / float(below)
    return sum((x * part for part in parts[1:]), x * parts[0])


def argument_names(arguments: tuple[int | str, ...], names: Sequence[str]) -> tuple[str, ...]:
    return tuple(f"v{i}" for i in range(sum(n or 1 for n in arguments if isinstance(n, int)) + len(names)))


def formula(function: Callable[..., Any], arguments: tuple[int | str, ...], names: Sequence[str]) -> Formula:
    tape = Tape()
    supply = (Recorded(tape, name, "f", tape.root) for name in argument_names(arguments, names))
    given: list[object] = []
    for n in arguments:
        if isinstance(n, str):
            given.append(RecordedNumbers(tape))
        else:
            given.append(tuple(next(supply) for _ in range(n)) if n else next(supply))
    named = dict(zip(names, supply, strict=True))
    return make_formula(arguments, tuple(names), tape, attempt(lambda: function(*given, **named)), function)


def make_formula(
    arguments: tuple[int | str, ...],
    names: tuple[str, ...],
    tape: Tape,
    results: object,
    live: Callable[..., object] | None = None,
) -> Formula:
    found = tape.results(results)
    return Formula(arguments, names, form.prune(tape.root.statements, found), found, live)
