"""SciPy's DOP853 and Radau, stepped directly (what `solve_ivp` does, less its bookkeeping).

Hairer, Nørsett, Wanner, Solving ODEs I, §II.5 (DOP853) and II, §IV.8 (Radau IIA, order 5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from contactbench.methods.base import CLAMPED, METHODS, NO_NUMBER, Adaptive, Outcome, Prepared, Request
from contactbench.peers.callback import flat_jacobian, flat_rhs, variational
from contactbench.peers.variational import SOURCE, integrated
from contactbench.solution import Counts, Status

#: evaluations DOP853 adds for the interpolant of a step
INTERPOLANT = 3


def starts(solver: Any) -> bool:
    """Whether the first step is a number: SciPy tries steps that are none without end."""
    return math.isfinite(solver.h_abs)


def factors(a: np.ndarray) -> Any:
    """LU of a matrix, which is overwritten: what `scipy.linalg.lu_factor` calls, without its wrappers."""
    from scipy.linalg.lapack import dgetrf, zgetrf

    if not np.isfinite(a).all():
        raise ValueError("array must not contain infs or NaNs")
    return (zgetrf if a.dtype == complex else dgetrf)(a, overwrite_a=True)


def solved(lu: Any, b: np.ndarray) -> np.ndarray:
    """The solution for a right-hand side, which is overwritten: as `scipy.linalg.lu_solve`."""
    from scipy.linalg.lapack import dgetrs, zgetrs

    if not np.isfinite(b).all():
        raise ValueError("array must not contain infs or NaNs")
    return (zgetrs if lu[0].dtype == complex else dgetrs)(lu[0], lu[1], b, overwrite_b=True)[0]


@dataclass
class ScipyRun(Prepared):
    solver: Any
    stiff: bool
    #: evaluations of an attempted step; None where that varies
    stages: int | None

    sensitivity_source = SOURCE

    def __post_init__(self) -> None:
        super().__post_init__()
        r = self.request
        self.rhs = flat_rhs(r.scene, r.carry)
        self.jacobian = flat_jacobian(r.scene, r.carry) if self.stiff else None

    def problem(self, y0: np.ndarray) -> tuple[float, np.ndarray, Any, dict[str, Any]]:
        """When it begins, the components less the time, f(t, y) for t from 0, and the options of the solver."""
        r, rhs, jacobian = self.request, self.rhs, self.jacobian
        start, y = self.split_clock(y0)
        options: dict[str, Any] = {"rtol": r.rtol, "atol": r.atol}
        if jacobian is not None:
            options["jac"] = lambda t, y: np.array(jacobian(start + t, y.tolist()))
        return start, y, lambda t, y: rhs(start + t, y.tolist()), options

    def bare(self, y0: np.ndarray) -> np.ndarray:
        end = float(self.request.save_at[-1])
        start, y, f, options = self.problem(y0)
        solver = self.solver(f, 0.0, y, end, **options)
        if not starts(solver):
            return np.full_like(y0, math.nan)
        while solver.status == "running":
            solver.step()
        return self.insert_clock(solver.y, start, end)

    def integrate(self, y0: np.ndarray) -> Outcome:
        """Radau without the wrappers of SciPy's linear algebra, nearly half of what it takes: the same to the bit.

        `bare`, which is what is timed, has them.
        """
        return self._stepped(y0, lean=self.stiff)

    def _stepped(self, y0: np.ndarray, lean: bool) -> Outcome:
        r = self.request
        start, y, plain, options = self.problem(y0)
        f, calls = plain, [0]
        if self.stiff and self.jacobian is None:  # SciPy's nfev leaves out the calls that difference it

            def f(t: float, y: np.ndarray) -> Any:
                calls[0] += 1
                return plain(t, y)

        times = r.save_at
        rows = [y] if times[0] == 0 else []
        solver, steps, interpolated, status, message = None, 0, 0, Status.ok, ""
        try:
            solver = self.solver(f, 0.0, y, float(times[-1]), **options)
            if not starts(solver):
                raise OverflowError("the first step is not finite")
            if lean:
                solver.lu, solver.solve_lu = factors, solved
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
            reached = 0.0 if solver is None else solver.t
            status, message = Status.failed, f"{type(error).__name__}: {error} (t = {reached:.6g})"
        if solver is None:  # the right-hand side failed at the initial state
            return self.finished(y0, np.empty((0, len(y0))), Counts(0, calls[0], 0, None), status, message)
        evaluations = calls[0] or solver.nfev
        counts = Counts(steps, evaluations, solver.njev, self._rejected(steps, evaluations, interpolated))
        stopped = (float(solver.t), np.array(solver.y))
        saved = self.insert_clock(np.reshape(rows, (-1, len(y))), start, times[: len(rows)])
        return self.finished(y0, saved, counts, status, message, stopped)

    def linearised(self, y0: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return integrated(
            ScipyRun(self.method, variational(self.request), self.solver, self.stiff, self.stages), y0
        )

    def _rejected(self, steps: int, evaluations: int, interpolated: int) -> int | None:
        """Attempts less steps, from the evaluations: two before the first step, then so many an attempt."""
        if self.stages is None:
            return None
        return (evaluations - 2 - INTERPOLANT * interpolated) // self.stages - steps

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
    stiff: bool = False
    stages: int | None = None
    about: str = ""
    engines: tuple[str, ...] = ("python",)
    own_time: bool = True
    rtol_range: tuple[float, float] = (CLAMPED, 1e-1)
    evaluations_per_step: int = 13

    def prepare(self, request: Request) -> Prepared:
        import scipy.integrate

        return ScipyRun(self.name, request, getattr(scipy.integrate, self.solver), self.stiff, self.stages)


METHODS.add(
    ScipyMethod("scipy-dop853", "DOP853", 8, stages=12, about="explicit Runge–Kutta 8(5,3), Python callbacks")
)
METHODS.add(
    ScipyMethod(
        "scipy-radau", "Radau", 5, stiff=True, evaluations_per_step=9,
        about="implicit Radau IIA, analytic Jacobian",
    )
)  # fmt: skip
