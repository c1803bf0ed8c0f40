"""Scenes for properties that no registered scene has: γ(t) of all kinds, what fades beyond the numbers."""

import contactbench as cb
from contactbench.numbers import functions as xm
from contactbench.scene import DrivenState
from contactbench.scenes.driven import FORCED_OSCILLATOR, spherical, spherical_span


# -- γ(t) without a closed form of its integral, and one that changes its sign -------------------------------
def pulsating(t, friction, depth, pulse, **parameters):
    """γ = γ₀ (1 + a sin νt); φ is no elementary function."""
    return friction * (1 + depth * xm.sin(pulse * t))


FORCED_PULSATING = cb.Driven(
    name="forced_pulsating",
    potential=lambda q, t, omega, force, drive, **damping: (
        omega * omega * q[0] * q[0] / 2 - force * q[0] * xm.cos(drive * t)
    ),
    gradient=lambda q, t, omega, force, drive, **damping: (omega * omega * q[0] - force * xm.cos(drive * t),),
    rate=pulsating,
    q=(1.0,),
    p=(0.0,),
    t_end=20.0,
    parameters={**FORCED_OSCILLATOR.parameters, "friction": 0.1, "depth": 1.5, "pulse": 1.3},
)


#: without parameters, a force and a damping that depend on time
PULSATING = cb.Driven(
    name="pulsating",
    potential=lambda q, t: q[0] ** 2 / 2 - 0.3 * q[0] * cb.math.sin(0.7 * t),
    rate=lambda t: 0.1 * (1 + 1.5 * cb.math.sin(1.3 * t)),
    q=(1.0,),
    p=(0.0,),
    t_end=20.0,
)


# -- Lane–Emden of index 1, in closed form, and a problem whose end is printed ----------------------------------
def spreading_wave(scene, t, mp):
    """Return u/t, u'' = −u, the motion under γ = 2/t; s − ½ q p falls as 1/t², the potential being quadratic."""
    t0, now = scene.t, scene.t + t
    u0, w0 = t0 * scene.q[0], t0 * scene.p[0] + scene.q[0]
    sin, cos = xm.sin(t), xm.cos(t)
    u, w = u0 * cos + w0 * sin, w0 * cos - u0 * sin
    q, p = u / now, (w - u / now) / now
    rest = (t0 / now) ** 2 * (scene.s - scene.q[0] * scene.p[0] / 2)
    return DrivenState((q,), (p,), now, q * p / 2 + rest)


LANE_EMDEN_1 = cb.Driven(
    name="lane_emden_1",
    potential=lambda q, t: q[0] * q[0] / 2,
    gradient=lambda q, t: (q[0],),
    rate=spherical,
    span=spherical_span,
    exact=spreading_wave,
    q=(0.8414709848078965,),
    p=(-0.30116867893975674,),
    t=1.0,
    t_end=20.0,
)


#: problem E3 of DETEST: Hull, Enright, Fellen, Sedgwick, SIAM J. Numer. Anal. 9, 603 (1972), doi:10.1137/0709052
DETEST_E3 = cb.Driven(
    name="detest_e3",
    potential=lambda q, t, softness, force, drive: (
        q[0] * q[0] / 2 - q[0] ** 4 / (4 * softness) - force * q[0] * xm.sin(drive * t)
    ),
    gradient=lambda q, t, softness, force, drive: (
        q[0] - q[0] * q[0] * q[0] / softness - force * xm.sin(drive * t),
    ),
    parameters={"softness": 6.0, "force": 2.0, "drive": 2.78535},
    q=(0.0,),
    p=(0.0,),
    t_end=20.0,
)


# -- a pole that is passed closely, and numbers that underflow ------
#: 4° from the upright pole, slowly turning: it swings back up to near the pole time and again
UPRIGHT_PENDULUM = cb.SCENES["spherical_pendulum"].with_(
    name="upright_pendulum", gamma=1e-3, q=(0.07584, 0.0, 0.99712), p=(0.0, 0.1, 0.0), t_end=50.0
)

#: e^{−γT} = e^{−1000}: momentum and energy fall below the smallest number there is, the attitude stays of size one
UNDERFLOW = cb.SCENES["rigid_body"].with_(name="underflow", gamma=5.0, t_end=200.0)

#: those with time in them
TIMED = (FORCED_PULSATING, LANE_EMDEN_1, DETEST_E3)


def scene_of(name):
    """Return a scene by its name, one of these or a registered one."""
    own = {scene.name: scene for scene in TIMED}
    return own.get(name) or cb.SCENES[name]
