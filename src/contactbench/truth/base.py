"""What a reference is, and which scene it belongs to."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from importlib.util import find_spec
from time import perf_counter
from typing import Any

import numpy as np

from contactbench.boundary import is_ours
from contactbench.errors import BadInput, array
from contactbench.scene import Scene
from contactbench.scene.many import Many
from contactbench.trace.formula import Formula


class BlowUp(BadInput):
    """The trajectory reaches infinity at `time`, an mpmath number."""

    def __init__(self, scene: Scene, time: Any) -> None:
        super().__init__(
            f"no reference for scene {scene.name!r}: the trajectory blows up at t = {float(time):.6g}"
        )
        self.time = time


class OutOfTime(BadInput):
    """A computation that was given so much time and needs more."""


#: a moment that never comes, on the clock of `perf_counter`
NEVER = math.inf


#: seconds after which the rest of a computation is foreseen, and how many times its budget it may still need
FORESEEN, HOPELESS = 2.0, 4.0


class Stopwatch:
    """The time of one computation of a scene over a span, and what all of it would take."""

    def __init__(self, scene: Scene, span: float, deadline: float) -> None:
        self.scene, self.span, self.deadline, self.begun = scene, span, deadline, perf_counter()

    def is_over(self, t: float) -> bool:
        """Return whether the deadline has passed, or, seen from t, will pass long before the end."""
        now = perf_counter()
        if now <= self.deadline < NEVER and now - self.begun > FORESEEN:
            return self.needed(t) > HOPELESS * (self.deadline - self.begun)
        return now > self.deadline

    def needed(self, t: float) -> float:
        """Return the seconds for the whole span at the pace so far."""
        return (perf_counter() - self.begun) * self.span / t if t > 0 else math.inf

    def check(self, t: float) -> None:
        """Raise `OutOfTime` if it is over."""
        if self.is_over(t):
            more = self.needed(t) - (perf_counter() - self.begun)
            pace = f" (t = {t:.3g} of {self.span:.3g} so far: about {duration(more)} more)" if t > 0 else ""
            faster = "" if find_spec("heyoka") else ", or install heyoka, which is much faster"
            raise OutOfTime(
                f"no reference for scene {self.scene.name!r} in the time it was given{pace}: allow it more, "
                f"or choose an earlier t_end{faster}"
            )


def duration(seconds: float) -> str:
    """Return a duration in the unit that suits it."""
    for unit, size in (("years", 3.156e7), ("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds:.2g} s"


@dataclass(frozen=True, repr=False)
class Reference:
    """The true states of a scene at given times.

    t : (k,).  y : (k, d) float64, correctly rounded, columns as in ``scene.labels(carry)``.
    decimals : the same numbers as k rows of d decimal strings with every digit that is known.
    digits : decimal digits known to be right, relative to the largest entry of a column, the
    worst column.  source : "closed form", "frozen" or "live".
    """

    scene: Scene
    carry: tuple[str, ...]
    t: np.ndarray
    y: np.ndarray
    decimals: list[list[str]]
    digits: int
    source: str

    def __repr__(self) -> str:
        """Return one line: of what, how much of it, how well it is known."""
        what = f"{len(self.t)} states to t = {self.t.max():g}, {self.digits} digits, {self.source}"
        return f"<Reference of {self.scene.name}: {what}>"

    def states(self) -> Any:
        """Return the states as one NamedTuple of arrays over time."""
        return self.scene.unpack(self.y.T, self.carry)


def checked_times(times: Any) -> np.ndarray:
    """Return `times` as a new float array of shape (k,), k ≥ 1, or `BadInput`."""
    t = np.array(array("times", times, "finite numbers ≥ 0"), ndmin=1)  # a copy
    if t.ndim != 1 or not t.size:
        raise BadInput(f"times: must be one number or a flat list of numbers, not of shape {t.shape}")
    for wrong in t[~(np.isfinite(t) & (t >= 0))][:1].tolist():
        raise BadInput(f"times contain {wrong!r}: must be finite numbers ≥ 0")
    return t


def with_decimals(scene: Scene, number: Callable[[str], Any]) -> Scene:
    """Return the scene with every float x, initial data included, replaced by ``number(repr(x))``."""

    def convert(value: Any) -> Any:
        return tuple(map(convert, value)) if isinstance(value, tuple) else number(repr(float(value)))

    start = {name: convert(getattr(scene, name)) for name in scene.initial_fields}
    return scene.with_numbers([convert(x) for x in scene.numbers()])._replaced(**start)


def _definition(function: Any) -> list[str]:
    """Return a function of this package by its name; a user's by what it computes, or, unknown, as none other."""
    if is_ours(function):
        return [function.__module__, function.__qualname__]
    return ["", function.digest if isinstance(function, Formula) else f"unknown {id(function)}"]


def fingerprint(value: Any) -> Any:
    """Return numbers as the decimals they print as; of an array, which may have millions, its hash."""
    if isinstance(value, np.ndarray):
        return hashlib.sha256(value.tobytes()).hexdigest()
    return [repr(float(x)) for x in np.ravel(value)]


def digest(scene: Scene) -> str:
    """Return the SHA-256 of what determines the trajectory: kind, functions, numbers and initial data.

    The scene's own name, its end time, and the Hessian and closed form (which follow from the rest)
    do not count.
    """
    functions = [
        [f.name, *_definition(value)]
        for f in fields(scene)
        if f.name not in ("exact", "hessian") and callable(value := getattr(scene, f.name))
    ]
    kind = type(scene)
    package = ".".join(kind.__module__.split(".")[:2])  # where it is imported from, not where it is written
    if isinstance(scene, Many):  # hashed as arrays: numbers may be millions
        functions.append([scene.sites, scene.dimensions, getattr(scene, "boundary", "")])
    definition = [
        f"{package}.{kind.__qualname__}",
        functions,
        list(getattr(scene, "parameters", {})),
        [repr(float(x)) for x in scene.numbers()],
        [fingerprint(getattr(scene, name)) for name in (*scene.initial_fields, *getattr(scene, "constants", ()))],
    ]
    return hashlib.sha256(json.dumps(definition).encode()).hexdigest()
