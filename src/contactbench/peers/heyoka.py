"""heyoka's adaptive Taylor method, compiled by LLVM: the strongest non-stiff peer that pip installs.

Biscani, Izzo, Mon. Not. R. Astron. Soc. 504, 2614 (2021), doi:10.1093/mnras/stab1032.
The scene's numbers are written into the program as constants: measured, 6 to 22 % faster than heyoka's
runtime parameters on every standard scene.  The Taylor order follows from the tolerance.  So every
tolerance and every set of numbers is a program of its own.
"""

from __future__ import annotations

import importlib.util
from copy import copy
from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np

from contactbench.methods.base import METHODS, ROUNDING, Adaptive
from contactbench.methods.prepared import Outcome, Prepared, Request, stopwatch
from contactbench.numbers.series import NO_SERIES, Series, SeriesNumbers, bare
from contactbench.peers.variational import SOURCE, run_variational, variational_request
from contactbench.scene import Scene
from contactbench.scene.cache import Cache, key
from contactbench.solution import Counts, Status


def taylor_system(scene: Scene, carry: tuple[str, ...], heyoka: Any) -> list[tuple[Any, Any]]:
    """The scene's equations as heyoka expressions, its numbers as constants."""
    names = scene.without_clock(scene.labels(carry))
    variables = heyoka.make_vars(*(f"y{i}" for i in range(len(names))))
    variables = variables if isinstance(variables, list) else [variables]
    slopes = map(bare, scene.slopes(Series(heyoka.time), [Series(v) for v in variables], carry))
    return [
        (v, heyoka.expression(s) if isinstance(s, float) else s)
        for v, s in zip(variables, slopes, strict=True)
    ]


def symbolic_derivative(scene: Scene, x: Any) -> list[list[Any]]:
    """Df on heyoka expressions: the scene's own Jacobian, or heyoka's derivatives of its right-hand side."""
    if scene.has_jacobian:
        return scene.jacobian(x)
    variables = scene.pack(x)

    def row(slope: Any) -> list[Any]:
        """Tangents do not move the time: its derivative is not asked for."""
        return [0.0 if i == scene.clock else SeriesNumbers().diff(slope, c) for i, c in enumerate(variables)]

    return [row(slope) for slope in scene.pack(scene.rhs(x))]


#: above this many equations heyoka's default, all formulas written out, takes seconds to compile
UNROLLED = 20

#: one program per identity, numbers and tolerance, a megabyte or two each; a run has a copy of its own, with a
#: state of its own
_integrators: Cache[tuple[Any, float]] = Cache(32)


@dataclass
class TaylorRun(Prepared):
    sensitivity_source = SOURCE

    def __post_init__(self) -> None:
        import heyoka

        super().__post_init__()
        r = self.request

        def make() -> tuple[Any, float]:
            elapsed = stopwatch()
            system = taylor_system(r.scene, r.carry, heyoka)
            _, start = self.split_clock(self.start)
            compact = len(self.start) > UNROLLED
            return heyoka.taylor_adaptive(system, start, tol=r.rtol, compact_mode=compact), elapsed()

        numbers = tuple(r.scene.numbers())
        program, self.compile_s = _integrators.get(key(r.scene.identity, numbers, r.carry, r.rtol), make)
        self.integrator = copy(program)
        #: where a packed state has what is integrated: all of it, but the time
        size, clock = len(self.start), self._clock
        self.motion: Any = slice(clock) if clock == size - 1 else [i for i in range(size) if i != clock]
        self.alone = Lock()  # one state: calls from several threads take turns
        self.outcomes = heyoka.taylor_outcome
        self.end, self.per_step = float(r.save_at[-1]), program.order + 1

    def bare(self, y0: np.ndarray) -> np.ndarray:
        """The time in a packed state is set and read in place: `split_clock` takes a third of a short run."""
        ta, c, steps = self.integrator, self._clock, self.request.max_steps
        if c is None:
            ta.time = 0.0
            ta.state[:] = y0
            ta.propagate_until(self.end, max_steps=steps)
            return ta.state.copy()
        y, state, start = y0.copy(), ta.state, y0.item(c)
        ta.time = start
        state[:] = y0[self.motion]
        ta.propagate_until(start + self.end, max_steps=steps)
        y[self.motion], y[c] = state, start + self.end
        return y

    def integrate(self, y0: np.ndarray) -> Outcome:
        with self.alone:
            return self._integrate(y0)

    def _integrate(self, y0: np.ndarray) -> Outcome:
        r, ta = self.request, self.integrator
        ta.time, ta.state[:] = self.split_clock(y0)
        origin = ta.time
        if len(r.save_at) == 1:
            outcome, _, _, steps, *_ = ta.propagate_until(origin + self.end, max_steps=r.max_steps)
            y = self.insert_clock(ta.state, origin, self.end).copy()
            if outcome == self.outcomes.time_limit:
                counts = Counts(steps, steps * self.per_step, 0, 0, "taylor")
                return self.finish(y0, y[None], counts)
            y = y[None][:0]
        else:
            start = r.save_at[0] == 0
            grid = r.save_at if start else np.concatenate([[0.0], r.save_at])
            outcome, _, _, steps, *_, y = ta.propagate_grid(origin + grid, max_steps=r.max_steps)
            y = self.insert_clock(y, origin, grid[: len(y)])
            y = y[: len(grid)] if start else y[1:]
        counts = Counts(steps, steps * self.per_step, 0, 0, "taylor")
        # of a grid that takes exactly so many steps heyoka says that they are spent
        if outcome == self.outcomes.time_limit or len(y) == len(r.save_at):
            return self.finish(y0, y, counts)
        stopped = (float(ta.time) - origin, ta.state.copy())
        if outcome == self.outcomes.step_limit:
            return self.finish(y0, y, counts, Status.budget, f"max_steps = {r.max_steps} spent", stopped)
        message = f"{outcome.name} at t = {stopped[0]:.6g}"
        if not ta.time > origin:  # a function without a series at the start: no failure of the motion
            message += f"; {NO_SERIES}"
            return self.finish(y0, y[:0], counts, Status.failed, message)
        status = Status.diverged if outcome == self.outcomes.err_nf_state else Status.failed
        return self.finish(y0, y, counts, status, message, stopped)

    def linearised(self, y0: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return run_variational(
            TaylorRun(self.method, variational_request(self.request, symbolic_derivative)), y0
        )


@dataclass(frozen=True)
class TaylorMethod(Adaptive):
    name: str = "heyoka-taylor"
    about: str = "adaptive Taylor series, LLVM-compiled; order grows with −log(rtol)"
    order: int | None = None
    engines: tuple[str, ...] = ("llvm",)
    own_time: bool = True
    rtol_range: tuple[float, float] = (ROUNDING, 1e-1)
    takes_atol: bool = False

    def refuses(self, scene: Scene) -> str | None:
        if importlib.util.find_spec("heyoka") is None:
            return "heyoka is not installed (pip install contactbench[bench])"
        return None

    def prepare(self, request: Request) -> Prepared:
        return TaylorRun(self.name, request)


METHODS.add(TaylorMethod())
