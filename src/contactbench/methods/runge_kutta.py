"""Explicit Runge–Kutta and Runge–Kutta–Nyström methods, each a file of coefficients in `tableaux`.

Runge–Kutta methods step y' = f(y), whatever the scene is.  Runge–Kutta–Nyström methods step z'' = f(t, z), which a
motion with damping Γ = γ(t) s is in z = e^{G/2} q, G = ∫γ from the start of the step:

    z'' = (γ²/4 + γ'/2) z − e^{G/2} ∇V(e^{−G/2} z, t)/m,   z' = e^{G/2} u,   u = q' + γ q/2.

The action is a quadrature by the weights of z': s e^{G} = s₀ + ½ [e^{G} q·p] + ∫ e^{G} (½ q·∇V − V), of their order.
Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, §II.1 and §II.14.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache
from itertools import combinations_with_replacement
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

from contactbench.methods.base import METHODS
from contactbench.methods.fixed_step import FixedStep
from contactbench.numbers import quadrature
from contactbench.numbers.control import Repeat, repeat, settle
from contactbench.numbers.dual import leaves, rebuild
from contactbench.scene import Scene
from contactbench.scene.algebra import scaled
from contactbench.splitting.composition import number
from contactbench.trace.formula import Formula, formula

Row = tuple[Fraction, ...]
FOLDER = Path(__file__).parent / "tableaux"


@dataclass(frozen=True)
class Tableau:
    """Coefficients of an explicit method: row i of the matrix has those of the stages before stage i.

    weights : of y; of a Nyström method two rows, of z and of z'.  lower : those of the embedded formula, and its order.
    """

    source: str
    order: int
    nodes: Row
    matrix: tuple[Row, ...]
    weights: tuple[Row, ...]
    lower: tuple[Row, ...] = ()
    lower_order: int = 0

    @property
    def nystrom(self) -> bool:
        return len(self.weights) == 2

    @property
    def used(self) -> int:
        """Return how many stages the step itself needs; others are those of the embedded formula."""
        return max(i for row in self.weights for i, w in enumerate(row) if w) + 1

    @property
    def first_same_as_last(self) -> bool:
        return self.matrix[-1] == self.weights[0][:-1]

    @property
    def estimate(self) -> tuple[Row, ...]:
        """Return the weights of the difference between the step and the embedded formula."""
        pairs = zip(self.weights, self.lower, strict=True)
        return tuple(tuple(a - b for a, b in zip(*pair, strict=True)) for pair in pairs)


def read_tableau(name: str) -> Tableau:
    given = tomllib.loads((FOLDER / f"{name}.toml").read_text(encoding="utf-8"))

    def row(text: str) -> Row:
        return tuple(map(Fraction, text.split()))

    def rows(start: str) -> tuple[Row, ...]:
        return tuple(row(given[start + part]) for part in ("weights", "velocity_weights") if start + part in given)

    matrix = ((), *map(row, given["matrix"].splitlines()))
    orders = given["order"], given.get("lower", 0)
    return Tableau(given["source"], orders[0], row(given["nodes"]), matrix, rows(""), rows("lower_"), orders[1])


def combine(weights: Sequence[Fraction], slopes: Sequence[Sequence[Any]], xp: Any) -> list[Any]:
    """Return Σ w k, entry by entry; weights of later stages may be left out."""
    used = [(number(w, xp), k) for w, k in zip(weights, slopes, strict=False) if w]
    if not used:
        return [0.0] * len(slopes[0]) if slopes else []
    first, *others = used
    total = [first[0] * c for c in first[1]]
    for w, k in others:
        total = [a + w * c for a, c in zip(total, k, strict=True)]
    return total


# -- y' = f(y) -----------------------------------------------------------------------------------------
def explicit_slope(scene: Any, x: Any, xp: Any) -> list[Any]:
    return leaves(scene.rhs(x))


def explicit_step(
    tableau: Tableau, scene: Any, x: Any, h: Any, xp: Any, stages: int, first: Any = None
) -> tuple[Any, list[Any], list[list[Any]]]:
    """Return the state after a step, the slope of the last stage, and h times the slopes of all."""
    y, slopes, slope = leaves(x), [], first
    for row in tableau.matrix[:stages]:
        if slopes or first is None:
            moved = combine(row, slopes, xp) if slopes else [0.0] * len(y)
            at = rebuild(x, [a + d for a, d in zip(y, moved, strict=True)]) if slopes else x
            slope = settle(explicit_slope(scene, at, xp), xp)
        slopes.append([h * c for c in slope])
    change = combine(tableau.weights[0], slopes, xp)
    return rebuild(x, [a + d for a, d in zip(y, change, strict=True)]), slope, slopes


# -- z'' = f(t, z) -------------------------------------------------------------------------------------
class Undamped(NamedTuple):
    """q and u, which are z and z' where a step begins; the time, where the scene has one; and s − ½ q·p."""

    q: Any
    u: Any
    t: Any = None
    action: Any = None


