"""Gauss's collocation on the symplectisation: a contact map of (q, p, s) for every contact Hamiltonian.

With P = r p and K = r H(q, P/r, s), Hamilton's equations of ω = dr∧ds − dP∧dq are

    q' = H_p,   P' = −r H_q,   s' = p·H_p − H,   r' = r H_s.

Collocation at Gauss's nodes preserves ω (Hairer, Lubich, Wanner, Geometric Numerical Integration, §VI.4) and commutes
with the linear scaling (P, r) ↦ (λP, λr), hence preserves r ds − P·dq = r η: the map of (q, p, s) has Φ*η = (r₀/r₁) η
(the symplectisation: Arnold, Mathematical Methods of Classical Mechanics, Appendix 4.E).  r is 1 where a step begins.

If ∂H/∂s depends on the time alone, H = h(q, p, t) + γ(t) s, then r = e^{∫γ} is known.  In this case (q, P) and the
action S = r s, S' = P·q' − r h, are integrated.  The conformal factor is then exact, and strong damping does not slow
down the iteration.  If moreover h = T(p) + V(q, t), then P' = −r ∇V(q, t) is known at given positions, and

    Q_i = q + h Σ_j a_ij r_j⁻¹ p/m + h² Σ_k (Σ_j a_ij r_j⁻¹ a_jk r_k) F(Q_k)/m,   F = −∇V,

are equations of the positions alone, whose iteration converges twice as fast.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import accumulate, zip_longest
from typing import Any, NamedTuple

from contactbench.checks import whole
from contactbench.methods.base import METHODS, unfit
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.implicit import (
    TYPICAL,
    bare,
    eliminated,
    fixed_point,
    found,
    implicit,
    jacobian,
    otherwise,
    solved,
)
from contactbench.methods.loops import SAME
from contactbench.numbers.control import Repeat, choose, repeat
from contactbench.numbers.dual import leaves, rebuild
from contactbench.numbers.protocol import Arithmetic, Condition, Count, Namespace, Vector
from contactbench.numbers.quadrature import Rule, rule
from contactbench.scene import Scene, added
from contactbench.scene.base import OwnState
from contactbench.scene.flow import damping

#: most equations of Newton's iteration: more take seconds to compile
ELIMINATED = 24
#: most stages, whose coefficients need digits in proportion
MOST_STAGES = 32
#: most stages whose polynomial starts the next step: that of more amplifies rounding to the size of the motion
EXTRAPOLATED = 24
#: what counts as the size of numbers at rest: this part of the size of the whole state, and not nothing
REST, TINY = 4e-5, 1e-290


class Lifted(NamedTuple):
    """q, P, s (S if r is known) and r (None if it is known), or their slopes; s is None if it is not carried."""

    q: Vector
    P: Vector
    s: Any
    r: Any


def components(z: Lifted) -> tuple[Arithmetic, ...]:
    """Return all components; dual numbers stay whole."""
    return (*z.q, *z.P, *(c for c in (z.s, z.r) if c is not None))


def with_components(z: Lifted, values: Sequence[Arithmetic]) -> Lifted:
    n, rest = len(z.q), iter(values[2 * len(z.q) :])
    s, r = (None if c is None else next(rest) for c in (z.s, z.r))
    return Lifted(tuple(values[:n]), tuple(values[n : 2 * n]), s, r)


#: the slopes of all stages, each a row of components
Slopes = tuple[tuple[Arithmetic, ...], ...]


class Equations(NamedTuple):
    """The equations k_i = slope(i, Σ_j a_ij k_j) of the stages of a step.

    coupling : a_ij.
    near : the slope where the step begins, as a function of a move from there.
    scales : for every stage the units of the components in which it has the Jacobian of `near`.
    moves : how far a unit of each component of a slope moves the state in a step, relative to the size of the state.
    end : from the slopes the state after the step, and for every component the factor of a slope in the next step.
    """

    coupling: Sequence[Sequence[Arithmetic]]
    slope: Callable[[int, Sequence[Arithmetic]], Sequence[Arithmetic]]
    near: Callable[[Sequence[Arithmetic]], Sequence[Arithmetic]]
    scales: Sequence[Sequence[Arithmetic]]
    moves: list[list[Arithmetic]]
    end: Callable[[Slopes], tuple[OwnState, Sequence[Arithmetic]]]


def combined(weights: Sequence[Arithmetic], rows: Sequence[Sequence[Arithmetic]]) -> tuple[Arithmetic, ...]:
    """Return Σ w k, component by component."""
    return tuple(
        sum((w * k for w, k in zip(weights[1:], others, strict=True)), weights[0] * first)
        for first, *others in zip(*rows, strict=True)
    )


def per_size(
    values: Sequence[Arithmetic], moves: Sequence[Arithmetic], lengths: Sequence[int]
) -> list[list[Arithmetic]]:
    """Return 1 over the size of the vector that each value belongs to, for the value and its derivatives.

    moves : how far the step takes the values, which adds to their size.  lengths : of the vectors.
    """
    own, ends = [], [*accumulate(lengths)]
    for begin, end in zip([0, *ends], ends, strict=False):
        parts = zip_longest(*map(leaves, (*values[begin:end], *moves[begin:end])), fillvalue=0.0)
        own.append([sum(map(abs, part)) for part in parts])
    whole = [sum(part) for part in zip_longest(*own, fillvalue=0.0)]
    over = [
        [1 / (TINY + REST * all_ + part) for all_, part in zip(whole, each, strict=False)] for each in own
    ]
    return [each for each, length in zip(over, lengths, strict=True) for _ in range(length)]


def stages_of_positions(scene: Any, x: Any, h: Arithmetic, xp: Namespace, rule: Rule) -> Equations:
    """Return the equations of the forces F(Q_i), where r and P follow from them."""
    nodes, stages = rule.nodes, range(len(rule.nodes))
    grown = [xp.exp(scene.damped_within(x, c * h, xp)) for c in nodes]
    shrunk = [1 / r for r in grown]
    v, inverse_mass = scene.velocity(x.p), scene.velocity((1.0,) * len(x.p))

    def twice(weights: Sequence[Arithmetic]) -> tuple[Arithmetic, list[Arithmetic]]:
        """Return the time that a momentum is worth, and what each force is worth."""
        kept = [h * w * c for w, c in zip(weights, shrunk, strict=True)]
        pushes = [sum(kept[j] * rule.matrix[j][k] for j in stages) * (h * grown[k]) for k in stages]
        return sum(kept), pushes

    def force(q: Vector, c: Arithmetic) -> tuple[Arithmetic, ...]:
        return tuple(-g for g in scene.gradient_at(moved(scene, x, c * h, q=q)))

    ways, coupling = zip(*map(twice, rule.matrix), strict=True)
    begins = [added(x.q, [way * c for c in v]) for way in ways]

    def position(i: int, push: Sequence[Arithmetic]) -> Vector:
        return added(begins[i], scene.velocity(push))

    def end(forces: Slopes) -> tuple[OwnState, Sequence[Arithmetic]]:
        way, push = twice(rule.weights)
        impulses = [[h * r * f for f in row] for r, row in zip(grown, forces, strict=True)]
        q = added(added(x.q, [way * c for c in v]), scene.velocity(combined(push, forces)))
        s = x.s
        if s is not None:
            for i, w in enumerate(rule.weights):
                p = tuple(shrunk[i] * c for c in added(x.p, combined(rule.matrix[i], impulses)))
                there = moved(scene, x, nodes[i] * h, q=position(i, combined(coupling[i], forces)))
                s = s + h * w * grown[i] * (scene.kinetic(p) - scene.potential_at(there))
        P = added(x.p, combined(rule.weights, impulses))
        return decayed(scene, x, h, q, P, s, xp), [1.0] * len(q)

    over = per_size(x.q, [h * c for c in v], scene.vectors[: len(scene.vectors) // 2])
    return Equations(
        coupling,
        lambda i, push: force(position(i, push), nodes[i]),
        lambda push: force(added(x.q, scene.velocity(push)), 0),
        [[1.0] * len(v)] * len(nodes),
        [[h * h * c * part for part in row] for c, row in zip(inverse_mass, over, strict=True)],
        end,
    )


def moved(scene: Any, x: Any, after: Arithmetic, **fields: Any) -> OwnState:
    """Return the state with other fields, at a later time if the scene has one."""
    y: OwnState = x._replace(**fields)
    return y if scene.clock is None else y._replace(t=x.t + after)


def decayed(scene: Any, x: Any, h: Arithmetic, q: Vector, P: Vector, S: Any, xp: Namespace) -> OwnState:
    """Return the state after a step where r is known; a small loss is subtracted, whose rounding is small too."""
    keep, lose = damping(scene.damped_within(x, h, xp), 1.0, xp)
    p, s = tuple(keep * c - lose * c for c in P), None if S is None else keep * S - lose * S
    return moved(scene, x, h, q=q, p=p, s=s)


def lifted_slope(scene: Any, x: OwnState, r: Arithmetic, known: bool) -> tuple[Arithmetic, ...]:
    """Return the slope of the lifted equations at a state; known : r is a function of the time alone."""
    rate, k = scene.damping_at(x), scene.rhs(x)
    P = tuple(r * (f + rate * p) for f, p in zip(k.p, x.p, strict=True))
    if known:
        return components(Lifted(k.q, P, None if x.s is None else r * (k.s + rate * x.s), None))
    return components(Lifted(k.q, P, k.s, r * rate))


def stages_of_lift(
    scene: Any, x: Any, h: Arithmetic, xp: Namespace, rule: Rule, first: Sequence[Arithmetic]
) -> Equations:
    """Return the equations of the slopes of (q, P, s, r); first : a slope like those of the step."""
    nodes, known = rule.nodes, scene.damped_within(x, h, xp) is not None
    start = Lifted(x.q, x.p, x.s, None if known else 1 + 0 * x.p[0])
    values, n = components(start), len(x.q)
    grown = [xp.exp(scene.damped_within(x, c * h, xp)) for c in nodes] if known else []
    shrunk = [1 / r for r in grown]

    def slope(move: Sequence[Arithmetic], c: Arithmetic, r: Any, over: Any) -> tuple[Arithmetic, ...]:
        """Return the slope after a move and the part c of the step; over : 1/r."""
        z = with_components(start, added(values, move))
        r, over = (r, over) if known else (z.r, 1 / z.r)
        # S' does not depend on s
        y = moved(scene, x, c * h, q=z.q, p=tuple(over * c for c in z.P), s=x.s if known else z.s)
        return lifted_slope(scene, y, r, known)

    def end(slopes: Slopes) -> tuple[OwnState, Sequence[Arithmetic]]:
        z = with_components(start, added(values, combined([h * w for w in rule.weights], slopes)))
        if known:
            over, after = xp.exp(-scene.damped_within(x, h, xp)), decayed(scene, x, h, z.q, z.P, z.s, xp)
        else:
            over, after = 1 / z.r, moved(scene, x, h, q=z.q, p=tuple(c / z.r for c in z.P), s=z.s)
        return after, [1.0] * n + [over] * (len(values) - n)

    lengths = [*scene.vectors, *[1] * (len(values) - 2 * n)]
    over = per_size(values, [h * c for c in first], lengths)
    return Equations(
        [[h * a for a in row] for row in rule.matrix],
        lambda i, move: slope(move, nodes[i], *((grown[i], shrunk[i]) if known else (None, None))),
        lambda move: slope(move, 0, 1.0, 1.0),
        [[1.0] * n + [r] * (len(values) - n) for r in (grown or (1.0,) * len(nodes))],
        [[h * part for part in row] for row in over],
        end,
    )


def in_positions(scene: Any, x: OwnState, xp: Namespace) -> bool:
    """Return whether the stages are equations of the positions alone."""
    return scene.separable and scene.damped_within(x, 0.0, xp) is not None


def newton(
    equations: Equations, x: OwnState, h: Arithmetic, moves: Sequence[Arithmetic], xp: Namespace
) -> tuple[Slopes, Condition, Arithmetic]:
    """Solve by simplified Newton iteration with the Jacobian where the step begins."""
    coupling, scales = equations.coupling, equations.scales
    stages, size = range(len(scales)), len(scales[0])
    still = [0 * c for c in x.q[:1] * size]
    J = jacobian(equations.near, still)
    factors = eliminated(
        [
            [
                float(i == j and a == b)
                - bare(coupling[i][j]) * (J[a][b] * bare(scales[i][a]) / bare(scales[i][b]))
                for j in stages
                for b in range(size)
            ]
            for i in stages
            for a in range(size)
        ]
    )

    def improved(slopes: Slopes) -> Slopes:
        here = [c for row in updated(equations, slopes) for c in row]
        there = [c for row in slopes for c in row]
        change = solved(factors, [a - b for a, b in zip(there, here, strict=True)])
        again = [a - d for a, d in zip(there, change, strict=True)]
        return tuple(tuple(again[i * size : (i + 1) * size]) for i in stages)

    first = (tuple(equations.near(still)),) * len(scales)
    slopes, converged, turns = fixed_point(improved, first, moves, xp)
    return slopes, converged, len(scales) * turns + (size + 2)


def updated(equations: Equations, slopes: Slopes) -> Slopes:
    return tuple(tuple(equations.slope(i, combined(row, slopes))) for i, row in enumerate(equations.coupling))


Step = Callable[..., tuple[OwnState, Arithmetic, Slopes]]


def collocation(stages: int) -> Step:
    """Return a step of so many stages: from x and initial slopes to x, evaluations and slopes for the next step."""

    def step(
        scene: Any, x: OwnState, h: Arithmetic, xp: Namespace, slopes: Slopes
    ) -> tuple[OwnState, Arithmetic, Slopes]:
        gauss = rule(xp, stages)
        if in_positions(scene, x, xp):
            equations = stages_of_positions(scene, x, h, xp, gauss)
        else:
            equations = stages_of_lift(scene, x, h, xp, gauss, slopes[0])
        parts = [[abs(part) for part in row] for row in equations.moves]
        moves = [
            w * parts[a][min(i, len(parts[a]) - 1)]
            for w, row in zip(gauss.weights, slopes, strict=True)
            for a, c in enumerate(row)
            for i, _ in enumerate(leaves(c))
        ]

        def solve(slopes: Slopes) -> tuple[Slopes, Condition, Arithmetic]:
            slopes, converged, turns = fixed_point(lambda k: updated(equations, k), slopes, moves, xp)
            found = slopes, converged, stages * turns
            if stages * len(slopes[0]) > ELIMINATED:
                return found
            return otherwise(found, lambda: newton(equations, x, h, moves, xp), xp)

        slopes, converged, spent = implicit(lambda k: updated(equations, k), solve, slopes, xp)
        after, over = equations.end(slopes)
        extrapolated = (combined(row, slopes) for row in gauss.onward)
        ahead = extrapolated if stages <= EXTRAPOLATED else slopes[-1:] * stages
        onward = tuple(tuple(a * c for a, c in zip(over, row, strict=True)) for row in ahead)
        return found(after, converged, xp), spent, onward

    return step


@dataclass(frozen=True)
class ContactGauss(FixedStep):
    """Collocation on the symplectisation; each : evaluations of an iteration.  A run begins with one evaluation."""

    each: int = field(kw_only=True)
    engines: tuple[str, ...] = ("llvm", "python")
    iterates = True
    unsolved = "its iteration does not converge"

    def refuses(self, scene: Scene) -> str | None:
        return unfit(self, scene, scene.canonical, "canonical coordinates (q, p, s)")

    def first(self, scene: Scene, x: OwnState, xp: Namespace) -> Slopes:
        if in_positions(scene, x, xp):
            return (tuple(-g for g in scene.gradient_at(x)),) * self.each  # type: ignore[attr-defined]
        return (lifted_slope(scene, x, 1.0, scene.damped_within(x, 0.0, xp) is not None),) * self.each

    def advance(
        self, scene: Scene, x: OwnState, h: Arithmetic, n: Count, xp: Namespace, repeat: Repeat = repeat
    ) -> OwnState:
        return self.advance_beside(scene, x, h, n, xp, repeat)[0]

    def beside(self, scene: Scene, carry: Sequence[str]) -> int:
        """Return how many numbers are kept: evaluations, the last step, and the slopes that the next begins with."""
        return 2 + len(leaves(self.first(scene, scene.initial(tuple(carry)), math)))

    def advance_beside(
        self,
        scene: Scene,
        x: OwnState,
        h: Arithmetic,
        n: Count,
        xp: Namespace,
        repeat: Repeat = repeat,
        beside: Sequence[Arithmetic] = (),
    ) -> tuple[OwnState, Sequence[Arithmetic]]:
        """Return the state after n steps and the numbers beside it; none are given where a run begins."""

        def another(carried: tuple[OwnState, Arithmetic, Any]) -> tuple[OwnState, Arithmetic, Any]:
            x, spent, slopes = carried
            x, more, slopes = self.step(scene, x, h, xp, slopes)  # type: ignore[call-arg, misc]
            # a nan state costs no evaluations
            return x, spent + choose(more > 0, more, 0.0, xp), slopes

        slopes = self.first(scene, x, xp)
        spent, last, *kept = beside or (0.0 * h, 0.0, *leaves(slopes))
        going = abs(last - h) <= SAME * h  # a polynomial of other steps is no start
        chosen = (choose(going, old, new, xp) for old, new in zip(kept, leaves(slopes), strict=True))
        start = x, spent + 1.0, rebuild(slopes, list(chosen)) if beside else slopes
        x, spent, slopes = repeat.steps(n, another, start, h)
        return x, (spent, h, *leaves(slopes))

    def composed(self, scene: Scene) -> bool:
        return scene.is_contact

    def kind_on(self, scene: Scene) -> str:
        return "gradient" if in_positions(scene, scene.initial(()), math) else self.kind

    def counts(self, scene: Scene, n: int, carry: Sequence[str] | None = None) -> int:
        """Return a typical number of evaluations of n steps."""
        return n * TYPICAL * self.each + 1


@cache
def method_of(stages: int) -> ContactGauss:
    return ContactGauss(
        f"contact-gauss{2 * stages}",
        2 * stages,
        collocation(stages),
        about="Gauss's collocation on the symplectisation, a contact map for every H; Arnold, Appendix 4.E",
        family="contact",
        each=stages,
        contact=True,
        symmetric=True,
    )


def gauss(stages: int) -> ContactGauss:
    """Return Gauss's collocation method of any number of stages, a contact map for every contact Hamiltonian.

    Its order is twice the number of stages.  `METHODS` has those of 1, 2, 4 and 8 stages.

    Parameters
    ----------
    stages
        From 1 to 32.

    Returns
    -------
    ContactGauss
        The method, to be given to `solve` and `prepare` in place of a name.

    Raises
    ------
    BadInput
        For a number of stages that is not whole, or not from 1 to 32.

    Notes
    -----
    The nodes are the roots of Legendre's polynomial and the coefficients integrals of Lagrange's basis, at 50 digits
    or more: Hairer, Lubich, Wanner, Geometric Numerical Integration, §II.1.3, doi:10.1007/3-540-30666-8.

    Examples
    --------
    >>> import contactbench as cb
    >>> cb.gauss(5).order
    10
    """
    return method_of(whole("stages", stages, MOST_STAGES))


for _stages in (1, 2, 4, 8):
    METHODS.add(method_of(_stages))
