"""A contact method whose steps follow the motion: `contact-rkn6` with reversible step density control.

Any sequence of steps of a contact composition is a product of exact contact flows: J e^{γt} is kept to
round-off whatever the steps are, and the steps taken, held fixed, are a contact map with the factor e^{−γt}.
The map from initial data to the state at a time is not: other data mean other steps, and the contact form
is kept as well as the tolerance allows.  What is chosen here is how long the steps are: h = ε/ρ with a step
density ρ that is integrated along,

    ρ_{n+1/2} = ρ_{n−1/2} + ε G(x_n),   G = d ln ω/dt,   ρ_{1/2} = ω(q_0) + ½ ε G(x_0),

which keeps ρ near the local frequency ω and the method time-symmetric (Hairer, Söderlind, SIAM J. Sci.  Comput. 26,
1838 (2005), doi:10.1137/040606995).  ω⁴ = ‖∇²V‖²_F/m² + (γ/8)⁴ + T⁻⁴: the curvature of the potential; the damping,
which is solved exactly but for what its negative substeps do; the whole span.  For −1/‖q‖ it gives h ∝ ‖q‖^{3/2}.  G
comes from ∇²V by dual numbers, or from ∇V alone where a scene has no Hessian.

A saved time is reached by one shortened step off the sequence, which goes on as if nothing had been
saved.  The tolerance sets ε = AIM · rtol^{1/6}: it is the size of the error, not an estimate of it.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import reduce
from operator import and_
from typing import Any

import numpy as np

from contactbench.methods.base import METHODS, SHORTEST, Adaptive, unfit
from contactbench.methods.jax_engine import CompiledRun
from contactbench.methods.prepared import NO_NUMBER, Outcome, Prepared, Request, stopwatch
from contactbench.numbers.control import XlaNumbers, choose
from contactbench.numbers.dual import Dual, DualNumbers, slope, value
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import Cache, Mechanical, Scene, Vector, key, scaled
from contactbench.scene.mechanical import derived_hessian
from contactbench.solution import DIVERGENCE, Counts, Differential, Status
from contactbench.splitting.composition import advance, plan
from contactbench.splitting.flows import flows_of
from contactbench.splitting.tables import RKN6
from contactbench.trace.compiled import compile_function
from contactbench.trace.form import Element, Function, Operation, Store, execute
from contactbench.trace.formula import Formula
from contactbench.trace.recording import RecordedNumbers, Tape, attempt, operand_of
from contactbench.xla import jnp, lax

#: ωh of one step at rtol = 1
AIM = 3.0
#: the density may fall by this factor in one step, at most: with a tolerance so loose that it would
#: otherwise become negative, symmetry is lost
SLOWEST = 0.25


# -- the step density --------------------------------------------------------------------------------
def squared_curvature(scene: Mechanical, q: Vector, v: Vector) -> Dual:
    """‖M^{-1/2} ∇²V M^{-1/2}‖²_F at q and its rate of change along v, less 1/m² where there is one mass."""
    hessian = scene.hessian
    if hessian is None and isinstance(scene.gradient, Formula):
        with suppress(CannotRecord):  # of many components most entries are often zero
            hessian = derived_hessian(scene.gradient)
    if hessian is not None:
        rows = hessian(tuple(map(Dual, q, v)), **scene.parameters)
        entries = [entry for row in rows for entry in row]
    else:
        moving, entries = tuple(map(Dual, q, v)), []
        for j in range(len(q)):
            column = scene.dV(tuple(Dual(x, float(i == j)) for i, x in enumerate(moving)))
            entries += [slope(entry) for entry in column]
    total, over_m = Dual(0.0, 0.0), scene.inverse_mass
    weights = [a * b for a in over_m for b in over_m] if isinstance(over_m, tuple) else [1.0] * len(entries)
    for entry, weight in zip(entries, weights, strict=True):
        if isinstance(entry, float) and not entry:
            continue
        total = total + entry * entry * weight
    return Dual(value(total), slope(total))


def frequency(scene: Mechanical, x: Any, span: Any) -> tuple[Any, Any]:
    """ω, and d ln ω/dt along the motion."""
    square = 1.0 if isinstance(scene.inverse_mass, tuple) else scene.inverse_mass * scene.inverse_mass
    curvature = squared_curvature(scene, x.q, scaled(scene.inverse_mass, x.p))
    damping = scene.gamma * scene.gamma / 64
    fourth = curvature.a * square + damping * damping + 1 / (span * span * span * span)
    return fourth**0.25, curvature.b * square / (4 * fourth)


def first_density(scene: Mechanical, x: Any, epsilon: Any, span: Any, xp: Any) -> Any:
    omega, growth = frequency(scene, x, span)
    return larger(omega + epsilon * growth / 2, SLOWEST * omega, xp)


def next_density(scene: Mechanical, x: Any, density: Any, epsilon: Any, span: Any, xp: Any) -> Any:
    return larger(density + epsilon * frequency(scene, x, span)[1], SLOWEST * density, xp)


def larger(a: Any, b: Any, xp: Any) -> Any:
    return choose(a >= b, a, b, xp)


# -- the loop, on every engine -------------------------------------------------------------------------
def solve(
    scene: Any, x: Any, options: Any, times: Any, xp: Any, pace: Any, repeat_while: Any, over: Any
) -> Any:
    """Take the sequence of steps from x, and at each of the times the shortened step off it.

    options : ε, the span, the budget of steps, and the scales of the motion.  pace(x) : what decides how long steps
    are, x or x without its tangent.
    The loops of an engine: ``repeat_while(condition, body, x)``, and ``over(times, body, x)`` with a body that returns
    x and a row, NaN where not reached.
    Returns what `over` does of (x, time, density, steps).
    """
    epsilon, span, budget, *scales = options
    square = sum(c * c for c in motion_of(scene, x))
    least = choose(square > 1, square, 1.0, xp)
    bounds = [DIVERGENCE**2 * larger(scale * scale, least, xp) for scale in scales]

    def next_time(carried: Any) -> Any:
        _, time, density, _ = carried
        return value(time) + epsilon / value(density)

    def healthy(carried: Any) -> Any:
        x, _, density, steps = carried
        inside = [c * c <= bound for c, bound in zip(motion_of(scene, x), bounds, strict=True)]
        return reduce(and_, inside, (steps < budget) & (epsilon > SHORTEST * span * value(density)))

    def step(carried: Any) -> Any:
        x, time, density, steps = carried
        h = epsilon / density
        x = advance(RKN6, scene, x, h, 1, xp)
        return x, time + h, next_density(scene, pace(x), density, epsilon, span, xp), steps + 1

    def interval(carried: Any, due: Any) -> Any:
        carried = repeat_while(lambda c: (next_time(c) <= due) & healthy(c), step, carried)
        x, time, _, _ = carried
        complete = (next_time(carried) > due) & healthy(carried)
        there = flat(scene.pack(advance(RKN6, scene, x, due - time, 1, xp)))
        return carried, [choose(complete, c, math.nan, xp) for c in there]

    density, zero = first_density(scene, pace(x), epsilon, span, xp), 0.0 * span
    time = Dual(zero, zero) if isinstance(density, Dual) else zero
    return over(times, interval, (x, time, density, zero))


def motion_of(scene: Any, x: Any) -> list[Any]:
    return [value(c) for c in scene.pack(x)[: scene.motion]]


def flat(components: Any) -> list[Any]:
    """Numbers, and after them the derivatives of dual ones."""
    tangents = map(slope, components) if isinstance(components[0], Dual) else ()
    return [*map(value, components), *tangents]


def record_loop(scene: Any, carry: tuple[str, ...], tangent: bool = False, moving: bool = False) -> Function:
    """``run(start, numbers, options, times, y, facts)``, the loop over steps and saved times.

    y : states at the saved times.  facts : time, density and steps at the end of the sequence, and the state there.
    tangent : the state is followed by a tangent, which is carried along with the steps as they are; moving : and
    through their choice, by the tangents of time and density.
    """
    tape, d = Tape(), len(scene.labels(carry))

    def load(array: str, size: int) -> list[Any]:
        return [tape.assign(Element(array, (i,)), "f", tape.root) for i in range(size)]

    twin = scene.with_numbers(load("numbers", len(scene.numbers())))
    start, xp = load("start", d * (1 + tangent)), RecordedNumbers(tape)  # type: list[Any], Any
    if tangent:
        start, xp = list(map(Dual, start[:d], start[d:])), DualNumbers(xp)

    def pace(x: Any) -> Any:
        return x if moving else scene.unpack(list(map(value, scene.pack(x))), carry)

    def over(times: str, body: Any, x: Any) -> Any:
        def interval(carried: Any) -> Any:
            x, j = carried
            x, row = body(x, tape.assign(Element(times, (j.name,)), "f", tape.block))
            stores = (Store(Element("y", (j.name, i)), operand_of(c)) for i, c in enumerate(row))
            tape.block.statements.extend(stores)
            return x, j + 1

        return tape.repeat(tape.assign(Operation("len", (times,)), "i", tape.root), interval, (x, 0))[0]

    x, options = scene.unpack(start, carry), load("options", 3 + scene.motion)
    x, time, density, steps = solve(twin, x, options, "times", xp, pace, tape.repeat_while, over)
    facts = [value(time), value(density), steps, *flat(scene.pack(x))]
    stores = [Store(Element("facts", (i,)), operand_of(fact)) for i, fact in enumerate(facts)]
    arguments = ("start", "numbers", "options", "times", "y", "facts")
    return Function("run", arguments, (*tape.root.statements, *stores))


# -- runs ----------------------------------------------------------------------------------------------
@dataclass
class AdaptiveContactRun(Prepared):
    sensitivity_source = "forward-mode AD, accepted steps frozen"
    #: how `sensitivity` with frozen=False differentiates
    map_source = "forward-mode AD through the steps and their choice"

    def __post_init__(self) -> None:
        super().__post_init__()
        r = self.request
        assert r.rtol is not None
        self.per_step = plan(RKN6, r.scene).count(flows_of(r.scene), ("gradient",), 1)
        scene: Any = r.scene
        #: gradients that the curvature of a state costs where the scene has no Hessian
        self.by_gradients = len(scene.q) if scene.hessian is None else 0
        #: of steps of the sequence; the shortened ones, one to every saved time, come out of `max_steps` first
        self.budget = max(r.max_steps - len(r.save_at) + 1, 0)
        self.epsilon = AIM * r.rtol ** (1 / RKN6.order)
        #: with the scales of the scene's own start
        self.options = self.options_from(self.start)

    def options_from(self, y0: np.ndarray) -> np.ndarray:
        return np.array([self.epsilon, self._end, self.budget, *self.scales(y0)[: self._motion]])

    @abstractmethod
    def sensitivity(self, y0: np.ndarray, frozen: bool = True) -> np.ndarray:
        """As in `Prepared`; with frozen=False through the density too, which is differentiable where the
        number of steps does not change."""

    def differential(self, y0: np.ndarray, out: Outcome, frozen: bool) -> Differential:
        with suppress(CannotRecord):
            if not frozen:
                return Differential(self.map_source, out.y, self.sensitivity(y0, frozen=False)[None])
        return super().differential(y0, out, frozen)

    @abstractmethod
    def attempt(self, y0: np.ndarray, options: np.ndarray) -> tuple[np.ndarray, Any]:
        """Return the states, NaN where not reached, and the facts of `record_loop`."""

    def integrate(self, y0: np.ndarray) -> Outcome:
        out = self.outcome(y0, *self.attempt(y0, self.options))
        if out.status is Status.ok or y0 is self.start:
            return out
        return self.outcome(y0, *self.attempt(y0, self.options_from(y0)))  # maybe of another scale

    def outcome(self, y0: np.ndarray, y: np.ndarray, facts: Any) -> Outcome:
        """The outcome of a run from its states, NaN where not reached, and the facts of `record_loop`."""
        r = self.request
        time, density, steps, *last = facts
        reached = int(np.argmin(np.append(np.isfinite(y).all(axis=1), False)))
        curvatures = int(steps) + 1
        taken = int(steps) + reached  # a shortened step to every saved time reached
        evaluations = taken * self.per_step + curvatures * self.by_gradients
        counts = Counts(taken, evaluations, 0 if self.by_gradients else curvatures, 0, "gradient")
        if reached == len(y):
            return self.finish(y0, y, counts)
        status, message = Status.budget, f"max_steps = {r.max_steps} spent (t = {time:.6g})"
        if steps < self.budget:
            status = Status.failed
            message = f"step {self.epsilon / density:.3g} below the resolution of time (t = {time:.6g})"
        return self.finish(y0, y[:reached], counts, status, message, (time, np.array(last)))


_loops: Cache[tuple[Any, float]] = Cache(256)


class AdaptiveNumbaLoop(AdaptiveContactRun):
    def __post_init__(self) -> None:
        super().__post_init__()
        r = self.request
        self.numbers, self.times = np.array(r.scene.numbers()), np.ascontiguousarray(r.save_at)
        self.run, self.compile_s = self.loop()

    def loop(self, tangent: bool = False, moving: bool = False) -> tuple[Any, float]:
        r = self.request

        def make() -> tuple[Any, float]:
            elapsed = stopwatch()
            function = attempt(lambda: record_loop(r.scene, r.carry, tangent, moving))
            return compile_function(function), elapsed()

        return _loops.get(key(r.scene.identity, r.carry, tangent, moving), make)

    def call(
        self, run: Any, start: np.ndarray, options: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        y, facts = np.empty((len(self.times), len(start))), np.empty(3 + len(start))
        run(start, self.numbers, self.options if options is None else options, self.times, y, facts)
        return y, facts

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return self.call(self.run, y0)[0][-1]

    def attempt(self, y0: np.ndarray, options: np.ndarray) -> tuple[np.ndarray, Any]:
        y, facts = self.call(self.run, y0, options)
        return y, facts.tolist()

    def sensitivity(self, y0: np.ndarray, frozen: bool = True) -> np.ndarray:
        run, _ = self.loop(tangent=True, moving=not frozen)
        states = [self.call(run, np.concatenate([y0, v]))[0] for v in self.tangents(y0)]
        return np.stack(states, axis=-1)[:, len(y0) :]


class AdaptivePythonLoop(AdaptiveContactRun):
    """Plain Python floats: the recorded loop, or as it is written where that cannot be had or has no number."""

    def __post_init__(self) -> None:
        super().__post_init__()
        r, elapsed, self.loops = self.request, stopwatch(), [self.as_written]
        with suppress(CannotRecord):
            self.loops.insert(0, execute(attempt(lambda: record_loop(r.scene, r.carry))))
            self.compile_s = elapsed()

    def sensitivity(self, y0: np.ndarray, frozen: bool = True) -> np.ndarray:
        return AdaptiveNumbaLoop(self.method, replace(self.request, engine="numba")).sensitivity(y0, frozen)

    def attempt(self, y0: np.ndarray, options: np.ndarray) -> tuple[np.ndarray, Any]:
        r = self.request
        given = y0.tolist(), r.scene.numbers(), options.tolist(), r.save_at.tolist()
        for loop in self.loops:
            y, facts = [[math.nan] * len(y0) for _ in r.save_at], [0.0, math.nan, 0.0, *given[0]]
            with suppress(*NO_NUMBER):  # maybe in a branch that is not taken; what was reached before counts
                loop(*given, y, facts)
                break
        return np.array(y), facts

    def as_written(self, start: Any, numbers: Any, options: Any, times: Any, y: Any, facts: Any) -> None:
        scene = self.request.scene

        def keep(carried: Any) -> Any:
            x, *known = carried
            facts[:] = [*known, *scene.pack(x)]
            return carried

        def repeat_while(condition: Any, body: Any, x: Any) -> Any:
            while condition(x):
                x = keep(body(x))
            return x

        def over(times: list[float], body: Any, x: Any) -> None:
            for k, time in enumerate(times):
                x, y[k] = body(keep(x), time)

        x = scene.unpack(start, self.request.carry)
        solve(scene, x, options, times, math, lambda x: x, repeat_while, over)


class ScalarNumbers(XlaNumbers):
    """Without arrays: constants that change at every step are cheaper one by one, in the loop's own kernel."""

    abilities = XlaNumbers.abilities._replace(vectors=False)


