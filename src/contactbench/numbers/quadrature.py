"""Gauss's collocation method of eight stages: integrals whose integrand holds another integral.

With nodes c, weights b and matrix A on [0, 1], ∫₀¹ f ≈ Σ b_j f(c_j) and ∫₀^{c_i} f ≈ Σ a_ij f(c_j).  As a
Runge–Kutta method it has order 16 (Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, §II.7).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from fractions import Fraction
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from contactbench.numbers.protocol import Arithmetic, Namespace, Numbers, has_digits

STAGES = 8
#: of the coefficients on doubles
DIGITS = 30
#: most halvings of a span; then its integral is accepted
HALVINGS = 12

#: γ(t)
Rate = Callable[[Any], Arithmetic]


class Rule(NamedTuple):
    """Nodes c, weights b, the matrix A, and for every node the interpolating polynomial's weights at 1 + c."""

    nodes: list[Arithmetic]
    weights: list[Arithmetic]
    matrix: list[list[Arithmetic]]
    onward: list[list[Arithmetic]]


@cache
def gauss(digits: int, stages: int = STAGES, ends: tuple[Fraction, ...] = ()) -> Rule:
    """Return the rule with a row of its matrix for each of some ends, by default the nodes."""
    import mpmath

    xp = mpmath.MPContext()
    xp.dps = digits + 10 + 2 * stages  # the powers of the nodes are nearly dependent
    near, _ = np.polynomial.legendre.leggauss(stages)
    nodes = [(1 + xp.findroot(lambda x: xp.legendre(stages, x), x)) / 2 for x in near.tolist()]
    basis = xp.matrix([[c**k for c in nodes] for k in range(stages)]) ** -1

    def weights(moments: Iterable[Arithmetic]) -> list[Arithmetic]:
        """Return the weights of a functional on polynomials, given its values on the powers."""
        return list(basis * xp.matrix(list(moments)))

    def integral(end: Arithmetic) -> list[Arithmetic]:
        return weights(end ** (k + 1) / (k + 1) for k in range(stages))

    at = [xp.mpf(end.numerator) / end.denominator for end in ends] or nodes
    onward = [weights((1 + c) ** k for k in range(stages)) for c in nodes]
    return Rule(nodes, integral(xp.mpf(1)), [integral(c) for c in at], onward)


@cache
def converted(number: Callable[[Any], Any], *asked: Any) -> Rule:
    """Return the rule in another kind of numbers."""
    nodes, weights, *tables = gauss(*asked)
    return Rule(
        [*map(number, nodes)], [*map(number, weights)], *([[*map(number, row)] for row in t] for t in tables)
    )


def rule(xp: Namespace, stages: int = STAGES, ends: tuple[Fraction, ...] = ()) -> Rule:
    """Return the rule in the numbers of a namespace."""
    if not has_digits(xp):
        return converted(float, DIGITS, stages, ends)
    return converted(xp.mpf, xp.dps, stages, ends) if isinstance(xp, Numbers) else gauss(xp.dps, stages, ends)


def weigh(weights: list[Arithmetic], values: list[Arithmetic]) -> Arithmetic:
    return sum(w * v for w, v in zip(weights, values, strict=True))


def integrals(rate: Rate, t: Arithmetic, h: Arithmetic, xp: Namespace) -> tuple[Arithmetic, Arithmetic]:
    """Return G = ∫_t^{t+h} γ and φ = ∫_t^{t+h} e^{−∫_t^τ γ} dτ of a rate γ(t), by one step on G' = γ, φ' = e^{−G}."""
    nodes, weights, matrix, _ = rule(xp)
    values = [rate(t + c * h) for c in nodes]
    kept = [xp.exp(-h * weigh(row, values)) for row in matrix]
    return h * weigh(weights, values), h * weigh(weights, kept)


def running(
    rate: Rate, t: Arithmetic, h: Arithmetic, ends: tuple[Fraction, ...], stages: int, xp: Namespace
) -> list[Arithmetic]:
    """Return ∫_t^{t+ch} of a rate for every c of some ends, to an error O(h^{stages + 1})."""
    nodes, _, matrix, _ = rule(xp, stages, ends)
    values = [rate(t + c * h) for c in nodes]
    return [h * weigh(row, values) for row in matrix]


def integral(rate: Rate, t: Arithmetic, h: Arithmetic, xp: Namespace) -> Arithmetic:
    """Return ∫_t^{t+h} γ over a span of any length, on plain numbers or arrays: halved until it no longer changes."""
    nodes, weights, *_ = rule(xp)
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
