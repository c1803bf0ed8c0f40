"""A prepared run: compiled, and called with initial data."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from time import perf_counter
from typing import Any

import numpy as np

from contactbench.boundary import blame
from contactbench.errors import BadInput, excerpt
from contactbench.methods.differences import differences
from contactbench.methods.outcome import Outcome, Saves
from contactbench.methods.request import METHODS, NO_NUMBER, Request
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import Scene
from contactbench.solution import Counts, Differential, Solution, Status


@dataclass
class Prepared(Saves, ABC):
    """A compiled solver: call it, with other initial data if you like, to get a `Solution`.

    A solver's own class writes `integrate`; `bare` where there is a faster way to the last state; and, where its
    map can be differentiated, `sensitivity` (or `linearised`) together with `sensitivity_source`.

    It belongs to what the scene's functions computed when it was prepared.  A function that cannot be recorded is
    called as it is; where that is so, and something has changed since, a call computes with the change.
    """

    method: str
    request: Request
    #: seconds spent tracing and compiling; zero where nothing is compiled
    compile_s: float = field(default=0.0, kw_only=True)

    #: of fixed steps: the step asked for, and the longest taken
    steps_taken = (math.nan, math.nan)
    #: how `sensitivity` differentiates the map of the steps taken; empty: it cannot
    sensitivity_source = ""

    def __init_subclass__(cls) -> None:
        """The short repr, which `dataclass` would replace in every class."""
        super().__init_subclass__()
        cls.__repr__ = Prepared.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        """One line: what a call runs."""
        r = self.request
        saved = f"{len(r.save_at)} states to t = {r.save_at[-1]:g}"
        return f"<{self.method} on {r.scene.name} ({r.engine}, {r.setting}), prepared: a call gives {saved}>"

    def __reduce__(self) -> Any:
        """Pickled as what it was prepared from."""
        return prepare_again, (self.method, self.request)

    def __call__(self, **data: Any) -> Solution:
        r, y0 = self.request, self._own_start
        if data:
            start = r.scene.initial(r.carry, **r.scene.checked(data))
            begins(r.scene, start)
            y0 = np.array(r.scene.pack(start), dtype=float)
        try:
            out = self.integrate(y0)
        except BaseException as error:
            raise blame(f"{self.method} on scene {r.scene.name!r}", error) from error.__cause__
        out = self.audit(y0, out)
        if self._clock is not None:
            out.y = self.at_saved_times(y0, out.y)
        return Solution(
            *self._common,
            *(out.y, y0, out.status, out.message, out.counts, out.end_time),
            *(self, r.control, r.value),
            *(out.steps or self.steps_taken),
        )

    @cached_property
    def _common(self) -> tuple[Scene, str, str, str, tuple[str, ...], np.ndarray]:
        """The first fields of all solutions of this run."""
        r = self.request
        return r.scene, self.method, r.engine, r.setting, r.carry, r.save_at

    @property
    def atol(self) -> float | None:
        """The absolute tolerance of the run, where its method takes one."""
        return self.request.atol

    @abstractmethod
    def integrate(self, y0: np.ndarray) -> Outcome:
        """Run from a packed initial state."""

    def bare(self, y0: np.ndarray) -> np.ndarray:
        """The solver's own call, by its fastest way: packed initial state to packed final state, unchecked."""
        return self.integrate(y0).y[-1]

    # -- the map of the steps taken --------------------------------------------------------------------
    @property
    def steps_follow_state(self) -> bool:
        """Whether other initial data may mean other steps: then `sensitivity` is not that of the map."""
        return self.request.rtol is not None

    def sensitivity(self, y0: np.ndarray) -> np.ndarray:
        """(k, d, m): derivative of the saved states along the scene's m tangents at y0, steps held fixed."""
        raise BadInput(f"{self.method} ({self.request.engine}): its map cannot be differentiated")

    def linearised(self, y0: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Saved states (k, d) and their derivative (k, d, m), of one and the same numerical map.

        y : the saved states of the plain run.  A solver that has to run anew for the derivative
        gives the states of that run instead.
        """
        return y, self.sensitivity(y0)

    def differential(self, y0: np.ndarray, out: Outcome, frozen: bool) -> Differential:
        """dΦ of the map its user gets, or with the steps frozen.

        To round-off where the engine can, else by differences of the solver.
        """
        if self.sensitivity_source and (frozen or not self.steps_follow_state):
            with suppress(CannotRecord):  # a function that dual numbers do not know
                states, derivative = self.linearised(y0, out.y)
                return Differential(self.sensitivity_source, states, derivative[None])
        if frozen and self.steps_follow_state:
            return Differential("", out.y, np.empty((0, *out.y.shape, 0)))
        return differences(self, y0, out)

    def log_factor(self, y0: np.ndarray, y: np.ndarray) -> np.ndarray | None:
        """Log of the product of the conformal factors of the contact maps applied, up to each saved time, (k,).

        y : the saved states.  None where a run is no composition of such maps.
        """
        return None

    def modified_hamiltonian(self, x: Any) -> Any | None:
        """H̃ at x (see `splitting.modified`), None where the run is not known to be the flow of one."""
        return None


def prepare_again(method: str, request: Request) -> Prepared:
    """Return a run that has come out of a pickle."""
    return METHODS[method].prepare(request)


class Refused(Prepared):
    """A prepared 'no': every call gives a solution with status `unsupported`."""

    def __init__(self, method: str, request: Request, why: str) -> None:
        super().__init__(method, request)
        self.why = why

    def integrate(self, y0: np.ndarray) -> Outcome:
        nothing = np.full((len(self.request.save_at), len(y0)), math.nan)
        return Outcome(nothing, Counts(), Status.unsupported, self.why, 0.0)


def begins(scene: Scene, start: Any) -> None:
    """Raise `BadInput` unless the equations have a finite slope at an initial state.

    Some solvers, SciPy's among them, never return from a first step that is not a number.
    """
    try:
        slope = [float(component) for component in scene.pack(scene.rhs(start))]
    except NO_NUMBER as error:
        if isinstance(error, BadInput):
            raise
        slope = [math.nan]
    except BaseException as error:
        raise blame(f"scene {scene.name!r}", error) from error.__cause__
    if not math.isfinite(math.hypot(*slope)):
        raise BadInput(
            f"initial data: the right-hand side of scene {scene.name!r} is not finite there: {excerpt(start)}"
        )


def stopwatch() -> Any:
    """Return a function that returns the seconds since it was made."""
    start = perf_counter()
    return lambda: perf_counter() - start
