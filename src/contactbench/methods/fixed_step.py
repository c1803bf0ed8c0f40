"""Fixed-step methods, and two of the engines that run them: a compiled JAX loop and plain Python.

The third and first, compiled by numba, is in numba_engine.py.

The Python loop is written on the scene's own components, so it also runs on NumPy arrays (an
ensemble) and on mpmath numbers (`trajectory` with another namespace).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from contactbench.methods.base import METHODS, Outcome, Prepared, Refused, Request, steps_in
from contactbench.methods.compiled import CompiledRun, XlaNumbers
from contactbench.numbers.recording import CannotRecord
from contactbench.scene import Scene
from contactbench.solution import Counts, Status
from contactbench.splitting.composition import Repeat, repeat

#: evaluations written out in one turn of the compiled loop
UNROLL = 32
#: numbers of saved times a program is compiled for; the next larger one serves all in between
CAPACITIES = (1, 64, 1024)

Step = Callable[[Any, Any, Any, Any], Any]  # (scene, x, h, xp) -> x
Factor = Callable[[Any, Any, Any], Any]  # (scene, h, xp) -> conformal factor of one step


@dataclass(frozen=True)
class FixedStep:
    """A one-step method given by its step map ``step(scene, x, h, xp) -> x``.

    evaluations : of `kind` per step.  A method that can merge the end of one step with the start of
    the next overrides `advance` and `counts` (see contact.py).
    """

    name: str
    order: int
    step: Step
    evaluations: int = 1
    kind: str = "rhs"
    about: str = ""
    engines: tuple[str, ...] = ("numba", "jax", "python")
    #: what it is compared as: contact, variational (from a discrete action) or established
    family: str = "established"
    #: declared properties, each tested for every registered method that claims it
    contact: bool = False  # every step is an exact conformal contact map with factor e^{−γh}
    symmetric: bool = False  # Φ_{−h} ∘ Φ_h = id
    factor: Factor | None = None  # every step is a conformal contact map with this factor instead
    adaptive = False
    #: tolerances from which a step can be chosen
    rtol_range = (1e-13, 1e-1)

    def refuses(self, scene: Scene) -> str | None:
        return None

    def advance(self, scene: Any, x: Any, h: Any, n: Any, xp: Any, repeat: Repeat = repeat) -> Any:
        """n ≥ 1 steps of size h."""
        return repeat(n, lambda x: self.step(scene, x, h, xp), x)

    def conformal_factor(self, scene: Scene, h: Any, xp: Any = math) -> Any | None:
        """The constant c of Φ_h*η = c η, e^{−γh} for a `contact` method; None where none is claimed."""
        if self.refuses(scene) is not None or scene.conformal_rate is None:
            return None
        if self.factor is not None:
            return self.factor(scene, h, xp)
        return xp.exp(-scene.conformal_rate * h) if self.contact else None

    def log_factor(self, scene: Scene, x: Any, h: float, n: int) -> float | None:
        """Log of the conformal factor of n steps of size h from x; None where the steps are no contact maps.

        nan where the factor is negative, as that of a Herglotz step may be.
        """
        factor = self.conformal_factor(scene, h)
        if factor is None:
            return None
        return n * math.log(factor) if factor > 0 else math.nan

    def counts(self, scene: Scene, n: int) -> int:
        """Evaluations in n uninterrupted steps."""
        return n * self.evaluations

    def per_step(self, scene: Scene) -> int:
        """Evaluations of a step in the middle of a run."""
        return self.counts(scene, 2) - self.counts(scene, 1)

    def kind_on(self, scene: Scene) -> str:
        """What `counts` counts on this scene."""
        return self.kind

    def prepare(self, request: Request) -> Prepared:
        from jax.errors import JAXTypeError

        from contactbench.methods.numba_engine import NumbaLoop
        from contactbench.methods.step_choice import ChosenStep

        run: type[FixedStepRun] = {"numba": NumbaLoop, "jax": JaxLoop, "python": PythonLoop}[request.engine]
        try:
            if request.step is not None:
                return run(self.name, request, self)
            return ChosenStep(self.name, request, self, run)
        except (CannotRecord, JAXTypeError) as error:
            why = str(error).partition("\n")[0]
            return Refused(
                self.name, request, f"{self.name} on {request.scene.name!r} cannot be compiled: {why}"
            )


def fixed_step(
    name: str, order: int, *, evaluations: int = 1, about: str = "", **claims: Any
) -> Callable[[Step], Step]:
    """Decorator that registers ``step(scene, x, h, xp) -> x`` as a method.

    It then runs on every engine and appears in every table, figure and test.  `claims` are the
    properties it declares: kind, family, contact, symmetric, factor.
    """

    def register(step: Step) -> Step:
        METHODS.add(FixedStep(name, order, step, evaluations, about=about, **claims))
        return step

    return register


@dataclass
class FixedStepRun(Prepared):
    """What the engines share: the division of the run into intervals of equal steps."""

    method_: FixedStep

    def __post_init__(self) -> None:
        super().__post_init__()
        r = self.request
        self.saves_start = r.save_at[0] == 0
        self.marks = np.diff(r.save_at) if self.saves_start else np.diff(r.save_at, prepend=0.0)
        self.ends = r.save_at[1:] if self.saves_start else r.save_at
        self.first_step, self.each_step = self.method_.counts(r.scene, 1), self.method_.per_step(r.scene)
        self.kind = self.method_.kind_on(r.scene)
        self.divide(r.step or math.nan)  # a fixed-step request always has one

    def divide(self, step: float) -> None:
        """Divide every interval into the fewest equal steps not longer than `step`."""
        self.n = self.division(step)
        self.h = self.marks / self.n
        self.totals, self.needed = self.cost(self.n), int(self.n.sum())

    def cost(self, n: np.ndarray) -> Counts:
        """Counts of intervals of n[k] steps; every interval starts afresh."""
        steps = int(n.sum())
        evaluations = len(n) * self.first_step + (steps - len(n)) * self.each_step
        return Counts(steps, evaluations, 0, 0, self.kind)

    def steps_at(self, step: float) -> int:
        """How many steps a division by `step` makes."""
        return int(self.division(step).sum())

    def division(self, step: float) -> np.ndarray:
        """Steps in each interval when divided by `step`."""
        spans = zip(self.marks.tolist(), self.ends.tolist(), strict=True)
        return np.array([steps_in(span, step, until) for span, until in spans], dtype=np.int64)

    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        """Packed states after each interval of n[k] steps of size h[k]; shape (k, d)."""
        raise NotImplementedError

    def log_factor(self, y0: np.ndarray, y: np.ndarray) -> np.ndarray | None:
        """As in `Prepared`: the flows are applied once more, in plain floats, from every saved state."""
        r = self.request
        starts = y[:-1] if self.saves_start else np.concatenate([y0[None], y[:-1]])
        logs = [
            self.method_.log_factor(r.scene, r.scene.unpack(start, r.carry), h, n)
            for start, h, n in zip(starts.tolist(), self.h.tolist(), self.n.tolist(), strict=True)
        ]
        known = [log for log in logs if log is not None]
        if len(known) < len(logs):
            return None
        return np.cumsum([0.0, *known] if self.saves_start else known)

    def integrate(self, y0: np.ndarray) -> Outcome:
        r = self.request
        if self.needed > r.max_steps:
            nothing = np.empty((0, len(y0)))
            message = f"{self.needed} steps needed, max_steps = {r.max_steps}"
            return self.finished(y0, nothing, Counts(), Status.budget, message)
        y = self.intervals(y0, self.h, self.n)
        if self.saves_start:
            y = np.concatenate([y0[None], y])
        out = self.finished(y0, y, self.totals)
        return out if out.status is not Status.diverged else self._located(y0, out)

    def _located(self, y0: np.ndarray, out: Outcome) -> Outcome:
        """A divergence pinned down to the step, by bisecting the interval in which it happened."""
        r = self.request
        k = int(np.argmax(np.isnan(out.y).all(axis=1)))  # the first saved time not reached
        i = k - 1 if self.saves_start else k
        good, time = (out.y[k - 1], float(r.save_at[k - 1])) if k else (y0, 0.0)
        h, left = self.h[i], int(self.n[i])
        steps = int(self.n[:i].sum())
        while left > 1:
            half = np.ones_like(self.n)  # the compiled loop has a fixed number of intervals
            half[0] = left // 2
            y = self.intervals(good, np.full(len(half), h), half)[:1]
            if self.first_divergence(y0, y) is None:
                good, time = y[0], time + float(half[0] * h)
                steps, left = steps + int(half[0]), left - int(half[0])
            else:
                left = int(half[0])
        end = time + float(h)
        counts = self.cost(np.array([steps + 1]))
        message = f"left the scene's scale by a factor 1e6 at t = {end:.6g}"
        return Outcome(out.y, counts, Status.diverged, message, end)


class PythonLoop(FixedStepRun):
    """Plain Python floats."""

    sensitivity_source = "forward-mode AD through the same steps, compiled"

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        from contactbench.methods.numba_engine import NumbaLoop

        try:
            return NumbaLoop(self.method, replace(self.request, engine="numba"), self.method_).sensitivity(y0)
        except CannotRecord:
            return JaxSteps(self.method, replace(self.request, engine="jax"), self.method_).sensitivity(y0)

    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        r = self.request
        x = r.scene.unpack(y0.tolist(), r.carry)
        spans = zip(h.tolist(), n.tolist(), strict=True)
        rows = []
        try:
            for state in trajectory(self.method_, r.scene, x, spans, math):
                rows.append(r.scene.pack(state))
        except (OverflowError, ZeroDivisionError, ValueError):  # Python's way to say inf or nan
            rows += [[math.nan] * len(y0)] * (len(n) - len(rows))
        return np.array(rows, dtype=float)


def trajectory(method: FixedStep, scene: Any, x: Any, spans: Any, xp: Any) -> Iterator[Any]:
    """States after each (h, n) of `spans`, on whatever numbers scene, x and xp are made of."""
    for h, n in spans:
        x = method.advance(scene, x, h, n, xp)
        yield x


def rolled(n: Any, body: Callable[[Any], Any], x: Any) -> Any:
    """`repeat` as a compiled loop that asks for loops over stages too: the shortest code."""
    from contactbench.xla import lax

    return lax.fori_loop(0, n, lambda _, x: body(x), x)


rolled.roll = True  # type: ignore[attr-defined]


def unrolled(together: int) -> Repeat:
    """`repeat` as a compiled loop with several steps, stages written out, in a turn."""

    def loop(n: Any, body: Callable[[Any], Any], x: Any) -> Any:
        x = rolled(n // together, lambda x: repeat(together, body, x), x)
        return x if together == 1 else rolled(n % together, body, x)

    return loop


class JaxSteps(FixedStepRun, CompiledRun):
    """The steps as a loop inside a scan over the saved times, to be compiled, and their derivative."""

    sensitivity_source = "forward-mode AD through the numerical map"

    def __post_init__(self) -> None:
        from contactbench.xla import jax

        super().__post_init__()
        saves = len(self.n)
        self.capacity = next((size for size in CAPACITIES if size >= saves), saves)
        # on the device once: converting them at every call would cost as much as a short run
        self.fixed = jax.device_put(self.spans(self.h, self.n))

    def spans(self, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        """The arguments of the program; intervals beyond those asked for have no steps."""
        padded = np.zeros((2, self.capacity))
        padded[:, : len(n)] = h, n
        return self.together(self.request.scene.numbers(), *padded)

    def divide(self, step: float) -> None:
        super().divide(step)
        if hasattr(self, "fixed"):  # a step for one call: not worth moving ahead of it
            self.fixed = self.spans(self.h, self.n)

    def key(self) -> tuple[Any, ...]:
        return (self.method_, self.capacity)

    def differentiable(self, y0: Any, fixed: Any) -> Any:
        """The same map as shorter code: stages in loops, one step a turn.  Slower, but its derivative
        compiles in a fraction of the time."""
        return self.states(y0, fixed, short=True)

    def states(self, y0: Any, fixed: Any, short: bool = False) -> Any:
        from contactbench.xla import jnp, lax

        numbers, h, n = self.apart(fixed)
        r, xp = self.request, XlaNumbers()
        scene = r.scene.with_numbers(list(numbers))
        loop = rolled if short else unrolled(self.steps_a_turn())

        def interval(x: Any, span: Any) -> Any:
            h, n = span
            x = self.method_.advance(scene, x, h, n, xp, loop)
            return x, jnp.stack(scene.pack(x))

        return lax.scan(interval, scene.unpack(list(y0), r.carry), (h, n.astype(int)))[1]

    def steps_a_turn(self) -> int:
        """Steps written out per turn of the loop: a turn costs XLA some 4 ns whatever it does."""
        return max(1, UNROLL // self.each_step)

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        derivative = super().sensitivity(y0)[: len(self.n)]
        if not self.saves_start:
            return derivative
        scene = self.request.scene
        start = scene.unpack(tuple(y0.tolist()), self.request.carry)
        return np.concatenate([np.array([scene.pack(v) for v in scene.tangents(start)]).T[None], derivative])


class JaxLoop(JaxSteps):
    """The compiled steps."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.program, self.compile_s = self.compiled("run", self.states, self._own_start, self.fixed)

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return np.asarray(self.program(self.placed(y0), self.fixed))[len(self.n) - 1]

    def integrate(self, y0: np.ndarray) -> Outcome:
        if self._saves == self.capacity == 1 and self.needed <= self.request.max_steps:
            y = np.asarray(self.program(self.placed(y0), self.fixed))
            out = self.at_end(y0, y[0].tolist(), y, self.totals)
            if out.checked:  # else the step at which it diverged is to be found
                return out
        return super().integrate(y0)

    def intervals(self, y0: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        fixed = self.fixed if n is self.n else self.spans(h, n)
        return np.asarray(self.program(self.placed(y0), fixed))[: len(n)]
