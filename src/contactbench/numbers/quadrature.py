"""Gauss's collocation method of eight stages: integrals whose integrand holds another integral.

With nodes c, weights b and matrix A on [0, 1], ∫₀¹ f ≈ Σ b_j f(c_j) and ∫₀^{c_i} f ≈ Σ a_ij f(c_j).  As a
Runge–Kutta method it has order 16 (Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, §II.7).
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np

from contactbench.numbers.protocol import Arithmetic, Namespace, Numbers, has_digits

STAGES = 8
#: of the coefficients on doubles
DIGITS = 30
#: most halvings of a span; then its integral is accepted
HALVINGS = 12

#: γ(t)
Rate = Callable[[Any], Arithmetic]
#: nodes, weights, matrix
Rule = tuple[list[Arithmetic], list[Arithmetic], list[list[Arithmetic]]]


@cache
def gauss(digits: int, stages: int = STAGES, ends: tuple[Fraction, ...] = ()) -> Rule:
    """Return nodes, weights, and the weights of integrals up to given ends, by default the nodes."""
    import mpmath

    xp = mpmath.MPContext()
    xp.dps = digits + 10
    near, _ = np.polynomial.legendre.leggauss(stages)
    nodes = [(1 + xp.findroot(lambda x: xp.legendre(stages, x), x)) / 2 for x in near.tolist()]
    powers = xp.matrix([[c**k for c in nodes] for k in range(stages)])

    def weights(end: Arithmetic) -> list[Arithmetic]:
        """∫₀^end of the interpolating polynomials: exact on as many powers as there are nodes."""
        return list(xp.lu_solve(powers, xp.matrix([end ** (k + 1) / (k + 1) for k in range(stages)])))

    at = [xp.mpf(end.numerator) / end.denominator for end in ends] or nodes
    return nodes, weights(xp.mpf(1)), [weights(c) for c in at]


@cache
def converted(number: Callable[[Any], Any], *asked: Any) -> Rule:
    """Return the rule in another kind of numbers."""
    nodes, weights, matrix = gauss(*asked)
    return [*map(number, nodes)], [*map(number, weights)], [[*map(number, row)] for row in matrix]


def rule(xp: Namespace, stages: int = STAGES, ends: tuple[Fraction, ...] = ()) -> Rule:
    """Return the rule in the numbers of a namespace."""
    if not has_digits(xp):
        return converted(float, DIGITS, stages, ends)
    return converted(xp.mpf, xp.dps, stages, ends) if isinstance(xp, Numbers) else gauss(xp.dps, stages, ends)


def weigh(weights: list[Arithmetic], values: list[Arithmetic]) -> Arithmetic:
    return sum(w * v for w, v in zip(weights, values, strict=True))


def integrals(rate: Rate, t: Arithmetic, h: Arithmetic, xp: Namespace) -> tuple[Arithmetic, Arithmetic]:
    """Return G = ∫_t^{t+h} γ and φ = ∫_t^{t+h} e^{−∫_t^τ γ} dτ of a rate γ(t), by one step on G' = γ, φ' = e^{−G}."""
    nodes, weights, matrix = rule(xp)
    values = [rate(t + c * h) for c in nodes]
    kept = [xp.exp(-h * weigh(row, values)) for row in matrix]
    return h * weigh(weights, values), h * weigh(weights, kept)


def running(
    rate: Rate, t: Arithmetic, h: Arithmetic, ends: tuple[Fraction, ...], stages: int, xp: Namespace
) -> list[Arithmetic]:
    """Return ∫_t^{t+ch} of a rate for every c of some ends, to an error O(h^{stages + 1})."""
    nodes, _, matrix = rule(xp, stages, ends)
    values = [rate(t + c * h) for c in nodes]
    return [h * weigh(row, values) for row in matrix]


def integral(rate: Rate, t: Arithmetic, h: Arithmetic, xp: Namespace) -> Arithmetic:
    """Return ∫_t^{t+h} γ over a span of any length, on plain numbers or arrays: halved until it no longer changes."""
    nodes, weights, _ = rule(xp)
    before: Any = None
    for k in range(HALVINGS):
        width = h / 2**k
        total: Any = 0 * h
        for j in range(2**k):
            total = total + width * weigh(weights, [rate(t + (j + c) * width) for c in nodes])
        if before is not None and bool(abs(total - before).max() <= 1e-15 * abs(total).max()):
            break
        before = total
    found: Arithmetic = total
    return found
