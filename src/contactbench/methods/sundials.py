"""SUNDIALS CVODE through scikit-sundae: variable-order Adams (non-stiff) and BDF (stiff).

Hindmarsh et al., ACM Trans. Math. Softw. 31, 363 (2005), doi:10.1145/1089014.1089020.
CVODE stops after 500 steps by default and says so only in its result: the budget is set from
`max_steps` and the result's status is read.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from contactbench.methods.base import METHODS, Adaptive, Outcome, Prepared, Request, counting
from contactbench.methods.callback import flat_jacobian, flat_rhs, variational
from contactbench.methods.variational import SOURCE, integrated
from contactbench.solution import Counts, Status

TOO_MUCH_WORK = -1  # CV_TOO_MUCH_WORK


@dataclass
class CvodeRun(Prepared):
    kind: str

    sensitivity_source = SOURCE

    def __post_init__(self) -> None:
        super().__post_init__()
        r = self.request
        rhs, jacobian = flat_rhs(r.scene, r.carry), flat_jacobian(r.scene, r.carry)

        def f(t: float, y: np.ndarray, yp: np.ndarray) -> None:
            yp[:] = list(rhs(y.tolist()))

        def jac(t: float, y: np.ndarray, yp: np.ndarray, J: np.ndarray) -> None:
            assert jacobian is not None
            J[:, :] = jacobian(y.tolist())

        self.f, self.jac = f, None if jacobian is None else jac

    def _solver(self, f: Any) -> Any:
        from sksundae.cvode import CVODE

        r = self.request
        return CVODE(f, method=self.kind, rtol=r.rtol, atol=r.atol, jacfn=self.jac, max_num_steps=r.max_steps)

    def integrate(self, y0: np.ndarray) -> Outcome:
        r = self.request
        f, calls = self.f, None
        if self.jac is None:  # CVODE's nfev leaves out the calls that difference the Jacobian
            counted, calls = counting(f)
            f = lambda t, y, yp: counted(t, y, yp)  # noqa: E731 (sksundae takes no *args)
        solver = self._solver(f)
        start = r.save_at[0] == 0
        try:
            if len(r.save_at) - start == 1:  # two-point `solve` would return after every step
                solver.init_step(0.0, y0)
                result = solver.step(float(r.save_at[-1]), tstop=float(r.save_at[-1]))
                y = np.array([y0, result.y])
            else:
                result = solver.solve(r.save_at if start else np.concatenate([[0.0], r.save_at]), y0)
                y = result.y
        except (OverflowError, ZeroDivisionError, ValueError) as error:
            message = f"{type(error).__name__}: {error}"
            return self.finished(y0, np.empty((0, len(y0))), Counts(), Status.failed, message)
        status, message = Status.ok, ""
        if not result.success:
            status = Status.budget if result.status == TOO_MUCH_WORK else Status.failed
            message = f"{result.message} (t = {float(np.max(result.t)):.6g})"
            y = y[:-1]  # the last state is where it stopped, not a saved time
        evaluations = result.nfev if calls is None else calls[0]
        counts = Counts(None, evaluations, result.njev, None)
        return self.finished(y0, y if start else y[1:], counts, status, message)

    def linearised(self, y0: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return integrated(CvodeRun(self.method, variational(self.request), self.kind), y0)

    def count(self) -> Counts:
        """Counts with the number of steps, which only CVODE's slower one-step mode reveals."""
        solver = self._solver(self.f)
        every = solver.solve(np.array([0.0, float(self.request.save_at[-1])]), self._own_start)
        return self().counts._replace(steps=len(every.t) - 1)


@dataclass(frozen=True)
class CvodeMethod(Adaptive):
    name: str
    kind: str
    about: str
    stiff: bool = False
    order: int | None = None
    engines: tuple[str, ...] = ("c+python",)
    rtol_range: tuple[float, float] = (1e-14, 1e-1)

    def prepare(self, request: Request) -> Prepared:
        return CvodeRun(self.name, request, self.kind)


METHODS.add(
    CvodeMethod("cvode-adams", "Adams", "variable-order Adams–Moulton, Newton with analytic Jacobian")
)
METHODS.add(CvodeMethod("cvode-bdf", "BDF", "variable-order BDF, Newton with analytic Jacobian", stiff=True))
