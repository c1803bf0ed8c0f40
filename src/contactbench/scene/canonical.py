"""The base class of scenes with coordinates q, momenta p, an action s and the contact form η = ds − p·dq."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from contactbench.checks import vector
from contactbench.errors import BadInput
from contactbench.numbers.protocol import Arithmetic
from contactbench.scene.algebra import State, Vector, cross, dot
from contactbench.scene.base import Check, Numeric, Scene, named_numbers


class Canonical(Scene):
    """A scene on T*Rⁿ × R in canonical coordinates."""

    q: Vector
    p: Vector
    parameters: Mapping[str, float]

    state: ClassVar[Any] = State
    initial_fields: ClassVar[tuple[str, ...]] = ("q", "p", "s")
    checks: ClassVar[dict[str, Check]] = {
        **Scene.checks,
        "q": vector,
        "p": vector,
        "parameters": named_numbers,
    }
    canonical = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.q) != len(self.p):
            raise BadInput(f"q has {len(self.q)} components and p {len(self.p)}: they must agree")

    @property
    def rate_changes(self) -> bool:  # type: ignore[override]
        return self.nonlinear_damping

    @property
    def required(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("s",) if self.nonlinear_damping else ()

    def unpack(self, y: Sequence[Arithmetic], carry: Sequence[str]) -> State:
        n = len(self.q)
        return State(tuple(y[:n]), tuple(y[n : 2 * n]), y[2 * n] if "s" in carry else None)

    def contact_form(self, x: State, dx: State) -> Numeric:
        return dx.s - dot(x.p, dx.q)

    def contact_terms(self, x: State, dx: State) -> Numeric:
        if self.mixed:
            return abs(dx.s) + sum(abs(p * v) for p, v in zip(x.p, dx.q, strict=True))
        return abs(dx.s) + dot(x.p, x.p) ** 0.5 * dot(dx.q, dx.q) ** 0.5


def angular_momentum(q: Vector, p: Vector) -> Vector | None:
    """Return q × p: one component in the plane, three in space, None in other dimensions."""
    if len(q) == 2:
        return (q[0] * p[1] - q[1] * p[0],)
    return cross(q, p) if len(q) == 3 else None
