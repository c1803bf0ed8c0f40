"""Fixed steps on scenes of many sites: compiled sweeps, and arrays."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.jax_engine import JaxLoop
from contactbench.methods.numba_engine import Loop
from contactbench.methods.prepared import stopwatch
from contactbench.methods.request import NO_NUMBER
from contactbench.methods.step_map import StepMap, is_fixed, trajectory
from contactbench.numbers.dual import Dual, DualNumbers, slope, value
from contactbench.scene import State
from contactbench.scene.cache import Cache, key
from contactbench.scene.many import Many
from contactbench.trace.fields import FieldProgram, record_fields
from contactbench.trace.sweeps import CHUNK, PAD, compile_sweeps

#: sites from which on all cores share a sweep
SHARED = 50_000

_loops: Cache[Loop] = Cache(256)


def field_program(method: StepMap, scene: Any, carry: tuple[str, ...], tangent: bool = False) -> FieldProgram:
    """The recorded loop of a method; tangent : every field and number is followed by its derivative.

    Raises `CannotRecord`.
    """
    d, with_s = scene.dimensions, "s" in carry
    names = tuple(scene.constants)

    def advance(numbers: Any, h: Any, n: Any, f: Any, s: Any, constants: Any, xp: Any, repeat: Any) -> Any:
        if tangent:
            f, s = list(map(Dual, f[: 2 * d], f[2 * d :])), [Dual(*s)] if with_s else []
            xp = DualNumbers(xp)
        twin = scene.with_numbers(numbers)._replaced(**dict(zip(names, constants, strict=True)))
        x = State(tuple(f[:d]), tuple(f[d:]), s[0] if with_s else None)
        x = method.advance(twin, x, h, n, xp, repeat)
        fields, rest = [*x.q, *x.p], [x.s] if with_s else []
        if not tangent:
            return [*fields, *rest]
        return [*map(value, fields), *map(slope, fields), *map(value, rest), *map(slope, rest)]

    twice = 1 + tangent
    return record_fields(advance, len(scene.numbers()), 2 * d * twice, with_s * twice, len(names))


def loop_of(method: StepMap, scene: Any, carry: tuple[str, ...], tangent: bool = False) -> Loop:
    """The loop, compiled: one for all sizes."""

    def make() -> Loop:
        elapsed = stopwatch()
        program: Any = field_program(method, scene, carry, tangent)
        boundary = getattr(scene, "boundary", "free")
        return Loop(program, compile_sweeps(program.run, boundary, program.sums), elapsed())

    known = is_fixed(method) and scene.identity is not None
    return _loops.get(key((method, scene.equations) if known else None, carry, tangent), make)


@cache
def others(count: int) -> ThreadPoolExecutor:
    """Threads beside this one."""
    return ThreadPoolExecutor(count, thread_name_prefix="sweep")


def threads_for(sites: int) -> int:
    """How many threads share the sweeps: those numba is to use, for large scenes."""
    if sites < SHARED:
        return 1
    from numba import get_num_threads

    return int(get_num_threads())


@dataclass
class SweepLoop(FixedStepRun):
    """Sweeps over the sites, compiled by LLVM."""

    sensitivity_source = "forward-mode AD through the numerical map"

    def __post_init__(self) -> None:
        r = self.request
        scene: Any = r.scene
        self.scene: Many = scene
        self.loop = loop_of(self.method_, scene, r.carry)
        self.compile_s = self.loop.seconds
        self.numbers = np.array(scene.numbers())
        super().__post_init__()

    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        return self.states(self.loop, y0[:, None], h, n)[..., 0]

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return self.intervals(y0, self.h, self.n)[-1]

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        r = self.request
        loop, tangents = loop_of(self.method_, r.scene, r.carry, True), self.tangents(y0)
        runs = [self.states(loop, np.stack([y0, v], axis=1), self.h, self.n)[..., 1] for v in tangents]
        derivative = np.stack(runs, axis=-1)
        if not self.saves_start:
            return derivative
        return np.concatenate([np.array(tangents).T[None], derivative])

    def states(self, loop: Loop, start: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        """Packed states after each interval, (k, size, m), from m of them, a state and maybe a tangent, (size, m)."""
        scene, program = self.scene, loop.program
        N, d, m = scene.sites, scene.dimensions, start.shape[1]
        rows, shape = loop.rows(self.numbers, h, n)
        which, shape = shape[len(program.shape) :], shape[: len(program.shape)]
        fields = np.zeros((program.rows, N + 2 * PAD))  # type: ignore[attr-defined]
        given = 2 * d * m
        for row, constant in zip(fields[given:], scene.constants.values(), strict=False):
            row[PAD:-PAD] = constant
        self.fill_ends(fields[given : given + len(scene.constants)])
        sums = np.empty((max(1, program.sums), -(-N // CHUNK)))  # type: ignore[attr-defined]
        kept, half = np.zeros(given), N * d
        out = np.empty((len(n), *start.shape))
        y = start
        for k in range(len(n)):
            columns = [y[i * half : (i + 1) * half, j].reshape(N, d) for j in range(m) for i in (0, 1)]
            for row, column in zip(fields, (c[:, i] for c in columns for i in range(d)), strict=False):
                row[PAD:-PAD] = column
            self.fill_ends(fields[:given])
            scalars = np.array(y[-1]) if "s" in self.request.carry else np.zeros(m)
            self.call(loop.run, scalars, rows, np.append(shape, which[k]), fields, sums, kept)
            y = out[k]
            ends = [fields[int(row), PAD:-PAD] for row in kept]
            for j in range(m):
                for i in (0, 1):
                    block = y[i * half : (i + 1) * half, j].reshape(N, d)
                    for c in range(d):
                        block[:, c] = ends[(2 * j + i) * d + c]
            if "s" in self.request.carry:
                y[-1] = scalars
        return out

    def fill_ends(self, rows: np.ndarray) -> None:
        """The neighbours beyond the ends."""
        boundary = getattr(self.scene, "boundary", "free")
        if boundary == "ring":
            rows[:, PAD - 1], rows[:, -PAD] = rows[:, -PAD - 1], rows[:, PAD]
        elif boundary == "free":
            rows[:, PAD - 1], rows[:, -PAD] = rows[:, PAD], rows[:, -PAD - 1]

    def call(self, run: Any, scalars: np.ndarray, *arguments: Any) -> None:
        """Advance by one interval, in as many threads as are worth it; each has numbers of its own, all equal."""
        threads, sync = threads_for(self.scene.sites), np.zeros(1, dtype=np.int64)
        *shared, kept = arguments
        part = np.array([0, threads])
        waiting = [
            others(threads - 1).submit(
                run, scalars.copy(), *shared, kept.copy(), np.array([rank, threads]), sync
            )
            for rank in range(1, threads)
        ]
        run(scalars, *shared, kept, part, sync)
        for each in waiting:
            each.result()


class ArrayLoop(FixedStepRun):
    """The step map on NumPy's arrays."""

    sensitivity_source = "forward-mode AD through the same steps, compiled"

    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        r, out = self.request, np.full((len(n), len(y0)), math.nan)
        spans = zip(h.tolist(), n.tolist(), strict=True)
        with suppress(*NO_NUMBER), np.errstate(all="ignore"):
            x = r.scene.unpack(y0, r.carry)
            for k, state in enumerate(trajectory(self.method_, r.scene, x, spans, math)):
                out[k] = r.scene.pack(state)
        return out

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        return SweepLoop(self.method, self.request, self.method_).sensitivity(y0)


MANY_ENGINES: dict[str, type[FixedStepRun]] = {"numba": SweepLoop, "jax": JaxLoop, "python": ArrayLoop}
