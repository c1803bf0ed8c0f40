"""How a run ended: the states a solver reached, judged before they are a solution."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from contactbench.methods.request import Request
from contactbench.scene import Scene
from contactbench.solution import Counts, Status, divergence_bound, first_divergence


@dataclass(slots=True)
class Outcome:
    """What integrating gave: packed states (NaN where not reached), counts, and how it ended.

    checked : the states are known to be finite and the last one to be at the end.
    steps : the step chosen in this run, and the longest taken, where the run chose one.
    """

    y: np.ndarray
    counts: Counts
    status: Status
    message: str
    end_time: float
    checked: bool = False
    steps: tuple[float, float] | None = None


class Saves:
    """The packed states that a request wants saved, and how those a solver reached are judged."""

    request: Request

    def __post_init__(self) -> None:
        r = self.request
        self._own_start = np.array(r.scene.pack(r.scene.initial(r.carry)), dtype=float)
        self._motion, self._clock, self._end = r.scene.motion, r.scene.clock, float(r.save_at[-1])
        self._bounded = isinstance(r.scene, Scene) and r.scene.bounds_energy
        self._saves = len(r.save_at)
        self.saves_start = r.save_at[0] == 0
        #: the saved times > 0
        self.later = r.save_at[1:] if self.saves_start else r.save_at

    @property
    def start(self) -> np.ndarray:
        """The scene's own initial state, packed."""
        return self._own_start

    def from_start(self, y0: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the saved states, of those at `later` times: the initial one before them where it is saved."""
        return np.concatenate([y0[None], y]) if self.saves_start else y

    def tangents(self, y0: np.ndarray) -> list[np.ndarray]:
        """Return the scene's tangent vectors at a packed state, packed."""
        r = self.request
        start = r.scene.unpack(tuple(y0.tolist()), r.carry)
        return [np.array(r.scene.pack(v), dtype=float) for v in r.scene.tangents(start)]

    # -- the time, which some solvers have of their own ------------------------------------------------
    def split_clock(self, y0: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the time at which a packed state begins, 0 where it has none, and the components less the time."""
        clock = self._clock
        if clock is None:
            return 0.0, y0
        y = y0[:clock] if clock == len(y0) - 1 else np.concatenate((y0[:clock], y0[clock + 1 :]))
        return float(y0[clock]), y

    def insert_clock(self, y: np.ndarray, start: float, times: Any) -> np.ndarray:
        """Return packed states, of components less the time: (k, ·) at k times since `start`, or a single one."""
        clock = self._clock
        if clock is None:
            return y
        packed = np.empty((*y.shape[:-1], y.shape[-1] + 1))  # a tenth of the time of np.insert
        packed[..., :clock], packed[..., clock + 1 :] = y[..., :clock], y[..., clock:]
        packed[..., clock] = start + times
        return packed

    def at_saved_times(self, y0: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return saved states whose time is the saved one, not the sum of many steps; NaN where not reached."""
        y, clock = y.copy(), self._clock
        y[:, clock] = np.where(np.isnan(y[:, clock]), math.nan, y0[clock] + self.request.save_at)
        return y

    # -- how a run ended -------------------------------------------------------------------------------
    def first_divergence(self, y0: np.ndarray, y: np.ndarray) -> int | None:
        """Return the index of the first saved state in y that is not finite or out of scale, or None."""
        return first_divergence(y, self._motion, divergence_bound(y0[: self._motion]))

    def finish(
        self,
        y0: np.ndarray,
        y: np.ndarray,
        counts: Counts,
        status: Status = Status.ok,
        message: str = "",
        stopped: tuple[float, np.ndarray] | None = None,
    ) -> Outcome:
        """Return an outcome from the saved states reached so far: checked for divergence, padded with NaN.

        stopped : time and state at which a solver gave up.  Where that state is out of scale the solver
        was right to, and the run has diverged by then: steps shrink without end before a singularity.
        """
        bad = self.first_divergence(y0, y)
        if bad is None and status is Status.ok and len(y) == self._saves:
            return Outcome(y, counts, status, message, self._end, True)
        times, reached, left = self.request.save_at, len(y), "left the scene's scale by a factor 1e6"
        if bad is not None:
            y, reached = y[:bad], bad
            status, message = Status.diverged, f"{left} before t = {times[bad]:.6g}"
        if reached < len(times):
            if status is Status.ok:
                status, message = Status.failed, f"stopped before t = {times[reached]:.6g}"
            y = np.concatenate([y, np.full((len(times) - reached, len(y0)), math.nan)])
        end = float(times[reached - 1]) if reached else 0.0
        if status is not Status.ok and stopped is not None:
            end = max(end, min(stopped[0], float(times[-1])))
            if self.first_divergence(y0, stopped[1][None]) is not None:
                status, message = Status.diverged, f"{left} by t = {end:.10g}"
        return Outcome(y, counts, status, message, end)

    def audit(self, y0: np.ndarray, out: Outcome) -> Outcome:
        """Return the outcome, an `ok` taken back that cannot be true."""
        if out.status is Status.ok and not out.checked:
            out = self._at_the_end(out)
        if out.status is Status.ok and self._bounded:
            out = self._without_rise(y0, out)
        return out

    def _at_the_end(self, out: Outcome) -> Outcome:
        """Take an `ok` back from a run that ended elsewhere or without a number."""
        if out.end_time != self._end:
            message = f"ended at t = {out.end_time:.6g}, not at t = {self._end:.6g}"
            return replace(out, y=np.full_like(out.y, math.nan), status=Status.failed, message=message)
        if not np.isfinite(out.y[-1]).all():
            return replace(out, status=Status.diverged, message="not finite at the end")
        return out

    def _without_rise(self, y0: np.ndarray, out: Outcome) -> Outcome:
        """Take an `ok` back where H0 ends above its start by more than all its terms there.

        No motion of a scene that `bounds_energy` does so: the steps are far too long for it.  An error that is
        small beside the terms at the end, after a start next to an equilibrium, is no such rise.
        """
        r = self.request
        x = r.scene.unpack(y0.tolist(), r.carry)
        start = r.scene.energy(x)
        most = start + r.scene.energy_terms(x)  # no motion from there reaches it
        x = r.scene.unpack(out.y[-1].tolist(), r.carry)
        end = r.scene.energy(x)
        if not (end > most > start and end - start > r.scene.energy_terms(x) / 2):
            return out
        energies = r.scene.energy(r.scene.unpack(out.y.T, r.carry))
        first = int(np.argmax(energies > most))
        y, time = out.y.copy(), float(r.save_at[first])
        y[first:] = math.nan
        message = f"H0 rose from {start:.6g} to {end:.6g}, above all that the scene allows: a smaller step is needed"
        return replace(out, y=y, status=Status.diverged, message=message, end_time=time, checked=True)
