"""Scenes with time in them: a forced oscillator, its damping constant or not; Lane–Emden; chaos; two of DETEST.

H = T(p) + V(q, t) + γ(t) s, the class of Bravetti, Seri, Vermeeren, Zadra, Celest. Mech. Dyn. Astron. 132, 7 (2020),
doi:10.1007/s10569-019-9946-9, whose examples the Lane–Emden scenes are.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from contactbench.numbers import functions as xm
from contactbench.numbers.protocol import Arithmetic, Namespace
from contactbench.scene import Driven, DrivenState, Vector

if TYPE_CHECKING:
    from mpmath import MPContext


# -- forces ----------------------------------------------------------------------------------------
def forced(
    q: Vector, t: Arithmetic, omega: Arithmetic, force: Arithmetic, drive: Arithmetic, **damping: Arithmetic
) -> Arithmetic:
    """V = ½ ω² q² − F q cos Ωt."""
    return omega * omega * q[0] * q[0] / 2 - force * q[0] * xm.cos(drive * t)


def forced_gradient(
    q: Vector, t: Arithmetic, omega: Arithmetic, force: Arithmetic, drive: Arithmetic, **damping: Arithmetic
) -> Vector:
    return (omega * omega * q[0] - force * xm.cos(drive * t),)


def double_well(q: Vector, t: Arithmetic, force: Arithmetic, drive: Arithmetic) -> Arithmetic:
    """V = ¼ q⁴ − ½ q² − F q sin Ωt."""
    square = q[0] * q[0]
    return square * square / 4 - square / 2 - force * q[0] * xm.sin(drive * t)


def double_well_gradient(q: Vector, t: Arithmetic, force: Arithmetic, drive: Arithmetic) -> Vector:
    return (q[0] * q[0] * q[0] - q[0] - force * xm.sin(drive * t),)


def constant_pull(q: Vector, t: Arithmetic) -> Arithmetic:
    """V = q: Lane–Emden of index 0."""
    return q[0]


def constant_pull_gradient(q: Vector, t: Arithmetic) -> Vector:
    return (1.0 + 0 * q[0],)


def square_well(q: Vector, t: Arithmetic) -> Arithmetic:
    """V = ½ q²: index 1."""
    return q[0] * q[0] / 2


def square_well_gradient(q: Vector, t: Arithmetic) -> Vector:
    return (q[0],)


def bessel(q: Vector, t: Arithmetic) -> Arithmetic:
    """V = ½ (1 − ¼ t⁻²) q²: of γ = 1/t the Bessel equation of order ½."""
    return (1 - 1 / (4 * t * t)) * q[0] * q[0] / 2


def bessel_gradient(q: Vector, t: Arithmetic) -> Vector:
    return ((1 - 1 / (4 * t * t)) * q[0],)


def soft_spring(
    q: Vector, t: Arithmetic, softness: Arithmetic, force: Arithmetic, drive: Arithmetic
) -> Arithmetic:
    """V = ½ q² − ¼ q⁴/c − F q sin Ωt."""
    square = q[0] * q[0]
    return square / 2 - square * square / (4 * softness) - force * q[0] * xm.sin(drive * t)


def soft_spring_gradient(
    q: Vector, t: Arithmetic, softness: Arithmetic, force: Arithmetic, drive: Arithmetic
) -> Vector:
    return (q[0] - q[0] * q[0] * q[0] / softness - force * xm.sin(drive * t),)


def sextic(q: Vector, t: Arithmetic) -> Arithmetic:
    """V = q⁶/6: index 5."""
    cube = q[0] * q[0] * q[0]
    return cube * cube / 6


def sextic_gradient(q: Vector, t: Arithmetic) -> Vector:
    square = q[0] * q[0]
    return (square * square * q[0],)


# -- γ(t) ---------------------------------------------------------------------------------------
def spherical(t: Arithmetic, **parameters: Arithmetic) -> Arithmetic:
    """γ = 2/t, the divergence of a radius in space."""
    return 2 / t


def spherical_span(
    t: Arithmetic, h: Arithmetic, xp: Namespace, **parameters: Arithmetic
) -> tuple[Arithmetic, Arithmetic]:
    """∫γ = 2 log(1 + h/t), φ = t h/(t + h)."""
    return 2 * xp.log1p(h / t), t * h / (t + h)


def cylindrical(t: Arithmetic) -> Arithmetic:
    """γ = 1/t, the divergence of a radius in the plane."""
    return 1 / t


def cylindrical_span(t: Arithmetic, h: Arithmetic, xp: Namespace) -> tuple[Arithmetic, Arithmetic]:
    """∫γ = log(1 + h/t), φ = t log(1 + h/t)."""
    spent = xp.log1p(h / t)
    return spent, t * spent


def pulsating(
    t: Arithmetic, friction: Arithmetic, depth: Arithmetic, pulse: Arithmetic, **parameters: Arithmetic
) -> Arithmetic:
    """γ = γ₀ (1 + a sin νt); φ is no elementary function."""
    return friction * (1 + depth * xm.sin(pulse * t))


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


def lane_emden_0(scene: Driven, t: Arithmetic, mp: MPContext) -> DrivenState:
    """q = C + D/t − t²/6, with 1 − t²/6 among them; s by `with_action`."""
    t0, v0 = scene.t, scene.p[0]
    D = -(v0 + t0 / 3) * t0**2
    C = scene.q[0] - D / t0 + t0**2 / 6

    def area(t: Arithmetic) -> Arithmetic:  # ∫ −½ t² q
        return -C * t**3 / 6 - D * t**2 / 4 + t**5 / 60

    return with_action(scene, t, lambda t: (C + D / t - t**2 / 6, -D / t**2 - t / 3), area)


def lane_emden_1(scene: Driven, t: Arithmetic, mp: MPContext) -> DrivenState:
    """q = (A sin t + B cos t)/t, with sin t/t among them."""
    return spreading_wave(scene, t, mp, mp.mpf(1))


def bessel_half(scene: Driven, t: Arithmetic, mp: MPContext) -> DrivenState:
    """q = (A sin t + B cos t)/√t, with J_½ = √(2/π) sin t/√t among them."""
    return spreading_wave(scene, t, mp, mp.mpf(1) / 2)


def spreading_wave(scene: Driven, t: Arithmetic, mp: MPContext, a: float) -> DrivenState:
    """Return u/tᵃ, u'' = −u, the motion under γ = 2a/t; s − ½ q p falls as 1/t²ᵃ, the potential being quadratic."""
    t0, now = scene.t, scene.t + t
    u0 = t0**a * scene.q[0]
    w0 = t0**a * (scene.p[0] + a * scene.q[0] / t0)
    sin, cos = mp.sin(t), mp.cos(t)
    u, w = u0 * cos + w0 * sin, w0 * cos - u0 * sin
    q, p = u / now**a, (w - a * u / now) / now**a
    rest = (t0 / now) ** (2 * a) * (scene.s - scene.q[0] * scene.p[0] / 2)
    return DrivenState((q,), (p,), now, q * p / 2 + rest)


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
#: few experiments each, since all of them on one more scene take a minute
_LAWS = ("convergence", "laws")
_COST = (*_LAWS, "decay_laws", "work_precision")

FORCED_OSCILLATOR = Driven(
    name="forced_oscillator",
    experiments=_COST,
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

FORCED_PULSATING = Driven(
    name="forced_pulsating",
    experiments=_LAWS,
    about="the forced oscillator under a damping γ₀(1 + a sin νt) that changes its sign: no step of it in closed form, "
    "the damping is integrated over each step by Gauss's rule",
    potential=forced,
    gradient=forced_gradient,
    rate=pulsating,
    q=(1.0,),
    p=(0.0,),
    t_end=20.0,
    parameters={**FORCED_OSCILLATOR.parameters, "friction": 0.1, "depth": 1.5, "pulse": 1.3},
)

_LANE_EMDEN = "the Lane–Emden equation, γ = 2/t, of index"
_SPHERICAL: Any = {"rate": spherical, "span": spherical_span}
LANE_EMDEN = (
    Driven(
        name="lane_emden_0",
        about=f"{_LANE_EMDEN} 0: 1 − t²/6 in closed form",
        experiments=("laws",),  # under a constant force most methods have no error but round-off
        potential=constant_pull,
        gradient=constant_pull_gradient,
        exact=lane_emden_0,
        q=(0.94,),
        p=(-0.2,),
        t=0.6,
        t_end=2.0,
        **_SPHERICAL,
    ),
    Driven(
        name="lane_emden_1",
        about=f"{_LANE_EMDEN} 1: sin t/t in closed form",
        experiments=_LAWS,
        potential=square_well,
        gradient=square_well_gradient,
        exact=lane_emden_1,
        q=(0.8414709848078965,),
        p=(-0.30116867893975674,),
        t=1.0,
        t_end=20.0,
        **_SPHERICAL,
    ),
    Driven(
        name="lane_emden_5",
        about=f"{_LANE_EMDEN} 5: 2(1 + 16t²/3)^(−1/2), one of its solutions in closed form",
        potential=sextic,
        gradient=sextic_gradient,
        exact=lane_emden_5,
        experiments=_COST,
        q=(1.0,),
        p=(-1.0,),
        t=0.75,
        t_end=20.0,
        slows_after=0.5,
        **_SPHERICAL,
    ),
)

DUFFING = Driven(
    name="duffing",
    experiments=(*_LAWS, "decay_laws"),
    about="a damped double well under a sinusoidal force: chaotic; up to the end time errors grow about fortyfold, "
    "long after it only laws and averages of a run mean anything",
    potential=double_well,
    gradient=double_well_gradient,
    parameters={"force": 0.4, "drive": 1.0},
    gamma=0.25,
    q=(1.0,),
    p=(0.0,),
    t_end=25.0,
)

_DETEST = "of Hull, Enright, Fellen, Sedgwick, SIAM J. Numer. Anal. 9, 603 (1972), doi:10.1137/0709052"
#: of the five of class E those whose damping is −γ(t) p
DETEST = (
    Driven(
        name="detest_e1",
        experiments=("laws",),
        about=f"problem E1 {_DETEST}: the Bessel equation of order ½, its x + 1 the time",
        potential=bessel,
        gradient=bessel_gradient,
        rate=cylindrical,
        span=cylindrical_span,
        exact=bessel_half,
        q=(0.6713967071418031,),
        p=(0.09540051444747454,),
        t=1.0,
        t_end=20.0,
    ),
    Driven(
        name="detest_e3",
        experiments=_LAWS,
        about=f"problem E3 {_DETEST}: y″ = y³/6 − y + 2 sin 2.78535t, undamped: contact-printed is contact-strang",
        potential=soft_spring,
        gradient=soft_spring_gradient,
        parameters={"softness": 6.0, "force": 2.0, "drive": 2.78535},
        q=(0.0,),
        p=(0.0,),
        t_end=20.0,
    ),
)

DRIVEN = (FORCED_OSCILLATOR, FORCED_PULSATING, *LANE_EMDEN, DUFFING, *DETEST)
