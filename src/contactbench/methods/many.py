"""Fixed steps on scenes of many sites: compiled sweeps, and arrays."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Hashable
from contextlib import suppress
from functools import cache, cached_property
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np

from contactbench.methods.jax_engine import Traced
from contactbench.methods.loops import (
    Loop,
    Plain,
    StepLoop,
    Steps,
    Watched,
    interruptible,
    is_fixed,
    loop_of,
)
from contactbench.methods.prepared import Request, stopwatch
from contactbench.numbers.control import Repeat
from contactbench.numbers.dual import Dual, DualNumbers, slope, value
from contactbench.numbers.protocol import Arithmetic, CannotRecord, Count
from contactbench.scene import Cache, Scene, State, Vector, key
from contactbench.scene.base import OwnState
from contactbench.scene.many import Many
from contactbench.solution import DIVERGENCE
from contactbench.trace.fields import FieldProgram, record_fields
from contactbench.trace.sweeps import (
    ADDRESSES,
    CHUNK,
    FIRST,
    LINE,
    OUT,
    PAD,
    STOP,
    WHOLE,
    Packing,
    compile_sweeps,
    stride_of,
)
from contactbench.xla import jax, lax

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from jax.sharding import Mesh, NamedSharding
    from numpy.typing import ArrayLike

#: sites from which on all cores share a sweep
SHARED = 50_000
#: steps times sites that take about a hundredth of a second or more
LONG = 1e7
#: bytes that are kept from one run to the next
SPARE = 2**26
#: numbers that a loop sees of a state: ‖q‖² + ‖p‖², H0, and the size of the terms of H0
SEEN = 3
#: steps and rounds of the measurement whether threads are faster than one, and how much faster they are to be
PILOT, ROUNDS, GAIN = 4, 3, 0.9


def field_program(
    advance: Callable[..., OwnState], scene: Many, packing: Packing, watch: bool
) -> FieldProgram:
    """Record ``advance(scene, x, h, n, xp, repeat)``, on dual numbers with two blocks; may raise `CannotRecord`.

    watch : what is `SEEN` of the start and of the end follows the state, where that is asked for.
    """
    (d, with_s, blocks), names = packing, tuple(scene.constants)

    def fields(
        numbers: Vector, h: Arithmetic, n: Count, f: Any, s: Any, constants: Vector, xp: Any, repeat: Repeat
    ) -> list[Arithmetic]:
        if blocks > 1:
            f, s, xp = list(map(Dual, f[: 2 * d], f[2 * d :])), [Dual(*s)] if with_s else [], DualNumbers(xp)
        twin = scene.with_numbers(numbers)._replaced(**dict(zip(names, constants, strict=True)))

        def see(k: int, x: State) -> list[Arithmetic]:
            def look(_: object) -> list[Arithmetic]:
                return [twin.product(x.q, x.q) + twin.product(x.p, x.p), twin.energy(x), twin.energy_terms(x)]

            return repeat(xp.tape.looks[k], look, [0.0] * SEEN) if watch else []

        start = State(tuple(f[:d]), tuple(f[d:]), s[0] if with_s else None)
        before = see(0, start)
        x = advance(twin, start, h, n, xp, repeat)
        components = [*x.q, *x.p], [x.s] if with_s else []
        end = [number(c) for part in components for number in (value, slope)[:blocks] for c in part]
        return [*end, *before, *see(1, x)]

    seen = 2 * SEEN * watch
    return record_fields(fields, len(scene.numbers()), 2 * d * blocks, with_s * blocks, len(names), seen)


@cache
def others(count: int) -> Executor:
    """Threads beside this one."""
    from concurrent.futures import ThreadPoolExecutor

    return ThreadPoolExecutor(count, thread_name_prefix="sweep")


os.register_at_fork(after_in_child=others.cache_clear)


class Rest:
    """Until when one thread works alone, since another one had no core; longer each time that happens again."""

    LEAST, MOST = 0.5, 60.0

    def __init__(self) -> None:
        self.until, self.length = 0.0, self.LEAST

    def note(self, late: bool) -> None:
        if late:
            self.until, self.length = monotonic() + self.length, min(2 * self.length, self.MOST)
        else:
            self.length = self.LEAST


REST = Rest()


def threads_for(sites: int) -> int:
    """How many threads may share the sweeps: those numba is to use, for large scenes."""
    if sites < SHARED:
        return 1
    from numba import get_num_threads

    return min(int(get_num_threads()), -(-sites // CHUNK))


class FieldLoop(Loop):
    """A recorded function on fields: one for all numbers of sites of a boundary."""

    program: Any

    def __init__(
        self, advance: Callable[..., OwnState], scene: Many, packing: Packing, watch: bool = False
    ) -> None:
        elapsed = stopwatch()
        self.seen = 2 * SEEN * watch
        #: fields of an earlier run, by the number of sites: to make new ones takes as long as some steps
        self.spare: dict[int, list[np.ndarray]] = {}
        self.boundary, self.packing = scene.boundary, packing
        #: whether all threads are faster than one, by the number of sites and of threads
        self.shares: dict[tuple[int, int], bool] = {}
        super().__init__(field_program(advance, scene, packing, watch), 0.0)  # type: ignore[arg-type]
        self.seconds = elapsed()

    @cached_property
    def sweeps(self) -> int:
        elapsed, program = stopwatch(), self.program
        made = compile_sweeps(program.run, self.boundary, program.sums, program.width, self.packing)
        self.seconds += elapsed()
        return made

    @cached_property
    def run(self) -> Callable[..., int]:
        pointer = ctypes.c_void_p
        return ctypes.CFUNCTYPE(None, pointer, ctypes.c_double, pointer, pointer)(self.sweeps)

    def data(self, scene: Many, arrays: dict[str, np.ndarray], rank: int = 0, threads: int = 1) -> np.ndarray:
        """The argument `data` of the compiled function: the addresses of its arrays, which are to be kept alive."""
        data = np.zeros(FIRST + len(ADDRESSES) + len(WHOLE))
        addresses = (arrays[name].ctypes.data for name in ADDRESSES)
        data.view(np.int64)[FIRST:] = [*addresses, scene.sites, stride_of(scene.sites), rank, threads]
        return data

    def arrays(
        self, scene: Many, numbers: np.ndarray, h: ArrayLike = (0.0,), n: ArrayLike = (1,)
    ) -> dict[str, np.ndarray]:
        """The arrays that the compiled function works on, by name; fields has the constants after the state."""
        program, sites, constants = self.program, scene.sites, scene.constants.values()
        w, shape = self.rows(numbers, np.asarray(h, dtype=float), np.asarray(n))
        try:
            fields = self.spare.get(sites, []).pop()
        except IndexError:
            fields = np.zeros((program.rows, stride_of(sites)))
        first = 2 * self.packing.dimensions * self.packing.blocks
        for row, constant in zip(fields[first:, : sites + 2 * PAD], constants, strict=False):
            row[PAD:-PAD] = constant
            if self.boundary != "fixed":  # the neighbours beyond the ends
                row[PAD - 1], row[-PAD] = constant[[-1, 0] if self.boundary == "ring" else [0, -1]]
        sums = np.zeros((2 * max(1, program.sums), -(-sites // CHUNK)))
        whole = {"shape": np.append(shape, [0, 0]).astype(np.int64), "sync": np.zeros(LINE, dtype=np.int64)}
        return {"w": w, "fields": fields, "sums": sums} | whole

    def call(
        self,
        scene: Many,
        arrays: dict[str, np.ndarray],
        y: np.ndarray,
        out: np.ndarray,
        threads: int,
        long: bool = False,
    ) -> bool:
        """Run the compiled function on some threads; return whether one of them was late and left out.

        Such a thread may look at the arrays later, which live as long as its call.  A long run hears Ctrl-C.
        """
        arrays = arrays | {"sync": np.zeros(LINE * threads, dtype=np.int64)}
        data = [self.data(scene, arrays, rank, threads) for rank in range(threads)]

        def work(each: np.ndarray, *_: object) -> None:
            self.run(out.ctypes.data, 0.0, y.ctypes.data, each.ctypes.data)

        for each in data[1:]:
            others(threads - 1).submit(work, each, arrays)
        interruptible(lambda: work(data[0]), lambda: arrays["sync"].__setitem__(STOP, 1), long)
        return bool((arrays["sync"][LINE::LINE] == OUT).any())

    def threads(self, scene: Many, numbers: np.ndarray, y: np.ndarray, h: float) -> int:
        """How many threads to use now: all where that was measured to be faster, else one."""
        most = threads_for(scene.sites)
        if most > 1 and (scene.sites, most) not in self.shares and monotonic() > REST.until:
            arrays, out = self.arrays(scene, numbers, [h], [PILOT]), np.empty(y.size + self.seen)
            times: dict[int, list[float]] = {1: [], most: []}
            for count in [1, most] * ROUNDS:
                elapsed = stopwatch()
                late = self.call(scene, arrays, y, out, count)
                times[count].append(elapsed())
                if late:
                    REST.note(late)
                    return 1
            self.shares[scene.sites, most] = min(times[most]) < GAIN * min(times[1])
        shared = self.shares.get((scene.sites, most), False) and monotonic() > REST.until
        return most if shared else 1

    def states(self, scene: Any, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        """Return packed states after each interval, (k, d), each maybe with its tangent after it."""
        return self.steps(scene, y0, h, n, False)[:, : y0.size]

    def steps(self, scene: Any, y: np.ndarray, h: np.ndarray, n: np.ndarray, watch: bool) -> np.ndarray:
        """Return the states, each followed by what was seen of the first start and of every end."""
        numbers = np.array(scene.numbers())
        arrays, out = self.arrays(scene, numbers, h, n), np.empty((len(n), y.size + self.seen))
        which = arrays["shape"][len(self.program.shape) : -2].copy()
        y = np.ascontiguousarray(y, dtype=float)
        threads, long = self.threads(scene, numbers, y, h[0]), np.asarray(n) > LONG / scene.sites
        for k, (row, after) in enumerate(zip(which, out, strict=True)):
            place = len(self.program.shape)
            arrays["shape"][place : place + 3] = row, watch and k == 0, watch
            if threads > 1:
                late = self.call(scene, arrays, y, after, threads, long[k])
                REST.note(late)
                threads = 1 if late else threads
            else:
                self.call(scene, arrays, y, after, 1, long[k])
            y = after
        if arrays["fields"].nbytes <= SPARE:
            self.spare = {scene.sites: [arrays["fields"]]}
        return out


_loops: Cache[FieldLoop] = Cache(256)


def loop_on(method: Steps, scene: Scene, carry: tuple[str, ...], tangent: bool = False) -> Loop:
    """Return the compiled loop of a method on a scene of any kind; raises `CannotRecord`."""
    return (field_loop if scene.by_sites else loop_of)(method, scene, carry, tangent)


def field_loop(method: Steps, scene: Any, carry: tuple[str, ...], tangent: bool = False) -> FieldLoop:
    """The loop of a method; `CannotRecord`, also where numba is told not to compile."""
    packing = Packing(scene.dimensions, "s" in carry, 1 + tangent)
    known = (method, scene.equations) if is_fixed(method) and scene.identity is not None else None

    def make() -> FieldLoop:
        with suppress(CannotRecord):  # an energy that is not as simple as its gradient
            return FieldLoop(method.advance, scene, packing, watch=not tangent)
        return FieldLoop(method.advance, scene, packing)

    return _loops.get(key(known, packing), make)


def slopes_of(scene: Many, carry: tuple[str, ...]) -> FieldLoop:
    """The right-hand side."""
    packing = Packing(scene.dimensions, "s" in carry)
    known = key(scene.equations if scene.identity is not None else None, packing)
    return _loops.get(known, lambda: FieldLoop(lambda scene, x, *_: scene.rhs(x), scene, packing))


class Arrays(Plain):
    """By the step map on NumPy's arrays."""

    @cached_property
    def tangents(self) -> FieldLoop:  # type: ignore[override]
        return field_loop(self.method, self.scene, self.carry, tangent=True)


