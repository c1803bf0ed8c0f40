"""SUNDIALS CVODE: variable-order Adams (non-stiff) and BDF (stiff).

Hindmarsh et al., ACM Trans. Math. Softw. 31, 363 (2005), doi:10.1145/1089014.1089020.
Engine "c": the C library that scikit-sundae's wheel ships, with the scene as C functions (abi/cvode.py).  Engine
"c+python": scikit-sundae as it is, calling back into Python.
CVODE stops after 500 steps by default and says so only in its result: the budget is set from
`max_steps` and the result's status is read.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np

from contactbench.methods.base import METHODS, ROUNDING, SHORTEST
from contactbench.methods.prepared import NO_NUMBER, Outcome, Prepared, Request
from contactbench.peers.base import Peer
from contactbench.peers.callback import CallbackPeer
from contactbench.peers.compiled import CompiledPeer
from contactbench.solution import Counts, Status

#: the major version of SUNDIALS whose C interface is known
MAJOR = 7
#: what CVode returns when the budget of steps is spent
TOO_MUCH_WORK = -1


class CvodeRun(CallbackPeer):
    """scikit-sundae, calling back into Python."""

    def bare(self, y0: np.ndarray) -> np.ndarray:
        start, y = self.split_clock(y0)
        solver = self.solver(start)
        solver.init_step(0.0, y)
        return self.insert_clock(solver.step(self._end, tstop=self._end).y, start, self._end)

    def solver(self, start: float, calls: list[int] | None = None) -> Any:
        """CVODE for the motion from a time on.  calls : its first entry counts the evaluations."""
        from sksundae.cvode import CVODE

        r, rhs, jacobian = self.request, self.slopes(calls), self.jacobian

        def f(t: float, y: np.ndarray, yp: np.ndarray) -> None:
            yp[:] = rhs(start + t, y.tolist())

        def jac(t: float, y: np.ndarray, yp: np.ndarray, J: np.ndarray) -> None:
            assert jacobian is not None
            J[:, :] = jacobian(start + t, y.tolist())

        return CVODE(
            f,
            jacfn=jac if jacobian else None,
            method=self.method_.solver,
            rtol=r.rtol,
            atol=r.atol,
            max_num_steps=r.max_steps,
            min_step=SHORTEST * self._end,
            max_step=self._end,
        )

    def integrate(self, y0: np.ndarray) -> Outcome:
        """One internal step at a time, so that steps are counted; saved times are interpolated."""
        r, times, end, calls = self.request, self.request.save_at, self._end, [0]
        start, y = self.split_clock(y0)
        # CVODE's own number leaves out the calls that difference the Jacobian
        solver = self.solver(start, calls)
        rows, steps, reached = ([y] if self.saves_start else []), 0, 0.0
        try:
            result = solver.init_step(0.0, y)
            while len(rows) < len(times) and steps < r.max_steps:
                result = solver.step(end, method="onestep", tstop=end)
                if not result.success:
                    break
                # after an interpolation CVODE first returns to where it was, without a step
                steps += float(result.t) > reached
                reached = float(result.t)
                while len(rows) < len(times) and times[len(rows)] <= reached:
                    at = float(times[len(rows)])
                    rows.append(result.y if at == reached else solver.step(at, tstop=end).y)
        except NO_NUMBER as error:
            message = f"{type(error).__name__}: {error}"
            return self.finish(y0, np.empty((0, len(y0))), Counts(), Status.failed, message)
        status, message = Status.ok, ""
        if not result.success or len(rows) < len(times):
            exhausted = result.success or result.status == TOO_MUCH_WORK
            status = Status.budget if exhausted else Status.failed
            reason = f"max_steps = {r.max_steps} spent" if exhausted else result.message
            message = f"{reason} (t = {float(result.t):.6g})"
        counts = Counts(steps, calls[0], result.njev, None)
        stopped = (float(result.t), np.array(result.y))
        return self.finish(y0, self.packed(rows, y, start), counts, status, message, stopped)


class CompiledCvodeRun(CompiledPeer):
    """The C library, its memory made once for all calls."""

    def connect(self) -> tuple[ModuleType, tuple[Any, ...]]:
        from contactbench.peers.abi import cvode

        r, size = self.request, len(self.split_clock(self.start)[1])
        assert r.rtol is not None
        assert r.atol is not None
        tolerances, bounds = (r.rtol, r.atol), (SHORTEST * self.end, self.end)
        self.memory = cvode.Memory(self.method_.solver, self.functions, self.data, size, tolerances, bounds)
        place = self.memory.memory, self.memory.vector, self.memory.y
        return cvode, (*place, self.data, self.clock, self.end, r.max_steps)

    def ending(self, flag: int) -> tuple[Status, str]:
        if flag >= 0:
            return Status.ok, ""
        if flag == TOO_MUCH_WORK:
            return Status.budget, f"max_steps = {self.request.max_steps} spent"
        from sksundae._cy_cvode import CVMESSAGES

        return Status.failed, str(CVMESSAGES.get(flag, f"CVODE returned {flag}"))


def cvode(name: str, request: Request, method: Peer) -> Prepared:
    """The run of an engine."""
    if request.engine == "c+python":
        return CvodeRun(name, request, method)
    try:
        return CompiledCvodeRun(name, request, method)
    except ImportError as why:
        raise ImportError(f"{why}; engine 'c+python' does without") from why


for _solver, _name in (("Adams", "Adams–Moulton"), ("BDF", "BDF")):
    _about = f"variable-order {_name}, Newton with analytic Jacobian (differences beyond 64 components)"
    METHODS.add(
        Peer(
            f"cvode-{_solver.lower()}",
            *(_about, cvode, ("c", "c+python"), (ROUNDING, 1e-1), _solver),
            implicit=True,
            costs={"c+python": 2},
        )
    )
