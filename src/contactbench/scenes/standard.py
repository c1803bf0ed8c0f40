"""The standard scenes: oscillator, the paper's particle, a central force, the damped rigid body."""

from __future__ import annotations

from contactbench.scene import Mechanical, RigidBody
from contactbench.scenes.closed_form import damped_body, damped_oscillator


def harmonic(q, omega):
    """V = ½ ω² q²."""
    return omega * omega * q[0] * q[0] / 2


def harmonic_gradient(q, omega):
    return (omega * omega * q[0],)


def harmonic_hessian(q, omega):
    return ((omega * omega,),)


def cubic(q, coupling):
    """V = ½‖q‖² + c q1² q2 (paper, eq. 2DOF-V, c = 0.1)."""
    x, y = q
    return (x * x + y * y) / 2 + coupling * x * x * y


def cubic_gradient(q, coupling):
    x, y = q
    return (x + 2 * coupling * x * y, y + coupling * x * x)


def cubic_hessian(q, coupling):
    x, y = q
    mixed = 2 * coupling * x
    return ((1 + 2 * coupling * y, mixed), (mixed, 1.0 + 0 * y))


def quartic(q, stiffness):
    """V = ½‖q‖² + ¼ k ‖q‖⁴, rotation invariant."""
    x, y = q
    square = x * x + y * y
    return square / 2 + stiffness * square * square / 4


def quartic_gradient(q, stiffness):
    x, y = q
    square = x * x + y * y  # multiplied last: of the operations that wait for one another there is one less
    return (x + stiffness * x * square, y + stiffness * y * square)


def quartic_hessian(q, stiffness):
    x, y = q
    slope = 1 + stiffness * (x * x + y * y)
    mixed = 2 * stiffness * x * y
    return ((slope + 2 * stiffness * x * x, mixed), (mixed, slope + 2 * stiffness * y * y))


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
    exact=damped_body,
)

RIGID_BODY_ANISOTROPIC = RigidBody(
    name="rigid_body_anisotropic",
    about="free top with anisotropic damping: no contact Hamiltonian γs gives it, no conformal factor",
    inertia=(1.0, 2.0, 3.0),
    damping=(0.05, 0.1, 0.3),
    M=(0.2, 1.5, 0.3),
    t_end=20.0,
)

PARTICLE_LONG = PARTICLE.with_(
    name="particle_long",
    about="the particle with γ = 10⁻³ over a hundred times the span",
    gamma=1e-3,
    t_end=2000.0,
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
    PARTICLE_LONG,
    QUADRATIC_DAMPING,
)