class Sweeps(StepLoop[tuple[np.ndarray, np.ndarray]]):
    """By sweeps over the sites, compiled by LLVM."""

    derivative = "forward-mode AD through the numerical map"

    def __init__(self, method: Steps, request: Request) -> None:
        super().__init__(method, request)
        self.loop = field_loop(method, self.scene, self.carry)
        self.loop.sweeps  # noqa: B018, compiled now
        self.seconds = self.loop.seconds

    tangents = Arrays.tangents

    def ready(self, h: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return h, n

    def take(self, y0: np.ndarray, ready: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, int | None]:
        return self.loop.states(self.scene, y0, *ready), None

    def watched(self, ready: tuple[np.ndarray, np.ndarray], steps: int, starts: bool) -> Watched | None:
        """As in `StepLoop`: looking at the states once more takes as long as a few steps."""
        loop, bounds, (h, n) = self.loop, self.scene.bounds_energy, ready
        if not loop.seen:
            return None

        def watched(y0: np.ndarray) -> tuple[np.ndarray, bool]:
            found = loop.steps(self.scene, y0, h, n, True)
            y, start, end = np.split(found, [len(y0), len(y0) + SEEN], axis=1)
            with np.errstate(over="ignore"):
                small, rises = end[:, 0] <= DIVERGENCE**2, end[-1, 1] > start[0, 1] + start[0, 2]
            fine = bool(small.all() and np.isfinite(end[:, 1]).all() and not (rises and bounds))
            return np.concatenate([y0[None], y]) if starts else y, fine

        return watched


class Meshes(Traced):
    """By JAX; many sites are divided evenly among all devices, on one CPU where threads would do so."""

    @cached_property
    def mesh(self) -> Mesh | None:
        from jax.sharding import Mesh

        devices, sites = jax.devices(), self.scene.sites  # type: ignore[attr-defined]
        even = sites >= SHARED and len(devices) > 1 and sites % len(devices) == 0
        alone = jax.process_count() == 1 and devices[0].platform == "cpu" and threads_for(sites) == 1
        return Mesh(np.array(devices), ("sites",)) if even and not alone else None

    def along(self, *axes: str) -> NamedSharding | None:
        from jax.sharding import NamedSharding, PartitionSpec

        return None if self.mesh is None else NamedSharding(self.mesh, PartitionSpec(*axes))

    @cached_property
    def everywhere(self) -> NamedSharding | None:  # type: ignore[override]
        return self.along()

    def key(self) -> tuple[Hashable, ...]:
        return (self.mesh,)

    def start_of(self, scene: Scene, y0: jax.Array) -> OwnState:
        x: OwnState = super().start_of(scene, y0)
        divided = self.along("sites")
        if self.mesh is None:
            return x
        q, p = (tuple(lax.with_sharding_constraint(c, divided) for c in part) for part in (x.q, x.p))
        return x._replace(q=q, p=p)

    def states(self, y0: jax.Array, fixed: jax.Array) -> jax.Array:
        y = super().states(y0, fixed)
        return y if self.mesh is None else lax.with_sharding_constraint(y, self.everywhere)


SITE_LOOPS: dict[str, type[StepLoop[Any]]] = {"numba": Sweeps, "jax": Meshes, "python": Arrays}
