"""Gauss's collocation on the symplectisation: a contact map of (q, p, s) for every contact Hamiltonian.

With P = r p and K = r H(q, P/r, s), Hamilton's equations of ω = dr∧ds − dP∧dq are

    q' = H_p,   P' = −r H_q,   s' = p·H_p − H,   r' = r H_s.

Collocation at Gauss's nodes preserves ω (Hairer, Lubich, Wanner, Geometric Numerical Integration, §VI.4) and commutes
with the linear scaling (P, r) ↦ (λP, λr), hence preserves r ds − P·dq = r η: the map of (q, p, s) has Φ*η = (r₀/r₁) η
(the symplectisation: Arnold, Mathematical Methods of Classical Mechanics, Appendix 4.E).  r is 1 where a step begins.

If ∂H/∂s depends on the time alone, H = h(q, p, t) + γ(t) s, then r = e^{∫γ} is known.  In this case (q, P) and the
action S = r s, S' = P·q' − r h, are integrated.  The conformal factor is then exact, and strong damping does not slow
down the iteration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from contactbench.methods.base import METHODS, unfit
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.implicit import (
    LOST,
    TYPICAL,
    bare,
    eliminated,
    fixed_point,
    found,
    gauss_tableau,
    implicit,
    jacobian,
    otherwise,
    solved,
)
from contactbench.numbers.control import Repeat, choose, repeat
from contactbench.numbers.dual import leaves, rebuild
from contactbench.numbers.protocol import Arithmetic, Condition, Count, Namespace, Vector
from contactbench.scene import Scene
from contactbench.scene.base import OwnState
from contactbench.scene.flow import damping

#: most equations of Newton's iteration: more take seconds to compile
ELIMINATED = 24


class Lifted(NamedTuple):
    """q, P, s (S if r is known) and r (None if it is known), or their slopes; s is None if it is not carried."""

    q: Vector
    P: Vector
    s: Any
    r: Any


def components(z: Lifted) -> list[Arithmetic]:
    """Return all components as a list; dual numbers stay whole."""
    return [*z.q, *z.P, *(c for c in (z.s, z.r) if c is not None)]


def with_components(z: Lifted, values: Sequence[Arithmetic]) -> Lifted:
    n, rest = len(z.q), iter(values[2 * len(z.q) :])
    s, r = (None if c is None else next(rest) for c in (z.s, z.r))
    return Lifted(tuple(values[:n]), tuple(values[n : 2 * n]), s, r)


def slope_at(scene: Any, x: OwnState, r: Arithmetic, known: bool) -> Lifted:
    """Return the slope of the lifted equations at a state; known : r is a function of the time alone."""
    rate, k = scene.damping_at(x), scene.rhs(x)
    P = tuple(r * (f + rate * p) for f, p in zip(k.p, x.p, strict=True))
    if known:
        return Lifted(k.q, P, None if x.s is None else r * (k.s + rate * x.s), None)
    return Lifted(k.q, P, k.s, r * rate)


def combined(start: Lifted, weights: Sequence[Arithmetic], slopes: Sequence[Lifted], h: Arithmetic) -> Lifted:
    """Return start + h Σ w k."""
    columns = zip(leaves(start), *map(leaves, slopes), strict=True)
    made: Lifted = rebuild(
        start, [c + h * sum(w * k for w, k in zip(weights, ks, strict=True)) for c, *ks in columns]
    )
    return made


def extrapolated(slopes: Sequence[Lifted], nodes: Sequence[Arithmetic], r: Arithmetic) -> tuple[Lifted, ...]:
    """Return the collocation polynomial's slopes at the nodes of the next step, where r is 1 again."""
    nothing, found = rebuild(slopes[0], [0 * c for c in leaves(slopes[0])]), []
    for c in nodes:
        others = [[(1 + c - b) / (a - b) for b in nodes if b is not a] for a in nodes]
        k = combined(nothing, [math.prod(row, start=c / c) for row in others], slopes, 1)
        known = k.r is None
        s = k.s / r if known and k.s is not None else k.s
        found.append(Lifted(k.q, tuple(P / r for P in k.P), s, None if known else k.r / r))
    return tuple(found)


Step = Callable[..., tuple[OwnState, Arithmetic, tuple[Lifted, ...]]]


