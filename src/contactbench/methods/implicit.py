"""Solve implicit steps to round-off by fixed-point or Newton iteration, and count every evaluation.

An iteration ends when increments are zero or no longer decrease (Hairer, Lubich, Wanner, Geometric Numerical
Integration, §VIII.6.2); a step that is too long for convergence has no result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from contactbench.numbers.control import choose, repeat_while
from contactbench.numbers.dual import Dual, leaves, rebuild
from contactbench.numbers.dual import slope as slope_of
from contactbench.numbers.protocol import Arithmetic, Condition, Namespace, abilities, has_digits
from contactbench.scene import AnyState
from contactbench.xla import jax, jnp, lax

#: number of first iterations whose increments may grow
FIRST = 3
#: number of iterations after which the increment must be below half of the iterate
TRIED = 12
#: largest number of iterations, and the largest final increment relative to the iterate
MOST, CONVERGED = 200, 1e-10
#: an increment larger than any that occurs
LARGEST = 1e300
#: increments of doubles below this part of the iterate are rounding
ROUNDING = 2.0**-46
#: increments below this part of the state change nothing: at rest, slopes are rounding and may oscillate for ever
LOST = 4e-15
#: number of iterations of a typical step
TYPICAL = 8


def fixed_point[K](
    update: Callable[[K], K],
    k: K,
    xp: Namespace,
    moves: Arithmetic = 1.0,
    lost: Arithmetic = 0.0,
) -> tuple[K, Condition, Arithmetic]:
    """Return k with update(k) = k, whether the iteration converged, and the number of updates.

    Increments above rounding may grow for a while, as for oscillating errors.  The slopes of dual numbers must settle
    too.  moves : factor by which an increment of k moves the state.  lost : a move of this size has no effect.
    """
    rounding = 10.0 ** (6 - xp.dps) if has_digits(xp) else ROUNDING
    nothing: Arithmetic = 0 * leaves(k)[0]

    def size(components: Iterable[Arithmetic]) -> Arithmetic:
        numbers = list(components)
        numbers += [Dual(slope_of(c), 0.0) for c in numbers if isinstance(c, Dual)]
        return sum(map(abs, numbers), nothing)

    def going(carried: tuple[K, Arithmetic, Arithmetic, Arithmetic]) -> Condition:
        k, turns, gap, before = carried
        more, whole = (gap < before) | (turns < FIRST), size(leaves(k))
        more = (more | (gap > rounding * whole)) & ((gap < whole / 2) | (turns < TRIED))
        return (gap > 0) & more & (turns < MOST)

    def turn(
        carried: tuple[K, Arithmetic, Arithmetic, Arithmetic],
    ) -> tuple[K, Arithmetic, Arithmetic, Arithmetic]:
        k, turns, gap, _ = carried
        new = update(k)
        increments = (a - b for a, b in zip(leaves(new), leaves(k), strict=True))
        return new, turns + 1, size(increments), gap

    start = k, nothing + 0.0, nothing + LARGEST, nothing + math.inf
    k, turns, gap, _ = repeat_while(going, turn, start, xp)
    small = (gap <= CONVERGED * size(leaves(k))) & (turns < MOST)  # what still moves is not settled
    return k, (small | (gap * moves <= lost)) & (gap < LARGEST), turns


def implicit[K](
    update: Callable[[K], K],
    solve: Callable[[K], tuple[K, Condition, Arithmetic]],
    k: K,
    xp: Namespace,
) -> tuple[K, Condition, Arithmetic]:
    """Return solve(k); under JAX, differentiate k = update(k) by its Jacobian.

    JAX cannot differentiate backwards through the loop of an iteration.
    """
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
    """Return the first result of an iteration; where it did not converge, run the second one and add the costs.

    Results have the form that `fixed_point` returns.
    """
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


# -- Gauss's collocation ---------------------------------------------------------------------------------
def gauss_tableau(stages: int, xp: Namespace) -> tuple[list[list[Arithmetic]], list[Arithmetic]]:
    """Return A and b: Hairer, Lubich, Wanner, §II.1.3, table 1.1."""
    root = xp.sqrt(15 if stages == 3 else 3)
    one = root / root
    if stages == 1:
        return [[one / 2]], [one]
    if stages == 2:
        return [[one / 4, one / 4 - root / 6], [one / 4 + root / 6, one / 4]], [one / 2, one / 2]
    A = [
        [one * 5 / 36, one * 2 / 9 - root / 15, one * 5 / 36 - root / 30],
        [one * 5 / 36 + root / 24, one * 2 / 9, one * 5 / 36 - root / 24],
        [one * 5 / 36 + root / 30, one * 2 / 9 + root / 15, one * 5 / 36],
    ]
    return A, [one * 5 / 18, one * 4 / 9, one * 5 / 18]
