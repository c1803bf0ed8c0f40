"""Chunks of an ensemble: who integrates them, and what happens to one whose worker dies."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent import futures
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from contactbench.ensembles.members import Array, Marks, Watch
from contactbench.errors import BadInput
from contactbench.methods.base import METHODS
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.jax_engine import rolled
from contactbench.methods.loops import LANES, Loop, identity
from contactbench.methods.many import SHARED, loop_on
from contactbench.methods.prepared import Request, furthest
from contactbench.numbers.control import XlaNumbers
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import AnyState, Cache, Scene, key

if TYPE_CHECKING:
    from jaxtyping import PyTree

    from contactbench.xla import jax

ENGINES = ("numba", "jax")
#: trajectories in a task of an executor, whose number of workers is not known
TASK = 2**14
#: how often a chunk is given to an executor that loses it
ATTEMPTS = 3
#: numbers that are kept of scenes of many sites at a time, for every core
AT_ONCE = 2**22
#: chunks begun for every core before the first of them is asked for
AHEAD = 2

#: trajectories a core integrates at a time: half a kilobyte per component
TILE = 64
#: trajectories a device is handed at a time: enough for the call not to count
CHUNK = {"cpu": 2**16, "gpu": 2**20}
AXIS = "trajectories"

#: final states (d, m), measures (·, m) and end times (m,)
Result = tuple[np.ndarray, np.ndarray, np.ndarray]
#: values (n,) of parameters that differ from one trajectory to the next, by their place among the scene's numbers
Own = dict[int, np.ndarray]
_programs: Cache[Callable[..., tuple[jax.Array, ...]]] = Cache(256)


@dataclass(frozen=True)
class Task:
    """What is done to every chunk; a worker elsewhere knows the method by its name."""

    request: Request
    method: str
    names: tuple[str, ...]
    engine: str | None

    def __call__(self, y0: np.ndarray, own: Own) -> Result | Exception:
        """Return one chunk by one core; an error of its own is its result, so that all others are its worker's."""
        try:
            chosen = METHODS[self.method]
            assert isinstance(chosen, FixedStep)
            run = FixedStepRun(self.method, self.request, chosen)
            made = list(self.chunks(run, y0, own, y0.shape[1], cores=1))
        except Exception as error:
            return error
        y, measures, end_time = (np.concatenate(arrays, axis=-1) for arrays in zip(*made, strict=True))
        return y, measures, end_time

    def chunks(
        self, run: FixedStepRun, y0: np.ndarray, own: Own, chunk: int | None, cores: int | None = None
    ) -> Iterator[Result]:
        """Yield the results of one chunk after the other, in this process; cores : by default all it may use."""
        from contactbench.xla import jax

        devices = jax.local_devices()
        why = "" if devices[0].platform == "cpu" else f"it runs on a CPU, not on {devices[0].platform}"
        many = run.request.scene.by_sites
        why = why or ("parameters differ from one trajectory to the next" if own and not many else "")
        if self.engine != "jax" and not why:
            try:
                loop = loop_on(run.method_, run.request.scene, run.request.carry)
            except CannotRecord as error:
                why = str(error)
            else:
                chunk = chunk or CHUNK["cpu"]
                yield from on_cores(run, loop, self.names, y0, cores or len(devices), chunk, own)
                return
        if self.engine == "numba":
            raise BadInput(f"engine = 'numba': {why}; leave the choice open, or take 'jax'")
        yield from on_devices(run, self.names, y0, own, chunk)


def results(
    task: Task, run: FixedStepRun, y0: np.ndarray, own: Own, chunk: int | None, executor: Executor | None
) -> Iterator[tuple[int, Result]]:
    """Yield (first trajectory of a chunk, its result), every chunk once; by an executor in the order they end."""
    if executor is not None:
        yield from spread(executor, task, y0, own, chunk or TASK)
        return
    first = 0
    for result in task.chunks(run, y0, own, chunk):
        yield first, result
        first += len(result[-1])


