"""heyoka's adaptive Taylor method, compiled by LLVM: the strongest non-stiff peer that pip installs.

Biscani, Izzo, Mon. Not. R. Astron. Soc. 504, 2614 (2021), doi:10.1093/mnras/stab1032.
A step is as long as its last two coefficients allow, as if the rest fell geometrically.  It does not where a force
grows exponentially ahead: far from a steep wall, e^{50(q − 1)}, order 12 (rtol 1e-9) has terms that still rise, and the
first step ends inside the wall, with an error of 1e-3.  A tighter rtol, which is a higher order, sees it.

The scene's numbers are written into the program as constants: measured, 6 to 22 % faster than heyoka's
runtime parameters on every standard scene.  The Taylor order follows from the tolerance.  So every
tolerance and every set of numbers is a program of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from threading import Lock
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from contactbench.methods.base import METHODS, ROUNDING
from contactbench.methods.prepared import Request, stopwatch
from contactbench.numbers.series import NO_SERIES, Series, expression_of
from contactbench.peers.base import Call, Ending, Peer
from contactbench.scene import Cache, Scene, key
from contactbench.solution import Counts, Status

if TYPE_CHECKING:
    import heyoka


def taylor_system(
    scene: Scene,
    carry: tuple[str, ...],
    heyoka: ModuleType,
    units: Sequence[float] | None = None,
    origin: int | None = None,
) -> list[tuple[object, object]]:
    """Return the equations, each component in its own unit; origin : the number of the parameter that is the start."""
    names = scene.without_clock(scene.labels(carry))
    variables = heyoka.make_vars(*(f"y{i}" for i in range(len(names))))
    variables = variables if isinstance(variables, list) else [variables]
    units = [1.0] * len(names) if units is None else units
    series: list[Any] = [Series(v) for v in variables]
    given = [y if unit == 1 else y * unit for y, unit in zip(series, units, strict=True)]
    time: Any = Series(heyoka.time)
    if origin is not None and scene.clock is not None:
        time = time + Series(heyoka.par[origin])
    slopes = map(expression_of, scene.slopes(time, given, carry))
    expressions = (heyoka.expression(s) if isinstance(s, float) else s for s in slopes)
    own = (s if unit == 1 else s / unit for s, unit in zip(expressions, units, strict=True))
    return list(zip(variables, own, strict=True))


#: above this many equations heyoka's default, all formulas written out, takes seconds to compile
UNROLLED = 20

#: steps between two checks for signals, about 0.01 s
PIECE = 10**4

#: one program per identity, numbers and tolerance, a megabyte or two each; a run has a copy of its own, with a
#: state of its own
_integrators: Cache[tuple[heyoka.taylor_adaptive, float]] = Cache(32)


def is_fast(scene: object) -> bool:
    """Return whether heyoka may reorder operations: up to a quarter faster, but for bodies up to 9 % slower."""
    return getattr(scene, "canonical", False)


class Taylor(Call):
    """A run of heyoka; shared : the scene's numbers are its runtime parameters, one program runs all scenes alike."""

    def __init__(self, method: Peer, request: Request, shared: bool = False) -> None:
        import heyoka

        super().__init__(method, request)
        r, size = request, len(request.start)
        scene = r.scene

        _, y0 = self.split_clock(r.start)
        scaled = np.ndim(r.scales) > 0
        units = np.array(r.scales) if scaled else np.ones(len(y0))
        #: units of the integrator's numbers; None if all are 1
        self.units = units if scaled else None
        numbers = scene.numbers()
        self.origin = len(numbers) if shared else 0

        def make() -> tuple[heyoka.taylor_adaptive, float]:
            elapsed = stopwatch()
            pars: list[Any] = [Series(heyoka.par[i]) for i in range(len(numbers))]
            alike = scene.with_numbers(pars) if shared else scene
            system = taylor_system(alike, r.carry, heyoka, units.tolist(), self.origin)
            how = {"compact_mode": size > UNROLLED, "fast_math": is_fast(scene)}
            return heyoka.taylor_adaptive(system, y0 / units, tol=r.rtol, **how), elapsed()

        given = (*(() if shared else numbers), *units), r.carry, r.rtol, shared
        program, self.seconds = _integrators.get(key(scene.recorded().identity, *given), make)
        self.integrator = copy(program)
        if shared:
            known = min(len(numbers), len(program.pars))
            self.integrator.pars[:known] = numbers[:known]
        #: places of the integrated components in a packed state: all but the time
        self.motion: slice | list[int] = slice(self.clock)
        if self.clock is not None and self.clock < size - 1:
            self.motion = [i for i in range(size) if i != self.clock]
        self.alone = Lock()  # one state: calls from several threads take turns
        self.outcomes, self.per_step = heyoka.taylor_outcome, program.order + 1

    def set(self, y0: np.ndarray) -> float:
        """Put the integrator to a packed state, in place: `split_clock` takes a third of a short run."""
        start = 0.0 if self.clock is None else y0.item(self.clock)
        self.integrator.time = 0.0
        if self.clock is not None and len(self.integrator.pars) > self.origin:
            self.integrator.pars[self.origin] = start
        self.integrator.state[:] = y0[self.motion] if self.units is None else y0[self.motion] / self.units
        return start

    def last(self, y0: np.ndarray) -> np.ndarray:
        ta, y, start = self.integrator, y0.copy(), self.set(y0)
        ta.propagate_until(self.end, max_steps=self.request.max_steps)
        y[self.motion] = ta.state if self.units is None else ta.state * self.units
        if self.clock is not None:
            y[self.clock] = start + self.end
        return y

    def __call__(self, y0: np.ndarray) -> Ending:
        most, ta, limit = self.request.max_steps, self.integrator, self.outcomes
        with self.alone:
            origin = self.set(y0)
            if len(self.request.save_at) == 1:
                outcome, steps = limit.step_limit, 0
                while outcome == limit.step_limit and steps < most:  # in pieces, of the same steps
                    piece = min(PIECE, most - steps)
                    outcome, _, _, taken, *_ = ta.propagate_until(self.end, max_steps=piece)
                    steps += taken
                y = ta.state[None][: outcome == limit.time_limit].copy()
            else:
                grid, piece = np.append(0.0, self.later), min(PIECE, most)
                outcome, _, _, steps, *_, y = ta.propagate_grid(grid, max_steps=piece)
                if steps == piece < most:  # once more, with a callback at every step: Python looks at signals
                    self.set(y0)
                    options = {"max_steps": most, "callback": lambda _: True}
                    outcome, _, _, steps, *_, y = ta.propagate_grid(grid, **options)
                y = y[1:]
            time, state = float(ta.time), ta.state.copy()
        if self.units is not None:
            y, state = y * self.units, state * self.units
        y = self.insert_clock(y, origin, self.later[: len(y)])
        counts = Counts(steps, steps * self.per_step, 0, 0, "taylor")
        # heyoka reports a spent budget also if the grid took exactly that many steps
        if outcome == limit.time_limit or len(y) == len(self.later):
            return Ending(y, counts)
        if outcome == limit.step_limit:
            return Ending(y, counts, Status.budget, self.spent, (time, state))
        message = f"{outcome.name} at t = {time:.6g}"
        if not time > 0:  # a function without a series at the start: no failure of the motion
            return Ending(None, counts, Status.failed, f"{message}; {NO_SERIES}")
        status = Status.diverged if outcome == limit.err_nf_state else Status.failed
        return Ending(y, counts, status, message, (time, state))


TAYLOR = METHODS.add(
    Peer(
        "heyoka-taylor",
        "adaptive Taylor series, LLVM-compiled; order grows with −log(rtol); Biscani, Izzo, doi:10.1093/mnras/stab1032",
        *(Taylor, ("llvm",), (ROUNDING, 1e-1)),
        package="heyoka",
        takes_atol=False,
    )
)
#: the same for many scenes that differ by their numbers
SHARED = replace(TAYLOR, call=partial(Taylor, shared=True))
