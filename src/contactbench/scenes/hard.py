"""The hard scenes, on which integrators break.

They are marked `hard`: the benchmark looks at how runs end and which laws they keep.  `about` explains the difficulty
of each scene.
"""

from __future__ import annotations

from contactbench.numbers.functions import exp
from contactbench.numbers.protocol import Arithmetic
from contactbench.scene import Mechanical, Vector
from contactbench.scenes.standard import OSCILLATOR, PARTICLE, RIGID_BODY, RIGID_BODY_ANISOTROPIC


def two_scales(q: Vector, omega: Arithmetic, coupling: Arithmetic) -> Arithmetic:
    """V = ½ q1² + ½ ω² q2² + c q1² q2: a slow and a fast oscillation, coupled."""
    x, y = q
    return (x * x + omega * omega * y * y) / 2 + coupling * x * x * y


def two_scales_gradient(q: Vector, omega: Arithmetic, coupling: Arithmetic) -> Vector:
    x, y = q
    return (x + 2 * coupling * x * y, omega * omega * y + coupling * x * x)


def two_scales_hessian(q: Vector, omega: Arithmetic, coupling: Arithmetic) -> tuple[Vector, ...]:
    x, y = q
    mixed = 2 * coupling * x
    return ((1 + 2 * coupling * y, mixed), (mixed, omega * omega + 0 * y))


def kepler(q: Vector, strength: Arithmetic) -> Arithmetic:
    """V = −k/‖q‖."""
    x, y = q
    return -strength * (x * x + y * y) ** -0.5


def kepler_gradient(q: Vector, strength: Arithmetic) -> Vector:
    x, y = q
    inverse = (x * x + y * y) ** -0.5
    pull = strength * inverse * inverse * inverse
    return (pull * x, pull * y)


def kepler_hessian(q: Vector, strength: Arithmetic) -> tuple[Vector, ...]:
    x, y = q
    inverse = (x * x + y * y) ** -0.5
    square = inverse * inverse
    pull = strength * inverse * square
    mixed = -3 * pull * square * x * y
    return ((pull * (1 - 3 * square * x * x), mixed), (mixed, pull * (1 - 3 * square * y * y)))


def wall(q: Vector, steepness: Arithmetic) -> Arithmetic:
    """V = e^{k (q − 1)}."""
    return exp(steepness * (q[0] - 1))


def wall_gradient(q: Vector, steepness: Arithmetic) -> Vector:
    return (steepness * wall(q, steepness),)


def wall_hessian(q: Vector, steepness: Arithmetic) -> tuple[Vector, ...]:
    return ((steepness * steepness * wall(q, steepness),),)


STIFF_SPRING = Mechanical(
    name="stiff_spring",
    about="two coupled oscillations of equal energy, one a hundred times faster than the other: explicit methods "
    "must follow the fast one whether or not it matters, and implicit methods must resolve it too, because it does "
    "not die out.",
    potential=two_scales,
    gradient=two_scales_gradient,
    hessian=two_scales_hessian,
    parameters={"omega": 100.0, "coupling": 0.1},
    gamma=0.1,
    q=(1.0, 0.01),
    p=(0.0, 0.3),
    t_end=20.0,
    stiff=True,
    pace=(0.0025,),
)

KEPLER_DRAG = Mechanical(
    name="kepler_drag",
    about="an orbit of eccentricity 0.9 about a centre of attraction, with drag: at every return the time "
    "scale shrinks by a factor of eighty. A fixed step must be as small as the pericentre requires, all the way round.",
    potential=kepler,
    gradient=kepler_gradient,
    hessian=kepler_hessian,
    rotation_invariant=True,
    parameters={"strength": 1.0},
    gamma=1e-3,
    q=(0.1, 0.0),
    p=(0.0, 4.358898943540674),
    t_end=100.0,
    pace=(0.008,),
)

KEPLER = KEPLER_DRAG.with_(
    name="kepler",
    about="an orbit of eccentricity 0.3 with drag, not hard: J decays as e^{-γt}, and V < 0 throughout",
    q=(0.7, 0.0),
    p=(0.0, 1.362770287738494),
    t_end=200.0,
    pace=(),
)

STEEP_WALL = Mechanical(
    name="steep_wall",
    about="a free flight into a wall, V = e^{50(q − 1)}: at the start the force is 10⁻²⁰, on the wall the time scale "
    "is 0.1. A solver that chooses its step from the local force steps far into the wall, is thrown back with a "
    "wrong energy, and may still end `ok`.",
    potential=wall,
    gradient=wall_gradient,
    hessian=wall_hessian,
    parameters={"steepness": 50.0},
    gamma=0.1,
    q=(0.0,),
    p=(0.25,),
    t_end=10.0,
    stiff=True,
)

