"""Draw random problems: families of scenes with numbers from a seed; CONTRIBUTING.md explains the choice.

The functions of a family take their numbers as parameters, so that one compiled program of a method runs all problems
of the family.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any
from zlib import crc32

import numpy as np
from numpy.random import Generator

from contactbench.numbers import functions as xm
from contactbench.numbers.protocol import Arithmetic, Vector
from contactbench.registry import Registry
from contactbench.runs.features import force_cost
from contactbench.scene import Driven, Mechanical, RigidBody, Scene, Spheres

#: seed of the population and number of problems per family, fixed before its first run (nine until they took too long)
SEED = 20261125
COUNT = 5
#: number of hard problems of each kind
HARD_COUNT = 6
#: ranges of damping over frequency, span in periods, and frequency, uniform in the logarithm
DAMPING, SPAN, FREQUENCY = (1e-5, 10.0), (3.0, 3000.0), (0.1, 10.0)
#: the same ranges for hard problems
HARD_SPAN, HARD_DAMPING = (3.0, 30.0), (10**2.5, 10**3.5)
#: of motions that creep: damping over frequency, span in the slow times γ/ω², number, and the errors of their contest
CREEP_DAMPING, CREEP_SPAN, CREEP_COUNT = (10.0, 100.0), (1.0, 10.0), 50
CREEP_ERRORS = (1e-2, 1e-3, 1e-4, 1e-5)
#: number of distances at which a rise is looked for, and the farthest
DISTANCES, FARTHEST = 400, 10.0
#: energies this close to the barrier, relatively, occur in hard problems only
BESIDE = 0.05
#: largest span in periods times the cost of the force, and largest exponent of the decay of the amplitude
DEAREST, DAMPED_OUT = 6e4, 20.0
#: largest damping times span under an attraction 1/r², so that no motion falls into the centre
FALL = 0.5


# -- potentials ------------------------------------------------------------------------------------
def quartic(q: Vector, w: Arithmetic, a: Arithmetic, b: Arithmetic, c: Arithmetic) -> Arithmetic:
    x = q[0]
    return w * x * x * (a / 2 + x * (b / 3 + x * c / 4))


def sextic(q: Vector, w: Arithmetic, r: Arithmetic, c: Arithmetic, d: Arithmetic) -> Arithmetic:
    x, y = q[0] * q[0], q[1] * q[1]
    return w * ((x + r * y) / 2 + c * (x * x * x + y * y * y) / 6 + d * x * y * (x + y) / 2)


def sunken(q: Vector, depth: Arithmetic, **sextics: Arithmetic) -> Arithmetic:
    return sextic(q, **sextics) - depth


def pendulum(q: Vector, w: Arithmetic, e: Arithmetic) -> Arithmetic:
    return -w * (xm.cos(q[0]) + e * xm.cos(2 * q[0]) / 2)


def cosines(q: Vector, w: Arithmetic, e: Arithmetic) -> Arithmetic:
    return -w * (xm.cos(q[0]) + xm.cos(q[1]) + e * xm.cos(q[0] - q[1]))


def morse(q: Vector, w: Arithmetic) -> Arithmetic:
    rise = 1 - xm.exp(-q[0])
    return w * rise * rise / 2


def lennard_jones(q: Vector, w: Arithmetic) -> Arithmetic:
    inverse = 1 / (q[0] * q[0] + q[1] * q[1])
    sixth = inverse * inverse * inverse
    return w * sixth * (sixth - 2) / 72


def henon_heiles(q: Vector, w: Arithmetic, r: Arithmetic, b: Arithmetic) -> Arithmetic:
    x, y = q
    return w * ((x * x + r * y * y) / 2 + x * x * y - b * y * y * y / 3)


def power_law(q: Vector, w: Arithmetic, half: Arithmetic) -> Arithmetic:
    return w * (q[0] * q[0] + q[1] * q[1]) ** half / (2 * half)


def kepler(q: Vector, w: Arithmetic) -> Arithmetic:
    return -w / xm.sqrt(q[0] * q[0] + q[1] * q[1])


def stretches(q: Vector) -> list[Arithmetic]:
    return [b - a for a, b in zip((0.0, *q), (*q, 0.0), strict=True)]


def toda(q: Vector, w: Arithmetic) -> Arithmetic:
    return w * sum(xm.exp(d) - d for d in stretches(q))


def fput(q: Vector, w: Arithmetic, a: Arithmetic, b: Arithmetic) -> Arithmetic:
    return w * sum(d * d * (0.5 + d * (a / 3 + d * b / 4)) for d in stretches(q))


def pushed(
    q: Vector, t: Arithmetic, w: Arithmetic, a: Arithmetic, c: Arithmetic, **drive: Arithmetic
) -> Arithmetic:
    x = q[0]
    push = drive["push"] * xm.cos(drive["turn"] * t + drive["phase"])
    return w * x * (x * (a / 2 + c * x * x / 4) - push)


def weight(q: Vector, w: Arithmetic, e: Arithmetic) -> Arithmetic:
    return w * (q[2] + e * q[0] * q[0] / 2)


def sines(q: Vector, w: Arithmetic, **waves: Arithmetic) -> Arithmetic:
    """A round well under waves of golden directions, of amplitude wave0, wave1, … and phase phase0, phase1, …"""
    total = (q[0] * q[0] + q[1] * q[1]) / 2
    for k in range(len(waves) // 2):
        length, angle = 1 + 0.1 * k, 2.399963 * k
        along = length * (math.cos(angle) * q[0] + math.sin(angle) * q[1])
        total = total + waves[f"wave{k}"] * xm.cos(along + waves[f"phase{k}"])
    return w * total


# -- how their numbers are drawn -------------------------------------------------------------------
# `w` is the square of the small frequency ω.  `extreme`, of hard problems, stands for the energy, in parts of the
# barrier, of the exponent or of the eccentricity; else it is drawn.
def log_uniform(rng: Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def energy_part(rng: Generator, low: float, high: float, extreme: float | None) -> float:
    """Return an energy in parts of the barrier, not next to it unless it is given."""
    while extreme is None:
        part = log_uniform(rng, low, high)
        extreme = None if abs(part - 1) < BESIDE else part
    return extreme


def thrown(
    rng: Generator, potential: Callable[..., Arithmetic], energy: float, q: Vector, **parameters: float
) -> Mechanical:
    """Return a point that starts at the bottom q of a well with an energy above it, in a direction by chance."""
    direction = rng.standard_normal(len(q))
    p = tuple((math.sqrt(2 * energy) * direction / np.linalg.norm(direction)).tolist())
    return Mechanical(name="drawn", potential=potential, q=q, p=p, t_end=1.0, parameters=parameters)


def draw_quartic(rng: Generator, w: float, extreme: float | None) -> Scene:
    c = log_uniform(rng, 0.1, 3.0)
    part = energy_part(rng, 0.03, 5.0, extreme)
    if extreme is None and rng.random() < 0.5:  # one well; the energy at which x⁴ is as large as x²
        return thrown(
            rng, quartic, w * part / c, (0.0,), w=w, a=1.0, b=rng.uniform(-0.5, 0.5) * math.sqrt(c), c=c
        )
    return thrown(rng, quartic, w / 2 * part / (4 * c), (1 / math.sqrt(c),), w=w / 2, a=-1.0, b=0.0, c=c)


def draw_sextic(rng: Generator, w: float, extreme: float | None) -> Mechanical:
    c, r = log_uniform(rng, 0.1, 3.0), log_uniform(rng, 1.0, 9.0)
    energy = w * log_uniform(rng, 0.03, 5.0) * math.sqrt(3 / c) / 2
    return thrown(rng, sextic, energy, (0.0, 0.0), w=w, r=r, c=c, d=c * rng.random())


def draw_pendulum(rng: Generator, w: float, extreme: float | None) -> Scene:
    e = rng.uniform(0.0, 0.4)
    scale = w / (1 + 2 * e)
    return thrown(rng, pendulum, 2 * scale * energy_part(rng, 0.03, 5.0, extreme), (0.0,), w=scale, e=e)


def draw_cosines(rng: Generator, w: float, extreme: float | None) -> Scene:
    e = rng.uniform(0.0, 1.0)
    return thrown(rng, cosines, w * (2 + 2 * e) * energy_part(rng, 0.03, 5.0, extreme), (0.0, 0.0), w=w, e=e)


def draw_morse(rng: Generator, w: float, extreme: float | None) -> Scene:
    return thrown(rng, morse, w / 2 * log_uniform(rng, 0.03, 0.95), (0.0,), w=w)


def draw_lennard_jones(rng: Generator, w: float, extreme: float | None) -> Scene:
    energy = w / 72 * (log_uniform(rng, 0.03, 0.95) if extreme is None else extreme)
    return thrown(rng, lennard_jones, energy, (1.0, 0.0), w=w).with_(rotation_invariant=True)


def draw_henon_heiles(rng: Generator, w: float, extreme: float | None) -> Scene:
    r, b = rng.uniform(1.0, 2.5), rng.uniform(0.3, 1.5)
    barrier = min(r**3 / (6 * b * b), r / 8 + b / 24)  # of the passes at (0, r/b) and at y = −1/2
    part = log_uniform(rng, 0.03, 0.95) if extreme is None else extreme
    return thrown(rng, henon_heiles, w * barrier * part, (0.0, 0.0), w=w, r=r, b=b)


def orbit(potential: Callable[..., Arithmetic], speed: float, **parameters: float) -> Scene:
    q, p = (1.0, 0.0), (0.0, speed)
    given = Mechanical(name="drawn", potential=potential, q=q, p=p, t_end=1.0, parameters=parameters)
    return given.with_(rotation_invariant=True)


def draw_power_law(rng: Generator, w: float, extreme: float | None) -> Scene:
    power = rng.uniform(2.0, 6.0) if extreme is None else extreme
    return orbit(power_law, math.sqrt(w) * rng.uniform(0.3, 1.0), w=w, half=power / 2)


def draw_kepler(rng: Generator, w: float, extreme: float | None) -> Scene:
    e = rng.uniform(0.0, 0.8) if extreme is None else extreme
    mass = w / (1 + e) ** 3  # it starts at r = 1 farthest out, so that half the long axis is 1/(1 + e)
    return orbit(kepler, math.sqrt(mass * (1 - e)), w=mass)


def chain(
    n: int, rng: Generator, potential: Callable[..., Arithmetic], w: float, energy: float, **given: float
) -> Scene:
    """Return a chain between two walls whose slowest mode has the frequency √w, with an energy for each particle."""
    scale = w / (2 * math.sin(math.pi / (2 * (n + 1)))) ** 2
    return thrown(rng, potential, scale * energy * n, (0.0,) * n, w=scale, **given)


def draw_toda(n: int, rng: Generator, w: float, extreme: float | None) -> Scene:
    return chain(n, rng, toda, w, log_uniform(rng, 0.01, 2.0) if extreme is None else extreme)


def draw_fput(n: int, rng: Generator, w: float, extreme: float | None) -> Scene:
    energy, a = log_uniform(rng, 0.01, 2.0), rng.uniform(0.0, 1.0)
    return chain(n, rng, fput, w, energy, a=a, b=a * a + rng.random())


def draw_pushed(rng: Generator, w: float, extreme: float | None) -> Scene:
    one = rng.random() < 0.5
    drive = {
        "push": rng.uniform(0.05, 0.5),
        "turn": math.sqrt(w) * rng.uniform(0.3, 2.0),
        "phase": rng.uniform(0, 6.28),
    }
    numbers = {"w": w, "a": 1.0, "c": rng.random()} if one else {"w": w / 2, "a": -1.0, "c": 1.0}
    start: dict[str, Any] = {"q": (0.0 if one else 1.0,), "p": (math.sqrt(w) * rng.uniform(-0.5, 0.5),)}
    return Driven(name="drawn", potential=pushed, t_end=1.0, parameters=numbers | drive, **start)


def draw_body(anisotropic: bool, rng: Generator, w: float, extreme: float | None) -> Scene:
    """Return a body of three moments that turns ω radians in a unit of time."""
    inertia = np.sort(rng.uniform(0.5, 1.0, 3))
    M = rng.standard_normal(3)
    M *= math.sqrt(w) / np.linalg.norm(M / inertia)
    damping = {"damping": rng.uniform(0.3, 1.7, 3).tolist()} if anisotropic else {"gamma": 1.0}
    return RigidBody(name="drawn", inertia=inertia.tolist(), M=M.tolist(), t_end=1.0, **damping)


def draw_s_damped(rng: Generator, w: float, extreme: float | None) -> Scene:
    """Return a well whose damping has a part that grows with the action, γ s + ½ κ s²; its bottom is below 0."""
    well = draw_sextic(rng, w, extreme)
    depth = sum(p * p for p in well.p) / 2  # without it s falls below 0, and the damping with it, without end
    numbers = {**well.parameters, "depth": depth}
    return well.with_(potential=sunken, parameters=numbers, kappa=w / depth * log_uniform(rng, 1e-8, 1e-1))


def draw_spherical(rng: Generator, w: float, extreme: float | None) -> Scene:
    """Return a point on a sphere under its weight, a little firmer to one side, thrown level from a tilt."""
    tilt, side, e = rng.uniform(0.2, 2.8), rng.uniform(0.0, 2 * math.pi), rng.uniform(0.0, 0.4)
    speed = math.sqrt(w) * math.sin(tilt) * rng.uniform(0.1, 1.5)
    level = (math.cos(side), math.sin(side))
    q = (math.sin(tilt) * level[0], math.sin(tilt) * level[1], -math.cos(tilt))
    p = (-speed * level[1], speed * level[0], 0.0)
    return Spheres(name="drawn", potential=weight, q=q, p=p, t_end=1.0, parameters={"w": w, "e": e})


def draw_sines(count: int, rng: Generator, w: float, extreme: float | None) -> Scene:
    waves = {f"wave{k}": rng.uniform(0.0, 0.3) / count for k in range(count)}
    waves |= {f"phase{k}": rng.uniform(0.0, 2 * math.pi) for k in range(count)}
    return thrown(rng, sines, w * log_uniform(rng, 0.03, 5.0), (0.0, 0.0), w=w, **waves)


# -- families --------------------------------------------------------------------------------------
def slowest(scene: Any, omega: float) -> float:
    """Return the decay rate of the slower part of a damped oscillation, including damping by s near rest."""
    gamma = scene.gamma + math.sqrt(2 * scene.kappa * scene.parameters.get("depth", 0.0))
    return float(gamma / 2 if gamma < 2 * omega else omega * omega / gamma)


@dataclass(frozen=True)
class Family:
    """One structure.  draw : its scene without damping, of random numbers, ω² and what makes it extreme, or None.

    damped : the scene with a damping γ.  rate : how fast it then decays; None where it is driven or falls.  most : γ at
    most, of ω and the span.
    """

    name: str
    draw: Callable[[Generator, float, float | None], Scene]
    damped: Callable[[Any, float], Scene] = lambda scene, gamma: scene.with_(gamma=gamma)
    rate: Callable[[Any, float], float] | None = slowest
    most: Callable[[float, float], float] = lambda omega, span: math.inf


def free(
    name: str, anisotropic: bool, damped: Callable[[Any, float], Scene], rate: Callable[[Any, float], float]
) -> Family:
    return Family(name, partial(draw_body, anisotropic), damped, rate, lambda omega, span: omega)


#: structures; other files may add theirs
FAMILIES = Registry("family", Family)
for family in (
    Family("well-4", draw_quartic),
    Family("well-6", draw_sextic),
    Family("pendulum", draw_pendulum),
    Family("cosine-lattice", draw_cosines),
    Family("morse", draw_morse),
    Family("lennard-jones", draw_lennard_jones),
    Family("henon-heiles", draw_henon_heiles),
    Family("power-law", draw_power_law),
    Family("kepler", draw_kepler, rate=None, most=lambda omega, span: FALL / span),
    *(Family(f"toda-{n}", partial(draw_toda, n)) for n in (2, 5)),
    *(Family(f"fput-{n}", partial(draw_fput, n)) for n in (3, 8)),
    Family("driven-well", draw_pushed, rate=None),
    free(
        "body-isotropic", False, lambda body, gamma: body.with_(gamma=gamma), lambda body, omega: body.gamma
    ),
    free(
        "body-anisotropic",
        True,
        lambda body, gamma: body.with_(damping=[gamma * rate for rate in body.rates]),
        lambda body, omega: min(body.rates),
    ),
    Family("quadratic-damping", draw_s_damped),
    Family("spherical-pendulum", draw_spherical),
    *(Family(f"sines-{n}", partial(draw_sines, n)) for n in (6, 24)),
):
    FAMILIES.add(family)


@dataclass(frozen=True)
class Hard:
    """Define a kind of hard problem: its families, how extreme they are, and whether damping is strong instead.

    span : in periods.  errors : of a contest; blank where only the endings count.  creeps : the motion starts at rest,
    uphill, and the span is in slow times.
    """

    families: tuple[str, ...]
    extreme: Callable[[Generator], float | None] = lambda rng: None
    damping: tuple[float, float] = DAMPING
    span: tuple[float, float] = HARD_SPAN
    count: int = HARD_COUNT
    errors: tuple[float, ...] = ()
    creeps: bool = False


HARD = {
    "near-collision": Hard(("kepler",), lambda rng: 1 - 10 ** -rng.uniform(2.0, 4.0)),
    "separatrix": Hard(
        ("pendulum", "well-4"), lambda rng: 1 + rng.choice((-1, 1)) * 10 ** -rng.uniform(3.0, 9.0)
    ),
    "strong-damping": Hard(("well-4", "cosine-lattice", "toda-5"), damping=HARD_DAMPING),
    "creep": Hard(
        ("well-4", "well-6", "pendulum", "cosine-lattice", "toda-5"),
        damping=CREEP_DAMPING,
        span=CREEP_SPAN,
        count=CREEP_COUNT,
        errors=CREEP_ERRORS,
        creeps=True,
    ),
    "steep-wall": Hard(("power-law",), lambda rng: rng.uniform(20.0, 60.0)),
}


def released(scene: Any) -> Mechanical:
    """Return a thrown point at rest where its energy would take it straight, or halfway to the top if that is lower."""
    p, bottom = np.array(scene.p), np.array(scene.q)
    along, distances = p / np.linalg.norm(p), np.geomspace(1e-3, FARTHEST, DISTANCES)
    rises = np.array([scene.V(tuple(bottom + d * along)) for d in distances]) - scene.V(scene.q)
    reached = rises >= p @ p / 2
    far = distances[np.argmax(reached)] if reached.any() else distances[np.argmax(rises)] / 2
    rest: Mechanical = scene.with_(q=tuple((bottom + far * along).tolist()), p=(0.0,) * len(p), stiff=True)
    return rest


@dataclass(frozen=True)
class Problem:
    """Hold a problem; hard : the kind of a hard one, blank for the population."""

    family: str
    hard: str
    seed: int
    scene: Scene


def draw(seed: int, family: str, number: int, hard: str = "") -> Problem:
    """Return problem number `number` of a family and seed, independent of the other problems drawn."""
    kind, own = HARD.get(hard), FAMILIES[family]
    rng = np.random.default_rng([seed, crc32(f"{family} {hard}".encode()), number])
    omega = log_uniform(rng, *FREQUENCY)
    gamma = omega * log_uniform(rng, *(kind.damping if kind else DAMPING))
    span = log_uniform(rng, *(kind.span if kind else SPAN))
    scene = own.draw(rng, omega**2, kind.extreme(rng) if kind else None)
    t_end = 2 * math.pi / omega * min(span, max(SPAN[0], DEAREST / force_cost(scene)))
    if kind and kind.creeps:
        scene, t_end = released(scene), span * gamma / omega**2
    scene = own.damped(scene, min(gamma, own.most(omega, t_end)))
    if own.rate is not None and not kind:
        t_end = min(t_end, DAMPED_OUT / own.rate(scene, omega))
    named = scene.with_(name=f"{hard or family}-{number}", t_end=t_end)
    return Problem(family, hard, seed, named.recorded())  # once for all methods
