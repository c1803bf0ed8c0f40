"""Programs of JAX: one compiled per structure, and its forward derivative."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from contactbench.methods.prepared import Request, stopwatch
from contactbench.scene import Cache, key
from contactbench.trace.recording import reason_of
from contactbench.xla import jax

if TYPE_CHECKING:
    from jax.stages import Compiled

#: packed states after each interval, from the first one and all other numbers of a run
States = Callable[["jax.Array", "jax.Array"], "jax.Array"]
_programs: Cache[tuple[Compiled, float]] = Cache(1024)


class Xla:
    """A compiled JAX function of a packed initial state and of all other numbers of a run.

    So a program is compiled once per scene structure and `capacity` for saved times, then shared.

    identity, key : what the program depends on, besides the fields carried and the capacity.  capacities : numbers of
    saved times a program is compiled for; the next larger one serves all in between.
    """

    def __init__(
        self,
        request: Request,
        identity: Hashable | None,
        key: tuple[Hashable, ...],
        capacities: tuple[int, ...],
    ) -> None:
        self.request, self.identity, self.key = request, identity, key
        self.capacities = capacities
        self.seconds = 0.0

    def together(self, *vectors: Sequence[float] | np.ndarray) -> np.ndarray:
        """Several arguments as one: what a short call costs is the number of its arguments."""
        self.borders = np.cumsum([len(vector) for vector in vectors])[:-1].tolist()
        return np.concatenate(vectors, dtype=float)

    def apart(self, fixed: jax.Array) -> list[Any]:
        return [fixed[i:j] for i, j in pairwise([0, *self.borders, len(fixed)])]

    def room(self, saves: int) -> int:
        return next((size for size in self.capacities if size >= saves), saves)

    def times(self) -> np.ndarray:
        """The saved times as a program takes them: the end again and again beyond those asked for."""
        times = self.request.save_at
        return np.pad(times, (0, self.room(len(times)) - len(times)), mode="edge")

    def place(self, fixed: np.ndarray) -> jax.Array:
        """Return arguments on the device: converting them at every call would cost as much as a short run."""
        placed: jax.Array = jax.device_put(fixed)
        return placed

    @cached_property
    def start_on_device(self) -> jax.Array:
        return self.place(self.request.start)

    def compile(self, function: States, fixed: jax.Array, capacity: int) -> None:
        self.fixed, self.capacity = fixed, capacity
        self.program, self.seconds = self.compiled("run", function, self.start_on_device, fixed)

    def call(self, y0: np.ndarray) -> np.ndarray:
        """Return what the program does from an initial state; the scene's own is moved to the device once."""
        start = self.start_on_device if y0 is self.request.start else y0
        return np.asarray(self.program(start, self.fixed))

    def compiled(
        self, purpose: str, function: Callable[..., jax.Array], *arguments: object
    ) -> tuple[Compiled, float]:
        """The program for a purpose, and the seconds it took to make; `CannotRecord` where it branches on values."""

        def make() -> tuple[Compiled, float]:
            elapsed = stopwatch()
            try:
                return jax.jit(function).lower(*arguments).compile(), elapsed()
            except jax.errors.JAXTypeError as error:
                raise reason_of(error) from error

        rest = purpose, self.request.carry, *self.key, self.capacity
        return _programs.get(key(self.identity, *rest), make)

    def derivative(self, states: States, y0: np.ndarray, v: np.ndarray, fixed: jax.Array) -> np.ndarray:
        """Return the derivative of the states along v."""

        def push(y0: jax.Array, v: jax.Array, fixed: jax.Array) -> jax.Array:
            slope: jax.Array = jax.jvp(lambda y: states(y, fixed), (y0,), (v,))[1]
            return slope

        program, _ = self.compiled("sensitivity, steps", push, y0, v, fixed)
        return np.asarray(program(y0, v, fixed))
