"""Scenes of many sites for the tests: chains with any boundary, bodies in one to three dimensions."""

import numpy as np

import contactbench as cb


def onsite(q):
    return q * q / 4 + cb.math.cos(q)


def bond(r, k):
    return k * r * r / 2 + r * r * r / 8 + r * r * r * r / 16


def data(size, seed=1):
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (2, size))


def masses(n, seed=2):
    return np.random.default_rng(seed).uniform(0.5, 2.0, n)


def chain(n, boundary="ring", held=True, mass=1.3, **changes):
    """A chain of n sites; held : by a potential at each of them."""
    q, p = data(n)
    given = {"onsite": onsite if held else None, "bond": bond, "parameters": {"k": 1.5}}
    given |= {"q": q, "p": p, "s": 0.3, "mass": mass, "gamma": 0.2, "t_end": 1.0}
    return cb.Lattice(name="chain", n=n, boundary=boundary, **given | changes)


def bodies(n, dimensions, **changes):
    q, p = data(n * dimensions)
    given = {"pair": lambda r2, a, b, soft: -a * b / cb.math.sqrt(r2 + soft), "parameters": {"soft": 0.25}}
    given |= {"q": 4 * q, "p": p, "s": 0.3, "masses": masses(n), "gamma": 0.2, "t_end": 1.0}
    return cb.Particles(name="bodies", dimensions=dimensions, **given | changes)


BOUNDARIES = ("ring", "fixed", "free")
#: few sites, every boundary, masses that are equal or not, every dimension
SMALL = {
    **{f"{b} held": chain(8, b) for b in BOUNDARIES},
    **{f"{b} masses": chain(8, b, held=False, mass=masses(8)) for b in BOUNDARIES},
    "no bonds": chain(8, bond=None, parameters={}),
    **{f"bodies {d}D": bodies(4, d) for d in (1, 2, 3)},
}
