"""Hermite interpolation between the ends of steps, as weights of the data there.

The cardinal functions of a polynomial with the first r derivatives given at nodes t_j are, up to their order at t_j,

    l_j(t)^r (1 − r S₁ τ + ½ (r² S₁² + r S₂) τ²) τ^k / k!,   τ = t − t_j,   S_k = Σ 1/(t_j − t_i)^k,

with Lagrange's l_j (Spitzbart, Amer. Math. Monthly 67, 42 (1960), doi:10.2307/2308924).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

#: times whose weights are computed at once
TOGETHER = 4096


class Weights(NamedTuple):
    """Weights (k, m, r) of r data at the m nodes `which`, (k, m), in the values at k times and in the slopes there."""

    which: np.ndarray
    values: np.ndarray
    slopes: np.ndarray

    def value(self, data: np.ndarray) -> np.ndarray:
        """Return the values at the times, (k, d), of data (n, r, d)."""
        return combined(self.values, data[self.which])

    def slope(self, data: np.ndarray) -> np.ndarray:
        return combined(self.slopes, data[self.which])


def combined(weights: np.ndarray, data: np.ndarray) -> np.ndarray:
    k, m, r, d = data.shape
    found = np.matmul(weights.reshape(k, 1, m * r), data.reshape(k, m * r, d))
    return np.asarray(found[:, 0])


def weights(t: np.ndarray, nodes: np.ndarray, which: np.ndarray, r: int) -> Weights:
    """Return the weights of r = 2 or 3 data a node at times (k,) that are no nodes; which : (k, m)."""
    if len(t) > TOGETHER:
        parts = [slice(k, k + TOGETHER) for k in range(0, len(t), TOGETHER)]
        return Weights(*map(np.concatenate, zip(*(weights(t[p], nodes, which[p], r) for p in parts))))
    near, own = nodes[which], np.arange(which.shape[1])
    h = ((near[:, -1] - near[:, 0]) / (len(own) - 1))[:, None]
    tau = (t[:, None] - near) / h
    with np.errstate(divide="ignore"):
        over = h[:, :, None] / (near[:, :, None] - near[:, None, :])
    over[:, own, own] = 0.0
    ratio = tau[:, None, :] * over
    ratio[:, own, own] = 1.0
    power, inverse = np.prod(ratio, axis=2) ** r, 1 / tau
    rising = r * power * (inverse.sum(axis=1, keepdims=True) - inverse)
    a = -r * over.sum(axis=2)
    b = (a * a + r * (over * over).sum(axis=2)) / 2 if r == 3 else 0 * a
    series = [(1 + (a + b * tau) * tau, a + 2 * b * tau), (tau, 1 + 0 * tau)]
    if r == 3:
        series[1:] = [(tau + a * tau * tau, 1 + 2 * a * tau), (tau * tau / 2, tau)]
    values = [power * own * h**k for k, (own, _) in enumerate(series)]
    slopes = [(rising * own + power * more) * h ** (k - 1) for k, (own, more) in enumerate(series)]
    return Weights(which, np.stack(values, axis=2), np.stack(slopes, axis=2))
