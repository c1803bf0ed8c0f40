"""Gauss's collocation on the symplectisation: a contact map of (q, p, s) for every contact Hamiltonian.

With P = r p and K = r H(q, P/r, s), Hamilton's equations of ω = dr∧ds − dP∧dq are

    q' = H_p,   P' = −r H_q,   s' = p·H_p − H,   r' = r H_s.

Collocation at Gauss's nodes preserves ω (Hairer, Lubich, Wanner, Geometric Numerical Integration, §VI.4) and commutes
with the linear scaling (P, r) ↦ (λP, λr), hence preserves r ds − P·dq = r η: the map of (q, p, s) has Φ*η = (r₀/r₁) η
(the symplectisation: Arnold, Mathematical Methods of Classical Mechanics, Appendix 4.E).  r is 1 where a step begins.

Where ∂H/∂s does not follow the motion, r is known, e^{∫∂H/∂s}: K then depends on the time, and (q, P) with the action
S = r s, S' = P·q' − r h, are integrated, H = h(q, p, t) + γ(t) s.  The factor is that of the exact flow, and however
strong the damping, it does not slow down the iteration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from contactbench.methods.base import METHODS, unfit
from contactbench.methods.implicit import TYPICAL, Implicit, fixed_point, found, gauss_tableau
from contactbench.numbers.control import Repeat, repeat
from contactbench.numbers.dual import leaves
from contactbench.numbers.protocol import Arithmetic, Count, Namespace, Vector
from contactbench.scene import Scene
from contactbench.scene.base import OwnState
from contactbench.scene.flow import damping


class Slope(NamedTuple):
    """q', P', s', or S' where r is known, and r', where it is not; of what is not there None."""

    q: Vector
    P: Vector
    s: Any
    r: Any


def slope_at(scene: Any, x: OwnState, r: Arithmetic, known: bool) -> Slope:
    """Return the slope of the lifted equations at a state of the scene; known : r is a function of the time."""
    rate, k = scene.damping_at(x), scene.rhs(x)
    P = tuple(r * (f + rate * p) for f, p in zip(k.p, x.p, strict=True))
    if known:
        return Slope(k.q, P, None if x.s is None else r * (k.s + rate * x.s), None)
    return Slope(k.q, P, k.s, r * rate)


def combined(start: Vector, weights: Sequence[Arithmetic], slopes: Sequence[Vector], h: Arithmetic) -> Vector:
    """Return start + h Σ w k, component by component."""
    columns = zip(start, *slopes, strict=True)
    return tuple(c + h * sum(w * k for w, k in zip(weights, ks, strict=True)) for c, *ks in columns)


def extrapolation(nodes: Sequence[Arithmetic]) -> list[list[Arithmetic]]:
    """Return the weights with which slopes at the nodes of a step are those at the nodes of the next one."""
    rows = []
    for c in nodes:
        row = []
        for j, own in enumerate(nodes):
            weight = own / own
            for k, other in enumerate(nodes):
                weight = weight * (1 + c - other) / (own - other) if k != j else weight
            row.append(weight)
        rows.append(row)
    return rows


Step = Callable[..., tuple[OwnState, Arithmetic, tuple[Slope, ...], Arithmetic]]


