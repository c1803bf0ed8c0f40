"""The isotropically damped rigid body in closed form: every saved state from the initial one, no steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from contactbench.methods.base import CALLBACKS, METHODS, Method
from contactbench.methods.loops import Plain, Recorded, StepLoop
from contactbench.methods.prepared import Outcome, Prepared, Request
from contactbench.numbers.control import Repeat
from contactbench.numbers.protocol import Arithmetic, Count, Namespace
from contactbench.scene import Scene
from contactbench.scene.base import OwnState
from contactbench.scene.rigid_body import FREE_COST, MOMENTUM_COST
from contactbench.solution import Counts, Status


@dataclass
class ExactRun(Prepared):
    """A step from the initial state to every saved time."""

    loop: StepLoop[Any]

    sensitivity_source = "forward-mode AD through the closed form"
    composed = True

    def __post_init__(self) -> None:
        super().__post_init__()
        one = np.ones(1, dtype=np.int64)
        self.steps = [(self.later[k : k + 1], one) for k in range(len(self.later))]
        self.ready = [self.loop.ready(*step) for step in self.steps]
        self.bare = self.loop.last(self.ready[-1])  # type: ignore
        self.compile_s = self.loop.seconds

    def integrate(self, y0: np.ndarray) -> Outcome:
        needed = len(self.later)
        if needed > self.request.max_steps:
            message = f"{needed} evaluations needed, max_steps = {self.request.max_steps}"
            return self.finish(y0, np.empty((0, len(y0))), Counts(), Status.budget, message)
        each = FREE_COST if "R" in self.request.carry else MOMENTUM_COST
        counts = Counts(needed, needed * each, 0, 0, "rotation")
        y = np.concatenate([self.loop.take(y0, ready)[0] for ready in self.ready])
        return self.finish(y0, self.from_start(y0, y), counts)

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        tangents = self.tangents(y0)
        columns = [np.concatenate([self.loop.tangent(y0, v, *step) for step in self.steps]) for v in tangents]
        return self.from_start(np.array(tangents).T, np.stack(columns, axis=-1))


@dataclass(frozen=True)  # its fields are its definition
class ExactMethod(Method):
    name: str = "contact-exact"
    about: str = (
        "the damped rigid body by Jacobi's elliptic functions; Celledoni et al., doi:10.1137/070704393"
    )
    order: int | None = None
    engines: tuple[str, ...] = ("llvm", "python")
    family: str = "contact"
    contact: bool = True
    adaptive: bool = False
    exact: bool = True
    tolerance: str = "nothing: the result has the digits that round-off of the phase leaves"

    def refuses(self, scene: Scene) -> str | None:
        if "free_damp" in scene.flows:
            return scene.own_equations
        return f"{self.name} solves free rigid bodies with isotropic damping; scene {scene.name!r} is none{scene.lacks}"

    def step_cost(self, scene: Scene, engine: str) -> float | None:
        """Return the cost of a saved time: it takes one step."""
        return FREE_COST if engine in CALLBACKS else None

    def advance(
        self, scene: Any, x: OwnState, h: Arithmetic, n: Count, xp: Namespace, repeat: Repeat | None = None
    ) -> OwnState:
        """Return the state after the time n h."""
        flow = scene.flows["free_damp"]
        return flow.apply(scene, x, flow.constants(scene, n * h, xp), xp)

    def prepare(self, request: Request) -> Prepared:
        # in Python its series end at convergence, and are not recorded
        python = request.engine == "python"
        loop = Plain(self, request, recorded=False) if python else Recorded(self, request)
        return ExactRun(self.name, request, loop)


METHODS.add(ExactMethod())
