"""Explicit Runge–Kutta and Runge–Kutta–Nyström methods, each a file of coefficients in `tableaux`.

Runge–Kutta methods solve y' = f(y).  For a body with isotropic damping, which only slows the clock of the motion, they
integrate e^{γt} M, which is undamped in the time τ = (1 − e^{−γt})/γ.  Runge–Kutta–Nyström methods solve z'' = f(t, z):
a motion with damping Γ = γ(t) s has this form in z = e^{G/2} q, G = ∫γ from the start of the step,

    z'' = (γ²/4 + γ'/2) z − e^{G/2} ∇V(e^{−G/2} z, t)/m,   z' = e^{G/2} u,   u = q' + γ q/2.

The action is a quadrature with the weights of z', of the same order: s e^{G} = s₀ + ½ [e^{G} q·p] +
∫ e^{G} (½ q·∇V − V).
Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, §II.1 and §II.14.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache, cached_property, lru_cache
from itertools import combinations_with_replacement
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

from contactbench.methods.base import METHODS, Method, unfit
from contactbench.methods.fixed_step import FixedStep
from contactbench.numbers import quadrature
from contactbench.numbers.control import Repeat, repeat, settle
from contactbench.numbers.dual import leaves, rebuild
from contactbench.numbers.protocol import Arithmetic, Count, Namespace, Vector
from contactbench.scene import Scene, State
from contactbench.scene.algebra import DrivenState, dot, scaled
from contactbench.scene.base import OwnState
from contactbench.scene.flow import damped_time
from contactbench.scene.mechanical import Mechanical
from contactbench.splitting.composition import number
from contactbench.trace.formula import Formula, formula

Row = tuple[Fraction, ...]
#: from weights to the weighted sum of the slopes of all stages
Slopes = Callable[[Row], Sequence[Arithmetic]]
#: the values of the last stage, if they are needed
Own = Sequence[Arithmetic] | None
FOLDER = Path(__file__).parent / "tableaux"
#: the stages of a step are written out, which is fastest, for states of up to this many numbers
SMALL = 24


@dataclass(frozen=True)
class Tableau:
    """Coefficients of an explicit method; row i of the matrix has the coefficients of the stages before stage i.

    weights : one row for y, or two rows, for z and z', of a Nyström method.  lower, lower_order : the weights and the
    order of the embedded formula.
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
        """Return the number of stages of the step without the embedded formula."""
        return max(i for row in self.weights for i, w in enumerate(row) if w) + 1

    @cached_property
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
        return tuple(
            row(given[start + part]) for part in ("weights", "velocity_weights") if start + part in given
        )

    matrix = ((), *map(row, given["matrix"].splitlines()))
    orders = given["order"], given.get("lower", 0)
    return Tableau(
        given["source"], orders[0], row(given["nodes"]), matrix, rows(""), rows("lower_"), orders[1]
    )


def combine(
    weights: Sequence[Fraction | Arithmetic],
    slopes: Sequence[Sequence[Arithmetic]],
    xp: Namespace,
    begin: Begin | None = None,
) -> list[Arithmetic]:
    """Return Σ w k, entry by entry, over the stages that have a weight; begin : see `run_stages`."""
    used = [(j, number(w, xp) if isinstance(w, Fraction) else w) for j, w in enumerate(weights) if w]
    if begin is None:
        (j, w), *used = used
        total = [w * c for c in slopes[j]]
    else:
        total = list(begin.start)
        used = [(j, w * begin.factors[j]) for j, w in used]
    for j, w in used:
        total = [a + w * c for a, c in zip(total, slopes[j], strict=False)]
    return total


class Begin(NamedTuple):
    """The first term of the sum that a stage starts from, and the factors of the values of the stages before."""

    start: Sequence[Arithmetic]
    factors: Sequence[Arithmetic]


class Carried(NamedTuple):
    """Variables of a loop over stages: the number of the next stage, the last slope, and the values of that stage."""

    stage: Count
    last: Sequence[Arithmetic]
    own: Own


