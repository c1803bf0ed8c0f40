"""Programs of JAX: one compiled per structure, its forward derivative, and the loop over fixed steps."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from contactbench.methods.loops import StepLoop, identity
from contactbench.methods.prepared import Request, stopwatch
from contactbench.numbers.control import Repeat, XlaNumbers
from contactbench.scene import Cache, key
from contactbench.trace.recording import reason_of
from contactbench.xla import jax, jnp, lax

_programs: Cache[tuple[Any, float]] = Cache(1024)


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
        key: tuple[Any, ...],
        capacities: tuple[int, ...] = (1, 64, 1024),
        everywhere: Any = None,
    ) -> None:
        self.request, self.identity, self.key = request, identity, key
        self.capacities, self.everywhere = capacities, everywhere
        self.seconds = 0.0

    def together(self, *vectors: Any) -> np.ndarray:
        """Several arguments as one: what a short call costs is the number of its arguments."""
        self.borders = np.cumsum([len(vector) for vector in vectors])[:-1].tolist()
        return np.concatenate(vectors, dtype=float)

    def apart(self, fixed: Any) -> list[Any]:
        return [fixed[i:j] for i, j in pairwise([0, *self.borders, len(fixed)])]

    def room(self, saves: int) -> int:
        if self.request.scene.by_sites:  # its states are large
            return saves
        return next((size for size in self.capacities if size >= saves), saves)

    def times(self) -> np.ndarray:
        """The saved times as a program takes them: the end again and again beyond those asked for."""
        times = self.request.save_at
        return np.pad(times, (0, self.room(len(times)) - len(times)), mode="edge")

    def place(self, fixed: np.ndarray) -> Any:
        """Return arguments on the device: converting them at every call would cost as much as a short run."""
        return jax.device_put(fixed, self.everywhere)

    @cached_property
    def start_on_device(self) -> Any:
        return self.place(self.request.start)

    def compile(self, function: Callable[[Any, Any], Any], fixed: Any, capacity: int) -> None:
        self.fixed, self.capacity = fixed, capacity
        self.program, self.seconds = self.compiled("run", function, self.start_on_device, fixed)

    def call(self, y0: np.ndarray, fixed: Any = None) -> np.ndarray:
        """Return what the program does from an initial state; the scene's own is moved to the device once."""
        start = self.start_on_device
        if y0 is not self.request.start:
            start = y0 if self.everywhere is None else self.place(y0)
        return np.asarray(self.program(start, self.fixed if fixed is None else fixed))

    def compiled(self, purpose: str, function: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
        """The program for a purpose, and the seconds it took to make; `CannotRecord` where it branches on values."""

        def make() -> tuple[Any, float]:
            elapsed = stopwatch()
            try:
                return jax.jit(function).lower(*arguments).compile(), elapsed()
            except jax.errors.JAXTypeError as error:
                raise reason_of(error) from error

        rest = purpose, self.request.carry, *self.key, self.capacity
        return _programs.get(key(self.identity, *rest), make)

    def derivative(
        self, states: Callable[[Any, Any], Any], y0: np.ndarray, v: np.ndarray, fixed: Any
    ) -> np.ndarray:
        """Return the derivative of the states along v."""

        def push(y0: Any, v: Any, fixed: Any) -> Any:
            return jax.jvp(lambda y: states(y, fixed), (y0,), (v,))[1]

        program, _ = self.compiled("sensitivity, steps", push, y0, v, fixed)
        return np.asarray(program(y0, v, fixed))


def compiled_loop(n: Any, body: Callable[[Any], Any], x: Any) -> Any:
    return lax.fori_loop(0, n, lambda _, x: body(x), x)


#: loops over stages too, the shortest code.  Against steps written out, measured on `particle`: compiled in a third to
#: a half of the time; short runs with few gradients a step up to three times as fast, more with many saved times; long
#: runs with many stages up to 1.7 times as slow
rolled = Repeat(compiled_loop, over_stages=True)


class Traced(StepLoop):
    """By a program of JAX, which has room for a fixed number of intervals."""

    derivative = "forward-mode AD through the numerical map"
    #: how arguments lie on several devices
    everywhere: Any = None

    def __init__(self, method: Any, request: Request) -> None:
        super().__init__(method, request)
        self.xla = Xla(
            request, identity(method, self.scene, self.carry), self.key(), everywhere=self.everywhere
        )

    def key(self) -> tuple[Any, ...]:
        return ()

    def record_tangent(self) -> None:
        """Nothing: the program is differentiated."""

    def ready(self, h: np.ndarray, n: np.ndarray) -> tuple[int, Any]:
        if not hasattr(self.xla, "program"):
            room = self.xla.room(len(n))
            self.xla.compile(self.states, self.spans(h, n, room), room)
            self.seconds = self.xla.seconds
        return len(n), self.spans(h, n, self.xla.capacity)

    def spans(self, h: np.ndarray, n: np.ndarray, room: int) -> Any:
        padded = np.zeros((2, room))
        padded[:, : len(n)] = h, n
        return self.xla.place(self.xla.together(self.scene.numbers(), *padded))

    def take(self, y0: np.ndarray, ready: Any) -> tuple[np.ndarray, int | None]:
        k, fixed = ready
        return self.xla.call(y0, fixed)[:k], None

    def start_of(self, scene: Any, y0: Any) -> Any:
        return scene.unpack(scene.entries(y0), self.carry)

    def states(self, y0: Any, fixed: Any) -> Any:
        """Saved states (k, d), traceable."""
        numbers, h, n = self.xla.apart(fixed)
        scene, xp = self.scene.with_numbers(list(numbers)), XlaNumbers()

        def interval(x: Any, span: Any) -> Any:
            h, n = span
            x = self.method.advance(scene, x, h, n, xp, rolled)
            return x, jnp.stack(scene.pack(x))

        return lax.scan(interval, self.start_of(scene, y0), (h, n.astype(int)))[1]

    def tangent(self, y0: np.ndarray, v: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        k, fixed = self.ready(h, n)
        return self.xla.derivative(self.states, y0, v, fixed)[:k]
