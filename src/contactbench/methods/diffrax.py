"""diffrax's adaptive Runge–Kutta methods, compiled by JAX.

Kidger, On Neural Differential Equations, Oxford 2021, arXiv:2202.02435.  64-bit, tolerances and
parameters traced (one program for all of them), `throw=False` with the result code read.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from contactbench.methods.base import METHODS, Adaptive, Outcome, Prepared, Request, stopwatch
from contactbench.solution import Counts, Status

_compiled: dict[Any, tuple[Any, float]] = {}


@dataclass
class DiffraxRun(Prepared):
    method_: DiffraxMethod

    def __post_init__(self) -> None:
        super().__post_init__()
        r = self.request
        self.numbers = np.array(r.scene.numbers())
        self.tolerances = np.array([r.rtol, r.atol])
        self.final_only = len(r.save_at) == 1
        self.program, self.compile_s = self._program("run", self._kernel)

    def _program(self, purpose: str, function: Any) -> tuple[Any, float]:
        import jax

        r = self.request
        key = (purpose, self.method, r.scene.structure, r.carry, len(r.save_at), r.max_steps)
        if key not in _compiled:
            elapsed = stopwatch()
            arguments = (self._own_start, self.numbers, self.tolerances, r.save_at)
            _compiled[key] = jax.jit(function).lower(*arguments).compile(), elapsed()
        return _compiled[key]

    def _kernel(
        self, y0: Any, numbers: Any, tolerances: Any, times: Any, on_rhs: Any = None
    ) -> Any:
        import diffrax
        import jax.numpy as jnp

        r = self.request
        scene = r.scene.with_numbers(list(numbers))

        def field(t: Any, x: Any, args: Any) -> Any:
            if on_rhs is not None:
                on_rhs()
            return scene.rhs(x)

        term = diffrax.ODETerm(field)
        saveat = diffrax.SaveAt(t1=True) if self.final_only else diffrax.SaveAt(ts=times)
        solution = diffrax.diffeqsolve(
            term, self.method_.solver(tolerances), 0.0, times[-1], None,
            scene.unpack(list(y0), r.carry),
            saveat=saveat,
            stepsize_controller=diffrax.PIDController(rtol=tolerances[0], atol=tolerances[1]),
            max_steps=r.max_steps,
            adjoint=diffrax.ForwardMode(),
            throw=False,
        )  # fmt: skip
        stats = solution.stats
        info = jnp.array([
            stats["num_accepted_steps"], stats["num_rejected_steps"],
            solution.result == diffrax.RESULTS.successful,
            solution.result == diffrax.RESULTS.max_steps_reached,
        ])  # fmt: skip
        return jnp.stack(scene.pack(solution.ys), axis=-1), info

    def integrate(self, y0: np.ndarray) -> Outcome:
        r = self.request
        y, info = self.program(y0, self.numbers, self.tolerances, r.save_at)
        y, (accepted, rejected, successful, exhausted) = np.asarray(y), np.asarray(info).tolist()
        counts = Counts(accepted, self.method_.evaluations(accepted, rejected), 0, rejected)
        if successful:
            return self.finished(y0, y, counts)
        # Unsuccessful runs may still hold a finite state at the wrong time: keep only what was
        # saved before the end (saved times not reached are inf or nan).
        reached = 0 if self.final_only else int(np.argmin(np.append(np.isfinite(y).all(axis=1), False)))
        status = Status.budget if exhausted else Status.failed
        message = f"max_steps = {r.max_steps} spent" if exhausted else "diffrax: the nonlinear solve failed"
        return self.finished(y0, y[:reached], counts, status, message)

    def count(self) -> Counts:
        """Counts with every right-hand side counted by a callback from inside the compiled loop."""
        import jax

        calls = [0]

        def tick() -> None:
            calls[0] += 1

        def kernel(*arguments: Any) -> Any:
            return self._kernel(*arguments, on_rhs=lambda: jax.debug.callback(tick))

        arguments = (self._own_start, self.numbers, self.tolerances, self.request.save_at)
        jax.block_until_ready(jax.jit(kernel)(*arguments))
        jax.effects_barrier()
        return self().counts._replace(evaluations=calls[0])

    sensitivity_source = "forward-mode AD, accepted steps frozen"

    def _tangent_kernel(self, y0: Any, numbers: Any, tolerances: Any, times: Any) -> Any:
        import jax
        import jax.numpy as jnp

        r = self.request
        x0 = r.scene.unpack(list(y0), r.carry)
        directions = jnp.array([r.scene.pack(v) for v in r.scene.tangents(x0)])

        def states(y: Any) -> Any:
            return self._kernel(y, numbers, tolerances, times)[0]

        return jnp.moveaxis(jax.vmap(lambda v: jax.jvp(states, (y0,), (v,))[1])(directions), 0, -1)

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        program, _ = self._program("sensitivity", self._tangent_kernel)
        return np.asarray(program(y0, self.numbers, self.tolerances, self.request.save_at))


@dataclass(frozen=True)
class DiffraxMethod(Adaptive):
    """per_step: right-hand sides per attempted step (all are first-same-as-last)."""

    name: str
    solver_name: str
    order: int
    per_step: int
    about: str
    stiff: bool = False
    engines: tuple[str, ...] = ("jax",)
    rtol_range: tuple[float, float] = (1e-14, 1e-1)

    def solver(self, tolerances: Any) -> Any:
        import diffrax
        import optimistix

        if not self.stiff:
            return getattr(diffrax, self.solver_name)()
        # The default, VeryChord, has one linearisation per step and a convergence criterion that
        # tight tolerances rarely meet: half of all steps are rejected and each is four times too
        # short.  Chord linearises at every stage and follows the error control.
        finder = optimistix.Chord(rtol=tolerances[0], atol=tolerances[1])
        return getattr(diffrax, self.solver_name)(root_finder=finder)

    def evaluations(self, accepted: int, rejected: int) -> int | None:
        """Right-hand sides of an explicit method: stages per attempt, and three to start
        (the first slope, and two by which diffrax chooses the first step)."""
        return None if self.stiff else (accepted + rejected) * self.per_step + 3

    def prepare(self, request: Request) -> Prepared:
        return DiffraxRun(self.name, request, self)


METHODS.add(DiffraxMethod("diffrax-tsit5", "Tsit5", 5, 6, "Tsitouras 5(4), explicit"))
METHODS.add(DiffraxMethod("diffrax-dopri8", "Dopri8", 8, 13, "Dormand–Prince 8(7), explicit"))
METHODS.add(DiffraxMethod("diffrax-kvaerno5", "Kvaerno5", 5, 6, "Kvaerno 5(4), implicit, Chord", stiff=True))
