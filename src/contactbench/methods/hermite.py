"""Hermite's interpolation in Newton's form: a polynomial through the first nodes is a part of that through all.

With each node as often as it has data, divided differences of equal nodes are derivatives over factorials (Stoer,
Bulirsch, Introduction to Numerical Analysis, §2.1.5).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contactbench.trace.kernel import Kernel

#: most nodes of a polynomial; the one that estimates its error has FEWER nodes less
NODES, FEWER = 8, 2
#: value, slope and second derivative at a node; most data of a polynomial
DATA, MOST = 3, 24
INFINITE = math.inf


class Components(NamedTuple):
    """How the components of a state are interpolated, (d,) each.

    data : data at a node, 2 or 3; 0 for a component that is `rates` times the slope of the component `leaders`.
    """

    data: np.ndarray
    leaders: np.ndarray
    rates: np.ndarray


def interpolate(
    t: np.ndarray, piece: np.ndarray, data: np.ndarray, components: Components, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the number of the node before each time, the states (l, d) there, and estimates of their errors (l, d).

    t, piece, data : nodes (n,), the numbers of their pieces, which no polynomial leaves, and value, slope and second
    derivative (n, 3, d).  times : increasing, (l,).
    """
    d = data.shape[2]
    out = np.empty((len(times), 1 + 2 * d))
    pieces = np.concatenate([[-1.0], piece, [-1.0]])
    work = np.empty(NODES + 4 * MOST + 2 * MOST * MOST + MOST * d + 2 * d)
    _interpolate(t, pieces, data.reshape(-1), *components, times, work, out.reshape(-1))
    return out[:, 0].astype(int), out[:, 1 : d + 1], out[:, d + 1 :]


@Kernel
def _interpolate(t, piece, data, orders, leaders, rates, saved, work, out):  # type: ignore[no-untyped-def]
    """Fill rows of `out`: the node before, the state, its error."""
    n = len(t)
    d = len(orders)
    # places in `work`: per number of data, the data's nodes and where they are in `data`, and 1/differences of nodes
    nodes = NODES
    owner = nodes + 2 * MOST
    gaps = owner + 2 * MOST
    table = gaps + 2 * MOST * MOST
    slopes = table + MOST * d
    # numbers of data that occur: 3 alone, or 2 as well
    kinds = 1
    for c in range(d):
        if orders[c] == 2.0:
            kinds = 2
    k = 0
    at = -1
    count = 0
    shorter = 0
    begin = 0.0
    for i in range(len(saved)):
        x = saved[i]
        while k + 2 < n and t[k + 1] <= x:
            k += 1
        if k != at:
            at = k
            begin = t[k]
            # the nearest nodes of the piece
            count = 0
            left = k
            right = k + 1
            for _j in range(NODES):
                before = piece[left + 1] == piece[k + 1]
                after = piece[right + 1] == piece[k + 1]
                nearer = k - left <= right - k - 1
                if before and (nearer or not after):
                    work[count] = left
                    left -= 1
                    count += 1
                elif after:
                    work[count] = right
                    right += 1
                    count += 1
            shorter = count - FEWER if count > FEWER + 1 else 0
            for other in range(kinds):
                kind = 1 - other
                r = kind + 2
                for j in range(count):
                    for each in range(r):
                        place = kind * MOST + j * r + each
                        node = int(work[j])
                        work[nodes + place] = t[node] - begin
                        work[owner + place] = node * DATA * d
                for below in range(count * r - 1):
                    level = below + 1
                    for j in range(count * r - level):
                        place = kind * MOST + j + level
                        gap = work[nodes + place] - work[nodes + place - level]
                        work[gaps + (kind * MOST + level) * MOST + j + level] = 1.0 / gap
            for c in range(d):
                r = int(orders[c])
                kind = MOST * (r - 2)
                first = table + MOST * c
                for j in range(count * r):
                    work[first + j] = data[int(work[owner + kind + j]) + c]
                for below in range(count * r - 1):
                    level = below + 1
                    given = level if level < r else 0
                    for j in range(count * r - level):
                        e = count * r - 1 - j
                        known = data[int(work[owner + kind + e]) + given * d + c] / level
                        equal = work[nodes + kind + e] == work[nodes + kind + e - level]
                        gap = work[gaps + (kind + level) * MOST + e]
                        quotient = (work[first + e] - work[first + e - 1]) * gap
                        work[first + e] = known if equal else quotient
        row = i * (2 * d + 1)
        out[row] = k
        for c in range(d):
            r = int(orders[c])
            kind = nodes + MOST * (r - 2)
            first = table + MOST * c
            value = 0.0
            slope = 0.0
            less = 0.0
            lower = 0.0
            product = 1.0
            rising = 0.0
            for j in range(count * r):
                less = value if j == shorter * r else less
                lower = slope if j == shorter * r else lower
                own = work[first + j]
                value += product * own
                slope += rising * own
                past = x - begin - work[kind + j]
                rising = rising * past + product
                product *= past
            out[row + 1 + c] = value
            out[row + 1 + d + c] = abs(value - less) if shorter > 0 else INFINITE
            work[slopes + c] = slope
            work[slopes + d + c] = lower
        for c in range(d):
            if orders[c] == 0.0:
                slope = work[slopes + int(leaders[c])] * rates[c]
                lower = work[slopes + d + int(leaders[c])] * rates[c]
                out[row + 1 + c] = slope
                out[row + 1 + d + c] = abs(slope - lower) if shorter > 0 else INFINITE
