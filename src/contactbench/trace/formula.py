"""Formulas: functions recorded as lists of operations.

A user's function may change with the globals and attributes that it reads; a formula is what it computed when it was
recorded.  It is compared and hashed by its operations, pickled, run on every kind of number, and differentiated.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, reduce
from operator import mul
from typing import Any

import numpy as np

from contactbench.errors import BadInput
from contactbench.numbers import functions
from contactbench.numbers.dual import DERIVATIVES, leaves
from contactbench.numbers.protocol import Arithmetic, CannotRecord, has_digits
from contactbench.numbers.series import LongSeries
from contactbench.trace import form
from contactbench.trace.form import FORMS, Assign, Operand, Operation, Results, Statement, execute
from contactbench.trace.recording import Recorded, RecordedNumbers, Tape, attempt

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
        """Return the formula of some derivatives along the first argument; exact : no constant is rounded."""
        if exact and self.exact is not None:
            return self.to_all_digits.derive(choose, exact)
        tape, moved = Tape(), dict[Operand, Operand]()
        for target, operation in self.body:
            assert isinstance(operation, Operation)
            operands = [moved.get(x, x) for x in operation.operands]
            if operation.function in ("add", "mul"):
                operands.sort(key=form.text)
            there = Operation(operation.function, tuple(operands))
            moved[target] = tape.assign(there, "f", tape.root).name
        results = [moved.get(x, x) for x in leaves(self.results)]
        along = argument_names(self.arguments[:1], ())
        chosen = attempt(lambda: choose(derivatives(tape, results, along, Fraction if exact else float)))
        made = make_formula(self.arguments, self.names, tape, chosen)
        return made if exact else replace(made, exact=lambda: self.derive(choose, exact=True))


# -- reverse mode ------------------------------------------------------------------------------------
#: a constant times a number, which is 1 where there is none: constants are multiplied ahead of the run
Amount = tuple[float | Fraction, Arithmetic]
#: a constant times a product of values on the tape, in the order in which they are multiplied
Term = tuple[float | Fraction, tuple[str, ...]]
#: terms by their factors in alphabetical order
Sum = dict[tuple[str, ...], Term]
#: float, or Fraction where no constant is rounded
Kind = Callable[[float], float | Fraction]
#: floats that a constant is the sum of, at most; terms of an adjoint that are not added before they are multiplied
FLOATS, FEW = 8, 4


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
    """Return the derivatives of results along arguments, a row for each result; kind : of the constants in them."""
    operations, rows = list(tape.root.statements), []
    sums = Sums(tape, kind, along[0])
    for result in results:
        found: dict[Operand, Sum] = {result: {(): (kind(1), ())}}
        for target, (function, operands) in reversed(operations):
            adjoint = found.pop(target, None)
            if adjoint is None:
                continue
            shared = function in ("add", "sub") and all(isinstance(x, str) for x in operands)
            if len(adjoint) > (1 if shared else FEW):
                adjoint = sums.settled(adjoint)
            for operand, terms in sums.shares(function, operands, target, adjoint):
                if isinstance(operand, str):
                    own = found.setdefault(operand, {})
                    for term in terms:
                        sums.add(own, term)
        rows.append([number(sums.total(found[name])) if found.get(name) else 0.0 for name in along])
    return rows


class Sums:
    """Sums of products of values on a tape: known products are found, common factors taken out."""

    def __init__(self, tape: Tape, kind: Kind, argument: str) -> None:
        self.tape, self.kind = tape, kind
        # the last factor has all digits, and so has a constant alone
        self.unit: Arithmetic = 1.0 if kind is float else self.value(argument) * 0.0 + 1.0
        self.made: dict[str, Operation] = dict(tape.root.statements)
        self.inverses: dict[Operand, str] = {}
        self.powers: dict[Operand, tuple[Operand, int]] = {}
        for name, (function, operands) in self.made.items():
            if function == "div" and operands[0] == 1:
                self.inverses[operands[1]] = name
            if function == "mul":
                (base, n), (other, m) = (self.powers.get(x, (x, 1)) for x in operands)
                if base == other:
                    self.powers[name] = base, n + m

    def value(self, name: str) -> Recorded:
        return Recorded(self.tape, name, "f", self.tape.root)

    def inverse(self, name: str) -> str:
        if name not in self.inverses:
            self.inverses[name] = (1.0 / self.value(name)).name
        return self.inverses[name]

    def term(self, x: Arithmetic | Operand) -> Term:
        """Return a value as a constant times a value that is no multiple of another one by a constant."""
        name = x.name if isinstance(x, Recorded) else x
        self.made.update(self.tape.root.statements[len(self.made) :])
        if not isinstance(name, str):
            return self.kind(float(name)), ()  # type: ignore[arg-type]
        function, operands = self.made.get(name, ("", ()))
        match function, operands:
            case "neg", (a,):
                return self.times((self.kind(-1), ()), self.term(a))
            case "mul", (float() as c, a) | (a, float() as c):
                return self.times((self.kind(c), ()), self.term(a))
            case "div", (str() as a, float() as c):
                return self.times((1 / self.kind(c), ()), self.term(a))
            case "div", (-1.0, str() as b):
                return self.kind(-1), (self.inverse(b),)
        return self.kind(1), (name,)

    def times(self, a: Term, b: Term) -> Term:
        factors = list(a[1])
        for new in b[1]:  # a product that is known replaces its factors
            for i, old in enumerate(factors):
                product = self.tape.root.known.get(("mul", *sorted((old, new))))
                if product is not None:
                    factors[i] = product
                    break
            else:
                factors.append(new)
        return a[0] * b[0], tuple(factors)

    def add(self, into: Sum, term: Term) -> None:
        place = tuple(sorted(term[1]))
        before, factors = into.pop(place, (self.kind(0), term[1]))
        if coefficient := before + term[0]:
            into[place] = coefficient, factors

    def settled(self, terms: Sum) -> Sum:
        """Return a sum as one value."""
        # one value for a sum and its negative, with a constant term of 1, which needs no product
        unit = terms[()][0] if () in terms else self.kind(math.copysign(1, terms[min(terms)][0]))
        coefficient, x = self.total({place: (c / unit, factors) for place, (c, factors) in terms.items()})
        coefficient = coefficient * unit
        factor = self.term(x) if isinstance(x, Recorded) else (self.kind(1), ())
        term = coefficient * factor[0], factor[1]
        return {term[1]: term}

    def total(self, terms: Sum) -> Amount:
        """Compute a sum, by Horner's scheme in the factor that most terms have."""
        if not terms:
            return self.kind(0), self.unit
        counts = Counter(factor for place in terms for factor in dict.fromkeys(place))
        common, count = max(counts.items(), key=lambda each: each[1], default=("", 0))
        if len(terms) > 1 and count > 1:
            inside: Sum = {}
            rest: Sum = {}
            for place, (coefficient, factors) in terms.items():
                if common in place:
                    at = factors.index(common)
                    self.add(inside, (coefficient, (*factors[:at], *factors[at + 1 :])))
                else:
                    rest[place] = coefficient, factors
            coefficient, x = self.total(inside)
            product = coefficient, x * self.value(common)
            return plus(product, self.total(rest)) if rest else product
        sizes: dict[Any, list[Amount]] = {}
        for coefficient, factors in terms.values():
            x = reduce(mul, map(self.value, factors)) if factors else self.unit
            sizes.setdefault(abs(coefficient), []).append((coefficient, x))
        alike = (sorted(amounts, key=lambda amount: amount[0] < 0) for amounts in sizes.values())
        return reduce(plus, [reduce(plus, amounts) for amounts in alike])

    def shares(
        self, function: str, operands: Sequence[Operand], target: str, adjoint: Sum
    ) -> Iterator[tuple[Operand, list[Term]]]:
        """Yield the operands of an operation with the terms that it adds to their adjoints."""
        if function == "where":
            condition, amount = self.value(str(operands[0])), number(self.total(adjoint))
            for operand, both in zip(operands[1:], ((amount, 0.0), (0.0, amount)), strict=True):
                yield operand, [self.term(RecordedNumbers(self.tape).where(condition, *both))]
            return
        for i, (operand, slope) in enumerate(
            zip(operands, self.slopes(function, operands, target), strict=True)
        ):
            if function == "div" and i == 1 and operand in self.powers:
                base, n = self.powers[operand]
                operand, slope = (
                    base,
                    self.times(self.term(target), (self.kind(-n), (self.inverse(str(base)),))),
                )
            if slope[0]:
                yield operand, [self.times(term, slope) for term in adjoint.values()]

    def slopes(self, function: str, operands: Sequence[Operand], target: str) -> Sequence[Term]:
        """Return the derivatives of an operation along its operands."""
        kind, term, times = self.kind, self.term, self.times
        xp, y = RecordedNumbers(self.tape), self.value(target)
        x: list[Any] = [self.value(o) if isinstance(o, str) else o for o in operands]
        one, minus = (kind(1), ()), (kind(-1), ())
        match function:
            case "add":
                return one, one
            case "sub":
                return one, minus
            case "neg":
                return [minus]
            case "mul":
                return term(x[1]), term(x[0])
            case "div" if isinstance(operands[1], str):
                inverse = kind(1), (self.inverse(operands[1]),)
                return inverse, times(minus, times(term(y), inverse))
            case "div":
                return (1 / kind(x[1]), ()), one
            case "sqrt":
                return [(kind(0.5), (self.inverse(target),))]
            case "pow":
                known = not isinstance(operands[1], str)
                rounded = known and kind(x[1]) - 1 != x[1] - 1
                below = term(y / x[0] if rounded else x[0] ** (x[1] - 1))
                return times(term(x[1]), below), one if known else term(y * xp.log(x[0]))
            case "atan2":
                square = x[0] * x[0] + x[1] * x[1]
                return term(x[1] / square), times(minus, term(x[0] / square))
            case "hypot":
                return term(x[0] / y), term(x[1] / y)
        if function not in DERIVATIVES:
            raise CannotRecord(f"no derivative of {function} is known")
        return [term(DERIVATIVES[function](xp, x[0], y))]


def plus(a: Amount, b: Amount) -> Amount:
    if a[0] < 0 < b[0]:
        a, b = b, a
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
