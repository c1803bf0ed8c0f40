"""Splittings whose part A has the springs of an equilibrium: A = T + U + γs and B = W, V = U + W.

U(q) = V(a) + ½(q − a)·K(q − a) with the Hessian K at a.  In the modes of the mass-weighted Hessian, A is
x'' + γx' + ω²x = 0, solved in closed form whatever the sign of ω² and of ω² − γ²/4; s − ½(q − a)·p decays alone.  A is
thus an exact contact flow, and so are the two flows of functions of W.

Where γh ≫ 1 a kick by W relaxes into an Euler step of the slow motion, an error of order one.  The kick by

    W − ∇W·G∇W/2h,   G = (h³/4)(x coth x − 1)/x² per mode,   x = h √(γ²/4 − ω²),

repairs it: for a linear force the trace of the step is that of the flow to second order in W, at any h and γ
(docs/mathematics.md).  For γ → 0 it is the kernel of Takahashi and Imada, J. Phys. Soc. Jpn. 53, 3765 (1984),
doi:10.1143/JPSJ.53.3765, with an exact linear part.  The step is then conjugate to one of order two at any γh, by a
move along the fast modes (`settle`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from contactbench.numbers.control import choose
from contactbench.numbers.dual import Dual, slope
from contactbench.numbers.protocol import Arithmetic, Namespace, Vector, has_digits
from contactbench.scene import Mechanical, State, added, dot
from contactbench.scene.base import Cache, key
from contactbench.scene.flow import STRONG, Flow, damped_time, damping

#: most iterations to the minimum, and the relative size of its last step and force
TURNS, CLOSE = 200, 1e-8
#: beyond this Ωh the numerator of the weight of an underdamped mode stays as it is there; it has a pole at π
TURNED = 2.0
#: |x²| below which power series stand for their functions, in double precision
SMALL = 1e-2


@dataclass(frozen=True)
class Expansion:
    """A quadratic potential: V(a), ω² and mode of each spring; rest : largest |curvature| of W, over mass."""

    about: tuple[float, ...]
    level: float
    squares: tuple[float, ...]
    modes: tuple[tuple[float, ...], ...]
    rest: float

    def has_creep(self, gamma: float) -> bool:
        """Return whether the slowest mode is overdamped, with the rest too: `settle` leaves u where p/γ is far."""
        return gamma > 0 and max(self.squares[0], self.rest) < (1 - APART**2) * gamma**2 / 4


# -- the expansion -------------------------------------------------------------------------------------
_expansions: Cache[Expansion] = Cache(256)


def expand(scene: Any, about: Sequence[float] | None = None) -> Expansion:
    """Return the expansion about a point, by default the minimum downhill from the start; without one U = V(start)."""
    scene = scene.with_numbers([*map(float, scene.numbers())]).recorded()
    begin = tuple(map(float, scene.q))
    start = begin if about is None else tuple(map(float, about))

    def make() -> Expansion:
        with np.errstate(all="ignore"):
            point = start if about is not None else minimum(scene, start)
            at = start if point is None else point
            n, weights = len(at), np.sqrt(np.broadcast_to(scene.inverse_mass, len(at)))
            K, here = (hessian(scene, x) * np.outer(weights, weights) for x in (at, begin))
            if point is None or not np.isfinite(K).all():
                K = np.zeros((n, n))
            rest = np.linalg.norm(here - K, 2) if np.isfinite(here).all() else math.inf
            squares, modes = np.linalg.eigh(K) if np.count_nonzero(K - np.diag(np.diag(K))) else axes(K)
        rows = tuple(map(tuple, modes.T.tolist()))
        return Expansion(at, float(scene.V(at)), tuple(squares.tolist()), rows, float(rest))

    return _expansions.get(key(scene.identity, *scene.numbers(), begin, about), make)


def is_quadratic(scene: Mechanical) -> bool:
    """Return whether the potential has the same curvature at the start and at two points that nothing singles out."""
    scene = scene.with_numbers([*map(float, scene.numbers())]).recorded()
    points = [tuple(a + shift for a in map(float, scene.q)) for shift in (0.0, 0.271, -0.618)]
    with np.errstate(all="ignore"):
        here, *others = (hessian(scene, point) for point in points)
    return all(np.allclose(here, other, rtol=1e-12, atol=0) for other in others)


def axes(K: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the modes of a diagonal matrix, without round-off."""
    order = np.argsort(np.diag(K), kind="stable")
    return np.diag(K)[order], np.eye(len(K))[:, order]


