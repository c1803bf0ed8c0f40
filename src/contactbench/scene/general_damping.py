"""Mechanical scenes with any damping Γ(s)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np

from contactbench.checks import function, require_number
from contactbench.errors import BadInput
from contactbench.numbers.control import choose, iterate, settle
from contactbench.numbers.protocol import Arithmetic, Namespace, has_digits, has_where
from contactbench.scene.algebra import State
from contactbench.scene.base import Check, optional
from contactbench.scene.flow import Flow, damped_time, plain
from contactbench.scene.mechanical import Mechanical

# With r = Γ' about half-way and the time τ in which linear damping of that rate would do the same,
# s = s₀ − Γ(s₀) φ_r(τ), φ_r(τ) = (1 − e^{−rτ})/r, the separated equation ∫ ds/Γ = −h of s' = −Γ(s) becomes
#
#     ∫₀^{τ(h)} k(τ) dτ = h,   k(τ) = e^{−rτ} Γ(s₀)/Γ(s(τ)),
#
# whose integrand is positive, 1 where Γ is linear, and regular at the zeros of Γ.  Gauss's rule and Newton's method
# from τ = h; the slope of the integral is k.  On doubles the rule has `NODES` nodes in each half of the step: enough
# for round-off where Γ'h is below one (measured in the tests).
NODES, ITERATIONS, PANELS = 16, 6, 2


@cache
def rule() -> tuple[list[float], list[float]]:
    x, w = np.polynomial.legendre.leggauss(NODES)
    return ((1 + x) / 2).tolist(), (w / 2).tolist()


def decay(scene: GeneralDamping, s: Arithmetic, h: Arithmetic, xp: Namespace) -> Arithmetic:
    """Return s(h) from s at 0; not finite where s reaches infinity before."""
    if scene.damping_flow is not None:
        return scene.damping_flow(s, h, xp)
    for _ in range(PANELS):
        s = by_quadrature(scene, s, h / PANELS, xp)
    return s


def by_quadrature(scene: GeneralDamping, s: Arithmetic, h: Arithmetic, xp: Namespace) -> Arithmetic:
    start = scene.dissipation(s)
    r = scene.dissipation_rate(s - start * damped_time(scene.dissipation_rate(s), h / 2, xp))
    resting = start == 0

    def at(tau: Arithmetic) -> Arithmetic:
        return s - start * damped_time(r, tau, xp)

    def pace(tau: Arithmetic) -> Arithmetic:
        there = scene.dissipation(at(tau))
        gone = there == 0
        ratio = choose(resting, 1.0, start, xp) / choose(gone, 1.0, there, xp)
        return choose(resting, 1.0, choose(gone, 1.0, xp.exp(-r * tau) * ratio, xp), xp)

    def elapsed(tau: Arithmetic) -> Arithmetic:
        if has_digits(xp):
            return xp.quad(pace, [0, tau])
        return tau * sum(w * pace(tau * x) for x, w in zip(*rule(), strict=True))

    def nearer(tau: Arithmetic) -> Arithmetic:
        return tau - (elapsed(tau) - h) / pace(tau)

    if has_where(xp):
        # a loop keeps the kind of number it begins with
        return at(iterate(nearer, h + 0 * s, ITERATIONS, xp))
    before, tau = 0 * h, h
    for _ in range(ITERATIONS if not has_digits(xp) else 2 * ITERATIONS):
        before, tau = tau, nearer(tau)
        if tau == before:
            break
    return at(tau)


def survival(
    scene: GeneralDamping, s: Arithmetic, after: Arithmetic, h: Arithmetic, xp: Namespace
) -> Arithmetic:
    """Return ∂s(h)/∂s = Γ(s(h))/Γ(s), the factor on p and on η; e^{−Γ'h} at the zeros of Γ.

    There Γ' is taken where s is on average, whose derivative is that of ∫Γ'(s).
    """
    start = scene.dissipation(s)
    resting = start == 0
    ratio = scene.dissipation(after) / choose(resting, 1.0, start, xp)
    z = scene.dissipation_rate(s) * h
    still = z == 0
    moved = choose(still, 1, z + xp.expm1(-z), xp) / choose(still, 2, z, xp) / choose(still, 1, z, xp)
    return choose(resting, xp.exp(-scene.dissipation_rate(s - start * h * moved) * h), ratio, xp)


def damp_generally(scene: GeneralDamping, x: State, h: Arithmetic, xp: Namespace) -> State:
    """C for any Γ(s): s follows s' = −Γ(s), and p the derivative of s(h), both solving p' = −Γ'(s) p."""
    s = decay(scene, x.s, h, xp)
    factor = survival(scene, x.s, s, h, xp)
    return settle(State(x.q, tuple(factor * p for p in x.p), s), xp)


def general_log_factor(scene: GeneralDamping, x: State, h: Arithmetic, xp: Namespace) -> Arithmetic:
    return xp.log(survival(scene, x.s, decay(scene, x.s, h, xp), h, xp))


@dataclass(frozen=True, kw_only=True)
class GeneralDamping(Mechanical):
    """Describe a point mass with any smooth damping: H = ‖p‖²/2m + V(q) + Γ(s), split into kick, drift and damping.

    Nyström tables and Herglotz's recursion refuse it: their flows need a Γ at most quadratic.

        GeneralDamping(name="cubic", potential=V, gradient=dV, q=(1.0,), p=(0.0,), s=0.5, t_end=10.0,
                       damping=lambda s: 0.1 * s + s**3, damping_slope=lambda s: 0.1 + 3 * s * s)

    Parameters
    ----------
    name, about, t_end, s, exact, slows_after, hard, experiments
        As of `Scene`.
    potential, gradient, hessian, q, p, gamma, kappa, mass, parameters, rotation_invariant
        As of `Mechanical`; gamma and kappa stay 0, Γ is in their place.
    damping, damping_slope
        ``Γ(s) -> number`` and ``Γ'(s) -> number``, plain arithmetic like the force.
    damping_flow
        ``(s, h, xp) -> s(h)``, the solution of s' = −Γ(s) where it is known in closed form; by default it is found
        by quadrature (`by_quadrature`), many evaluations of Γ a step.

    Raises
    ------
    BadInput
        As `Mechanical` does, and for a gamma or kappa beside Γ.
    """

    damping: Callable[[Arithmetic], Arithmetic]
    damping_slope: Callable[[Arithmetic], Arithmetic]
    damping_flow: Callable[..., Arithmetic] | None = None

    kind = "general damping"
    functions: ClassVar[dict[str, tuple[str, ...]]] = {
        **Mechanical.functions,
        **dict.fromkeys(("damping", "damping_slope"), ("s",)),
        "damping_flow": ("s", "h", "xp"),
    }

    coefficients: ClassVar[tuple[str, ...]] = ("mass",)
    #: no merged flow is known, hence three parts
    flows: ClassVar[Mapping[str, Flow]] = {
        **{name: Mechanical.flows[name] for name in ("kick", "drift")},
        "damp": Flow(plain, damp_generally, {}, general_log_factor),
    }
    parts: ClassVar[tuple[str, ...]] = ("kick", "drift", "damp")
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

    required: ClassVar[tuple[str, ...]] = ("s",)

    nonlinear_damping = True

    def dissipation(self, s: Arithmetic) -> Arithmetic:
        return self.damping(s)

    def dissipation_rate(self, s: Arithmetic) -> Arithmetic:
        return self.damping_slope(s)

    #: Γ'' is not asked for: solvers difference
    has_jacobian = False
