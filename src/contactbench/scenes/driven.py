"""Time-dependent scenes: a forced oscillator, Lane–Emden, chaos.

H = T(p) + V(q, t) + γ(t) s, the class of Bravetti, Seri, Vermeeren, Zadra, Celest. Mech. Dyn. Astron. 132, 7 (2020),
doi:10.1007/s10569-019-9946-9, one of whose examples the Lane–Emden scene is.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from contactbench.numbers import functions as xm
from contactbench.numbers.protocol import Arithmetic, Namespace
from contactbench.scene import Driven, DrivenState, Vector

if TYPE_CHECKING:
    from mpmath import MPContext


# -- forces ----------------------------------------------------------------------------------------
def forced(q: Vector, t: Arithmetic, omega: Arithmetic, force: Arithmetic, drive: Arithmetic) -> Arithmetic:
    """V = ½ ω² q² − F q cos Ωt."""
    return omega * omega * q[0] * q[0] / 2 - force * q[0] * xm.cos(drive * t)


def forced_gradient(
    q: Vector, t: Arithmetic, omega: Arithmetic, force: Arithmetic, drive: Arithmetic
) -> Vector:
    return (omega * omega * q[0] - force * xm.cos(drive * t),)


def double_well(q: Vector, t: Arithmetic, force: Arithmetic, drive: Arithmetic) -> Arithmetic:
    """V = ¼ q⁴ − ½ q² − F q sin Ωt."""
    square = q[0] * q[0]
    return square * square / 4 - square / 2 - force * q[0] * xm.sin(drive * t)


def double_well_gradient(q: Vector, t: Arithmetic, force: Arithmetic, drive: Arithmetic) -> Vector:
    return (q[0] * q[0] * q[0] - q[0] - force * xm.sin(drive * t),)


def sextic(q: Vector, t: Arithmetic) -> Arithmetic:
    """V = q⁶/6: index 5."""
    cube = q[0] * q[0] * q[0]
    return cube * cube / 6


def sextic_gradient(q: Vector, t: Arithmetic) -> Vector:
    square = q[0] * q[0]
    return (square * square * q[0],)


# -- γ(t) ---------------------------------------------------------------------------------------
def spherical(t: Arithmetic) -> Arithmetic:
    """γ = 2/t, the divergence of a radius in space."""
    return 2 / t


def spherical_span(t: Arithmetic, h: Arithmetic, xp: Namespace) -> tuple[Arithmetic, Arithmetic]:
    """∫γ = 2 log(1 + h/t), φ = t h/(t + h)."""
    return 2 * xp.log1p(h / t), t * h / (t + h)


# -- closed forms ----------------------------------------------------------------------------------
def forced_oscillator(scene: Driven, t: Arithmetic, mp: MPContext) -> DrivenState:
    """Steady and transient oscillation, sums of exponentials; s = ½ q p + r, r' = −γ r + ½ F q cos Ωt.

    Critical and no damping, and a constant force without a spring, are limits of the formula: there it is taken
    beside them, with digits to spare.
    """
    omega, drive = mp.mpf(scene.parameters["omega"]), scene.parameters["drive"]
    digits, gamma = mp.dps, mp.mpf(scene.gamma)
    with mp.workdps(8 * digits):
        near = mp.mpf(10) ** -digits
        omega = near if omega == 0 and drive == 0 else omega
        resting = gamma == 0 or gamma * gamma / 4 == omega * omega / mp.mpf(scene.mass)
        return oscillation(scene, omega, gamma + near if resting else gamma, t, mp)


def oscillation(
    scene: Driven, omega: Arithmetic, gamma: Arithmetic, t: Arithmetic, mp: MPContext
) -> DrivenState:
    m, force = scene.mass, scene.parameters["force"]
    square, turn = omega * omega, mp.mpc(0, scene.parameters["drive"])
    start = mp.exp(turn * scene.t)
    amplitude = force * start / (m * turn * turn + m * gamma * turn + square)
    root = mp.sqrt(gamma**2 / 4 - square / m + mp.mpc(0))
    rates = (-gamma / 2 + root, -gamma / 2 - root)
    q0 = scene.q[0] - amplitude.real
    v0 = scene.p[0] / m - (turn * amplitude).real
    free = ((v0 - rates[1] * q0) / (2 * root), (rates[0] * q0 - v0) / (2 * root))
    terms = [(free[0], rates[0]), (free[1], rates[1]), (amplitude / 2, turn)]
    terms.append((mp.conj(amplitude) / 2, -turn))
    q = sum(c * mp.exp(rate * t) for c, rate in terms).real
    p = m * sum(c * rate * mp.exp(rate * t) for c, rate in terms).real
    gain = mp.mpf(0)
    for c, rate in terms:
        for side in (start, mp.conj(start)):
            total = rate + (turn if side is start else -turn)
            gain += (c * side * force / 4 * (mp.exp(total * t) - mp.exp(-gamma * t)) / (total + gamma)).real
    rest = mp.exp(-gamma * t) * (scene.s - scene.q[0] * scene.p[0] / 2)
    return DrivenState((q,), (p,), scene.t + t, q * p / 2 + gain + rest)


def lane_emden_5(scene: Driven, t: Arithmetic, mp: MPContext) -> DrivenState:
    """q = (3a/(3 + a²t²))^½, with (1 + t²/3)^{−½} for a = 1; for initial data on one of them."""
    u0 = -3 * scene.p[0] / scene.q[0] ** 3
    a, root = u0 / scene.t, mp.sqrt(3)

    def motion(now: Arithmetic) -> tuple[Arithmetic, Arithmetic]:
        q = mp.sqrt(3 * a / (3 + (a * now) ** 2))
        return q, -(q**3) * a * now / 3

    def area(now: Arithmetic) -> Arithmetic:  # ∫ ⅓ t² q⁶ = √3 ∫ w²/(1 + w²)³ dw, w = at/√3
        w = a * now / root
        found: Arithmetic = root * (mp.atan(w) / 8 + w * (w * w - 1) / (8 * (1 + w * w) ** 2))
        return found

    return with_action(scene, t, motion, area)


def with_action(
    scene: Driven, t: Arithmetic, motion: Callable[..., Vector], area: Callable[..., Arithmetic]
) -> DrivenState:
    """Return a state under γ = 2/t: s = ½ q p + r with (t² r)' = t² (½ q V' − V), whose integral is `area`."""
    q, p = motion(scene.t + t)
    rest = scene.t**2 * (scene.s - scene.q[0] * scene.p[0] / 2) + area(scene.t + t) - area(scene.t)
    return DrivenState((q,), (p,), scene.t + t, q * p / 2 + rest / (scene.t + t) ** 2)


# -- scenes ----------------------------------------------------------------------------------------
FORCED_OSCILLATOR = Driven(
    name="forced_oscillator",
    about="a damped oscillator under a sinusoidal force: a transient and a steady motion, both in closed form",
    potential=forced,
    gradient=forced_gradient,
    parameters={"omega": 1.0, "force": 0.3, "drive": 0.7},
    gamma=0.1,
    q=(1.0,),
    p=(0.0,),
    t_end=20.0,
    exact=forced_oscillator,
)

LANE_EMDEN_5 = Driven(
    name="lane_emden_5",
    about="the Lane–Emden equation, γ = 2/t, of index 5: 2(1 + 16t²/3)^(−1/2), one of its solutions in closed form",
    potential=sextic,
    gradient=sextic_gradient,
    rate=spherical,
    span=spherical_span,
    exact=lane_emden_5,
    q=(1.0,),
    p=(-1.0,),
    t=0.75,
    t_end=20.0,
    slows_after=0.5,
)

DUFFING = Driven(
    name="duffing",
    about="a damped double well under a sinusoidal force: chaotic; up to the end time errors grow about fortyfold, "
    "long after it only laws and averages of a run are meaningful",
    potential=double_well,
    gradient=double_well_gradient,
    parameters={"force": 0.4, "drive": 1.0},
    gamma=0.25,
    q=(1.0,),
    p=(0.0,),
    t_end=25.0,
)

DRIVEN = (FORCED_OSCILLATOR, LANE_EMDEN_5, DUFFING)
