"""SciPy's DOP853 and Radau, stepped directly (what `solve_ivp` does, less its bookkeeping).

Hairer, Nørsett, Wanner, Solving ODEs I, §II.5 (DOP853) and II, §IV.8 (Radau IIA, order 5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from contactbench.methods.base import CLAMPED, METHODS, Adaptive
from contactbench.methods.prepared import NO_NUMBER, Outcome, Prepared, Request
from contactbench.peers.callback import CallbackPeer
from contactbench.solution import Counts, Status

#: evaluations DOP853 adds for the interpolant of a step
INTERPOLANT = 3
#: and before the first step
BEFORE = 2


def starts(solver: Any) -> bool:
    """Return whether the first step is finite: with one that is not, SciPy would never return."""
    return math.isfinite(solver.h_abs)


def factor(a: np.ndarray) -> Any:
    """Return the LU factors of a matrix, as `scipy.linalg.lu_factor` does inside its wrappers."""
    from scipy.linalg.lapack import dgetrf, zgetrf

    if not np.isfinite(a).all():
        raise ValueError("array must not contain infs or NaNs")
    return (zgetrf if a.dtype == complex else dgetrf)(a, overwrite_a=True)


def solve(lu: Any, b: np.ndarray) -> np.ndarray:
    """Return the solution for a right-hand side, as `scipy.linalg.lu_solve` does inside its wrappers."""
    from scipy.linalg.lapack import dgetrs, zgetrs

    if not np.isfinite(b).all():
        raise ValueError("array must not contain infs or NaNs")
    return (zgetrs if lu[0].dtype == complex else dgetrs)(lu[0], lu[1], b, overwrite_b=True)[0]


@dataclass
class ScipyRun(CallbackPeer):
    #: evaluations of an attempted step; None where that varies
    stages: int | None = None

    def problem(self, y0: np.ndarray, calls: list[int] | None = None) -> tuple[float, np.ndarray, Any]:
        """When it begins, the components less the time, and SciPy's solver.  calls : counts the evaluations."""
        import scipy.integrate

        r, rhs, jacobian = self.request, self.rhs, self.jacobian
        start, y = self.split_clock(y0)

        def f(t: float, y: np.ndarray) -> Any:
            return rhs(start + t, y.tolist())

        def counting(t: float, y: np.ndarray) -> Any:
            assert calls is not None
            calls[0] += 1
            return f(t, y)

        options: dict[str, Any] = {"rtol": r.rtol, "atol": r.atol}
        if jacobian is not None:
            options["jac"] = lambda t, y: np.array(jacobian(start + t, y.tolist()))
        solver = getattr(scipy.integrate, self.solver)
        return start, y, solver(f if calls is None else counting, 0.0, y, self._end, **options)

    def bare(self, y0: np.ndarray) -> np.ndarray:
        start, _, solver = self.problem(y0)
        if not starts(solver):
            return np.full_like(y0, math.nan)
        while solver.status == "running":
            solver.step()
        return self.insert_clock(solver.y, start, self._end)

    def integrate(self, y0: np.ndarray) -> Outcome:
        r, times, calls = self.request, self.request.save_at, [0]
        differenced = self.newton and self.jacobian is None  # SciPy's nfev leaves those calls out
        try:
            start, y, solver = self.problem(y0, calls if differenced else None)
        except NO_NUMBER as error:  # the right-hand side failed at the initial state
            message = f"{type(error).__name__}: {error} (t = 0)"
            counts = Counts(0, calls[0], 0, None)
            return self.finish(y0, np.empty((0, len(y0))), counts, Status.failed, message)
        rows = [y] if self.saves_start else []
        steps, interpolated, status, message = 0, 0, Status.ok, ""
        try:
            if not starts(solver):
                raise OverflowError("the first step is not finite")
            if self.newton:  # the wrappers take half of the time; `bare`, which is timed, has them
                solver.lu, solver.solve_lu = factor, solve
            while len(rows) < len(times):
                if steps == r.max_steps:
                    status, message = Status.budget, f"max_steps = {r.max_steps} spent at t = {solver.t:.6g}"
                    break
                note = solver.step()
                steps += 1
                if solver.status == "failed":
                    status, message = Status.failed, f"{note} (t = {solver.t:.6g})"
                    break
                due = int(np.searchsorted(times, solver.t, side="right"))
                if due > len(rows):
                    interpolated += int(times[len(rows)] < solver.t)
                    rows.extend(self._dense(solver, times[len(rows) : due]))
        except (*NO_NUMBER, np.linalg.LinAlgError) as error:
            status, message = Status.failed, f"{type(error).__name__}: {error} (t = {solver.t:.6g})"
        evaluations = calls[0] or solver.nfev
        counts = Counts(steps, evaluations, solver.njev, self._rejected(steps, evaluations, interpolated))
        stopped = (float(solver.t), np.array(solver.y))
        return self.finish(y0, self.packed(rows, y, start), counts, status, message, stopped)

    def _rejected(self, steps: int, evaluations: int, interpolated: int) -> int | None:
        """Attempts less steps, from the evaluations."""
        if self.stages is None:
            return None
        return (evaluations - BEFORE - INTERPOLANT * interpolated) // self.stages - steps

    @staticmethod
    def _dense(solver: Any, times: np.ndarray) -> list[np.ndarray]:
        if len(times) == 1 and times[0] == solver.t:  # no interpolation at the solver's own point
            return [solver.y.copy()]
        interpolant = solver.dense_output()
        return [solver.y.copy() if t == solver.t else interpolant(t) for t in times]


@dataclass(frozen=True)
class ScipyMethod(Adaptive):
    name: str
    solver: str
    order: int
    about: str
    newton: bool = False
    stages: int | None = None
    engines: tuple[str, ...] = ("python",)
    own_time: bool = True
    rtol_range: tuple[float, float] = (CLAMPED, 1e-1)
    evaluations_per_step: int = 13

    def prepare(self, request: Request) -> Prepared:
        return ScipyRun(self.name, request, self.solver, self.newton, self.stages)


METHODS.add(
    ScipyMethod("scipy-dop853", "DOP853", 8, "explicit Runge–Kutta 8(5,3), Python callbacks", stages=12)
)
_radau = "implicit Radau IIA, analytic Jacobian"
METHODS.add(ScipyMethod("scipy-radau", "Radau", 5, _radau, newton=True, evaluations_per_step=9))
