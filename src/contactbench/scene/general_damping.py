"""Mechanical scenes with any damping Γ(s)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import ClassVar, cast

import numpy as np

from contactbench.checks import function, require_number
from contactbench.errors import BadInput
from contactbench.numbers.control import choose, iterate, settle
from contactbench.numbers.dual import Dual, DualNumbers, slope, value
from contactbench.numbers.protocol import (
    Arithmetic,
    ChoosingNamespace,
    ExactNamespace,
    Namespace,
    has_digits,
    has_where,
)
from contactbench.scene.algebra import State
from contactbench.scene.base import Check, optional
from contactbench.scene.flow import Flow, damped_time, plain
from contactbench.scene.mechanical import Mechanical

# With r = Γ' about half-way and the time τ in which linear damping of that rate would do the same,
# s = s₀ − Γ(s₀) φ_r(τ), φ_r(τ) = (1 − e^{−rτ})/r, the separated equation ∫ ds/Γ = −h of s' = −Γ(s) becomes
#
#     ∫₀^{τ(h)} k(τ) dτ = h,   k(τ) = e^{−rτ} Γ(s₀)/Γ(s(τ)) = 1/(1 − e^{rτ} ∫₀^τ (Γ' − r) e^{−rτ'} dτ'),
#
# the latter from dΓ(s(τ))/dτ = −Γ'(s(τ)) Γ(s₀) e^{−rτ}.  It divides by no Γ: near a zero, where round-off is most of
# Γ, k and its derivatives are as good as elsewhere.  Gauss's rule, the integrals up to its nodes those of the
# polynomial through them, and Newton's method from τ = h; the slope of the integral is k.  On doubles the rule has
# `NODES` nodes in each half of the step: enough for round-off where Γ'h is below one (measured in the tests).  Along
# the way ∫Γ' dt = rh + ∫(Γ' − r) k dτ.
NODES, ITERATIONS, PANELS = 16, 6, 2


@cache
def rule() -> tuple[list[float], list[float], list[list[float]]]:
    """Return Gauss's nodes and weights on [0, 1], and the weights of the integrals from 0 to each node."""
    legendre = np.polynomial.legendre  # loaded when first used
    x, w = legendre.leggauss(NODES)
    integrals = legendre.legval(x, legendre.legint(np.eye(NODES), lbnd=-1)).T
    upto = integrals @ np.linalg.inv(legendre.legvander(x, NODES - 1)) / 2
    return ((1 + x) / 2).tolist(), (w / 2).tolist(), upto.tolist()


def decayed(
    scene: GeneralDamping, s: Arithmetic, h: Arithmetic, xp: Namespace
) -> tuple[Arithmetic, Arithmetic]:
    """Return s(h) from s at 0, and log ∂s(h)/∂s, the logarithm of the factor on p and η; not finite beyond s = ∞."""
    if scene.damping_flow is not None:
        span = Dual(h, 0.0) if isinstance(h, Dual) else h
        after = scene.damping_flow(Dual(s, 1.0), span, DualNumbers(cast(ChoosingNamespace, xp)))
        resting = scene.dissipation(s) == 0  # where a closed form need not have a derivative
        ratio = choose(resting, 1.0, slope(after), xp)
        return value(after), choose(resting, at_rest(scene, s, h, xp), xp.log(ratio), xp)
    log = 0.0 * s
    for _ in range(PANELS):
        s, more = by_quadrature(scene, s, h / PANELS, xp)
        log = log + more
    return s, log


