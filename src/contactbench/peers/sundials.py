"""SUNDIALS CVODE: variable-order Adams (non-stiff) and BDF (stiff).

Hindmarsh et al., ACM Trans. Math. Softw. 31, 363 (2005), doi:10.1145/1089014.1089020.
Engine "c": the C library that scikit-sundae's wheel ships, with the scene as C functions (abi/cvode.py).  Engine
"c+python": scikit-sundae as it is, calling back into Python.
CVODE stops after 500 steps by default and says so only in its result: the budget is set from
`max_steps` and the result's status is read.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from contactbench.methods.base import METHODS, ROUNDING, SHORTEST, Adaptive
from contactbench.methods.prepared import NO_NUMBER, Outcome, Prepared, Refused, Request
from contactbench.peers.abi.cvode import ADAMS, BDF, TOO_MUCH_WORK, Library, library
from contactbench.peers.callback import CallbackPeer
from contactbench.peers.compiled import CompiledPeer
from contactbench.solution import Counts, Status


class CvodeRun(CallbackPeer):
    """scikit-sundae, calling back into Python."""

    def bare(self, y0: np.ndarray) -> np.ndarray:
        start, y = self.split_clock(y0)
        solver, end = self._solver(start), self._end
        solver.init_step(0.0, y)
        return self.insert_clock(solver.step(end, tstop=end).y, start, end)

    def _solver(self, start: float, calls: list[int] | None = None) -> Any:
        """CVODE for the motion from a time on.  calls : its first entry counts the evaluations."""
        from sksundae.cvode import CVODE

        r, rhs, jacobian = self.request, self.rhs, self.jacobian

        def f(t: float, y: np.ndarray, yp: np.ndarray) -> None:
            yp[:] = rhs(start + t, y.tolist())

        def counting(t: float, y: np.ndarray, yp: np.ndarray) -> None:
            assert calls is not None
            calls[0] += 1
            f(t, y, yp)

        def jac(t: float, y: np.ndarray, yp: np.ndarray, J: np.ndarray) -> None:
            assert jacobian is not None
            J[:, :] = jacobian(start + t, y.tolist())

        return CVODE(
            f if calls is None else counting,
            jacfn=None if jacobian is None else jac,
            method=self.solver,
            rtol=r.rtol,
            atol=r.atol,
            max_num_steps=r.max_steps,
            min_step=SHORTEST * self._end,
            max_step=self._end,
        )

    def integrate(self, y0: np.ndarray) -> Outcome:
        r, calls = self.request, [0]
        start, y = self.split_clock(y0)
        # CVODE's nfev leaves out the calls that difference the Jacobian
        solver = self._solver(start, calls if self.jacobian is None else None)
        try:
            rows, steps, result = self._step_by_step(solver, y)
        except NO_NUMBER as error:
            message = f"{type(error).__name__}: {error}"
            return self.finish(y0, np.empty((0, len(y0))), Counts(), Status.failed, message)
        status, message = Status.ok, ""
        if not result.success or len(rows) < len(r.save_at):
            exhausted = result.success or result.status == TOO_MUCH_WORK
            status = Status.budget if exhausted else Status.failed
            reason = f"max_steps = {r.max_steps} spent" if exhausted else result.message
            message = f"{reason} (t = {float(result.t):.6g})"
        counts = Counts(steps, calls[0] or result.nfev, result.njev, None)
        stopped = (float(result.t), np.array(result.y))
        return self.finish(y0, self.packed(rows, y, start), counts, status, message, stopped)

    def _step_by_step(self, solver: Any, y0: np.ndarray) -> tuple[list[np.ndarray], int, Any]:
        """One internal step at a time, so that steps are counted; saved times are interpolated."""
        times, budget, end = self.request.save_at, self.request.max_steps, self._end
        rows, steps, reached = ([y0] if self.saves_start else []), 0, 0.0
        result = solver.init_step(0.0, y0)
        while len(rows) < len(times) and steps < budget:
            result = solver.step(end, method="onestep", tstop=end)
            if not result.success:
                break
            # after an interpolation CVODE first returns to where it was, without a step
            steps += float(result.t) > reached
            reached = float(result.t)
            while len(rows) < len(times) and times[len(rows)] <= reached:
                at = float(times[len(rows)])
                rows.append(result.y if at == reached else solver.step(at, tstop=end).y)
        return rows, steps, result


class CompiledCvodeRun(CompiledPeer):
    """The C library, its memory made once for all calls."""

    def connect(self) -> None:
        from contactbench.peers.abi import cvode_calls
        from contactbench.peers.abi.cvode_memory import Memory

        r = self.request
        assert r.rtol is not None
        assert r.atol is not None
        kind, size = {"Adams": ADAMS, "BDF": BDF}[self.solver], len(self.split_clock(self.start)[1])
        self.memory = m = Memory(
            kind, self.functions, self.data, size, (r.rtol, r.atol), SHORTEST * self.end, self.end
        )
        self.calls = cvode_calls
        self.arguments = (m.memory, m.vector, m.y, self.data, self.clock, self.end, r.max_steps)

    def ending(self, flag: int) -> tuple[Status, str]:
        if flag >= 0:
            return Status.ok, ""
        if flag == TOO_MUCH_WORK:
            return Status.budget, f"max_steps = {self.request.max_steps} spent"
        from sksundae._cy_cvode import CVMESSAGES

        return Status.failed, str(CVMESSAGES.get(flag, f"CVODE returned {flag}"))


@dataclass(frozen=True)
class CvodeMethod(Adaptive):
    name: str
    solver: str
    about: str
    order: int | None = None
    engines: tuple[str, ...] = ("c", "c+python")
    own_time: bool = True
    rtol_range: tuple[float, float] = (ROUNDING, 1e-1)
    evaluations_per_step: int = 2

    def prepare(self, request: Request) -> Prepared:
        if request.engine == "c+python":
            return CvodeRun(self.name, request, self.solver)
        found = library()
        if not isinstance(found, Library):
            return Refused(self.name, request, f"{found}; engine 'c+python' does without")
        return CompiledCvodeRun(self.name, request, self.solver)


for _solver, _name in (("Adams", "Adams–Moulton"), ("BDF", "BDF")):
    METHODS.add(
        CvodeMethod(
            f"cvode-{_solver.lower()}",
            _solver,
            f"variable-order {_name}, Newton with analytic Jacobian (differences beyond 64 components)",
        )
    )
