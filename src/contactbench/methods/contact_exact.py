"""The isotropically damped rigid body in closed form: one evaluation for any time, no steps.

Every saved state comes from the initial one by the flow `free_damp`, so that errors do not add up.  There is
neither step nor tolerance to be set: the result has the digits that round-off of the phase leaves.  An
evaluation counts as the rotations it costs, few where the attitude is not carried (see `MOMENTUM_COST`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from contactbench.methods.base import CALLBACKS, METHODS, Method
from contactbench.methods.fixed_step_run import NumbaLoop, PythonLoop
from contactbench.methods.jax_engine import CompiledRun
from contactbench.methods.prepared import Outcome, Prepared, Request
from contactbench.numbers.control import Repeat, XlaNumbers
from contactbench.scene import Scene
from contactbench.scene.rigid_body import FREE_COST, MOMENTUM_COST
from contactbench.solution import Counts, Status
from contactbench.xla import jax, jnp


def evolve(scene: Any, x: Any, t: Any, xp: Any) -> Any:
    flow = scene.flows["free_damp"]
    return flow.apply(scene, x, flow.constants(scene, t, xp), xp)


class ExactRun(Prepared):
    """A step from the initial state to every saved time, each a fixed-step run of its own."""

    sensitivity_source = "forward-mode AD through the closed form"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.connect()

    def connect(self) -> None:
        r, method = self.request, METHODS[self.method]
        run = {"numba": NumbaLoop, "python": WrittenLoop}[r.engine]
        to = [replace(r, save_at=self.later[k : k + 1], step=t) for k, t in enumerate(self.later.tolist())]
        self.runs = [run(self.method, request, method) for request in to]
        self.compile_s = self.runs[0].compile_s

    def log_factor(self, y0: np.ndarray, y: np.ndarray) -> np.ndarray:
        return -self.request.scene.conformal_rate * self.request.save_at

    def states_at(self, y0: np.ndarray) -> np.ndarray:
        """Packed states at the `later` times, NaN where there are no numbers; shape (k, d)."""
        return np.array([run.bare(y0) for run in self.runs])

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return self.runs[-1].bare(y0)

    def integrate(self, y0: np.ndarray) -> Outcome:
        needed = len(self.later)
        if needed > self.request.max_steps:
            message = f"{needed} evaluations needed, max_steps = {self.request.max_steps}"
            return self.finish(y0, np.empty((0, len(y0))), Counts(), Status.budget, message)
        each = FREE_COST if "R" in self.request.carry else MOMENTUM_COST
        counts = Counts(needed, needed * each, 0, 0, "rotation")
        return self.finish(y0, self.from_start(y0, self.states_at(y0)), counts)

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        columns = np.array(self.tangents(y0)).T
        return self.from_start(columns, np.concatenate([run.sensitivity(y0) for run in self.runs]))


class WrittenLoop(PythonLoop):
    """The closed form as it is written, whose series end where plain numbers no longer change."""

    def record(self) -> None:
        """Nothing: recorded, the series would have the fixed length of arrays."""


class ExactJax(ExactRun, CompiledRun):
    def connect(self) -> None:
        self.compile(self.states, self.together(self.request.scene.numbers(), self.times()))

    def states(self, y0: Any, fixed: Any) -> Any:
        numbers, times = self.apart(fixed)
        r, xp = self.request, XlaNumbers()
        scene = r.scene.with_numbers(list(numbers))
        x = scene.unpack(list(y0), r.carry)
        return jax.vmap(lambda t: jnp.stack(scene.pack(evolve(scene, x, t, xp))))(times)

    def states_at(self, y0: np.ndarray) -> np.ndarray:
        return self.call(y0)[: self._saves][-len(self.later) :]

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return self.call(y0)[self._saves - 1]

    sensitivity = CompiledRun.sensitivity


@dataclass(frozen=True)  # its fields are its definition
class ExactMethod(Method):
    name: str = "contact-exact"
    about: str = (
        "the damped rigid body by Jacobi's elliptic functions; Celledoni et al., doi:10.1137/070704393"
    )
    order: int | None = None
    engines: tuple[str, ...] = ("numba", "jax", "python")
    family: str = "contact"
    contact: bool = True
    adaptive: bool = False
    exact: bool = True
    tolerance: str = "nothing: the result has the digits that round-off of the phase leaves"

    def refuses(self, scene: Scene) -> str | None:
        if "free_damp" in scene.flows:
            return scene.own_equations
        return f"{self.name} solves free rigid bodies with isotropic damping; scene {scene.name!r} is none"

    def step_cost(self, scene: Scene, engine: str) -> float | None:
        """Saved times are as many as steps."""
        return FREE_COST if engine in CALLBACKS else None

    def advance(self, scene: Any, x: Any, h: Any, n: Any, xp: Any, repeat: Repeat | None = None) -> Any:
        """The state after the time nh, for engines that write loops of steps."""
        return evolve(scene, x, n * h, xp)

    def counts(self, scene: Scene, n: int, carry: Sequence[str] | None = None) -> int:
        return n * FREE_COST

    def per_step(self, scene: Scene, carry: Sequence[str] | None = None) -> int:
        return FREE_COST

    def kind_on(self, scene: Scene) -> str:
        return "rotation"

    def prepare(self, request: Request) -> Prepared:
        return (ExactJax if request.engine == "jax" else ExactRun)(self.name, request)


METHODS.add(ExactMethod())