def hessian(scene: Mechanical, q: Sequence[float]) -> np.ndarray:
    columns = [[*map(slope, scene.dV(directed(q, unit)))] for unit in np.eye(len(q)).tolist()]
    found: np.ndarray = np.array(columns, dtype=float)
    return np.asarray((found + found.T) / 2)


def directed(q: Sequence[Arithmetic], v: Sequence[Arithmetic]) -> Vector:
    return tuple(map(Dual, q, v))


def minimum(scene: Mechanical, q: tuple[float, ...]) -> tuple[float, ...] | None:
    """Return the minimum downhill from q, by Newton's method with |eigenvalues| and halved steps; None without one."""
    largest = 0.0
    try:
        for _ in range(TURNS):
            g = np.array(scene.dV(q), dtype=float)
            largest = max(largest, force := float(np.linalg.norm(g)))
            if force == 0:
                return q
            curvatures, U = np.linalg.eigh(hessian(scene, q))
            sizes = np.maximum(np.abs(curvatures), 1e-12 * np.abs(curvatures).max() + 1e-300)
            move, here = -U @ (U.T @ g / sizes), scene.V(q)
            if np.linalg.norm(move) <= CLOSE * (CLOSE + np.linalg.norm(q)) and force <= CLOSE * largest:
                return tuple((q + move).tolist())
            while not scene.V(tuple(q + move)) <= here + 1e-14 * abs(here):
                move /= 2
                if not np.linalg.norm(move) > 0:
                    return None
            q = tuple((q + move).tolist())
    except (ArithmeticError, ValueError, np.linalg.LinAlgError):  # beyond the range of floats
        pass
    return None


# -- the flows -----------------------------------------------------------------------------------------
class Split:
    """A mechanical scene as compositions see it, with the flows of an expansion."""

    flows: ClassVar[Mapping[str, Flow]] = {}

    def __init__(self, scene: Any, expansion: Expansion, xp: Namespace) -> None:
        self.scene, self.expansion = scene, expansion
        inverse = scene.inverse_mass
        inverse = inverse if isinstance(inverse, tuple) else (inverse,) * len(expansion.about)
        self.roots = tuple(map(xp.sqrt, inverse))
        self.over_roots = tuple(1 / root for root in self.roots)
        self.rows: Sequence[Sequence[Any]] = expansion.modes
        if has_digits(xp):
            self.rows = orthonormal([[xp.mpf(u) for u in row] for row in self.rows])
        self.columns = tuple(zip(*self.rows, strict=True))

    def from_point(self, q: Vector) -> Vector:
        return tuple(x - a for x, a in zip(q, self.expansion.about, strict=True))

    def positions(self, d: Vector) -> Vector:
        """Return the modes' coordinates of a distance, or of a momentum over mass."""
        return combined(self.rows, multiplied(self.over_roots, d))

    def momenta(self, p: Vector) -> Vector:
        """Return the modes' momenta, or forces."""
        return combined(self.rows, multiplied(self.roots, p))

    def distance(self, x: Vector) -> Vector:
        return multiplied(self.roots, combined(self.columns, x))

    def momentum(self, y: Vector) -> Vector:
        return multiplied(self.over_roots, combined(self.columns, y))

    def rest(self, q: Vector, wanted: bool) -> tuple[Vector, Any]:
        """Return ∇W, and W if wanted."""
        x = self.positions(self.from_point(q))
        pulls = multiplied(self.expansion.squares, x)
        force = tuple(map(lambda g, k: g - k, self.scene.dV(q), self.momentum(pulls)))
        return force, self.scene.V(q) - self.expansion.level - dot(x, pulls) / 2 if wanted else None

    def bend(self, q: Vector, x: Vector) -> Vector:
        """Return ∇²W v for the displacement v of modes x."""
        bent = map(slope, self.scene.dV(directed(q, self.distance(x))))
        pulls = self.momentum(multiplied(self.expansion.squares, x))
        return tuple(b - k for b, k in zip(bent, pulls, strict=True))


