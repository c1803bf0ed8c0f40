"""Derived gradients need hardly more operations than those written by hand; derivatives are right to round-off."""

import mpmath
import numpy as np
import pytest

import contactbench as cb
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


#: functions of two numbers whose gradient nobody writes by hand
OTHERS = {
    "ratio of a square": lambda q: q[0] * q[0] / (q[0] * q[0]) * q[0],
    "ratio of powers": lambda q: q[0] * q[0] / (q[0] ** 3 + 1) + 3 / (q[1] * q[1]),
    "broken powers": lambda q: q[0] ** -3.5 * q[1] ** 2.3 + 0.1 * q[1] ** -0.3,
    "powers of powers": lambda q: q[0] ** 2.3 + q[1] ** -1.5 + q[0] ** q[1],
    "a number to a power": lambda q: 2.0 ** q[0],  # whose derivative has log 2, a double
    "powers of sums": lambda q: q[0] ** 0.1 * 0.2 + (q[0] * q[0] + 0.3) ** 1.7 / 1.1,
    "choice": lambda q: where(q[0] > 1, q[0] ** 3 * q[1], q[1] / q[0]) * q[1],
    "choice, of quotients": lambda q: where(q[0] > 1, q[0] / 3, q[0] / 7) * 0.1,
    "nested": lambda q: exp(-2 * (1 - q[0] * q[1]) ** 2) * (1 - q[0] * q[1]) - 1 / sqrt(q[0] + q[1] * q[1]),
    "differences": lambda q: (q[0] - q[1]) ** 4 * (2 * q[0] - 3 * q[1]) ** 2 / 7 - (q[0] - q[1]) ** 2,
    "polynomial": lambda q: q[0] ** 4 / 4 - 3 * q[0] * q[1] ** 2 + q[1] / 7 - (q[0] - q[1]) ** 3,
    "roots and quotients": lambda q: -1 / sqrt(q[0] ** 2 + q[1] ** 2) + q[0] / (2 + q[1] ** 2),
    "quotient in an exponent": lambda q: exp(-(((q[0] - 3) / 3) ** 2)) / 7,
    "products": lambda q: 0.1 * (0.1 * q[0] ** 3) * 0.3 + q[0] * 0.7 / 0.9,
    "functions of quotients": lambda q: sin(q[0] / 3) * log(q[0] / 7) / 0.3 + 1 / (q[0] * 0.1) ** 3,
    "exponential": lambda q: (1 - exp(-(q[0] - 0.3))) ** 2 + log(2 + q[1]) * q[0],
    "circular": lambda q: sin(q[0]) * cos(q[1]) + cb.math.tan(q[0] / 3),
    "arcus": lambda q: cb.math.asin(q[0] / 3) + cb.math.acos(q[1] / 3) + cb.math.atan(q[0] * q[1]),
    "angle": lambda q: cb.math.atan2(q[1], q[0]),
    "hyperbolic": lambda q: cb.math.tanh(q[0]) * cb.math.sinh(q[1]) + cb.math.cosh(q[0]),
    "area": lambda q: cb.math.asinh(q[1]) + cb.math.acosh(2 + q[0]) + cb.math.atanh(q[1] / 4),
    "small arguments": lambda q: cb.math.expm1(q[0] - q[1]) * q[1] + cb.math.log1p(q[0] * q[1]),
    "absolute": lambda q: abs(q[0] - q[1]) ** 3 + np.hypot(q[0], q[1]),
    "NumPy": lambda q: np.sin(q[0]) + np.float64(2) * np.exp(q[1]) + np.maximum(q[0], q[1]) ** 2,
    "constant": lambda q: 3.0,
    "one of them": lambda q: q[1],
}


@pytest.mark.parametrize("name", [*POTENTIALS, *OTHERS])
def test_derivatives_are_those_of_the_function(name):
    """At 60 digits, by differences: 1/3, and 0.1 × 0.1 as two floats, are rounded for doubles alone; and in doubles."""
    function, _, n = POTENTIALS[name] if name in POTENTIALS else (OTHERS[name], None, 2)
    value, off = as_formula(function, (n,)), 1e-15 if name == "a number to a power" else 1e-35
    gradient = value.gradient()
    hessian = gradient.hessian()
    for q in np.random.default_rng(5).uniform(0.5, 2.0, (5, n)).tolist():
        with mpmath.workdps(60):
            x, h = tuple(map(mpmath.mpf, q)), mpmath.mpf(10) ** -20
            slope, rows = gradient(x), hessian(x)
            for i in range(n):
                ends = [tuple(c + d * (i == j) for j, c in enumerate(x)) for d in (h, -h)]
                pairs = [(slope[i], [*map(value, ends)])]
                pairs += [(rows[j][i], [gradient(end)[j] for end in ends]) for j in range(n)]
                for found, (ahead, behind) in pairs:
                    assert abs(found - (ahead - behind) / (2 * h)) < off * (1 + abs(found))
            exact, bends = [*map(float, slope)], [*map(float, np.ravel(rows))]
        # roundings of the terms of a sum that cancel
        assert gradient(q) == pytest.approx(exact, rel=1e-14, abs=1e-14 * max(map(abs, exact)))
        assert np.ravel(hessian(q)) == pytest.approx(bends, rel=1e-13, abs=1e-13 * max(1.0, *map(abs, bends)))
