"""A contact method whose steps follow the motion: `contact-rkn6` with reversible step density control.

Any sequence of steps of a contact composition is a product of exact contact flows: J e^{γt} is kept to
round-off whatever the steps are, and the steps taken, held fixed, are a contact map with the factor e^{−γt}.
The map from initial data to the state at a time is not: other data mean other steps, and the contact form
is kept as well as the tolerance allows.  What is chosen here is how long the steps are: h = ε/ρ with a step
density ρ that is integrated along,

    ρ_{n+1/2} = ρ_{n−1/2} + ε G(x_n),   G = d ln ω/dt,   ρ_{1/2} = ω(q_0) + ½ ε G(x_0),

which keeps ρ near the local frequency ω and the method time-symmetric (Hairer, Söderlind, SIAM J. Sci.
Comput. 26, 1838 (2005), doi:10.1137/040606995).  ω⁴ = ‖∇²V‖²_F/m² + (γ/8)⁴ + T⁻⁴: the curvature of the
potential; the damping, which is solved exactly but for what its negative substeps do; the whole span.
For −1/‖q‖ it gives h ∝ ‖q‖^{3/2}.
G comes from ∇²V by dual numbers, or from ∇V alone where a scene has no Hessian.

A saved time is reached by one shortened step off the sequence, which goes on as if nothing had been
saved.  The tolerance sets ε = AIM · rtol^{1/6}: it is the size of the error, not an estimate of it.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import numpy as np

from contactbench.methods.adaptive_program import first_density, next_density, record_loop
from contactbench.methods.base import METHODS, SHORTEST, Adaptive, Request
from contactbench.methods.compiled import CompiledRun
from contactbench.methods.outcome import Outcome
from contactbench.methods.prepared import Prepared, stopwatch
from contactbench.methods.request import NO_NUMBER
from contactbench.numbers.protocol import CannotRecord
from contactbench.numbers.xla import XlaNumbers
from contactbench.scene import Mechanical, Scene
from contactbench.scene.cache import Cache, key
from contactbench.solution import DIVERGENCE, Counts, Differential, Status, divergence_bound
from contactbench.splitting.composition import advance, plan
from contactbench.splitting.flows import flows_of
from contactbench.splitting.tables import RKN6
from contactbench.trace.compiled import compile_function
from contactbench.trace.python import execute
from contactbench.trace.recording import attempt

#: ωh of one step at rtol = 1
AIM = 3.0


class ScalarNumbers(XlaNumbers):
    """Without arrays: constants that change at every step are cheaper one by one, in the loop's own kernel."""

    abilities = XlaNumbers.abilities._replace(vectors=False)


@dataclass
class AdaptiveContactRun(Prepared):
    """What the engines share: how a run ends, and what it costs."""

    def __post_init__(self) -> None:
        super().__post_init__()
        r = self.request
        assert r.rtol is not None
        self.composition = RKN6
        self.per_step = plan(self.composition, r.scene).count(flows_of(r.scene), ("gradient",), 1)
        scene: Any = r.scene
        #: gradients that the curvature of a state costs where the scene has no Hessian
        self.by_gradients = len(scene.q) if scene.hessian is None else 0
        #: of steps of the sequence; the shortened ones, one to every saved time, come out of `max_steps` first
        self.budget = max(r.max_steps - len(r.save_at) + 1, 0)
        self.epsilon, self.span = AIM * r.rtol ** (1 / self.composition.order), float(r.save_at[-1])

    #: how `sensitivity` with frozen=False differentiates
    map_source = ""

    @abstractmethod
    def sensitivity(self, y0: np.ndarray, frozen: bool = True) -> np.ndarray:
        """As in `Prepared`; with frozen=False through the density too, which is differentiable where the
        number of steps does not change."""

    def differential(self, y0: np.ndarray, out: Outcome, frozen: bool) -> Differential:
        with suppress(CannotRecord):
            if not frozen:
                return Differential(self.map_source, out.y, self.sensitivity(y0, frozen=False)[None])
        return super().differential(y0, out, frozen)

    def outcome(
        self, y0: np.ndarray, y: np.ndarray, steps: int, time: float, last: list[float], density: float
    ) -> Outcome:
        """The outcome of a run whose sequence of steps ended at (time, last); y : NaN where not reached."""
        r = self.request
        reached = int(np.argmin(np.append(np.isfinite(y).all(axis=1), False)))
        counts = self.cost(steps, reached)
        if reached == len(y):
            return self.finish(y0, y, counts)
        status, message = Status.budget, f"max_steps = {r.max_steps} spent (t = {time:.6g})"
        if steps < self.budget:
            status = Status.failed
            message = f"step {self.epsilon / density:.3g} below the resolution of time (t = {time:.6g})"
        return self.finish(y0, y[:reached], counts, status, message, (time, np.array(last)))

    def cost(self, steps: int, reached: int) -> Counts:
        """Counts of a sequence of steps, and of a shortened step to every saved time reached."""
        taken, curvatures = steps + reached, steps + 1
        evaluations = taken * self.per_step
        if self.by_gradients:
            return Counts(taken, evaluations + curvatures * self.by_gradients, 0, 0, "gradient")
        return Counts(taken, evaluations, curvatures, 0, "gradient")


