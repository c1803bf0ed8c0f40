"""Mechanical scenes: kinetic energy, potential, damping."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from operator import add
from typing import Any, ClassVar, Self

import numpy as np

from contactbench.blame import is_ours, their_code
from contactbench.checks import finite, function, positive, switch, vector
from contactbench.errors import BadInput, excerpt
from contactbench.numbers.control import choose, settle
from contactbench.numbers.functions import namespace
from contactbench.numbers.protocol import Arithmetic, CannotRecord, Namespace
from contactbench.scene.algebra import State, Vector, dot, norm, scaled, times
from contactbench.scene.base import Check, Numeric, OwnState, Sizes, as_formula, optional
from contactbench.scene.canonical import Canonical, angular_momentum
from contactbench.scene.contact_system import on_metric
from contactbench.scene.flow import Constants, Flow, damped_time, damping, plain
from contactbench.scene.scales import reach, scale_of
from contactbench.trace.formula import Formula

#: most components with a derived Hessian
LARGEST_HESSIAN = 32
#: cached derivatives of formulas; both raise `CannotRecord` for an unknown derivative
derived_gradient = lru_cache(256)(Formula.gradient)
derived_hessian = lru_cache(256)(Formula.hessian)


def each_positive(name: str, value: Any) -> float | tuple[float, ...]:
    """Return one number > 0, or a tuple of such; raise `BadInput` for anything else."""
    if np.ndim(value) == 0:
        return positive(name, value)
    return tuple(positive(f"{name}[{i}]", each) for i, each in enumerate(vector(name, value)))


def masses(name: str, value: Any) -> float | tuple[float, ...]:
    """Return masses; for a matrix raise `BadInput` with the way to give it."""
    if callable(value) or np.ndim(value) > 1:
        how = "a matrix, constant or not, is cb.Mechanical(mass=lambda q: …), a function of q"
        why = f"{name} = {excerpt(value)}: must be one number > 0, or one for every component; {how}"
        raise BadInput(why)
    return each_positive(name, value)


def sign(number: Arithmetic) -> int:
    return int(number > 0) - int(number < 0)


def damping_rate(name: str, value: Any) -> float:
    """Return a finite number; for a function or an array raise `BadInput` with the way to give it."""
    if callable(value):
        how = "of time is cb.Driven(rate=lambda t: …), of s cb.GeneralDamping(damping=…), of q and s cb.ContactSystem"
        raise BadInput(f"{name} = {excerpt(value)}: must be a number; {how}")
    if np.ndim(value):
        how = "a rate for each momentum cb.diffrax.Contact takes, a matrix cb.Equations(rhs=…)"
        raise BadInput(f"{name} = {excerpt(value)}: must be a number; {how}")
    return finite(name, value)


# -- flows -----------------------------------------------------------------------------------------
def kick(scene: Mechanical, x: State, h: Arithmetic, xp: Namespace) -> State:
    """B: p −= h ∇V(q), s −= h V(q)."""
    p = tuple(p - h * g for p, g in zip(x.p, scene.gradient_at(x), strict=True))
    return x._replace(p=p, s=None if x.s is None else x.s - h * scene.potential_at(x))


def drift(scene: Mechanical, x: State, h: Arithmetic, xp: Namespace) -> State:
    """A: q += h p/m, s += h T(p).  (T is homogeneous of degree two: p·T_p − T = T.)"""
    q = tuple(map(add, x.q, scaled(times(scene.inverse_mass, h), x.p)))
    return x._replace(q=q, s=None if x.s is None else x.s + h * scene.kinetic(x.p))


def _damp_constants(scene: Mechanical, h: Arithmetic, xp: Namespace) -> Constants:
    half_kappa = scene.kappa * damped_time(scene.gamma, h, xp) / 2 if scene.nonlinear_damping else None
    return *damping(scene.gamma, h, xp), half_kappa


def damp(scene: Mechanical, x: State, constants: Constants, xp: Namespace) -> State:
    """C: p *= e^{−γh}, s *= e^{−γh}; with κ: divided by D² and D, D = 1 + ½ κ s φ(h).

    The Bernoulli equation s' = −γ s − ½ κ s² has s(h) = e^{−γh} s/D, and ∫Γ'(s) = γh + 2 log D.
    D ≤ 0 is blow-up in finite time: the state leaves through infinity, not by a wrong number.
    """
    keep, lose, half_kappa = constants
    p, s = tuple(keep * p - lose * p for p in x.p), None if x.s is None else keep * x.s - lose * x.s
    if half_kappa is None:
        return State(x.q, p, s)
    over_D = _over_D(x, half_kappa, xp)
    return settle(State(x.q, tuple(over_D * over_D * p for p in p), over_D * s), xp)


def _over_D(x: State, half_kappa: Arithmetic, xp: Namespace) -> Arithmetic:
    D = 1 + half_kappa * x.s
    return choose(D > 0, 1 / choose(D > 0, D, 1.0, xp), xp.inf, xp)


def _drift_damp_constants(scene: Mechanical, h: Arithmetic, xp: Namespace) -> Constants:
    phi = damped_time(scene.gamma, h, xp)
    half_kappa = (scene.kappa * phi / 2,) if scene.nonlinear_damping else ()
    return times(scene.inverse_mass, phi), phi, *damping(scene.gamma, h, xp), *half_kappa


def drift_damp(scene: Mechanical, x: OwnState, constants: Constants, xp: Namespace) -> OwnState:
    """AC, the flow of T + γs: q += φ p/m, s → e^{−γh} (s + φ T(p)), p → e^{−γh} p.

    With ½κs² added, and k = ½κφ, a = 1 + ks, b² = kφT(p):

        p → e^{−γh} p/y,   s → e^{−γh} (as + φT(p))/y,   q += (φ/m) p·atan2(b, a)/b,   y = a² + b².

    (In the time φ, s = w'/(kw) up to a constant turns the Riccati equation s' = T − ½κs² into Pinney's
    w'' = const/w³; y = w².)  κ < 0 makes b imaginary.  The conformal factor is the factor of p, e^{−γh}/y.
    """
    if not scene.nonlinear_damping:
        phi_over_m, phi, keep, lose = constants
        q = tuple(map(add, x.q, scaled(phi_over_m, x.p)))
        s = None if x.s is None else x.s + phi * scene.kinetic(x.p)
        s = None if s is None else keep * s - lose * s
        return x._replace(q=q, p=tuple(keep * p - lose * p for p in x.p), s=s)
    phi_over_m, phi, keep, lose, _ = constants
    a, over_y, path = _pinney(scene, x, constants, xp)
    q = tuple(map(add, x.q, scaled(times(phi_over_m, path), x.p)))
    s = a * x.s + phi * scene.kinetic(x.p)
    p = tuple((keep * p - lose * p) * over_y for p in x.p)
    return settle(State(q, p, (keep * s - lose * s) * over_y), xp)


def _pinney(
    scene: Mechanical, x: State, constants: Constants, xp: Namespace
) -> tuple[Arithmetic, Arithmetic, Arithmetic]:
    """Return a, 1/y and atan2(b, a)/b of `drift_damp`; 1/y is infinite from the time of blow-up on.

    For κ < 0 with b² = −kφT: y = a² − b², factored because both factors are positive until s reaches
    infinity, and log((a + b)/(a − b))/2b.  For κ > 0 only p = 0 blows up, any other goes round.
    """
    _, phi, _, _, half_kappa = constants
    a, z = 1 + half_kappa * x.s, half_kappa * phi * scene.kinetic(x.p)
    if scene.kappa_sign is None:
        return _pinney_of_any_sign(a, z, xp)
    square = scene.kappa_sign * z
    straight = square == 0
    b = xp.sqrt(choose(straight, 1.0, square, xp))  # 1: no derivative of √0 is taken
    if scene.kappa_sign > 0:
        y = choose(straight, choose(a > 0, a * a, 0.0, xp), a * a + square, xp)
    else:
        edge = choose(straight, 0.0, b, xp)
        y = choose(a > edge, (a - edge) * (a + edge), 0.0, xp)
    alive = y > 0
    y, run, rise = choose(alive, y, 1.0, xp), choose(alive, a, 2.0, xp), choose(alive, b, 1.0, xp)
    if scene.kappa_sign > 0:
        bent = xp.atan2(rise, run) / rise
    else:
        bent = xp.log1p(2 * rise / choose(straight, 1.0, run - rise, xp)) / (2 * rise)
    path = choose(straight, 1 / choose(straight, run, 1.0, xp), bent, xp)
    return a, choose(alive, 1 / y, xp.inf, xp), path


#: for z/a² ≤ SMALL, a sum of POWERS powers gives atan2(√z, a)/√z to round-off
SMALL, POWERS = 1e-2, 9


def _pinney_of_any_sign(
    a: Arithmetic, z: Arithmetic, xp: Namespace
) -> tuple[Arithmetic, Arithmetic, Arithmetic]:
    """Return the same for an unknown sign of κ, z = kφT; it is smooth at κ = 0."""
    size, square = abs(z), a * a
    near = (size <= SMALL * square) & (a > 0)
    b = xp.sqrt(choose(near | (z == 0), 1.0, size, xp))
    turns, ahead = (z > 0) & ~near, (a > b) & (z < 0) & ~near
    y = choose(near | turns, square + z, choose(ahead, (a - b) * (a + b), 0.0, xp), xp)
    alive = y > 0
    run = choose(near, a, 1.0, xp)
    part = choose(near, z, 0.0, xp) / (run * run)
    series: Arithmetic = 0.0
    for k in reversed(range(POWERS)):
        series = 1 / (2 * k + 1) - part * series
    bent = xp.log1p(2 * b / choose(ahead, a - b, 1.0, xp)) / (2 * b)
    path = choose(near, series / run, choose(turns, xp.atan2(b, a) / b, bent, xp), xp)
    return a, choose(alive, 1 / choose(alive, y, 1.0, xp), xp.inf, xp), path


@dataclass(frozen=True, kw_only=True)
class Mechanical(Canonical):
    """Describe a point mass in a potential: H = ‖p‖²/2m + V(q) + γ s + ½ κ s² on T*Rⁿ × R.

    The functions may read globals or attributes: every solve, run and reference uses their values at its preparation.

    Parameters
    ----------
    name, about, t_end, s, exact, scale, slows_after, hard, stiff, mission, pace
        As of `Scene`.
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
        Damping; without any, every run reports "undamped".  κ ≠ 0 makes s part of the dynamics.
    mass
        > 0; one number, or one for every component; or ``M(q, **parameters)``, a symmetric positive definite matrix,
        n rows of n numbers.  Then the result is the `ContactSystem` with H = ½ pᵀM(q)⁻¹p + V(q) + γ s + ½ κ s² and the
        parameters γ and κ.  Gradient and Hessian are derived, and every component has its own scale, since angles and
        lengths are often mixed.  The damping is −γ p with p = M(q) q', a friction −γ M(q) q' proportional to the mass.
    parameters
        Numbers by name that the functions take.
    rotation_invariant
        Whether V(Rq) = V(q), so that the angular momentum obeys J' = −Γ'(s) J.

    Raises
    ------
    BadInput
        For lengths that differ, values that are not finite, mass ≤ 0, t_end ≤ 0.
    """

    potential: Callable[..., Arithmetic]
    gradient: Callable[..., Vector] | None = None
    q: Vector
    p: Vector
    gamma: float = 0.0
    kappa: float = 0.0
    mass: Any = 1.0
    hessian: Callable[..., Sequence[Vector]] | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    rotation_invariant: bool = False
    inverse_mass: Arithmetic | Vector = field(init=False, repr=False, default=1.0)
    #: the sign of the original κ, 1, 0 or −1, which selects the flows; None for flows of any sign
    kappa_sign: int = field(init=False, repr=False, default=0)

    kind = "mechanical"
    functions: ClassVar[dict[str, tuple[str, ...]]] = dict.fromkeys(
        ("potential", "gradient", "hessian"), ("q", "**")
    )
    coefficients: ClassVar[tuple[str, ...]] = ("gamma", "kappa", "mass")
    reciprocals: ClassVar[dict[str, str]] = {"mass": "inverse_mass"}
    checks: ClassVar[dict[str, Check]] = {
        **Canonical.checks,
        "potential": function,
        "gradient": optional(function),
        "hessian": optional(function),
        "gamma": damping_rate,
        "kappa": finite,
        "mass": masses,
        "rotation_invariant": switch,
    }
    separable = True
    flows: ClassVar[Mapping[str, Flow]] = {
        "kick": Flow(plain, kick, {"gradient": 1}),
        "drift": Flow(plain, drift, {}),
        "damp": Flow(_damp_constants, damp, {}),
        "drift_damp": Flow(_drift_damp_constants, drift_damp, {}),
    }
    parts: ClassVar[tuple[str, ...]] = ("kick", "drift_damp")

    def __new__(cls, *_: object, **given: Any) -> Self:
        if cls is Mechanical and callable(given.get("mass")):
            return on_metric(**given)  # type: ignore[return-value]
        return super().__new__(cls, *_, **given)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._fix("kappa_sign", sign(self.kappa))
        if isinstance(self.mass, tuple) and len(self.mass) != self.bodies:
            raise BadInput(f"mass = {excerpt(self.mass)}: must be one number > 0, or {self.bodies} of them")
        with their_code(f"q = {excerpt(self.q)}: the gradient of scene {self.name!r}"):
            force = self.dV(self.q)
        if not isinstance(force, tuple | list | np.ndarray):
            wanted = f"must return {len(self.q)} numbers, a tuple"
            raise BadInput(f"gradient: {wanted}; it returns {excerpt(force)}")
        vector(f"q = {excerpt(self.q)}, where gradient", force, len(self.q))

    @property
    def bodies(self) -> int:
        """Return the number of masses."""
        return len(self.q)

    @property
    def decided(self) -> tuple[Hashable, ...]:  # type: ignore[override]
        return (self.kappa_sign,)

    def _decide(self) -> Self:
        return self._replaced(kappa_sign=sign(self.kappa))

    def orders(self) -> list[tuple[int, int, bool]]:
        if "kappa" not in self.coefficients:
            return super().orders()
        i, zero = self.coefficients.index("kappa"), len(self.numbers())
        found = [(zero, i, self.kappa_sign > 0)] if self.kappa_sign >= 0 else []
        return super().orders() + found + ([(i, zero, self.kappa_sign < 0)] if self.kappa_sign <= 0 else [])

    def recorded(self) -> Self:
        """Return the scene recorded; derive a missing gradient and Hessian."""
        if self.gradient is not None and not self.has_users_functions:
            return self
        scene = super().recorded()
        if scene.gradient is None:
            sizes = tuple(len(self.q) if name == "q" else 0 for name in self.functions["potential"][:-1])
            try:
                potential = as_formula(scene.potential, sizes, self.parameters)
                scene = scene._replaced(gradient=derived_gradient(potential))
            except CannotRecord as why:
                missing = "its gradient is missing, and the potential cannot be differentiated"
                hint = "; q is a tuple of numbers, q[0] the first" if "'tuple'" in str(why) else ""
                raise BadInput(f"scene {self.name!r}: {missing}: {why}{hint}") from why
        if not is_ours(type(self)) or "hessian" not in self.functions or scene.hessian is not None:
            return scene
        if isinstance(scene.gradient, Formula) and len(scene.q) <= LARGEST_HESSIAN:
            with suppress(CannotRecord):
                scene = scene._replaced(hessian=derived_hessian(scene.gradient))
        return scene

    # -- physics -------------------------------------------------------------------------------
    @property
    def nonlinear_damping(self) -> bool:  # type: ignore[override]
        return self.kappa_sign != 0

    @property
    def may_gain_energy(self) -> bool:  # type: ignore[override]
        return self.nonlinear_damping or self.gamma <= 0

    @property
    def bounds_energy(self) -> bool:
        return not self.nonlinear_damping and self.gamma >= 0

    @property
    def conformal_rate(self) -> Numeric:
        return None if self.nonlinear_damping else self.gamma

    def velocity(self, p: Vector) -> Vector:
        return scaled(self.inverse_mass, p)

    def kinetic(self, p: Vector) -> Arithmetic:
        if isinstance(self.inverse_mass, tuple):
            return dot(p, scaled(self.inverse_mass, p)) / 2
        return dot(p, p) * self.inverse_mass / 2

    def V(self, q: Vector) -> Arithmetic:
        return self.potential(q, **self.parameters)

    def dV(self, q: Vector) -> Vector:
        return (self.gradient or self.recorded().gradient)(q, **self.parameters)  # type: ignore[misc]

    def potential_at(self, x: OwnState) -> Arithmetic:
        return self.V(x.q)

    def gradient_at(self, x: OwnState) -> Vector:
        return self.dV(x.q)

    def dissipation(self, s: Arithmetic) -> Arithmetic:
        linear = self.gamma * s
        return linear + self.kappa * s * s / 2 if self.nonlinear_damping else linear

    def dissipation_rate(self, s: Arithmetic) -> Arithmetic:
        return self.gamma + self.kappa * s if self.nonlinear_damping else self.gamma

    def damping_at(self, x: OwnState) -> Arithmetic:
        return self.dissipation_rate(x.s)

    def energy(self, x: OwnState) -> Numeric:
        return self.kinetic(x.p) + self.potential_at(x)

    def hamiltonian(self, x: State) -> Numeric:
        return self.energy(x) + self.dissipation(x.s)

    def rhs(self, x: State) -> State:
        rate = self.damping_at(x)
        force = tuple(-g - rate * p for g, p in zip(self.gradient_at(x), x.p, strict=True))
        if x.s is None:
            return State(self.velocity(x.p), force)
        s = self.kinetic(x.p) - self.potential_at(x) - self.dissipation(x.s)
        return State(self.velocity(x.p), force, s)

    def bend(self, x: OwnState, f: OwnState) -> list[Numeric]:
        action = math.nan  # where V depends on the time
        if x.s is not None and self.clock is None:
            rate = self.damping_at(x)
            action = 2 * dot(f.q, f.p) + rate * (dot(f.q, x.p) - f.s)
        unknown = f._replace(q=self.velocity(f.p), p=(math.nan,) * len(x.p))
        return self.pack(unknown if x.s is None else unknown._replace(s=action))

    def sizes(self, x: OwnState, end: float) -> Sizes:
        xp = namespace(x.q[0])
        far, fast = reach(self, x, end, self.alike[: len(self.alike) // 2], xp)
        if self.mixed:
            momenta = np.array(fast) / np.array(self.velocity((1.0,) * len(x.p)))
            return [*far, *momenta], float(np.nanmax(np.array(far) * momenta))
        over_mass: Any = self.velocity((1.0,) * len(x.p))[0]
        q, p = far[0], fast[0] * (1 / over_mass)
        return [q] * len(x.q) + [p] * len(x.p), scale_of(q, xp) * scale_of(p, xp)

    @property
    def mixed(self) -> bool:  # type: ignore[override]
        return isinstance(self.mass, tuple)

    @property
    def alike(self) -> Sequence[int]:
        n = len(self.q)
        return [1] * 2 * n if self.mixed else [n, n]

    def energy_terms(self, x: OwnState) -> Arithmetic:
        return self.kinetic(x.p) + abs(self.potential_at(x))

    def hamiltonian_terms(self, x: State) -> Numeric:
        kinetic = self.kinetic(x.p)
        return abs(kinetic) + abs(self.hamiltonian(x) - kinetic)

    @property
    def has_jacobian(self) -> bool:  # type: ignore[override]
        return self.hessian is not None

    def jacobian(self, x: State) -> list[list[Arithmetic]] | None:
        if self.hessian is None or not self.has_jacobian:
            return None
        n = len(x.q)
        hess = self.hessian(x.q, **self.parameters)
        rate = self.dissipation_rate(x.s)
        tail: list[Arithmetic] = [] if x.s is None else [0.0]
        over_m = self.velocity((1.0,) * n)
        rows = [[0.0] * n + [over_m[i] if i == j else 0.0 for j in range(n)] + tail for i in range(n)]
        for i in range(n):
            damping = [-rate if i == j else 0.0 for j in range(n)]
            column = [-self.kappa * x.p[i]] if x.s is not None and self.nonlinear_damping else tail
            rows.append([-hess[i][j] for j in range(n)] + damping + column)
        if x.s is not None:
            rows.append([-g for g in self.dV(x.q)] + [*self.velocity(x.p)] + [-rate])
        return rows

    def momentum(self, x: State) -> Vector | None:
        return angular_momentum(x.q, x.p)

    #: the argument that claims a symmetry, for messages
    symmetry: ClassVar[str] = "rotation_invariant = True"

    @property
    def has_momentum_law(self) -> bool:  # type: ignore[override]
        return self.rotation_invariant and len(self.q) in (2, 3)

    def momentum_terms(self, x: State) -> Numeric:
        return norm(x.q) * norm(x.p)
