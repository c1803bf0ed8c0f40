"""CyRK's solvers, C++ throughout: DOP853, Verner 8(7), Tsitouras 5(4), Radau IIA, LSODA.

Renaud, https://github.com/jrenaud90/CyRK, doi:10.5281/zenodo.7093266.  Methods: Hairer, Nørsett, Wanner, Solving
ODEs I, §II.5 (DOP853) and II, §IV.8 (Radau); Verner, Numer. Algorithms 53, 383 (2010),
doi:10.1007/s11075-009-9290-3; Tsitouras, Comput. Math. Appl. 62, 770 (2011), doi:10.1016/j.camwa.2011.06.002;
Petzold, SIAM J. Sci. Stat. Comput. 4, 136 (1983), doi:10.1137/0904010 (LSODA).

The scene is a C function (c_functions.py).  CyRK's documented `nbsolve2_ivp` costs 5 µs a call from compiled
code and a hundred more from Python, nearly all of it for boxing its arguments and its result; so it is
called from compiled code, through the C entry it wraps (cyrk_driver.py).  That entry takes no
Jacobian: Radau and LSODA difference the right-hand side, and the calls they make for it are counted.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass

import numpy as np

from contactbench.methods.base import CLAMPED, METHODS, Adaptive, Outcome, Prepared, Refused, Request
from contactbench.numbers.protocol import CannotRecord
from contactbench.peers.abi.cyrk_interface import KNOWN, why_not
from contactbench.peers.c_functions import c_functions, clock_of, derivative
from contactbench.peers.variational import SOURCE, integrated, variational_request
from contactbench.scene import Scene
from contactbench.solution import Counts, Status

#: CyRK's status codes
SUCCESS, TOO_MANY_STEPS = 1, (-52, -53)
#: evaluations before the first step: at the initial state, and to choose the step
BEFORE = 2


@dataclass
class CyrkRun(Prepared):
    solver: str
    #: evaluations of an attempted step, whether accepted or not; None where that varies
    stages: int | None

    sensitivity_source = SOURCE

    def __post_init__(self) -> None:
        super().__post_init__()
        from contactbench.peers.abi import cyrk_driver

        r = self.request
        functions = c_functions(r.scene, r.carry)
        self.compile_s, self.rhs = functions.compile_s, functions.rhs
        self.data = functions.data(r.scene.numbers())
        self.number, self.message = cyrk_driver.number(self.solver), cyrk_driver.message
        self.to_end, self.at_times = cyrk_driver.to_end, cyrk_driver.at_times
        self.end, self.size, self.clock = float(r.save_at[-1]), len(self._own_start), clock_of(r.scene)
        self.final_only = len(self.later) == 1

    def _bare(self, y0: np.ndarray) -> np.ndarray:
        r = self.request
        return self.to_end(
            self.rhs, self.number, y0, self.data, self.clock, self.end, r.rtol, r.atol, r.max_steps
        )

    def bare(self, y0: np.ndarray) -> np.ndarray:
        """The solver's own call: a packed state in, the packed state at the end out."""
        return self._bare(y0)[KNOWN:]

    def many(self, starts: np.ndarray) -> np.ndarray:
        """Facts and final state, (n, KNOWN + d), of one start (n, d) after the other, in a compiled loop."""
        from contactbench.peers.abi.cyrk_driver import in_a_loop

        r, rows = self.request, np.ascontiguousarray(starts)  # CyRK reads a state where it begins
        return in_a_loop(
            self.rhs, self.number, rows, self.data, self.clock, self.end, r.rtol, r.atol, r.max_steps
        )

    def integrate(self, y0: np.ndarray) -> Outcome:
        if self.final_only:
            told = self._bare(y0)
            status, reached, saved, steps, evaluations, *end = told.tolist()
            rows = told[None, KNOWN:]
            if status == SUCCESS and self._saves == 1:
                return self.at_end(y0, end, rows, self.counted(int(steps), int(evaluations)))
        r, later = self.request, self.later
        if not self.final_only:
            rows = np.empty((len(later), self.size))
            told = self.at_times(
                self.rhs, self.number, y0, self.data, self.clock, later, r.rtol, r.atol, r.max_steps, rows
            )
            status, reached, saved, steps, evaluations = told[:KNOWN].tolist()
        exhausted = status in TOO_MANY_STEPS
        if status != SUCCESS and not exhausted:
            steps -= 1  # CyRK counts the step that failed
        if saved < len(later):
            rows = rows[: int(saved)]
        rows = self.from_start(y0, rows)
        counts = self.counted(int(steps), int(evaluations))
        if not self.final_only:
            counts = counts._replace(rejected=None)
        if status == SUCCESS:
            return self.finished(y0, rows, counts)
        message = f"max_steps = {r.max_steps} spent" if exhausted else self.message(int(status))
        return self.finished(
            y0, rows, counts, Status.budget if exhausted else Status.failed, f"{message} (t = {reached:.6g})",
            (reached, told[KNOWN:]),
        )  # fmt: skip

    def counted(self, steps: int, evaluations: int) -> Counts:
        """The counts of a run without interpolation, which asks for evaluations of its own."""
        rejected = (evaluations - BEFORE) // self.stages - steps if self.stages else None
        return Counts(steps, evaluations, 0, rejected)

    def variational(self) -> CyrkRun:
        """The same run of the scene together with its tangent vectors."""
        carry = self.request.carry
        larger = variational_request(self.request, lambda scene, x: derivative(scene, x, carry))
        return CyrkRun(self.method, larger, self.solver, self.stages)

    def linearised(self, y0: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return integrated(self.variational(), y0)

    def count(self, counts: Counts) -> Counts:
        """With the rejected steps of a run to the last time."""
        if counts.rejected is None and self.stages:
            status, _, _, steps, evaluations = map(int, self._bare(self._own_start)[:KNOWN])
            if status == SUCCESS:
                return counts._replace(rejected=self.counted(steps, evaluations).rejected)
        return counts


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
        why = why_not()
        if why:
            return Refused(self.name, request, why)
        try:
            return CyrkRun(self.name, request, self.solver, self.stages)
        except CannotRecord as reason:
            return Refused(self.name, request, str(reason))


for _method in (
    CyrkMethod("cyrk-dop853", "DOP853", 8, "explicit Runge–Kutta 8(5,3), C++", stages=12),
    CyrkMethod("cyrk-vern8", "Vern8", 8, "Verner's explicit Runge–Kutta 8(7), C++", stages=13),
    CyrkMethod("cyrk-tsit5", "Tsit5", 5, "Tsitouras' explicit Runge–Kutta 5(4), C++", stages=6),
    CyrkMethod("cyrk-lsoda", "LSODA", None, "Adams or BDF, chosen as it goes (ODEPACK), C++"),
    CyrkMethod("cyrk-radau", "RADAU", 5, "implicit Radau IIA, Jacobian by differences, C++"),
):
    METHODS.add(_method)