class AdaptivePythonLoop(AdaptiveContactRun):
    """Plain Python floats."""

    sensitivity_source = "forward-mode AD, accepted steps frozen, on jax"
    map_source = "forward-mode AD through the steps and their choice, on jax"

    def __post_init__(self) -> None:
        super().__post_init__()
        r, elapsed, scene, self.loop = self.request, stopwatch(), cast("Mechanical", self.request.scene), None
        with suppress(CannotRecord):
            loop = attempt(lambda: record_loop(self.composition, scene, r.carry, tangent=False))
            self.loop = execute(loop)
            self.compile_s = elapsed()

    def sensitivity(self, y0: np.ndarray, frozen: bool = True) -> np.ndarray:
        return AdaptiveJaxLoop(self.method, self.request).sensitivity(y0, frozen)

    def integrate(self, y0: np.ndarray) -> Outcome:
        if self.loop is not None:
            r = self.request
            y, facts = [[math.nan] * len(y0) for _ in r.save_at], [0.0] * (3 + len(y0))
            options = self.epsilon, self.span, self.budget
            with suppress(*NO_NUMBER):  # maybe in a branch that is not taken
                self.loop(y0.tolist(), r.scene.numbers(), options, r.save_at.tolist(), y, facts)
                time, density, steps, *last = facts
                return self.outcome(y0, np.array(y), int(steps), time, last, density)
        return self.as_written(y0)

    def as_written(self, y0: np.ndarray) -> Outcome:
        """The same without a recorded loop."""
        r, epsilon, span = self.request, self.epsilon, self.span
        scene: Any = r.scene
        bound = divergence_bound(y0[: self._motion]) ** 2
        x, time, steps = scene.unpack(y0.tolist(), r.carry), 0.0, 0
        y = np.full((len(r.save_at), len(y0)), math.nan)
        density = math.nan
        try:
            density = first_density(scene, x, epsilon, span, max)
            for k, due in enumerate(r.save_at.tolist()):
                while time + epsilon / density <= due:
                    step = epsilon / density
                    if steps == self.budget or not step > SHORTEST * span:
                        break
                    if not all(c * c <= bound for part in x[:2] for c in part):
                        break
                    x = advance(self.composition, scene, x, step, 1, math)
                    density = next_density(scene, x, density, epsilon, span, max)
                    time, steps = time + step, steps + 1
                else:
                    if steps == self.budget:
                        break
                    y[k] = scene.pack(advance(self.composition, scene, x, due - time, 1, math))
                    continue
                break
        except NO_NUMBER:
            pass
        return self.outcome(y0, y, steps, time, [float(c) for c in scene.pack(x)], density)


_loops: Cache[tuple[Any, float]] = Cache(256)


