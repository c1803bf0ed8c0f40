"""Choose and loop on every kind of number; an if statement works on plain numbers only (see `Abilities`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from contactbench.numbers.dual import leaves, rebuild
from contactbench.numbers.protocol import (
    Abilities,
    Arithmetic,
    Column,
    Condition,
    Count,
    Namespace,
    Numbers,
    abilities,
    has_where,
)
from contactbench.xla import jnp, lax

#: most iterations of a loop over plain numbers; a thousand digits take forty
ENDLESS = 200


class Iteration(Protocol):
    """Apply a body n times."""

    def __call__[X](self, n: Count, body: Callable[[X], X], x: X, /) -> X: ...


class Rows(Protocol):
    """Rows of numbers, which a loop may number."""

    def __getitem__(self, i: Count, /) -> Sequence[Arithmetic]: ...
    def __setitem__(self, i: Count, row: Sequence[Arithmetic], /) -> None: ...
    def combine(self, weights: Column, first: Count, count: Count, late: int = 0) -> Sequence[Arithmetic]:
        """Return Σ weights[first + j] times row j, j < count; the `late` first rows are added last."""


@dataclass(frozen=True)
class Repeat:
    """Apply a body n times by an engine's loop; with `rows` the stages of a step are a loop, too."""

    loop: Iteration
    rows: Callable[[int, Sequence[Arithmetic]], Rows] | None = None

    @property
    def over_stages(self) -> bool:
        return self.rows is not None

    def __call__[X](self, n: Count, body: Callable[[X], X], x: X) -> X:
        return self.loop(n, body, x)

    def steps(self, n: Count, step: Callable[[Any], Any], x: Any, h: Arithmetic) -> Any:
        """Apply a step n times to a state, or a tuple that begins with one; the k-th begins at t + k h."""
        state = x if hasattr(x, "_fields") else x[0]
        start = getattr(state, "t", None)
        if start is None:
            return self.loop(n, step, x)

        def another(carried: tuple[Any, Any]) -> tuple[Any, Any]:
            x, k = carried
            now = start + k * h
            return step(x._replace(t=now) if hasattr(x, "_fields") else (x[0]._replace(t=now), *x[1:])), k + 1

        begun: tuple[Any, Any] = (x, 0)
        return self.loop(n, another, begun)[0]


def turns[X](n: Any, body: Callable[[X], X], x: X) -> X:
    for _ in range(n):
        x = body(x)
    return x


#: a plain loop; compiled engines pass their own
repeat = Repeat(turns)


def choose(condition: Condition, yes: Arithmetic, no: Arithmetic, xp: Namespace) -> Arithmetic:
    """Return yes or no, entry by entry for arrays; both are computed, so that neither may divide by zero."""
    if has_where(xp):
        return xp.where(condition, yes, no)
    return yes if condition else no


def settle[X](x: X, xp: Namespace) -> X:
    """Return x, computed once: XLA would redo divisions and sines for every later component that reads them."""
    return lax.optimization_barrier(x) if abilities(xp).traced else x


def scan[X](
    body: Callable[[X], tuple[X, object]], x: X, turns: int, rest: Callable[[X], Arithmetic], xp: Namespace
) -> tuple[X, Any]:
    """Return x after `turns` of ``x, out = body(x)``, and the outs; of plain numbers until rest(x) is negligible."""
    can = abilities(xp)
    if can.traced:
        return lax.scan(lambda x, _: body(x), x, None, length=turns)
    outs = []
    for _ in range(ENDLESS if can.branch else turns):
        x, out = body(x)
        outs.append(out)
        if can.branch and 1 + rest(x) == 1:  # the rest is negligible
            return x, outs
    if can.branch:
        raise ArithmeticError(f"no convergence in {ENDLESS} turns")
    return x, outs


def iterate[X](body: Callable[[X], X], x: X, turns: int, xp: Namespace) -> X:
    """Return x after so many turns of ``x = body(x)``, as a loop if code is compiled."""
    recorded: Callable[..., X] | None = getattr(xp, "iterate", None)
    if recorded is not None:
        return recorded(turns, body, x)
    return scan(lambda x: (body(x), 0.0), x, turns, lambda _: math.inf, xp)[0]


def repeat_while[X](condition: Callable[[X], Condition], body: Callable[[X], X], x: X, xp: Namespace) -> X:
    """Return x after repeating ``x = body(x)`` while the condition holds, entry by entry for arrays."""
    can = abilities(xp)
    if can.branch:
        while condition(x):
            x = body(x)
        return x

    def turn(x: X) -> X:
        going, after = condition(x), leaves(body(x))
        return rebuild(x, [choose(going, new, old, xp) for new, old in zip(after, leaves(x), strict=True)])

    if can.traced:
        return lax.while_loop(lambda x: jnp.any(condition(x)), turn, x)
    recorded: Callable[..., X] | None = getattr(xp, "repeat_while", None)
    if recorded is not None:
        return recorded(condition, turn, x)
    while np.any(condition(x)):
        x = turn(x)
    return x


def when[X](condition: Condition, body: Callable[..., Any], x: X, xp: Namespace, *given: object) -> X:
    """Return body(x, *given) where the condition holds, else x; nothing is computed in vain.

    Recorded loops move invariant expressions out; expressions in the arguments of the body stay inside.
    """
    once: Any = choose(condition, 1.0, 0.0, xp), x, given
    return repeat_while(lambda c: c[0] > 0, lambda c: (0.0, body(*c[1:2], *c[2]), c[2]), once, xp)[1]  # type: ignore[no-any-return]


def unwind[X](body: Callable[[X, Any], X], x: X, outs: Any, xp: Namespace) -> X:
    """Return x after ``x = body(x, out)`` for the outs of `scan`, the last first."""
    if abilities(xp).traced:
        return lax.scan(lambda x, out: (body(x, out), None), x, outs, reverse=True)[0]
    for out in reversed(outs):
        x = body(x, out)
    return x


class XlaNumbers(Numbers):
    """`jax.numpy`, with the compiled loops and the barrier that the functions above use."""

    abilities = Abilities(vectors=True, traced=True)

    def __getattr__(self, name: str) -> Any:
        return getattr(jnp, name)
