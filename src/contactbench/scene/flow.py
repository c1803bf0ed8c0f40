"""Exact subflows, the parts of every contact integrator: each an exact (conformal) contact map.

Each is the time-h flow of one part of the Hamiltonian; for T, V and Γ(s) see the paper, eqs. A-flow, B-flow, C-flow.
T + Γ has a flow of its own (`drift_damp`) for every Γ(s) = γs + ½κs², so that mechanical scenes come in two parts.  On
these Nyström tables keep their order: {V, {V, {V, T + Γ}}} = 0, since V lowers the degree in (p, s) by one and T + Γ is
of degree two (docs/mathematics.md).  A cubic term in Γ would break it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from contactbench.numbers.control import choose
from contactbench.numbers.protocol import Arithmetic, Namespace, Vector


def plain(scene: object, h: Arithmetic, xp: Namespace) -> Arithmetic:
    """Return the step itself, for flows without other constants."""
    return h


#: what `Flow.constants` returns and `Flow.apply` takes
Constants = Any


class Damped(Protocol):
    """A scene with the linear damping γ."""

    @property
    def gamma(self) -> Arithmetic: ...


class Flow(NamedTuple):
    """Define one exact subflow φ_h by two functions: numbers that depend on h alone are computed outside the time loop.

    Flows for h1 and h2 compose to the flow for h1 + h2, so that neighbours may be merged.

    Parameters
    ----------
    constants
        ``(scene, h, xp) -> constants``: the coefficients that depend on the step alone.
    apply
        ``(scene, x, constants, xp) -> x``: the state after the step.
    costs
        Evaluations of one application, by kind ("gradient", "rotation"; "attitude": the additional rotations if R is
        carried).
    """

    constants: Callable[..., Constants]
    apply: Callable[..., Any]
    costs: dict[str, int]


def damped_time(gamma: Arithmetic, h: Arithmetic, xp: Namespace) -> Arithmetic:
    """Return φ(h) = (1 − e^{−γh})/γ, the time a damped momentum is worth; exactly h when γ = 0."""
    undamped, z = gamma == 0, gamma * h
    small = h * (1 - z / 2 * (1 - z / 3))  # its derivatives by γ are those at 0
    return choose(undamped, small, -xp.expm1(-z) / choose(undamped, 1.0, gamma, xp), xp)


#: the decay is a factor above this γh, and a small loss below it
STRONG = 1.5


def damping(gamma: Arithmetic, h: Arithmetic, xp: Namespace) -> tuple[Arithmetic, Arithmetic]:
    """Return e^{−γh} as a pair (keep, lose): damped(p) = keep·p − lose·p.

    With keep = 1 only the small loss is rounded, not the factor, in each of 10⁶ steps; a large loss is (e^{−γh}, 0).
    """
    strong = gamma * h > STRONG
    factor, loss = xp.exp(-gamma * h), -xp.expm1(-gamma * h)
    return choose(strong, factor, 1.0, xp), choose(strong, 0.0, loss, xp)


def time_and_damping(scene: Damped, h: Arithmetic, xp: Namespace) -> Vector:
    return damped_time(scene.gamma, h, xp), *damping(scene.gamma, h, xp)