def multiplied(a: Sequence[Arithmetic], b: Sequence[Arithmetic]) -> Vector:
    return tuple(x * y for x, y in zip(a, b, strict=True))


def combined(rows: Sequence[Sequence[Any]], x: Vector) -> Vector:
    """Return the matrix times x, without products by its zeros and ones."""
    made = []
    for row in rows:
        terms = [c if u == 1 else u * c for u, c in zip(row, x, strict=True) if u != 0]
        made.append(sum(terms[1:], terms[0]))
    return tuple(made)


def orthonormal(rows: Sequence[Sequence[Any]]) -> Sequence[Sequence[Any]]:
    """Return rows orthonormal to all digits: each of Newton and Schulz's iterations U(3 − UᵀU)/2 doubles them."""
    U: Any = np.array(rows, dtype=object)
    for _ in range(3):
        U = (3 * U - U @ (U.T @ U)) / 2
    return [*map(tuple, U)]


class Spring(NamedTuple):
    """The solution of one mode after a step: x += c x + σ y, y → (kept) y + d y − ω²σ x."""

    c: Arithmetic
    d: Arithmetic
    sigma: Arithmetic
    back: Arithmetic


def spring(gamma: Arithmetic, square: float, h: Arithmetic, strong: Any, xp: Namespace) -> Spring:
    """Return the flow of x'' + γx' + ω²x = 0, with differences from one computed without cancellation.

    Where overdamped, with the slow and fast rates λ = −γ/2 ± ν: σ = e^{λ₊h}(1 − e^{−2νh})/2ν, c = e^{λ₊h} − 1 − λ₊σ,
    d = e^{λ₋h} + λ₊σ (− 1 unless strong).
    """
    mu = gamma / 2
    z = mu * mu - square
    none = z == 0
    over, nu = z > 0, xp.sqrt(choose(none, 1.0, abs(z), xp))
    slow = choose(mu > 0, -square / choose(mu > 0, mu + nu, 1.0, xp), nu - mu, xp)
    slow = choose(over, slow, 0 * slow, xp)  # no overflow where it is not used
    fast = choose(over, -mu - nu, 0 * mu, xp)
    width = choose(over, nu, 1.0, xp)
    creeping = -xp.exp(slow * h) * xp.expm1(-2 * width * h) / (2 * width)
    c, d = xp.expm1(slow * h) - slow * creeping, slow * creeping
    d = d + choose(strong, xp.exp(fast * h), xp.expm1(fast * h), xp)
    angle = choose(z < 0, nu * h, 0 * h, xp)
    damp, half = xp.exp(-mu * h), xp.sin(angle / 2)
    loss = xp.expm1(-mu * h) * xp.cos(angle) - 2 * half * half
    swinging = damp * choose(none, h * (1 + z * h * h / 6), xp.sin(angle) / nu, xp)
    kept = choose(strong, damp * xp.cos(angle), loss, xp)
    sigma = choose(over, creeping, swinging, xp)
    c = choose(over, c, loss + mu * swinging, xp)
    return Spring(c, choose(over, d, kept - mu * swinging, xp), sigma, -square * sigma)


def _swing_constants(split: Split, h: Arithmetic, xp: Namespace) -> tuple[Any, ...]:
    gamma = split.scene.gamma
    strong = gamma * h > STRONG
    springs = tuple(spring(gamma, square, h, strong, xp) for square in split.expansion.squares)
    own = tuple(tuple(column) for column in zip(*springs, strict=True))
    return (*own, *damping(gamma, h, xp), choose(strong, 0 * h, 1 + 0 * h, xp), damped_time(gamma, h, xp))


