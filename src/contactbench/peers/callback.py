"""Solvers that call back into Python: right-hand sides and Jacobians of plain floats.

They are as lean as what a user would write for one problem: the scene is recorded once as a plain Python
function, its numbers written in as constants.  Where it cannot be recorded (a force that branches on values)
it is called as it is, at four times the cost.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from contactbench.methods.prepared import Prepared
from contactbench.numbers.protocol import CannotRecord
from contactbench.peers.c_functions import derivative
from contactbench.peers.variational import SOURCE, run_variational, variational_request
from contactbench.scene import System
from contactbench.trace.form import Function, Unpack
from contactbench.trace.python import execute
from contactbench.trace.recording import Recorded, Tape, attempt

Rows = list[list[float]]


@dataclass
class CallbackPeer(Prepared):
    """A run of a solver whose right-hand side, and Jacobian if it takes one, are Python."""

    solver: str
    #: whether it solves its steps by Newton's iteration, and takes a Jacobian
    newton: bool = True

    sensitivity_source = SOURCE

    def __post_init__(self) -> None:
        super().__post_init__()
        scene, carry = self.request.scene, self.request.carry
        self.rhs = flat_rhs(scene, carry)
        self.jacobian = flat_jacobian(scene, carry) if self.newton else None

    def packed(self, rows: list[np.ndarray], y: np.ndarray, start: float) -> np.ndarray:
        """Return the packed states of those reached at the saved times; y : the first."""
        return self.insert_clock(np.reshape(rows, (-1, len(y))), start, self.request.save_at[: len(rows)])

    def linearised(self, y0: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        carry = self.request.carry
        larger = variational_request(self.request, lambda scene, x: derivative(scene, x, carry))
        return run_variational(replace(self, request=larger), y0)


def record_function(scene: System, what: str, carry: tuple[str, ...]) -> Callable[..., Any] | None:
    """``f(t, y)`` on a list of floats: the slopes, or rows of a Jacobian; None if it cannot be had."""
    tape = Tape()
    names = tuple(f"y{i}" for i in range(len(scene.without_clock(scene.labels(carry)))))
    t, *y = (Recorded(tape, name, "f", tape.root) for name in ["t", *names])
    slopes = scene.slopes if what == "rhs" else partial(motion_jacobian, scene)
    try:
        results = tape.results(attempt(lambda: slopes(t, y, carry)))
    except (CannotRecord, TypeError):
        return None
    return execute(Function(what, ("t", "y"), (Unpack(names, "y"), *tape.root.statements), results))


def motion_jacobian(scene: System, t: Any, y: Sequence[Any], carry: tuple[str, ...]) -> list[Any]:
    """Rows of ∂f/∂y at (t, y), y and f less the time."""
    rows = scene.jacobian(scene.unpack(scene.with_clock(y, t), carry))
    return [scene.without_clock(row) for row in scene.without_clock(rows)]


def flat_rhs(scene: System, carry: tuple[str, ...]) -> Callable[[float, Sequence[float]], Sequence[float]]:
    """``f(t, y) -> slopes`` on a list of floats."""
    return record_function(scene, "rhs", carry) or (lambda t, y: scene.slopes(t, y, carry))


def flat_jacobian(scene: System, carry: tuple[str, ...]) -> Callable[[float, Sequence[float]], Rows] | None:
    """``J(t, y) -> rows`` on plain floats, or None when the scene has no Hessian."""
    if not scene.has_jacobian:
        return None
    return record_function(scene, "jacobian", carry) or (lambda t, y: motion_jacobian(scene, t, y, carry))
