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

from contactbench.errors import BadInput
from contactbench.scene import Scene


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


def in_time(scene: Scene, deadline: float) -> None:
    """Raise `OutOfTime` once the deadline is over."""
    if perf_counter() > deadline:
        faster = "" if find_spec("heyoka") else ", or install heyoka, which is much faster"
        raise OutOfTime(
            f"no reference for scene {scene.name!r} in the time it was given: allow it more, or choose an "
            f"earlier t_end{faster}"
        )


@dataclass(frozen=True)
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

    def states(self) -> Any:
        """The states as one NamedTuple of arrays over time."""
        return self.scene.unpack(tuple(self.y.T), self.carry)


def checked_times(times: Any) -> np.ndarray:
    """`times` as a new float array of shape (k,), k ≥ 1, or `BadInput`."""
    try:
        t = np.atleast_1d(np.array(times, dtype=float))
    except (TypeError, ValueError):
        raise BadInput(f"times = {times!r}: must be finite numbers ≥ 0") from None
    if t.ndim != 1 or not t.size:
        raise BadInput(f"times: must be one number or a flat list of numbers, not of shape {t.shape}")
    for wrong in t[~(np.isfinite(t) & (t >= 0))][:1].tolist():
        raise BadInput(f"times contain {wrong!r}: must be finite numbers ≥ 0")
    return t


def with_decimals(scene: Scene, number: Callable[[str], Any]) -> Scene:
    """The scene with every float x, initial data included, replaced by ``number(repr(x))``."""

    def convert(value: Any) -> Any:
        return tuple(map(convert, value)) if isinstance(value, tuple) else number(repr(float(value)))

    start = {name: convert(getattr(scene, name)) for name in scene.initial_fields}
    return scene.with_numbers([convert(x) for x in scene.numbers()])._replaced(**start)


def digest(scene: Scene) -> str:
    """SHA-256 of what determines the trajectory: kind, functions, numbers and initial data.

    The scene's own name, its end time, and the Hessian and closed form (which follow from the rest)
    do not count.
    """
    functions = [
        [f.name, getattr(value, "__module__", ""), getattr(value, "__qualname__", repr(value))]
        for f in fields(scene)
        if f.name not in ("exact", "hessian") and callable(value := getattr(scene, f.name))
    ]
    kind = type(scene)
    package = ".".join(kind.__module__.split(".")[:2])  # where it is imported from, not where it is written
    definition = [
        f"{package}.{kind.__qualname__}",
        functions,
        list(getattr(scene, "parameters", {})),
        [repr(float(x)) for x in scene.numbers()],
        [[repr(float(x)) for x in np.ravel(getattr(scene, name))] for name in scene.initial_fields],
    ]
    return hashlib.sha256(json.dumps(definition).encode()).hexdigest()
