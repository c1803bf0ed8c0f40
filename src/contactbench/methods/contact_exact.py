"""The isotropically damped rigid body in closed form: one evaluation for any time, no steps.

Every saved state comes from the initial one by the flow `free_damp`, so that errors do not add up.  The
tolerance is not needed: the result has the digits that round-off of the phase leaves.  An evaluation counts
as the rotations it costs (see `FREE_COST`).
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from contactbench.methods.base import METHODS, Adaptive, Outcome, Prepared, Request
from contactbench.methods.compiled import CompiledRun, XlaNumbers
from contactbench.scene import RigidBody, Scene
from contactbench.solution import Counts, Status
from contactbench.splitting.flows import FREE_COST, flows_of


def evolved(scene: Any, x: Any, t: Any, xp: Any) -> Any:
    """The state at time t from state x at time 0."""
    flow = flows_of(scene)["free_damp"]
    return flow.apply(scene, x, flow.constants(scene, t, xp), xp)


class ExactRun(Prepared):
    """What both engines share."""

    @property
    def steps_follow_state(self) -> bool:
        """There are no steps."""
        return False

    def log_factor(self, y0: np.ndarray, y: np.ndarray) -> np.ndarray:
        """−γt, as every flow of the scene."""
        return -self.request.scene.conformal_rate * self.request.save_at

    @abstractmethod
    def states_at(self, y0: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Packed states at times > 0, as far as there are numbers for them; shape (k, d)."""

    def integrate(self, y0: np.ndarray) -> Outcome:
        times = self.request.save_at
        later = times[1:] if times[0] == 0 else times
        if len(later) > self.request.max_steps:
            message = f"{len(later)} evaluations needed, max_steps = {self.request.max_steps}"
            return self.finished(y0, np.empty((0, len(y0))), Counts(), Status.budget, message)
        y = self.states_at(y0, later)
        if times[0] == 0:
            y = np.concatenate([y0[None], y])
        return self.finished(y0, y, Counts(len(later), len(later) * FREE_COST, 0, 0, "rotation"))


class ExactPython(ExactRun):
    """Plain Python floats."""

    sensitivity_source = "forward-mode AD through the closed form on jax"

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        return ExactJax(self.method, replace(self.request, engine="jax")).sensitivity(y0)

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return self.states_at(y0, self.request.save_at[-1:])[-1]

    def states_at(self, y0: np.ndarray, times: np.ndarray) -> np.ndarray:
        scene: Any = self.request.scene
        x, rows = scene.unpack(y0.tolist(), self.request.carry), []
        try:
            for t in times.tolist():
                rows.append(scene.pack(evolved(scene, x, t, math)))
        except (OverflowError, ZeroDivisionError, ValueError):  # Python's way to say inf or nan
            rows.append([math.nan] * len(y0))
        return np.array(rows, dtype=float)


class ExactJax(ExactRun, CompiledRun):
    """All saved times at once, compiled."""

    sensitivity_source = "forward-mode AD through the closed form"

    def __post_init__(self) -> None:
        from contactbench.xla import jax

        super().__post_init__()
        self.fixed = jax.device_put(self.together(self.request.scene.numbers(), self.request.save_at))
        self.program, self.compile_s = self.compiled("run", self.states, self._own_start, self.fixed)

    def key(self) -> tuple[Any, ...]:
        return (self.method, len(self.request.save_at))

    def states(self, y0: Any, fixed: Any) -> Any:
        from contactbench.xla import jax, jnp

        numbers, times = self.apart(fixed)
        r, xp = self.request, XlaNumbers()
        scene = r.scene.with_numbers(list(numbers))
        x = scene.unpack(list(y0), r.carry)
        return jax.vmap(lambda t: jnp.stack(scene.pack(evolved(scene, x, t, xp))))(times)

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return np.asarray(self.program(self.placed(y0), self.fixed))[-1]

    def states_at(self, y0: np.ndarray, times: np.ndarray) -> np.ndarray:
        return np.asarray(self.program(self.placed(y0), self.fixed))[-len(times) :]


@dataclass(frozen=True)
class ExactMethod(Adaptive):
    name: str = "contact-exact"
    about: str = (
        "the damped rigid body by Jacobi's elliptic functions; Celledoni et al., doi:10.1137/070704393"
    )
    order: int | None = None
    engines: tuple[str, ...] = ("jax", "python")
    family: str = "contact"
    contact: bool = True
    exact: bool = True
    tolerance: str = "nothing: the result has the digits that round-off of the phase leaves"

    def refuses(self, scene: Scene) -> str | None:
        if isinstance(scene, RigidBody) and scene.isotropic:
            return None
        return f"{self.name} solves rigid bodies with isotropic damping; scene {scene.name!r} is none"

    def prepare(self, request: Request) -> Prepared:
        return {"jax": ExactJax, "python": ExactPython}[request.engine](self.name, request)


METHODS.add(ExactMethod())