def collocation(stages: int) -> Step:
    """Return a step of so many stages: from x and initial slopes to x, evaluations and slopes for the next step."""

    def step(
        scene: Any, x: OwnState, h: Arithmetic, xp: Namespace, slopes: tuple[Lifted, ...]
    ) -> tuple[OwnState, Arithmetic, tuple[Lifted, ...]]:
        A, b = gauss_tableau(stages, xp)
        nodes = [sum(row[1:], row[0]) for row in A]
        known = slopes[0].r is None
        start = Lifted(x.q, x.p, x.s, None if known else 1 + 0 * x.p[0])
        grown = [xp.exp(scene.damped_within(x, c * h, xp)) for c in nodes] if known else []

        def state(z: Lifted, p: Vector, s: Any, c: Arithmetic) -> OwnState:
            y = x._replace(q=z.q, p=p, s=s)
            return y if scene.clock is None else y._replace(t=x.t + c * h)

        def stage(slopes: Sequence[Lifted], i: int) -> tuple[OwnState, Arithmetic]:
            z = combined(start, A[i], slopes, h)
            r = grown[i] if known else z.r
            s = x.s if known else z.s  # S' does not depend on s
            return state(z, tuple(P / r for P in z.P), s, nodes[i]), r

        def update(slopes: tuple[Lifted, ...]) -> tuple[Lifted, ...]:
            if scene.separable:  # velocities of the new momenta: it converges faster
                momenta = [stage(slopes, i)[0].p for i in range(stages)]
                pairs = zip(slopes, momenta, strict=True)
                slopes = tuple(k._replace(q=tuple(scene.velocity(p))) for k, p in pairs)
            return tuple(slope_at(scene, *stage(slopes, i), known) for i in range(stages))

        def newton() -> tuple[tuple[Lifted, ...], Condition, Arithmetic]:
            """Solve by simplified Newton iteration with the Jacobian at the begin of the step."""

            def slope(values: Sequence[Arithmetic]) -> Sequence[Arithmetic]:
                z = with_components(start, values)
                r = 1.0 if known else z.r
                p = z.P if known else tuple(P / r for P in z.P)
                return components(slope_at(scene, state(z, p, x.s if known else z.s, 0), r, known))

            J, span = jacobian(slope, components(start)), bare(h)
            scales = [[1.0] * len(x.q) + [bare(r)] * (size - len(x.q)) for r in grown or (1.0,) * stages]
            matrix = [
                [
                    float(i == j and a == b) - span * bare(A[i][j]) * (J[a][b] * scale[a] / scale[b])
                    for j in range(stages)
                    for b in range(size)
                ]
                for i, scale in enumerate(scales)
                for a in range(size)
            ]
            factors = eliminated(matrix)

            def improved(slopes: tuple[Lifted, ...]) -> tuple[Lifted, ...]:
                there = [c for k in slopes for c in components(k)]
                here = [
                    c for i in range(stages) for c in components(slope_at(scene, *stage(slopes, i), known))
                ]
                change = solved(factors, [a - b for a, b in zip(there, here, strict=True)])
                again = [a - d for a, d in zip(there, change, strict=True)]
                return tuple(
                    with_components(k, again[i * size : (i + 1) * size]) for i, k in enumerate(slopes)
                )

            first = (slope_at(scene, x, 1.0, known),) * stages
            slopes, converged, turns = fixed_point(improved, first, xp, moves=abs(h), lost=lost)
            return slopes, converged, stages * turns + (size + 2)

        size, lost = len(components(start)), LOST * sum(map(abs, leaves(start)))

        def solve(slopes: tuple[Lifted, ...]) -> tuple[tuple[Lifted, ...], Condition, Arithmetic]:
            slopes, converged, turns = fixed_point(update, slopes, xp, moves=abs(h), lost=lost)
            found = slopes, converged, stages * turns
            return otherwise(found, newton, xp) if stages * size <= ELIMINATED else found

        slopes, converged, spent = implicit(update, solve, slopes, xp)
        z = combined(start, b, slopes, h)
        if known:  # a small loss is subtracted, whose rounding is small too
            G = scene.damped_within(x, h, xp)
            r, (keep, lose) = xp.exp(G), damping(G, 1.0, xp)
            p, s = tuple(keep * P - lose * P for P in z.P), None if z.s is None else keep * z.s - lose * z.s
        else:
            r, p, s = z.r, tuple(P / z.r for P in z.P), z.s
        return found(state(z, p, s, 1), converged, xp), spent, extrapolated(slopes, nodes, r)

    return step


@dataclass(frozen=True)
class ContactGauss(FixedStep):
    """Collocation on the symplectisation; the first iteration of a run starts from the slope there, one evaluation.

    each : evaluations per iteration.
    """

    each: int = field(kw_only=True)
    engines: tuple[str, ...] = ("llvm", "python")
    iterates = True
    unsolved = "its iteration does not converge"

    def refuses(self, scene: Scene) -> str | None:
        return unfit(self, scene, scene.canonical, "canonical coordinates (q, p, s)")

    def first(self, scene: Scene, x: OwnState, xp: Namespace) -> tuple[Lifted, ...]:
        known = scene.damped_within(x, 0.0, xp) is not None
        return (slope_at(scene, x, 1.0, known),) * self.each

    def advance(
        self, scene: Scene, x: OwnState, h: Arithmetic, n: Count, xp: Namespace, repeat: Repeat = repeat
    ) -> OwnState:
        return self.advance_counted(scene, x, h, n, xp, repeat)[0]

    def advance_counted(
        self, scene: Scene, x: OwnState, h: Arithmetic, n: Count, xp: Namespace, repeat: Repeat = repeat
    ) -> tuple[OwnState, Arithmetic]:
        """Return the state after n steps and the evaluations they took."""

        def another(carried: tuple[OwnState, Arithmetic, Any]) -> tuple[OwnState, Arithmetic, Any]:
            x, spent, slopes = carried
            x, more, slopes = self.step(scene, x, h, xp, slopes)  # type: ignore[call-arg, misc]
            # a nan state costs no evaluations
            return x, spent + choose(more > 0, more, 0.0, xp), slopes

        start = x, 1.0 + 0 * h, self.first(scene, x, xp)
        x, spent, _ = repeat.steps(n, another, start, h)
        return x, spent

    def composed(self, scene: Scene) -> bool:
        return scene.is_contact

    def counts(self, scene: Scene, n: int, carry: Sequence[str] | None = None) -> int:
        """Return a typical number of evaluations of n steps."""
        return n * TYPICAL * self.each + 1


_about = "Gauss's collocation on the symplectisation, a contact map for every H; Arnold, Appendix 4.E"
for _stages in (1, 2, 3):
    METHODS.add(
        ContactGauss(
            f"contact-gauss{2 * _stages}",
            2 * _stages,
            collocation(_stages),
            about=_about,
            family="contact",
            each=_stages,
            contact=True,
            symmetric=True,
        )
    )
