"""A function recorded as a list of operations: a formula.

A user's function is a Python object that may do another thing tomorrow: it reads globals, closures, attributes.  A
formula is what it computed when it was recorded, and nothing else.  It is compared and hashed by its operations, can
be pickled, runs on every kind of number that the function ran on, and is differentiated operation by operation.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from heapq import heappop, heappush
from typing import Any

from contactbench.errors import BadInput
from contactbench.numbers import functions
from contactbench.numbers.dual import DERIVATIVES
from contactbench.trace.recording import (
    FUNCTIONS,
    CannotRecord,
    Recorded,
    RecordedNumbers,
    Tape,
    recorded,
    text_of,
)

#: an operand or a result: the place of an argument or an operation, or a constant
Operand = int | float
#: of a result: one operand, a tuple of them, rows of them
Results = Any
NAMESPACE = "xp"
#: how operations are written where a number may be an array or a traced one
WRITTEN = {
    "{1} if {0} else {2}": "where({0}, {1}, {2})",
    "{0} and {1}": "both({0}, {1})",
    "{0} or {1}": "either({0}, {1})",
    "not {0}": "invert({0})",
}


class FormulaTape(Tape):
    """A recording that keeps its operations, equal ones once."""

    def __init__(self, arguments: int) -> None:
        super().__init__()
        self.arguments = [Recorded(self, f"v{i}", "f", self.root) for i in range(arguments)]
        self.operations: list[tuple[str, str, tuple[Operand, ...]]] = []
        self.places: dict[tuple[str, ...], int] = {}

    def operation(self, form: str, kind: str, *operands: Any) -> Recorded:
        given = tuple(map(self.operand, operands))
        key = (form, *map(repr, given))
        if key not in self.places:
            self.places[key] = len(self.arguments) + len(self.operations)
            self.operations.append((form, kind, given))
        return self.at(self.places[key], kind)

    def operand(self, x: Any) -> Operand:
        """The place of a recorded number, or a constant."""
        if not isinstance(x, Recorded):
            text_of(x)  # raises where it is no number
            return float(x)
        if x.tape is not self:
            raise CannotRecord("numbers of different origin are combined")
        return int(x.name[1:])

    def at(self, place: int, kind: str = "f") -> Recorded:
        """The number at a place."""
        return Recorded(self, f"v{place}", kind, self.root)

    def value(self, operand: Operand) -> Any:
        """The number an operand stands for."""
        if isinstance(operand, float):
            return operand
        before = operand - len(self.arguments)
        return self.at(operand, "f" if before < 0 else self.operations[before][1])


@dataclass(frozen=True, eq=False, repr=False)
class Formula:
    """What a function of numbers computes.

    arguments : of every positional argument the length of the tuple it is, 0 for a number, "xp" for a namespace of
    numbers, which is not read.  names : keyword arguments, numbers.  operations : (form, kind, operands).
    results : the operand that is returned, or nested tuples of them.  live : the function it was recorded from.
    Raises `BadInput` for an argument of another length.
    """

    arguments: tuple[int | str, ...]
    names: tuple[str, ...]
    operations: tuple[tuple[str, str, tuple[Operand, ...]], ...]
    results: Results
    live: Callable[..., Any] | None = None

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all that it computes."""
        text = repr((self.arguments, self.names, self.operations, self.results))
        return hashlib.sha256(text.encode()).hexdigest()

    def __repr__(self) -> str:
        name = getattr(self.live, "__name__", "derived" if self.live is None else type(self.live).__name__)
        return f"<formula of {name}: {len(self.operations)} operations>"

    def __eq__(self, other: object) -> bool:
        return self.digest == other.digest if isinstance(other, Formula) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.digest)

    def __reduce__(self) -> Any:
        return Formula, (self.arguments, self.names, self.operations, self.results)

    @property
    def size(self) -> int:
        """The number of its arguments, every component counted."""
        return sum(n or 1 for n in self.arguments if isinstance(n, int)) + len(self.names)

    @property
    def source(self) -> str:
        """The formula as a Python function."""
        place, lines, signature = 0, [], []
        for i, n in enumerate(self.arguments):
            signature.append(NAMESPACE if n == NAMESPACE else f"a{i}" if n else f"v{place}")
            if isinstance(n, int):
                if n:
                    lines.append(f"{''.join(f'v{place + j}, ' for j in range(n))}= a{i}")
                place += n or 1
        lines += [f"v{place + j} = {name}" for j, name in enumerate(self.names)]
        for i, (form, _, operands) in enumerate(self.operations, self.size):
            lines.append(f"v{i} = {WRITTEN.get(form, form).format(*map(_written, operands))}")
        lines.append(f"return {_written(self.results)}")
        return "\n    ".join([f"def formula({', '.join([*signature, *self.names])}):", *lines, ""])

    @cached_property
    def function(self) -> Callable[..., Any]:
        scope = dict(SCOPE)
        exec(self.source, scope)
        return scope["formula"]

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        for given, n in zip(arguments, self.arguments, strict=True):
            if isinstance(n, int) and n and len(given) != n:
                raise BadInput(f"{len(given)} components: this function was recorded for {n}")
        return self.function(*arguments, **named)

    # -- derivatives -------------------------------------------------------------------------------
    def replayed(self) -> FormulaTape:
        """A tape with its operations at their places."""
        tape = FormulaTape(self.size)
        for form, kind, operands in self.operations:
            tape.operation(form, kind, *map(tape.value, operands))
        return tape

    def gradient(self) -> Formula:
        """The derivative of a single result along the components of the first argument, by reverse mode.

        Raises `CannotRecord` for a function whose derivative is not known.
        """
        tape = self.replayed()
        return self.derived(
            tape,
            tuple(recorded(lambda: Adjoints(tape, self.parameters).along(self.results, self.components))),
        )

    def jacobian(self, symmetric: bool = False) -> Formula:
        """The derivative of a tuple of results, a row for each; zeros are constants.

        symmetric : it is, so that half of it is enough.
        """
        tape, n = self.replayed(), self.components
        adjoints = Adjoints(tape, self.parameters)

        def row(result: Operand) -> list[Any]:
            found = adjoints.along(result, n)
            adjoints.found.clear()
            return found

        rows = [recorded(lambda out=out: row(out)) for out in self.results]  # type: ignore[misc]
        if symmetric:
            for i in range(n):
                rows[i][i + 1 :] = [rows[j][i] for j in range(i + 1, n)]
        return self.derived(tape, tuple(map(tuple, rows)))

    @property
    def components(self) -> int:
        """The number of components of the first argument."""
        n = self.arguments[0]
        assert isinstance(n, int)
        return n or 1

    @property
    def parameters(self) -> range:
        """The places of the keyword arguments."""
        return range(self.size - len(self.names), self.size)

    def derived(self, tape: FormulaTape, results: Results) -> Formula:
        """A formula of the same arguments."""
        return finished(self.arguments, self.names, tape, results)


