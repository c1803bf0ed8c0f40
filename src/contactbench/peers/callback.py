"""Solvers that call back into Python: right-hand sides and Jacobians of plain floats.

They are as lean as what a user would write for one problem: the scene is recorded once as a plain Python
function, its numbers written in as constants.  Where it cannot be recorded (a force that branches on values)
it is called as it is, at four times the cost.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from contactbench.numbers.protocol import CannotRecord
from contactbench.peers.base import PeerRun
from contactbench.scene import System
from contactbench.trace.form import Function, Unpack
from contactbench.trace.python import execute
from contactbench.trace.recording import Recorded, Tape, attempt


@dataclass
class CallbackPeer(PeerRun):
    """A run of a solver whose right-hand side, and Jacobian if it takes one, are Python.

    rhs : ``(t, y) -> slopes`` and jacobian : ``(t, y) -> rows``, on a list of floats; None where there is none.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        scene, carry = self.request.scene, self.request.carry
        self.rhs = record_function(scene, "rhs", carry) or (lambda t, y: scene.slopes(t, y, carry))
        self.jacobian: Callable[[float, Any], Any] | None = None
        if self.method_.implicit and scene.has_jacobian:
            self.jacobian = record_function(scene, "jacobian", carry) or (
                lambda t, y: motion_jacobian(scene, t, y, carry)
            )

    def slopes(self, calls: list[int] | None) -> Callable[[float, Any], Any]:
        """The right-hand side; calls : its first entry counts the evaluations."""
        rhs = self.rhs
        if calls is None:
            return rhs

        def counting(t: float, y: Any) -> Any:
            calls[0] += 1
            return rhs(t, y)

        return counting

    def packed(self, rows: list[np.ndarray], y: np.ndarray, start: float) -> np.ndarray:
        """The packed states of those reached at the saved times; y : the first."""
        return self.insert_clock(np.reshape(rows, (-1, len(y))), start, self.request.save_at[: len(rows)])


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
