"""Derived gradients need hardly more operations than those written by hand, and are right to round-off."""

import mpmath
import numpy as np
import pytest

from contactbench.numbers.functions import cos, exp, log, sin, sqrt, where
from contactbench.scene.base import as_formula


def radius(q):
    return sqrt(q[0] * q[0] + q[1] * q[1])


def pulled(q, by):
    return tuple(by * c for c in q)


def ring(q):
    a, b = q[0] * (1 + q[0] * q[0]), q[1] * (1 + q[1] * q[1])
    r = q[1] - q[0]
    pull = r * (1 + r * r)
    return a - pull, b + pull


def inverse_cube(r):
    return 1 / (r * r * r)


def sixth(q):
    over = 1 / (q[0] * q[0])
    return over * over * over


def lennard_jones(q):
    return ((6 - 12 * sixth(q)) * sixth(q) / q[0],)


#: name → potential, its gradient by hand, number of coordinates
POTENTIALS = {
    "double well": (lambda q: (q[0] ** 2 - 1) ** 2 / 4, lambda q: (q[0] * (q[0] * q[0] - 1),), 1),
    "double well, expanded": (
        lambda q: q[0] ** 4 / 4 - q[0] ** 2 / 2,
        lambda q: (q[0] * (q[0] * q[0] - 1),),
        1,
    ),
    "harmonic": (lambda q: 2.5 * q[0] * q[0] / 2, lambda q: (2.5 * q[0],), 1),
    "pendulum": (lambda q: -cos(q[0]), lambda q: (sin(q[0]),), 1),
    "Kepler": (lambda q: -1 / radius(q), lambda q: pulled(q, inverse_cube(radius(q))), 2),
    "Hénon–Heiles": (
        lambda q: (q[0] * q[0] + q[1] * q[1]) / 2 + q[0] * q[0] * q[1] - q[1] ** 3 / 3,
        lambda q: (q[0] * (1 + 2 * q[1]), q[1] + q[0] * q[0] - q[1] * q[1]),
        2,
    ),
    "Morse": (lambda q: (1 - exp(-q[0])) ** 2, lambda q: (2 * exp(-q[0]) * (1 - exp(-q[0])),), 1),
    "quartic": (
        lambda q: (q[0] ** 2 + q[1] ** 2) / 2 + (q[0] ** 2 + q[1] ** 2) ** 2 / 10,
        lambda q: pulled(q, 1 + 0.4 * (q[0] * q[0] + q[1] * q[1])),
        2,
    ),
    "Lennard-Jones": (lambda q: sixth(q) * sixth(q) - sixth(q), lennard_jones, 1),
    "ring": (
        lambda q: sum(r**2 / 2 + r**4 / 4 for r in (q[0], q[1], q[1] - q[0])),
        ring,
        2,
    ),
    "logarithm": (lambda q: log(1 + q[0] * q[0]), lambda q: (2 * q[0] / (1 + q[0] * q[0]),), 1),
}


@pytest.mark.parametrize("name", POTENTIALS)
def test_a_derived_gradient_takes_hardly_more_operations_than_one_by_hand(name):
    potential, gradient, n = POTENTIALS[name]
    derived, by_hand = as_formula(potential, (n,)).gradient(), as_formula(gradient, (n,))
    assert len(derived.body) <= max(1.2 * len(by_hand.body), len(by_hand.body) + 1)


#: potentials whose gradient nobody writes by hand
OTHERS = {
    "ratio of a square": lambda q: q[0] * q[0] / (q[0] * q[0]) * q[0],
    "ratio of powers": lambda q: q[0] * q[0] / (q[0] ** 3 + 1) + 3 / (q[1] * q[1]),
    "powers": lambda q: q[0] ** -3.5 * q[1] ** 2.3 + 0.1 * q[1] ** -0.3,
    "choice": lambda q: where(q[0] > 1, q[0] ** 3 * q[1], q[1] / q[0]) * q[1],
    "nested": lambda q: exp(-2 * (1 - q[0] * q[1]) ** 2) * (1 - q[0] * q[1]) - 1 / sqrt(q[0] + q[1] * q[1]),
    "differences": lambda q: (q[0] - q[1]) ** 4 * (2 * q[0] - 3 * q[1]) ** 2 / 7 - (q[0] - q[1]) ** 2,
}


@pytest.mark.parametrize("name", [*POTENTIALS, *OTHERS])
def test_a_derived_gradient_is_right_to_round_off(name):
    potential, _, n = POTENTIALS[name] if name in POTENTIALS else (OTHERS[name], None, 2)
    derived = as_formula(potential, (n,)).gradient()
    for q in np.random.default_rng(5).uniform(0.5, 2.0, (20, n)).tolist():
        with mpmath.workdps(60):
            exact = [
                float(mpmath.diff(lambda *q: potential(q), tuple(map(mpmath.mpf, q)), order))
                for order in np.eye(n, dtype=int).tolist()
            ]
        # roundings of the terms of a sum that cancel
        assert derived(q) == pytest.approx(exact, rel=1e-14, abs=1e-14 * max(map(abs, exact)))