def run_stages(
    tableau: Tableau,
    stages: int,
    evaluate: Callable[[Count, Sequence[Arithmetic] | None], tuple[Sequence[Arithmetic], Own]],
    base: Sequence[tuple[Row, Sequence[Arithmetic]]],
    begins: Callable[[int], Begin],
    xp: Any,
    loop: Repeat | None = None,
    first: tuple[Sequence[Arithmetic], Own] | None = None,
) -> tuple[Slopes, Own]:
    """Return the function that sums the slopes of all stages by weights, and the values of the last stage.

    ``evaluate(i, Σ a k)`` returns the slope and the values of stage i; its argument is None at the first stage.
    first : the result of the first stage, if it is known.  loop : run the stages as one loop over rows, whose code is
    short and fast for large states; then Σ a k includes `base`, rows like a slope with a weight for every stage.  Else
    the sums begin as `begins` says, so that nothing but one product and one sum waits for the last values.
    """
    if loop is None or loop.rows is None:
        slope, own = evaluate(0, None) if first is None else first
        known = [slope]
        values: list[Any] = [own]
        for i, row in enumerate(tableau.matrix[1:stages], start=1):
            slope, own = settle(evaluate(i, combine(row, values, xp, begins(i))), xp)
            known.append(slope)
            values.append(own)
        return lambda weights: combine(weights, known, xp), own
    given, none = len(base), (Fraction(0),)
    size, begin = given + stages, Carried(0, base[-1][1], None)
    rows = loop.rows(size, begin.last)
    for k, (_, given_by) in enumerate(base):
        rows[k] = given_by
    if first is not None:
        begin = Carried(1, *first)

    def column(weights: Iterable[Fraction]) -> Any:
        return xp.asarray([number(w, xp) for w in weights])

    def plus(total: Sequence[Arithmetic], weight: Arithmetic, row: Sequence[Arithmetic]) -> list[Arithmetic]:
        return [a + weight * b for a, b in zip(total, row, strict=True)]

    matrix = tableau.matrix[:stages]
    padded = ((*(w[i] for w, _ in base), *row, *none * stages)[:size] for i, row in enumerate(matrix))
    square, latest = (
        column(w for row in padded for w in row),
        column([*none, *(row[-1] for row in matrix[1:])]),
    )

    # the latest row is added separately, so that the sum of the others need not wait for it
    def another(carried: Carried) -> Carried:
        i, last, own = carried
        total = rows.combine(square, size * i, given - 1 + i, given)
        rows[given - 1 + i] = last
        slope, new = evaluate(i, plus(total, latest[i], last))
        return Carried(i + 1, slope, None if own is None else new)

    _, last, own = loop(stages - (first is not None), another, begin)

    def slopes(weights: Row) -> Sequence[Arithmetic]:
        *others, end = weights[:stages]
        return plus(rows.combine(column((*none * given, *others)), 0, size - 1, given), number(end, xp), last)

    return slopes, own


def table(values: Sequence[Fraction], xp: Any, loop: Repeat | None) -> Any:
    """Return constants of the stages as a list, or as an array that a loop can index."""
    return [number(v, xp) for v in values] if loop is None else xp.asarray([number(v, xp) for v in values])


# -- y' = f(y) -----------------------------------------------------------------------------------------
def explicit_step[X](
    tableau: Tableau,
    scene: Scene,
    x: X,
    h: Arithmetic,
    xp: Namespace,
    stages: int,
    loop: Repeat | None = None,
    first: Sequence[Arithmetic] | None = None,
) -> tuple[X, Slopes]:
    """Return the state after a step, and the sums of h times the slopes; first : the slope at the start."""
    y = leaves(x)

    def evaluate(i: Count, moved: Sequence[Arithmetic] | None) -> tuple[list[Arithmetic], Own]:
        return both(leaves(scene.rhs(x if moved is None else rebuild(x, moved))))

    def both(rate: Sequence[Arithmetic]) -> tuple[list[Arithmetic], Own]:
        return [h * c for c in rate], None if loop else rate

    begin, base = Begin(y, [h] * stages), [((Fraction(1),) * stages, y)]
    known = None if first is None else both(first)
    slopes, _ = run_stages(tableau, stages, evaluate, base, lambda _: begin, xp, loop, known)
    return rebuild(x, [a + d for a, d in zip(y, slopes(tableau.weights[0]), strict=True)]), slopes


