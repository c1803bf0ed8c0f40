"""Implicit steps, solved by fixed-point iteration to round-off, every evaluation counted.

It ends when the increments are zero or no longer decrease (Hairer, Lubich, Wanner, Geometric Numerical Integration,
§VIII.6.2); a step that is too long for it to converge has no result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from contactbench.methods.base import METHODS, unfit
from contactbench.methods.fixed_step import FixedStep
from contactbench.numbers.control import Repeat, choose, repeat, repeat_while
from contactbench.numbers.dual import Dual, leaves, rebuild
from contactbench.numbers.dual import slope as slope_of
from contactbench.numbers.protocol import Arithmetic, Condition, Count, Namespace, has_digits
from contactbench.scene import AnyState, Mechanical, Scene, State, Vector, dot, shifted

#: iterations that may differ by more than the one before
FIRST = 3
#: iterations after which increments are less than half of what is iterated, or never are
TRIED = 12
#: iterations after which a step has none, and the last increment that is none, relative to what is iterated
MOST, CONVERGED = 200, 1e-10
#: an increment beyond all numbers
LARGEST = 1e300
#: increments of doubles that are rounding, on the same scale
ROUNDING = 2.0**-46
#: an increment that changes no state, relative to it: at rest slopes are rounding, which may go to and fro for ever
LOST = 4e-15
#: iterations of a typical step
TYPICAL = 8


def fixed_point[K](
    update: Callable[[K], K],
    k: K,
    xp: Namespace,
    part: Callable[[K], object] = lambda k: k,
    patient: bool = False,
    moves: Arithmetic = 1.0,
    lost: Arithmetic = 0.0,
) -> tuple[K, Condition, Arithmetic]:
    """Return k with update(k) = k, whether it was found, and after how many updates.

    part : of k, what settles.  patient : increments may grow for a while that are not yet rounding, as those of errors
    that turn do, and the slopes of dual numbers have to settle too.  moves, lost : what an increment is multiplied by,
    and what of that does nothing.
    """
    rounding = 10.0 ** (6 - xp.dps) if has_digits(xp) else ROUNDING
    nothing: Arithmetic = 0 * leaves(k)[0]

    def size(components: Iterable[Arithmetic]) -> Arithmetic:
        numbers = list(components)
        if patient:
            numbers += [Dual(slope_of(c), 0.0) for c in numbers if isinstance(c, Dual)]
        return sum(map(abs, numbers), nothing)

    def going(carried: tuple[K, Arithmetic, Arithmetic, Arithmetic]) -> Condition:
        k, turns, gap, before = carried
        more = (gap < before) | (turns < FIRST)
        if patient:
            whole = size(leaves(part(k)))
            more = (more | (gap > rounding * whole)) & ((gap < whole / 2) | (turns < TRIED))
        return (gap > 0) & more & (turns < MOST)

    def turn(
        carried: tuple[K, Arithmetic, Arithmetic, Arithmetic],
    ) -> tuple[K, Arithmetic, Arithmetic, Arithmetic]:
        k, turns, gap, _ = carried
        new = update(k)
        increments = (a - b for a, b in zip(leaves(part(new)), leaves(part(k)), strict=True))
        return new, turns + 1, size(increments), gap

    start = k, nothing + 0.0, nothing + LARGEST, nothing + math.inf
    k, turns, gap, _ = repeat_while(going, turn, start, xp)
    small = gap <= CONVERGED * size(leaves(part(k)))
    if patient:  # what still moves is not settled
        small = small & (turns < MOST)
    return k, (small | (gap * moves <= lost)) & (gap < LARGEST), turns


# -- Newton's iteration --------------------------------------------------------------------------------
def otherwise[K](
    first: tuple[K, Condition, Arithmetic],
    again: Callable[[], tuple[K, Condition, Arithmetic]],
    xp: Namespace,
) -> tuple[K, Condition, Arithmetic]:
    """Return what was found, whether, and its cost; where it was not, what another way finds, which is only then gone.

    Both are as `fixed_point` returns them, the costs added.
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
    """Return a number without what makes it a dual one."""
    while isinstance(x, Dual):
        x = x.a
    return x


def jacobian(
    function: Callable[[Sequence[Arithmetic]], Sequence[Arithmetic]], x: Sequence[Arithmetic]
) -> list[list[Arithmetic]]:
    """Return the derivatives of a function of so many numbers, a row for each of its values."""

    def along(direction: Sequence[float]) -> list[Arithmetic]:
        values = function([Dual(bare(c), d) for c, d in zip(x, direction, strict=True)])
        return [bare(slope_of(v)) for v in values]

    # what the function has of dual numbers besides its arguments is not of x
    still = along([0.0] * len(x))
    columns = [along([float(i == j) for i in range(len(x))]) for j in range(len(x))]
    return [[c[i] - still[i] for c in columns] for i in range(len(still))]


def absent(x: Arithmetic) -> bool:
    return isinstance(x, float | int) and x == 0


def eliminated(matrix: Sequence[Sequence[Arithmetic]]) -> list[list[Arithmetic]]:
    """Return L − 1 and U of matrix = L U in one, without pivoting: for matrices 1 − h J."""
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


