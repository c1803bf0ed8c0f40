"""Run the integrators inside `scipy.integrate.solve_ivp`, with its events and dense output."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import DenseOutput, OdeSolver
from scipy.integrate._ivp.common import warn_extraneous
from scipy.interpolate import BPoly

from contactbench.blame import is_ours
from contactbench.checks import positive
from contactbench.errors import BadInput, excerpt
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.loops import Plain, Recorded, StepLoop
from contactbench.methods.one_step import OneStep, step_map
from contactbench.methods.prepared import NO_NUMBER, Request, furthest
from contactbench.methods.prescribed import steps_in
from contactbench.numbers.control import Repeat, repeat
from contactbench.numbers.dual import Dual, slope
from contactbench.numbers.protocol import Arithmetic, CannotRecord, Count, Namespace
from contactbench.scene import AnyState, Scene, verify
from contactbench.trace.compiled import COMPILES

#: by how much, in parts of the largest slope, `fun` may differ from the scene's right-hand side
SAME = 1e-6
#: most components of a compiled step: twice `Method.largest`
LARGEST = 512
#: pieces that a run repeats: compiled as a loop of one turn, so that LLVM rounds them as in a longer one
LOOPED = (1, 2)

__all__ = ["Contact"]


@dataclass(frozen=True)
class Piece:
    """One of the four pieces of an uninterrupted run (see `FixedStep.pieces`), as a loop takes it."""

    method: FixedStep
    which: int
    whole: bool
    iterates: ClassVar[bool] = False

    @property
    def step(self) -> object:
        """Return the object that decides whether the piece belongs to this package, see `is_fixed`."""
        return type(self.method) if not is_ours(type(self.method)) else self.method.step

    def advance(
        self, scene: Scene, x: AnyState, h: Arithmetic, n: Count, xp: Namespace, repeat: Repeat = repeat
    ) -> AnyState:
        piece = self.method.pieces(scene, self.whole)[self.which]
        assert piece is not None
        if self.which not in LOOPED:
            return piece(scene, x, h, xp, repeat)
        return repeat(n, lambda x: piece(scene, x, h, xp, repeat), x)


def pieces(step: OneStep, h: float) -> list[Callable[[np.ndarray], np.ndarray]]:
    """Return the four pieces of a run of steps of size h on packed states, compiled where they can be."""
    request = Request(step.scene, "python", step.carry, np.array([1.0]), h)

    def by(loop: Callable[..., StepLoop[Any]], whole: bool) -> list[Callable[[np.ndarray], np.ndarray]]:
        def made(which: int) -> Callable[[np.ndarray], np.ndarray]:
            steps = loop(Piece(step.method, which, whole), request)
            return steps.last(steps.ready(np.array([h]), np.array([1])))

        there = enumerate(step.method.pieces(step.scene, whole))
        return [(lambda y: y) if piece is None else made(which) for which, piece in there]

    with suppress(CannotRecord):
        if COMPILES and len(step.start) <= LARGEST:
            return by(Recorded, whole=True)
    return by(partial(Plain, recorded=False), whole=False)


class Hermite(DenseOutput):
    """The Hermite polynomial of y, y' and y'' of degree five, or of degree three without y''."""

    def __init__(self, *ends: tuple[float, Sequence[np.ndarray]]) -> None:
        super().__init__(ends[0][0], ends[1][0])
        times, derivatives = zip(*sorted(ends, key=lambda end: end[0]), strict=True)
        known = min(map(len, derivatives))
        self.polynomial = BPoly.from_derivatives(times, [end[:known] for end in derivatives])

    def _call_impl(self, t: np.ndarray) -> np.ndarray:
        return np.moveaxis(self.polynomial(t), -1, 0)