def formula(function: Callable[..., Any], arguments: tuple[int | str, ...], names: Sequence[str]) -> Formula:
    """Record a function; arguments, names : as in `Formula`.  Raises `CannotRecord`."""
    tape = FormulaTape(sum(n or 1 for n in arguments if isinstance(n, int)) + len(names))
    supply = iter(tape.arguments)
    given: list[Any] = []
    for n in arguments:
        if isinstance(n, str):
            given.append(RecordedNumbers(tape))
        else:
            given.append(tuple(next(supply) for _ in range(n)) if n else next(supply))
    named = dict(zip(names, supply, strict=True))
    return finished(arguments, tuple(names), tape, recorded(lambda: function(*given, **named)), function)


def finished(
    arguments: tuple[int | str, ...],
    names: tuple[str, ...],
    tape: FormulaTape,
    results: Results,
    live: Callable[..., Any] | None = None,
) -> Formula:
    """The formula of some results, without the operations that none of them needs."""
    operands = _operands(tape, results)
    first = len(tape.arguments)
    wanted = {x for x in _leaves(operands) if isinstance(x, int) and x >= first}
    waiting = list(wanted)
    while waiting:
        for x in tape.operations[waiting.pop() - first][2]:
            if isinstance(x, int) and x >= first and x not in wanted:
                wanted.add(x)
                waiting.append(x)
    order = sorted(wanted)
    moved: dict[Any, int] = dict(zip(order, range(first, first + len(order)), strict=True))

    def again(x: Operand) -> Operand:
        return moved.get(x, x) if isinstance(x, int) else x

    operations = tuple(
        (form, kind, tuple(map(again, given)))
        for form, kind, given in (tape.operations[place - first] for place in order)
    )
    return Formula(arguments, names, operations, _mapped(again, operands), live)


def _operands(tape: FormulaTape, results: Any) -> Results:
    if isinstance(results, tuple | list):
        return tuple(_operands(tape, part) for part in results)
    return tape.operand(results)


def _mapped(change: Callable[[Operand], Operand], results: Results) -> Results:
    if isinstance(results, tuple):
        return tuple(_mapped(change, part) for part in results)
    return change(results)


def _leaves(results: Results) -> Iterator[Operand]:
    if isinstance(results, tuple):
        for part in results:
            yield from _leaves(part)
    else:
        yield results


