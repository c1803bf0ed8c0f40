"""Run the integrators inside `scipy.integrate.solve_ivp`, with its events and dense output."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import DenseOutput, OdeSolver
from scipy.integrate._ivp.common import warn_extraneous

from contactbench.checks import positive
from contactbench.errors import BadInput, excerpt
from contactbench.methods.loops import Loop, identity
from contactbench.methods.one_step import OneStep, step_map
from contactbench.methods.prepared import NO_NUMBER, furthest
from contactbench.methods.prescribed import steps_in
from contactbench.numbers.control import Repeat, repeat
from contactbench.numbers.dual import Dual, slope
from contactbench.numbers.protocol import Arithmetic, CannotRecord, Count, Namespace
from contactbench.scene import Cache, Scene, Vector, key, verify
from contactbench.scene.algebra import AnyState
from contactbench.solution import DIVERGENCE
from contactbench.trace.compiled import COMPILES
from contactbench.trace.program import record

#: by how much, in parts of the largest slope, `fun` may differ from the scene's right-hand side
SAME = 1e-6
#: components of a step that is compiled, at most: as in `Method.largest`, twice
LARGEST = 512
#: the pieces that a run repeats: compiled as a loop of n = 1 turns, LLVM rounds them as in a longer one
LOOPED = (1, 2)

__all__ = ["Contact"]

_loops: Cache[Loop] = Cache(256)


# -- a run, step by step ---------------------------------------------------------------------------------
class Run:
    """An uninterrupted run of steps of size h; `kept` is what it goes on from, packed."""

    def __init__(self, one: OneStep, h: float, start: np.ndarray) -> None:
        try:
            if not COMPILES or len(one.start) > LARGEST:
                raise CannotRecord
            pieces = [compiled(one, h, which) for which in range(4)]
        except CannotRecord:
            pieces = [plain(one, h, which) for which in range(4)]
        opening, self.begin, self.lead_on, self.close = pieces
        self.kept = opening(start)

    def step(self) -> np.ndarray:
        begun = self.begin(self.kept)
        self.kept = self.lead_on(begun)
        return self.close(begun)


def compiled(step: OneStep, h: float, which: int) -> Callable[[np.ndarray], np.ndarray]:
    """Return a piece of a run, recorded and compiled as the loop of `cb.solve` is.  Raises `CannotRecord`."""
    scene, method, carry = step.scene, step.method, step.carry
    piece = method.pieces(scene, whole=True)[which]
    if piece is None:
        return lambda y: y
    d = len(step.start)

    def some(
        numbers: Sequence[Arithmetic], h: Arithmetic, n: Count, y: Vector, xp: Namespace, repeat: Repeat
    ) -> list[Arithmetic]:
        twin, x = scene.with_numbers(numbers), scene.unpack(y, carry)
        if which not in LOOPED:
            return scene.pack(piece(twin, x, h, xp, repeat))
        moved: AnyState = repeat(n, lambda x: piece(twin, x, h, xp, repeat), x)
        return scene.pack(moved)

    def make() -> Loop:
        return Loop(record(some, len(scene.numbers()), d, d, DIVERGENCE), 0.0)

    loop = _loops.get(key(identity(method, scene, carry), which), make)
    run, rows = loop.run, loop.rows(np.array(scene.numbers()), np.array([h]), np.array([1]))

    def apply(y: np.ndarray) -> np.ndarray:
        after = np.empty(d)
        run(y, *rows, after)
        return after

    return apply


def plain(step: OneStep, h: float, which: int) -> Callable[[np.ndarray], np.ndarray]:
    """Return a piece of a run as it is written, on floats."""
    scene = step.scene
    piece = step.method.pieces(scene, whole=False)[which]
    if piece is None:
        return lambda y: y

    def apply(y: np.ndarray) -> np.ndarray:
        x = scene.unpack(scene.entries(y), step.carry)
        return np.array(scene.pack(piece(scene, x, h, math, repeat)), dtype=float)

    return apply


# -- the interpolant -----------------------------------------------------------------------------------
class Hermite(DenseOutput):
    """The polynomial of y, hy' and, where known, h²y'' at both ends of a step: of degree three or five."""

    def __init__(self, t_old: float, t: float, ends: Sequence[Sequence[np.ndarray]]) -> None:
        super().__init__(t_old, t)
        self.coefficients: tuple[np.ndarray, ...]
        (y, d, *e), (y1, d1, *e1) = ends
        if not e:
            self.coefficients = y, d, 3 * (y1 - y) - 2 * d - d1, 2 * (y - y1) + d + d1
            return
        gap, rise, bend = y1 - y - d - e[0] / 2, d1 - d - e[0], e1[0] - e[0]
        third, fourth = 10 * gap - 4 * rise + bend / 2, 7 * rise - 15 * gap - bend
        self.coefficients = y, d, e[0] / 2, third, fourth, 6 * gap - 3 * rise + bend / 2

    def _call_impl(self, t: np.ndarray) -> np.ndarray:
        part = (t - self.t_old) / (self.t - self.t_old)
        value = np.zeros((len(self.coefficients[0]), *t.shape))
        for coefficient in reversed(self.coefficients):
            value = value * part + coefficient.reshape(-1, *[1] * t.ndim)
        return value


