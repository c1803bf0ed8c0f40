"""What the solvers of other libraries have in common."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from contactbench.methods.base import Adaptive
from contactbench.methods.prepared import Prepared, Refused, Request
from contactbench.peers.variational import Bundle, Variational
from contactbench.scene import Scene


@dataclass(frozen=True)
class Peer(Adaptive):
    """A solver of another library.

    run : its prepared run, of name, request and the method; raises `ImportError` where the library cannot be used.
    solver : its name in the library.  package : what must be installed.  stages : evaluations of an attempted step,
    where that is fixed.  implicit : whether it takes a Jacobian.  costs : see `step_cost`, by engine.
    """

    name: str
    about: str
    run: Callable[[str, Request, Peer], Prepared]
    engines: tuple[str, ...]
    rtol_range: tuple[float, float]
    solver: str = ""
    package: str = ""
    order: int | None = None
    stages: int | None = None
    implicit: bool = False
    takes_atol: bool = True
    costs: Mapping[str, float] = field(default_factory=dict)
    own_time = True

    def refuses(self, scene: Scene) -> str | None:
        if self.package and importlib.util.find_spec(self.package) is None:
            return f"{self.package} is not installed (pip install contactbench[bench])"
        return None

    def step_cost(self, scene: Scene, engine: str) -> float | None:
        return self.costs.get(engine)

    def prepare(self, request: Request) -> Prepared:
        try:
            return self.run(self.name, request, self)
        except ImportError as why:
            return Refused(self.name, request, str(why))


@dataclass
class PeerRun(Prepared):
    """A run whose derivative is that of the variational equations."""

    method_: Peer

    sensitivity_source = "variational equations, a run of its own"

    def variational(self) -> Self:
        """The same run of the scene together with its tangent vectors."""
        base = self.request.scene
        count = len(base.tangents(base.initial(self.request.carry)))
        name = f"variational equations of {base.name}"
        larger: Any = Variational(name=name, t_end=base.t_end, base=base, count=count)
        return replace(self, request=replace(self.request, scene=larger))

    def linearised(self, y0: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        scene, d, run = self.request.scene, len(y0), self.variational()
        larger: Any = run.request.scene
        x = scene.unpack(tuple(y0.tolist()), self.request.carry)
        y = run.integrate(np.array(larger.pack(Bundle(x, tuple(scene.tangents(x)))), dtype=float)).y
        v = y[:, d:].reshape(len(y), larger.count, -1)
        if scene.clock is not None:
            v = np.insert(v, scene.clock, np.where(np.isnan(y[:, :1]), np.nan, 0.0), axis=2)
        return y[:, :d], np.moveaxis(v, 1, 2)
