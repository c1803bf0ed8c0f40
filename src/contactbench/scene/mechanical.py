"""Mechanical scenes: kinetic energy, potential, damping."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from math import isfinite
from typing import Any, ClassVar, Self

import numpy as np

from contactbench.boundary import is_ours, user_error
from contactbench.errors import BadInput, excerpt, finite, function, is_real, positive, switch, vector
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene.algebra import State, Vector, cross, dot, norm
from contactbench.scene.base import Scene
from contactbench.trace.formula import Formula, formula

#: components up to which a Hessian is derived
LARGEST_HESSIAN = 32


@lru_cache(256)
def derived_gradient(potential: Formula) -> Formula:
    """Return ∇V from V.  Raises `BadInput` for a function whose derivative is not known."""
    try:
        return potential.gradient()
    except CannotRecord as why:
        raise BadInput(f"the gradient is missing, and cannot be derived from the potential: {why}") from why


@lru_cache(256)
def derived_hessian(gradient: Formula) -> Formula:
    """Return the Hessian from ∇V.  Raises `CannotRecord`."""
    return gradient.hessian()


@dataclass(frozen=True, kw_only=True)
class Mechanical(Scene):
    """H = ‖p‖²/2m + V(q) + γ s + ½ κ s² on T*Rⁿ × R.

    The functions may read globals or attributes: every solve, run and reference is of what they compute when it
    is prepared.

    Parameters
    ----------
    potential
        ``V(q, **parameters) -> number``.
    gradient, hessian
        ``dV(q, **parameters) -> n-tuple`` and ``(q, **parameters) -> n×n`` nested tuples; by default derived from the
        potential (the Hessian up to 32 components; solvers difference where there is none).
    q, p
        Initial coordinates and momenta, n numbers each.
    gamma, kappa
        Damping; κ ≠ 0 makes s part of the dynamics.
    mass
        > 0.
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
    mass: float = 1.0
    hessian: Callable[..., Any] | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    rotation_invariant: bool = False
    #: kept so that no division is left in the right-hand side: compiled loops run up to twice as fast
    inverse_mass: Any = field(init=False, repr=False, default=1.0)

    kind: ClassVar[str] = "mechanical"
    functions: ClassVar[dict[str, tuple[str, ...]]] = dict.fromkeys(
        ("potential", "gradient", "hessian"), ("q", "**")
    )
    initial_fields: ClassVar[tuple[str, ...]] = ("q", "p", "s")
    canonical: ClassVar[bool] = True

    def __post_init__(self) -> None:
        self._check_kinds()
        fix = object.__setattr__
        fix(self, "q", vector("q", self.q))
        fix(self, "p", vector("p", self.p))
        if len(self.q) != len(self.p):
            raise BadInput(f"q has {len(self.q)} components and p {len(self.p)}: they must agree")
        for name in ("gamma", "kappa", "s"):
            fix(self, name, finite(name, getattr(self, name)))
        fix(self, "mass", positive("mass", self.mass))
        fix(self, "inverse_mass", finite(f"mass = {self.mass!r}: 1/mass", 1 / self.mass))
        fix(self, "t_end", positive("t_end", self.t_end))
        fix(self, "parameters", {k: finite(k, v) for k, v in self.parameters.items()})
        self._check_force()

    def _check_kinds(self) -> None:
        super()._check_kinds()
        function("potential", self.potential)
        for name in ("gradient", "hessian"):
            if getattr(self, name) is not None:
                function(name, getattr(self, name))
        switch("rotation_invariant", self.rotation_invariant)
        names = self.parameters if isinstance(self.parameters, Mapping) else [None]
        if not all(isinstance(name, str) and name.isidentifier() for name in names):
            raise BadInput(f"parameters = {excerpt(self.parameters)}: must be a dict of numbers by name")
        self._check_names(self.parameters)

    def _check_force(self) -> None:
        """Raise `BadInput` unless the gradient at the initial position is n finite numbers."""
        try:
            force = self.dV(self.q)
        except (ZeroDivisionError, OverflowError):
            raise BadInput(
                f"q = {excerpt(self.q)}: the force of scene {self.name!r} is singular there"
            ) from None
        except (ValueError, IndexError, TypeError) as error:
            raise BadInput(
                f"q = {excerpt(self.q)}: wrong for scene {self.name!r}, whose gradient says: "
                f"{user_error(type(error).__name__, error)}"
            ) from error
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            raise user_error(f"scene {self.name!r}", error) from error
        if not isinstance(force, tuple | list | np.ndarray):
            raise BadInput(
                f"gradient: must return {len(self.q)} numbers, a tuple; it returns {excerpt(force)}"
            )
        if len(force) != len(self.q):
            raise BadInput(f"q = {excerpt(self.q)}: scene {self.name!r} needs {len(force)} components")
        if not all(is_real(f) and hasattr(f, "__float__") for f in force):
            raise BadInput(f"gradient: must return real numbers; it returns {excerpt(force)}")
        if not all(isfinite(f) for f in force):
            raise BadInput(f"q = {excerpt(self.q)}: the force of scene {self.name!r} is not finite there")

    @property
    def required(self) -> tuple[str, ...]:
        return ("s",) if self.kappa else ()

    def labels(self, carry: Sequence[str]) -> list[str]:
        n = len(self.q)
        names = [f"q{i + 1}" for i in range(n)] + [f"p{i + 1}" for i in range(n)]
        return names + [c for c in self.optional if c in carry]

    def initial(self, carry: Sequence[str], **data: Any) -> State:
        values = {f: getattr(self, f) for f in self.initial_fields} | data
        return State(tuple(values["q"]), tuple(values["p"]), values["s"] if "s" in carry else None)

    def unpack(self, y: Sequence[Any], carry: Sequence[str]) -> State:
        n = len(self.q)
        return State(tuple(y[:n]), tuple(y[n : 2 * n]), y[2 * n] if "s" in carry else None)

    def numbers(self) -> list[float]:
        return [self.gamma, self.kappa, self.mass, *self.parameters.values()]

    def number_names(self) -> list[str]:
        return ["gamma", "kappa", "mass", *self.parameters]

    def with_numbers(self, numbers: Sequence[Any]) -> Self:
        gamma, kappa, mass, *rest = numbers
        parameters = dict(zip(self.parameters, rest, strict=True))
        own = {"gamma": gamma, "kappa": kappa, "mass": mass, "inverse_mass": 1 / mass}
        return self._replaced(**own, parameters=parameters, _kappa_sign=self.kappa_sign)

    @property
    def kappa_sign(self) -> int:
        """1, 0 or −1, the sign of κ (decided by the original κ, not by a tracer): flows differ by it."""
        known = self.__dict__.get("_kappa_sign")
        return int(self.kappa > 0) - int(self.kappa < 0) if known is None else known

    @property
    def nonlinear_damping(self) -> bool:
        """Whether Γ has its quadratic term."""
        return self.kappa_sign != 0

    @property
    def structure(self) -> tuple[Any, ...]:
        functions = self.potential, self.gradient, self.hessian
        return (Mechanical, *functions, len(self.q), tuple(self.parameters), self.kappa_sign)

    def recorded(self) -> Self:
        """Return the scene recorded, with a gradient and a Hessian derived where they are left out."""
        scene = super().recorded()
        if scene.gradient is None:
            scene = scene._replaced(gradient=derived_gradient(scene._potential_formula()))
        if not is_ours(type(self)) or "hessian" not in self.functions or scene.hessian is not None:
            return scene
        if isinstance(scene.gradient, Formula) and len(scene.q) <= LARGEST_HESSIAN:
            with suppress(CannotRecord):
                scene = scene._replaced(hessian=derived_hessian(scene.gradient))
        return scene

    def _potential_formula(self) -> Formula:
        """Return the potential as a formula; `BadInput` where it cannot be recorded."""
        if isinstance(self.potential, Formula):
            return self.potential
        sizes = tuple(len(self.q) if name == "q" else 0 for name in self.functions["potential"][:-1])
        try:
            return formula(self.potential, sizes, tuple(self.parameters))
        except CannotRecord as why:
            raise BadInput(
                f"scene {self.name!r}: its gradient is missing, and the potential cannot be differentiated: {why}"
            ) from why

    # -- physics -------------------------------------------------------------------------------
    def kinetic(self, p: Vector) -> Any:
        """Return T(p) = ‖p‖²/2m."""
        return dot(p, p) * self.inverse_mass / 2

    def V(self, q: Vector) -> Any:
        return self.potential(q, **self.parameters)

    def dV(self, q: Vector) -> Vector:
        return (self.gradient or self.recorded().gradient)(q, **self.parameters)  # type: ignore[misc]

    def potential_at(self, x: Any) -> Any:
        """Return V at a state."""
        return self.V(x.q)

    def gradient_at(self, x: Any) -> Vector:
        """Return ∇V at a state."""
        return self.dV(x.q)

    def damping_at(self, x: Any) -> Any:
        """Return γ at a state."""
        return self.gamma

    def energy(self, x: State) -> Any:
        """Return H0 = T + V."""
        return self.kinetic(x.p) + self.potential_at(x)

    def dissipation(self, s: Any) -> Any:
        """Return Γ(s) = γ s + ½ κ s²."""
        linear = self.gamma * s
        return linear + self.kappa * s * s / 2 if self.nonlinear_damping else linear

    def dissipation_rate(self, s: Any) -> Any:
        """Return Γ'(s) = γ + κ s."""
        return self.gamma + self.kappa * s if self.nonlinear_damping else self.gamma

    def hamiltonian(self, x: State) -> Any:
        """Return H = H0 + Γ(s); needs s."""
        return self.energy(x) + self.dissipation(x.s)

    def rhs(self, x: State) -> State:
        rate = self.dissipation_rate(x.s)
        velocity = tuple(p * self.inverse_mass for p in x.p)
        force = tuple(-g - rate * p for g, p in zip(self.dV(x.q), x.p, strict=True))
        if x.s is None:
            return State(velocity, force)
        return State(velocity, force, self.kinetic(x.p) - self.V(x.q) - self.dissipation(x.s))

    @property
    def has_jacobian(self) -> bool:
        return self.hessian is not None

    def jacobian(self, x: State) -> list[list[Any]] | None:
        """Return ∂(rhs)/∂(state) in packed order, or None when the scene has no Hessian."""
        if self.hessian is None:
            return None
        n = len(x.q)
        hess = self.hessian(x.q, **self.parameters)
        rate = self.dissipation_rate(x.s)
        tail: list[Any] = [] if x.s is None else [0.0]
        rows = [[0.0] * n + [self.inverse_mass if i == j else 0.0 for j in range(n)] + tail for i in range(n)]
        for i in range(n):
            damping = [-rate if i == j else 0.0 for j in range(n)]
            column = [] if x.s is None else [-self.kappa * x.p[i] if self.nonlinear_damping else 0.0]
            rows.append([-hess[i][j] for j in range(n)] + damping + column)
        if x.s is not None:
            rows.append([-g for g in self.dV(x.q)] + [p * self.inverse_mass for p in x.p] + [-rate])
        return rows

    def momentum(self, x: State) -> Vector | None:
        """Return the angular momentum q × p (one component in the plane, three in space), else None."""
        q, p = x.q, x.p
        if len(q) == 2:
            return (q[0] * p[1] - q[1] * p[0],)
        return cross(q, p) if len(q) == 3 else None

    def torque(self, x: State) -> Vector | None:
        """Return −q × ∇V, the rate at which the potential changes the angular momentum."""
        return self.momentum(State(x.q, tuple(-g for g in self.gradient_at(x))))

    @property
    def has_momentum_law(self) -> bool:
        return self.rotation_invariant and len(self.q) in (2, 3)

    @property
    def has_torque(self) -> bool:
        return len(self.q) == 2 and not self.rotation_invariant and not self.nonlinear_damping

    @property
    def rate_changes(self) -> bool:
        return self.nonlinear_damping

    @property
    def may_gain_energy(self) -> bool:
        return self.nonlinear_damping or self.gamma <= 0

    @property
    def bounds_energy(self) -> bool:
        return not self.nonlinear_damping and self.gamma >= 0

    def energy_terms(self, x: State) -> Any:
        """Return T + |V|."""
        return self.kinetic(x.p) + abs(self.potential_at(x))

    def contact_form(self, x: State, dx: State) -> Any:
        """Return η(dx) = ds − p·dq at x."""
        return dx.s - dot(x.p, dx.q)

    def contact_terms(self, x: State, dx: State) -> Any:
        """Return |ds| + ‖p‖‖dq‖."""
        return abs(dx.s) + norm(x.p) * norm(dx.q)

    def hamiltonian_terms(self, x: State) -> Any:
        """Return |T| + |V + Γ|."""
        kinetic = self.kinetic(x.p)
        return abs(kinetic) + abs(self.hamiltonian(x) - kinetic)

    def momentum_terms(self, x: State) -> Any:
        """Return ‖q‖‖p‖."""
        return norm(x.q) * norm(x.p)

    def tangents(self, x: State) -> list[State]:
        """Return the coordinate basis of the tangent space at x, in packed order."""
        flat = self.pack(x)
        carry = ("s",) if x.s is not None else ()
        size = len(flat)
        return [self.unpack([1.0 if i == j else 0.0 for j in range(size)], carry) for i in range(size)]

    @property
    def conformal_rate(self) -> Any:
        return None if self.nonlinear_damping else self.gamma
