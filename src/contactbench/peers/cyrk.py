"""CyRK's solvers, C++ throughout: DOP853, Verner 8(7), Radau IIA, LSODA.

Renaud, https://github.com/jrenaud90/CyRK, doi:10.5281/zenodo.7093266.  Methods: Hairer, Nørsett, Wanner, Solving
ODEs I, §II.5 (DOP853) and II, §IV.8 (Radau); Verner, Numer. Algorithms 53, 383 (2010),
doi:10.1007/s11075-009-9290-3; Petzold, SIAM J. Sci. Stat. Comput. 4, 136 (1983), doi:10.1137/0904010 (LSODA).

CyRK's documented `nbsolve2_ivp` takes 5 µs a call from compiled code and 100 µs more from Python, mostly to convert
arguments and result.  So compiled code calls the C function that it wraps.  That function takes no Jacobian: Radau and
LSODA difference the right-hand side, and these calls are counted.
"""

from __future__ import annotations

from threading import Thread

import numpy as np

from contactbench.methods.base import CLAMPED, METHODS
from contactbench.peers.base import Peer
from contactbench.peers.compiled import SUCCESS, TOO_MANY_STEPS, TOO_MANY_STEPS_SO_FAR, Compiled, Connection
from contactbench.solution import Counts, Status

#: steps of a short run, about 0.01 s; seconds between two checks for signals
PIECE, LOOK = 10**4, 0.1
#: evaluations before the first step: at the initial state, and to choose the step
BEFORE = 2


class Cyrk(Compiled):
    def connect(self, clock: int) -> Connection:
        from contactbench.peers.abi import cyrk

        r, method = self.request, int(cyrk.find_ode_method_int(self.method.solver))
        where = self.functions.rhs, method, self.data, clock, self.end
        return cyrk, (*where, np.array([r.rtol]), np.array(r.atol, ndmin=1), r.max_steps)

    def run(self, y0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Run by one uninterruptible call of C++; a long run uses another thread, which Ctrl-C abandons."""
        *given, most = self.arguments
        self.arguments = (*given, min(PIECE, most))
        try:
            found = super().run(y0)
        finally:
            self.arguments = (*given, most)
        if most <= PIECE or found[0][0] not in (TOO_MANY_STEPS, TOO_MANY_STEPS_SO_FAR):
            return found
        again: list[tuple[np.ndarray, np.ndarray]] = []
        worker = Thread(target=lambda: again.append(Compiled.run(self, y0)), daemon=True)
        worker.start()
        while worker.is_alive():
            worker.join(LOOK)
        return again[0]

    def ending(self, flag: int) -> tuple[Status, str]:
        if flag == SUCCESS:
            return Status.ok, ""
        if flag in (TOO_MANY_STEPS, TOO_MANY_STEPS_SO_FAR):
            return Status.budget, self.spent
        return Status.failed, str(self.library.get_error_message(flag)).rstrip(".")

    def counts(self, steps: int, evaluations: int, jacobians: int, rejected: float) -> Counts:
        """Return the counts; rejected steps follow from the evaluations, unless interpolations take some."""
        if (stages := self.method.stages) is None or not self.final_only:
            return Counts(steps, evaluations, 0, None)
        return Counts(steps, evaluations, 0, (evaluations - BEFORE) // stages - steps)


for _solver, _order, _stages, _about in (
    ("DOP853", 8, 12, "explicit Runge–Kutta 8(5,3), C++; Hairer, Nørsett, Wanner I, §II.5"),
    ("Vern8", 8, 13, "Verner's explicit Runge–Kutta 8(7), C++"),
    ("LSODA", None, None, "Adams or BDF, chosen as it goes (ODEPACK), C++; Petzold, doi:10.1137/0904010"),
    ("RADAU", 5, None, "implicit Radau IIA, Jacobian by differences, C++; Hairer, Wanner II, §IV.8"),
):
    _name, _range = f"cyrk-{_solver.lower()}", (CLAMPED, 1e-1)
    METHODS.add(
        Peer(
            _name, _about, Cyrk, ("c++",), _range, _solver, "CyRK", _order, _stages, stiff=_solver == "RADAU"
        )
    )