def collocation(stages: int) -> Step:
    """Return a step from x and the slopes to start with: x, iterations, slopes to start the next with, and r₁."""

    def step(
        scene: Any, x: OwnState, h: Arithmetic, xp: Namespace, slopes: tuple[Slope, ...]
    ) -> tuple[OwnState, Arithmetic, tuple[Slope, ...], Arithmetic]:
        A, b = gauss_tableau(stages, xp)
        nodes = [sum(row[1:], row[0]) for row in A]
        known = slopes[0].r is None
        spent = [scene.damped_within(x, c * h, xp) for c in nodes] if known else []
        grown, end = [xp.exp(G) for G in spent], scene.damped_within(x, h, xp)
        keep, lose = damping(end, 1.0, xp) if known else (1.0, 0.0)

        def lifted(weights: Sequence[Arithmetic], slopes: Sequence[Slope]) -> tuple[Vector, Vector, Any, Any]:
            q, P = (
                combined(x.q, weights, [k.q for k in slopes], h),
                combined(x.p, weights, [k.P for k in slopes], h),
            )
            s = None if x.s is None else combined((x.s,), weights, [(k.s,) for k in slopes], h)[0]
            return q, P, s, None if known else combined((1.0,), weights, [(k.r,) for k in slopes], h)[0]

        def stage(slopes: Sequence[Slope], i: int) -> tuple[OwnState, Arithmetic]:
            q, P, s, r = lifted(A[i], slopes)
            if known:  # S' does not depend on s
                s, r = x.s, grown[i]
            y = x._replace(q=q, p=tuple(c / r for c in P), s=s)
            return (y if scene.clock is None else y._replace(t=x.t + nodes[i] * h)), r

        def update(slopes: tuple[Slope, ...]) -> tuple[Slope, ...]:
            if scene.separable:  # with velocities of momenta that are known already it converges faster
                momenta = [stage(slopes, i)[0].p for i in range(stages)]
                pairs = zip(slopes, momenta, strict=True)
                slopes = tuple(k._replace(q=tuple(scene.velocity(p))) for k, p in pairs)
            return tuple(slope_at(scene, *stage(slopes, i), known) for i in range(stages))

        slopes, converged, turns = fixed_point(update, slopes, xp, patient=True)
        q, P, s, r = lifted(b, slopes)
        if known:  # little is lost: the rounding of the factor is that of the loss
            y, r = x._replace(q=q, p=tuple(keep * c - lose * c for c in P)), xp.exp(end)
            y = y._replace(s=None if s is None else keep * s - lose * s)
        else:
            y = x._replace(q=q, p=tuple(c / r for c in P), s=s)
        if scene.clock is not None:
            y = y._replace(t=x.t + h)
        return found(y, converged, xp), turns, carried_on(slopes, extrapolation(nodes), r, known), r

    return step


def carried_on(
    slopes: Sequence[Slope], rows: list[list[Arithmetic]], r: Arithmetic, known: bool
) -> tuple[Slope, ...]:
    """Return the collocation polynomials' slopes at the nodes of the next step, where r is 1 again."""

    def ahead(parts: Sequence[Vector], row: Sequence[Arithmetic], over: Arithmetic) -> Vector:
        return combined(tuple(0 * c for c in parts[0]), row, parts, over)

    one, over = r / r, 1 / r
    found = []
    for row in rows:
        s = None if slopes[0].s is None else ahead([(k.s,) for k in slopes], row, over if known else one)[0]
        rate = None if known else ahead([(k.r,) for k in slopes], row, over)[0]
        q, P = ahead([k.q for k in slopes], row, one), ahead([k.P for k in slopes], row, over)
        found.append(Slope(q, P, s, rate))
    return tuple(found)


@dataclass(frozen=True)
class ContactGauss(Implicit):
    """Collocation on the symplectisation; a run starts from the slope at its beginning, one evaluation."""

    unsolved = "its fixed-point iteration does not converge"

    def refuses(self, scene: Scene) -> str | None:
        return unfit(self, scene, scene.canonical, "canonical coordinates (q, p, s)")

    def first(self, scene: Scene, x: OwnState, xp: Namespace) -> tuple[Slope, ...]:
        known = scene.damped_within(x, 0.0, xp) is not None
        return (slope_at(scene, x, 1.0, known),) * self.each

    def advance_counted(
        self, scene: Scene, x: OwnState, h: Arithmetic, n: Count, xp: Namespace, repeat: Repeat = repeat
    ) -> tuple[OwnState, Arithmetic]:
        def another(carried: tuple[OwnState, Arithmetic, Any]) -> tuple[OwnState, Arithmetic, Any]:
            x, spent, slopes = carried
            x, turns, slopes, _ = self.step(scene, x, h, xp, slopes)  # type: ignore[call-arg, misc]
            return x, spent + self.each * turns, slopes

        x, spent, _ = repeat(n, another, (x, 0 * leaves(x)[0] + 1.0, self.first(scene, x, xp)))
        return x, spent

    def log_factor(self, scene: Scene, x: OwnState, h: float, n: int) -> float | None:
        if self.refuses(scene) is not None:
            return None
        if scene.conformal_rate is not None:
            return super().log_factor(scene, x, h, n)
        total, slopes = 0.0, self.first(scene, x, math)
        for _ in range(n):
            x, _, slopes, r = self.step(scene, x, h, math, slopes)  # type: ignore[call-arg, misc]
            total -= math.log(r) if r > 0 else math.nan
        return total

    def counts(self, scene: Scene, n: int, carry: Sequence[str] | None = None) -> int:
        return n * TYPICAL * self.each + 1


_about = (
    "Gauss's collocation on the symplectisation, a contact map for every H(q, p, s); Arnold, Appendix 4.E"
)
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