def swing(split: Split, x: State, constants: tuple[Any, ...], xp: Namespace) -> State:
    """A, the flow of T + U + γs: every mode by `Spring`, s − ½(q − a)·p → e^{−γh}(s − ½(q − a)·p) − φ V(a)."""
    c, d, sigma, back, keep, lose, near, phi = constants
    away = split.from_point(x.q)
    X, Y = split.positions(away), split.momenta(x.p)
    moved = split.distance(tuple(c * x + s * y for c, s, x, y in zip(c, sigma, X, Y, strict=True)))
    pulled = split.momentum(tuple(b * x + d * y for b, d, x, y in zip(back, d, X, Y, strict=True)))
    q = added(x.q, moved)
    p = tuple(near * a + b for a, b in zip(x.p, pulled, strict=True))
    if x.s is None:
        return State(q, p)
    own = x.s - dot(away, x.p) / 2
    s = keep * own - lose * own + dot(split.from_point(q), p) / 2
    return State(q, p, s - phi * split.expansion.level if split.expansion.level else s)


def kick(split: Split, x: State, h: Arithmetic, xp: Namespace) -> State:
    """B: p −= h ∇W, s −= h W."""
    force, W = split.rest(x.q, x.s is not None)
    p = tuple(p - h * f for p, f in zip(x.p, force, strict=True))
    return State(x.q, p, None if x.s is None else x.s - h * W)


def series(z: Arithmetic, coefficients: Sequence[float]) -> Arithmetic:
    total: Arithmetic = 0.0
    for c in reversed(coefficients):
        total = total * z + c
    return total


#: powers of x² in (x coth x − 1)/x² and in (1 − x/sinh x)/x²
COTH = (1 / 3, -1 / 45, 2 / 945, -1 / 4725, 2 / 93555)
SINH = (1 / 6, -7 / 360, 31 / 15120, -127 / 604800, 73 / 3421440)


def even(z: Arithmetic, xp: Namespace, powers: Sequence[float], over: Any, under: Any) -> Arithmetic:
    """Return an even function of x = √z by its series near zero, over(x) or under(√−z); both are computed."""
    small = z == 0 if has_digits(xp) else abs(z) <= SMALL
    x = xp.sqrt(choose(small, 1.0, abs(z), xp))
    return choose(small, series(z, powers), choose(z > 0, over(x), under(x), xp), xp)


def gradient_weight(z: Arithmetic, xp: Namespace) -> Arithmetic:
    """Return (x coth x − 1)/x², x² = z."""

    def under(x: Arithmetic) -> Arithmetic:
        angle = choose(x < TURNED, x, TURNED, xp)
        return (1 - angle * xp.cos(angle) / xp.sin(angle)) / (x * x)

    def over(x: Arithmetic) -> Arithmetic:
        return (x * (1 + xp.exp(-2 * x)) / -xp.expm1(-2 * x) - 1) / (x * x)

    return even(z, xp, COTH, over, under)


def _gradient_constants(split: Split, h: Arithmetic, xp: Namespace) -> tuple[Any, ...]:
    quarter = split.scene.gamma * split.scene.gamma / 4
    weights = (gradient_weight(h * h * (quarter - square), xp) for square in split.expansion.squares)
    return h, tuple(h * h * h / 4 * weight for weight in weights)


def gradient_kick(split: Split, x: State, constants: tuple[Any, ...], xp: Namespace) -> State:
    """B of W − ∇W·G∇W/2h: p −= h ∇W − ∇²W G∇W, s −= h W − ½∇W·G∇W."""
    h, weights = constants
    force, W = split.rest(x.q, x.s is not None)
    modes = split.momenta(force)
    shift = multiplied(weights, modes)
    p = tuple(p - (h * f - b) for p, f, b in zip(x.p, force, split.bend(x.q, shift), strict=True))
    return State(x.q, p, None if x.s is None else x.s - (h * W - dot(modes, shift) / 2))


#: modes are settled whose rates differ by more than this part of γ
APART = 0.5
#: θ and weights of the two functions W(u + θv), by which κ(W(u) − ½v²W''(u)) is matched up to v², and the motion
#: of a settled state to second order in W where γh ≫ 1: θ₁θ₂ = 1 and θ₁ − θ₂ = ½
FIRST, SECOND = (17**0.5 + 1) / 4, (17**0.5 - 1) / 4
NODES = ((FIRST, -2 * SECOND), (SECOND, 2 * FIRST))


