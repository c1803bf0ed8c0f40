"""What the solvers that call back into Python share: right-hand sides and Jacobians of plain floats.

They are as lean as what a user would write for one problem: the scene is recorded once as a plain Python
function, its numbers written in as constants.  Where it cannot be recorded (a force that branches on values)
it is called as it is, at four times the cost.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from contactbench.methods.base import Request
from contactbench.methods.variational import Variational, numerical_derivative, variational_request
from contactbench.numbers.recording import CannotRecord, Recorded, Tape, executed, text_of
from contactbench.numbers.recording import recorded as within
from contactbench.scene import Mechanical, Scene, State


def recorded(scene: Scene, what: str, carry: tuple[str, ...]) -> Callable[..., Any] | None:
    """``f(y)`` on a packed list of floats: the list of slopes, or rows of a Jacobian; None if it cannot be had."""
    tape = Tape()
    names = [f"y{i}" for i in range(len(scene.labels(carry)))]
    y = [Recorded(tape, name, "f", tape.root) for name in names]
    try:
        value = within(lambda: getattr(scene, what)(scene.unpack(y, carry)))
        rows = [scene.pack(value)] if what == "rhs" else value
        texts = [f"[{', '.join(map(text_of, row))}]" for row in rows]
    except (CannotRecord, TypeError):
        return None
    lines = [f"def {what}(y):", f"    {', '.join(names)}, = y", *tape.root.lines]
    result = texts[0] if what == "rhs" else f"[{', '.join(texts)}]"
    return executed("\n".join([*lines, f"    return {result}", ""]))[what]


def flat_rhs(scene: Scene, carry: tuple[str, ...]) -> Callable[[Sequence[float]], list[float]]:
    """``f(y) -> slopes`` on a packed list of floats."""
    if (lean := recorded(scene, "rhs", carry)) is not None:
        return lean
    rhs = scene.rhs
    if isinstance(scene, Mechanical) and not carry:
        n = len(scene.q)

        def short(y: Sequence[float]) -> list[float]:
            dx = rhs(State(tuple(y[:n]), tuple(y[n:])))
            return [*dx.q, *dx.p]

        return short
    if isinstance(scene, Variational):
        return flat_variational(scene, carry)
    unpack, pack = scene.unpack, scene.pack
    return lambda y: pack(rhs(unpack(y, carry)))


def flat_variational(scene: Variational, carry: tuple[str, ...]) -> Callable[[Sequence[float]], list[float]]:
    """``scene.rhs`` with the tangents pushed by one matrix product: four times as fast."""
    base, derivative = scene.base, scene.derivative
    size = len(base.labels(carry))

    def pushed(y: Sequence[float]) -> list[float]:
        x = base.unpack(y[:size], carry)
        tangents = np.array(y[size:]).reshape(scene.count, size)
        rows = np.array(derivative(base, x))
        return [*base.pack(base.rhs(x)), *(tangents @ rows.T).ravel().tolist()]

    return pushed


def flat_jacobian(
    scene: Scene, carry: tuple[str, ...]
) -> Callable[[Sequence[float]], list[list[float]]] | None:
    """``J(y) -> rows`` on packed plain floats, or None when the scene has no Hessian."""
    jacobian = getattr(scene, "jacobian", None)
    if jacobian is None or (isinstance(scene, Mechanical) and scene.hessian is None):
        return None
    return recorded(scene, "jacobian", carry) or (lambda y: jacobian(scene.unpack(y, carry)))


def variational(request: Request) -> Request:
    """The same question about the scene and its tangents, on plain floats."""
    return variational_request(request, numerical_derivative(request.scene, request.carry))
