"""Equations of first order without a Hamiltonian, for methods that need none."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import InitVar, dataclass, field
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from contactbench.blame import their_code
from contactbench.checks import finite, function, vector
from contactbench.errors import BadInput, excerpt
from contactbench.numbers.protocol import Arithmetic, CannotRecord
from contactbench.scene.algebra import AnyState, Vector
from contactbench.scene.base import Check, Numeric, Scene, Sizes, named_numbers
from contactbench.scene.mechanical import LARGEST_HESSIAN
from contactbench.scene.scales import RATIO, SPANS
from contactbench.trace.formula import Formula, formula


class EquationState(NamedTuple):
    """State of equations: y, an n-tuple, and the time t."""

    y: Vector
    t: Arithmetic

    @property
    def s(self) -> None:
        """There is no action."""


@lru_cache(256)
def derived_jacobian(rhs: Formula, size: int) -> Formula | None:
    """Return ∂f/∂(y, t), n rows of n + 1 numbers, as a formula of one tuple; None for an unknown derivative."""

    def together(z: Vector, **parameters: Arithmetic) -> object:
        return rhs(z[size], z[:size], **parameters)

    try:
        return formula(together, (size + 1,), rhs.names).derive(lambda rows: rows)
    except CannotRecord:
        return None


@dataclass(frozen=True, kw_only=True)
class Equations(Scene):
    """Describe any equations of first order, y' = f(t, y), with the time in the state, t' = 1.

    The solvers of other libraries run them, and Runge–Kutta methods here.  Methods that split a Hamiltonian, and those
    for q'' = f(q), refuse them: of all laws there is the error of the solution alone.

    Parameters
    ----------
    name, about, t_end, scale, slows_after, hard, stiff, mission, pace
        As of `Scene`; the name may be left out.
    rhs
        ``f(t, y, **parameters)`` → n numbers, plain arithmetic on the n-tuple y, functions from `contactbench.math`.
        Its Jacobian is derived from its operations, up to 32 components; solvers difference where it cannot be.
    y0
        The state at the start, n numbers.
    t
        The time at the start.
    parameters
        Numbers by name that the function takes.
    exact
        Closed form: ``exact(scene, t, xp)``, t since the start, a state with fields y and t.
    s
        None is taken: there is no action.

    Raises
    ------
    BadInput
        For values that are not finite, and a function that does not return n finite numbers at the start.

    Examples
    --------
    >>> import contactbench as cb
    >>> van_der_pol = cb.Equations(
    ...     rhs=lambda t, y, mu: (y[1], mu * (1 - y[0] ** 2) * y[1] - y[0]),
    ...     y0=(2.0, 0.0),
    ...     t_end=10.0,
    ...     parameters={"mu": 2.0},
    ... )
    >>> cb.solve(van_der_pol, "rk8", step=0.05).laws().index.tolist()
    ['solution_error']
    """

    name: str = "equations"
    rhs: InitVar[Callable[..., Sequence[Arithmetic]]]
    y0: Vector
    t: float = 0.0
    parameters: Mapping[str, float] = field(default_factory=dict)
    #: the function given as `rhs`, which is the name of a method of every scene
    right_hand_side: Callable[..., Sequence[Arithmetic]] = field(init=False)
    jacobian_of: Formula | None = field(init=False, repr=False, default=None)

    kind = "equations"
    functions: ClassVar[dict[str, tuple[str, ...]]] = {"right_hand_side": ("t", "y0", "**")}
    optional: ClassVar[tuple[str, ...]] = ()
    state: ClassVar[type[AnyState]] = EquationState
    initial_fields: ClassVar[tuple[str, ...]] = ("y0", "t")
    checks: ClassVar[dict[str, Check]] = {
        **Scene.checks,
        "y0": vector,
        "t": finite,
        "parameters": named_numbers,
    }
    keeps_dates = True
    has_energy = False
    may_gain_energy = True
    conformal_rate = None
    lacks = ": it has no Hamiltonian, which cb.ContactSystem(hamiltonian=…) takes"

    def __post_init__(self, rhs: Any) -> None:  # type: ignore[override]
        # a copy is made by the method of this name of the scene that is copied
        own = getattr(rhs, "__self__", None)
        if rhs is Equations.rhs:
            raise BadInput("rhs: is missing, a function lambda t, y: …")
        self._fix(
            "right_hand_side", own.right_hand_side if isinstance(own, Equations) else function("rhs", rhs)
        )
        super().__post_init__()
        if self.s:
            raise BadInput(f"s = {self.s!r}: equations have no action")
        with their_code(f"scene {self.name!r}: rhs, called with t, y"):
            slope = self.right_hand_side(self.t, self.y0, **self.parameters)
        if not isinstance(slope, tuple | list | np.ndarray):
            raise BadInput(f"rhs: must return {len(self.y0)} numbers, a tuple; it returns {excerpt(slope)}")
        vector(f"y0 = {excerpt(self.y0)}, where rhs", slope, len(self.y0))

    def with_(self, **changes: Any) -> Self:
        """Return a copy with changed parameters by keyword, perhaps with another `rhs`."""
        given = changes.pop("rhs", None)
        changed = super().with_(**changes)
        if given is None:
            return changed
        names = (f for f in self.__dataclass_fields__.values() if f.init and f.name in changed.__dict__)
        return type(self)(**{f.name: getattr(changed, f.name) for f in names}, rhs=given)

    def recorded(self) -> Self:
        """Return the scene recorded, with its Jacobian derived if possible."""
        scene = super().recorded()
        if isinstance(scene.right_hand_side, Formula) and len(scene.y0) <= LARGEST_HESSIAN:
            return scene._replaced(jacobian_of=derived_jacobian(scene.right_hand_side, len(scene.y0)))
        return scene

    # -- packing -----------------------------------------------------------------------------------
    @property
    def clock(self) -> int:
        return len(self.y0)

    def fields_in(self, carry: Sequence[str]) -> list[str]:
        return [*self.initial_fields]

    def labels(self, carry: Sequence[str]) -> list[str]:
        return [*(f"y{i + 1}" for i in range(len(self.y0))), "t"]

    def initial(self, carry: Sequence[str], **data: Any) -> EquationState:
        return EquationState(tuple(data.get("y0", self.y0)), data.get("t", self.t))

    def unpack(self, y: Sequence[Arithmetic], carry: Sequence[str]) -> EquationState:
        return EquationState(tuple(y[:-1]), y[-1])

    def data(self, x: EquationState) -> dict[str, object]:
        return {"y0": x.y, "t": x.t}

    def sizes(self, x: EquationState, end: float) -> Sizes:
        """Return the sizes of a throw with the initial slope, as long as the slope changes little."""

        def slope(span: float) -> np.ndarray:
            with suppress(ArithmeticError, ValueError):  # where a function is not defined
                there = EquationState(tuple((y + span * first).tolist()), x.t + span)
                return np.array(self.rhs(there).y, dtype=float)
            return np.full(len(y), np.nan)

        y, first = np.array(x.y, dtype=float), np.zeros(len(x.y))
        first, own, longest = slope(0.0), np.abs(y), 0.0
        fast = np.abs(first)
        moves = own + fast > 0
        for span in (end / RATIO**k for k in reversed(range(SPANS))):
            if not (np.abs(slope(span) - first) * span <= own + span / 2 * fast)[moves].all():
                break
            longest = span
        far = np.fmax(own, longest * fast)
        far = np.where(far > 0, far, longest * np.abs(slope(longest)))
        return far.tolist(), 0.0

    # -- equations ---------------------------------------------------------------------------------
    def rhs(self, x: EquationState) -> EquationState:  # type: ignore[no-redef]
        slope = self.right_hand_side(self.time(x.t), x.y, **self.parameters)
        return EquationState(tuple(slope), 1.0 + 0 * x.t)

    @property
    def has_jacobian(self) -> bool:  # type: ignore[override]
        return self.jacobian_of is not None

    def jacobian(self, x: EquationState) -> list[list[Arithmetic]] | None:
        if self.jacobian_of is None:
            return None
        rows = self.jacobian_of((*x.y, self.time(x.t)), **self.parameters)
        return [*map(list, rows), [0.0] * (len(x.y) + 1)]

    # -- no Hamiltonian ----------------------------------------------------------------------------
    def energy(self, x: EquationState) -> Numeric:
        return math.nan * x.t

    hamiltonian = hamiltonian_terms = momentum_terms = energy

    def contact_form(self, x: EquationState, dx: EquationState) -> Numeric:
        return math.nan * x.t

    contact_terms = contact_form

    def momentum(self, x: EquationState) -> None:
        return None
