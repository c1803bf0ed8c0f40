"""CyRK's solvers, C++ throughout: DOP853, Verner 8(7), Tsitouras 5(4), Radau IIA, LSODA.

Renaud, https://github.com/jrenaud90/CyRK, doi:10.5281/zenodo.7093266.  Methods: Hairer, Nørsett, Wanner, Solving
ODEs I, §II.5 (DOP853) and II, §IV.8 (Radau); Verner, Numer. Algorithms 53, 383 (2010),
doi:10.1007/s11075-009-9290-3; Tsitouras, Comput. Math. Appl. 62, 770 (2011), doi:10.1016/j.camwa.2011.06.002;
Petzold, SIAM J. Sci. Stat. Comput. 4, 136 (1983), doi:10.1137/0904010 (LSODA).

CyRK's documented `nbsolve2_ivp` costs 5 µs a call from compiled code and a hundred more from Python, nearly all of it
for boxing its arguments and its result; so it is called from compiled code, through the C entry it wraps.  That entry
takes no Jacobian: Radau and LSODA difference the right-hand side, and the calls they make for it are counted.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass

from contactbench.methods.base import CLAMPED, METHODS, Adaptive
from contactbench.methods.prepared import Prepared, Refused, Request
from contactbench.peers.abi.cyrk import SUCCESS, TOO_MANY_STEPS, TOO_MANY_STEPS_SO_FAR, why_not
from contactbench.peers.compiled import CompiledPeer
from contactbench.scene import Scene
from contactbench.solution import Counts, Status

#: evaluations before the first step: at the initial state, and to choose the step
BEFORE = 2


@dataclass
class CyrkRun(CompiledPeer):
    #: evaluations of an attempted step, whether accepted or not; None where that varies
    stages: int | None = None

    def connect(self) -> None:
        from contactbench.peers.abi import cyrk_calls

        r = self.request
        self.calls, self.message = cyrk_calls, cyrk_calls.message
        method = cyrk_calls.number(self.solver)
        self.arguments = (
            *(self.functions.rhs, method, self.data, self.clock, self.end),
            *(r.rtol, r.atol, r.max_steps),
        )

    def ending(self, flag: int) -> tuple[Status, str]:
        if flag == SUCCESS:
            return Status.ok, ""
        if flag in (TOO_MANY_STEPS, TOO_MANY_STEPS_SO_FAR):
            return Status.budget, f"max_steps = {self.request.max_steps} spent"
        return Status.failed, self.message(flag)

    def counts(self, steps: int, evaluations: int, jacobians: int, rejected: float) -> Counts:
        """Rejected steps follow from the evaluations, unless an interpolation asks for some of its own."""
        if self.stages is None or not self.final_only:
            return Counts(steps, evaluations, 0, None)
        return Counts(steps, evaluations, 0, (evaluations - BEFORE) // self.stages - steps)


@dataclass(frozen=True)
class CyrkMethod(Adaptive):
    name: str
    solver: str
    order: int | None
    about: str
    stages: int | None = None
    engines: tuple[str, ...] = ("c++",)
    own_time: bool = True
    rtol_range: tuple[float, float] = (CLAMPED, 1e-1)

    def refuses(self, scene: Scene) -> str | None:
        if importlib.util.find_spec("CyRK") is None:
            return "CyRK is not installed (pip install contactbench[bench])"
        return None

    def prepare(self, request: Request) -> Prepared:
        if why := why_not():
            return Refused(self.name, request, why)
        return CyrkRun(self.name, request, self.solver, stages=self.stages)


for _method in (
    CyrkMethod("cyrk-dop853", "DOP853", 8, "explicit Runge–Kutta 8(5,3), C++", stages=12),
    CyrkMethod("cyrk-vern8", "Vern8", 8, "Verner's explicit Runge–Kutta 8(7), C++", stages=13),
    CyrkMethod("cyrk-tsit5", "Tsit5", 5, "Tsitouras' explicit Runge–Kutta 5(4), C++", stages=6),
    CyrkMethod("cyrk-lsoda", "LSODA", None, "Adams or BDF, chosen as it goes (ODEPACK), C++"),
    CyrkMethod("cyrk-radau", "RADAU", 5, "implicit Radau IIA, Jacobian by differences, C++"),
):
    METHODS.add(_method)
