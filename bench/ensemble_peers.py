"""Ensembles by each engine: functions of a scene, a setting and initial states (d, n) that return a run.

A run takes nothing and returns the final states (d, n) on the host, one array or one per component.
Each peer is in its best shape of those tried: diffrax in tiles of trajectories that fit the first cache,
both with steps of their own (vmap) and with steps they share (one system per tile, about twice as fast,
its error control over the tile); heyoka in batches of the machine's vector width.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

import contactbench as cb
from c_loops import ensemble_kernel
from contactbench.methods.prepared import Refused

#: trajectories integrated together: the fastest of 64, 256 and all, for vmap and for shared steps
TILE = 64
#: trajectories for which its program is compiled
ROOM = 4096
SOLVERS = {"diffrax-tsit5": ("Tsit5", 6), "diffrax-dopri8": ("Dopri8", 13)}


def contact(scene: Any, method: str, engine: str, value: float, y0: np.ndarray) -> Any:
    start = scene.unpack(tuple(np.ascontiguousarray(y0)), ())

    def run() -> list[np.ndarray]:
        return scene.pack(solved(start).final)

    def solved(start: Any) -> Any:
        return cb.ensemble(scene, method, start, step=value, carry=(), progress=False, engine=engine)

    counts = solved(scene.unpack(tuple(y0[:, :1]), ())).counts
    return run, lambda: (counts.steps, counts.evaluations, counts.kind)


@cache
def diffrax_program(name: str, shape: str, scene_name: str) -> Any:
    import diffrax

    from contactbench.xla import jax, jnp

    scene = cb.SCENES[scene_name]
    solver = getattr(diffrax, SOLVERS[name][0])()

    def solve(y: Any, tolerance: Any, end: Any) -> Any:
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, x, args: scene.rhs(x)),
            solver,
            0.0,
            end,
            None,
            scene.unpack(list(y), ()),
            saveat=diffrax.SaveAt(t1=True),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            max_steps=10**6,
            adjoint=diffrax.ForwardMode(),
            throw=False,
        )
        return jnp.stack([c[0] for c in scene.pack(solution.ys)]), solution.stats["num_steps"]

    if shape == "vmap":
        solve = jax.vmap(solve, in_axes=(1, None, None), out_axes=(1, 0))

    def tiled(y: Any, tiles: Any, tolerance: Any, end: Any) -> Any:
        def one(k: Any, state: Any) -> Any:
            y, most = state
            mine, steps = solve(jax.lax.dynamic_slice_in_dim(y, k * TILE, TILE, axis=1), tolerance, end)
            y = jax.lax.dynamic_update_slice_in_dim(y, mine, k * TILE, axis=1)
            return y, jnp.maximum(most, steps.max())

        return jax.lax.fori_loop(0, tiles, one, (y, jnp.array(0)))

    return jax.jit(tiled)


def diffrax(scene: Any, method: str, shape: str, value: float, y0: np.ndarray) -> Any:
    """The program for `ROOM` serves fewer too; the last trajectory fills the last tile."""
    program, steps, n = diffrax_program(method, shape, scene.name), [0], y0.shape[1]
    tiles = -(-n // TILE)
    room = np.pad(y0, ((0, 0), (0, max(ROOM, tiles * TILE) - n)), mode="edge")

    def run() -> np.ndarray:
        y, steps[0] = program(room, tiles, value, scene.t_end)
        return np.asarray(y)[:, :n]

    return run, lambda: (int(steps[0]), int(steps[0]) * SOLVERS[method][1] + 1, "rhs")


def heyoka(scene: Any, method: str, shape: str, value: float, y0: np.ndarray) -> Any:
    import heyoka

    from contactbench.peers.heyoka import taylor_system

    width = heyoka.recommended_simd_size()
    ta = heyoka.taylor_adaptive_batch(taylor_system(scene, (), heyoka), np.zeros((len(y0), width)), tol=value)
    filled = np.pad(y0, ((0, 0), (0, -y0.shape[1] % width)), mode="edge")
    most = [0]

    def run() -> np.ndarray:
        y = np.empty_like(filled)
        most[0] = 0
        for k in range(0, y.shape[1], width):
            ta.set_time(0.0)
            ta.state[:] = filled[:, k : k + width]
            ta.propagate_until(scene.t_end)
            most[0] = max(most[0], *(steps for *_, steps in ta.propagate_res))
            y[:, k : k + width] = ta.state
        return y[:, : y0.shape[1]]

    return run, lambda: (most[0], most[0] * (ta.order + 1), "taylor")


def compiled_loop(scene: Any, method: str, shape: str, value: float, y0: np.ndarray) -> Any:
    """CyRK or CVODE's C library, one trajectory after the other, without leaving compiled code."""
    run = cb.prepare(scene, method, rtol=value, carry=(), save_at=[scene.t_end])
    if isinstance(run, Refused):
        return run.why
    starts, most = np.ascontiguousarray(y0.T), [0, 0]

    def loop() -> np.ndarray:
        told = run.many(starts)
        most[:] = told[:, 3:5].max(axis=0).astype(int)
        return told[:, -len(y0) :].T

    return loop, lambda: (*most, "rhs")


def limit_c(scene: Any, method: str, shape: str, value: float, y0: np.ndarray) -> Any:
    kernel, _, shape = shape.partition(" ")
    made = ensemble_kernel(kernel, shape, scene, value, y0)
    if isinstance(made, str):
        return made
    run, evaluations, steps = made
    return run, lambda: (steps, evaluations, "gradient")


def prepared(scene: Any, method: str, engine: str, shape: str, value: float, y0: np.ndarray) -> Any:
    """(run, costs) of a cell, or why it cannot be run."""
    if method in cb.METHODS and not cb.METHODS[method].adaptive:
        return contact(scene, method, engine, value, y0)
    if shape == "loop":
        return compiled_loop(scene, method, shape, value, y0)
    return {"c": limit_c, "llvm": heyoka, "jax": diffrax}[engine](scene, method, shape, value, y0)
