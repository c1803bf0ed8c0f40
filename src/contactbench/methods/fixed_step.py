"""A fixed-step method given by its step map, on every engine: an integrator is one function or one short class."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from contactbench.methods.base import METHODS, Prepared, Refused, Request
from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.jax_engine import JaxLoop
from contactbench.methods.numba_engine import NumbaLoop
from contactbench.methods.python_engine import PythonLoop
from contactbench.methods.step_choice import ChosenStep
from contactbench.methods.step_map import Step, StepMap
from contactbench.numbers.recording import CannotRecord

ENGINES: dict[str, type[FixedStepRun]] = {"numba": NumbaLoop, "jax": JaxLoop, "python": PythonLoop}


@dataclass(frozen=True)
class FixedStep(StepMap):
    """A step map on the engines; see `StepMap` for what it declares."""

    def prepare(self, request: Request) -> Prepared:
        run = ENGINES[request.engine]
        try:
            if request.step is not None:
                return run(self.name, request, self)
            return ChosenStep(self.name, request, self, run)
        except CannotRecord as why:
            what = f"{self.name} on {request.scene.name!r} cannot be compiled"
            return Refused(self.name, request, f"{what}: {why}")


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
