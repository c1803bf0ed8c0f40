"""A fixed-step method given by its step map, on every engine: an integrator is one function or one short class."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from contactbench.errors import NAME, BadInput, excerpt, function, switch, text, whole
from contactbench.methods.base import FAMILIES, METHODS, Request
from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.jax_engine import JaxLoop
from contactbench.methods.many import MANY_ENGINES
from contactbench.methods.numba_engine import NumbaLoop
from contactbench.methods.prepared import Prepared
from contactbench.methods.python_engine import PythonLoop
from contactbench.methods.step_choice import ChosenStep
from contactbench.methods.step_map import Step, StepMap

ENGINES: dict[str, type[FixedStepRun]] = {"numba": NumbaLoop, "jax": JaxLoop, "python": PythonLoop}


@dataclass(frozen=True)
class FixedStep(StepMap):
    """A step map on the engines; see `StepMap` for what it declares."""

    def prepare(self, request: Request) -> Prepared:
        run = (MANY_ENGINES if request.scene.kind == "many" else ENGINES)[request.engine]
        if request.step is not None:
            return run(self.name, request, self)
        return ChosenStep(self.name, request, self, run)


#: no method has more stages, nor a higher order
MOST = 10**4


def _one_of(allowed: tuple[str, ...]) -> Callable[[str, Any], None]:
    def check(name: str, value: Any) -> None:
        if not isinstance(value, str) or value not in allowed:
            raise BadInput(f"{name} = {excerpt(value)}: must be one of {', '.join(allowed)}")

    return check


#: what a step map may declare, and the check of each
CLAIMS: dict[str, Callable[[str, Any], Any]] = {
    "kind": _one_of(("rhs", "gradient", "rotation")),
    "family": _one_of(FAMILIES),
    "contact": switch,
    "symmetric": switch,
    "factor": function,
}


def fixed_step(
    name: str, order: int, *, evaluations: int = 1, about: str = "", **claims: Any
) -> Callable[[Step], Step]:
    """Decorator that registers ``step(scene, x, h, xp) -> x`` as a method.

    It then runs on every engine and appears in every table, figure and test.  `claims` are the
    properties it declares: kind, family, contact, symmetric, factor.
    Raises `BadInput` for what is none of these.
    """

    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise BadInput(f"method name {excerpt(name)}: must be letters, digits, '_', '.', '+', '-'")
    order, evaluations = whole("order", order, MOST), whole("evaluations", evaluations, MOST)
    text("about", about)
    for claim, value in claims.items():
        if claim not in CLAIMS:
            raise BadInput(f"{excerpt(claim)}: a step map declares {', '.join(CLAIMS)}")
        CLAIMS[claim](claim, value)

    def register(step: Step) -> Step:
        function("step map", step)
        METHODS.add(FixedStep(name, order, step, evaluations, about=about, **claims))
        return step

    return register