def undamped_twin(scene: Any) -> Any:
    """Return the scene without its damping, which only slows its clock."""
    return scene._replaced(gamma=0.0)


# -- z'' = f(t, z) -------------------------------------------------------------------------------------
class Undamped(NamedTuple):
    """q and u (z and z' at the start of a step), the time if the scene has one, and s − ½ q·p."""

    q: Vector
    u: Vector
    t: Arithmetic | None = None
    action: Arithmetic | None = None


class Factors(NamedTuple):
    """At every stage: e^{G/2}, h e^{G/2}, e^{−G/2}, h e^{−G/2}, c h e^{−G/2}; at the end of the step: 1 − e^{−G/2}."""

    grown: Vector
    pushed: Vector
    shrunk: Vector
    way: Vector
    far: Vector
    loss: Arithmetic


@lru_cache(64)
def rate_slope(rate: Callable[..., Arithmetic], names: tuple[str, ...]) -> Formula:
    """Return γ'(t); may raise `CannotRecord`."""
    return (rate if isinstance(rate, Formula) else formula(rate, (0,), names)).gradient()


def masses(scene: Mechanical, q: Vector) -> Vector:
    return tuple(1 / c for c in scene.velocity((1.0,) * len(q)))


def at(scene: Mechanical, q: Vector, t: Arithmetic | None) -> OwnState:
    return scene.state(q=q, p=q, **({} if t is None else {"t": t}))


def undamped(scene: Mechanical, x: State | DrivenState) -> Undamped:
    half = scene.damping_at(x) / 2
    u = tuple(v + half * c for v, c in zip(scene.velocity(x.p), x.q, strict=True))
    s = x.s
    return Undamped(x.q, u, getattr(x, "t", None), None if s is None else s - dot(x.q, x.p) / 2)


def damped(scene: Mechanical, y: Undamped) -> OwnState:
    x = at(scene, y.q, y.t)
    half = scene.damping_at(x) / 2
    v = (u - half * c for u, c in zip(y.u, y.q, strict=True))
    p = tuple(m * c for m, c in zip(masses(scene, y.q), v, strict=True))
    return x._replace(p=p, s=None if y.action is None else y.action + dot(y.q, p) / 2)


def factors_of(tableau: Tableau, scene: Any, t: Any, h: Any, xp: Any) -> Factors:
    """Return the factors of a step from t; t has no effect where γ is constant."""
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
    grown, shrunk = zip(*pairs[:-1], strict=True)
    pushed, way = (tuple(h * c for c in each) for each in (grown, shrunk))
    far = tuple(number(c, xp) * w for c, w in zip(nodes, way, strict=False))
    return Factors(grown, pushed, shrunk, way, far, -xp.expm1(-whole))


@cache
def sums(nodes: tuple[Fraction, ...]) -> dict[Fraction, tuple[Fraction, ...]]:
    """Return the nonzero nodes in order, each with two or three smaller nodes that add up to it, if there are any."""
    found: dict[Fraction, tuple[Fraction, ...]] = {}
    for c in sorted({*nodes} - {Fraction(0)}):
        tried = (
            terms for n in (2, 3) for terms in combinations_with_replacement(found, n) if sum(terms) == c
        )
        found[c] = next(tried, ())
    return found


def exponentials(nodes: tuple[Fraction, ...], whole: Arithmetic, xp: Namespace) -> list[Vector]:
    """Return e^{cx} and e^{−cx} for the nodes c; nodes that are sums of others by products."""
    one = 1.0 + 0 * whole
    found: dict[Fraction, Vector] = {Fraction(0): (one, one)}
    for c, terms in sums(nodes).items():
        if terms:
            found[c] = tuple(prod(found[term][k] for term in terms) for k in (0, 1))
        else:
            grown = xp.exp(number(c, xp) * whole)
            found[c] = grown, 1 / grown
    return [found[c] for c in nodes]


