"""Mechanical scenes with forces and damping that depend on the time."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from contactbench.checks import finite, function, is_number, real_array, require_number
from contactbench.errors import BadInput, excerpt
from contactbench.numbers import quadrature
from contactbench.numbers.protocol import Arithmetic, Namespace
from contactbench.scene.algebra import AnyState, DrivenState, Vector, scaled, times
from contactbench.scene.base import Check, Numeric, optional
from contactbench.scene.flow import Constants, Flow, plain
from contactbench.scene.mechanical import Mechanical, _drift_damp_constants, drift_damp


# A is T, B is V(q, t) at a fixed t, and C is γ(t) s with the clock t' = 1, so that G = ∫γ over the step is exact
# however they alternate.  Where A and C are merged, φ = ∫e^{−∫γ} is the time a momentum is worth.  V(q, t) and the
# clock depend on neither p nor s: Nyström tables keep their order.
def driven_log_factor(scene: Driven, x: DrivenState, h: Arithmetic, xp: Namespace) -> Arithmetic:
    return -(scene.gamma * h if scene.rate is None else scene.spent(x.t, h, xp)[0])


def driven_damp(scene: Driven, x: DrivenState, h: Arithmetic, xp: Namespace) -> DrivenState:
    """C: p *= e^{−G}, s *= e^{−G}, t += h."""
    decay = xp.exp(driven_log_factor(scene, x, h, xp))
    s = None if x.s is None else decay * x.s
    return DrivenState(x.q, tuple(decay * p for p in x.p), x.t + h, s)


def _driven_constants(scene: Driven, h: Arithmetic, xp: Namespace) -> Constants:
    """Return h, and the constants of `drift_damp` if γ is constant."""
    return (h,) if scene.rate_changes else (h, *_drift_damp_constants(scene, h, xp))


def driven_drift_damp(scene: Driven, x: DrivenState, constants: Constants, xp: Namespace) -> DrivenState:
    """AC over (t, t + h), with φ and ∫γ over that interval."""
    h, *constant = constants
    if not constant:
        total, phi = scene.spent(x.t, h, xp)
        constant = times(scene.inverse_mass, phi), phi, 1.0, -xp.expm1(-total)
    moved: DrivenState = drift_damp(scene, x, constant, xp)
    return moved._replace(t=x.t + h)


def increasing(name: str, value: object) -> tuple[float, ...]:
    """Return increasing finite numbers, or a single number, as a tuple."""
    times = np.array(real_array(name, value, "increasing finite times"), ndmin=1)
    if times.ndim != 1 or not np.isfinite(times).all() or np.any(np.diff(times) <= 0):
        raise BadInput(f"{name} = {excerpt(value)}: must be increasing finite times, such as (13.3,)")
    return tuple(times.tolist())


@dataclass(frozen=True, kw_only=True)
class Driven(Mechanical):
    """Describe a driven point mass: H = ‖p‖²/2m + V(q, t) + γ(t) s, with the time in the state, t' = 1.

    Adaptive solvers are given f(t, y): the time is theirs and no part of the state whose error they control.

    A processed composition (contact-rkn8) begins and ends with steps back: its γ(t) and V(q, t) have to be defined
    some steps before the start.

    The contact form is taken at a given time: tangents do not move t.  H has no decay law, since ∂H/∂t ≠ 0.

    Parameters
    ----------
    name, about, t_end, s, exact, scale, slows_after, hard, stiff, mission, pace
        As of `Scene`.
    hessian, q, p, kappa, mass, parameters, rotation_invariant
        As of `Mechanical`; κ = 0, no Hessian and no symmetry are allowed.
    potential
        ``V(q, t, **parameters) -> number``.
    gradient
        ``dV(q, t, **parameters) -> n-tuple``; by default derived.
    t
        The time at the start; a run ends at t + t_end.
    gamma
        Damping, where it is constant.
    rate
        ``γ(t, **parameters) -> number`` where it is not.
    breaks
        Increasing times at which force or damping changes abruptly or a pulse sits, such as (13.3,); of a pulse its
        middle and both ends.  No step of any method straddles one: each starts afresh there.  Functions are given no
        time nearer than a few roundings to a break, nor beyond one that a step begins or ends at: it does not matter
        what they return at a jump.  For substeps that lead out of a step, time stands still at a break: over a jump
        of a force that depends on time besides, a processor (contact-rkn8) is of lower order.
    span
        ``(t, h, xp, **parameters) -> (G, φ)`` where it is known in closed form: G = ∫_t^{t+h} γ and
        φ = ∫_t^{t+h} e^{−∫_t^τ γ} dτ, the time for which a damped momentum effectively drifts.  By default both come
        from Gauss's collocation method of order 16 on every step, eight values of γ: right to round-off while γh and
        the phase of a sinusoidal γ stay below 1 over a step, to 10⁻¹¹ below 2 (measured in the tests).  A γ with
        complex singularities nearer to the real axis than about two steps asks for smaller ones.  The steps are
        contact maps in any case, with the factor of the rule.

    Raises
    ------
    BadInput
        As `Mechanical` does, and for κ, a Hessian, a symmetry or a span without a rate.
    """

    t: float = 0.0
    rate: Callable[..., Arithmetic] | None = None
    span: Callable[..., tuple[Arithmetic, Arithmetic]] | None = None
    breaks: tuple[float, ...] = ()

    kind = "driven"
    keeps_dates = True
    functions: ClassVar[dict[str, tuple[str, ...]]] = {
        **dict.fromkeys(("potential", "gradient"), ("q", "t", "**")),
        "rate": ("t", "**"),
        "span": ("t", "h", "xp", "**"),
    }
    state: ClassVar[type[AnyState]] = DrivenState
    flows: ClassVar[Mapping[str, Flow]] = {
        **Mechanical.flows,
        "damp": Flow(plain, driven_damp, {}),
        "drift_damp": Flow(_driven_constants, driven_drift_damp, {}),
    }
    initial_fields: ClassVar[tuple[str, ...]] = ("q", "p", "t", "s")
    checks: ClassVar[dict[str, Check]] = {
        "t": finite,
        **Mechanical.checks,
        "rate": optional(function),
        "span": optional(function),
        "breaks": increasing,
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kappa or self.hessian is not None or self.rotation_invariant:
            fields = "kappa, hessian and rotation_invariant"
            raise BadInput(f"scene {self.name!r}: {fields} are for scenes without time")
        if self.rate is not None:
            if self.gamma:
                raise BadInput(f"gamma = {self.gamma!r}: the rate of damping has it in it")
            require_number("rate", self._value("rate"))
        if self.span is not None:
            if self.rate is None:
                raise BadInput("span: its rate is missing, the damping that it is the integral of")
            pair = self._value("span")
            if not (isinstance(pair, tuple | list) and len(pair) == 2 and all(map(is_number, pair))):
                raise BadInput(f"span: must return a pair of real numbers; it returns {excerpt(pair)}")

    def breaks_until(self, end: float, begin: float = 0.0) -> list[tuple[float, float]]:
        found = ((b - self.t, 4 * math.ulp(max(abs(b), abs(self.t), abs(b - self.t)))) for b in self.breaks)
        return [(time, exact) for time, exact in found if begin - exact < time < end + exact]

    @property
    def structure(self) -> tuple[Hashable, ...]:
        return *super().structure, bool(self.breaks)

    @property
    def layout(self) -> Sequence[object]:
        return [self.breaks] if self.breaks else []

    @property
    def clock(self) -> int:
        return 2 * len(self.q)

    def unpack(self, y: Sequence[Arithmetic], carry: Sequence[str]) -> DrivenState:  # type: ignore[override]
        n = len(self.q)
        s = y[2 * n + 1] if "s" in carry else None
        return DrivenState(tuple(y[:n]), tuple(y[n : 2 * n]), y[2 * n], s)

    @property
    def coefficients(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("mass",) if self.rate else ("gamma", "mass")

    def V(self, q: Vector, t: Arithmetic | None = None) -> Arithmetic:
        """Return V(q, t), by default at the start time."""
        return self.potential(q, self.t if t is None else self.time(t), **self.parameters)

    def dV(self, q: Vector, t: Arithmetic | None = None) -> Vector:
        gradient: Callable[..., Vector] = self.gradient or self.recorded().gradient  # type: ignore[assignment]
        return gradient(q, self.t if t is None else self.time(t), **self.parameters)

    def potential_at(self, x: DrivenState) -> Arithmetic:
        return self.V(x.q, x.t)

    def gradient_at(self, x: DrivenState) -> Vector:
        return self.dV(x.q, x.t)

    def damping_at(self, x: DrivenState) -> Arithmetic:
        return self.rate_at(x.t)

    def hamiltonian(self, x: DrivenState) -> Numeric:  # type: ignore[override]
        return self.energy(x) + self.damping_at(x) * x.s

    def rhs(self, x: DrivenState) -> DrivenState:  # type: ignore[override]
        rate = self.damping_at(x)
        velocity = scaled(self.inverse_mass, x.p)
        force = tuple(-g - rate * p for g, p in zip(self.gradient_at(x), x.p, strict=True))
        s = None if x.s is None else self.kinetic(x.p) - self.potential_at(x) - rate * x.s
        return DrivenState(velocity, force, 1.0 + 0 * x.t, s)

    #: ∂∇V/∂t is not asked for: solvers difference
    has_jacobian = False
    has_hamiltonian_law = False
    may_gain_energy = True
    bounds_energy = False

    @property
    def conformal_rate(self) -> Numeric:
        return self.gamma if self.rate is None else None

    @property
    def rate_changes(self) -> bool:  # type: ignore[override]
        return self.rate is not None

    def rate_at(self, t: Arithmetic) -> Arithmetic:
        return self.gamma if self.rate is None else self.rate(self.time(t), **self.parameters)

    def spent(self, t: Arithmetic, h: Arithmetic, xp: Namespace) -> tuple[Arithmetic, Arithmetic]:
        """Return (G, φ) of the damping from t to t + h, a step."""
        if self.span is not None:
            return self.span(self.time(t), h, xp, **self.parameters)
        return quadrature.integrals(self.rate_at, t, h, xp)

    def damped_within(self, x: DrivenState, h: Arithmetic, xp: Namespace) -> Numeric:
        return -driven_log_factor(self, x, h, xp)

    def damped_by(self, x: DrivenState, t: Numeric, xp: Namespace) -> Numeric:
        if self.rate is None:
            return self.gamma * t
        if self.span is not None:
            return self.spent(x.t, t, xp)[0]
        return quadrature.integral(self.rate_at, x.t, t, xp)
