"""A function recorded as a list of operations: a formula.

A user's function is a Python object that may do another thing tomorrow: it reads globals, closures, attributes.  A
formula is what it computed when it was recorded, and nothing else.  It is compared and hashed by its operations, can
be pickled, runs on every kind of number that the function ran on, and is differentiated operation by operation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from contactbench.errors import BadInput
from contactbench.numbers import functions
from contactbench.trace.adjoints import Adjoints
from contactbench.trace.form import (
    FUNCTIONS,
    Assign,
    Function,
    Operand,
    Operation,
    Results,
    Unpack,
    Update,
    digest,
    leaves,
    mapped,
)
from contactbench.trace.python import FORMS, executed
from contactbench.trace.recording import FormulaTape, Place, RecordedNumbers, Step, recorded

NAMESPACE = "xp"


# -- how formulas are written, for numbers that may be arrays or traced ------------------------------
def _where(condition: Any, a: Any, b: Any) -> Any:
    if isinstance(condition, bool):
        return a if condition else b
    return functions.namespace(functions.leading(a, b, condition)).where(condition, a, b)


WRITTEN = FORMS | {
    "where": "where({}, {}, {})",
    "and": "({0} and {1} if isinstance({0}, bool) else {0} & {1})",
    "or": "({0} or {1} if isinstance({0}, bool) else {0} | {1})",
    "not": "(not {0} if isinstance({0}, bool) else ~{0})",
}
SCOPE: dict[str, Any] = {
    **{name: functions.function(name) for name in FUNCTIONS},
    "atan2": functions.atan2,
    "hypot": functions.hypot,
    "where": _where,
    "inf": math.inf,
    "nan": math.nan,
}


@dataclass(frozen=True, eq=False, repr=False)
class Formula:
    """What a function of numbers computes.

    arguments : of every positional argument the length of the tuple it is, 0 for a number, "xp" for a namespace of
    numbers, which is not read.  names : keyword arguments, numbers.  steps : its operations.
    results : the place that is returned, or nested tuples of them.  live : the function it was recorded from.
    Raises `BadInput` for an argument of another length.
    """

    arguments: tuple[int | str, ...]
    names: tuple[str, ...]
    steps: tuple[Step, ...]
    results: Results
    live: Callable[..., Any] | None = None

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all that it computes."""
        return digest(self.arguments, self.names, self.steps, self.results)

    def __repr__(self) -> str:
        name = getattr(self.live, "__name__", "derived" if self.live is None else type(self.live).__name__)
        return f"<formula of {name}: {len(self.steps)} operations>"

    def __eq__(self, other: object) -> bool:
        return self.digest == other.digest if isinstance(other, Formula) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.digest)

    def __reduce__(self) -> Any:
        return Formula, (self.arguments, self.names, self.steps, self.results)

    @property
    def size(self) -> int:
        """The number of its arguments, every component counted."""
        return sum(n or 1 for n in self.arguments if isinstance(n, int)) + len(self.names)

    @property
    def written(self) -> Function:
        """The formula as a function of the intermediate form."""
        supply = (f"v{i}" for i in range(self.size))
        signature: list[str] = []
        body: list[Any] = []
        for i, n in enumerate(self.arguments):
            if isinstance(n, str) or not n:
                signature.append(NAMESPACE if n else next(supply))
            else:
                signature.append(f"a{i}")
                body.append(Unpack(tuple(next(supply) for _ in range(n)), f"a{i}"))
        body += [Update((own,), (name,)) for own, name in zip(supply, self.names, strict=True)]
        for place, (function, _, operands) in enumerate(self.steps, self.size):
            body.append(Assign(f"v{place}", Operation(function, tuple(map(_name, operands)))))
        return Function("formula", (*signature, *self.names), tuple(body), mapped(_name, self.results))

    @cached_property
    def function(self) -> Callable[..., Any]:
        return executed(self.written, WRITTEN, SCOPE)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        for given, n in zip(arguments, self.arguments, strict=True):
            if isinstance(n, int) and n and len(given) != n:
                raise BadInput(f"{len(given)} components: this function was recorded for {n}")
        return self.function(*arguments, **named)

    # -- derivatives -------------------------------------------------------------------------------
    def replayed(self) -> FormulaTape:
        """A tape with its operations at their places."""
        tape = FormulaTape(self.size)
        for function, kind, operands in self.steps:
            tape.operation(function, kind, *map(tape.value, operands))
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

        def row(result: Place) -> list[Any]:
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
    places = _places(tape, results)
    first = len(tape.arguments)
    wanted = {x for x in leaves(places) if isinstance(x, int) and x >= first}
    waiting = list(wanted)
    while waiting:
        for x in tape.steps[waiting.pop() - first][2]:
            if isinstance(x, int) and x >= first and x not in wanted:
                wanted.add(x)
                waiting.append(x)
    order = sorted(wanted)
    moved: dict[Any, int] = dict(zip(order, range(first, first + len(order)), strict=True))

    def again(x: Place) -> Place:
        return moved.get(x, x) if isinstance(x, int) else x

    operations = tuple(
        Step(function, kind, tuple(map(again, given)))
        for function, kind, given in (tape.steps[place - first] for place in order)
    )
    return Formula(arguments, names, operations, mapped(again, places), live)


def _places(tape: FormulaTape, results: Any) -> Results:
    if isinstance(results, tuple | list):
        return tuple(_places(tape, part) for part in results)
    return tape.operand(results)


def _name(place: Place) -> Operand:
    """A place as a name; a constant as it is."""
    return place if isinstance(place, float) else f"v{place}"
