"""Scenes with time in them: a forced oscillator, the Lane–Emden equation, a chaotic double well.

H = T(p) + V(q, t) + γ(t) s, the class of Bravetti, Seri, Vermeeren, Zadra, Celest. Mech. Dyn. Astron. 132, 7 (2020),
doi:10.1007/s10569-019-9946-9, whose examples the Lane–Emden scenes are.
"""

from __future__ import annotations

from typing import Any

from contactbench.numbers import functions as xm
from contactbench.scene import Driven, DrivenState


# -- forces ----------------------------------------------------------------------------------------
def forced(q, t, omega, force, drive):
    """V = ½ ω² q² − F q cos Ωt."""
    return omega * omega * q[0] * q[0] / 2 - force * q[0] * xm.cos(drive * t)


def forced_gradient(q, t, omega, force, drive):
    return (omega * omega * q[0] - force * xm.cos(drive * t),)


def double_well(q, t, force, drive):
    """V = ¼ q⁴ − ½ q² − F q sin Ωt."""
    square = q[0] * q[0]
    return square * square / 4 - square / 2 - force * q[0] * xm.sin(drive * t)


def double_well_gradient(q, t, force, drive):
    return (q[0] * q[0] * q[0] - q[0] - force * xm.sin(drive * t),)


def constant_pull(q, t):
    """V = q: Lane–Emden of index 0."""
    return q[0]


def constant_pull_gradient(q, t):
    return (1.0 + 0 * q[0],)


def square_well(q, t):
    """V = ½ q²: index 1."""
    return q[0] * q[0] / 2


def square_well_gradient(q, t):
    return (q[0],)


def sextic(q, t, sixth):
    """V = q⁶/6: index 5; the sixth is a parameter because it is no binary fraction."""
    cube = q[0] * q[0] * q[0]
    return sixth * cube * cube


def sextic_gradient(q, t, sixth):
    square = q[0] * q[0]
    return (6 * sixth * square * square * q[0],)


# -- γ = 2/t ---------------------------------------------------------------------------------------
def spherical(t, **parameters):
    """γ = 2/t, the divergence of a radius in space."""
    return 2 / t


def spherical_span(t, h, xp, **parameters):
    """∫γ = 2 log(1 + h/t), φ = t h/(t + h)."""
    return 2 * xp.log1p(h / t), t * h / (t + h)


# -- closed forms ----------------------------------------------------------------------------------
def forced_oscillator(scene: Driven, t: Any, mp: Any) -> DrivenState:
    """Steady and transient oscillation, sums of exponentials; s = ½ q p + r, r' = −γ r + ½ F q cos Ωt."""
    m, gamma, force = scene.mass, scene.gamma, scene.parameters["force"]
    square, turn = scene.parameters["omega"] ** 2, mp.mpc(0, scene.parameters["drive"])
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


def lane_emden(index: int) -> Any:
    """The solution that is regular at t = 0, of index 0, 1 or 5; s = ½ q p + r, (t² r)' = t² (½ q^{n+1} − V(q)).

    Only for initial data on it.  Chandrasekhar, An Introduction to the Study of Stellar Structure, §IV.4.
    """

    def integral(t: Any, mp: Any) -> Any:
        """∫ t² (½ q V'(q) − V(q))."""
        if index == 0:
            return -(t**3) / 6 + t**5 / 60
        if index == 1:
            return mp.mpf(0)
        root = mp.sqrt(3)
        u = t / root  # ∫ t² q⁶/3 = √3 ∫ u²/(1 + u²)³ du
        return root * (mp.atan(u) / 8 + u * (u * u - 1) / (8 * (1 + u * u) ** 2))

    def exact(scene: Driven, elapsed: Any, mp: Any) -> DrivenState:
        t = scene.t + elapsed
        if index == 0:
            q, p = 1 - t * t / 6, -t / 3
        elif index == 1:
            q, p = mp.sin(t) / t, (t * mp.cos(t) - mp.sin(t)) / t**2
        else:
            q = (1 + t * t / 3) ** (-mp.mpf(1) / 2)
            p = -t / 3 * q**3
        gained = integral(t, mp) - integral(scene.t, mp)
        rest = scene.t**2 * (scene.s - scene.q[0] * scene.p[0] / 2) + gained
        return DrivenState((q,), (p,), t, q * p / 2 + rest / t**2)

    return exact
