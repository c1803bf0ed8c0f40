"""Laws, and the deviation of a decaying quantity from its law relative to its present size."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from contactbench.blame import blame
from contactbench.errors import BadInput
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import Scene
from contactbench.solution import Solution

#: smaller numbers lose relative precision by gradual underflow
MEANINGFUL = np.finfo(float).tiny / np.finfo(float).eps
#: H, J and Φ*η are differences of larger terms that cancel under strong damping: a deviation is relative to the true
#: size, but at least to this part of the terms ("clamped"), so that round-off stays below 10⁻¹²
ATTAINABLE = 1e-3


class Deviation(NamedTuple):
    """Deviations from a law at the saved times, each of shape (k,).

    uncertainty : error bars, None if the deviation is computed to round-off.  clamped : whether the deviation is
    relative to a thousandth of the terms instead of the true size; None if the law has no such limit.
    """

    size: np.ndarray
    uncertainty: np.ndarray | None = None
    clamped: np.ndarray | None = None


class Undefined(BadInput):
    """Report that a law has no reference size on a scene, such as H(0) = 0."""


class Gate(Enum):
    """Rules by which the regression gate compares a law; see `tables.schema`."""

    error = "error"
    structure = "structure"  # an error; where it is round-off it must stay round-off
    count = "count"


@dataclass(frozen=True)
class Measured:
    """Hold a law's value, its error bar and the number of clamped saved times; the last two may be None."""

    value: float
    uncertainty: float | None = None
    clamped: int | None = None

    @property
    def bound(self) -> bool:
        """Return whether the value is an upper bound."""
        return self.uncertainty is not None and self.value <= UNSURE * self.uncertainty


@dataclass(frozen=True)
class Law:
    """Define a measure of a solution and its properties.

    Parameters
    ----------
    name
        A key in `LAWS` and the name of a column.
    measure
        ``measure(solution)``: the deviation at the saved times, or one number.
    applies
        ``applies(scene)``: whether the scene has this law.
    differentiates
        Whether it needs the derivative of the map, which may cost many runs.
    claimed
        ``claimed(solution)``: whether the method of the run claims to keep it on the scene at every setting.
    definition, label
        Its meaning, and a short label for headers and axes.
    needs
        The optional fields that it reads.
    gate
        How two runs are compared.

    Raises
    ------
    BadInput
        On a call, if the scene has no such law or the run did not carry a field that it needs.
    """

    name: str
    definition: str
    label: str
    measure: Callable[[Solution], Deviation | float]
    needs: tuple[str, ...] = ()
    applies: Callable[[Scene], bool] = lambda scene: True
    gate: Gate = Gate.error
    differentiates: bool = False
    claimed: Callable[[Solution], bool] = lambda solution: False

    @property
    def about(self) -> str:
        """Return its definition, for lists of the registry."""
        return self.definition

    @property
    def structural(self) -> bool:
        """Return whether it is a law of the map, independent of the error of the solution."""
        return self.gate is Gate.structure

    def __call__(self, solution: Solution) -> float:
        """Return the measure, nan unless the run ended `ok` and the law is defined for its method.

        Raises `BadInput` if the scene has no such law or the run did not carry a field that it needs.
        """
        return self.measured(solution).value

    def measured(self, solution: Solution) -> Measured:
        """Return the measure with its error bar; raises as the call does."""
        found = self.along(solution)
        if not isinstance(found, Deviation):
            return Measured(found)
        value = float(found.size.max())
        clamped = None if found.clamped is None else int(found.clamped.sum())
        uncertainty = None if found.uncertainty is None else float(found.uncertainty.max())
        unknown = uncertainty is not None and not value > uncertainty
        return Measured(value + (uncertainty or 0.0) if unknown else value, uncertainty, clamped)

    def along(self, solution: Solution) -> Deviation | float:
        """Return the deviation at every saved time if the law is a maximum over them; raises as the call does.

        A structural law is judged at ends of steps, where other times were saved too.
        """
        if not self.applies(solution.scene):
            raise BadInput(f"law {self.name!r} is not defined for scene {solution.scene.name!r}")
        missing = [f for f in self.needs_on(solution.scene) if f not in solution.carry]
        if missing:
            raise BadInput(f"law {self.name!r} needs carry=({', '.join(map(repr, missing))},)")
        if not solution.ok:
            return math.nan
        try:
            return self.measure(solution.at_steps if self.structural else solution)
        except CannotRecord as error:
            raise BadInput(f"law {self.name!r}: {error}") from error
        except Exception as error:
            raise blame(f"law {self.name!r}", error) from error.__cause__

    def needs_on(self, scene: Scene) -> tuple[str, ...]:
        return tuple(field for field in self.needs if field in scene.optional)