def pull(scene: Any, q: Vector, t: Arithmetic | None, acts: bool) -> list[Arithmetic]:
    """Return the values of a stage: e^{−G/2} z''; ½ q·∇V − V if s is carried; γ'/2 if γ changes."""
    x = at(scene, q, t)
    gradient, gamma = tuple(scene.gradient_at(x)), scene.damping_at(x)
    stiffness, turn = gamma * gamma / 4, []
    if scene.rate_changes:
        slope = rate_slope(scene.rate, tuple(scene.parameters))
        turn = [slope(scene.time(t), **scene.parameters)[0] / 2]
        stiffness = stiffness + turn[0]
    rate = [stiffness * c - a for c, a in zip(q, scene.velocity(gradient), strict=True)]
    action = [dot(q, gradient) / 2 - scene.potential_at(x)] if acts else []
    return [*rate, *action, *turn]


def factors_by_stage(
    tableau: Tableau, factors: Factors, h: Arithmetic, xp: Namespace, loop: Repeat | None
) -> Callable[[Count], Sequence[Arithmetic]]:
    """Return a function from the number of a stage to its factors and its time since the start of the step."""
    columns = [*factors[:-1], tuple(number(c, xp) * h for c in tableau.nodes)]
    stages: Any = list(zip(*columns, strict=True))
    if loop is None or loop.rows is None:
        return stages.__getitem__  # type: ignore[no-any-return]
    rows = loop.rows(len(stages), stages[0])
    for i, row in enumerate(stages):
        rows[i] = row
    return rows.__getitem__


def nystrom_step(
    tableau: Tableau,
    scene: Mechanical,
    y: Undamped,
    h: Arithmetic,
    xp: Namespace,
    stages: int,
    loop: Repeat | None = None,
    first: Sequence[Arithmetic] | None = None,
    factors: Factors | None = None,
    stage: Callable[[Count], Sequence[Arithmetic]] | None = None,
) -> tuple[Undamped, Slopes, Own]:
    """Return the state after a step, the sums of h z'', e^{G} (½ q·∇V − V), γ'/2, and `pull` at the last stage."""
    factors = factors or factors_of(tableau, scene, y.t, h, xp)
    stage, loss = stage or factors_by_stage(tableau, factors, h, xp, loop), factors.loss
    acts, d = y.action is not None, len(y.q)

    def scale(i: Count, own: Sequence[Arithmetic]) -> list[Arithmetic]:
        grown, pushed, *_ = stage(i)
        rest = [pushed * grown * own[d]] if acts else []
        return [*scaled(pushed, own[:d]), *rest, *(h * c for c in own[d + acts :])]

    def evaluate(i: Count, moved: Sequence[Arithmetic] | None) -> tuple[list[Arithmetic], list[Arithmetic]]:
        q, t = y.q, y.t
        if moved is not None:
            *_, way, _, passed = stage(i)
            q = tuple(way * c if loop else c for c in moved[:d])
            t = None if t is None else t + passed
        own = pull(scene, q, t, acts)
        return scale(i, own), own

    def begins(i: int) -> Begin:
        _, _, shrunk, way, far, _ = stage(i)
        return Begin(
            [shrunk * a + far * b for a, b in zip(y.q, y.u, strict=True)],
            [way * stage(j)[1] for j in range(i)],
        )

    base = []
    if loop:
        over = 1 / h
        beside: list[Any] = [*([y.action] if acts else []), *([y.t] if scene.rate_changes else [])]
        base = [((Fraction(1),) * stages, [over * c for c in y.q] + beside), (tableau.nodes, [*y.u, *beside])]
    known = None if first is None else (scale(0, first), first)
    slopes, own = run_stages(tableau, stages, evaluate, base, begins, xp, loop, known)
    position, change = map(slopes, tableau.weights)
    z = (a + h * (b + c) for a, b, c in zip(y.q, y.u, position[:d], strict=True))
    velocity = (a + b for a, b in zip(y.u, change[:d], strict=True))
    q, u = (tuple(a - loss * a for a in part) for part in (z, velocity))
    t, action = None if y.t is None else y.t + h, y.action
    if acts:
        action = action + change[d]
        action = action - loss * (2 - loss) * action
    if scene.rate_changes:  # u jumps with γ; where γ is smooth this is within the order of the method
        before, after = (scene.damping_at(at(scene, y.q, time)) / 2 for time in (y.t, t))
        jump = after - before - change[-1]
        u = tuple(a + jump * c for a, c in zip(u, q, strict=True))
    return Undamped(q, u, t, action), slopes, own


