"""A function recorded as a list of operations: a formula.

A user's function is a Python object that may do another thing tomorrow: it reads globals, closures, attributes.  A
formula is what it computed when it was recorded, and nothing else.  It is compared and hashed by its operations, can
be pickled, runs on every kind of number that the function ran on, and is differentiated operation by operation.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from heapq import heappop, heappush
from itertools import product
from typing import Any

from contactbench.errors import BadInput
from contactbench.numbers import functions
from contactbench.numbers.dual import DERIVATIVES
from contactbench.numbers.recording import (
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
        #: of every quotient c/x, c a constant, that has been recorded: its place and c, by the place of x
        self.quotients: dict[Operand, tuple[int, float]] = {}

    def operation(self, form: str, kind: str, *operands: Any) -> Recorded:
        given = tuple(map(self.operand, operands))
        key = (form, *map(repr, given))
        if key not in self.places:
            self.places[key] = place = len(self.arguments) + len(self.operations)
            self.operations.append((form, kind, given))
            if form == "{0} / {1}" and isinstance(given[0], float) and given[0]:
                self.quotients.setdefault(given[1], (place, given[0]))
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


@dataclass(frozen=True, eq=False)
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
    live: Callable[..., Any] | None = field(default=None, repr=False)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all that it computes."""
        text = repr((self.arguments, self.names, self.operations, self.results))
        return hashlib.sha256(text.encode()).hexdigest()

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
        return self.derived(tape, tuple(recorded(lambda: pulled_back(tape, self.results, self.components))))

    def jacobian(self, symmetric: bool = False) -> Formula:
        """The derivative of a tuple of results, a row for each; zeros are constants.

        symmetric : it is, so that half of it is enough.
        """
        tape, n = self.replayed(), self.components
        rows = [recorded(lambda out=out: pulled_back(tape, out, n)) for out in self.results]  # type: ignore[misc]
        if symmetric:
            for i, j in product(range(n), repeat=2):
                rows[i][j] = rows[max(i, j)][min(i, j)]
        return self.derived(tape, tuple(map(tuple, rows)))

    @property
    def components(self) -> int:
        """The number of components of the first argument."""
        n = self.arguments[0]
        assert isinstance(n, int)
        return n or 1

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
def pulled_back(tape: FormulaTape, result: Operand, n: int) -> list[Any]:
    """The derivatives of a result along the first n arguments: adjoints of operations, last to first.

    Griewank, Walther, Evaluating Derivatives, 2nd ed., SIAM 2008, §3.2, doi:10.1137/1.9780898717761.
    """
    first = len(tape.arguments)
    adjoints: dict[int, Any] = {}
    waiting: list[int] = []

    def add(operand: Operand, amount: Any) -> None:
        if isinstance(operand, float) or amount is None:
            return
        if operand not in adjoints:
            adjoints[operand] = amount
            if operand >= first:
                heappush(waiting, -operand)
        else:
            adjoints[operand] = adjoints[operand] + amount

    add(result, 1.0)
    while waiting:
        place = -heappop(waiting)
        form, _, operands = tape.operations[place - first]
        for operand, amount in _shares(tape, form, operands, place, adjoints.pop(place)):
            add(operand, amount)
    return [adjoints.get(i, 0.0) for i in range(n)]


def _times(a: Any, b: Any) -> Any:
    """a·b, without a factor of 1."""
    return b if isinstance(a, float) and a == 1 else a * b


def _shares(
    tape: FormulaTape, form: str, operands: tuple[Operand, ...], place: int, adjoint: Any
) -> list[tuple[Operand, Any]]:
    """What the adjoint of an operation adds to those of its operands."""
    xp, y = RecordedNumbers(tape), tape.at(place)
    x = [tape.value(operand) for operand in operands]
    match form:
        case "{0} + {1}":
            return [(operands[0], adjoint), (operands[1], adjoint)]
        case "{0} - {1}":
            return [(operands[0], adjoint), (operands[1], -adjoint)]
        case "-{0}":
            return [(operands[0], -adjoint)]
        case "{0} * {1}" if operands[0] == operands[1]:
            return [(operands[0], _times(_times(2.0, adjoint), x[0]))]
        case "{0} * {1}":
            return [(operands[0], _times(adjoint, x[1])), (operands[1], _times(adjoint, x[0]))]
        case "{0} / {1}" if isinstance(x[1], float):
            return [(operands[0], _times(adjoint, 1 / x[1]))]
        case "{0} / {1}" if isinstance(x[0], float):  # c/x: −c/x² = −y²/c
            return [(operands[1], _times(adjoint * (-1 / x[0]), y * y) if x[0] else None)]
        case "{0} / {1}":
            inverse = 1.0 / x[1]
            share = _times(adjoint, inverse)
            return [(operands[0], share), (operands[1], -(share * (x[0] * inverse)))]
        case "{0} ** {1}" if isinstance(x[1], float):
            return [(operands[0], _times(_times(x[1], adjoint), x[0] ** (x[1] - 1)))]
        case "{0} ** {1}":
            along = None if isinstance(x[0], float) else _times(adjoint, x[1] * x[0] ** (x[1] - 1))
            return [(operands[0], along), (operands[1], _times(adjoint, y * xp.log(x[0])))]
        case "abs({0})":
            return [(operands[0], xp.where(x[0] < 0, -adjoint, adjoint))]
        case "sqrt({0})":
            known = tape.quotients.get(place)  # c/√x has been divided already
            slope = 0.5 / y if known is None else tape.at(known[0]) * (0.5 / known[1])
            return [(operands[0], _times(adjoint, slope))]
        case "atan2({0}, {1})":
            share = adjoint / (x[0] * x[0] + x[1] * x[1])
            return [(operands[0], share * x[1]), (operands[1], -(share * x[0]))]
        case "hypot({0}, {1})":
            share = adjoint / y
            return [(operands[0], share * x[0]), (operands[1], share * x[1])]
        case "{1} if {0} else {2}":
            return [
                (operands[1], xp.where(x[0], adjoint, 0.0)), (operands[2], xp.where(x[0], 0.0, adjoint)),
            ]  # fmt: skip
    name = form.partition("(")[0]
    if name in DERIVATIVES:
        return [(operands[0], _times(adjoint, DERIVATIVES[name](xp, x[0], y)))]
    raise CannotRecord(f"no derivative of {name} is known")


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