class AdaptiveJaxLoop(AdaptiveContactRun, CompiledRun):
    def __post_init__(self) -> None:
        super().__post_init__()
        self.compile(self.flat(self._solve), self.given(self.options))

    def given(self, options: np.ndarray) -> np.ndarray:
        return self.together(self.request.scene.numbers(), options, self.times())

    def states(self, y0: Any, fixed: Any) -> Any:
        return self._solve(y0, fixed)[0]

    def sensitivity(self, y0: np.ndarray, frozen: bool = True) -> np.ndarray:
        def states(y0: Any, fixed: Any) -> Any:
            return self._solve(y0, fixed, frozen)[0]

        return self.derivative(y0, states, "frozen" if frozen else "map")[: self._saves]

    def _solve(self, y0: Any, fixed: Any, frozen: bool = True) -> Any:
        numbers, options, times = self.apart(fixed)
        scene: Any = self.request.scene.with_numbers(list(numbers))
        x = scene.unpack(list(y0), self.request.carry)
        pace = lax.stop_gradient if frozen else lambda x: x

        def over(times: Any, body: Any, x: Any) -> Any:
            def interval(x: Any, due: Any) -> Any:
                x, row = body(x, due)
                return x, jnp.stack(row)

            return lax.scan(interval, x, times)

        (x, *facts), y = solve(scene, x, options, times, ScalarNumbers(), pace, lax.while_loop, over)
        return y, jnp.stack(facts), jnp.stack(scene.pack(x))

    def attempt(self, y0: np.ndarray, options: np.ndarray) -> tuple[np.ndarray, Any]:
        fixed = None if options is self.options else self.given(options)
        y, facts, last = self.unflat(super().call(y0, fixed), len(y0))
        return y, (*facts, *last)


RUNS: dict[str, type[AdaptiveContactRun]] = {
    "numba": AdaptiveNumbaLoop,
    "jax": AdaptiveJaxLoop,
    "python": AdaptivePythonLoop,
}


@dataclass(frozen=True)  # its fields are its definition
class AdaptiveContactMethod(Adaptive):
    family = "contact"
    name: str = "contact-adaptive"
    order: int | None = 6
    about: str = "contact-rkn6 with reversible step density; Hairer, Söderlind, doi:10.1137/040606995"
    engines: tuple[str, ...] = tuple(RUNS)
    evaluations_per_step: int = 12
    largest: int = 64
    takes_atol: bool = False
    tolerance: str = "a step in local time scales, 3 rtol^{1/6}: the size of the error"

    def refuses(self, scene: Scene) -> str | None:
        needs = "forces that depend on q alone and a merged drift and damping"
        return unfit(self, scene, scene.kind == "mechanical", needs)

    def prepare(self, request: Request) -> Prepared:
        return RUNS[request.engine](self.name, request)


METHODS.add(AdaptiveContactMethod())