HARD = tuple(
    scene.with_(hard=scene is not KEPLER, mission=False)
    for scene in (
        OSCILLATOR.with_(
            name="overdamped",
            about="γ = 50: after a short transient the motion creeps back at the slow rate 0.02. A method that "
            "applies force and friction one after the other gets this rate wrong, by a factor of about "
            "(γh/2)coth(γh/2); an explicit one is unstable unless γh is of order one, although nothing fast happens.",
            gamma=50.0,
            t_end=100.0,
            stiff=True,
            pace=(0.5, 0.1, 0.02, 0.005),  # γh = 25, 5, 1
        ),
        PARTICLE.with_(
            name="creeping",
            about="the particle at γ = 50: after a short transient it creeps back along a curve, thousands of times "
            "more slowly than the damping acts. Explicit methods follow the damping, and compositions of order two "
            "fall to order one.",
            gamma=50.0,
            t_end=200.0,
            stiff=True,
            pace=(10.0, 2.5, 0.5, 0.1, 0.02),
        ),
        OSCILLATOR.with_(
            name="weak_damping",
            about="γ = 10⁻⁵ over 1600 periods: a tenth of the energy is lost in all. The numerical dissipation of a "
            "method adds to the damping of the scene, and at coarse steps exceeds it.",
            gamma=1e-5,
            t_end=1e4,
            pace=(0.25,),
        ),
        STIFF_SPRING,
        RIGID_BODY.with_(
            name="tumbling",
            about="a body spinning about its middle axis, off by 10⁻⁸: it flips over and back, time and again. Every "
            "flip magnifies rounding errors by 10⁸, so that no method that takes steps in double precision has many "
            "digits of the attitude. The closed form takes no steps and has all digits; the decay laws can hold in any "
            "case.",
            gamma=1e-3,
            M=(1e-8, 1.0, 1e-8),
            t_end=200.0,
            pace=(0.25,),
        ),
        RIGID_BODY.with_(
            name="needle",
            about="moments of inertia 10⁻³, 1 and 1.001: a small momentum about the thin axis is a fast spin, the two "
            "others are nearly equal, and the energy is nearly all in the spin.",
            inertia=(1e-3, 1.0, 1.001),
            M=(0.02, 1.0, 0.5),
            t_end=20.0,
            pace=(0.0125,),
        ),
        RIGID_BODY_ANISOTROPIC.with_(
            name="singular_damping_2",
            about="damping whose kernel is the middle axis. Rotation about this axis is unstable without damping and "
            "stable with this much: the other rotations die out, and the body ends in a steady rotation, not at rest.",
            damping=(0.5, 0.0, 0.5),
            t_end=100.0,
            pace=(0.2,),
        ),
        PARTICLE.with_(
            name="saddle_edge",
            about="the particle with 99.9 % of the energy of the saddles at (±√50, −5), heading for one: it "
            "hesitates there and turns back. An energy error of 0.1 % lets it escape to infinity.",
            gamma=1e-3,
            q=(0.0, -1.5),
            p=(4.35, -1.95),
            t_end=50.0,
            pace=(0.1,),
        ),
        PARTICLE.with_(
            name="escape",
            about="the particle beyond the saddle and heading out: it reaches infinity in finite time, before the end "
            "time asked for. The right answer is `diverged`, with that time; any finite state would be wrong.",
            gamma=1e-3,
            q=(8.0, -6.0),
            p=(3.0, -1.0),
            t_end=10.0,
            pace=(0.0004,),
        ),
        KEPLER_DRAG,
        KEPLER,
        STEEP_WALL,
        OSCILLATOR.with_(
            name="antidamping",
            about="γ = −0.1: energy is fed in and the motion grows by e^{5}. No method may assume decay.",
            gamma=-0.1,
            t_end=100.0,
            pace=(0.2,),
        ),
        OSCILLATOR.with_(
            name="large_step",
            about="the oscillator at steps around the stability limit, ωh = 2 for a splitting without the merged "
            "flow; the limits themselves are in `limits.csv`.",
            gamma=1.0,
            t_end=210.0,
            pace=(2.1, 1.4, 0.525, 0.13125),  # both sides of the limit
        ),
    )
)