def by_quadrature(
    scene: GeneralDamping, s: Arithmetic, h: Arithmetic, xp: Namespace
) -> tuple[Arithmetic, Arithmetic]:
    start = scene.dissipation(s)
    r = scene.dissipation_rate(s - start * damped_time(scene.dissipation_rate(s), h / 2, xp))

    def at(tau: Arithmetic) -> Arithmetic:
        return s - start * damped_time(r, tau, xp)

    def sampled(tau: Arithmetic) -> tuple[Arithmetic, Arithmetic, Arithmetic]:
        """Return the integrals from 0 to tau of k and of k (Γ' − r), and k there."""
        nodes, weights, upto = rule()
        beside = [scene.dissipation_rate(at(tau * x)) - r for x in nodes]
        grown = [xp.exp(r * (tau * x)) for x in nodes]
        shrunk = [a / b for a, b in zip(beside, grown, strict=True)]

        def pace(growth: Arithmetic, row: list[float]) -> Arithmetic:
            return 1 / (1 - growth * tau * sum(a * b for a, b in zip(row, shrunk, strict=True)))

        paces = [pace(growth, row) for growth, row in zip(grown, upto, strict=True)]
        weighted = [w * k for w, k in zip(weights, paces, strict=True)]
        extra = sum(a * b for a, b in zip(weighted, beside, strict=True))
        return tau * sum(weighted), tau * extra, pace(xp.exp(r * tau), weights)

    def integrated(tau: Arithmetic, xp: ExactNamespace) -> tuple[Arithmetic, Arithmetic, Arithmetic]:
        """Return the same to all digits of the numbers."""
        pace = lambda t: xp.exp(-r * t) * start / scene.dissipation(at(t)) if start else 1  # noqa: E731
        beside = lambda t: pace(t) * (scene.dissipation_rate(at(t)) - r)  # noqa: E731
        return xp.quad(pace, [0, tau]), xp.quad(beside, [0, tau]), pace(tau)

    def integrals(tau: Arithmetic) -> tuple[Arithmetic, Arithmetic, Arithmetic]:
        return integrated(tau, xp) if has_digits(xp) else sampled(tau)

    def nearer(tau: Arithmetic) -> Arithmetic:
        whole, _, pace = integrals(tau)
        return tau - (whole - h) / pace

    if has_where(xp):
        # a loop keeps the kind of number it begins with
        tau = iterate(nearer, h + 0 * s, ITERATIONS, xp)
    else:
        before, tau = 0 * h, h
        for _ in range(ITERATIONS if not has_digits(xp) else 2 * ITERATIONS):
            before, tau = tau, nearer(tau)
            if tau == before:
                break
    return at(tau), -r * h - integrals(tau)[1]


def at_rest(scene: GeneralDamping, s: Arithmetic, h: Arithmetic, xp: Namespace) -> Arithmetic:
    """Return −Γ'h with Γ' at the mean of s, so that the derivative by s is right too."""
    z = scene.dissipation_rate(s) * h
    still = z == 0
    moved = choose(still, 1, z + xp.expm1(-z), xp) / choose(still, 2, z, xp) / choose(still, 1, z, xp)
    return -scene.dissipation_rate(s - scene.dissipation(s) * h * moved) * h


def damp_generally(scene: GeneralDamping, x: State, h: Arithmetic, xp: Namespace) -> State:
    """C for any Γ(s): s follows s' = −Γ(s), and p the derivative of s(h), both solving p' = −Γ'(s) p."""
    s, log = decayed(scene, x.s, h, xp)
    factor = xp.exp(log)
    return settle(State(x.q, tuple(factor * p for p in x.p), s), xp)


@dataclass(frozen=True, kw_only=True)
class GeneralDamping(Mechanical):
    """Describe a point mass with any smooth damping: H = ‖p‖²/2m + V(q) + Γ(s), split into kick, drift and damping.

    Nyström tables and Herglotz's recursion refuse it: their flows need a Γ at most quadratic.

        GeneralDamping(name="cubic", potential=V, gradient=dV, q=(1.0,), p=(0.0,), s=0.5, t_end=10.0,
                       damping=lambda s: 0.1 * s + s**3, damping_slope=lambda s: 0.1 + 3 * s * s)

    Parameters
    ----------
    name, about, t_end, s, exact, scale, slows_after, hard, stiff, mission, pace
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
        "damp": Flow(plain, damp_generally, {}),
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

    nonlinear_damping = True

    def dissipation(self, s: Arithmetic) -> Arithmetic:
        return self.damping(s)

    def dissipation_rate(self, s: Arithmetic) -> Arithmetic:
        return self.damping_slope(s)

    #: Γ'' is not asked for: solvers difference
    has_jacobian = False
