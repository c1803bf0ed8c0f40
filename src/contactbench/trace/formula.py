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
from contactbench.numbers.dual import leaves, rebuild
from contactbench.trace.adjoints import Adjoints
from contactbench.trace.form import (
    FUNCTIONS,
    Digested,
    Function,
    Operand,
    Operation,
    Results,
    Unpack,
    Update,
    prune,
)
from contactbench.trace.python import FORMS, execute
from contactbench.trace.recording import Recorded, RecordedNumbers, Tape, attempt

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
class Formula(Digested):
    """What a function of numbers computes.

    arguments : of every positional argument the length of the tuple it is, 0 for a number, "xp" for a namespace of
    numbers, which is not read.  names : keyword arguments, numbers.  body : `Operation`s, on the arguments v0, v1, …
    one after the other.  results : the operand that is returned, or nested tuples of them.
    live : the function it was recorded from.
    Raises `BadInput` for an argument of another length.
    """

    arguments: tuple[int | str, ...]
    names: tuple[str, ...]
    body: tuple[Any, ...]
    results: Results
    live: Callable[..., Any] | None = None

    def parts(self) -> tuple[Any, ...]:
        return self.arguments, self.names, self.body, self.results

    def __repr__(self) -> str:
        name = getattr(self.live, "__name__", "derived" if self.live is None else type(self.live).__name__)
        return f"<formula of {name}: {len(self.body)} operations>"

    def __reduce__(self) -> Any:
        return Formula, self.parts()

    @cached_property
    def function(self) -> Callable[..., Any]:
        signature: list[str] = []
        body: list[Any] = []
        supply = iter(argument_names(self.arguments, self.names))
        for i, n in enumerate(self.arguments):
            if isinstance(n, str) or not n:
                signature.append(NAMESPACE if n else next(supply))
            else:
                signature.append(f"a{i}")
                body.append(Unpack(tuple(next(supply) for _ in range(n)), f"a{i}"))
        body += [Update((own,), (name,)) for own, name in zip(supply, self.names, strict=True)]
        written = Function("formula", (*signature, *self.names), (*body, *self.body), self.results)
        return execute(written, WRITTEN, SCOPE)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        for given, n in zip(arguments, self.arguments, strict=True):
            if isinstance(n, int) and n and len(given) != n:
                raise BadInput(f"{len(given)} components: this function was recorded for {n}")
        return self.function(*arguments, **named)

    # -- derivatives -------------------------------------------------------------------------------
    def gradient(self) -> Formula:
        """The derivative of a single result along the components of the first argument, by reverse mode.

        Raises `CannotRecord` for a function whose derivative is not known.
        """
        tape, result, adjoints = self.replay()
        row = attempt(lambda: adjoints.along(result, self.components))
        return make_formula(self.arguments, self.names, tape, row)

    def jacobian(self, symmetric: bool = False) -> Formula:
        """The derivative of a tuple of results, a row for each; zeros are constants.

        symmetric : it is, so that half of it is enough.
        """
        tape, results, adjoints = self.replay()
        rows = [attempt(lambda out=out: adjoints.along(out, self.components)) for out in results]  # type: ignore[misc]
        if symmetric:
            for i in range(len(rows)):
                rows[i][i + 1 :] = [rows[j][i] for j in range(i + 1, len(rows))]
        return make_formula(self.arguments, self.names, tape, rows)

    @property
    def components(self) -> tuple[str, ...]:
        """The components of the first argument."""
        return argument_names(self.arguments[:1], ())

    def replay(self) -> tuple[Tape, Results, Adjoints]:
        """A tape with its operations, its results there, and their derivatives."""
        tape, moved = Tape(), dict[Operand, Operand]()
        for target, operation in self.body:
            there = Operation(operation.function, tuple(moved.get(x, x) for x in operation.operands))
            moved[target] = tape.assign(there, "f", tape.root).name
        arguments = argument_names(self.arguments, self.names)
        adjoints = Adjoints(tape, arguments, arguments[len(arguments) - len(self.names) :])
        return tape, rebuild(self.results, [moved.get(x, x) for x in leaves(self.results)]), adjoints


def argument_names(arguments: tuple[int | str, ...], names: Sequence[str]) -> tuple[str, ...]:
    """A name for every number in the arguments of a formula."""
    return tuple(f"v{i}" for i in range(sum(n or 1 for n in arguments if isinstance(n, int)) + len(names)))


def formula(function: Callable[..., Any], arguments: tuple[int | str, ...], names: Sequence[str]) -> Formula:
    """Record a function; arguments, names : as in `Formula`.  Raises `CannotRecord`."""
    tape = Tape()
    supply = (Recorded(tape, name, "f", tape.root) for name in argument_names(arguments, names))
    given: list[Any] = []
    for n in arguments:
        if isinstance(n, str):
            given.append(RecordedNumbers(tape))
        else:
            given.append(tuple(next(supply) for _ in range(n)) if n else next(supply))
    named = dict(zip(names, supply, strict=True))
    return make_formula(arguments, tuple(names), tape, attempt(lambda: function(*given, **named)), function)


def make_formula(
    arguments: tuple[int | str, ...], names: tuple[str, ...], tape: Tape, results: Any, live: Any = None
) -> Formula:
    """The formula of some results, without the operations that none of them needs."""
    found = tape.results(results)
    return Formula(arguments, names, prune(tape.root.statements, found), found, live)
