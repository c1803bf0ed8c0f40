"""diffrax's adaptive Runge–Kutta methods, compiled by JAX.

Kidger, On Neural Differential Equations, Oxford 2021, arXiv:2202.02435.  64-bit; tolerances,
and parameters are traced (one program for all of them), `throw=False` with the result code read.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from contactbench.methods.base import METHODS, ROUNDING, SHORTEST
from contactbench.methods.jax_engine import CompiledRun
from contactbench.methods.prepared import Outcome
from contactbench.peers.base import Peer
from contactbench.solution import Counts, Status


def mark() -> None:
    """What marks an evaluation in a program that is counted."""


@dataclass
class DiffraxRun(CompiledRun):
    method_: Peer

    sensitivity_source = "forward-mode AD, accepted steps frozen"
    #: one program for two saved times and for 1024: it takes up to 50 µs longer than one for 64 (measured), and
    #: a program takes seconds to compile
    capacities = (1, 1024)

    def __post_init__(self) -> None:
        super().__post_init__()
        r = self.request
        self.final_only = len(r.save_at) == 1
        fixed = self.together(r.scene.numbers(), [r.rtol, r.atol], self.times())
        self.compile(self.flat(self._solve_and_count), fixed)

    def key(self) -> tuple[Any, ...]:
        return (self.method_, self.capacity, self.request.max_steps)

    def states(self, y0: Any, fixed: Any) -> Any:
        return self._solve(y0, fixed)[0]

    def _solve_and_count(self, y0: Any, fixed: Any) -> Any:
        """As `_solve`; of an implicit method the facts have the evaluations too.

        diffrax does not report its Newton iterations.  To count them costs a program nothing: measured on
        eleven scenes, the same bits, in 0.78 to 1.01 of the time.
        """
        if not self.method_.implicit:
            return self._solve(y0, fixed)
        from contactbench.xla import jnp

        (y, info, last), evaluations = count_callbacks(partial(self._solve, marked=True), y0, fixed)
        return y, jnp.append(info, evaluations), last

    def _solve(self, y0: Any, fixed: Any, marked: bool = False) -> Any:
        import diffrax
        import optimistix

        from contactbench.xla import jax, jnp

        numbers, (rtol, atol), times = self.apart(fixed)
        r, implicit = self.request, self.method_.implicit
        scene = r.scene.with_numbers(list(numbers))

        # Measured: one array through the linear algebra of the implicit methods (and it compiles in half the
        # time), and through explicit stages where there are more than three components, 1.1 to 1.4 times as
        # fast; a tuple of scalars for two components, 1.1 times as fast; equal for three.
        start = 0.0 if scene.clock is None else y0[scene.clock]
        y = scene.without_clock(scene.entries(y0))
        as_array = implicit or len(y) > 3

        def field(t: Any, x: Any, args: Any) -> Any:
            if marked:
                jax.debug.callback(mark)
            slopes = scene.slopes(start + t, scene.entries(x) if as_array else list(x), r.carry)
            return jnp.stack(slopes) if as_array else tuple(slopes)

        # recorded once: diffrax calls it at a dozen places of an implicit step, and traces it anew at each
        term = diffrax.ODETerm(jax.jit(field, inline=True))
        grid = [diffrax.SubSaveAt(t1=True), diffrax.SubSaveAt(ts=times)]
        # The default root finder, VeryChord, has one linearisation per step and a convergence criterion that
        # tight tolerances rarely meet: half of all steps are rejected and each is four times too
        # short.  Chord linearises at every stage and follows the error control.
        finder: Any = {"root_finder": optimistix.Chord(rtol=rtol, atol=atol)} if implicit else {}
        solution = diffrax.diffeqsolve(
            term,
            getattr(diffrax, self.method_.solver)(**finder),
            0.0,
            times[-1],
            None,
            jnp.stack(y) if as_array else tuple(y),
            saveat=diffrax.SaveAt(t1=True) if self.final_only else diffrax.SaveAt(subs=grid),
            stepsize_controller=diffrax.PIDController(
                rtol=rtol, atol=atol, dtmin=SHORTEST * times[-1], force_dtmin=False
            ),
            max_steps=r.max_steps,
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
            if r.scene.kind == "many":
                return y
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
        # explicit methods are first-same-as-last: stages per attempt, and the very first slope
        evaluations = int(counted[0]) if counted else (accepted + rejected) * (self.method_.stages or 0) + 1
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


for _solver, _order, _stages, _implicit, _about in (
    ("Tsit5", 5, 6, False, "Tsitouras 5(4), explicit"),
    ("Dopri8", 8, 13, False, "Dormand–Prince 8(7), explicit"),
    ("Kvaerno5", 5, 6, True, "Kvaerno 5(4), implicit, Chord"),
):
    METHODS.add(
        Peer(
            f"diffrax-{_solver.lower()}",
            *(_about, DiffraxRun, ("jax",), (ROUNDING, 1e-1), _solver),
            order=_order,
            stages=_stages,
            implicit=_implicit,
            # an implicit step compiled by XLA takes about as long as two right-hand sides in Python
            costs={"jax": 2} if _implicit else {},
            most=1024 if _implicit else 0,
            largest=64,
        )
    )


# -- how often a JAX program calls back, without its calling back: every callback becomes an addition ------------
# A callback costs 20 µs, and JAX keeps no program that has one for other processes.
def count_callbacks(function: Callable[..., Any], *arguments: Any) -> tuple[Any, Any]:
    """What a traceable function returns, and how many `jax.debug.callback` it came by, which are not called.

    Raises `NotImplementedError` where one, or any other effect, is in a construct of JAX that has no rule here.
    """
    from contactbench.xla import jax, jnp

    program, shape = jax.make_jaxpr(function, return_shape=True)(*arguments)
    outputs, number = evaluate(program, jax.tree.leaves(arguments), jnp.array(0))
    return jax.tree.unflatten(jax.tree.structure(shape), outputs), number


def evaluate(program: Any, inputs: Sequence[Any], number: Any) -> tuple[list[Any], Any]:
    """The outputs of a program, equation by equation, and the number of callbacks, those so far included."""
    jaxpr = program.jaxpr
    values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*program.consts, *inputs], strict=True))

    def read(atom: Any) -> Any:
        return atom.val if hasattr(atom, "val") else values[atom]

    for equation in jaxpr.eqns:
        given = list(map(read, equation.invars))
        if equation.effects:
            found, number = count(equation.primitive.name, equation.params, given, number)
        else:
            parameters = equation.primitive.get_bind_params(equation.params)
            if isinstance(parameters, tuple):  # of older JAX: functions to be called, and the rest
                given, parameters = [*parameters[0], *given], parameters[1]
            found = equation.primitive.bind(*given, **parameters)
            found = found if equation.primitive.multiple_results else [found]
        values |= zip(equation.outvars, found, strict=True)
    return list(map(read, jaxpr.outvars)), number


def count(
    name: str, parameters: dict[str, Any], given: Sequence[Any], number: Any
) -> tuple[Sequence[Any], Any]:
    from contactbench.xla import lax

    if name == "debug_callback":
        return (), number + 1
    if name in ("jit", "custom_jvp_call"):
        return evaluate(parameters["jaxpr" if name == "jit" else "call_jaxpr"], given, number)
    if name == "cond":
        branches = [lambda n, *x, each=each: evaluate(each, x, n) for each in parameters["branches"]]
        return lax.switch(given[0], branches, number, *given[1:])
    if name != "while" or parameters["cond_jaxpr"].effects:
        raise NotImplementedError(f"a callback, or another effect, inside {name}, or inside its condition")
    i = parameters["cond_nconsts"]
    j = i + parameters["body_nconsts"]
    return lax.while_loop(
        lambda state: evaluate(parameters["cond_jaxpr"], [*given[:i], *state[0]], 0)[0][0],
        lambda state: evaluate(parameters["body_jaxpr"], [*given[i:j], *state[0]], state[1]),
        (list(given[j:]), number),
    )
