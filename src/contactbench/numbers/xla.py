"""The namespace of JAX's arrays and traced numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from contactbench.numbers.protocol import Abilities, Numbers


class XlaNumbers(Numbers):
    """`jax.numpy`, with the compiled loops and the barrier that `numbers/control.py` uses."""

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
