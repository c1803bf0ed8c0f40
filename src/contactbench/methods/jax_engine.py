"""Runs on JAX: one compiled program per structure, its forward derivative, and the loop over fixed steps."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Hashable
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from contactbench.methods.fixed_step_run import FixedStepRun, identity
from contactbench.methods.prepared import Prepared, stopwatch
from contactbench.numbers.control import Repeat, XlaNumbers
from contactbench.scene import Cache, key
from contactbench.trace.recording import reason_of
from contactbench.xla import jax, jnp, lax

_programs: Cache[tuple[Any, float]] = Cache(1024)


class CompiledRun(Prepared):
    """A run whose saved states are a JAX function of the packed initial state and all other numbers.

    So a program is compiled once per scene structure and `capacity` for saved times, then shared.
    """

    #: numbers of saved times a program is compiled for; the next larger one serves all in between
    capacities: ClassVar[tuple[int, ...]] = (1, 64, 1024)

    #: all arguments but the initial state, on the device; made by `together`, taken `apart` in the program
    fixed: Any
    #: how arguments lie on several devices; None on one
    everywhere: Any = None

    def key(self) -> tuple[Any, ...]:
        """What the program depends on besides the identity and the fields carried."""
        return (self.method, self.capacity)

    @property
    def identity(self) -> Hashable | None:
        return self.request.scene.identity

    @abstractmethod
    def states(self, y0: Any, fixed: Any) -> Any:
        """Saved states (k, d), traceable."""

    def together(self, *vectors: Any) -> np.ndarray:
        """Several arguments as one: what a short call costs is the number of its arguments."""
        self.borders = np.cumsum([len(vector) for vector in vectors])[:-1].tolist()
        return np.concatenate(vectors, dtype=float)

    def apart(self, fixed: Any) -> list[Any]:
        return [fixed[i:j] for i, j in pairwise([0, *self.borders, len(fixed)])]

    @staticmethod
    def flat(function: Callable[..., tuple[Any, Any, Any]]) -> Callable[..., Any]:
        """A function that returns saved states, facts about the run, and its last state, all in one vector."""
        return lambda *arguments: jnp.concatenate([jnp.ravel(part) for part in function(*arguments)])

    def unflat(self, vector: np.ndarray, d: int) -> tuple[np.ndarray, list[float], list[float]]:
        rest = vector[self.capacity * d :].tolist()
        return vector[: self._saves * d].reshape(-1, d), rest[:-d], rest[-d:]

    def room(self, saves: int) -> int:
        if self.request.scene.by_sites:  # its states are large
            return saves
        return next((size for size in self.capacities if size >= saves), saves)

    @cached_property
    def capacity(self) -> int:
        return self.room(self._saves)

    def times(self) -> np.ndarray:
        """The saved times as a program takes them: the end again and again beyond those asked for."""
        times = self.request.save_at
        return np.pad(times, (0, self.capacity - len(times)), mode="edge")

    def call(self, y0: np.ndarray, fixed: Any = None) -> np.ndarray:
        """What the program returns, from an initial state; the scene's own is moved to the device once."""
        start = self._start_on_device if y0 is self.start else y0
        return np.asarray(self.program(start, self.fixed if fixed is None else fixed))

    @cached_property
    def _start_on_device(self) -> Any:
        return jax.device_put(self.start, self.everywhere)

    def compile(self, states: Callable[..., Any], fixed: np.ndarray) -> None:
        # on the device once: converting them at every call would cost as much as a short run
        self.fixed = jax.device_put(fixed, self.everywhere)
        self.program, self.compile_s = self.compiled("run", states, self._start_on_device, self.fixed)

    def compiled(self, purpose: str, function: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
        """The program for a purpose, and the seconds it took to make; `CannotRecord` where it branches on values."""

        def make() -> tuple[Any, float]:
            elapsed = stopwatch()
            try:
                return jax.jit(function).lower(*arguments).compile(), elapsed()
            except jax.errors.JAXTypeError as error:
                raise reason_of(error) from error

        return _programs.get(key(self.identity, purpose, self.request.carry, *self.key()), make)

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        return self.derivative(y0, self.states, "steps")[: self._saves]

    def derivative(self, y0: np.ndarray, states: Callable[[Any, Any], Any], which: str) -> np.ndarray:
        def push(y0: Any, v: Any, fixed: Any) -> Any:
            return jax.jvp(lambda y: states(y, fixed), (y0,), (v,))[1]

        tangents = self.tangents(y0)
        program, _ = self.compiled(f"sensitivity, {which}", push, y0, tangents[0], self.fixed)
        columns = [np.asarray(program(y0, v, self.fixed)) for v in tangents]
        return np.stack(columns, axis=-1)


def compiled_loop(n: Any, body: Callable[[Any], Any], x: Any) -> Any:
    return lax.fori_loop(0, n, lambda _, x: body(x), x)


#: loops over stages too, the shortest code.  Against steps written out, measured on `particle`: compiled in a third to
#: a half of the time; short runs with few gradients a step up to three times as fast, more with many saved times; long
#: runs with many stages up to 1.7 times as slow
rolled = Repeat(compiled_loop, over_stages=True)


class JaxLoop(FixedStepRun, CompiledRun):
    sensitivity_source = "forward-mode AD through the numerical map"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.compile(self.states, self.fixed)

    @cached_property
    def capacity(self) -> int:  # type: ignore[override]
        return self.room(len(self.n))

    def divide(self, step: float) -> None:
        super().divide(step)
        self.fixed = self.spans(self.h, self.n)

    def spans(self, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        padded = np.zeros((2, self.capacity))
        padded[:, : len(n)] = h, n
        return self.together(self.numbers, *padded)

    def key(self) -> tuple[Any, ...]:
        return (self.capacity,)

    @cached_property
    def identity(self) -> Hashable | None:  # type: ignore[override]
        return identity(self.method_, self.request.scene, self.request.carry)

    def start_of(self, scene: Any, y0: Any) -> Any:
        return scene.unpack(scene.entries(y0), self.request.carry)

    def states(self, y0: Any, fixed: Any) -> Any:
        numbers, h, n = self.apart(fixed)
        r, xp = self.request, XlaNumbers()
        scene = r.scene.with_numbers(list(numbers))

        def interval(x: Any, span: Any) -> Any:
            h, n = span
            x = self.method_.advance(scene, x, h, n, xp, rolled)
            return x, jnp.stack(scene.pack(x))

        return lax.scan(interval, self.start_of(scene, y0), (h, n.astype(int)))[1]

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        derivative = self.derivative(y0, self.states, "steps")[: len(self.n)]
        return self.from_start(np.array(self.tangents(y0)).T, derivative[self.saved])

    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        return self.call(y0, None if n is self.n else self.spans(h, n))[: len(n)]

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return self.call(y0)[len(self.n) - 1]
