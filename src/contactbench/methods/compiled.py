"""What the JAX engines share: one compiled program per structure, and its forward derivative."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Hashable
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from contactbench.methods.prepared import Prepared, stopwatch
from contactbench.scene.cache import Cache, key
from contactbench.trace.recording import reason_of

_programs: Cache[tuple[Any, float]] = Cache(1024)


class CompiledRun(Prepared):
    """A run whose saved states are a JAX function of the packed initial state and other arguments.

    Everything numerical (initial data, parameters, steps, tolerances, saved times) is an argument:
    a program is compiled once per scene structure and `capacity` for saved times, then shared.
    """

    #: numbers of saved times a program is compiled for; the next larger one serves all in between
    capacities: ClassVar[tuple[int, ...]] = (1, 64, 1024)

    #: all arguments but the initial state, on the device; made by `together`, taken `apart` in the program
    fixed: Any

    @abstractmethod
    def key(self) -> tuple[Any, ...]:
        """What the program depends on besides the identity and the fields carried."""

    @property
    def identity(self) -> Hashable | None:
        """What the program depends on of the scene, and of a user's method."""
        return self.request.scene.identity

    @abstractmethod
    def states(self, y0: Any, fixed: Any) -> Any:
        """Saved states (k, d), traceable."""

    def together(self, *vectors: Any) -> np.ndarray:
        """Several arguments as one: what a short call costs is the number of its arguments."""
        self.borders = np.cumsum([len(vector) for vector in vectors])[:-1].tolist()
        return np.concatenate(vectors, dtype=float)

    def apart(self, fixed: Any) -> list[Any]:
        """The arguments again, inside the program."""
        return [fixed[i:j] for i, j in pairwise([0, *self.borders, len(fixed)])]

    @staticmethod
    def flat(function: Callable[..., tuple[Any, Any, Any]]) -> Callable[..., Any]:
        """A function that returns saved states, facts about the run, and its last state, all in one vector."""
        from contactbench.xla import jnp

        return lambda *arguments: jnp.concatenate([jnp.ravel(part) for part in function(*arguments)])

    def unflat(self, vector: np.ndarray, d: int) -> tuple[np.ndarray, list[float], list[float]]:
        """The three again: saved states (k, d), facts, last state (d,)."""
        told = vector[self.capacity * d :].tolist()
        return vector[: self._saves * d].reshape(-1, d), told[:-d], told[-d:]

    def room(self, saves: int) -> int:
        """The number of saved times of the program for so many."""
        return next((size for size in self.capacities if size >= saves), saves)

    @cached_property
    def capacity(self) -> int:
        """The number of saved times of the program."""
        return self.room(self._saves)

    def times(self) -> np.ndarray:
        """The saved times as a program takes them: the end again and again beyond those asked for."""
        times = self.request.save_at
        return np.pad(times, (0, self.capacity - len(times)), mode="edge")

    def placed(self, y0: np.ndarray) -> Any:
        """The initial state as the program takes it: the scene's own is moved once, not at every call."""
        return self._own_start_placed if y0 is self._own_start else y0

    @cached_property
    def _own_start_placed(self) -> Any:
        from contactbench.xla import jax

        return jax.device_put(self._own_start)

    def compiled(self, purpose: str, function: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
        """The program for a purpose, and the seconds it took to trace and compile.

        Raises `CannotRecord` where what is traced branches on values.
        """
        from contactbench.xla import jax

        def make() -> tuple[Any, float]:
            elapsed = stopwatch()
            try:
                return jax.jit(function).lower(*arguments).compile(), elapsed()
            except jax.errors.JAXTypeError as error:
                raise reason_of(error) from error

        return _programs.get(key(self.identity, purpose, self.request.carry, *self.key()), make)

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        return self.pushed(y0, self.states, "steps")

    def pushed(self, y0: np.ndarray, states: Callable[[Any, Any], Any], which: str) -> np.ndarray:
        """(k, d, m): derivative of `states(y0, fixed)` along the scene's tangents; `which` names the program."""
        from contactbench.xla import jax

        def push(y0: Any, v: Any, fixed: Any) -> Any:
            return jax.jvp(lambda y: states(y, fixed), (y0,), (v,))[1]

        tangents = self.tangents(y0)
        program, _ = self.compiled(f"sensitivity, {which}", push, y0, tangents[0], self.fixed)
        pushed = np.stack([np.asarray(program(y0, v, self.fixed)) for v in tangents], axis=-1)
        return pushed[: self._saves]
