"""Scenes with a contact Hamiltonian of another form than T(p) + V(q) + Γ(s)."""

from __future__ import annotations

from contactbench.numbers import functions as xp
from contactbench.numbers.protocol import Arithmetic
from contactbench.scene import ContactSystem, Vector
from contactbench.scenes.standard import CENTRAL


def double_pendulum(q: Vector, p: Vector, s: Arithmetic, gamma: Arithmetic) -> Arithmetic:
    """H of two equal masses on equal rods, in units of m, l and √(l/g); q are the angles from the vertical.

    Lagrange's function is q₁'² + ½q₂'² + q₁'q₂' cos(q₁ − q₂) − V (Landau, Lifshitz, Mechanics, §5, problem 1).
    """
    cosine, sine = xp.cos(q[0] - q[1]), xp.sin(q[0] - q[1])
    kinetic = (p[0] * p[0] + 2 * p[1] * p[1] - 2 * p[0] * p[1] * cosine) / (2 * (1 + sine * sine))
    return kinetic + 2 * (1 - xp.cos(q[0])) + (1 - xp.cos(q[1])) + gamma * s


def polar(q: Vector, p: Vector, s: Arithmetic, gamma: Arithmetic, stiffness: Arithmetic) -> Arithmetic:
    """H = ½ (p_r² + p_θ²/r²) + V(r) + γ s, the metric diag(1, r²) of the paper's eqs. 30–37 in the plane."""
    square = q[0] * q[0]
    return (p[0] * p[0] + p[1] * p[1] / square) / 2 + square / 2 + stiffness * square * square / 4 + gamma * s


def polar_momentum(
    q: Vector, p: Vector, s: Arithmetic, gamma: Arithmetic, stiffness: Arithmetic
) -> Arithmetic:
    return p[1]


def thermostat(q: Vector, p: Vector, s: Arithmetic, beta: Arithmetic) -> Arithmetic:
    """H = ρ^{−1/2}, which has the invariant density ρ = e^{−βh} f(s), h = ½(p² + q²), f = e^s/(1 + e^s)².

    The divergence of a contact field in n degrees of freedom is −(n + 1) ∂H/∂s, and H' = −H ∂H/∂s: |H|^{−(n+1)} is
    invariant.  ρ^{−1/2} = 2 e^{βh/2} cosh(s/2).
    """
    return 2 * xp.exp(beta * (p[0] * p[0] + q[0] * q[0]) / 4) * xp.cosh(s / 2)


DOUBLE_PENDULUM = ContactSystem(
    name="double_pendulum",
    about="a double pendulum of equal masses and rods; its friction is −γp, proportional to the mass matrix",
    hamiltonian=double_pendulum,
    parameters={"gamma": 0.1},
    q=(1.5, 0.5),
    p=(0.0, 0.0),
    t_end=20.0,
)

POLAR = ContactSystem(
    name="polar",
    about="the motion of `central` in polar coordinates (the paper, eqs. 30–37); p_θ decays as e^{-γt}",
    hamiltonian=polar,
    momentum=polar_momentum,
    parameters={"gamma": CENTRAL.gamma, **CENTRAL.parameters},
    q=(1.0, 0.0),
    p=(0.3, 0.8),
    t_end=20.0,
)

THERMOSTAT = ContactSystem(
    name="thermostat",
    about="an oscillator in contact density dynamics, whose invariant density is canonical; Bravetti, Tapias, Phys. "
    "Rev. E 93, 022139 (2016), doi:10.1103/PhysRevE.93.022139",
    hamiltonian=thermostat,
    parameters={"beta": 1.0},
    q=(1.0,),
    p=(0.3,),
    s=0.5,
    t_end=5.0,
)

CONTACT_SYSTEMS = (DOUBLE_PENDULUM, POLAR, THERMOSTAT)
