"""Programs of JAX: one compiled per structure, its forward derivative, and the loop over fixed steps."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from contactbench.methods.loops import StepLoop, Steps, identity
from contactbench.methods.prepared import Request, stopwatch
from contactbench.numbers.control import Repeat, XlaNumbers
from contactbench.numbers.protocol import Count
from contactbench.scene import AnyState, Cache, Scene, key
from contactbench.trace.recording import reason_of
from contactbench.xla import jax, jnp, lax

if TYPE_CHECKING:
    from jax.sharding import Sharding
    from jax.stages import Compiled

#: packed states after each interval, from the first one and all other numbers of a run
States = Callable[["jax.Array", "jax.Array"], "jax.Array"]
_programs: Cache[tuple[Compiled, float]] = Cache(1024)


class Xla:
    """A compiled JAX function of a packed initial state and of all other numbers of a run.

    So a program is compiled once per scene structure and `capacity` for saved times, then shared.

    identity, key : what the program depends on, besides the fields carried and the capacity.  capacities : numbers of
    saved times a program is compiled for; the next larger one serves all in between.  everywhere : how arguments lie
    on several devices; None on one.
    """

    def __init__(
        self,
        request: Request,
        identity: Hashable | None,
        key: tuple[Hashable, ...],
        capacities: tuple[int, ...] = (1, 64, 1024),
        everywhere: Sharding | None = None,
    ) -> None:
        self.request, self.identity, self.key = request, identity, key
        self.capacities, self.everywhere = capacities, everywhere
        self.seconds = 0.0

    def together(self, *vectors: Sequence[float] | np.ndarray) -> np.ndarray:
        """Several arguments as one: what a short call costs is the number of its arguments."""
        self.borders = np.cumsum([len(vector) for vector in vectors])[:-1].tolist()
        return np.concatenate(vectors, dtype=float)

    def apart(self, fixed: jax.Array) -> list[Any]:
        return [fixed[i:j] for i, j in pairwise([0, *self.borders, len(fixed)])]

    def room(self, saves: int) -> int:
        if self.request.scene.by_sites:  # its states are large
            return saves
        return next((size for size in self.capacities if size >= saves), saves)

    def times(self) -> np.ndarray:
        """The saved times as a program takes them: the end again and again beyond those asked for."""
        times = self.request.save_at
        return np.pad(times, (0, self.room(len(times)) - len(times)), mode="edge")

    def place(self, fixed: np.ndarray) -> jax.Array:
        """Return arguments on the device: converting them at every call would cost as much as a short run."""
        placed: jax.Array = jax.device_put(fixed, self.everywhere)
        return placed

    @cached_property
    def start_on_device(self) -> jax.Array:
        return self.place(self.request.start)

    def compile(self, function: States, fixed: jax.Array, capacity: int) -> None:
        self.fixed, self.capacity = fixed, capacity
        self.program, self.seconds = self.compiled("run", function, self.start_on_device, fixed)

    def call(self, y0: np.ndarray, fixed: jax.Array | None = None) -> np.ndarray:
        """Return what the program does from an initial state; the scene's own is moved to the device once."""
        own = y0 is self.request.start
        start = self.start_on_device if own else y0 if self.everywhere is None else self.place(y0)
        return np.asarray(self.program(start, self.fixed if fixed is None else fixed))

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


def compiled_loop[X](n: Count, body: Callable[[X], X], x: X) -> X:
    after: X = lax.fori_loop(0, n, lambda _, x: body(x), x)
    return after


#: loops over stages too, the shortest code.  Against steps written out, measured on `particle`: compiled in a third to
#: a half of the time; short runs with few gradients a step up to three times as fast, more with many saved times; long
#: runs with many stages up to 1.7 times as slow
rolled = Repeat(compiled_loop, over_stages=True)


class Traced(StepLoop["tuple[int, jax.Array]"]):
    """By a program of JAX, which has room for a fixed number of intervals."""

    derivative = "forward-mode AD through the numerical map"
    #: how arguments lie on several devices
    everywhere: Sharding | None = None

    def __init__(self, method: Steps, request: Request) -> None:
        super().__init__(method, request)
        self.xla = Xla(
            request, identity(method, self.scene, self.carry), self.key(), everywhere=self.everywhere
        )

    def key(self) -> tuple[Hashable, ...]:
        return ()

    tangents = None  # type: ignore[assignment]  # the program is differentiated

    def ready(self, h: np.ndarray, n: np.ndarray) -> tuple[int, jax.Array]:
        if not hasattr(self.xla, "program"):
            room = self.xla.room(len(n))
            self.xla.compile(self.states, self.spans(h, n, room), room)
            self.seconds = self.xla.seconds
        return len(n), self.spans(h, n, self.xla.capacity)

    def spans(self, h: np.ndarray, n: np.ndarray, room: int) -> jax.Array:
        padded = np.zeros((2, room))
        padded[:, : len(n)] = h, n
        return self.xla.place(self.xla.together(self.scene.numbers(), *padded))

    def take(self, y0: np.ndarray, ready: tuple[int, jax.Array]) -> tuple[np.ndarray, int | None]:
        k, fixed = ready
        return self.xla.call(y0, fixed)[:k], None

    def start_of(self, scene: Scene, y0: jax.Array) -> AnyState:
        start: AnyState = scene.unpack(scene.entries(y0), self.carry)
        return start

    def states(self, y0: jax.Array, fixed: jax.Array) -> jax.Array:
        """Saved states (k, d), traceable."""
        numbers, h, n = self.xla.apart(fixed)
        scene, xp = self.scene.with_numbers(list(numbers)), XlaNumbers()

        def interval(x: AnyState, span: tuple[jax.Array, jax.Array]) -> tuple[AnyState, jax.Array]:
            h, n = span
            x = self.method.advance(scene, x, h, n, xp, rolled)
            return x, jnp.stack(scene.pack(x))

        return lax.scan(interval, self.start_of(scene, y0), (h, n.astype(int)))[1]

    def tangent(self, y0: np.ndarray, v: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        k, fixed = self.ready(h, n)
        return self.xla.derivative(self.states, y0, v, fixed)[:k]
