"""SciPy's DOP853 and Radau, stepped directly (what `solve_ivp` does, less its bookkeeping).

Hairer, Nørsett, Wanner, Solving ODEs I, §II.5 (DOP853) and II, §IV.8 (Radau IIA, order 5).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from contactbench.methods.base import CLAMPED, METHODS
from contactbench.methods.prepared import NO_NUMBER, Outcome
from contactbench.peers.base import Peer
from contactbench.peers.callback import CallbackPeer
from contactbench.solution import Counts, Status

#: evaluations DOP853 adds for the interpolant of a step
INTERPOLANT = 3
#: and before the first step
BEFORE = 2


def starts(solver: Any) -> bool:
    """Return whether the first step is finite: with one that is not, SciPy would never return."""
    return math.isfinite(solver.h_abs)


class ScipyRun(CallbackPeer):
    def problem(self, y0: np.ndarray, calls: list[int] | None = None) -> tuple[float, np.ndarray, Any]:
        """When it begins, the components less the time, and SciPy's solver.  calls : counts the evaluations."""
        import scipy.integrate

        r, rhs, jacobian = self.request, self.slopes(calls), self.jacobian
        start, y = self.split_clock(y0)

        def f(t: float, y: np.ndarray) -> Any:
            return rhs(start + t, y.tolist())

        options: dict[str, Any] = {"rtol": r.rtol, "atol": r.atol}
        if jacobian is not None:
            options["jac"] = lambda t, y: np.array(jacobian(start + t, y.tolist()))
        solver = getattr(scipy.integrate, self.method_.solver)
        return start, y, solver(f, 0.0, y, self._end, **options)

    def bare(self, y0: np.ndarray) -> np.ndarray:
        start, _, solver = self.problem(y0)
        if not starts(solver):
            return np.full_like(y0, math.nan)
        while solver.status == "running":
            solver.step()
        return self.insert_clock(solver.y, start, self._end)

    def integrate(self, y0: np.ndarray) -> Outcome:
        r, times, calls = self.request, self.request.save_at, [0]
        try:
            start, y, solver = self.problem(y0, calls)
        except NO_NUMBER as error:  # the right-hand side failed at the initial state
            message, counts = f"{type(error).__name__}: {error} (t = 0)", Counts(0, calls[0], 0, None)
            return self.finish(y0, np.empty((0, len(y0))), counts, Status.failed, message)
        rows = [y] if self.saves_start else []
        steps, interpolated, status, message = 0, 0, Status.ok, ""
        try:
            if not starts(solver):
                raise OverflowError("the first step is not finite")
            while len(rows) < len(times):
                if steps == r.max_steps:
                    status, message = Status.budget, f"max_steps = {r.max_steps} spent at t = {solver.t:.6g}"
                    break
                note = solver.step()
                steps += 1
                if solver.status == "failed":
                    status, message = Status.failed, f"{note} (t = {solver.t:.6g})"
                    break
                due = times[len(rows) : int(np.searchsorted(times, solver.t, side="right"))]
                if len(due) and due[0] < solver.t:  # no interpolation at the solver's own point
                    interpolated, interpolant = interpolated + 1, solver.dense_output()
                rows += [solver.y.copy() if t == solver.t else interpolant(t) for t in due]
        except (*NO_NUMBER, np.linalg.LinAlgError) as error:
            status, message = Status.failed, f"{type(error).__name__}: {error} (t = {solver.t:.6g})"
        rejected = None
        if (stages := self.method_.stages) is not None:
            rejected = (calls[0] - BEFORE - INTERPOLANT * interpolated) // stages - steps
        counts, stopped = (
            Counts(steps, calls[0], solver.njev, rejected),
            (float(solver.t), np.array(solver.y)),
        )
        return self.finish(y0, self.packed(rows, y, start), counts, status, message, stopped)


_range, _dop853 = (CLAMPED, 1e-1), "explicit Runge–Kutta 8(5,3), Python callbacks"
_radau = "implicit Radau IIA, analytic Jacobian"
METHODS.add(
    Peer(
        "scipy-dop853",
        _dop853,
        ScipyRun,
        ("python",),
        _range,
        "DOP853",
        order=8,
        stages=12,
        costs={"python": 13},
    )
)
METHODS.add(
    Peer(
        "scipy-radau",
        _radau,
        ScipyRun,
        ("python",),
        _range,
        "Radau",
        order=5,
        implicit=True,
        costs={"python": 9},
    )
)
