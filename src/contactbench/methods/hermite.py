"""Hermite's interpolation in Newton's form: a polynomial through the first nodes is a part of that through all.

With each node as often as it has data, divided differences of equal nodes are derivatives over factorials (Stoer,
Bulirsch, Introduction to Numerical Analysis, §2.1.5).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np


class Newton(NamedTuple):
    """Polynomials in Newton's form: nodes (k, n) with repetitions, and coefficients (k, n, d)."""

    nodes: np.ndarray
    coefficients: np.ndarray

    def at(
        self, t: np.ndarray, which: np.ndarray, lengths: Sequence[int]
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield values and slopes (l, d) at times t of the polynomials `which`, with their first `lengths` terms."""
        product, rising = np.ones((len(t), 1)), np.zeros((len(t), 1))
        value, slope = (np.zeros((len(t), self.coefficients.shape[2])) for _ in range(2))
        for k in range(self.nodes.shape[1]):
            own = self.coefficients[which, k]
            value += product * own
            slope += rising * own
            past = (t - self.nodes[which, k])[:, None]
            rising, product = rising * past + product, product * past
            if k + 1 in lengths:
                yield value.copy(), slope.copy()


def newton(t: np.ndarray, data: np.ndarray) -> Newton:
    """Return the polynomials through values and derivatives, data (k, m, r, d) at nodes t (k, m)."""
    _, m, r, _ = data.shape
    nodes, level = np.repeat(t, r, axis=1), np.repeat(data[:, :, 0], r, axis=1)
    coefficients = [level[:, 0]]
    for k in range(1, m * r):
        own = np.arange(m * r - k)
        own = own[own % r + k < r]  # differences of equal nodes
        gaps = nodes[:, k:] - nodes[:, :-k]
        gaps[:, own] = 1.0
        level = (level[:, 1:] - level[:, :-1]) / gaps[:, :, None]
        level[:, own] = data[:, own // r, k] / math.factorial(k) if len(own) else level[:, own]
        coefficients.append(level[:, 0])
    return Newton(nodes, np.stack(coefficients, axis=1))