class Pull(NamedTuple):
    """What a stage evaluates: e^{−G/2} z'', ½ q·∇V − V where s is carried, and γ'/2 where γ changes."""

    rate: Any
    action: Any = None
    turn: Any = None


class Factors(NamedTuple):
    """What a step of size h is made with: h² e^{G/2} and e^{−G/2} at every stage, 1 − e^{−G/2} at the end, and 1/h."""

    grown: tuple[Any, ...]
    shrunk: tuple[Any, ...]
    loss: Any
    frequency: Any


@lru_cache(64)
def rate_slope(rate: Any, names: tuple[str, ...]) -> Formula:
    """Return γ'(t); may raise `CannotRecord`."""
    return (rate if isinstance(rate, Formula) else formula(rate, (0,), names)).gradient()


def masses(scene: Any, q: Any) -> tuple[Any, ...]:
    one = tuple(1.0 + 0 * c for c in q) if scene.by_sites else (1.0,) * len(q)
    return tuple(1 / c for c in scene.velocity(one))


def at(scene: Any, q: Any, t: Any) -> Any:
    return scene.state(q=q, p=q, **({} if t is None else {"t": t}))


def undamped(scene: Any, x: Any) -> Undamped:
    half = scene.damping_at(x) / 2
    u = tuple(v + half * c for v, c in zip(scene.velocity(x.p), x.q, strict=True))
    s = x.s
    return Undamped(x.q, u, getattr(x, "t", None), None if s is None else s - scene.product(x.q, x.p) / 2)


def damped(scene: Any, y: Undamped) -> Any:
    x = at(scene, y.q, y.t)
    half = scene.damping_at(x) / 2
    v = (u - half * c for u, c in zip(y.u, y.q, strict=True))
    p = tuple(m * c for m, c in zip(masses(scene, y.q), v, strict=True))
    return x._replace(p=p, s=None if y.action is None else y.action + scene.product(y.q, p) / 2)


def factors_of(tableau: Tableau, scene: Any, t: Any, h: Any, xp: Any) -> Factors:
    """Return the factors of a step from t, which does not matter where γ is constant."""
    nodes = (*tableau.nodes, Fraction(1))
    if not scene.rate_changes:
        whole = scene.gamma * h / 2
        pairs = exponentials(nodes, whole, xp)
    else:
        if scene.span is not None:
            spent = [scene.spent(t, number(c, xp) * h, xp)[0] for c in nodes]
        else:
            spent = quadrature.running(scene.rate_at, t, h, nodes, tableau.order, xp)
        whole = spent[-1] / 2
        pairs = [(grown := xp.exp(each / 2), 1 / grown) for each in spent]
    grown, shrunk = (tuple(each) for each in zip(*pairs[:-1], strict=True))
    return Factors(tuple(h * h * each for each in grown), shrunk, -xp.expm1(-whole), 1 / h)


def exponentials(nodes: Sequence[Fraction], whole: Any, xp: Any) -> list[tuple[Any, Any]]:
    """Return e^{cx} and e^{−cx} for some c, those of a sum of two or three others as products."""
    one = 1.0 + 0 * whole
    found = {Fraction(0): (one, one)}
    for c in sorted(set(nodes) - found.keys()):
        sums = (terms for n in (2, 3) for terms in combinations_with_replacement(found, n) if sum(terms) == c)
        if (terms := next(sums, None)) is not None:
            found[c] = tuple(prod(found[term][k] for term in terms) for k in (0, 1))
        else:
            grown = xp.exp(number(c, xp) * whole)
            found[c] = grown, 1 / grown
    return [found[c] for c in nodes]


def pull(scene: Any, q: Any, t: Any, acts: bool) -> Pull:
    x = at(scene, q, t)
    gradient, gamma = tuple(scene.gradient_at(x)), scene.damping_at(x)
    stiffness, turn = gamma * gamma / 4, None
    if scene.rate_changes:
        turn = rate_slope(scene.rate, tuple(scene.parameters))(t, **scene.parameters)[0] / 2
        stiffness = stiffness + turn
    rate = tuple(stiffness * c - a for c, a in zip(q, scene.velocity(gradient), strict=True))
    return Pull(rate, scene.product(q, gradient) / 2 - scene.potential_at(x) if acts else None, turn)


class Stages(NamedTuple):
    """h² z'' of all stages; h e^{G} (½ q·∇V − V); h γ'/2."""

    slopes: list[Any]
    actions: list[Any]
    turns: list[Any]