def conformal(
    values: np.ndarray,
    start: np.ndarray,
    t: np.ndarray,
    rate: float | np.ndarray,
    terms: float | np.ndarray = 0.0,
    error: np.ndarray | None = None,
) -> Deviation:
    """Return ‖values − e^{−γt} start‖ / max(e^{−γt} ‖start‖, ATTAINABLE · terms) at each time, γ the rate.

    values : (k, m).  start : (m,).  terms : (k,), the size of the terms that cancel in the values.  error : (k,), the
    error bar of the values.  If the denominator is below the meaningful range, the deviation is the excess of the value
    over that range (0 if the value has underflowed too).
    """
    norm = np.linalg.norm(start, axis=-1) or 1.0
    true_log, bar = np.log(norm) - rate * t, None
    attainable = ATTAINABLE * (terms + np.zeros(len(values)))
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        clamped = np.log(attainable) > true_log
        # values are scaled up, since scaling the start down may underflow; in two halves, so that no factor overflows
        half = np.exp(np.minimum(rate * t / 2, 700.0))[:, None]
        against_true = np.linalg.norm(values * half * half - start, axis=1) / norm
        against_terms = np.linalg.norm(values - np.exp(-rate * t)[:, None] * start, axis=1) / attainable
        excess = np.maximum(np.abs(values).max(axis=1) / MEANINGFUL - 1, 0.0)
        if error is not None:
            bar = np.exp(np.log(error) - np.maximum(true_log, np.log(np.maximum(attainable, MEANINGFUL))))
    meaningful = np.where(clamped, attainable > MEANINGFUL, true_log > math.log(MEANINGFUL))
    size = np.where(meaningful, np.where(clamped, against_terms, against_true), excess)
    return Deviation(size, bar, clamped & (t > 0))


# -- round-off -------------------------------------------------------------------------------------
# A law is kept if its deviation is round-off: at most 10⁻¹², or the accumulated rounding of all evaluations.  The
# round-off of a law of the map grows with the derivative of the numerical map; if that was not taken, with the
# condition number of the motion.
#
# A bound above 10⁻⁶ decides nothing, because every method would pass: a deviation below it is undecided, neither kept
# nor broken.  A deviation that differences of the solver do not resolve, or that is clamped at every saved time, is
# undecided too.  A run that does not follow the motion is not judged.
EPSILON = float(np.finfo(float).eps)
#: a larger bound decides nothing
DECIDABLE = 1e-6
#: a structural deviation up to this is round-off
STRUCTURE = 1e-12
#: a deviation of at most this many error bars is only an upper bound
UNSURE = 2.0
#: laws of the state alone, whose round-off the map does not magnify
OF_THE_STATE = ("momentum_law", "attitude_drift", "sphere_drift")
#: columns of a structural law beside its value → their meanings
JUDGEMENT = {
    "claimed": "whether the method promises on this scene to keep it at every setting",
    "kept": "whether the run keeps it to round-off; blank where that is undecided, or the run is not judged because "
    "its solution is off by more than a tenth",
}
#: a run whose solution error is larger does not follow the motion
WRECKED = 0.1


def round_off_bound(growth: float, evaluations: int) -> float:
    """Return ε · evaluations · max(growth, 1); growth : ‖DΦ(t)‖₂ of the map, or the motion's condition number."""
    return float(EPSILON * evaluations * np.maximum(growth, 1.0))


def is_kept(value: float, bound: float, unsure: bool = False, faded: bool = False) -> bool | None:
    """Return whether a deviation shows that a law is kept; None if it is undecided.

    unsure : it is an upper bound.  faded : it is clamped at every saved time.
    """
    if value <= bound:
        return True if (bound <= DECIDABLE or value <= STRUCTURE) and not faded else None
    return None if unsure else False