def looped(repeat: Repeat, stages: int, scene: Scene, x: OwnState) -> Repeat | None:
    """Return `repeat` if the stages of a step are to be one loop: many stages and a large state."""
    return repeat if repeat.rows is not None and stages > 4 and len(scene.pack(x)) > SMALL else None


@dataclass(frozen=True)
class RungeKutta(FixedStep):
    """A fixed-step method by a tableau, for y, or for z if it is a Nyström method."""

    tableau: Tableau = field(kw_only=True)

    def refuses(self, scene: Scene) -> str | None:
        return refusal(self, self.tableau, scene)

    def advance(
        self, scene: Any, x: OwnState, h: Arithmetic, n: Count, xp: Namespace, repeat: Repeat = repeat
    ) -> OwnState:
        tableau, stages = self.tableau, self.tableau.used
        loop = looped(repeat, stages, scene, x)
        if not tableau.nystrom:
            free, step = scene, h
            if scene.slows_its_clock:  # equal steps of that clock, which starts anew with every interval
                free, step = undamped_twin(scene), damped_time(scene.gamma, h * n, xp) / n
            x = repeat.steps(n, lambda x: explicit_step(tableau, free, x, step, xp, stages, loop)[0], x, h)
            return scene.decayed(x, xp.exp(-scene.gamma * h * n)) if scene.slows_its_clock else x
        factors = stage = None
        if not scene.rate_changes:
            factors = factors_of(tableau, scene, None, h, xp)
            stage = factors_by_stage(tableau, factors, h, xp, loop)

        def another(y: Undamped) -> Undamped:
            return nystrom_step(tableau, scene, y, h, xp, stages, loop, None, factors, stage)[0]

        return damped(scene, repeat.steps(n, another, undamped(scene, x), h))


def refusal(method: Method, tableau: Tableau, scene: Scene) -> str | None:
    """Return why a scene is out of reach, or None."""
    if not tableau.nystrom:
        return None
    fits = scene.kind in ("mechanical", "driven") and not scene.nonlinear_damping
    if fits and scene.clock is not None and "rate" in scene.functions_of_floats:
        return f"{method.name} needs γ'(t), and the rate of scene {scene.name!r} cannot be recorded"
    return unfit(method, scene, fits, "a configuration q in Rⁿ and damping Γ = γ s")


def runge_kutta(name: str, tableau: Tableau, about: str, mission: bool = False) -> RungeKutta:
    def step(scene: Scene, x: OwnState, h: Arithmetic, xp: Namespace) -> OwnState:
        return METHODS[name].advance(scene, x, h, 1, xp)

    kind = "gradient" if tableau.nystrom else "rhs"
    known = name, tableau.order, step, tableau.used, kind, f"{about}; {tableau.source}"
    return RungeKutta(*known, mission=mission, tableau=tableau)


RKN8, RKN12, RK8 = map(read_tableau, ("rkn8-6", "rkn12-10", "rk8"))
METHODS.add(runge_kutta("rk4", read_tableau("rk4"), "classical Runge–Kutta", mission=True))
METHODS.add(runge_kutta("rk8", RK8, "explicit Runge–Kutta"))
METHODS.add(runge_kutta("rkn8", RKN8, "explicit Runge–Kutta–Nyström on z = e^{γt/2} q"))
METHODS.add(runge_kutta("rkn12", RKN12, "explicit Runge–Kutta–Nyström on z = e^{γt/2} q"))