# -- by the loop numba compiles, a thread on every core ------------------------------------------------
def on_cores(
    run: FixedStepRun,
    loop: Loop,
    names: Sequence[str],
    y0: np.ndarray,
    cores: int,
    chunk: int,
    own: Own,
) -> Iterator[Result]:
    """Yield the results of chunks of one size, of which a few are begun ahead, so that no core waits for another."""
    scene: Any = run.request.scene
    n = y0.shape[1]
    work: Callable[..., Result]
    if scene.by_sites:
        chunk = min(chunk, max(1, AT_ONCE // (len(run.n) * len(y0))))
        cores = cores if scene.sites < SHARED else 1
        work, share = partial(one_by_one, run, loop, names), equal_share(n, cores, chunk, 1)
    else:
        loop.many  # noqa: B018, compiled now, once
        work, share = (
            partial(side_by_side, run, loop, names),
            equal_share(n, cores, chunk, loop.lanes),
        )
        if share >= n and not loop.is_long(run.needed * n):  # no thread is worth its start
            yield work(y0, own)
            return
    ahead: deque[Future[Result]] = deque()
    threads = futures.ThreadPoolExecutor(cores)
    try:
        for first in range(0, n, share):
            part = slice(first, first + share)
            numbers = {place: values[part] for place, values in own.items()}
            ahead.append(threads.submit(work, y0[:, part], numbers))
            if len(ahead) > AHEAD * cores:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()
    finally:  # begin no other where one has failed or the rest is not wanted
        threads.shutdown(cancel_futures=True)


def equal_share(n: int, cores: int, chunk: int, lanes: int = LANES) -> int:
    """Return the size of the fewest chunks of at most `chunk`, a multiple of `cores`; whole tiles if they fit."""
    share = -(-n // (cores * -(-n // (cores * chunk))))
    whole = lanes * -(-share // lanes)
    return whole if whole <= chunk else share


def side_by_side(run: FixedStepRun, loop: Loop, names: Sequence[str], y0: np.ndarray, _: Own) -> Result:
    """Return final states (d, m), measures (·, m) and end times (m,) of some trajectories, on one core."""
    w, shape = loop.rows(np.array(run.request.scene.numbers()), run.h, run.n)
    place = len(loop.program.shape)

    def states() -> Iterator[np.ndarray]:
        y = y0
        for which in shape[place:]:
            y = loop.side_by_side(y, w, np.append(shape[:place], which))[0]
            yield y

    return measured(run, run.request.scene, names, y0, states(), run.until)


def one_by_one(run: FixedStepRun, loop: Loop, names: Sequence[str], y0: np.ndarray, own: Own) -> Result:
    """Return the same of scenes of many sites, one trajectory after the other, each with parameters of its own."""
    base = run.request.scene
    numbers = np.tile(base.numbers(), (y0.shape[1], 1))
    for place, values in own.items():
        numbers[:, place] = values
    paths = [
        loop.states(base.with_numbers(row), start, run.h, run.n)
        for row, start in zip(numbers, np.ascontiguousarray(y0.T), strict=True)
    ]
    scene = base.with_numbers(list(numbers.T)) if own else base
    return measured(run, scene, names, y0, np.stack(paths, axis=-1), run.until)


def measured(
    run: FixedStepRun,
    scene: Scene,
    names: Sequence[str],
    y0: np.ndarray,
    states: Iterable[np.ndarray],
    times: np.ndarray,
) -> Result:
    """Return the result from the states (d, m) after each interval, which are looked at where a time is saved."""
    carry = run.request.carry
    with np.errstate(all="ignore"):
        watch = Watch(scene, carry, names, furthest(scene, carry, y0, run._end), y0)
        marks = watch.begun
        for y, t in zip(states, times.tolist(), strict=True):
            if not math.isnan(t):
                x = scene.unpack(scene.components(y), carry)
                marks = watch.at(marks, x, y, t)
        return watch.result(marks, x, y)


# -- by JAX ------------------------------------------------------------------------------------------
def on_devices(
    run: FixedStepRun, names: tuple[str, ...], y0: np.ndarray, own: Own, chunk: int | None
) -> Iterator[Result]:
    """Yield the results of one chunk after the other, each divided among this process's devices."""
    from jax.sharding import Mesh, NamedSharding, PartitionSpec

    from contactbench.xla import jax

    mesh = Mesh(np.array(jax.local_devices()), (AXIS,))
    platform = mesh.devices.flat[0].platform
    at_once = mesh.size * (chunk or CHUNK.get(platform, CHUNK["gpu"]))
    n = y0.shape[1]
    count = -(-n // -(-n // at_once))  # in chunks of one size, that of a single program
    share = -(-count // mesh.size)
    tile = min(TILE, share) if platform == "cpu" else share
    size = mesh.size * tile * -(-share // tile)
    r, places = run.request, tuple(own)

    cut, whole = PartitionSpec(None, AXIS), PartitionSpec()

    def make() -> Callable[..., tuple[jax.Array, ...]]:
        share = share_of(run, names, places, tile)
        taken, given = (cut, cut, cut, whole, whole), (cut, cut, PartitionSpec(AXIS))
        return jax.jit(jax.shard_map(share, mesh=mesh, in_specs=taken, out_specs=given, check_vma=False))

    program = _programs.get(key(identity(run.method_, r.scene, r.carry), names, places, tile, mesh), make)
    sharding = NamedSharding(mesh, cut)
    individual = np.array([*own.values()]).reshape(len(own), n)
    numbers = np.array(r.scene.numbers())

    def begin(part: slice) -> tuple[jax.Array, ...]:
        filled = ((0, 0), (0, size - (part.stop - part.start)))  # the last trajectory again and again
        values: list[float | np.ndarray] = list(r.scene.numbers())
        for place, each in own.items():
            values[place] = each[part]
        bound = furthest(r.scene.with_numbers(values), r.carry, y0[:, part], run._end)
        arrays = (np.pad(a, filled, mode="edge") for a in (y0[:, part], bound, individual[:, part]))
        return program(*jax.device_put(tuple(arrays), sharding), numbers, (run.h, run.n, run.until))

    slices = [slice(first, min(first + count, n)) for first in range(0, n, count)]
    ahead = begin(slices[0])
    for part, following in zip(slices, [*slices[1:], None], strict=True):
        out = ahead
        if following is not None:  # begun before this one is waited for: no device idles at its end
            ahead = begin(following)
        yield tuple(np.asarray(a)[..., : part.stop - part.start] for a in out)  # type: ignore[misc]


def share_of(
    run: FixedStepRun, names: Sequence[str], places: Sequence[int], tile: int
) -> Callable[..., tuple[jax.Array, ...]]:
    """Return the function of one device: its part of a chunk, tile by tile."""
    from contactbench.xla import jax, jnp, lax

    base, carry, xp = run.request.scene, run.request.carry, XlaNumbers()

    def packed(scene: Scene, x: AnyState) -> Any:
        return jnp.stack(list(scene.pack(x))) if not scene.by_sites else scene.pack(x)

    def one_tile(
        y0: Array, bound: Array, own: Array, numbers: Array, spans: PyTree
    ) -> tuple[Array, Array, Array]:
        values = list(numbers)
        for place, value in zip(places, own, strict=True):
            values[place] = value
        scene = base.with_numbers(values)
        watch = Watch(scene, carry, names, bound, y0, jnp)

        def span(carried: tuple[AnyState, Marks], interval: PyTree) -> tuple[tuple[AnyState, Marks], None]:
            (x, marks), (h, n, t) = carried, interval
            # parameters of its own give every trajectory stage constants of its own
            h = jnp.broadcast_to(h, tile) if places else h
            x = run.method_.advance(scene, x, h, n, xp, rolled)
            seen = watch.at(marks, x, packed(scene, x), t)
            return (x, jax.tree.map(partial(jnp.where, jnp.isnan(t)), marks, seen)), None

        (x, marks), _ = lax.scan(span, (watch.start, watch.begun), spans)
        return watch.result(marks, x, packed(scene, x))

    def share(y0: Array, bound: Array, own: Array, numbers: Array, spans: PyTree) -> tuple[jax.Array, ...]:
        tiles = [a.reshape(len(a), a.shape[1] // tile, tile).swapaxes(0, 1) for a in (y0, bound, own)]
        y, measures, end = lax.map(lambda a: one_tile(a[0], a[1], a[2], numbers, spans), tiles)
        return *(a.swapaxes(0, 1).reshape(a.shape[1], -1) for a in (y, measures)), end.reshape(-1)

    return share


# -- by an executor ------------------------------------------------------------------------------------
def spread(
    executor: Executor, task: Task, y0: np.ndarray, own: Own, size: int
) -> Iterator[tuple[int, Result]]:
    """Yield (first trajectory, result) of chunks; one that its worker lost is given again, `ATTEMPTS` times in all."""
    lost: Counter[int] = Counter()
    pending: dict[Future[Result | Exception], int] = {}

    def begin(first: int) -> None:
        part = slice(first, first + size)
        numbers = {place: values[part] for place, values in own.items()}
        try:
            pending[executor.submit(task, y0[:, part], numbers)] = first
        except futures.BrokenExecutor as error:
            raise BadInput(f"executor: {type(executor).__name__} is broken: {error}") from error

    for first in range(0, y0.shape[1], size):
        begin(first)
    while pending:
        for future in futures.wait(pending, return_when=futures.FIRST_COMPLETED).done:
            first = pending.pop(future)
            try:
                result = future.result()
            except (Exception, futures.CancelledError) as error:
                lost[first] += 1
                if lost[first] == ATTEMPTS:
                    what = f"chunk {first // size} was lost {ATTEMPTS} times"
                    raise BadInput(f"executor: {what}: {error!r}") from error
                begin(first)
                continue
            if isinstance(result, Exception):
                raise result
            yield first, result
