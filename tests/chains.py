"""Scenes of several bodies for the tests: chains with any boundary, bodies in one to three dimensions."""

from itertools import combinations, pairwise

import numpy as np

import contactbench as cb


def onsite(q):
    return q * q / 4 + cb.math.cos(q)


def bond(r, k):
    return k * r * r / 2 + r * r * r / 8 + r * r * r * r / 16


def chain_potential(boundary, onsite, bond):
    """Return V(q, **parameters) of a chain whose sites are held by `onsite` (or None) and bound by `bond`."""

    def potential(q, **parameters):
        ends = {"ring": (*q, q[0]), "fixed": (0.0, *q, 0.0), "free": q}[boundary]
        total = sum(bond(b - a, **parameters) for a, b in pairwise(ends))
        return total if onsite is None else total + sum(map(onsite, q))

    return potential


def body_potential(pair, masses, dimensions):
    """Return V(q, **parameters), the sum of pair(r², m_a, m_b) over all pairs of bodies."""

    def potential(q, **parameters):
        places = [q[dimensions * k : dimensions * (k + 1)] for k in range(len(masses))]
        total = 0.0
        for (x, a), (y, b) in combinations(zip(places, masses, strict=True), 2):
            total = total + pair(
                sum((c - d) * (c - d) for c, d in zip(x, y, strict=True)), a, b, **parameters
            )
        return total

    return potential


def data(size, seed=1):
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (2, size))


def masses(n, seed=2):
    return tuple(np.random.default_rng(seed).uniform(0.5, 2.0, n).tolist())


def chain(n, boundary="ring", held=True, mass=1.3, bond=bond, **changes):
    """A chain of n sites; held : by a potential at each of them."""
    q, p = map(tuple, data(n).tolist())
    potential = chain_potential(boundary, onsite if held else None, bond)
    given = {"parameters": {"k": 1.5}, "q": q, "p": p, "s": 0.3, "mass": mass, "gamma": 0.2, "t_end": 1.0}
    return cb.Mechanical(name=f"chain-{boundary}", potential=potential, **given | changes)


def softened(r2, a, b, soft):
    return -a * b / cb.math.sqrt(r2 + soft)


def bodies(n, dimensions, pair=softened, **changes):
    q, p = data(n * dimensions)
    own = masses(n)
    given = {"parameters": {"soft": 0.25}, "q": tuple((4 * q).tolist()), "p": tuple(p.tolist()), "s": 0.3}
    given |= {"mass": tuple(np.repeat(own, dimensions).tolist()), "gamma": 0.2, "t_end": 1.0}
    return cb.Mechanical(name="bodies", potential=body_potential(pair, own, dimensions), **given | changes)


def planets(masses, q, p, softening, **given):
    """Bodies of given masses in a plane."""
    more = {"gamma": 0.0, "parameters": {"soft": softening**2}, "mass": tuple(np.repeat(masses, 2))} | given
    return cb.Mechanical(name="planets", potential=body_potential(softened, masses, 2), q=q, p=p, **more)


#: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, §II.10: mass times velocity for p
PLEIADES = planets(
    np.arange(1.0, 8.0),
    (3.0, 3.0, 3.0, -3.0, -1.0, 2.0, -3.0, 0.0, 2.0, 0.0, -2.0, -4.0, 2.0, 4.0),
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -5.0, 0.0, 5.0, 10.5, 0.0, -10.5, 0.0),
    0.0,
    t_end=3.0,
)
