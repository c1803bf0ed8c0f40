"""SciPy's DOP853 and Radau, stepped directly (what `solve_ivp` does, less its bookkeeping).

Hairer, Nørsett, Wanner, Solving ODEs I, §II.5 (DOP853) and II, §IV.8 (Radau IIA, order 5).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from contactbench.methods.base import CLAMPED, METHODS
from contactbench.peers.base import Callback, Peer, Rates

if TYPE_CHECKING:
    from scipy.integrate import OdeSolver


class Scipy(Callback):
    def begin(self, start: float, y: np.ndarray, rhs: Rates) -> OdeSolver:
        import scipy.integrate

        r, jacobian = self.request, self.jacobian

        def f(t: float, y: np.ndarray) -> Sequence[float]:
            return rhs(start + t, self.scene.entries(y))

        options: dict[str, Any] = {"rtol": r.rtol, "atol": r.atol}
        if jacobian is not None:
            options["jac"] = lambda t, y: np.array(jacobian(start + t, self.scene.entries(y)))
        solver = getattr(scipy.integrate, self.method.solver)(f, 0.0, y, self.end, **options)
        if not math.isfinite(solver.h_abs):  # SciPy would never return
            raise OverflowError("the first step is not finite")
        return solver

    @np.errstate(under="ignore")
    def last(self, y0: np.ndarray) -> np.ndarray:
        start, y = self.split_clock(y0)
        with suppress(OverflowError):
            solver = self.begin(start, y, self.rhs)
            while solver.status == "running":
                solver.step()
            return self.insert_clock(solver.y, start, self.end)
        return np.full_like(y0, math.nan)


PAPER = "Virtanen et al., Nat. Methods 17, 261 (2020), doi:10.1038/s41592-019-0686-2"
for _solver, _order, _stages, _cost, _about in (
    ("DOP853", 8, 12, 13, "explicit Runge–Kutta 8(5,3), Python callbacks"),
    ("Radau", 5, None, 9, "implicit Radau IIA, analytic Jacobian"),
):
    _known = _solver, "scipy", _order, _stages, _stages is None
    _named = f"scipy-{_solver.lower()}", f"{_about}; {PAPER}", Scipy, ("python",), (CLAMPED, 1e-1)
    _same: dict[str, Any] = {"mission": True, "stiff": _stages is None, "like": f"cyrk-{_solver.lower()}"}
    METHODS.add(Peer(*_named, *_known, costs={"python": _cost}, **_same))
