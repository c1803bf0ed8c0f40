"""The standard scenes: oscillator, the paper's particle, a central force, the damped rigid body."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

from contactbench.numbers.protocol import Arithmetic
from contactbench.scene import BodyState, HeavyTop, Mechanical, RigidBody, Spheres, State, Vector, dot

if TYPE_CHECKING:
    from mpmath import MPContext


def harmonic(q: Vector, omega: Arithmetic) -> Arithmetic:
    """V = ½ ω² q²."""
    return omega * omega * q[0] * q[0] / 2


def harmonic_gradient(q: Vector, omega: Arithmetic) -> Vector:
    return (omega * omega * q[0],)


def harmonic_hessian(q: Vector, omega: Arithmetic) -> tuple[Vector, ...]:
    return ((omega * omega,),)


def cubic(q: Vector, coupling: Arithmetic) -> Arithmetic:
    """V = ½‖q‖² + c q1² q2 (paper, eq. 2DOF-V, c = 0.1)."""
    x, y = q
    return (x * x + y * y) / 2 + coupling * x * x * y


def cubic_gradient(q: Vector, coupling: Arithmetic) -> Vector:
    x, y = q
    return (x + 2 * coupling * x * y, y + coupling * x * x)


def cubic_hessian(q: Vector, coupling: Arithmetic) -> tuple[Vector, ...]:
    x, y = q
    mixed = 2 * coupling * x
    return ((1 + 2 * coupling * y, mixed), (mixed, 1.0 + 0 * y))


def quartic(q: Vector, stiffness: Arithmetic) -> Arithmetic:
    """V = ½‖q‖² + ¼ k ‖q‖⁴, rotation invariant."""
    x, y = q
    square = x * x + y * y
    return square / 2 + stiffness * square * square / 4


def quartic_gradient(q: Vector, stiffness: Arithmetic) -> Vector:
    x, y = q
    square = x * x + y * y  # multiplied last: of the operations that wait for one another there is one less
    return (x + stiffness * x * square, y + stiffness * y * square)


def quartic_hessian(q: Vector, stiffness: Arithmetic) -> tuple[Vector, ...]:
    x, y = q
    slope = 1 + stiffness * (x * x + y * y)
    mixed = 2 * stiffness * x * y
    return ((slope + 2 * stiffness * x * x, mixed), (mixed, slope + 2 * stiffness * y * y))


def height(q: Vector, weight: Arithmetic) -> Arithmetic:
    """V = w q₃."""
    return weight * q[2]


def height_gradient(q: Vector, weight: Arithmetic) -> Vector:
    return (0.0 * q[0], 0.0 * q[1], weight + 0.0 * q[2])


def height_hessian(q: Vector, weight: Arithmetic) -> tuple[Vector, ...]:
    return ((0.0, 0.0, 0.0),) * 3


# -- closed forms: ``(scene, t, mp)`` with an mpmath context and mpmath numbers ----------------------
def damped_oscillator(scene: Mechanical, t: Arithmetic, mp: MPContext) -> State:
    """V = ½ ω² q², Γ = γ s; s = ½ q p + e^{−γt} (s0 − ½ q0 p0), since ½ q p obeys the equation of s itself."""
    m, gamma = scene.mass, scene.gamma
    square = scene.parameters["omega"] ** 2 / m
    q0, v0, s0 = scene.q[0], scene.p[0] / m, scene.s
    root = mp.sqrt(square - gamma**2 / 4 + mp.mpc(0))  # imaginary when overdamped
    decay = mp.exp(-gamma * t / 2)
    cos, sinc = mp.cos(root * t).real, (mp.sin(root * t) / root).real if root != 0 else t
    q = decay * (q0 * cos + (v0 + gamma * q0 / 2) * sinc)
    v = decay * (v0 * cos - (square * q0 + gamma * v0 / 2) * sinc)
    s = q * m * v / 2 + mp.exp(-gamma * t) * (s0 - q0 * m * v0 / 2)
    return State((q,), (m * v,), s)


def damped_body(scene: RigidBody, t: Arithmetic, mp: MPContext) -> BodyState:
    """M(t) = e^{−γt} m(τ), τ = (1 − e^{−γt})/γ, m the free top (Landau–Lifshitz, Mechanics, §37).

    Attitude is not given (R = None); s = e^{−γt} (s0 + τ H0(0)) since H0 = H0(0) e^{−2γt}.
    """
    gamma = scene.gamma
    tau = -mp.expm1(-gamma * t) / gamma if gamma else t
    decay = mp.exp(-gamma * t)
    m = free_top(scene.inertia, scene.M, tau, mp)
    s = decay * (scene.s + tau * dot(scene.M, scene.angular_velocity(scene.M)) / 2)
    return BodyState(tuple(decay * c for c in m), None, s)


@lru_cache(16)
def elliptic_phase(
    sine: Arithmetic, cosine: Arithmetic, modulus: Arithmetic, mp: MPContext, precision: int
) -> Any:
    """Return F of the angle with these sides at the start of a motion, cached for all its times."""
    return mp.ellipf(mp.atan2(sine, cosine), modulus)


def free_top(inertia: Any, M0: Any, tau: Arithmetic, mp: MPContext) -> Vector:
    """Return the body momentum of the free asymmetric top at time tau, by Jacobi elliptic functions.

    In an order in which the motion encircles the last axis, M = (A1 cn u, A2 sn u, ±A3 dn u) with u linear in time.
    """
    axes = sorted(range(3), key=lambda i: inertia[i])
    square = dot(M0, M0)
    twice = sum(m * m / i for m, i in zip(M0, inertia, strict=True))
    if square < twice * inertia[axes[1]]:  # encircles the axis of smallest inertia
        axes.reverse()
    I1, I2, I3 = (inertia[i] for i in axes)
    M1, M2, M3 = (M0[i] for i in axes)
    # 2E I3 − ‖M‖² and ‖M‖² − 2E I1 up to the common sign of I3 − I1, free of cancellation
    outer = abs(M1 * M1 * (I3 - I1) / I1 + M2 * M2 * (I3 - I2) / I2)
    inner = abs(M2 * M2 * (I2 - I1) / I2 + M3 * M3 * (I3 - I1) / I3)
    if outer == 0 or inner == 0 or I3 == I2:  # steady rotation, or a sphere
        return tuple(M0)
    A1, A2 = mp.sqrt(I1 * outer / abs(I3 - I1)), mp.sqrt(I2 * outer / abs(I3 - I2))
    A3 = mp.sqrt(I3 * inner / abs(I3 - I1))
    rate = mp.sqrt(abs(I3 - I2) * inner / (I1 * I2 * I3))
    modulus = abs(I2 - I1) * outer / (abs(I3 - I2) * inner)
    right_handed = axes in ([0, 1, 2], [1, 2, 0], [2, 0, 1])
    side = 1 if M3 >= 0 else -1
    forward = (right_handed == (I1 < I3)) == (side > 0)
    u = elliptic_phase(M2 / A2, M1 / A1, modulus, mp, mp.prec) + (rate * tau if forward else -rate * tau)
    cn, sn, dn = (mp.ellipfun(kind, u, m=modulus) for kind in ("cn", "sn", "dn"))
    by_axis = dict(zip(axes, (A1 * cn, A2 * sn, side * A3 * dn), strict=True))
    return tuple(by_axis[i] for i in range(3))


# -- scenes ----------------------------------------------------------------------------------------
OSCILLATOR = Mechanical(
    name="oscillator",
    about="linear damped oscillator; everything is known in closed form",
    potential=harmonic,
    gradient=harmonic_gradient,
    hessian=harmonic_hessian,
    parameters={"omega": 1.0},
    gamma=0.1,
    q=(1.0,),
    p=(0.0,),
    t_end=20.0,
    mission=True,
    exact=damped_oscillator,
)

PARTICLE = Mechanical(
    name="particle",
    about="the paper's 2-DOF particle (§6); γ and the initial data are ours, the paper prints h and T only",
    potential=cubic,
    gradient=cubic_gradient,
    hessian=cubic_hessian,
    parameters={"coupling": 0.1},
    gamma=0.1,
    q=(1.0, 0.5),
    p=(0.0, 0.3),
    t_end=20.0,
    mission=True,
)

CENTRAL = Mechanical(
    name="central",
    about="a rotation-invariant quartic force: angular momentum decays as e^{-γt} exactly",
    potential=quartic,
    gradient=quartic_gradient,
    hessian=quartic_hessian,
    rotation_invariant=True,
    parameters={"stiffness": 1.0},
    gamma=0.1,
    q=(1.0, 0.0),
    p=(0.3, 0.8),
    t_end=20.0,
)

RIGID_BODY = RigidBody(
    name="rigid_body",
    about="free top with isotropic damping: H0 decays as e^{-2γt}, the spatial momentum J = R M as e^{-γt}",
    inertia=(1.0, 2.0, 3.0),
    gamma=0.1,
    M=(0.2, 1.5, 0.3),
    t_end=20.0,
    mission=True,
    exact=damped_body,
)

RIGID_BODY_ANISOTROPIC = RigidBody(
    name="rigid_body_anisotropic",
    about="free top with anisotropic damping, which no term γs of a contact Hamiltonian gives: no conformal factor",
    inertia=(1.0, 2.0, 3.0),
    damping=(0.05, 0.1, 0.3),
    M=(0.2, 1.5, 0.3),
    t_end=20.0,
)

HEAVY_TOP = HeavyTop(
    name="heavy_top",
    about="Lagrange's top with isotropic damping: the vertical momentum decays as e^{-γt}",
    inertia=(1.0, 1.0, 0.5),
    weight=1.0,
    gamma=0.05,
    M=(0.0, 0.0, 2.0),
    R=(0.955336489125606, 0.29552020666133955, 0.0, 0.0),
    t_end=20.0,
)

SPHERICAL_PENDULUM = Spheres(
    name="spherical_pendulum",
    about="a damped spherical pendulum: the vertical component of q × p decays as e^{-γt}",
    potential=height,
    gradient=height_gradient,
    hessian=height_hessian,
    axis=(0.0, 0.0, 1.0),
    parameters={"weight": 1.0},
    gamma=0.2,
    q=(0.6, 0.0, -0.8),
    p=(0.32, 0.9, 0.24),
    t_end=20.0,
)

PARTICLE_LONG = PARTICLE.with_(
    name="particle_long",
    about="the particle with γ = 10⁻³ over a hundred times the span",
    gamma=1e-3,
    t_end=2000.0,
    mission=False,
)

# Γ'(s) = κs falls from 0.5 at the start to 0.09 at the end, so that a rate taken as constant would show.
# s stays positive (0.18 at least): the force grows faster than linearly, so T exceeds V on average (virial
# theorem) and feeds s, while s ≤ 0 would mean antidamping and, from s < 0 on, possible blow-up.
QUADRATIC_DAMPING = CENTRAL.with_(
    name="quadratic_damping",
    about="the central force with Γ(s) = ½κs²: H and J both decay as e^{-∫Γ'(s)dt}, at a rate that changes",
    gamma=0.0,
    kappa=0.5,
    s=1.0,
)

STANDARD = (
    OSCILLATOR,
    PARTICLE,
    CENTRAL,
    RIGID_BODY,
    RIGID_BODY_ANISOTROPIC,
    HEAVY_TOP,
    SPHERICAL_PENDULUM,
    PARTICLE_LONG,
    QUADRATIC_DAMPING,
)
