"""The registry of methods, and the question that one of them is asked."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from contactbench.errors import Registry
from contactbench.scene import Scene
from contactbench.solution import EXACT, printed_setting

#: name → method, each a `base.Method`
METHODS = Registry("method")
#: Python's way to say inf or nan
NO_NUMBER = (OverflowError, ZeroDivisionError, ValueError)


@dataclass(frozen=True)
class Request:
    """A validated question to a method: what to solve, how finely, and what to save."""

    scene: Scene
    engine: str
    carry: tuple[str, ...]
    save_at: np.ndarray
    step: float | None = None
    rtol: float | None = None
    atol: float | None = None
    max_steps: int = 10**8

    @property
    def control(self) -> str:
        """What is set: "step", "rtol" or nothing, "exact"."""
        return "step" if self.step is not None else "rtol" if self.rtol is not None else EXACT

    @property
    def value(self) -> float:
        """To what it is set; 0 for nothing."""
        return self.step or self.rtol or 0.0

    @cached_property
    def setting(self) -> str:
        """The setting as it is keyed in tables."""
        return printed_setting(self.control, self.value)