class ContactSolver(OdeSolver):
    """A run of equal steps of one method on one scene, as SciPy drives it; see `Contact`."""

    #: what is solved, and by what
    step_map: ClassVar[OneStep]
    rhs: ClassVar[staticmethod[[float, ArrayLike], np.ndarray]]
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
        name = self.step_map.method.name
        if max_step == math.inf:
            raise BadInput(f"max_step is missing: {name} takes equal steps, the longest not above max_step")
        warn_extraneous(extraneous)
        super().__init__(fun, t0, y0, t_bound, vectorized)
        if self.n != len(self.labels):
            names = ", ".join(self.labels[:8]) + (", …" if len(self.labels) > 8 else "")
            raise BadInput(f"y0 has {self.n} components: must be {len(self.labels)}, {names}")
        self._require_equations(t0)
        self.t0, self.taken, span = t0, 0, abs(t_bound - t0)
        self.steps = int(steps_in(span, max(abs(t0), abs(t_bound)), positive("max_step", max_step)))
        self.max_step = span / self.steps
        self.motion = self.step_map.scene.motion
        start = self.packed(t0, self.y)
        self.bound = furthest(self.step_map.scene, self.step_map.carry, start, span)
        self.cost = self.step_map.method.per_step(self.step_map.scene, self.step_map.carry)
        if span:
            self.run = Run(self.step_map, self.direction * self.max_step, start)
        self.last: tuple[float, list[np.ndarray]] | None = None

    def packed(self, t: float, y: np.ndarray) -> np.ndarray:
        scene = self.step_map.scene
        return y if scene.clock is None else np.array(scene.with_clock(y.tolist(), float(t)))

    def _require_equations(self, t0: float) -> None:
        """Raise `BadInput` where `fun` is not the scene's right-hand side, which is what the steps solve."""
        try:
            given, own = self.fun_single(t0, self.y), self.rhs(t0, self.y)
        except NO_NUMBER as error:
            begins = getattr(self.step_map.scene, "t", 0.0)
            raise BadInput(f"fun({t0:g}, y0): {error}; the scene's own start is at t = {begins:g}") from error
        if given.shape == own.shape and np.abs(given - own).max() <= SAME * np.abs(own).max():
            return
        scene = self.step_map.scene.name
        raise BadInput(
            f"fun({t0:g}, y0) = {excerpt(given.tolist())}: the steps solve scene {scene!r}, whose slope there is "
            f"{excerpt(own.tolist())}; give the solver's own rhs"
        )

    def _step_impl(self) -> tuple[bool, str | None]:
        try:
            reached = self.run.step()
        except NO_NUMBER:  # Python's way to say inf or nan
            reached = np.full(len(self.step_map.start), math.nan)
        self.taken += 1
        span = self.t_bound - self.t0
        t = self.t_bound if self.taken == self.steps else self.t0 + self.taken * (span / self.steps)
        clock = self.step_map.scene.clock
        y = reached if clock is None else np.delete(reached, clock)
        self.nfev += self.cost
        if not ((np.abs(y[: self.motion]) <= self.bound).all() and np.isfinite(y).all()):
            return False, f"left the scene's scale by a factor 1e6 at t = {t:.6g}"
        self.t, self.y = t, y
        return True, None

    def _dense_output_impl(self) -> Hermite:
        before, after = self._end(self.t_old, self._y_old), self._end(self.t, self.y)
        size = self.t - self.t_old
        ends = [[d * size**k for k, d in enumerate(end)] for end in (before, after)]
        degree = min(map(len, ends))
        return Hermite(self.t_old, self.t, [end[:degree] for end in ends])

    def step(self) -> str | None:
        self._y_old = self.y
        message: str | None = super().step()
        return message

    def _end(self, t: float, y: np.ndarray) -> list[np.ndarray]:
        """Return y, y' and, where dual numbers pass through the scene, y''."""
        if self.last is not None and self.last[0] == t:
            return self.last[1]
        scene, carry, first = self.step_map.scene, self.step_map.carry, self.rhs(t, y)
        found = [y, first]
        dual = list(map(Dual, y.tolist(), first.tolist()))
        try:
            second = scene.slopes(Dual(float(t), 1.0), dual, carry)
            found.append(np.array([slope(x) for x in second], dtype=float))
        except (TypeError, AttributeError, *NO_NUMBER):  # a function of plain numbers
            pass
        self.last = t, found
        return found


def Contact(method: str, scene: Scene | str, carry: Sequence[str] | None = None) -> type[ContactSolver]:
    """Return a solver for `solve_ivp(…, method=…)`: a fixed-step method on a scene.

    ``max_step`` is the longest step: as in `cb.solve` the span is divided into the fewest equal steps that are not
    longer, so that none is cut off at its end.  The last state is that of ``cb.solve(scene, method, step=max_step,
    save_at=[t])`` to the bit where numba compiles it, but on bodies with isotropic damping and by Herglotz's
    recursion; there, and before, states agree to round-off: the kernel of a processed method goes on, what
    is shown is postprocessed.  ``t_span`` may run backwards.

    Events and dense output are SciPy's, by a Hermite interpolant of degree five, whose error falls as h⁶ (three and
    h⁴ where a force takes floats only).  It is no contact map: laws hold at the steps, not between them.

    Its ``nfev`` counts what the steps evaluate.

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
        For a method that is no step map or cannot do the scene; the solver for a ``fun`` that is not the scene's
        right-hand side, and without ``max_step``.

    Examples
    --------
    >>> import contactbench as cb
    >>> from scipy.integrate import solve_ivp
    >>> contact = cb.scipy.Contact("contact-strang", "oscillator", carry=())
    >>> solve_ivp(contact.rhs, (0, 1), contact.start, method=contact, max_step=0.1).y.shape
    (2, 11)
    """
    step = step_map(scene, method, carry)
    if step.scene.has_users_functions:
        verify(step.scene)
    if step.scene.breaks_until(math.inf):
        why = "equal steps end at none of its breaks; leave them out, and go from one to the next"
        raise BadInput(f"scene {step.scene.name!r}: {why}")
    made, carried = step.scene, step.carry

    def rhs(t: float, y: ArrayLike) -> np.ndarray:
        """Return the scene's slope at time t and state y, the state less the time."""
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
