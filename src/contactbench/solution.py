"""What a run returns: the saved states, how it ended, and what it cost."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from contactbench.errors import BadInput
from contactbench.scene import Scene, rotation_matrix


class Status(StrEnum):
    """The ways a run can end."""

    ok = "ok"
    diverged = "diverged"  # not finite, or beyond 10⁶ times the scene's scale
    budget = "budget"  # the step or evaluation budget was spent
    failed = "failed"  # the solver gave up; its own words are in the message
    timeout = "timeout"
    unsupported = "unsupported"  # this method cannot do this scene; the message says why


class Counts(NamedTuple):
    """What a run cost: accepted steps, evaluations of `kind`, Jacobians, rejected steps.

    kind is "gradient" (∇V), "rhs" (the whole right-hand side), "taylor" (orders of Taylor
    coefficients; each costs about one rhs) or "rotation" (half an rhs; see
    `rhs_equivalents`).  A count is None where the solver does not say; `Prepared.count` may
    find it out.
    """

    steps: int | None = 0
    evaluations: int | None = 0
    jacobians: int = 0
    rejected: int | None = 0
    kind: str = "rhs"

    @property
    def rhs_equivalents(self) -> float | None:
        """Evaluations on the scale of one right-hand side.

        A gradient counts as one (it is nearly all of a mechanical right-hand side); two rotations
        of the rigid body, which together apply its whole vector field once, count as one.
        """
        if self.evaluations is None:
            return None
        return self.evaluations / 2 if self.kind == "rotation" else float(self.evaluations)


@dataclass
class Solution:
    """Saved states of one run.

    t : saved times, shape (k,).  y : packed states, shape (k, d), NaN where the run did not get.
    q, p : (k, n); s : (k,); M : (k, 3); R : (k, 3, 3); a field the run did not carry is None.
    end_time : how far the run got.
    """

    scene: Scene
    method: str
    engine: str
    setting: str
    carry: tuple[str, ...]
    t: np.ndarray
    y: np.ndarray
    status: Status = Status.ok
    message: str = ""
    counts: Counts = field(default_factory=Counts)
    end_time: float = float("nan")
    #: the initial state y was integrated from, packed
    y0: np.ndarray | None = None
    #: () -> states (k, d) and their derivative (k, d, m) along the m tangents of the initial state
    differentiate: Callable[[], tuple[np.ndarray, np.ndarray]] | None = None
    #: how it is obtained, for the tables; empty where it is not available
    sensitivity_source: str = ""
    #: what was set, "step" or "rtol", and its value
    control: str = ""
    value: float = float("nan")

    @property
    def ok(self) -> bool:
        return self.status is Status.ok

    @property
    def sensitivity(self) -> np.ndarray:
        """Derivative of the saved states along the scene's m tangents at the start, (k, d, m).

        Raises `BadInput` where the method does not provide it.
        """
        return self.linearised[1]

    @cached_property
    def linearised(self) -> tuple[np.ndarray, np.ndarray]:
        """`sensitivity`, and the states (k, d) at which it is the derivative.

        These are `y`, or, where the solver integrated the variational equations in a run of its
        own, the states of that run, which differ from y by as much as the tolerance allows.
        """
        if self.differentiate is None or not self.sensitivity_source:
            raise BadInput(f"{self.method} ({self.engine}): no derivative of the numerical map is available")
        return self.differentiate()

    @property
    def labels(self) -> list[str]:
        return self.scene.labels(self.carry)

    def _columns(self, prefix: str) -> np.ndarray | None:
        index = [i for i, name in enumerate(self.labels) if name.startswith(prefix)]
        return self.y[:, index] if index else None

    @property
    def q(self) -> np.ndarray | None:
        return self._columns("q")

    @property
    def p(self) -> np.ndarray | None:
        return self._columns("p")

    @property
    def M(self) -> np.ndarray | None:
        return self._columns("M")

    @property
    def s(self) -> np.ndarray | None:
        return self.y[:, -1] if "s" in self.carry else None

    @property
    def quaternion(self) -> np.ndarray | None:
        """The attitude as integrated, (k, 4), w first."""
        return self._columns("R_")

    @property
    def R(self) -> np.ndarray | None:
        quaternion = self.quaternion
        if quaternion is None:
            return None
        return np.moveaxis(np.array(rotation_matrix(tuple(quaternion.T))), -1, 0)

    def states(self) -> Any:
        """All saved states at once: a state whose components are arrays over the saved times."""
        return self.scene.unpack(tuple(self.y.T), self.carry)

    def start(self) -> Any:
        """The initial state."""
        if self.y0 is None:
            raise BadInput(f"{self.method}: this solution does not know its initial state")
        return self.scene.unpack(tuple(self.y0.tolist()), self.carry)


#: a run has diverged when |q|, |p| or |M| exceed this many times the scene's scale
DIVERGENCE = 1e6
FEW = 64


def divergence_bound(motion: np.ndarray) -> float:
    """10⁶ times the size of the initial (q, p) or M; of 1 where that is zero."""
    return DIVERGENCE * (math.sqrt(float(motion @ motion)) or 1.0)


def first_divergence(y: np.ndarray, size: int, bound: float) -> int | None:
    """Index of the first row of y that is not finite, or whose first `size` entries pass the bound."""
    # the common case first, without an overflow; a few numbers are worth no NumPy, many are
    largest = math.hypot(*y.ravel().tolist()) if y.size <= FEW else np.abs(y).max()
    if largest <= bound:  # nan fails every comparison
        return None
    bad = ~(np.isfinite(y).all(axis=1) & (np.abs(y[:, :size]).max(axis=1) <= bound))
    return int(np.argmax(bad)) if bad.any() else None
