"""SUNDIALS CVODE: variable-order Adams (non-stiff) and BDF (stiff).

Hindmarsh et al., ACM Trans. Math. Softw. 31, 363 (2005), doi:10.1145/1089014.1089020.  Engine "c": the C library that
scikit-sundae's wheel ships, with the scene as C functions (abi/cvode.py).  Engine "c+python": scikit-sundae as it is,
calling back into Python.  CVODE stops after 500 steps by default and says so only in its result: the budget is set
from `max_steps` and the result's status is read.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from contactbench.methods.base import METHODS, ROUNDING, SHORTEST
from contactbench.methods.prepared import Request
from contactbench.peers.base import Call, Callback, Peer, Rates
from contactbench.peers.compiled import FACTS, KNOWN, TOO_MUCH_WORK, Compiled, Connection
from contactbench.solution import Status

if TYPE_CHECKING:
    from sksundae.cvode import CVODE

#: components times steps of CVODE between two checks for signals, some hundredths of a second
PIECE = 10**5
FLAG, SAVED = map(FACTS.index, ("flag", "saved"))


class Stepper:
    """scikit-sundae's CVODE, one internal step at a time, with the interface of SciPy's solvers."""

    def __init__(self, solver: CVODE, y: np.ndarray, end: float) -> None:
        self.solver, self.end, self.status, self.njev = solver, end, "running", 0
        self.t, self.y = 0.0, solver.init_step(0.0, y).y

    def step(self) -> str:
        result, before = None, self.t
        while result is None or (result.success and result.t == before):
            # after an interpolation CVODE first returns to where it was, without a step
            result = self.solver.step(self.end, method="onestep", tstop=self.end)
        self.t, self.y, self.njev = float(result.t), result.y, result.njev
        self.status = "running" if result.success else "failed"
        return str(result.message)

    def dense_output(self) -> Callable[[float], np.ndarray]:
        return lambda t: self.solver.step(float(t), tstop=self.end).y


class CvodeCallback(Callback):
    failure = 0

    def last(self, y0: np.ndarray) -> np.ndarray:
        start, y = self.split_clock(y0)
        solver = self.solver(start, self.rhs)
        solver.init_step(0.0, y)
        return self.insert_clock(solver.step(self.end, tstop=self.end).y, start, self.end)

    def begin(self, start: float, y: np.ndarray, rhs: Rates) -> Stepper:
        return Stepper(self.solver(start, rhs), y, self.end)

    def solver(self, start: float, rhs: Rates) -> CVODE:
        from sksundae.cvode import CVODE

        r, scene, jacobian = self.request, self.scene, self.jacobian

        def f(t: float, y: np.ndarray, yp: np.ndarray) -> None:
            yp[:] = rhs(start + t, scene.entries(y))

        def jac(t: float, y: np.ndarray, yp: np.ndarray, J: np.ndarray) -> None:
            assert jacobian is not None
            J[:, :] = jacobian(start + t, scene.entries(y))

        options = {"method": self.method.solver, "rtol": r.rtol, "atol": r.atol, "max_num_steps": r.max_steps}
        bounds = {"min_step": SHORTEST * self.end, "max_step": self.end}
        return CVODE(f, jacfn=jac if jacobian else None, **options, **bounds)


class Cvode(Compiled):
    def connect(self, clock: int) -> Connection:
        from contactbench.peers.abi import cvode

        r, size = self.request, len(self.split_clock(self.request.start)[1])
        assert r.rtol is not None
        assert r.atol is not None
        tolerances, bounds = (r.rtol, r.atol), (SHORTEST * self.end, self.end)
        self.memory = cvode.Memory(self.method.solver, self.functions, self.data, size, tolerances, bounds)
        place = self.memory.memory, self.memory.vector, self.memory.y
        return cvode, (*place, self.data, clock, self.end, r.max_steps)

    def run(self, y0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Run in pieces with the same steps, so that Python can handle signals between them."""
        *place, most = self.arguments
        piece = max(1, PIECE // len(y0))
        rows, taken, facts = np.empty((len(self.later), len(y0))), 0, np.zeros(KNOWN)
        while taken < most:
            count, saved = min(piece, most - taken), int(facts[SAVED])
            if self.final_only:
                facts = self.library.on_to_end(*place, count) if taken else self.to_end(y0, *place, count)
            elif taken:
                facts = self.library.on_to_times(saved, self.later, rows, *place, count)
            else:
                facts = self.library.at_times(y0, self.later, rows, *place, count)
            if facts[FLAG] != TOO_MUCH_WORK:
                break
            taken += count
        return facts, facts[None, KNOWN:] if self.final_only else rows

    def ending(self, flag: int) -> tuple[Status, str]:
        if flag >= 0:
            return Status.ok, ""
        if flag == TOO_MUCH_WORK:
            return Status.budget, self.spent
        from sksundae._cy_cvode import CVMESSAGES

        return Status.failed, str(CVMESSAGES.get(flag, f"CVODE returned {flag}"))


def cvode(method: Peer, request: Request) -> Call:
    if request.engine == "c+python":
        return CvodeCallback(method, request)
    try:
        return Cvode(method, request)
    except ImportError as why:
        others = "; engine 'c+python' does without" if "c+python" in method.engines else ""
        raise ImportError(f"{why}{others}") from why


PAPER = "Hindmarsh et al., ACM Trans. Math. Softw. 31, 363 (2005), doi:10.1145/1089014.1089020"
for _solver, _name in (("Adams", "Adams–Moulton"), ("BDF", "BDF")):
    _about = f"variable-order {_name}, Newton with analytic Jacobian (differences beyond 64 components)"
    _named = f"cvode-{_solver.lower()}", f"{_about}; {PAPER}", cvode, ("c", "c+python"), (ROUNDING, 1e-1)
    _about_it: dict[str, Any] = {"mission": True, "stiff": _solver == "BDF"}
    METHODS.add(Peer(*_named, _solver, "sksundae", implicit=True, costs={"c+python": 2}, **_about_it))
