"""What the JAX engines share: one compiled program per structure, and its forward derivative."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from contactbench.methods.base import Prepared, stopwatch

_programs: dict[Any, tuple[Any, float]] = {}


class XlaNumbers:
    """`jax.numpy`, and `settle`: a state that must be computed once, whoever reads it."""

    def __getattr__(self, name: str) -> Any:
        import jax

        return jax.lax.optimization_barrier if name == "settle" else getattr(jax.numpy, name)


class CompiledRun(Prepared):
    """A run whose saved states are a JAX function of the packed initial state and other arguments.

    Everything numerical (initial data, parameters, steps, tolerances, saved times) is an argument:
    a program is compiled once per scene structure and number of saved times, then shared.
    """

    def key(self) -> tuple[Any, ...]:
        """What the program depends on besides the scene's structure and the fields carried."""
        raise NotImplementedError

    def arguments(self) -> tuple[Any, ...]:
        """The arguments after y0."""
        raise NotImplementedError

    def states(self, y0: Any, *arguments: Any) -> Any:
        """Saved states (k, d), traceable."""
        raise NotImplementedError

    @staticmethod
    def on_device(*arrays: np.ndarray) -> tuple[Any, ...]:
        """Arguments that do not change from call to call, moved once."""
        import jax

        return tuple(jax.device_put(array) for array in arrays)

    def placed(self, y0: np.ndarray) -> Any:
        """The initial state as the program takes it: the scene's own is moved once, not at every call."""
        return self._own_start_placed if y0 is self._own_start else y0

    @cached_property
    def _own_start_placed(self) -> Any:
        return self.on_device(self._own_start)[0]

    def differentiable(self, y0: Any, *arguments: Any) -> Any:
        """`states`, in whatever form is best differentiated."""
        return self.states(y0, *arguments)

    def compiled(self, purpose: str, function: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
        """The program for a purpose, and the seconds it took to trace and compile."""
        import jax

        r = self.request
        key = (purpose, r.scene.structure, r.carry, *self.key())
        if key not in _programs:
            elapsed = stopwatch()
            _programs[key] = jax.jit(function).lower(*arguments).compile(), elapsed()
        return _programs[key]

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        import jax

        r = self.request
        rest = self.arguments()

        def push(y0: Any, v: Any, *rest: Any) -> Any:
            return jax.jvp(lambda y: self.differentiable(y, *rest), (y0,), (v,))[1]

        start = r.scene.unpack(tuple(y0.tolist()), r.carry)
        tangents = [np.array(r.scene.pack(v)) for v in r.scene.tangents(start)]
        program, _ = self.compiled("sensitivity", push, y0, tangents[0], *rest)
        return np.stack([np.asarray(program(y0, v, *rest)) for v in tangents], axis=-1)
