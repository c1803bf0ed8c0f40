"""diffrax's adaptive Runge–Kutta methods, compiled by JAX.

Kidger, On Neural Differential Equations, Oxford 2021, arXiv:2202.02435.  64-bit; tolerances,
parameters and the budget of steps are traced (one program for all of them), `throw=False` with the result code read.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from contactbench.methods.base import METHODS, ROUNDING, SHORTEST, Adaptive
from contactbench.methods.jax_engine import CompiledRun
from contactbench.methods.prepared import Outcome, Prepared, Request
from contactbench.scene import Scene
from contactbench.solution import Counts, Status


def mark() -> None:
    """What marks an evaluation in a program that is counted."""


@dataclass
class DiffraxRun(CompiledRun):
    method_: DiffraxMethod

    sensitivity_source = "forward-mode AD, accepted steps frozen"
    #: one program for two saved times and for 1024: it takes up to 50 µs longer than one for 64 (measured), and
    #: a program takes seconds to compile
    capacities = (1, 1024)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.final_only = len(self.request.save_at) == 1
        self.compile(self.flat(self._solve_and_count), self.arguments())

    def arguments(self) -> np.ndarray:
        r = self.request
        return self.together(r.scene.numbers(), [r.rtol, r.atol, r.max_steps], self.times())

    def key(self) -> tuple[Any, ...]:
        return (self.method_, self.capacity)

    def states(self, y0: Any, fixed: Any) -> Any:
        return self._solve(y0, fixed)[0]

    def _solve_and_count(self, y0: Any, fixed: Any) -> Any:
        """As `_solve`; of an implicit method the facts have the evaluations too.

        diffrax does not report its Newton iterations.  To count them costs a program nothing: measured on
        eleven scenes, the same bits, in 0.78 to 1.01 of the time.
        """
        if not self.method_.stiff:
            return self._solve(y0, fixed)
        from contactbench.peers.counting import count_callbacks
        from contactbench.xla import jnp

        (y, info, last), evaluations = count_callbacks(partial(self._solve, marked=True), y0, fixed)
        return y, jnp.append(info, evaluations), last

    def _solve(self, y0: Any, fixed: Any, marked: bool = False) -> Any:
        import diffrax

        from contactbench.peers.diffrax_budget import Budgeted
        from contactbench.xla import jax, jnp

        numbers, (rtol, atol, max_steps), times = self.apart(fixed)
        r = self.request
        scene = r.scene.with_numbers(list(numbers))

        # Measured: one array through the linear algebra of the implicit methods (and it compiles in half the
        # time), and through explicit stages where there are more than three components, 1.1 to 1.4 times as
        # fast; a tuple of scalars for two components, 1.1 times as fast; equal for three.
        start = 0.0 if scene.clock is None else y0[scene.clock]
        y = scene.without_clock(list(y0))
        as_array = self.method_.stiff or len(y) > 3

        def field(t: Any, x: Any, args: Any) -> Any:
            if marked:
                jax.debug.callback(mark)
            slopes = scene.slopes(start + t, list(x), r.carry)
            return jnp.stack(slopes) if as_array else tuple(slopes)

        # recorded once: diffrax calls it at a dozen places of an implicit step, and traces it anew at each
        term = diffrax.ODETerm(jax.jit(field, inline=True))
        grid = [diffrax.SubSaveAt(t1=True), diffrax.SubSaveAt(ts=times)]
        pid = diffrax.PIDController(rtol=rtol, atol=atol, dtmin=SHORTEST * times[-1], force_dtmin=False)
        solution = diffrax.diffeqsolve(
            term,
            self.method_.solver(rtol, atol),
            0.0,
            times[-1],
            None,
            jnp.stack(y) if as_array else tuple(y),
            saveat=diffrax.SaveAt(t1=True) if self.final_only else diffrax.SaveAt(subs=grid),
            stepsize_controller=Budgeted(pid, max_steps, times[-1]),
            max_steps=None,
            adjoint=diffrax.ForwardMode(),
            throw=False,
        )
        stats, results = solution.stats, diffrax.RESULTS
        info = jnp.array(
            [
                stats["num_accepted_steps"],
                stats["num_rejected_steps"],
                solution.result == results.successful,
                solution.result == results.max_steps_reached,
                solution.result == results.dt_min_reached,
                (solution.ts if self.final_only else solution.ts[0])[0],
            ]
        )

        def packed(y: Any, t: Any) -> Any:
            components = list(y.T) if as_array else list(y)
            return jnp.stack(scene.with_clock(components, start + t), axis=-1)

        if self.final_only:
            end = packed(solution.ys, times[-1:])
            return end, info, end[0]
        return packed(solution.ys[1], times), info, packed(solution.ys[0], times[-1:])[0]

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return self.call(y0)[-len(y0) :]

    def integrate(self, y0: np.ndarray) -> Outcome:
        r = self.request
        y, info, last = self.unflat(self.call(y0), len(y0))
        accepted, rejected, successful, exhausted, collapsed, time, *counted = info
        accepted, rejected = int(accepted), int(rejected)
        evaluations = int(counted[0]) if counted else self.method_.evaluations(accepted, rejected)
        counts = Counts(accepted, evaluations, 0, rejected)
        if successful:
            return self.finish(y0, y, counts)
        # Unsuccessful runs may still hold a finite state at the wrong time: keep only what was
        # saved before the end (saved times not reached are inf or nan).
        reached = 0 if self.final_only else int(np.argmin(np.append(np.isfinite(y).all(axis=1), False)))
        status = Status.budget if exhausted else Status.failed
        why = "step below the resolution of time" if collapsed else "the nonlinear solve failed"
        message = f"max_steps = {r.max_steps} spent" if exhausted else f"diffrax: {why} (t = {time:.6g})"
        return self.finish(y0, y[:reached], counts, status, message, (time, np.array(last)))


@dataclass(frozen=True)
class DiffraxMethod(Adaptive):
    """stages : right-hand sides per attempted step (all are first-same-as-last)."""

    name: str
    solver_name: str
    order: int
    stages: int
    about: str
    stiff: bool = False
    engines: tuple[str, ...] = ("jax",)
    own_time: bool = True
    rtol_range: tuple[float, float] = (ROUNDING, 1e-1)

    def solver(self, rtol: Any, atol: Any) -> Any:
        import diffrax
        import optimistix

        if not self.stiff:
            return getattr(diffrax, self.solver_name)()
        # The default, VeryChord, has one linearisation per step and a convergence criterion that
        # tight tolerances rarely meet: half of all steps are rejected and each is four times too
        # short.  Chord linearises at every stage and follows the error control.
        finder: Any = optimistix.Chord(rtol=rtol, atol=atol)
        return getattr(diffrax, self.solver_name)(root_finder=finder)

    def evaluations(self, accepted: int, rejected: int) -> int:
        """Right-hand sides of an explicit method: stages per attempt, and the very first slope."""
        return (accepted + rejected) * self.stages + 1

    def step_cost(self, scene: Scene, engine: str) -> float | None:
        """An implicit step compiled by XLA takes about as long as two right-hand sides in Python."""
        return 2 if self.stiff else None

    def prepare(self, request: Request) -> Prepared:
        return DiffraxRun(self.name, request, self)


METHODS.add(DiffraxMethod("diffrax-tsit5", "Tsit5", 5, 6, "Tsitouras 5(4), explicit"))
METHODS.add(DiffraxMethod("diffrax-dopri8", "Dopri8", 8, 13, "Dormand–Prince 8(7), explicit"))
METHODS.add(DiffraxMethod("diffrax-kvaerno5", "Kvaerno5", 5, 6, "Kvaerno 5(4), implicit, Chord", stiff=True))
