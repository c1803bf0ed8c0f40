"""Trajectories side by side, by the loop numba compiles: a thread on every core."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from contactbench.ensembles.measures import DECAYING
from contactbench.measure.deviation import conformal_deviation
from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.llvm import compiled
from contactbench.methods.numba_engine import Loop
from contactbench.solution import DIVERGENCE

#: trajectories a compiled loop integrates side by side: with fewer each waits for its own last operation
LANES = 32


def on_cores(
    run: FixedStepRun, loop: Loop, names: list[str], y0: np.ndarray, cores: int, chunk: int
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The same by the loop numba compiles, a thread on every core."""
    many = compiled(loop.program.many, LANES).many
    n = y0.shape[1]
    share = min(chunk, -(-n // cores))
    parts = [y0[:, first : first + share] for first in range(0, n, share)]
    with ThreadPoolExecutor(cores) as threads:
        for first in range(0, len(parts), cores):
            mine = parts[first : first + cores]
            done = threads.map(lambda part: side_by_side(run, loop, many, names, part), mine)
            yield tuple(np.concatenate(arrays, axis=-1) for arrays in zip(*done, strict=True))  # type: ignore[misc]


def side_by_side(
    run: FixedStepRun, loop: Loop, many: Callable[..., Any], names: list[str], y0: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Final states (d, m), measures (·, m) and end times (m,) of some trajectories, on one core."""
    r, m = run.request, y0.shape[1]
    scene = r.scene
    rows, shape = loop.rows(np.array(scene.numbers()), run.h, run.n)
    y = np.pad(y0, ((0, 0), (0, -m % LANES)), mode="edge")  # the last trajectory again and again
    part, place = np.array([0, y.shape[1] // LANES]), len(loop.program.shape)

    def quantity(name: str, x: Any) -> Any:
        return np.stack(np.broadcast_arrays(*DECAYING[name][0](scene, x)), axis=-1)

    start = scene.unpack(tuple(y0), r.carry)
    size = np.linalg.norm(y0[: run._motion], axis=0)
    bound = DIVERGENCE * np.where(size > 0, size, 1.0)
    alive, end = np.ones(m, dtype=bool), np.zeros(m)
    with np.errstate(all="ignore"):
        origin = {name: quantity(name, start) for name in names[1:]}
        worst = {name: np.zeros(m) for name in origin}
        for which, t in zip(shape[place:], run.later, strict=True):
            after = np.empty((1, *y.shape))
            many(y, rows, np.append(shape[:place], which), after, part)
            y = after[0]
            x = scene.unpack(tuple(y[:, :m]), r.carry)
            alive &= np.isfinite(y[:, :m]).all(axis=0) & (np.abs(y[: run._motion, :m]).max(axis=0) <= bound)
            end = np.where(alive, t, end)
            for name, first in origin.items():
                terms = DECAYING[name][1](scene, x)
                law = conformal_deviation(quantity(name, x), first, t, scene.conformal_rate, terms)
                worst[name] = np.maximum(worst[name], law)
        energy = scene.energy(x) / scene.energy(start) - 1
    measures = np.array([energy, *worst.values()])
    return np.where(alive, y[:, :m], np.nan), np.where(alive, measures, np.nan), end
