"""A race of every method on molecules of many kinds has winners, or reasons where there are none."""

from itertools import pairwise

import numpy as np
import pytest

import contactbench as cb

#: seconds of the quick part
SHORT = 3.0
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


def atoms(n, pair, rest, seed, stretch, heat, t_end=30.0):
    """n atoms on a line, neighbours bound to each other: pair(r) at the distance r; displaced and hot at random."""
    q, p = np.random.default_rng(seed).standard_normal((2, n))
    potential = lambda q: sum(pair(b - a) for a, b in pairwise(q))  # noqa: E731
    start = {"q": rest * np.arange(n) + stretch * q, "p": heat * p}
    return cb.Mechanical(name="line", potential=potential, gamma=0.1, t_end=t_end, **start)


#: a molecule, and its budget in seconds
MOLECULES = {
    "Morse, 20 atoms": (lambda: atoms(20, lambda r: morse(r - 1), 1.0, 0, 0.3, 0.3), 60.0),
    "Morse, steep, 12 atoms, hot": (lambda: atoms(12, lambda r: steep_morse(r - 1), 1.0, 2, 0.2, 2.0), 30.0),
    "Morse, three bonds": (lambda: atoms(4, lambda r: morse(r - 1), 1.0, 0, 1.0, 1.0), 40.0),
    "Lennard-Jones, 8 atoms": (
        lambda: atoms(8, lambda r: lennard_jones(r * r), LJ_REST, 5, 0.03, 0.3, 20.0),
        40.0,
    ),
    "Buckingham, two atoms that part": (
        lambda: atoms(2, lambda r: buckingham(r * r), BUCKINGHAM_REST, 9, 0.0, 1.0),
        20.0,
    ),
}


def race(scene, budget):
    """Return the frame of a race, or why there is none."""
    try:
        return cb.compare(scene, budget=budget)
    except cb.BadInput as why:
        return str(why)


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
def test_a_race_of_a_molecule_names_winners_or_reasons(name, request):
    make, budget = MOLECULES[name]
    if request.config.option.markexpr.startswith("not slow"):
        budget = SHORT
    assert not unexplained(race(make(), budget))
