"""The isotropically damped rigid body in closed form: one evaluation for any time, no steps.

Every saved state comes from the initial one by the flow `free_damp`, so that errors do not add up.  There is
neither step nor tolerance to be set: the result has the digits that round-off of the phase leaves.  An
evaluation counts as the rotations it costs, few where the attitude is not carried (see `MOMENTUM_COST`).
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import replace
from typing import Any

import numpy as np

from contactbench.methods.base import CALLBACKS, METHODS, Method
from contactbench.methods.fixed_step_run import Loop, loop_of
from contactbench.methods.jax_engine import CompiledRun
from contactbench.methods.prepared import NO_NUMBER, Outcome, Prepared, Request
from contactbench.numbers.control import Repeat, XlaNumbers
from contactbench.scene import Scene
from contactbench.solution import Counts, Status
from contactbench.splitting.flows import FREE_COST, MOMENTUM_COST, flows_of


def evolve(scene: Any, x: Any, t: Any, xp: Any) -> Any:
    """The state at time t from state x at time 0."""
    flow = flows_of(scene)["free_damp"]
    return flow.apply(scene, x, flow.constants(scene, t, xp), xp)


class ExactRun(Prepared):
    """What the engines share."""

    def log_factor(self, y0: np.ndarray, y: np.ndarray) -> np.ndarray:
        """−γt, as every flow of the scene."""
        return -self.request.scene.conformal_rate * self.request.save_at

    @abstractmethod
    def states_at(self, y0: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Packed states at the last of the saved times, as far as there are numbers for them; shape (k, d)."""

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return self.states_at(y0, self.request.save_at[-1:])[-1]

    def integrate(self, y0: np.ndarray) -> Outcome:
        needed = len(self.later)
        if needed > self.request.max_steps:
            message = f"{needed} evaluations needed, max_steps = {self.request.max_steps}"
            return self.finish(y0, np.empty((0, len(y0))), Counts(), Status.budget, message)
        y = self.from_start(y0, self.states_at(y0, self.later))
        each = FREE_COST if "R" in self.request.carry else MOMENTUM_COST
        return self.finish(y0, y, Counts(needed, needed * each, 0, 0, "rotation"))


class ExactPython(ExactRun):
    """Plain Python floats."""

    sensitivity_source = "forward-mode AD through the closed form, compiled"

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        return ExactNumba(self.method, replace(self.request, engine="numba")).sensitivity(y0)

    def states_at(self, y0: np.ndarray, times: np.ndarray) -> np.ndarray:
        scene: Any = self.request.scene
        x, rows = scene.unpack(y0.tolist(), self.request.carry), []
        try:
            for t in times.tolist():
                rows.append(scene.pack(evolve(scene, x, t, math)))
        except NO_NUMBER:
            rows.append([math.nan] * len(y0))
        return np.array(rows, dtype=float)


class ExactNumba(ExactRun):
    """Recorded as a loop of one step, compiled by LLVM, and called once for every saved time.

    The loops of the special functions have the fixed length of arrays, and what the time alone decides
    is computed ahead of a call.
    """

    sensitivity_source = "forward-mode AD through the closed form"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.loop = self.loop_to_a_time()
        self.run, self.compile_s = self.loop.run, self.loop.seconds
        self.rows, self.shapes = self.ahead(self.loop)

    def loop_to_a_time(self, tangent: bool = False) -> Loop:
        method: Any = METHODS[self.method]
        return loop_of(method, self.request.scene, self.request.carry, tangent)

    def ahead(self, loop: Loop) -> tuple[np.ndarray, list[np.ndarray]]:
        """What depends on the saved times only, and the arguments that say which of it is which time's."""
        times = self.request.save_at
        rows, shape = loop.rows(np.array(self.request.scene.numbers()), times, np.ones(len(times), dtype=int))
        common, which = shape[: -len(times)], shape[-len(times) :]
        return rows, [np.append(common, row) for row in which]

    def bare(self, y0: np.ndarray) -> np.ndarray:
        after = np.empty((1, len(y0)))
        self.run(y0, self.rows, self.shapes[-1], after)
        return after[0]

    def states_at(self, y0: np.ndarray, times: np.ndarray) -> np.ndarray:
        y = np.empty((len(times), len(y0)))
        for k, shape in enumerate(self.shapes[-len(times) :]):
            self.run(y0, self.rows, shape, y[k : k + 1])
        return y

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        loop, tangents, d = self.loop_to_a_time(tangent=True), self.tangents(y0), len(y0)
        rows, shapes = self.ahead(loop)
        y = np.empty((len(shapes), len(tangents), 2 * d))
        for j, tangent in enumerate(tangents):
            for k, shape in enumerate(shapes):
                loop.run(np.concatenate([y0, tangent]), rows, shape, y[k, j : j + 1])
        return y[:, :, d:].transpose(0, 2, 1)


class ExactJax(ExactRun, CompiledRun):
    """All saved times at once, compiled."""

    sensitivity_source = "forward-mode AD through the closed form"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.compile(self.states, self.together(self.request.scene.numbers(), self.times()))

    def key(self) -> tuple[Any, ...]:
        return (self.method, self.capacity)

    def states(self, y0: Any, fixed: Any) -> Any:
        from contactbench.xla import jax, jnp

        numbers, times = self.apart(fixed)
        r, xp = self.request, XlaNumbers()
        scene = r.scene.with_numbers(list(numbers))
        x = scene.unpack(list(y0), r.carry)
        return jax.vmap(lambda t: jnp.stack(scene.pack(evolve(scene, x, t, xp))))(times)

    def states_at(self, y0: np.ndarray, times: np.ndarray) -> np.ndarray:
        return self.call(y0)[: self._saves][-len(times) :]


RUNS: dict[str, type[ExactRun]] = {"numba": ExactNumba, "jax": ExactJax, "python": ExactPython}


class ExactMethod(Method):
    """A closed form for any time: neither step nor tolerance."""

    name = "contact-exact"
    about = "the damped rigid body by Jacobi's elliptic functions; Celledoni et al., doi:10.1137/070704393"
    order = None
    engines = tuple(RUNS)
    family = "contact"
    contact = True
    adaptive = False
    exact = True
    tolerance = "nothing: the result has the digits that round-off of the phase leaves"

    def refuses(self, scene: Scene) -> str | None:
        if scene.kind == "isotropic body":
            return scene.own_equations
        return f"{self.name} solves rigid bodies with isotropic damping; scene {scene.name!r} is none"

    def step_cost(self, scene: Scene, engine: str) -> float | None:
        """Saved times are as many as steps."""
        return FREE_COST if engine in CALLBACKS else None

    def advance(self, scene: Any, x: Any, h: Any, n: Any, xp: Any, repeat: Repeat | None = None) -> Any:
        """The state after the time nh, for engines that write loops of steps."""
        return evolve(scene, x, n * h, xp)

    def prepare(self, request: Request) -> Prepared:
        return RUNS[request.engine](self.name, request)


METHODS.add(ExactMethod())
