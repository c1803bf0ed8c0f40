"""Mechanical scenes: kinetic energy, potential, damping."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, ClassVar, Self

import numpy as np

from contactbench.errors import (
    BadInput,
    excerpt,
    finite,
    function,
    is_ours,
    positive,
    require_number,
    switch,
    their_code,
    vector,
)
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene.algebra import State, Vector, cross, dot, norm, scaled
from contactbench.scene.base import Check, Scene, named_numbers, optional
from contactbench.scene.scales import in_order, reach
from contactbench.trace.formula import Formula, formula

#: components up to which a Hessian is derived
LARGEST_HESSIAN = 32
#: derivatives of formulas, taken once; both raise `CannotRecord` where one is not known
derived_gradient = lru_cache(256)(Formula.gradient)
derived_hessian = lru_cache(256)(Formula.hessian)


def masses(name: str, value: Any) -> Any:
    """Return one number > 0, or a tuple of such; raise `BadInput` for anything else."""
    if callable(value) or np.ndim(value) > 1:
        how = "a constant matrix is diagonal in other coordinates; one that depends on q SciPy's solve_ivp takes"
        why = f"{name} = {excerpt(value)}: must be one number > 0, or one for every component; {how}"
        raise BadInput(why)
    if not isinstance(value, tuple | list | np.ndarray) or np.ndim(value) == 0:
        return positive(name, value)
    return tuple(positive(f"{name}[{i}]", each) for i, each in enumerate(vector(name, value)))


def sign(number: Any) -> int:
    return int(number > 0) - int(number < 0)


def damping_rate(name: str, value: Any) -> float:
    """Return a finite number; raise `BadInput` for anything else, which says how a function is given."""
    if callable(value):
        how = "one of time is cb.Driven(rate=lambda t: …), one of s cb.GeneralDamping(damping=…); of q solve_ivp"
        raise BadInput(f"{name} = {excerpt(value)}: must be a number; {how}")
    if np.ndim(value):
        how = "a rate for each momentum cb.diffrax.Contact takes, a matrix SciPy's solve_ivp"
        raise BadInput(f"{name} = {excerpt(value)}: must be a number; {how}")
    return finite(name, value)


class Canonical(Scene):
    """What all scenes with H = T(p) + V(q) + γ s + ½ κ s² share, however their components are kept."""

    #: T(p), and V and ∇V at a state
    kinetic: Callable[[Vector], Any]
    potential_at: Callable[[Any], Any]
    gradient_at: Callable[[Any], Vector]
    gamma: Any
    inverse_mass: Any
    kappa: Any = 0.0
    kappa_sign: int = 0

    def velocity(self, p: Vector) -> Vector:
        return scaled(self.inverse_mass, p)

    def product(self, a: Vector, b: Vector) -> Any:
        return dot(a, b)

    def damping_at(self, x: Any) -> Any:
        return self.gamma

    @property
    def nonlinear_damping(self) -> bool:
        return self.kappa_sign != 0

    def energy(self, x: State) -> Any:
        return self.kinetic(x.p) + self.potential_at(x)

    def dissipation(self, s: Any) -> Any:
        linear = self.gamma * s
        return linear + self.kappa * s * s / 2 if self.nonlinear_damping else linear

    def dissipation_rate(self, s: Any) -> Any:
        return self.gamma + self.kappa * s if self.nonlinear_damping else self.gamma

    def hamiltonian(self, x: State) -> Any:
        return self.energy(x) + self.dissipation(x.s)

    def rhs(self, x: State) -> State:
        rate = self.dissipation_rate(x.s)
        force = tuple(-g - rate * p for g, p in zip(self.gradient_at(x), x.p, strict=True))
        if x.s is None:
            return State(self.velocity(x.p), force)
        return State(
            self.velocity(x.p), force, self.kinetic(x.p) - self.potential_at(x) - self.dissipation(x.s)
        )

    def sizes(self, x: State, end: float) -> tuple[np.ndarray, Any]:
        far, fast = reach(self, x, end)
        masses = tuple(1 / each for each in self.velocity(tuple(1.0 + 0 * c for c in x.p)))
        flat = self.pack(State(x.q, tuple(fast * mass for mass in masses)))
        momenta = np.array(np.broadcast_arrays(*flat), dtype=float)[len(flat) // 2 :]
        places = np.broadcast_to(far, momenta.shape)
        return np.concatenate([places, momenta]), in_order(far) * in_order(momenta.max(axis=0))

    @property
    def rate_changes(self) -> bool:  # type: ignore[override]
        return self.nonlinear_damping

    @property
    def may_gain_energy(self) -> bool:  # type: ignore[override]
        return self.nonlinear_damping or self.gamma <= 0

    @property
    def bounds_energy(self) -> bool:
        return not self.nonlinear_damping and self.gamma >= 0

    def energy_terms(self, x: State) -> Any:
        return self.kinetic(x.p) + abs(self.potential_at(x))

    def contact_form(self, x: State, dx: State) -> Any:
        return dx.s - self.product(x.p, dx.q)

    def contact_terms(self, x: State, dx: State) -> Any:
        return abs(dx.s) + self.product(x.p, x.p) ** 0.5 * self.product(dx.q, dx.q) ** 0.5

    def hamiltonian_terms(self, x: State) -> Any:
        kinetic = self.kinetic(x.p)
        return abs(kinetic) + abs(self.hamiltonian(x) - kinetic)

    @property
    def conformal_rate(self) -> Any:
        return None if self.nonlinear_damping else self.gamma


@dataclass(frozen=True, kw_only=True)
class Mechanical(Canonical):
    """H = ‖p‖²/2m + V(q) + γ s + ½ κ s² on T*Rⁿ × R.

    The functions may read globals or attributes: every solve, run and reference is of what they compute when it
    is prepared.

    Parameters
    ----------
    potential
        ``V(q, **parameters) -> number``.
    gradient
        ``dV(q, **parameters) -> n-tuple``; by default derived from the potential.
    hessian
        ``(q, **parameters) -> n×n`` nested tuples; by default derived up to 32 components; solvers difference where
        there is none.
    q, p
        Initial coordinates and momenta, n numbers each.
    gamma, kappa
        Damping; κ ≠ 0 makes s part of the dynamics.
    mass
        > 0; one number, or one for every component.
    parameters
        Numbers by name that the functions take.
    rotation_invariant
        Whether V(Rq) = V(q), so that the angular momentum obeys J' = −Γ'(s) J.

    Raises
    ------
    BadInput
        For lengths that differ, values that are not finite, mass ≤ 0, t_end ≤ 0.
    """

    potential: Callable[..., Any]
    gradient: Callable[..., Vector] | None = None
    q: Vector
    p: Vector
    gamma: float = 0.0
    kappa: float = 0.0
    mass: Any = 1.0
    hessian: Callable[..., Any] | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    rotation_invariant: bool = False
    inverse_mass: Any = field(init=False, repr=False, default=1.0)
    #: 1, 0 or −1, the sign of κ (decided by the original κ, not by a tracer): flows differ by it; None: any
    kappa_sign: int = field(init=False, repr=False, default=0)

    kind: ClassVar[str] = "mechanical"
    functions: ClassVar[Any] = dict.fromkeys(("potential", "gradient", "hessian"), ("q", "**"))
    state: ClassVar[Any] = State
    initial_fields: ClassVar[tuple[str, ...]] = ("q", "p", "s")
    coefficients: ClassVar[tuple[str, ...]] = ("gamma", "kappa", "mass")
    reciprocals: ClassVar[dict[str, str]] = {"mass": "inverse_mass"}
    checks: ClassVar[dict[str, Check]] = {
        **Scene.checks,
        "potential": function,
        "gradient": optional(function),
        "hessian": optional(function),
        "q": vector,
        "p": vector,
        "gamma": damping_rate,
        "kappa": finite,
        "mass": masses,
        "rotation_invariant": switch,
        "parameters": named_numbers,
    }
    canonical: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        self._fix("kappa_sign", sign(self.kappa))
        if isinstance(self.mass, tuple) and len(self.mass) != len(self.q):
            raise BadInput(f"mass = {excerpt(self.mass)}: must be one number > 0, or {len(self.q)} of them")
        if len(self.q) != len(self.p):
            raise BadInput(f"q has {len(self.q)} components and p {len(self.p)}: they must agree")
        with their_code(f"q = {excerpt(self.q)}: the gradient of scene {self.name!r}"):
            force = self.dV(self.q)
        if not isinstance(force, tuple | list | np.ndarray):
            wanted = f"must return {len(self.q)} numbers, a tuple"
            raise BadInput(f"gradient: {wanted}; it returns {excerpt(force)}")
        vector(f"q = {excerpt(self.q)}, where gradient", force, len(self.q))

    @property
    def required(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("s",) if self.nonlinear_damping else ()

    def unpack(self, y: Sequence[Any], carry: Sequence[str]) -> State:
        n = len(self.q)
        return State(tuple(y[:n]), tuple(y[n : 2 * n]), y[2 * n] if "s" in carry else None)

    @property
    def decided(self) -> tuple[Any, ...]:  # type: ignore[override]
        return (self.kappa_sign,)

    def _decide(self, like: Any = None) -> Self:
        return self._replaced(kappa_sign=sign(self.kappa) if like is None else like.kappa_sign)

    def orders(self) -> list[tuple[int, int, bool]]:
        if "kappa" not in self.coefficients:
            return super().orders()
        i, zero = self.coefficients.index("kappa"), len(self.numbers())
        found = [(zero, i, self.kappa_sign > 0)] if self.kappa_sign >= 0 else []
        return super().orders() + found + ([(i, zero, self.kappa_sign < 0)] if self.kappa_sign <= 0 else [])

    def recorded(self) -> Self:
        """Return the scene recorded, with a gradient and a Hessian derived where they are left out."""
        scene = super().recorded()
        if scene.gradient is None:
            sizes = tuple(len(self.q) if name == "q" else 0 for name in self.functions["potential"][:-1])
            try:
                potential = scene.potential
                if not isinstance(potential, Formula):
                    potential = formula(potential, sizes, tuple(self.parameters))
                scene = scene._replaced(gradient=derived_gradient(potential))
            except CannotRecord as why:
                missing = "its gradient is missing, and the potential cannot be differentiated"
                if isinstance(why.__cause__, TypeError) and "positional argument" in str(why):
                    takes = ", ".join(self.functions["potential"][:-1])
                    missing += f" (it is called with {takes}; cb.Driven has the time, lambda q, t: …)"
                raise BadInput(f"scene {self.name!r}: {missing}: {why}") from why
        if not is_ours(type(self)) or "hessian" not in self.functions or scene.hessian is not None:
            return scene
        if isinstance(scene.gradient, Formula) and len(scene.q) <= LARGEST_HESSIAN:
            with suppress(CannotRecord):
                scene = scene._replaced(hessian=derived_hessian(scene.gradient))
        return scene

    # -- physics -------------------------------------------------------------------------------
    def kinetic(self, p: Vector) -> Any:
        if isinstance(self.inverse_mass, tuple):
            return dot(p, scaled(self.inverse_mass, p)) / 2
        return dot(p, p) * self.inverse_mass / 2

    def V(self, q: Vector) -> Any:
        return self.potential(q, **self.parameters)

    def dV(self, q: Vector) -> Vector:
        return (self.gradient or self.recorded().gradient)(q, **self.parameters)  # type: ignore[misc]

    def potential_at(self, x: Any) -> Any:
        return self.V(x.q)

    def gradient_at(self, x: Any) -> Vector:
        return self.dV(x.q)

    @property
    def has_jacobian(self) -> bool:  # type: ignore[override]
        return self.hessian is not None

    def jacobian(self, x: State) -> list[list[Any]] | None:
        if self.hessian is None or not self.has_jacobian:
            return None
        n = len(x.q)
        hess = self.hessian(x.q, **self.parameters)
        rate = self.dissipation_rate(x.s)
        tail: list[Any] = [] if x.s is None else [0.0]
        over_m = scaled(self.inverse_mass, [1.0] * n)
        rows = [[0.0] * n + [over_m[i] if i == j else 0.0 for j in range(n)] + tail for i in range(n)]
        for i in range(n):
            damping = [-rate if i == j else 0.0 for j in range(n)]
            column = [-self.kappa * x.p[i]] if x.s is not None and self.nonlinear_damping else tail
            rows.append([-hess[i][j] for j in range(n)] + damping + column)
        if x.s is not None:
            rows.append([-g for g in self.dV(x.q)] + [*scaled(self.inverse_mass, x.p)] + [-rate])
        return rows

    def momentum(self, x: State) -> Vector | None:
        """Return the angular momentum q × p (one component in the plane, three in space), else None."""
        q, p = x.q, x.p
        if len(q) == 2:
            return (q[0] * p[1] - q[1] * p[0],)
        return cross(q, p) if len(q) == 3 else None

    @property
    def has_momentum_law(self) -> bool:  # type: ignore[override]
        return self.rotation_invariant and len(self.q) in (2, 3)

    @property
    def has_torque(self) -> bool:  # type: ignore[override]
        return len(self.q) == 2 and not self.rotation_invariant and not self.nonlinear_damping

    def momentum_terms(self, x: State) -> Any:
        return norm(x.q) * norm(x.p)


@dataclass(frozen=True, kw_only=True)
class GeneralDamping(Mechanical):
    """H = ‖p‖²/2m + V(q) + Γ(s) for any smooth Γ, on the three-part splitting: kick, drift and damping.

    Nyström tables, Herglotz's recursion and `contact-adaptive` refuse it: their flows need a Γ at most quadratic.

        GeneralDamping(name="cubic", potential=V, gradient=dV, q=(1.0,), p=(0.0,), s=0.5, t_end=10.0,
                       damping=lambda s: 0.1 * s + s**3, damping_slope=lambda s: 0.1 + 3 * s * s)

    Parameters
    ----------
    damping, damping_slope
        ``Γ(s) -> number`` and ``Γ'(s) -> number``, plain arithmetic like the force.
    damping_flow
        ``(s, h, xp) -> s(h)``, the solution of s' = −Γ(s) where it is known in closed form; by default it is found
        by quadrature (`splitting.dissipation`), many evaluations of Γ a step.

    Raises
    ------
    BadInput
        As `Mechanical` does, and for a gamma or kappa beside Γ.
    """

    damping: Callable[[Any], Any]
    damping_slope: Callable[[Any], Any]
    damping_flow: Callable[[Any, Any, Any], Any] | None = None

    kind: ClassVar[str] = "general damping"
    functions: ClassVar[dict[str, tuple[str, ...]]] = {
        **Mechanical.functions,
        **dict.fromkeys(("damping", "damping_slope"), ("s",)),
        "damping_flow": ("s", "h", "xp"),
    }

    coefficients: ClassVar[tuple[str, ...]] = ("mass",)
    checks: ClassVar[dict[str, Check]] = {
        **Mechanical.checks,
        "damping": function,
        "damping_slope": function,
        "damping_flow": optional(function),
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gamma or self.kappa:
            raise BadInput(f"gamma = {self.gamma!r}, kappa = {self.kappa!r}: Γ has them in it")
        for name in ("damping", "damping_slope", "damping_flow"):
            if getattr(self, name) is not None:
                require_number(name, self._value(name))

    required = ("s",)

    nonlinear_damping = True

    def dissipation(self, s: Any) -> Any:
        return self.damping(s)

    def dissipation_rate(self, s: Any) -> Any:
        return self.damping_slope(s)

    #: Γ'' is not asked for: solvers difference
    has_jacobian = False