def _written(results: Results) -> str:
    if isinstance(results, tuple):
        return f"({''.join(f'{_written(part)}, ' for part in results)})"
    return text_of(results) if isinstance(results, float) else f"v{results}"


# -- reverse mode ----------------------------------------------------------------------------------
#: factors a product is written out to
LONGEST = 8
#: a product of the numbers at some places, and sums of them: place … place → coefficient
Product = tuple[int, ...]
Sum = dict[Product, float]


class Adjoints:
    """Derivatives of one result along what it was computed from, the last operation first.

    They are kept as sums of products of numbers, so that equal products meet, constants are multiplied ahead of
    the run, and what all products share is multiplied once: short code, which is what a force is to be.

    Griewank, Walther, Evaluating Derivatives, 2nd ed., SIAM 2008, §3.2, doi:10.1137/1.9780898717761.
    """

    def __init__(self, tape: FormulaTape, parameters: range) -> None:
        self.tape, self.parameters = tape, parameters
        self.found: dict[int, Sum] = {}
        self.waiting: list[int] = []

    def along(self, result: Operand, n: int) -> list[Any]:
        """The derivatives of a result along the first n arguments."""
        first = len(self.tape.arguments)
        self.add(result, {(): 1.0})
        while self.waiting:
            place = -heappop(self.waiting)
            form, _, operands = self.tape.operations[place - first]
            self.share(form, operands, place, self.found.pop(place))
        return [self.number(self.found[i]) if i in self.found else 0.0 for i in range(n)]

    def add(self, operand: Operand, amount: Sum) -> None:
        """Add to the derivative along an operand."""
        if isinstance(operand, float):
            return
        if operand not in self.found:
            self.found[operand] = {}
            if operand >= len(self.tape.arguments):
                heappush(self.waiting, -operand)
        found = self.found[operand]
        for product, coefficient in amount.items():
            found[product] = found.get(product, 0.0) + coefficient
            if not found[product]:
                del found[product]

    def share(self, form: str, operands: tuple[Operand, ...], place: int, adjoint: Sum) -> None:
        """Add to the operands of an operation what its adjoint is worth to them."""
        xp, y = RecordedNumbers(self.tape), self.tape.at(place)
        x = [self.tape.value(operand) for operand in operands]
        match form:
            case "{0} + {1}":
                self.add(operands[0], adjoint)
                self.add(operands[1], adjoint)
            case "{0} - {1}":
                self.add(operands[0], adjoint)
                self.add(operands[1], {product: -c for product, c in adjoint.items()})
            case "{0} / {1}" if operands[0] == 1.0 and isinstance(operands[0], float):
                self.add(operands[1], self.times(adjoint, -1.0, (place, place)))
            case "-{0}" | "{0} * {1}" | "{0} / {1}":
                coefficient, factors = self.product(place)
                for factor in dict.fromkeys(factors):
                    rest = list(factors)
                    rest.remove(factor)
                    times = coefficient * factors.count(factor)
                    self.add(factor, self.times(adjoint, times, tuple(rest)))
            case "{0} ** {1}" if isinstance(x[1], float):
                self.chain(operands[0], adjoint, x[0] ** (x[1] - 1), x[1])
            case "{0} ** {1}":
                if not isinstance(x[0], float):
                    self.chain(operands[0], adjoint, x[1] * x[0] ** (x[1] - 1))
                self.chain(operands[1], adjoint, y * xp.log(x[0]))
            case "abs({0})":
                self.chain(operands[0], adjoint, xp.where(x[0] < 0, -1.0, 1.0))
            case "sqrt({0})":
                self.chain(operands[0], adjoint, 1.0 / y, 0.5)
            case "atan2({0}, {1})":
                square = x[0] * x[0] + x[1] * x[1]
                self.chain(operands[0], adjoint, x[1] / square)
                self.chain(operands[1], adjoint, x[0] / square, -1.0)
            case "hypot({0}, {1})":
                self.chain(operands[0], adjoint, x[0] / y)
                self.chain(operands[1], adjoint, x[1] / y)
            case "{1} if {0} else {2}":
                amount = self.number(adjoint)
                self.chain(operands[1], {(): 1.0}, xp.where(x[0], amount, 0.0))
                self.chain(operands[2], {(): 1.0}, xp.where(x[0], 0.0, amount))
            case _:
                name = form.partition("(")[0]
                if name not in DERIVATIVES:
                    raise CannotRecord(f"no derivative of {name} is known")
                self.chain(operands[0], adjoint, DERIVATIVES[name](xp, x[0], y))

    def chain(self, operand: Operand, adjoint: Sum, slope: Any, coefficient: float = 1.0) -> None:
        """Add adjoint · coefficient · slope to the derivative along an operand."""
        if isinstance(slope, Recorded):
            times, factors = self.product(self.tape.operand(slope))
            self.add(operand, self.times(adjoint, coefficient * times, factors))
        elif slope:
            self.add(operand, self.times(adjoint, coefficient * slope, ()))

    def product(self, operand: Operand) -> tuple[float, Product]:
        """An operand as a product of a constant and numbers, quotients as products with reciprocals."""
        if isinstance(operand, float):
            return operand, ()
        first = len(self.tape.arguments)
        if operand < first:
            return 1.0, (operand,)
        form, _, operands = self.tape.operations[operand - first]
        if form == "-{0}":
            coefficient, factors = self.product(operands[0])
            return -coefficient, factors
        if form == "{0} / {1}" and isinstance(operands[1], float):
            coefficient, factors = self.product(operands[0])
            return coefficient / operands[1], factors
        if form == "{0} / {1}":
            if isinstance(operands[0], float) and operands[0] == 1.0:
                return 1.0, (operand,)
            inverse = self.tape.operation(form, "f", 1.0, self.tape.value(operands[1]))
            operands = (operands[0], self.tape.operand(inverse))
        elif form != "{0} * {1}":
            return 1.0, (operand,)
        (a, left), (b, right) = map(self.product, operands)
        if len(left) + len(right) > LONGEST:
            return 1.0, (operand,) if form == "{0} * {1}" else tuple(
                o for o in operands if isinstance(o, int)
            )
        return a * b, tuple(sorted(left + right))

    def times(self, adjoint: Sum, coefficient: float, factors: Product) -> Sum:
        """A sum times a product."""
        if not adjoint:
            return adjoint
        if len(adjoint) > 1 and (factors or coefficient != 1.0):
            adjoint = self.collected(adjoint)
        found: Sum = {}
        for product, c in adjoint.items():
            if len(product) + len(factors) > LONGEST:
                product = (self.tape.operand(self.number({product: 1.0})),)  # type: ignore[assignment]
            found[tuple(sorted(product + factors))] = c * coefficient
        return found

    def collected(self, adjoint: Sum) -> Sum:
        """A sum as one product: what all its products share, and a sum of what is left of them."""
        shared: list[int] = list(next(iter(adjoint)))
        for product in adjoint:
            shared = [x for x in dict.fromkeys(shared) for _ in range(min(shared.count(x), product.count(x)))]
        size = min(map(abs, adjoint.values()))
        total: Any = None
        for product, coefficient in sorted(adjoint.items(), key=lambda item: item[1] < 0):
            rest = list(product)
            for x in shared:
                rest.remove(x)
            share = coefficient / size
            if total is None:
                total = self.number({tuple(rest): share})
            elif share < 0:
                total = total - self.number({tuple(rest): -share})
            else:
                total = total + self.number({tuple(rest): share})
        if isinstance(total, float):
            return {tuple(shared): total * size}
        return {tuple(sorted([*shared, int(total.name[1:])])): size}

    def number(self, adjoint: Sum) -> Any:
        """The value of a sum; constants and parameters are multiplied first: that is done ahead of a run."""
        if len(adjoint) > 1:
            adjoint = self.collected(adjoint)
        for product, coefficient in adjoint.items():
            value: Any = None if abs(coefficient) == 1 else abs(coefficient)
            for x in sorted(dict.fromkeys(product), key=lambda x: (x not in self.parameters, -x)):
                factor = self.tape.at(x) ** product.count(x)
                value = factor if value is None else value * factor
            value = 1.0 if value is None else value
            return -value if coefficient < 0 else value
        return 0.0


# -- what formulas are written with ----------------------------------------------------------------
def _where(condition: Any, a: Any, b: Any) -> Any:
    if isinstance(condition, bool):
        return a if condition else b
    return functions.namespace(functions.leading(a, b, condition)).where(condition, a, b)


def _both(a: Any, b: Any) -> Any:
    return a and b if isinstance(a, bool) else a & b


def _either(a: Any, b: Any) -> Any:
    return a or b if isinstance(a, bool) else a | b


def _invert(a: Any) -> Any:
    return not a if isinstance(a, bool) else ~a


SCOPE: dict[str, Any] = {
    **{name: functions.function(name) for name in FUNCTIONS},
    "atan2": functions.atan2, "hypot": functions.hypot, "where": _where, "both": _both, "either": _either,
    "invert": _invert, "inf": math.inf, "nan": math.nan,
}  # fmt: skip
