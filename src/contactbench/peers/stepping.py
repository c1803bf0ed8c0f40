"""Methods of fixed steps in other libraries, and their loop."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np

from contactbench.methods.base import CALLBACKS, Method
from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.loops import StepLoop
from contactbench.methods.prepared import Prepared, Refused, Request
from contactbench.scene import Scene

#: evaluations of one call of a library, which nothing ends: some hundredths of a second
PIECE = 10**6


class LibrarySteps(StepLoop[list[tuple[float, int]]]):
    """Take the steps of a library by calls ``advance(y, h, n)``, which share its memory."""

    derivative = ""
    method: Any
    scene: Any

    def __init__(self, method: Any, request: Request) -> None:
        super().__init__(method, request)
        self.alone = Lock()

    @abstractmethod
    def advance(self, y: np.ndarray, h: float, n: int) -> np.ndarray:
        """Return the packed state n steps of h after another."""

    def ready(self, h: np.ndarray, n: np.ndarray) -> list[tuple[float, int]]:
        return list(zip(h.tolist(), n.tolist(), strict=True))

    def take(self, y0: np.ndarray, ready: list[tuple[float, int]]) -> tuple[np.ndarray, int | None]:
        rows, y, most = [], y0, max(1, PIECE // self.method.stages)
        with self.alone:
            for h, n in ready:
                for done in range(0, n, most):
                    y = self.advance(y, h, min(most, n - done))
                rows.append(y)
        return np.array(rows), None


@dataclass(frozen=True)
class Stepper(Method):
    """A method of another library that takes equal steps; solver : its name there; stages : gradients of a step."""

    name: str
    order: int
    about: str
    loop: Callable[[Stepper, Request], LibrarySteps]
    package: str
    stages: int = 1
    solver: str = ""
    symmetric: bool = False
    engines: tuple[str, ...] = ("c",)
    adaptive = False
    one_step = False
    tolerance = "nothing: it takes a step"

    def refuses(self, scene: Scene) -> str | None:
        return self.lacks(self.engines[0]) or self.unfit(scene)

    @abstractmethod
    def unfit(self, scene: Scene) -> str | None:
        """Return why the library does not take a scene, or None."""

    def prepare(self, request: Request) -> Prepared:
        try:
            own: Any = self
            return FixedStepRun(self.name, request, own, self.loop(self, request))
        except ImportError as why:
            return Refused(self.name, request, str(why))

    def counts(self, scene: Scene, n: int, carry: Sequence[str] | None = None) -> int:
        return n * self.stages

    def per_step(self, scene: Scene, carry: Sequence[str] | None = None) -> int:
        return self.stages

    def kind_on(self, scene: Scene) -> str:
        return "gradient"

    def step_cost(self, scene: Scene, engine: str) -> float | None:
        return 3 * self.stages if engine in CALLBACKS else None

    def composed(self, scene: Scene) -> bool:
        return self.contact

    def modified_hamiltonian(self, scene: Scene, x: object, h: float) -> None:
        return None
