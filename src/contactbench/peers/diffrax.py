"""diffrax's adaptive Runge–Kutta methods, compiled by JAX.

Kidger, On Neural Differential Equations, Oxford 2021, arXiv:2202.02435.  64-bit; tolerances,
and parameters are traced (one program for all of them), `throw=False` with the result code read.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from contactbench.methods.base import METHODS, ROUNDING, SHORTEST
from contactbench.methods.prepared import Request, stopwatch
from contactbench.peers.base import Call, Ending, Peer
from contactbench.scene import Cache, key
from contactbench.solution import Counts, Status
from contactbench.trace.recording import reason_of
from contactbench.xla import doubles, jax, jnp

if TYPE_CHECKING:
    from jax.stages import Compiled

#: numbers of saved times that programs are compiled for; a run uses the next larger one, which takes up to 50 µs more
#: (measured) but saves seconds of compilation
CAPACITIES = (1, 1024)
#: one per structure of a scene, method, budget and capacity
_programs: Cache[tuple[Compiled, float]] = Cache(1024)


def on_device(x: np.ndarray) -> Any:
    with doubles():
        return jax.device_put(x)


class Diffrax(Call):
    """A compiled JAX function of two vectors on the device: converting arguments would dominate a short call."""

    def __init__(self, method: Peer, request: Request) -> None:
        super().__init__(method, request)
        r, self.saves = request, len(request.save_at)
        self.final_only = self.saves == 1
        self.capacity = next((size for size in CAPACITIES if size >= self.saves), self.saves)
        times = np.pad(r.save_at, (0, self.capacity - self.saves), mode="edge")  # the end again and again
        parts = r.scene.numbers(), [r.rtol or 0.0], np.array(r.atol, ndmin=1), times
        self.borders = np.cumsum([len(part) for part in parts])[:-1].tolist()
        self.start, self.fixed = map(on_device, (r.start, np.concatenate(parts, dtype=float)))

        def make() -> tuple[Compiled, float]:
            elapsed = stopwatch()
            try:
                with doubles():
                    return jax.jit(self._flat).lower(self.start, self.fixed).compile(), elapsed()
            except jax.errors.JAXTypeError as error:  # it branches on values
                raise reason_of(error) from error

        rest = r.carry, method, r.max_steps, np.size(r.atol), self.capacity
        self.program, self.seconds = _programs.get(key(r.scene.identity, *rest), make)

    def _run(self, y0: np.ndarray) -> np.ndarray:
        """Run the program from an initial state; the scene's own is on the device already."""
        return np.asarray(self.program(self.start if y0 is self.request.start else on_device(y0), self.fixed))

    def _flat(self, y0: jax.Array, fixed: jax.Array) -> jax.Array:
        """Return saved states, facts about the run, and its last state, all in one vector."""
        return jnp.concatenate([jnp.ravel(part) for part in self._solve(y0, fixed)])

    def _solve(self, y0: jax.Array, fixed: jax.Array) -> tuple[jax.Array, ...]:
        import diffrax
        import optimistix

        parts: list[Any] = jnp.split(fixed, self.borders)
        numbers, (rtol,), atol, times = parts
        r, implicit = self.request, self.method.implicit
        scene = r.scene.with_numbers(list(numbers))

        # Measured: one array through the linear algebra of the implicit methods (and it compiles in half the
        # time), and through explicit stages where there are more than three components, 1.1 to 1.4 times as
        # fast; a tuple of scalars for two components, 1.1 times as fast; equal for three.
        start = 0.0 if scene.clock is None else y0[scene.clock]
        y = scene.without_clock(scene.entries(y0))
        as_array = implicit or len(y) > 3 or len(atol) > 1
        atol = atol if len(atol) > 1 else atol[0]

        def field(t: jax.Array, x: Any, args: object) -> object:
            slopes = scene.slopes(start + t, scene.entries(x) if as_array else list(x), r.carry)
            return jnp.stack(slopes) if as_array else tuple(slopes)

        # recorded once: diffrax calls it at a dozen places of an implicit step, and traces it anew at each
        term = diffrax.ODETerm(jax.jit(field, inline=True))
        grid = [diffrax.SubSaveAt(t1=True), diffrax.SubSaveAt(ts=times)]
        # The default root finder, VeryChord, has one linearisation per step and a convergence criterion that
        # tight tolerances rarely meet: half of all steps are rejected and each is four times too
        # short.  Chord linearises at every stage and follows the error control.
        finder: Any = {"root_finder": optimistix.Chord(rtol=rtol, atol=atol)} if implicit else {}
        control = diffrax.PIDController(rtol=rtol, atol=atol, dtmin=SHORTEST * times[-1], force_dtmin=False)
        solution = diffrax.diffeqsolve(
            term,
            getattr(diffrax, self.method.solver)(**finder),
            0.0,
            times[-1],
            None,
            jnp.stack(y) if as_array else tuple(y),
            saveat=diffrax.SaveAt(t1=True) if self.final_only else diffrax.SaveAt(subs=grid),
            stepsize_controller=control,
            max_steps=r.max_steps,
            adjoint=diffrax.ForwardMode(),
            throw=False,
        )
        endings = (
            diffrax.RESULTS.successful,
            diffrax.RESULTS.max_steps_reached,
            diffrax.RESULTS.dt_min_reached,
        )
        counts = (solution.stats[f"num_{which}_steps"] for which in ("accepted", "rejected"))
        time = (solution.ts if self.final_only else solution.ts[0])[0]
        info = jnp.array([*counts, *(solution.result == each for each in endings), time])

        def packed(y: Any, t: jax.Array) -> Any:
            components = list(y.T) if as_array else list(y)
            return jnp.stack(scene.with_clock(components, start + t), axis=-1)

        if self.final_only:
            end = packed(solution.ys, times[-1:])
            return end, info, end[0]
        return packed(solution.ys[1], times), info, packed(solution.ys[0], times[-1:])[0]

    def last(self, y0: np.ndarray) -> np.ndarray:
        return self._run(y0)[-len(y0) :]

    def __call__(self, y0: np.ndarray) -> Ending:
        found, d = self._run(y0), len(y0)
        info, last = found[self.capacity * d : -d].tolist(), found[-d:]
        y = found[: self.saves * d].reshape(-1, d)[-len(self.later) :]  # less the start
        accepted, rejected, successful, exhausted, collapsed, time = info
        accepted, rejected = int(accepted), int(rejected)
        # explicit methods are first-same-as-last: stages per attempt, and the very first slope; diffrax does not say
        # how many Newton iterations an implicit one took
        explicit = (accepted + rejected) * (self.method.stages or 0) + 1
        evaluations = None if self.method.implicit else explicit
        counts = Counts(accepted, evaluations, 0, rejected)
        if successful:
            return Ending(y, counts)
        # Unsuccessful runs may still hold a finite state at the wrong time: keep only what was
        # saved before the end (saved times not reached are inf or nan).
        reached = 0 if self.final_only else int(np.argmin(np.append(np.isfinite(y).all(axis=1), False)))
        status = Status.budget if exhausted else Status.failed
        why = "step below the resolution of time" if collapsed else "the nonlinear solve failed"
        message = self.spent if exhausted else f"diffrax: {why} (t = {time:.6g})"
        return Ending(y[:reached], counts, status, message, (time, last))


for _solver, _order, _stages, _implicit, _about in (
    ("Tsit5", 5, 6, False, "Tsitouras 5(4), explicit; doi:10.1016/j.camwa.2011.06.002"),
    ("Dopri8", 8, 13, False, "Prince, Dormand 8(7), explicit; doi:10.1016/0771-050X(81)90010-3"),
    ("Kvaerno5", 5, 6, True, "Kværnø 5(4), implicit, Chord; doi:10.1023/B:BITN.0000046811.70614.38"),
):
    _known = _solver, "diffrax", _order, _stages, _implicit
    _named = f"diffrax-{_solver.lower()}", _about, Diffrax, ("jax",), (ROUNDING, 1e-1)
    # an implicit step compiled by XLA takes about as long as two right-hand sides in Python
    _sized: dict[str, Any] = {"largest": 64, "mission": not _implicit, "stiff": _implicit}
    METHODS.add(Peer(*_named, *_known, costs={"jax": 2} if _implicit else {}, **_sized))
