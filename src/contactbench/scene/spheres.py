"""Points on spheres: pendulums, rotors, spins.  The free motion is a great circle, which damping only slows down."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations
from typing import Any, ClassVar, Self

import numpy as np

from contactbench.checks import vector, whole
from contactbench.errors import BadInput, excerpt
from contactbench.numbers.control import choose, repeat_while, settle
from contactbench.numbers.protocol import Arithmetic, Namespace, abilities, has_digits
from contactbench.scene.algebra import State, Vector, cross, dot, norm, times
from contactbench.scene.base import Check, Sizes, optional
from contactbench.scene.flow import Constants, Flow, plain
from contactbench.scene.mechanical import Mechanical, _drift_damp_constants, _pinney, each_positive
from contactbench.scene.scales import known
from contactbench.trace.formula import Formula

#: for θ² ≤ SMALL, sums of POWERS powers give (1 − cos θ)/θ² and sin θ/θ to round-off; most halvings
SMALL, POWERS, MOST = 1.0, 10, 600.0
SINC, VERSINE = ([(-1) ** k / math.factorial(2 * k + more) for k in range(POWERS)] for more in (1, 2))
#: allowed relative distance of a start from the sphere
CLOSE = 1e-12
#: a number, or one for every point
Each = Any


def unit(name: str, value: Any) -> Vector:
    """Return a direction in space, of length one."""
    given = vector(name, value, 3)
    if not any(given):
        raise BadInput(f"{name} = {excerpt(value)}: must be the direction of an axis, not zero")
    return tuple(c / math.hypot(*given) for c in given)


def flat(name: str, value: Any) -> tuple[Vector, int]:
    """Return the numbers of one point or several in a row, and the length of a point, 0 if it is not known."""
    several = isinstance(value, tuple | list | np.ndarray) and len(value) > 0
    if several and all(np.ndim(row) == 1 for row in value):
        rows = [vector(f"{name}[{i}]", row, len(value[0])) for i, row in enumerate(value)]
        return sum(rows, ()), len(value[0])
    return vector(name, value), 0


def of(value: Each, i: int) -> Any:
    """Return the value for point i, from one for all points or one for each."""
    return value[i] if isinstance(value, tuple) else value


def rows_of(numbers: Sequence[Arithmetic], d: int) -> Iterator[Vector]:
    return (tuple(numbers[i : i + d]) for i in range(0, len(numbers), d))


def call_grouped(
    function: Callable[..., Arithmetic], d: int, q: Vector, **parameters: Arithmetic
) -> Arithmetic:
    """Call a function of points with their numbers one after the other."""
    return function(tuple(rows_of(q, d)), **parameters)


# -- flows -----------------------------------------------------------------------------------------
def circular(square: Arithmetic, xp: Namespace) -> tuple[Arithmetic, Arithmetic]:
    """Return cos θ and sin θ/θ of θ², by a series for a part of θ, doubled: no slow branch to a function."""
    if has_digits(xp) or abilities(xp).traced:  # JAX takes no derivative backwards through a loop
        still = square <= (0 if has_digits(xp) else SMALL)
        angle = xp.sqrt(choose(still, 1.0, square, xp))
        versine, sinc = series(choose(still, square, 0.0, xp))
        cos = choose(still, 1 - versine, xp.cos(angle), xp)
        return cos, choose(still, sinc, xp.sin(angle) / angle, xp)
    least, halvings = repeat_while(
        lambda c: (c[0] > SMALL) & (c[1] < MOST), lambda c: (c[0] / 4, c[1] + 1), (square, 0.0 * square), xp
    )
    versine, sinc, _ = repeat_while(
        lambda c: c[2] > 0,
        lambda c: (2 * c[0] * (2 - c[0]), c[1] * (1 - c[0]), c[2] - 1),
        (*series(least), halvings),
        xp,
    )
    return 1 - versine, sinc


def series(square: Arithmetic) -> tuple[Arithmetic, Arithmetic]:
    """Return 1 − cos θ and sin θ/θ of θ² ≤ `SMALL`."""
    fourth = square * square
    versine, sinc = (horner(c[::2], fourth) + square * horner(c[1::2], fourth) for c in (VERSINE, SINC))
    return square * versine, sinc


def horner(coefficients: Sequence[float], x: Arithmetic) -> Arithmetic:
    total: Arithmetic = coefficients[-1]
    for c in coefficients[-2::-1]:
        total = c + x * total
    return total


def sphere_kick(scene: Spheres, x: State, h: Arithmetic, xp: Namespace) -> State:
    """B: p −= h ∇V along the sphere, s −= h V; then q and p are projected back to the sphere.

    The projection only removes rounding errors: on the sphere it is the identity.  Without it the free motion exchanges
    rounding errors of |q| and q·p, a parametric resonance of both (measured: 10⁻³ after 10⁶ steps).  1/|q| and 1/|q|²
    are Newton steps from 1/R and 1/R².
    """
    q_after: Vector = ()
    p_after: Vector = ()
    for i, ((q, p), g) in enumerate(zip(scene.pairs(x), scene.points(scene.dV(x.q)), strict=True)):
        over_square = of(scene.inverse_radius, i) * of(scene.inverse_radius, i)
        kicked = tuple(b - h * c for b, c in zip(p, g, strict=True))
        off = over_square * dot(q, q)
        across = over_square * dot(q, kicked) * (2 - off)
        q_after += tuple((1.5 - 0.5 * off) * a for a in q)
        p_after += tuple(b - across * a for a, b in zip(q, kicked, strict=True))
    return State(q_after, p_after, None if x.s is None else x.s - h * scene.potential_at(x))


def great_circles(
    scene: Spheres,
    x: State,
    time: Each,
    xp: Namespace,
    damped: Callable[[Arithmetic], Arithmetic] = lambda c: c,
) -> tuple[Vector, Vector]:
    """Return q after the free motion, each point over its time divided by its mass, and the damped p.

    q → q cos θ + (p t/m) sin θ/θ, p → p cos θ − q (|p|² t/mR²) sin θ/θ, θ = |p| t/mR: no division by |p|.
    What needs no sine is computed beside it.
    """
    q_after: Vector = ()
    p_after: Vector = ()
    for i, (q, p) in enumerate(scene.pairs(x)):
        t, over_R = of(time, i), of(scene.inverse_radius, i)
        square, bend = dot(p, p), t * over_R * over_R
        slow, back = tuple(map(damped, p)), damped(bend * square)
        cos, sinc = circular(bend * t * square, xp)
        q_after += tuple(cos * a + sinc * (t * b) for a, b in zip(q, p, strict=True))
        p_after += tuple(cos * b - sinc * (back * a) for a, b in zip(q, slow, strict=True))
    return q_after, p_after


def sphere_drift(scene: Spheres, x: State, h: Arithmetic, xp: Namespace) -> State:
    """A: great circles; s += h T."""
    q, p = great_circles(scene, x, times(scene.inverse_mass, h), xp)
    return settle(State(q, p, None if x.s is None else x.s + h * scene.kinetic(x.p)), xp)


def sphere_drift_damp(scene: Spheres, x: State, constants: Constants, xp: Namespace) -> State:
    """AC: the same great circles for the time φ = (1 − e^{−γh})/γ, then p → e^{−γh} p, s → e^{−γh} (s + φ T).

    Along a geodesic |p| only decays: it is `mechanical.drift_damp` with the geodesic in place of the straight line.
    """
    time, phi, keep, lose, *nonlinear = constants
    s = None if x.s is None else x.s + phi * scene.kinetic(x.p)
    factor: Any = 1.0
    if nonlinear:
        a, factor, path = _pinney(scene, x, constants, xp)
        time, s = times(time, path), a * x.s + phi * scene.kinetic(x.p)

    def damped(c: Arithmetic) -> Any:
        return (keep * c - lose * c) * factor if nonlinear else keep * c - lose * c

    q, p = great_circles(scene, x, time, xp, damped)
    return settle(State(q, p, None if s is None else damped(s)), xp)


@dataclass(frozen=True, kw_only=True)
class Spheres(Mechanical):
    """Describe a point on a sphere, or several, each on its own: H = Σ ‖p_i‖²/2m_i + V(q) + γ s, ‖q_i‖ = R_i.

    Points are vectors of d numbers, momenta are tangent, q_i·p_i = 0; d = 2 is a plane pendulum, d = 3 a spherical
    one, d = 4 a body with three equal moments, 4 m R², as a unit quaternion (S³ = SU(2), twice around).  The equations
    for all methods are those in the surrounding space, with the constraint's multiplier eliminated:

        q' = p/m,   p' = −∇V + q (q·∇V − ‖p‖²/m)/‖q‖² − γ p,   s' = T − V − γ s.

    Contact methods stay on the sphere to round-off; others drift off it (`cb.LAWS["sphere_drift"]`).

        Spheres(name="pendulum", potential=lambda q: 9.81 * q[2], gamma=0.1, q=(0.6, 0.0, -0.8), p=(0.0, 0.5, 0.0),
                axis=(0, 0, 1), t_end=10.0)

    Parameters
    ----------
    name, about, t_end, s, exact, scale, slows_after, hard, stiff, mission, pace
        As of `Scene`.
    potential
        ``V(q, **parameters) -> number`` of a point, d numbers, or of several, a tuple of such.  It is a function near
        the sphere: only its derivatives along the sphere count.
    gradient, hessian
        Of a single point, as of `Mechanical`: derivatives in the surrounding space.
    q, p
        A point and its momentum, or a tuple of points and one of momenta; kept as one flat tuple, as solutions have it.
    dimension
        The number d ≥ 2; by default as q says.
    mass, radius
        > 0; one number, or one for every point.
    gamma, kappa
        Damping Γ = γ s + ½ κ s².
    parameters
        Numbers by name that the functions take.
    rotation_invariant
        Whether V does not change where all points are rotated together: J = Σ q_i ∧ p_i obeys J' = −Γ'(s) J.
    axis
        Three numbers, where V does not change under rotations about this axis (d = 3): its component of J does.

    Raises
    ------
    BadInput
        For a start off the sphere or a momentum that is not tangent, by more than 10⁻¹² of its size, and as
        `Mechanical` does.
    """

    q: Any
    p: Any
    radius: Any = 1.0
    dimension: Any = None
    axis: Any = None
    #: 1/R
    inverse_radius: Any = field(init=False, repr=False, default=1.0)

    kind = "spheres"
    canonical = separable = False
    constrained = True
    coefficients: ClassVar[tuple[str, ...]] = ("gamma", "kappa", "mass", "radius")
    reciprocals: ClassVar[dict[str, str]] = {"mass": "inverse_mass", "radius": "inverse_radius"}
    checks: ClassVar[dict[str, Check]] = {
        **Mechanical.checks,
        **dict.fromkeys(("q", "p"), lambda name, value: value),  # checked together, with their radius
        "mass": each_positive,
        "radius": each_positive,
        "axis": optional(unit),
    }
    flows: ClassVar[Mapping[str, Flow]] = {
        "kick": Flow(plain, sphere_kick, {"gradient": 1}),
        "drift": Flow(plain, sphere_drift, {}),
        "damp": Mechanical.flows["damp"],
        "drift_damp": Flow(_drift_damp_constants, sphere_drift_damp, {}),
    }

    def __post_init__(self) -> None:
        (q, d), (p, _) = (flat(name, getattr(self, name)) for name in ("q", "p"))
        d = d or (len(q) if self.dimension is None else whole("dimension", self.dimension, 1000, least=2))
        if d < 2 or len(q) % d:
            raise BadInput(f"q = {excerpt(self.q)}: must be {max(d, 2)} numbers for each point, 2 or more")
        for name, value in (("dimension", d), ("q", q), ("p", p)):
            self._fix(name, value)
        for name in ("gradient", "hessian"):
            if self.bodies > 1 and callable(given := getattr(self, name)) and not isinstance(given, Formula):
                raise BadInput(f"{name}: of several points it is derived; of one it may be given")
        super().__post_init__()
        if isinstance(self.radius, tuple) and len(self.radius) != self.bodies:
            raise BadInput(
                f"radius = {excerpt(self.radius)}: must be one number > 0, or {self.bodies} of them"
            )
        if self.axis is not None and (self.dimension != 3 or self.rotation_invariant):
            raise BadInput(
                f"axis = {excerpt(self.axis)}: is for points in space, and for one axis of symmetry alone"
            )
        for i, (a, b) in enumerate(self.pairs(self.initial(()))):
            which, R = f"[{i}]" if self.bodies > 1 else "", of(self.radius, i)
            if abs(math.hypot(*a) - R) > CLOSE * R:
                there = tuple(c * R / (math.hypot(*a) or 1.0) for c in a)
                says = f"must be on the sphere, |q| = radius = {R!r}: it is {math.hypot(*a)!r}, at {excerpt(there)} not"
                raise BadInput(f"q{which} = {excerpt(a)}: {says}")
            if abs(dot(a, b)) > CLOSE * R * math.hypot(*b):
                raise BadInput(f"p{which} = {excerpt(b)}: must be tangent, q·p = 0: q·p is {dot(a, b)!r}")

    # -- points ------------------------------------------------------------------------------------
    @property
    def bodies(self) -> int:
        return int(len(self.q) // self.dimension)

    def points(self, numbers: Sequence[Arithmetic]) -> Iterator[Vector]:
        return rows_of(numbers, self.dimension)

    def pairs(self, x: State) -> Iterator[tuple[Vector, Vector]]:
        return zip(self.points(x.q), self.points(x.p), strict=True)

    @property
    def decided(self) -> tuple[Hashable, ...]:  # type: ignore[override]
        return (*super().decided, self.dimension, self.axis)

    @property
    def layout(self) -> Sequence[object]:
        return [self.dimension]

    def number_names(self) -> list[str]:
        """Return the names; blank for a radius, with which points have to be changed too."""
        return ["" if name == "radius" else name for name in super().number_names()]

    def of_numbers(self, function: Any) -> Any:
        """Return a function of points as a function of their numbers; a recorded one is one already."""
        grouped = isinstance(function, Formula) or getattr(function, "func", None) is call_grouped
        if self.bodies == 1 or grouped:
            return function
        return partial(call_grouped, function, self.dimension)

    def recorded(self) -> Self:
        potential = self.of_numbers(self.potential)
        scene = self if potential is self.potential else self._replaced(potential=potential)
        return super(Spheres, scene).recorded()

    # -- physics -----------------------------------------------------------------------------------
    def velocity(self, p: Vector) -> Vector:
        return tuple(of(self.inverse_mass, i // self.dimension) * c for i, c in enumerate(p))

    def kinetic(self, p: Vector) -> Arithmetic:
        return dot(p, self.velocity(p)) / 2

    def V(self, q: Vector) -> Arithmetic:
        return self.of_numbers(self.potential)(q, **self.parameters)  # type: ignore[no-any-return]

    def rhs(self, x: State) -> State:
        rate, slope, velocity = self.dissipation_rate(x.s), self.dV(x.q), self.velocity(x.p)
        force: Vector = ()
        for (q, p), g, v in zip(self.pairs(x), self.points(slope), self.points(velocity), strict=True):
            pull = (dot(q, g) - dot(p, v)) / dot(q, q)
            force += tuple(pull * a - b - rate * c for a, b, c in zip(q, g, p, strict=True))
        if x.s is None:
            return State(velocity, force)
        return State(velocity, force, self.kinetic(x.p) - self.potential_at(x) - self.dissipation(x.s))

    def jacobian(self, x: State) -> list[list[Arithmetic]] | None:
        rows = super().jacobian(x)
        if rows is None:
            return None
        n, d, slope, v = len(x.q), self.dimension, self.dV(x.q), self.velocity(x.p)
        for i in range(0, n, d):
            own = range(i, i + d)
            q, square = x.q[i : i + d], dot(x.q[i : i + d], x.q[i : i + d])
            pull = (dot(q, slope[i : i + d]) - dot(x.p[i : i + d], v[i : i + d])) / square
            hessian = [[-c for c in rows[n + k][:n]] for k in own]
            change = [dot(q, [row[j] for row in hessian]) / square for j in range(n)]
            for j in own:
                change[j] = change[j] + (slope[j] - 2 * pull * x.q[j]) / square
            for k in own:
                row = rows[n + k]
                row[:n] = [a + x.q[k] * b for a, b in zip(row[:n], change, strict=True)]
                row[k] = row[k] + pull
                for j in own:
                    row[n + j] = row[n + j] - 2 * x.q[k] * v[j] / square
        return rows

    @property
    def mixed(self) -> bool:  # type: ignore[override]
        return isinstance(self.mass, tuple) or isinstance(self.radius, tuple)

    @property
    def alike(self) -> Sequence[int]:
        return [self.dimension] * 2 * self.bodies

    def sizes(self, x: State, end: float) -> Sizes:
        """Return the radii, and the momenta after a fall through a radius, √(2 m R ‖∇V‖)."""
        try:
            slope = self.dV(x.q)
        except Exception:  # a user's function, where it is not defined
            slope = tuple(np.nan * c for c in x.q)
        places: list[float] = []
        momenta: list[float] = []
        for i, (p, g) in enumerate(zip(self.points(x.p), self.points(slope), strict=True)):
            R = of(self.radius, i)
            most = np.fmax(norm(p), (2 * R / of(self.inverse_mass, i) * norm(g)) ** 0.5)
            places += [R] * self.dimension
            momenta += [most] * self.dimension
        return [*places, *momenta], float(max(places) * np.max(momenta))

    def settled(self, y: np.ndarray, carry: Sequence[str]) -> np.ndarray:
        n, d = len(self.q), self.dimension
        q, p = (y[:, part].reshape(len(y), n // d, d) for part in (slice(0, n), slice(n, 2 * n)))
        q *= np.array(self.radius).reshape(-1, 1) / np.linalg.norm(q, axis=2, keepdims=True)
        p -= q * (q * p).sum(axis=2, keepdims=True) / (q * q).sum(axis=2, keepdims=True)
        return np.hstack([q.reshape(len(y), n), p.reshape(len(y), n), y[:, 2 * n :]])

    def departure(self, x: State, start: State) -> Vector:
        """Return | |q|/R − 1 | of every point, and |q·p|/R relative to the size of its momenta from the start on."""
        sizes, found = known(np.array(self.sizes(start, self.t_end)[0][len(x.q) :: self.dimension])), []
        for i, ((q, p), size) in enumerate(zip(self.pairs(x), sizes, strict=True)):
            R = of(self.radius, i)
            found += [abs(norm(q) / R - 1), abs(dot(q, p)) / (R * size)]
        return tuple(found)

    # -- symmetry ----------------------------------------------------------------------------------
    def momentum(self, x: State) -> Vector:
        """Return Σ q ∧ p: one number in the plane, three in space, d(d − 1)/2; its component along an axis."""
        total: Sequence[Arithmetic] = ()
        for q, p in self.pairs(x):
            planes = combinations(range(len(q)), 2)
            turned = cross(q, p) if len(q) == 3 else [q[i] * p[j] - q[j] * p[i] for i, j in planes]
            total = [a + b for a, b in zip(total, turned, strict=True)] if total else turned
        return tuple(total) if self.axis is None else (dot(self.axis, total),)

    @property
    def symmetry(self) -> str:  # type: ignore[override]
        return super().symmetry if self.axis is None else f"axis = {excerpt(self.axis)}"

    @property
    def has_momentum_law(self) -> bool:  # type: ignore[override]
        return self.rotation_invariant or self.axis is not None

    # -- tangents ----------------------------------------------------------------------------------
    def tangents(self, x: State) -> list[State]:
        """Return a basis: a point along e with its momentum carried along, or the momentum along e; then s."""
        basis, zero = [], None if x.s is None else 0.0 * x.q[0]
        for i, (q, p) in enumerate(self.pairs(x)):
            R, first = of(self.radius, i), i * self.dimension

            def at(v: Vector, first: int = first) -> Vector:
                return tuple(0.0 * c for c in x.q[:first]) + v + tuple(0.0 * c for c in x.q[first + len(v) :])

            for e in frame(tuple(c / R for c in q)):
                carried = tuple(-dot(e, p) / (R * R) * c for c in q)
                basis += [State(at(e), at(carried), zero), State(at(tuple(0.0 * c for c in e)), at(e), zero)]
        nothing = tuple(0.0 * c for c in x.q)
        return basis if x.s is None else [*basis, State(nothing, nothing, 1.0 + nothing[0])]

    def displaced(self, x: State, v: State, amount: float) -> State:  # type: ignore[override]
        """Return points moved along great circles, and their momenta, changed along the sphere and carried along."""
        s = None if x.s is None else x.s + amount * v.s
        moved: tuple[Vector, Vector] = ((), ())
        for i, ((q, p), (dq, dp)) in enumerate(zip(self.pairs(x), self.pairs(v), strict=True)):
            R = of(self.radius, i)
            across, way = dot(q, dp) / (R * R), norm(dq)
            p = tuple(a + amount * (b - across * c) for a, b, c in zip(p, dp, q, strict=True))
            if way > 0:
                turn, u = way * amount / R, tuple(c / way for c in dq)
                cos, sin, along = math.cos(turn), math.sin(turn), dot(p, u)
                p = tuple(a + along * ((cos - 1) * b - sin * c / R) for a, b, c in zip(p, u, q, strict=True))
                q = tuple(cos * a + sin * R * b for a, b in zip(q, u, strict=True))
            moved = moved[0] + q, moved[1] + p
        return State(*moved, s)


def frame(u: Vector) -> list[Vector]:
    """Return d − 1 orthonormal vectors orthogonal to a unit vector u: axes mirrored so that the last is ±u."""
    last = u[-1]
    side = 1.0 if last >= 0 else -1.0
    mirror = (*u[:-1], last + side)
    found = []
    for a, c in enumerate(u[:-1]):
        share = c / (1 + side * last)
        found.append(tuple((1.0 if a == k else 0.0) - share * m for k, m in enumerate(mirror)))
    return found
