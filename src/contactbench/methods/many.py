"""Fixed steps on scenes of many sites: compiled sweeps, and arrays."""

from __future__ import annotations

import math
import os
from contextlib import nullcontext, suppress
from functools import cache, cached_property
from threading import Lock
from typing import Any

import numpy as np

from contactbench.methods.fixed_step_run import FixedStepRun, Loop, is_fixed
from contactbench.methods.jax_engine import JaxLoop
from contactbench.methods.prepared import NO_NUMBER, stopwatch
from contactbench.numbers.dual import Dual, DualNumbers, slope, value
from contactbench.scene import State
from contactbench.scene.cache import Cache, key
from contactbench.trace.compiled import require_compiler
from contactbench.trace.fields import FieldProgram, record_fields
from contactbench.trace.python import execute
from contactbench.trace.sweeps import CHUNK, PAD, compile_sweeps

#: sites from which on all cores share a sweep
SHARED = 50_000
#: held by the run whose threads wait for one another: those of two runs would wait for ever
TOGETHER = Lock()

def slopes_program(scene: Any, carry: tuple[str, ...]) -> FieldProgram:
    """The recorded right-hand side."""
    d, with_s, names = scene.dimensions, "s" in carry, tuple(scene.constants)

    def slopes(numbers: Any, h: Any, n: Any, f: Any, s: Any, constants: Any, xp: Any, repeat: Any) -> Any:
        twin = scene.with_numbers(numbers)._replaced(**dict(zip(names, constants, strict=True)))
        x = twin.rhs(State(tuple(f[:d]), tuple(f[d:]), s[0] if with_s else None))
        return [*x.q, *x.p, *([x.s] if with_s else [])]

    return record_fields(slopes, len(scene.numbers()), 2 * d, int(with_s), len(names))


_loops: Cache[FieldLoop] = Cache(256)


def field_program(method: Any, scene: Any, carry: tuple[str, ...], tangent: bool = False) -> FieldProgram:
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


@cache
def others(count: int) -> Any:
    """Threads beside this one."""
    from concurrent.futures import ThreadPoolExecutor

    return ThreadPoolExecutor(count, thread_name_prefix="sweep")


os.register_at_fork(after_in_child=others.cache_clear)


def threads_for(sites: int) -> int:
    """How many threads share the sweeps: those numba is to use, for large scenes."""
    if sites < SHARED:
        return 1
    from numba import get_num_threads

    return int(get_num_threads())


