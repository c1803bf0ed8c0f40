"""Methods of fixed steps in other libraries, and their loop."""

from __future__ import annotations

import importlib.util
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


class LibrarySteps(StepLoop):
    """Take the steps of a library, whose memory all calls share."""

    derivative = ""

    def __init__(self, method: Stepper, request: Request) -> None:
        super().__init__(method, request)
        self.alone = Lock()

    def ready(self, h: np.ndarray, n: np.ndarray) -> Any:
        """Return the steps in intervals that are not too long, and which of their ends are asked for."""
        parts = np.maximum(1, -(-n * self.method.stages // PIECE))
        last = np.cumsum(parts) - 1
        each = np.repeat(n // parts, parts)
        each[last] += n - parts * (n // parts)
        return np.repeat(h, parts), each, last

    def march(self, memory: Any, y: np.ndarray, ready: Any) -> np.ndarray:
        """Return what `memory.take` gives from y on, with a look at signals between intervals that are long."""
        h, n, last = ready
        with self.alone:
            if len(last) == len(h):
                return memory.take(y, h, n)
            rows = np.empty((len(h), len(y)))
            for k in range(len(h)):
                y = rows[k] = memory.take(y, h[k : k + 1], n[k : k + 1])[0]
        return rows[last]


@dataclass(frozen=True)
class Stepper(Method):
    """A method of another library that takes equal steps; solver : its name there; stages : gradients of a step."""

    name: str
    order: int
    about: str
    loop: Callable[[Stepper, Request], StepLoop]
    package: str
    stages: int = 1
    solver: str = ""
    symmetric: bool = False
    engines: tuple[str, ...] = ("c",)
    adaptive = False
    one_step = False
    tolerance = "nothing: it takes a step"

    def refuses(self, scene: Scene) -> str | None:
        if importlib.util.find_spec(self.package) is None:
            return f"{self.package} is not installed (pip install contactbench[bench])"
        return self.unfit(scene)

    @abstractmethod
    def unfit(self, scene: Any) -> str | None:
        """Return why the library does not take a scene, or None."""

    def prepare(self, request: Request) -> Prepared:
        try:
            return FixedStepRun(self.name, request, self, self.loop(self, request))
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

    def log_factor(self, scene: Any, x: Any, h: float, n: int) -> float | None:
        return -scene.gamma * h * n if self.contact else None

    def modified_hamiltonian(self, scene: Scene, x: Any, h: float) -> Any | None:
        return None
