"""SUNDIALS CVODE: variable-order Adams (non-stiff) and BDF (stiff).

Hindmarsh et al., ACM Trans. Math. Softw. 31, 363 (2005), doi:10.1145/1089014.1089020.
Engine "c": the C library that scikit-sundae's wheel ships, with the scene as C functions
(cvode_library.py, c_functions.py).  Engine "c+python": scikit-sundae as it is, calling back into Python.
CVODE stops after 500 steps by default and says so only in its result: the budget is set from
`max_steps` and the result's status is read.
"""

from __future__ import annotations

from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np

from contactbench.methods.base import (
    METHODS,
    NO_NUMBER,
    ROUNDING,
    SHORTEST,
    Adaptive,
    Outcome,
    Prepared,
    Refused,
    Request,
)
from contactbench.numbers.protocol import CannotRecord
from contactbench.peers.abi.cvode_library import ADAMS, BDF, KNOWN, TOO_MUCH_WORK, Library, library
from contactbench.peers.abi.cvode_solver import Solver
from contactbench.peers.c_functions import c_functions, clock_of, derivative
from contactbench.peers.callback import flat_jacobian, flat_rhs, variational
from contactbench.peers.variational import SOURCE, integrated, variational_request
from contactbench.solution import Counts, Status


@dataclass
class CvodeRun(Prepared):
    kind: str

    sensitivity_source = SOURCE

    def __post_init__(self) -> None:
        super().__post_init__()
        r = self.request
        self.rhs, self.jacobian = flat_rhs(r.scene, r.carry), flat_jacobian(r.scene, r.carry)

    def bare(self, y0: np.ndarray) -> np.ndarray:
        start, y = self.split_clock(y0)
        solver, end = self._solver(start), float(self.request.save_at[-1])
        solver.init_step(0.0, y)
        return self.insert_clock(solver.step(end, tstop=end).y, start, end)

    def _solver(self, start: float, calls: list[int] | None = None) -> Any:
        """CVODE for the motion from a time on.  calls : its first entry counts the evaluations."""
        from sksundae.cvode import CVODE

        r, rhs, jacobian = self.request, self.rhs, self.jacobian
        span = float(r.save_at[-1])

        def f(t: float, y: np.ndarray, yp: np.ndarray) -> None:
            yp[:] = rhs(start + t, y.tolist())

        def counted(t: float, y: np.ndarray, yp: np.ndarray) -> None:
            assert calls is not None
            calls[0] += 1
            f(t, y, yp)

        def jac(t: float, y: np.ndarray, yp: np.ndarray, J: np.ndarray) -> None:
            assert jacobian is not None
            J[:, :] = jacobian(start + t, y.tolist())

        return CVODE(
            f if calls is None else counted, method=self.kind, rtol=r.rtol, atol=r.atol,
            jacfn=None if jacobian is None else jac, max_num_steps=r.max_steps,
            min_step=SHORTEST * span, max_step=span,
        )  # fmt: skip

    def integrate(self, y0: np.ndarray) -> Outcome:
        r, calls = self.request, [0]
        start, y = self.split_clock(y0)
        # CVODE's nfev leaves out the calls that difference the Jacobian
        solver = self._solver(start, calls if self.jacobian is None else None)
        final_only = len(r.save_at) == 1
        try:
            rows, steps, result = (self._to_the_end if final_only else self._step_by_step)(solver, y)
        except NO_NUMBER as error:
            message = f"{type(error).__name__}: {error}"
            return self.finished(y0, np.empty((0, len(y0))), Counts(), Status.failed, message)
        status, message = Status.ok, ""
        if not result.success or len(rows) < len(r.save_at):
            exhausted = result.success or result.status == TOO_MUCH_WORK
            status = Status.budget if exhausted else Status.failed
            reason = f"max_steps = {r.max_steps} spent" if exhausted else result.message
            message = f"{reason} (t = {float(result.t):.6g})"
        counts = Counts(steps, calls[0] or result.nfev, result.njev, None)
        stopped = (float(result.t), np.array(result.y))
        saved = self.insert_clock(np.reshape(rows, (-1, len(y))), start, r.save_at[: len(rows)])
        return self.finished(y0, saved, counts, status, message, stopped)

    def _to_the_end(self, solver: Any, y0: np.ndarray) -> tuple[list[np.ndarray], int | None, Any]:
        """Straight to the last time, in CVODE's fastest mode, which does not tell the steps."""
        end = float(self.request.save_at[-1])
        solver.init_step(0.0, y0)
        result = solver.step(end, tstop=end)
        return ([result.y] if result.success else []), None, result

    def _step_by_step(self, solver: Any, y0: np.ndarray) -> tuple[list[np.ndarray], int | None, Any]:
        """One internal step at a time, so that steps are counted; saved times are interpolated."""
        times, budget = self.request.save_at, self.request.max_steps
        rows, steps, reached, end = ([y0] if times[0] == 0 else []), 0, 0.0, float(times[-1])
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

    def linearised(self, y0: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return integrated(CvodeRun(self.method, variational(self.request), self.kind), y0)

    def count(self, counts: Counts) -> Counts:
        """With the steps of a run to the last time."""
        if counts.steps is None:
            start, y = self.split_clock(self._own_start)
            _, steps, _ = self._step_by_step(self._solver(start), y)
            counts = counts._replace(steps=steps)
        return counts


@dataclass
class CompiledCvodeRun(Prepared):
    """The C library, its memory made once for all calls."""

    kind: str

    sensitivity_source = SOURCE

    def __post_init__(self) -> None:
        super().__post_init__()
        from contactbench.peers.abi import cvode_driver

        r = self.request
        assert r.rtol is not None
        assert r.atol is not None
        functions = c_functions(r.scene, r.carry)
        self.compile_s = functions.compile_s
        self.data = functions.data(r.scene.numbers())
        self.size, self.end, self.clock = len(self._own_start), float(r.save_at[-1]), clock_of(r.scene)
        self.solver = Solver(
            {"Adams": ADAMS, "BDF": BDF}[self.kind], functions, self.data,
            len(self.split_clock(self._own_start)[1]), r.rtol, r.atol, self.end,
            SHORTEST * self.end,
        )  # fmt: skip
        self.alone = Lock()  # one memory: calls from several threads take turns
        self.to_end, self.at_times = cvode_driver.to_end, cvode_driver.at_times
        self.final_only = len(self.later) == 1

    def _bare(self, y0: np.ndarray) -> np.ndarray:
        s = self.solver
        return self.to_end(
            s.memory, s.vector, s.y, y0, self.data, self.clock, self.end, self.request.max_steps
        )

    def bare(self, y0: np.ndarray) -> np.ndarray:
        """The solver's own call: a packed state in, the packed state at the end out."""
        return self._bare(y0)[KNOWN:]

    def many(self, starts: np.ndarray) -> np.ndarray:
        """Facts and final state, (n, KNOWN + d), of one start (n, d) after the other, in a compiled loop."""
        from contactbench.peers.abi.cvode_driver import in_a_loop

        s = self.solver
        return in_a_loop(
            s.memory, s.vector, s.y, starts, self.data, self.clock, self.end, self.request.max_steps
        )

    def integrate(self, y0: np.ndarray) -> Outcome:
        with self.alone:
            return self._integrate(y0)

    def _integrate(self, y0: np.ndarray) -> Outcome:
        if self.final_only:
            told = self._bare(y0)
            rows = told[None, KNOWN:]
            flag, reached, saved, steps, evaluations, jacobians, rejected, *end = told.tolist()
            if flag >= 0 and self._saves == 1:
                return self.at_end(
                    y0, end, rows, Counts(int(steps), int(evaluations), int(jacobians), int(rejected))
                )
        r, s, later = self.request, self.solver, self.later
        if not self.final_only:
            rows = np.empty((len(later), self.size))
            told = self.at_times(s.memory, s.vector, s.y, y0, self.data, self.clock, later, r.max_steps, rows)
            flag, reached, saved, steps, evaluations, jacobians, rejected = told[:KNOWN].tolist()
        if saved < len(later):
            rows = rows[: int(saved)]
        rows = self.from_start(y0, rows)
        counts = Counts(int(steps), int(evaluations), int(jacobians), int(rejected))
        if flag >= 0:
            return self.finished(y0, rows, counts)
        exhausted = flag == TOO_MUCH_WORK
        status = Status.budget if exhausted else Status.failed
        message = f"max_steps = {r.max_steps} spent" if exhausted else _meaning(int(flag))
        return self.finished(
            y0, rows, counts, status, f"{message} (t = {reached:.6g})", (reached, told[KNOWN:])
        )

    def linearised(self, y0: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        carry = self.request.carry
        larger = variational_request(self.request, lambda scene, x: derivative(scene, x, carry))
        try:
            run: Prepared = CompiledCvodeRun(self.method, larger, self.kind)
        except CannotRecord:  # no derivative on dual numbers: JAX has one
            run = CvodeRun(self.method, variational(self.request), self.kind)
        return integrated(run, y0)


def _meaning(flag: int) -> str:
    from sksundae._cy_cvode import CVMESSAGES

    return str(CVMESSAGES.get(flag, f"CVODE returned {flag}"))


@dataclass(frozen=True)
class CvodeMethod(Adaptive):
    name: str
    kind: str
    about: str
    order: int | None = None
    engines: tuple[str, ...] = ("c", "c+python")
    own_time: bool = True
    rtol_range: tuple[float, float] = (ROUNDING, 1e-1)
    evaluations_per_step: int = 2

    def prepare(self, request: Request) -> Prepared:
        if request.engine == "c+python":
            return CvodeRun(self.name, request, self.kind)
        found = library()
        if not isinstance(found, Library):
            return Refused(self.name, request, f"{found}; engine 'c+python' does without")
        try:
            return CompiledCvodeRun(self.name, request, self.kind)
        except CannotRecord as why:
            return Refused(self.name, request, f"{why}; engine 'c+python' calls the scene as it is")


METHODS.add(
    CvodeMethod(
        "cvode-adams",
        "Adams",
        "variable-order Adams–Moulton, Newton with analytic Jacobian (differences beyond 64 components)",
    )
)
METHODS.add(
    CvodeMethod(
        "cvode-bdf",
        "BDF",
        "variable-order BDF, Newton with analytic Jacobian (differences beyond 64 components)",
    )
)
