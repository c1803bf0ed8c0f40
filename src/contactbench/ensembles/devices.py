"""Trajectories tile by tile, by JAX: on the GPUs, or where numba cannot."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from contactbench.ensembles.members import Watch
from contactbench.methods.fixed_step_run import FixedStepRun, identity
from contactbench.methods.jax_engine import rolled
from contactbench.numbers.control import XlaNumbers
from contactbench.scene.cache import Cache, key

#: trajectories a core integrates at a time: half a kilobyte per component
TILE = 64
#: trajectories a device is handed at a time: enough for the call not to count
CHUNK = {"cpu": 2**16, "gpu": 2**20}
AXIS = "trajectories"

#: final states (d, m), measures (·, m) and end times (m,)
Result = tuple[np.ndarray, np.ndarray, np.ndarray]
#: values (n,) of parameters that differ from one trajectory to the next, by their place among the scene's numbers
Own = dict[int, np.ndarray]
_programs: Cache[Callable[..., Any]] = Cache(256)


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

    def make() -> Callable[..., Any]:
        share = share_of(run, names, places, tile)
        specs = {"in_specs": (cut, cut, whole, whole), "out_specs": (cut, cut, PartitionSpec(AXIS))}
        return jax.jit(jax.shard_map(share, mesh=mesh, check_vma=False, **specs))

    program = _programs.get(key(identity(run.method_, r.scene, r.carry), names, places, tile, mesh), make)
    sharding = NamedSharding(mesh, cut)
    individual = np.array([*own.values()]).reshape(len(own), n)
    numbers = np.array(r.scene.numbers())

    def begin(part: slice) -> Any:
        filled = ((0, 0), (0, size - (part.stop - part.start)))  # the last trajectory again and again
        arrays = (np.pad(a[:, part], filled, mode="edge") for a in (y0, individual))
        return program(*jax.device_put(tuple(arrays), sharding), numbers, (run.h, run.n, run.later))

    parts = [slice(first, min(first + count, n)) for first in range(0, n, count)]
    ahead = begin(parts[0])
    for part, following in zip(parts, [*parts[1:], None], strict=True):
        out = ahead
        if following is not None:  # begun before this one is waited for: no device idles at its end
            ahead = begin(following)
        yield tuple(np.asarray(a)[..., : part.stop - part.start] for a in out)  # type: ignore[misc]


def share_of(
    run: FixedStepRun, names: tuple[str, ...], places: tuple[int, ...], tile: int
) -> Callable[..., Any]:
    """Return the function of one device: its part of a chunk, tile by tile."""
    from contactbench.xla import jnp, lax

    base, carry, motion, xp = run.request.scene, run.request.carry, run._motion, XlaNumbers()

    def packed(scene: Any, x: Any) -> Any:
        return jnp.stack(list(scene.pack(x))) if scene.kind != "many" else scene.pack(x)

    def one_tile(y0: Any, own: Any, numbers: Any, spans: Any) -> Any:
        values = list(numbers)
        for place, value in zip(places, own, strict=True):
            values[place] = value
        scene = base.with_numbers(values)
        watch = Watch(scene, carry, names, motion, y0, jnp)

        def span(carried: Any, interval: Any) -> Any:
            (x, marks), (h, n, t) = carried, interval
            # parameters of its own give every trajectory stage constants of its own
            h = jnp.broadcast_to(h, tile) if places else h
            x = run.method_.advance(scene, x, h, n, xp, rolled)
            return (x, watch.at(marks, x, packed(scene, x), t)), None

        (x, marks), _ = lax.scan(span, (watch.start, watch.begun), spans)
        return watch.result(marks, x, packed(scene, x))

    def share(y0: Any, own: Any, numbers: Any, spans: Any) -> Any:
        tiles = [a.reshape(len(a), a.shape[1] // tile, tile).swapaxes(0, 1) for a in (y0, own)]
        y, measures, end = lax.map(lambda part: one_tile(part[0], part[1], numbers, spans), tiles)
        return *(a.swapaxes(0, 1).reshape(a.shape[1], -1) for a in (y, measures)), end.reshape(-1)

    return share
