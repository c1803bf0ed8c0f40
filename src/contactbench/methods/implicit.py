"""Solve implicit steps to round-off by fixed-point or Newton iteration, and count every evaluation.

An iteration ends when increments are zero or no longer decrease (Hairer, Lubich, Wanner, Geometric Numerical
Integration, §VIII.6.2); a step that is too long for convergence has no result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from contactbench.numbers.control import choose, repeat_while
from contactbench.numbers.dual import Dual, leaves, rebuild
from contactbench.numbers.dual import slope as slope_of
from contactbench.numbers.protocol import Arithmetic, Condition, Namespace, abilities, has_digits
from contactbench.scene import AnyState
from contactbench.xla import jax, jnp, lax

#: number of first iterations whose increments may grow
FIRST = 3
#: number of iterations after which an increment must move the state by less than this part of its size
TRIED, LOST = 12, 0.1
#: largest number of iterations, and the largest move by a final increment
MOST, CONVERGED = 200, 1e-10
#: an increment larger than any that occurs
LARGEST = 1e300
#: moves of doubles below the first are rounding; below the second an iteration ends, far from a unit in the last place
#: since its remainder has one sign, and adds up from step to step
ROUNDING, SETTLED = 2.0**-46, 2e-17
#: number of iterations of a typical step
TYPICAL = 8


def fixed_point[K](
    update: Callable[[K], K], k: K, moves: Sequence[Arithmetic], xp: Namespace
) -> tuple[K, Condition, Arithmetic]:
    """Return k with update(k) = k, whether the iteration converged, and the number of updates.

    It ends when an increment moves the state by a small part of a unit in the last place, and dual numbers settle too.
    moves : how far a unit of every number in k moves the state, relative to the size of the state.
    """
    settled, rounding = (10.0**-xp.dps, 10.0 ** (6 - xp.dps)) if has_digits(xp) else (SETTLED, ROUNDING)
    nothing: Arithmetic = 0 * leaves(k)[0]

    def going(carried: tuple[K, Arithmetic, Arithmetic, Arithmetic]) -> Condition:
        _, turns, gap, before = carried
        more = (gap < before) | (turns < FIRST) | (gap > rounding)
        return (gap > settled) & more & ((gap < LOST) | (turns < TRIED)) & (turns < MOST)

    def turn(
        carried: tuple[K, Arithmetic, Arithmetic, Arithmetic],
    ) -> tuple[K, Arithmetic, Arithmetic, Arithmetic]:
        k, turns, gap, _ = carried
        new = update(k)
        pairs = zip(moves, leaves(new), leaves(k), strict=True)
        return new, turns + 1, sum((move * abs(a - b) for move, a, b in pairs), nothing), gap

    start = k, nothing + 0.0, nothing + LARGEST, nothing + math.inf
    k, turns, gap, _ = repeat_while(going, turn, start, xp)
    return k, (gap <= CONVERGED) & (turns < MOST), turns


def implicit[K](
    update: Callable[[K], K],
    solve: Callable[[K], tuple[K, Condition, Arithmetic]],
    k: K,
    xp: Namespace,
) -> tuple[K, Condition, Arithmetic]:
    """Return solve(k); under JAX, whose loops have no reverse mode, differentiate k = update(k) itself."""
    if not abilities(xp).traced or any(isinstance(c, Dual) for c in leaves(k)):
        return solve(k)

    def packed(k: K) -> Any:
        return jnp.stack(jnp.broadcast_arrays(*leaves(k)))

    def gap(y: Any) -> Any:
        return packed(update(rebuild(k, list(y)))) - y

    def search(_: object, y: Any) -> tuple[Any, tuple[Any, Any]]:
        end, there, cost = solve(rebuild(k, list(y)))
        return packed(end), (jnp.where(there, 1.0, 0.0), cost)

    def inverse(linear: Callable[[Any], Any], y: Any) -> Any:
        """Solve linear(x) = y, entry by entry of arrays."""
        unit = jnp.eye(len(y)).reshape(len(y), *y.shape[:1], *[1] * (y.ndim - 1))
        columns = jax.vmap(linear)(jnp.broadcast_to(unit, (len(y), *y.shape)))
        matrix, y = jnp.moveaxis(columns, (1, 0), (-2, -1)), jnp.moveaxis(y, 0, -1)
        return jnp.moveaxis(jnp.linalg.solve(matrix, y[..., None])[..., 0], -1, 0)

    y, (there, cost) = lax.custom_root(gap, packed(k), search, inverse, has_aux=True)
    return rebuild(k, list(y)), there > 0, cost


# -- Newton's iteration --------------------------------------------------------------------------------
def otherwise[K](
    first: tuple[K, Condition, Arithmetic],
    again: Callable[[], tuple[K, Condition, Arithmetic]],
    xp: Namespace,
) -> tuple[K, Condition, Arithmetic]:
    """Return the first result of an iteration; where it did not converge, run the second one and add the costs."""
    k, there, cost = first
    open_, settled, lost = 1.0, 0.0, -1.0

    def another(carried: tuple[K, Arithmetic, Arithmetic]) -> tuple[K, Arithmetic, Arithmetic]:
        k, there, more = again()
        return k, choose(there, settled, lost, xp), carried[2] + more

    start = k, choose(there, settled, open_, xp) + 0 * cost, cost
    k, end, cost = repeat_while(lambda carried: carried[1] > settled, another, start, xp)
    return k, end > lost, cost


def bare(x: Arithmetic) -> Arithmetic:
    """Return the value of a number, without its dual parts."""
    while isinstance(x, Dual):
        x = x.a
    return x


def jacobian(
    function: Callable[[Sequence[Arithmetic]], Sequence[Arithmetic]], x: Sequence[Arithmetic]
) -> list[list[Arithmetic]]:
    """Return the Jacobian of a function at x, a row for each of its values."""

    def along(direction: Sequence[float]) -> list[Arithmetic]:
        values = function([Dual(bare(c), d) for c, d in zip(x, direction, strict=True)])
        return [bare(slope_of(v)) for v in values]

    # the function may contain other dual numbers: subtract their part
    still = along([0.0] * len(x))
    columns = [along([float(i == j) for i in range(len(x))]) for j in range(len(x))]
    return [[c[i] - still[i] for c in columns] for i in range(len(still))]


def absent(x: Arithmetic) -> bool:
    return isinstance(x, float | int) and x == 0


def eliminated(matrix: Sequence[Sequence[Arithmetic]]) -> list[list[Arithmetic]]:
    """Return L − 1 and U in one matrix, matrix = L U, without pivoting, for a matrix 1 − h J."""
    rows = [list(row) for row in matrix]
    for k, pivot in enumerate(rows):
        for row in rows[k + 1 :]:
            if absent(row[k]):
                continue
            row[k] = row[k] / pivot[k]
            for j in range(k + 1, len(row)):
                if not absent(pivot[j]):
                    row[j] = row[j] - row[k] * pivot[j]
    return rows


def solved(factors: Sequence[Sequence[Arithmetic]], b: Sequence[Arithmetic]) -> list[Arithmetic]:
    """Return x with L U x = b."""

    def less(value: Arithmetic, row: Sequence[Arithmetic], x: Sequence[Arithmetic]) -> Arithmetic:
        return value - sum(a * c for a, c in zip(row, x, strict=True) if not absent(a))

    y: list[Arithmetic] = []
    for value, row in zip(b, factors, strict=True):
        y.append(less(value, row[: len(y)], y))
    x: list[Arithmetic] = []
    for k in reversed(range(len(y))):
        x.insert(0, less(y[k], factors[k][k + 1 :], x) / factors[k][k])
    return x


def found[X: AnyState](x: X, converged: object, xp: Namespace) -> X:
    """Return x, with nan in every component where the iteration did not converge."""
    after: X = rebuild(x, [choose(converged, part, math.nan, xp) for part in leaves(x)])
    return after
