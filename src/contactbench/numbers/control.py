"""Choices and loops on every kind of number.

Plain numbers (floats, mpmath) may be looked at; arrays and traced numbers may not: see `Abilities`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from contactbench.numbers.protocol import Abilities, Numbers, abilities

#: turns after which a loop over plain numbers is given up: a thousand digits take forty
ENDLESS = 200


@dataclass(frozen=True)
class Repeat:
    """``repeat(n, body, x)``: n-fold application, by the kind of loop an engine has.

    over_stages : the loops over the stages of a step are to be such loops too, for short code.
    joint_first : a turn begins with the kick that joins two steps: with the drift after it, it is one loop over sites.
    """

    loop: Callable[[Any, Callable[[Any], Any], Any], Any]
    over_stages: bool = False
    joint_first: bool = False

    def __call__(self, n: Any, body: Callable[[Any], Any], x: Any) -> Any:
        return self.loop(n, body, x)


def turns(n: int, body: Callable[[Any], Any], x: Any) -> Any:
    """x after n turns of ``x = body(x)``."""
    for _ in range(n):
        x = body(x)
    return x


#: a plain loop; compiled engines pass their own
repeat = Repeat(turns)


def choose(condition: Any, yes: Any, no: Any, xp: Any) -> Any:
    """yes or no, entry by entry for arrays.  Both have been computed: neither may divide by zero."""
    if abilities(xp).branch:
        return yes if condition else no
    return xp.where(condition, yes, no)


def settle(x: Any, xp: Any) -> Any:
    """x, computed once: XLA would redo divisions and sines for every later component that reads them,
    which grows exponentially along a chain of flows."""
    return xp.settle(x) if abilities(xp).barrier else x


def negligible(x: Any) -> bool:
    """Whether a plain number is lost beside 1."""
    return 1 + x == 1


def scan(
    body: Callable[[Any], tuple[Any, Any]], x: Any, turns: int, rest: Callable[[Any], Any], xp: Any
) -> tuple[Any, Any]:
    """x after `turns` of ``x, out = body(x)``, and the outs; plain numbers until ``rest(x)`` is negligible.

    Raises `ArithmeticError` if it never is.
    """
    can = abilities(xp)
    if can.loops:
        return xp.scan(body, x, turns)
    outs = []
    for _ in range(ENDLESS if can.branch else turns):
        x, out = body(x)
        outs.append(out)
        if can.branch and negligible(rest(x)):
            return x, outs
    if can.branch:
        raise ArithmeticError(f"no convergence in {ENDLESS} turns")
    return x, outs


def unwind(body: Callable[[Any, Any], Any], x: Any, outs: Any, xp: Any) -> Any:
    """x after ``x = body(x, out)`` for the outs of a `scan`, last to first."""
    if abilities(xp).loops:
        return xp.unwind(body, x, outs)
    for out in reversed(outs):
        x = body(x, out)
    return x


class XlaNumbers(Numbers):
    """`jax.numpy`, with the compiled loops and the barrier that the functions above use."""

    abilities = Abilities(vectors=True, loops=True, barrier=True)

    def __getattr__(self, name: str) -> Any:
        from contactbench.xla import jax

        return getattr(jax.numpy, name)

    def settle(self, x: Any) -> Any:
        """x, computed once."""
        from contactbench.xla import lax

        return lax.optimization_barrier(x)

    def scan(self, body: Callable[[Any], tuple[Any, Any]], x: Any, turns: int) -> tuple[Any, Any]:
        from contactbench.xla import lax

        return lax.scan(lambda x, _: body(x), x, None, length=turns)

    def unwind(self, body: Callable[[Any, Any], Any], x: Any, outs: Any) -> Any:
        from contactbench.xla import lax

        return lax.scan(lambda x, out: (body(x, out), None), x, outs, reverse=True)[0]
