"""Chains, rings and bodies: scenes of as many degrees of freedom as one likes."""

from __future__ import annotations

import numpy as np

from contactbench.numbers import functions as math
from contactbench.numbers.protocol import Arithmetic, Namespace
from contactbench.scene import State
from contactbench.scene.many import Lattice, Particles


def quartic_bond(r: Arithmetic, beta: Arithmetic) -> Arithmetic:
    """W = ½ r² + ¼ β r⁴: Fermi, Pasta, Ulam, Tsingou's β-chain."""
    square = r * r  # of the forms of W, the one whose derivative is shortest: half the time of r * r * r * r
    return square * (0.5 + beta / 4 * square)


def linear_bond(r: Arithmetic) -> Arithmetic:
    """W = ½ r²."""
    return r * r / 2


def toda_bond(r: Arithmetic) -> Arithmetic:
    """W = e^{−r} + r − 1 (Toda, J. Phys. Soc. Jpn. 22, 431 (1967), doi:10.1143/JPSJ.22.431)."""
    return math.exp(-r) + r - 1


def pendulum(q: Arithmetic, spacing: Arithmetic) -> Arithmetic:
    """U = (1 − cos q) a of sites at a distance a; with bonds r²/2a it is the sine-Gordon equation."""
    return (1 - math.cos(q)) * spacing


def spring(r: Arithmetic, spacing: Arithmetic) -> Arithmetic:
    return r * r / (2 * spacing)


def gravity(r2: Arithmetic, a: Arithmetic, b: Arithmetic, G: Arithmetic) -> Arithmetic:
    """V = −G a b/r."""
    return -G * a * b / math.sqrt(r2)


def kink(i: Arithmetic, n: int) -> Arithmetic:
    """A kink of the continuous equation at a third of the chain, of velocity `SPEED`."""
    return 4 * math.atan(math.exp(place(i, n)))


def moving_kink(i: Arithmetic, n: int) -> Arithmetic:
    """Its momenta, mass times velocity."""
    return -SPACING * SPEED * 2 / math.sqrt(1 - SPEED**2) / math.cosh(place(i, n))


#: of the kink's velocity and of its sites
SPEED, SPACING = 0.5, 0.25


def place(i: Arithmetic, n: int) -> Arithmetic:
    """Return the distance from the kink in its own width."""
    return (i - n / 3) * SPACING / math.sqrt(1 - SPEED**2)


def long_wave(i: Arithmetic, n: int) -> Arithmetic:
    return math.sin(2 * math.pi * i / n)


def two_waves(i: Arithmetic, n: int) -> Arithmetic:
    return 0.3 + 0.5 * math.cos(4 * math.pi * i / n)


def normal_modes(scene: Lattice, t: float, xp: Namespace) -> State:
    """A ring of springs, mode by mode: damped oscillators of ω_k = 2 √(1/m) |sin(πk/n)|.

    s = ½ q·p + e^{−γt} (s0 − ½ q0·p0), as for one oscillator: V is quadratic.
    """
    m, gamma, n = scene.mass, scene.gamma, scene.n
    square = 4 * np.sin(np.pi * np.arange(n) / n) ** 2 / m
    q0, v0 = np.fft.fft(scene.q), np.fft.fft(scene.p) / m
    root = np.sqrt(square - gamma**2 / 4 + 0j)
    still = root == 0
    decay, cos = np.exp(-gamma * t / 2), np.cos(root * t)
    sinc = np.where(still, t, np.sin(root * t) / np.where(still, 1, root))
    q = decay * (q0 * cos + (v0 + gamma * q0 / 2) * sinc)
    v = decay * (v0 * cos - (square * q0 + gamma * v0 / 2) * sinc)
    v[0] = v0[0] * np.exp(-gamma * t)
    q[0] = q0[0] + v0[0] * (-np.expm1(-gamma * t) / gamma if gamma else t)
    q, p = np.fft.ifft(q).real, m * np.fft.ifft(v).real
    s = q @ p / 2 + np.exp(-gamma * t) * (scene.s - scene.q @ scene.p / 2)
    return State((q,), (p,), s)


#: masses, positions (astronomical units) and velocities (per day): the Sun, Jupiter, Saturn, Uranus, Neptune, Pluto
#: (Hairer, Lubich, Wanner, Geometric Numerical Integration, §I.2.4, table 2.2)
OUTER = np.array(
    [
        [1.00000597682, 0, 0, 0, 0, 0, 0],
        [0.000954786104043, -3.5023653, -3.8169847, -1.5507963, 0.00565429, -0.00412490, -0.00190589],
        [0.000285583733151, 9.0755314, -3.0458353, -1.6483708, 0.00168318, 0.00483525, 0.00192462],
        [0.0000437273164546, 8.3101420, -16.2901086, -7.2521278, 0.00354178, 0.00137102, 0.00055029],
        [0.0000517759138449, 11.4707666, -25.7294829, -10.8169456, 0.00288930, 0.00114527, 0.00039677],
        [1 / 1.3e8, -15.5387357, -25.2225594, -3.1902382, 0.00276725, -0.00170702, -0.00136504],
    ]
)

LINEAR_RING = Lattice(
    name="linear_ring",
    about="a ring of springs: known in closed form, mode by mode",
    experiments=("scaling",),
    n=64,
    bond=linear_bond,
    gamma=0.01,
    q=long_wave,
    p=two_waves,
    t_end=20.0,
    exact=normal_modes,
)
FPUT = Lattice(
    name="fput",
    about="the β-ring of Fermi, Pasta, Ulam and Tsingou, weakly damped",
    experiments=("scaling",),
    n=64,
    bond=quartic_bond,
    parameters={"beta": 0.25},
    gamma=1e-3,
    q=long_wave,
    p=two_waves,
    t_end=20.0,
)
SINE_GORDON = Lattice(
    name="sine_gordon",
    about="a kink of the sine-Gordon equation that slows down",
    experiments=("scaling",),
    n=64,
    boundary="free",
    onsite=pendulum,
    bond=spring,
    parameters={"spacing": 0.25},
    mass=0.25,
    gamma=0.05,
    q=kink,
    p=moving_kink,
    t_end=20.0,
)
TODA = Lattice(
    name="toda",
    about="Toda's ring with damping: exponential bonds",
    experiments=("scaling",),
    n=32,
    bond=toda_bond,
    gamma=0.01,
    q=long_wave,
    p=two_waves,
    t_end=20.0,
)
PLANETS = Particles(
    name="planets",
    about="the outer planets and the Sun, with a weak drag; days, astronomical units, solar masses",
    experiments=("scaling",),
    masses=OUTER[:, 0],
    pair=gravity,
    parameters={"G": 2.95912208286e-4},
    gamma=1e-6,
    q=OUTER[:, 1:4],
    p=OUTER[:, :1] * OUTER[:, 4:],
    t_end=5000.0,
)
MANY = (LINEAR_RING, FPUT, SINE_GORDON, TODA, PLANETS)