class FieldLoop(Loop):
    """A recorded loop on fields: one for all numbers of sites of a boundary."""

    program: Any

    def __init__(self, program: FieldProgram, boundary: str, seconds: float) -> None:
        super().__init__(program, seconds)  # type: ignore[arg-type]
        self.boundary = boundary

    @cached_property
    def run(self) -> Any:
        elapsed = stopwatch()
        run = compile_sweeps(self.program.run, self.boundary, self.program.sums)
        self.seconds += elapsed()
        return run

    @cached_property
    def in_python(self) -> tuple[Any, Any]:
        return execute(self.program.setup), None

    def paths(self, scene: Any, carry: tuple[str, ...], numbers: np.ndarray, y: np.ndarray, h: Any, n: Any) -> np.ndarray:
        """Packed states after each interval, (k, m, size), of a state and maybe its tangent, (m, size)."""
        sites, d, m = scene.sites, scene.dimensions, len(y)
        known, given, half = len(self.program.shape), 2 * d * m, scene.sites * d
        arrays = self.arrays(scene, numbers, given, h, n)
        fields, shape, kept = (arrays[name] for name in ("fields", "shape", "kept"))
        inside = fields[:, PAD:-PAD]
        out = np.empty((len(n), *y.shape))
        for k in range(len(n)):
            # field by field: the components of q and p of the state, then those of its tangent
            inside[:given] = y[:, : 2 * half].reshape(2 * m, sites, d).swapaxes(1, 2).reshape(given, sites)
            self.fill_ends(fields[:given])
            scalars = y[:, -1].copy()
            row = np.append(shape[:known], shape[known + k])
            self.share(sites, scalars, arrays["w"], row, fields, arrays["sums"], kept)
            y = out[k]
            for i, row in enumerate(kept.astype(int)):
                j, c = divmod(i, d)  # the j-th block of q or p, and the component
                y[j // 2, (j % 2) * half + c : (j % 2 + 1) * half : d] = inside[row]
            if "s" in carry:
                y[:, -1] = scalars
        return out

    def arrays(
        self, scene: Any, numbers: np.ndarray, given: int, h: Any = (0.0,), n: Any = (1,)
    ) -> dict[str, np.ndarray]:
        """The arrays that `run` works on, by name; fields holds the scene's constants after `given` rows."""
        program, sites, constants = self.program, scene.sites, scene.constants.values()
        w, shape = self.rows(numbers, np.asarray(h, dtype=float), np.asarray(n))
        fields = np.zeros((program.rows, sites + 2 * PAD))
        for row, constant in zip(fields[given:, PAD:-PAD], constants, strict=False):
            row[:] = constant
        self.fill_ends(fields[given : given + len(constants)])
        sums = np.zeros((max(1, program.sums), -(-sites // CHUNK)))
        found = {"w": w, "shape": shape.astype(np.int64), "fields": fields, "sums": sums}
        return found | {"kept": np.zeros(given), "scalars": np.zeros(1)}

    def fill_ends(self, rows: np.ndarray) -> None:
        """The neighbours beyond the ends."""
        if self.boundary != "fixed":
            low, high = (-PAD - 1, PAD) if self.boundary == "ring" else (PAD, -PAD - 1)
            rows[:, PAD - 1], rows[:, -PAD] = rows[:, low], rows[:, high]

    def share(self, sites: int, scalars: np.ndarray, *arguments: Any) -> None:
        """Run in as many threads as are worth it; each has scalars and a list of rows of its own, all equal."""
        threads, sync, (*shared, kept) = threads_for(sites), np.zeros(1, dtype=np.int64), arguments
        parts = [np.array([rank, threads]) for rank in range(threads)]
        with TOGETHER if threads > 1 else nullcontext():
            waiting = [
                others(threads - 1).submit(self.run, scalars.copy(), *shared, kept.copy(), part, sync)
                for part in parts[1:]
            ]
            self.run(scalars, *shared, kept, parts[0], sync)
            for each in waiting:
                each.result()


def loop_of(method: Any, scene: Any, carry: tuple[str, ...], tangent: bool = False) -> FieldLoop:
    """The loop of a method; `CannotRecord`, also where numba is told not to compile."""
    require_compiler()

    def make() -> FieldLoop:
        elapsed = stopwatch()
        program = field_program(method, scene, carry, tangent)
        return FieldLoop(program, scene.boundary, elapsed())

    known = (method, scene.equations) if is_fixed(method) and scene.identity is not None else None
    return _loops.get(key(known, carry, tangent), make)


class SweepLoop(FixedStepRun):
    """Sweeps over the sites, compiled by LLVM."""

    sensitivity_source = "forward-mode AD through the numerical map"

    def __post_init__(self) -> None:
        self.loop = loop_of(self.method_, self.request.scene, self.request.carry)
        self.loop.run  # noqa: B018, compiled now
        self.compile_s = self.loop.seconds
        super().__post_init__()

    @cached_property
    def tangent_loop(self) -> FieldLoop:  # type: ignore[override]
        return loop_of(self.method_, self.request.scene, self.request.carry, tangent=True)

    def paths(self, loop: FieldLoop, y: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        return loop.paths(self.request.scene, self.request.carry, self.numbers, y, h, n)

    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        return self.paths(self.loop, y0[None], h, n)[:, 0]

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return self.intervals(y0, self.h, self.n)[-1]

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        tangents = self.tangents(y0)
        columns = [self.paths(self.tangent_loop, np.stack([y0, v]), self.h, self.n)[:, 1] for v in tangents]
        return self.from_start(np.array(tangents).T, np.stack(columns, axis=-1))


class ArrayLoop(SweepLoop):
    """The step map on NumPy's arrays."""

    sensitivity_source = "forward-mode AD through the same steps, compiled"

    def __post_init__(self) -> None:
        FixedStepRun.__post_init__(self)

    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        r, out = self.request, np.full((len(n), len(y0)), math.nan)
        x = r.scene.unpack(y0, r.carry)
        with suppress(*NO_NUMBER), np.errstate(all="ignore"):
            for k, (step, count) in enumerate(zip(h.tolist(), n.tolist(), strict=True)):
                x = self.method_.advance(r.scene, x, step, count, math)
                out[k] = r.scene.pack(x)
        return out


MANY_RUNS: dict[str, type[FixedStepRun]] = {"numba": SweepLoop, "jax": JaxLoop, "python": ArrayLoop}