class AdaptiveNumbaLoop(AdaptiveContactRun):
    """The same loop as a program compiled by LLVM."""

    sensitivity_source = "forward-mode AD, accepted steps frozen"
    map_source = "forward-mode AD through the steps and their choice"

    def __post_init__(self) -> None:
        super().__post_init__()
        r = self.request
        self.numbers = np.array(r.scene.numbers())
        self.options = np.array([self.epsilon, self.span, self.budget])
        self.times = np.ascontiguousarray(r.save_at)
        self.run, self.compile_s = self.loop()

    def loop(self, tangent: bool = False, moving: bool = False) -> tuple[Any, float]:
        """The compiled loop, and the seconds it took."""
        r = self.request

        def make() -> tuple[Any, float]:
            elapsed = stopwatch()
            scene: Any = r.scene
            loop = attempt(lambda: record_loop(self.composition, scene, r.carry, tangent, moving))
            return compile_function(loop), elapsed()

        return _loops.get(key(r.scene.identity, r.carry, tangent, moving), make)

    def solve(self, run: Any, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States at the saved times, and the facts about the end of the sequence."""
        y, facts = np.empty((len(self.times), len(start))), np.empty(3 + len(start))
        run(start, self.numbers, self.options, self.times, y, facts)
        return y, facts

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return self.solve(self.run, y0)[0][-1]

    def integrate(self, y0: np.ndarray) -> Outcome:
        y, facts = self.solve(self.run, y0)
        time, density, steps, *last = facts.tolist()
        return self.outcome(y0, y, int(steps), time, last, density)

    def sensitivity(self, y0: np.ndarray, frozen: bool = True) -> np.ndarray:
        run, _ = self.loop(tangent=True, moving=not frozen)
        pushed = [self.solve(run, np.concatenate([y0, v]))[0][:, len(y0) :] for v in self.tangents(y0)]
        return np.stack(pushed, axis=-1)


class AdaptiveJaxLoop(AdaptiveContactRun, CompiledRun):
    """A while loop over the steps inside a scan over the saved times."""

    sensitivity_source = "forward-mode AD, accepted steps frozen"
    map_source = "forward-mode AD through the steps and their choice"

    def __post_init__(self) -> None:
        from contactbench.xla import jax

        super().__post_init__()
        r = self.request
        options = [self.epsilon, self.span, self.budget]
        self.fixed = jax.device_put(self.together(r.scene.numbers(), options, self.times()))
        self.program, self.compile_s = self.compiled(
            "run", self.flat(self._solve), self._own_start, self.fixed
        )

    def key(self) -> tuple[Any, ...]:
        return (self.method, self.capacity)

    def states(self, y0: Any, fixed: Any) -> Any:
        return self._solve(y0, fixed)[0]

    def sensitivity(self, y0: np.ndarray, frozen: bool = True) -> np.ndarray:
        return self.pushed(y0, partial(self._states, frozen), "frozen" if frozen else "map")

    def _states(self, frozen: bool, y0: Any, fixed: Any) -> Any:
        return self._solve(y0, fixed, frozen)[0]

    def _solve(self, y0: Any, fixed: Any, frozen: bool = True) -> Any:
        from contactbench.xla import jnp, lax

        r, xp = self.request, ScalarNumbers()
        numbers, options, times = self.apart(fixed)
        scene: Any = r.scene.with_numbers(list(numbers))
        epsilon, span, budget = options
        start = scene.unpack(list(y0), r.carry)
        square = y0[: self._motion] @ y0[: self._motion]
        bound = DIVERGENCE**2 * jnp.where(square > 0, square, 1.0)

        def pace(x: Any) -> Any:
            return lax.stop_gradient(x) if frozen else x

        def due(carried: Any, until: Any) -> Any:
            _x, time, density, _steps = carried
            return time + epsilon / density <= until

        def healthy(carried: Any) -> Any:
            x, _time, density, steps = carried
            inside = jnp.all(jnp.stack([c * c <= bound for part in x[:2] for c in part]))
            return (steps < budget) & (epsilon > SHORTEST * span * density) & inside

        def step(carried: Any) -> Any:
            x, time, density, steps = carried
            h = epsilon / density
            x = advance(self.composition, scene, x, h, 1, xp)
            density = next_density(scene, pace(x), density, epsilon, span, jnp.maximum)
            return x, time + h, density, steps + 1

        def interval(carried: Any, until: Any) -> Any:
            carried = lax.while_loop(lambda c: due(c, until) & healthy(c), step, carried)
            x, time, _, _ = carried
            there = advance(self.composition, scene, x, until - time, 1, xp)
            complete = healthy(carried) & ~due(carried, until)
            return carried, jnp.where(complete, jnp.stack(scene.pack(there)), jnp.nan)

        density = first_density(scene, pace(start), epsilon, span, jnp.maximum)
        (x, time, density, steps), y = lax.scan(interval, (start, 0.0 * span, density, 0.0 * span), times)
        return y, jnp.stack([time, density, steps]), jnp.stack(scene.pack(x))

    def integrate(self, y0: np.ndarray) -> Outcome:
        y, info, last = self.unflat(np.asarray(self.program(self.placed(y0), self.fixed)), len(y0))
        time, density, steps = info
        return self.outcome(y0, y, int(steps), time, last, density)


@dataclass(frozen=True)
class AdaptiveContactMethod(Adaptive):
    family = "contact"
    name: str = "contact-adaptive"
    order: int | None = 6
    about: str = "contact-rkn6 with reversible step density; Hairer, Söderlind, doi:10.1137/040606995"
    engines: tuple[str, ...] = ("numba", "jax", "python")
    evaluations_per_step: int = 12
    takes_atol: bool = False
    tolerance: str = "a step in local time scales, 3 rtol^{1/6}: the size of the error"

    def refuses(self, scene: Scene) -> str | None:
        if scene.kind == "general damping":
            return f"{self.name} needs a merged drift and damping; scene {scene.name!r} has none"
        if scene.kind == "driven":
            return f"{self.name} has no step density for forces that change with time, as on scene {scene.name!r}"
        if scene.kind != "mechanical":
            return f"{self.name} follows the curvature of a potential; scene {scene.name!r} has none"
        return scene.own_equations

    def prepare(self, request: Request) -> Prepared:
        loops: dict[str, type[AdaptiveContactRun]] = {
            "numba": AdaptiveNumbaLoop,
            "jax": AdaptiveJaxLoop,
            "python": AdaptivePythonLoop,
        }
        return loops[request.engine](self.name, request)


METHODS.add(AdaptiveContactMethod())
