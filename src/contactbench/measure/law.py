"""What a law is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from contactbench.boundary import blame
from contactbench.errors import BadInput
from contactbench.measure.deviation import Deviation
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import Scene
from contactbench.solution import Solution


class Undefined(BadInput):
    """A law has nothing to be relative to on a scene, such as H(0) = 0."""


class Gate(Enum):
    """How the regression gate compares a law (the rules of results/schema.py have the numbers)."""

    error = "error"
    structure = "structure"  # an error; where it is round-off it must stay round-off
    count = "count"


@dataclass(frozen=True)
class Measured:
    """What a law gives: its value, the error bar where there is one, and at how many saved times it was
    taken against its terms instead of its own size (None where it has no such limit).

    A drift smaller than its error bar is not known; `value` is then the sum of both, an upper bound.
    """

    value: float
    uncertainty: float | None = None
    clamped: int | None = None

    @property
    def bound(self) -> bool:
        """Whether the value is an upper bound."""
        return self.uncertainty is not None and self.value <= 2 * self.uncertainty


@dataclass(frozen=True)
class Law:
    """A measure, and what those who show or compare it must know.

    definition : its meaning, a header or axis label; label : a short name, mathtext.  needs : the fields it
    reads.  gate : how two runs are compared.  shown : the documents that list it.
    """

    name: str
    definition: str
    label: str
    measure: Callable[[Solution], Deviation | float]
    needs: tuple[str, ...] = ()
    applies: Callable[[Scene], bool] = lambda scene: True
    gate: Gate = Gate.error
    shown: tuple[str, ...] = ("laws",)
    #: whether it takes the derivative of the map, which may cost many runs
    differentiates: bool = False
    #: whether the method of a run promises, on its scene, to keep it at every setting
    claimed: Callable[[Solution], bool] = lambda solution: False

    @property
    def structural(self) -> bool:
        """Whether it is a law of the map itself, kept or not whatever the error of the solution."""
        return self.gate is Gate.structure and "laws" in self.shown and not self.name.endswith("_frozen")

    def __call__(self, solution: Solution) -> float:
        """The measure; nan unless the run ended `ok` and the law is defined for its method.

        Raises `BadInput` when the scene has no such law or the run did not carry what it needs.
        """
        return self.measured(solution).value

    def measured(self, solution: Solution) -> Measured:
        """The measure with its error bar; raises as the call does."""
        found = self.along(solution)
        if not isinstance(found, Deviation):
            return Measured(found)
        value = float(found.size.max())
        marked = None if found.clamped is None else int(found.clamped.sum())
        if found.uncertainty is None:
            return Measured(value, None, marked)
        uncertainty = float(found.uncertainty.max())
        return Measured(value if value > uncertainty else value + uncertainty, uncertainty, marked)

    def along(self, solution: Solution) -> Deviation | float:
        """The deviation at every saved time, where the law is a maximum over them; raises as the call does."""
        if not self.applies(solution.scene):
            raise BadInput(f"law {self.name!r} is not defined for scene {solution.scene.name!r}")
        missing = [f for f in self.needs_on(solution.scene) if f not in solution.carry]
        if missing:
            raise BadInput(f"law {self.name!r} needs carry=({', '.join(map(repr, missing))},)")
        if not solution.ok:
            return math.nan
        try:
            return self.measure(solution)
        except CannotRecord as error:
            raise BadInput(f"law {self.name!r}: {error}") from error
        except Exception as error:
            raise blame(f"law {self.name!r}", error) from error.__cause__

    def needs_on(self, scene: Scene) -> tuple[str, ...]:
        """The optional fields it reads on this scene."""
        return tuple(field for field in self.needs if field in scene.optional)