class Settled(NamedTuple):
    """Constants of a processor: κ of the first mode; by mode √κ in parts of that, the fast rate and ν."""

    strength: Arithmetic
    scales: Vector
    fast: Vector
    nu: Vector


def _settle_constants(split: Split, h: Arithmetic, xp: Namespace) -> Settled:
    gamma = split.scene.gamma
    quarter, modes = gamma * gamma / 4, []
    for square in split.expansion.squares:
        apart = (gamma > 0) & (quarter - square > APART * APART * quarter)
        nu = xp.sqrt(choose(apart, quarter - square, 1.0, xp))
        fast = choose(apart, gamma / 2 + nu, 1.0, xp)
        rate = fast - 2 * square / fast
        x = rate * h / 2
        strength = rate * h * h / 4 * even(x * x, xp, SINH, lambda x: settling(x, xp), lambda x: x)
        modes.append((choose(apart, strength, 0 * h, xp), fast + 0 * h, nu + 0 * h))
    strengths, rates, halves = zip(*modes, strict=True)
    first = choose(strengths[0] > 0, strengths[0], 1.0 + 0 * h, xp)
    return Settled(strengths[0], tuple(xp.sqrt(each / first) for each in strengths), rates, halves)


def settling(x: Arithmetic, xp: Namespace) -> Arithmetic:
    """Return (1 − x/sinh x)/x²."""
    return (1 + 2 * x * xp.exp(-x) / xp.expm1(-2 * x)) / (x * x)


def along(split: Split, x: State, constants: Sequence[Any], theta: float, weight: float) -> State:
    """Return the exact flow of κ W(u + θv) for the time `weight`; u = (y + r x)/2ν, v = x − u, r the fast rate."""
    X, Y = split.positions(split.from_point(x.q)), split.momenta(x.p)
    by = Settled(*constants)
    slow = tuple((y + r * x) / (2 * nu) for r, nu, x, y in zip(by.fast, by.nu, X, Y, strict=True))
    place = tuple(a * (u + theta * (x - u)) for a, u, x in zip(by.scales, slow, X, strict=True))
    there = added(split.expansion.about, split.distance(place))
    force, W = split.rest(there, x.s is not None)
    time = weight * by.strength
    moves, falls = [], []
    for a, r, nu, f in zip(by.scales, by.fast, by.nu, split.momenta(force), strict=True):
        pull = time * a * f / (2 * nu)
        moves.append((1 - theta) * pull)
        falls.append(-pull * (r + theta * (2 * nu - r)))
    q, p = added(x.q, split.distance(tuple(moves))), added(x.p, split.momentum(tuple(falls)))
    if x.s is None:
        return State(q, p)
    work = sum(dx * (y + dy / 2) for dx, y, dy in zip(moves, Y, falls, strict=True))
    return State(q, p, x.s + work - time * W)


def settle(split: Split, x: State, constants: Sequence[Any], xp: Namespace) -> State:
    """Processor: give a state of the kernel the fast part that kicks in the middle of steps leave out.

    To first order in W it is the flow of S, for W = u^a v^b the power times (1 − z/sinh z)/ρ, z = ρh/2 and
    ρ = (b − 1)λ₋ + (a − 1)λ₊, λ± the rates of a mode; here with a + b = 3, as W begins at a minimum, and λ₊ only
    where b = 0.  Of several modes each coordinate has a scale, whose square is its κ in parts of the first.
    """
    for theta, weight in NODES:
        x = along(split, x, constants, theta, weight)
    return x


def unsettle(split: Split, x: State, constants: Sequence[Any], xp: Namespace) -> State:
    """Undo `settle`."""
    for theta, weight in reversed(NODES):
        x = along(split, x, constants, theta, -weight)
    return x


Split.flows = {
    "swing": Flow(_swing_constants, swing, {}),
    "kick": Flow(lambda split, h, xp: h, kick, {"gradient": 1}),
    "gradient_kick": Flow(_gradient_constants, gradient_kick, {"gradient": 2}),
    "settle": Flow(_settle_constants, settle, {"gradient": 2}),
    "unsettle": Flow(_settle_constants, unsettle, {"gradient": 2}),
}