class ContactSolver(OdeSolver):
    """Take equal steps of one method on one scene for SciPy's driver; see `Contact`."""

    step_map: ClassVar[OneStep]
    rhs: ClassVar[staticmethod[..., np.ndarray]]
    start: ClassVar[np.ndarray]
    labels: ClassVar[list[str]]

    y: np.ndarray

    def __init__(
        self,
        fun: Callable[[float, np.ndarray], ArrayLike],
        t0: float,
        y0: ArrayLike,
        t_bound: float,
        max_step: float = math.inf,
        vectorized: bool = False,
        **extraneous: object,
    ) -> None:
        step, scene = self.step_map, self.step_map.scene
        if max_step == math.inf:
            raise BadInput("max_step is missing: steps are equal, the longest not above it")
        if vectorized:
            raise BadInput("vectorized = True: a scene computes the slope of one state at a time")
        warn_extraneous(extraneous)
        super().__init__(fun, t0, y0, t_bound, vectorized)
        if self.n != len(self.labels):
            names = ", ".join(self.labels[:8]) + ", …" * (len(self.labels) > 8)
            raise BadInput(f"y0 has {self.n} components: must be {len(self.labels)}, {names}")
        try:
            given, own = self.fun_single(t0, self.y), self.rhs(t0, self.y)
        except NO_NUMBER as error:
            begins = getattr(scene, "t", 0.0)
            raise BadInput(f"fun({t0:g}, y0): {error}; the scene's own start is at t = {begins:g}") from error
        if given.shape != own.shape or not np.abs(given - own).max() <= SAME * np.abs(own).max():
            raise BadInput(
                f"fun({t0:g}, y0) = {excerpt(given.tolist())}: the steps solve scene {scene.name!r}, whose slope "
                f"there is {excerpt(own.tolist())}; give the solver's own rhs"
            )
        self.t0, self.taken, span = t0, 0, abs(t_bound - t0)
        self.steps = int(steps_in(span, max(abs(t0), abs(t_bound)), positive("max_step", max_step)))
        start = self.y if scene.clock is None else np.array(scene.with_clock(self.y.tolist(), float(t0)))
        self.bound = furthest(scene, step.carry, start, span)
        self.cost = step.method.per_step(scene, step.carry)
        if span:
            opening, *self.pieces = pieces(step, self.direction * (span / self.steps))
            self.kept = opening(start)
            self.ahead = scene.split_clock(self.kept)[0] - scene.split_clock(start)[0]

    def _step_impl(self) -> tuple[bool, str | None]:
        begin, lead_on, close = self.pieces
        begun = begin(self.kept)
        self.kept, reached = lead_on(begun), close(begun)
        self.taken += 1
        self.nfev += self.cost
        last, size = self.taken == self.steps, (self.t_bound - self.t0) / self.steps
        t = self.t_bound if last else self.t0 + self.taken * size
        scene = self.step_map.scene
        if scene.clock is not None:  # no sum of steps
            self.kept[scene.clock] = self.t0 + (self.taken * size + self.ahead)
        y = reached if scene.clock is None else np.delete(reached, scene.clock)
        if not ((np.abs(y[: scene.motion]) <= self.bound).all() and np.isfinite(y).all()):
            return False, f"left the scene's scale by a factor 1e6 at t = {t:.6g}"
        self.y_old, self.t, self.y = self.y, t, y
        return True, None

    def _dense_output_impl(self) -> Hermite:
        ends = (self.t_old, self.y_old), (self.t, self.y)
        return Hermite(*((t, self._derivatives(t, y)) for t, y in ends))

    def _derivatives(self, t: float, y: np.ndarray) -> list[np.ndarray]:
        """Return y, y' and, if the scene takes dual numbers, y''."""
        first = self.rhs(t, y)
        dual = list(map(Dual, y.tolist(), first.tolist()))
        try:
            second = self.step_map.scene.slopes(Dual(float(t), 1.0), dual, self.step_map.carry)
            return [y, first, np.array([slope(x) for x in second], dtype=float)]
        except (TypeError, AttributeError, *NO_NUMBER):  # a function of plain numbers
            return [y, first]


def Contact(method: str, scene: Scene | str, carry: Sequence[str] | None = None) -> type[ContactSolver]:
    """Return a solver for `solve_ivp(…, method=…)`: a fixed-step method on a scene.

    ``max_step`` is the longest step: as in `cb.solve` the span is divided into the fewest equal steps that are not
    longer, so that none is cut off at its end.  The last state equals that from ``cb.solve(scene, method,
    step=max_step, save_at=[t])`` to the bit in compiled code, except for bodies with isotropic damping and Herglotz's
    recursion; all other states agree to round-off.  The kernel of a processed method continues, and the states shown
    are postprocessed.  ``t_span`` may run backwards.

    Events and dense output are SciPy's, by a Hermite interpolant of degree five, whose error falls as h⁶ (three and
    h⁴ where a force takes floats only).  It is no contact map: laws hold at the steps, not between them.

    Its ``nfev`` counts the evaluations of the steps.

    Parameters
    ----------
    method
        A fixed-step method.
    scene
        Itself, or its name.  The time of a driven scene is SciPy's and no part of y.
    carry
        Which of s and R are part of y; by default all the scene has.

    Returns
    -------
    type
        A class for ``solve_ivp(…, method=…)``, with the scene's ``rhs(t, y)``, ``start``, (d,), and ``labels``.

    Raises
    ------
    BadInput
        For a method that is no step map or cannot do the scene; the solver without ``max_step``, for a ``fun`` that
        is not the scene's right-hand side, and for ``args`` and ``vectorized``.

    Examples
    --------
    >>> import contactbench as cb
    >>> from scipy.integrate import solve_ivp
    >>> contact = cb.scipy.Contact("contact-strang", "oscillator", carry=())
    >>> solve_ivp(contact.rhs, (0, 1), contact.start, method=contact, max_step=0.1).y.shape
    (2, 11)
    """
    step = step_map(scene, method, carry)
    made, carried = step.scene, step.carry
    if made.has_users_functions:
        verify(made)
    if made.breaks_until(math.inf):
        why = "equal steps end at none of its breaks; leave them out, and go from one to the next"
        raise BadInput(f"scene {made.name!r}: {why}")

    def rhs(t: float, y: ArrayLike, *args: object) -> np.ndarray:
        """Return the scene's slope at time t and state y, the state less the time."""
        if args:
            raise BadInput(f"args = {excerpt(args)}: parameters are the scene's own, scene.with_(…)")
        return np.array(made.slopes(float(t), np.asarray(y, dtype=float).tolist(), carried), dtype=float)

    own = {
        "step_map": step,
        "rhs": staticmethod(rhs),
        "start": np.array(made.without_clock(list(step.start)), dtype=float),
        "labels": list(made.without_clock(step.labels)),
        "__doc__": f"{method} on scene {made.name!r}, as SciPy drives it.",
        "__module__": __name__,
    }
    return type(f"Contact[{method} on {made.name}]", (ContactSolver,), own)
