"""The JAX engine of the fixed-step methods: a loop over steps inside a scan over the saved times."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import cached_property
from typing import Any

import numpy as np

from contactbench.methods.compiled import CompiledRun
from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.step_map import identity
from contactbench.numbers.control import Repeat
from contactbench.numbers.xla import XlaNumbers


def compiled_loop(n: Any, body: Callable[[Any], Any], x: Any) -> Any:
    """x after n turns of ``x = body(x)``."""
    from contactbench.xla import lax

    return lax.fori_loop(0, n, lambda _, x: body(x), x)


#: loops over stages too, the shortest code.  Against steps written out, measured on `particle`: compiled in a third to
#: a half of the time; short runs with few gradients a step up to three times as fast, more with many saved times; long
#: runs with many stages up to 1.7 times as slow
rolled = Repeat(compiled_loop, over_stages=True)


class JaxLoop(FixedStepRun, CompiledRun):
    """The compiled steps: a loop inside a scan over the saved times."""

    sensitivity_source = "forward-mode AD through the numerical map"

    def __post_init__(self) -> None:
        from contactbench.xla import jax

        super().__post_init__()
        self.capacity = self.room(len(self.n))
        # on the device once: converting them at every call would cost as much as a short run
        self.fixed = jax.device_put(self.spans(self.h, self.n))
        self.program, self.compile_s = self.compiled("run", self.states, self._own_start, self.fixed)

    def spans(self, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        """The arguments of the program; intervals beyond those asked for have no steps."""
        padded = np.zeros((2, self.capacity))
        padded[:, : len(n)] = h, n
        return self.together(self.request.scene.numbers(), *padded)

    def divide(self, step: float) -> None:
        super().divide(step)
        if hasattr(self, "fixed"):  # a step for one call: not worth moving ahead of it
            self.fixed = self.spans(self.h, self.n)

    def key(self) -> tuple[Any, ...]:
        return (self.capacity,)

    @cached_property
    def identity(self) -> Hashable | None:  # type: ignore[override]
        return identity(self.method_, self.request.scene, self.request.carry)

    def states(self, y0: Any, fixed: Any) -> Any:
        from contactbench.xla import jnp, lax

        numbers, h, n = self.apart(fixed)
        r, xp = self.request, XlaNumbers()
        scene = r.scene.with_numbers(list(numbers))

        def interval(x: Any, span: Any) -> Any:
            h, n = span
            x = self.method_.advance(scene, x, h, n, xp, rolled)
            return x, jnp.stack(scene.pack(x))

        return lax.scan(interval, scene.unpack(scene.entries(y0), r.carry), (h, n.astype(int)))[1]

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        derivative = super().sensitivity(y0)[: len(self.n)]
        if not self.saves_start:
            return derivative
        return np.concatenate([np.array(self.tangents(y0)).T[None], derivative])

    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        fixed = self.fixed if n is self.n else self.spans(h, n)
        return np.asarray(self.program(self.placed(y0), fixed))[: len(n)]

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return np.asarray(self.program(self.placed(y0), self.fixed))[len(self.n) - 1]
