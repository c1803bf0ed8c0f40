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

from collections.abc import Hashable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

from contactbench.numbers.dual import Dual, slope
from contactbench.scene import Scene, System, dot
from contactbench.scene.cache import key


class Bundle(NamedTuple):
    """A state and its tangent vectors, each a state of the same fields."""

    x: Any
    v: tuple[Any, ...]


@dataclass(frozen=True, kw_only=True)
class Variational(System):
    """The variational equations of `base` with `count` tangent vectors."""

    base: Scene
    count: int

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
        base, carry = self.base, self.carried(z)
        rows = derivative(base, z.x, carry)
        v = (base.unpack([dot(row, flat) for row in rows], carry) for flat in map(base.pack, z.v))
        return Bundle(base.rhs(z.x), tuple(v))

    def jacobian(self, z: Bundle) -> list[list[Any]]:
        """diag(Df, …, Df), for the implicit solvers.

        What is left out, the coupling D²f(y) v_j of the tangents to the state, is strictly block
        triangular: Newton's iteration converges all the same, the tangents one iteration after the
        state, and the convergence test of the solver sees both.
        """
        rows = derivative(self.base, z.x, self.carried(z))
        moved = [self.base.without_clock(row) for row in self.base.without_clock(rows)]
        blocks = [rows] + [moved] * self.count
        size, found = sum(map(len, blocks)), list[list[Any]]()
        for block in blocks:
            before = [0.0] * len(found)
            found += [[*before, *row, *[0.0] * (size - len(before) - len(row))] for row in block]
        return found

    def carried(self, z: Bundle) -> tuple[str, ...]:
        return tuple(name for name in self.base.optional if getattr(z.x, name) is not None)


def derivative(scene: Scene, x: Any, carry: tuple[str, ...]) -> list[list[Any]]:
    """Df at x, rows in packed order: the scene's own Jacobian, or its right-hand side on dual numbers."""
    with suppress(NotImplementedError):
        rows = scene.jacobian(x)
        if rows is not None:
            return rows
    y = scene.pack(x)
    columns = []
    for j in range(len(y)):
        moved = [Dual(c, 1.0 if i == j else 0.0) for i, c in enumerate(y)]
        columns.append([slope(c) for c in scene.pack(scene.rhs(scene.unpack(moved, carry)))])
    return [list(row) for row in zip(*columns, strict=True)]