def nystrom_step(
    tableau: Tableau, scene: Any, y: Undamped, h: Any, xp: Any, stages: int, first: Any = None, factors: Any = None
) -> tuple[Undamped, Any, Stages]:
    """Return the state after a step, the pull of the last stage, and what all stages have evaluated."""
    grown, shrunk, loss, frequency = factors or factors_of(tableau, scene, y.t, h, xp)
    way, acts, cube = [h * c for c in y.u], y.action is not None, frequency * frequency * frequency
    found, own = Stages([], [], []), first
    for i, row in enumerate(tableau.matrix[:stages]):
        c = number(tableau.nodes[i], xp)
        if i:
            z = [a + c * b for a, b in zip(y.q, way, strict=True)]
            z = [a + b for a, b in zip(z, combine(row, found.slopes, xp), strict=True)]
            own = pull(scene, scaled(shrunk[i], z), None if y.t is None else y.t + c * h, acts)
        elif first is None:
            own = pull(scene, y.q, y.t, acts)
        own = settle(own, xp)
        found.slopes.append(scaled(grown[i], own.rate))
        found.actions.append([cube * grown[i] * grown[i] * own.action] if acts else [])
        found.turns.append([] if own.turn is None else [h * own.turn])
    position, velocity = (combine(row, found.slopes, xp) for row in tableau.weights)
    z = [a + (b + d) for a, b, d in zip(y.q, way, position, strict=True)]
    q = tuple(a - loss * a for a in z)
    u = tuple(a + frequency * d for a, d in zip(y.u, velocity, strict=True))
    u = tuple(a - loss * a for a in u)
    t = None if y.t is None else y.t + h
    if scene.rate_changes:  # of order h^order where γ is smooth, and what a jump of γ does to u where it is not
        before, after = (scene.damping_at(at(scene, y.q, time)) / 2 for time in (y.t, t))
        jump = after - before - combine(tableau.weights[1], found.turns, xp)[0]
        u = tuple(a + jump * c for a, c in zip(u, q, strict=True))
    action = y.action
    if acts:
        action = action + combine(tableau.weights[1], found.actions, xp)[0]
        action = action - loss * (2 - loss) * action
    return Undamped(q, u, t, action), own, found


@dataclass(frozen=True)
class RungeKutta(FixedStep):
    """A step of a tableau, of y, or of z where it is a Nyström method."""

    tableau: Tableau = field(kw_only=True)

    def refuses(self, scene: Scene) -> str | None:
        return refusal(self.name, self.tableau, scene)

    def advance(self, scene: Any, x: Any, h: Any, n: Any, xp: Any, repeat: Repeat = repeat) -> Any:
        tableau, stages = self.tableau, self.tableau.used
        if not tableau.nystrom:
            return repeat(n, lambda x: explicit_step(tableau, scene, x, h, xp, stages)[0], x)
        factors = None if scene.rate_changes else factors_of(tableau, scene, None, h, xp)
        another = lambda y: nystrom_step(tableau, scene, y, h, xp, stages, factors=factors)[0]  # noqa: E731
        return damped(scene, repeat(n, another, undamped(scene, x)))


def refusal(name: str, tableau: Tableau, scene: Any) -> str | None:
    """Return why a scene is out of reach, or None."""
    if not tableau.nystrom:
        return None
    if scene.kind not in ("mechanical", "driven", "many") or scene.nonlinear_damping:
        return f"{name} needs a configuration q in Rⁿ and damping Γ = γ s, which scene {scene.name!r} does not have"
    if scene.clock is not None and "rate" in scene.functions_of_floats:
        return f"{name} needs γ'(t), and the rate of scene {scene.name!r} cannot be recorded"
    return scene.own_equations


def runge_kutta(name: str, tableau: Tableau, about: str) -> RungeKutta:
    def step(scene: Any, x: Any, h: Any, xp: Any) -> Any:
        return METHODS[name].advance(scene, x, h, 1, xp)

    kind = "gradient" if tableau.nystrom else "rhs"
    return RungeKutta(name, tableau.order, step, tableau.used, kind, f"{about}; {tableau.source}", tableau=tableau)


RKN8, RKN12, RK8 = map(read_tableau, ("rkn8-6", "rkn12-10", "rk8"))
METHODS.add(runge_kutta("rk4", read_tableau("rk4"), "classical Runge–Kutta"))
METHODS.add(runge_kutta("rk8", RK8, "explicit Runge–Kutta"))
METHODS.add(runge_kutta("rkn8", RKN8, "explicit Runge–Kutta–Nyström on z = e^{γt/2} q"))
METHODS.add(runge_kutta("rkn12", RKN12, "explicit Runge–Kutta–Nyström on z = e^{γt/2} q"))
