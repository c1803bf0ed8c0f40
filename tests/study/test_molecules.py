"""A race of every method on molecules of many kinds ends in its time, with winners, or reasons where there are none."""

from itertools import pairwise
from time import perf_counter

import numpy as np
import pytest

import contactbench as cb

#: of the budget, what a race may take
LATE = 1.1
#: seconds of the quick part
SHORT = 10.0
#: where the Lennard-Jones and the Buckingham pair rest
LJ_REST, BUCKINGHAM_REST = 2 ** (1 / 6), 1.0


def morse(r):
    return (1 - cb.math.exp(-r)) ** 2


def steep_morse(r):
    return 5 * (1 - cb.math.exp(-3 * r)) ** 2


def lennard_jones(r2):
    return 4 * (r2**-6 - r2**-3)


def buckingham(r2):
    r = cb.math.sqrt(r2)
    return 2e4 * cb.math.exp(-10 * r) - 1 / (r2 * r2 * r2)


def data(size, seed, stretch, heat):
    """Displacements and momenta at random."""
    q, p = np.random.default_rng(seed).standard_normal((2, size))
    return stretch * q, heat * p


def lattice(n, bond, seed, stretch, heat, boundary="free", t_end=30.0):
    q, p = data(n, seed, stretch, heat)
    return cb.Lattice(name="chain", n=n, boundary=boundary, bond=bond, q=q, p=p, gamma=0.1, t_end=t_end)


def bodies(n, dimensions, pair, rest, seed, stretch, heat, t_end=10.0):
    """Bodies at the points of a grid, `rest` apart."""
    side = np.arange(np.ceil(n ** (1 / dimensions)))
    grid = np.stack(np.meshgrid(*[side] * dimensions, indexing="ij"), axis=-1).reshape(-1, dimensions)[:n]
    q, p = data(grid.size, seed, stretch, heat)
    masses = np.linspace(1.0, 2.0, n)
    pairs = {"pair": lambda r2, a, b: pair(r2), "masses": masses, "dimensions": dimensions}
    return cb.Particles(name="bodies", q=rest * grid.ravel() + q, p=p, gamma=0.05, t_end=t_end, **pairs)


def mechanical(n, pair, rest, seed, stretch, heat, t_end=30.0):
    """n atoms on a line, neighbours bound to each other: pair(r) at the distance r."""
    q, p = data(n, seed, stretch, heat)
    potential = lambda q: sum(pair(b - a) for a, b in pairwise(q))  # noqa: E731
    q = tuple((rest * np.arange(n) + q).tolist())
    return cb.Mechanical(name="line", potential=potential, q=q, p=tuple(p.tolist()), gamma=0.1, t_end=t_end)


#: a molecule, and its budget in seconds
MOLECULES = {
    "Morse, lattice, 20 sites": (lambda: lattice(20, morse, 0, 0.3, 0.3), 60.0),
    "Morse, lattice, 20 sites, hot": (lambda: lattice(20, morse, 1, 0.0, 2.0), 30.0),
    "Morse, steep, ring of 12": (lambda: lattice(12, steep_morse, 2, 0.2, 0.5, "ring"), 30.0),
    "Morse, three bonds": (lambda: mechanical(4, lambda r: morse(r - 1), 1.0, 0, 1.0, 1.0), 40.0),
    "Morse, pair in space": (
        lambda: bodies(2, 3, lambda r2: morse(cb.math.sqrt(r2) - 1), 1.0, 4, 0.1, 0.3),
        20.0,
    ),
    "Lennard-Jones, chain of 8": (
        lambda: mechanical(8, lambda r: lennard_jones(r * r), LJ_REST, 5, 0.03, 0.3, 20.0),
        40.0,
    ),
    "Lennard-Jones, 7 bodies in a plane": (lambda: bodies(7, 2, lennard_jones, LJ_REST, 6, 0.02, 0.3), 40.0),
    "Lennard-Jones, 20 bodies in space": (lambda: bodies(20, 3, lennard_jones, LJ_REST, 7, 0.02, 0.1), 60.0),
    "Buckingham, lattice of 16, fixed": (
        lambda: lattice(16, lambda r: buckingham((1.2 + r) ** 2), 8, 0.03, 0.1, "fixed", 10.0),
        30.0,
    ),
    "Buckingham, two atoms that part": (
        lambda: mechanical(2, lambda r: buckingham(r * r), BUCKINGHAM_REST, 9, 0.0, 1.0),
        20.0,
    ),
}


def race(scene, budget):
    """Return how long a race took, and its frame, or why there is none."""
    begun = perf_counter()
    try:
        outcome = cb.compare(scene, budget=budget)
    except cb.BadInput as why:
        outcome = str(why)
    return perf_counter() - begun, outcome


def unexplained(outcome):
    """Return what of a race has neither a verdict nor, for every method, one line that says why not."""
    if isinstance(outcome, str):
        return [outcome] if "\n" in outcome else []
    return [
        key
        for key, part in outcome.groupby(["kind", "error_asked"])
        if not (part["verdict"].isin(["win", "tie", "undecided"]).any() or part["reason"].ne("").all())
    ]


@pytest.mark.quick(name="Morse, three bonds")
@pytest.mark.parametrize("name", MOLECULES)
def test_a_race_of_a_molecule_ends_in_its_time(name, request):
    make, budget = MOLECULES[name]
    if request.config.option.markexpr == "not slow":
        budget = SHORT
    seconds, outcome = race(make(), budget)
    assert seconds < LATE * budget
    assert not unexplained(outcome)
