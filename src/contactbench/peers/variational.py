"""The variational equations: a scene and its tangent vectors as one larger scene.

    y' = f(y),   v_j' = Df(y) v_j   for every tangent vector v_j of the scene at the initial state.

Any solver runs it as it runs the scene itself, with the same tolerances.  The tangents are part of
the error control, so the steps are those of the larger system and not those of the plain run.  The
derivative belongs to the map of the larger run: contact form and drift are evaluated at the states of
that run, which differ from the plain ones by as much as the tolerance allows (with the plain states
the mismatch would be counted as drift; measured, up to five times the drift itself).

Dieci, Van Vleck, Appl. Numer. Math. 17, 275 (1995), doi:10.1016/0168-9274(95)00033-Q, §1;
Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, §I.14.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np

from contactbench.methods.prepared import Prepared, Request
from contactbench.scene import Scene, System, dot
from contactbench.scene.cache import key

#: ``(scene, x) -> rows``: ∂(rhs)/∂(state) in packed order
Derivative = Callable[[Scene, Any], Any]

SOURCE = "variational equations, a run of its own"


class Bundle(NamedTuple):
    """A state and its tangent vectors, each a state of the same fields."""

    x: Any
    v: tuple[Any, ...]


@dataclass(frozen=True, kw_only=True)
class Variational(System):
    """The variational equations of `base` with `count` tangent vectors."""

    base: Scene
    count: int
    derivative: Derivative

    def labels(self, carry: Sequence[str]) -> list[str]:
        own = self.base.labels(carry)
        moved = self.base.without_clock(own)
        return own + [f"d{j + 1} {name}" for j in range(self.count) for name in moved]

    @property
    def clock(self) -> int | None:
        return self.base.clock  # tangents do not move the time, and have none

    @property
    def motion(self) -> int:
        return self.base.motion  # tangents may grow as they like

    def initial(self, carry: Sequence[str], **data: Any) -> Bundle:
        x = self.base.initial(carry, **data)
        return Bundle(x, tuple(self.base.tangents(x)))

    def unpack(self, y: Sequence[Any], carry: Sequence[str]) -> Bundle:
        base, d = self.base, len(self.base.labels(carry))
        each = len(base.without_clock(y[:d]))
        v = (base.unpack(base.with_clock(y[i : i + each], 0.0), carry) for i in range(d, len(y), each))
        return Bundle(base.unpack(y[:d], carry), tuple(v))

    def pack(self, state: Bundle) -> list[Any]:  # type: ignore[override]
        moved = (self.base.without_clock(System.pack(v)) for v in state.v)
        return [*System.pack(state.x), *(c for v in moved for c in v)]

    def numbers(self) -> list[float]:
        return self.base.numbers()

    def with_numbers(self, numbers: Sequence[Any]) -> Self:
        return self._replaced(base=self.base.with_numbers(numbers))

    @property
    def structure(self) -> tuple[Any, ...]:
        return (Variational, self.count, *self.base.structure)

    @property
    def identity(self) -> Hashable | None:
        return key(self.base.identity, Variational, self.count)

    def rhs(self, z: Bundle) -> Bundle:
        carry = tuple(name for name in self.base.optional if getattr(z.x, name) is not None)
        rows = self.derivative(self.base, z.x)
        pushed = (
            self.base.unpack([dot(row, flat) for row in rows], carry) for flat in map(self.base.pack, z.v)
        )
        return Bundle(self.base.rhs(z.x), tuple(pushed))

    def jacobian(self, z: Bundle) -> list[list[Any]]:
        """diag(Df, …, Df), for the implicit solvers.

        What is left out, the coupling D²f(y) v_j of the tangents to the state, is strictly block
        triangular: Newton's iteration converges all the same, the tangents one iteration after the
        state, and the convergence test of the solver sees both.
        """
        base = self.base
        rows = self.derivative(base, z.x)
        moved = [base.without_clock(row) for row in base.without_clock(rows)]
        blocks = [rows] + [moved] * self.count
        size = sum(map(len, blocks))
        found, before = [], 0
        for block in blocks:
            after = size - before - len(block)
            found += [[*[0.0] * before, *row, *[0.0] * after] for row in block]
            before += len(block)
        return found


def variational_request(request: Request, derivative: Derivative) -> Request:
    """The same question about the scene and its tangents."""
    scene = request.scene
    count = len(scene.tangents(scene.initial(request.carry)))
    larger: Any = Variational(
        name=f"variational equations of {scene.name}",
        t_end=scene.t_end,
        base=scene,
        count=count,
        derivative=derivative,
    )
    return replace(request, scene=larger)


def run_variational(run: Prepared, y0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States (k, d) and tangents (k, d, m) at the saved times, from a run of a `variational_request`.

    NaN where the run did not get.
    """
    scene: Any = run.request.scene
    carry = run.request.carry
    x = scene.base.unpack(tuple(y0.tolist()), carry)
    start = np.array(scene.pack(Bundle(x, tuple(scene.base.tangents(x)))), dtype=float)
    y, d = run.integrate(start).y, len(y0)
    v = y[:, d:].reshape(len(y), scene.count, -1)
    if scene.clock is not None:
        v = np.insert(v, scene.clock, np.where(np.isnan(y[:, :1]), np.nan, 0.0), axis=2)
    return y[:, :d], np.moveaxis(v, 1, 2)