@dataclass(frozen=True)
class Implicit(FixedStep):
    """A method whose step returns x and iterations; each : evaluations of an iteration, one more comes first."""

    each: int = field(kw_only=True)
    engines: tuple[str, ...] = ("llvm", "python")
    iterates = True
    unsolved = "its iteration does not converge"

    def refuses(self, scene: Scene) -> str | None:
        return unfit(self, scene, True, "")

    def advance(
        self, scene: Scene, x: AnyState, h: Arithmetic, n: Count, xp: Namespace, repeat: Repeat = repeat
    ) -> AnyState:
        return self.advance_counted(scene, x, h, n, xp, repeat)[0]

    def advance_counted(
        self, scene: Scene, x: AnyState, h: Arithmetic, n: Count, xp: Namespace, repeat: Repeat = repeat
    ) -> tuple[AnyState, Arithmetic]:
        """Return the state after n steps and the evaluations they took."""

        def another(carried: tuple[AnyState, Arithmetic]) -> tuple[AnyState, Arithmetic]:
            x, spent = carried
            x, turns = self.step(scene, x, h, xp)
            return x, spent + (self.each * turns + 1)

        after: tuple[AnyState, Arithmetic] = repeat(n, another, (x, 0 * leaves(x)[0]))
        return after

    def counts(self, scene: Scene, n: int, carry: Sequence[str] | None = None) -> int:
        """Return what n steps typically cost."""
        return n * (TYPICAL * self.each + 1)


def found[X: AnyState](x: X, converged: object, xp: Namespace) -> X:
    """Return x, without numbers where the iteration did not converge."""
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


def gauss(stages: int) -> Callable[[Scene, State, Arithmetic, Namespace], tuple[State, Arithmetic]]:
    """Return a step of Gauss's collocation; an iteration takes momenta first, which converges faster."""

    def step(scene: Any, x: State, h: Arithmetic, xp: Namespace) -> tuple[State, Arithmetic]:
        A, b = gauss_tableau(stages, xp)

        def moved(weights: Sequence[Arithmetic], slopes: Sequence[State]) -> State:
            y = x
            for weight, k in zip(weights, slopes, strict=True):
                y = shifted(y, weight * h, k)
            return y

        def update(slopes: Sequence[State]) -> Sequence[State]:
            if scene.separable:
                momenta = [moved(row, slopes).p for row in A]
                pairs = zip(slopes, momenta, strict=True)
                slopes = [k._replace(q=tuple(scene.velocity(p))) for k, p in pairs]
            return tuple(scene.rhs(moved(row, slopes)) for row in A)

        first: Sequence[State] = (scene.rhs(x),) * stages
        lost = LOST * sum(map(abs, leaves(x)))
        slopes, converged, turns = fixed_point(update, first, xp, moves=abs(h), lost=lost)
        return found(moved(b, slopes), converged, xp), turns

    return step


# -- a discrete gradient -------------------------------------------------------------------------------
class DiscreteGradient(Implicit):
    def refuses(self, scene: Scene) -> str | None:
        fits = scene.separable and scene.clock is None
        return unfit(self, scene, fits, "forces that depend on q alone")


#: where the motion turns: of a way² smaller than this part of q², what lacks in V is rounding, being of order way³
TURNING = 1e-10


def discrete_gradient(scene: Mechanical, x: State, h: Arithmetic, xp: Namespace) -> tuple[State, Arithmetic]:
    """Damping for h/2, a step that keeps H0, and damping for h/2: H0 never rises where Γ' ≥ 0.

    p₁ = p − h ∇̄V, q₁ = q + h (p + p₁)/2m with the midpoint discrete gradient ∇̄V·(q₁ − q) = V(q₁) − V(q):
    Gonzalez, J. Nonlinear Sci. 6, 449 (1996), doi:10.1007/BF02440162, eq. (3.5).
    """
    damp = scene.flows["damp"]
    constants = damp.constants(scene, h / 2, xp)
    x = damp.apply(scene, x, constants, xp)
    before = scene.V(x.q)

    def momentum(force: Vector, span: Arithmetic) -> Vector:
        return tuple(p - span * f for p, f in zip(x.p, force, strict=True))

    def end(force: Vector) -> Vector:
        return tuple(q + h * v for q, v in zip(x.q, scene.velocity(momentum(force, h / 2)), strict=True))

    def update(k: tuple[Vector, Vector]) -> tuple[Vector, Vector]:
        after, _ = k
        way = tuple(b - a for a, b in zip(x.q, after, strict=True))
        gradient = scene.dV(tuple(a + d / 2 for a, d in zip(x.q, way, strict=True)))
        square, lack = dot(way, way), scene.V(after) - before - dot(gradient, way)
        moves = square > TURNING * dot(x.q, x.q)
        share = choose(moves, lack / choose(moves, square, 1.0, xp), 0.0, xp)
        force = tuple(g + share * d for g, d in zip(gradient, way, strict=True))
        return end(force), force

    first = tuple(scene.dV(x.q))
    # by positions: where the motion turns, what round-off does to the force is large, and does nothing
    (q, force), converged, turns = fixed_point(update, (end(first), first), xp, lambda k: k[0])
    s = x.s
    if s is not None:
        s = s + h * (scene.kinetic(momentum(force, h / 2)) - (before + scene.V(q)) / 2)
    x = damp.apply(scene, State(q, momentum(force, h), s), constants, xp)
    return found(x, converged, xp), turns


_source = "Hairer, Lubich, Wanner, Geometric Numerical Integration, §II.1.3, by fixed-point iteration"
for _stages in (2, 3):
    _name, _order = f"gauss{2 * _stages}", 2 * _stages
    METHODS.add(Implicit(_name, _order, gauss(_stages), about=_source, each=_stages, symmetric=True))
_source = "discrete gradient of Gonzalez, doi:10.1007/BF02440162, between halves of exact damping"
METHODS.add(
    DiscreteGradient(
        "discrete-gradient", 2, discrete_gradient, kind="gradient", about=_source, each=1, symmetric=True
    )
)
