"""Linear multistep methods in z = e^{γt/2} q, z'' = γ²z/4 − e^{γt/2} ∇V(q)/m: one gradient a step.

    z_{n+1} + α₁ z_n + … + α_k z_{n+1−k} = h² (β₁ z''_n + … + β_K z''_{n+1−K}),

with β exact on polynomials of the highest degree; for symmetric α the energy of z has no drift.  Quinlan, Tremaine,
Astron. J. 100, 1694 (1990), doi:10.1086/115629.  Every interval starts anew: a Nyström method steps backwards to its K
points before the start.  The action is s e^{γt} = s₀ + ½ [e^{γt} q·p] + ∫ e^{γt} (½ q·∇V − V).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from itertools import accumulate
from typing import Any, NoReturn

import numpy as np

from contactbench.methods.base import METHODS, unfit
from contactbench.methods.dense import Nodes, Source
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.fixed_step_run import EqualSteps
from contactbench.methods.loops import Loop
from contactbench.methods.parts import Parts
from contactbench.methods.prepared import Request
from contactbench.methods.runge_kutta import (
    RKN8,
    RKN12,
    Tableau,
    factors_by_stage,
    factors_of,
    looped,
    nystrom_step,
    pull,
    runge_kutta,
    undamped,
)
from contactbench.numbers.control import Repeat, Rows, repeat
from contactbench.numbers.dual import leaves, rebuild
from contactbench.numbers.protocol import Arithmetic, CannotRecord, Count, Namespace
from contactbench.scene import Cache, Scene, State, Vector, dot, key, scaled
from contactbench.scene.base import OwnState
from contactbench.solution import DIVERGENCE, Counts
from contactbench.splitting.composition import number
from contactbench.trace.program import Program, record

#: a step of the starter over a step, whose error is larger all the same
LONGER = 3
#: e^{γt/2} overflows for larger γt
LONGEST = 1400.0
#: variables of a step: z, the last increments, z'', the earlier z'', the last ψ, the fading sum of ψ, e^{−γt/2}, and
#: the part of the action that fades alone
Carried = tuple[Vector, Any, Vector, Any, Vector, Arithmetic, Arithmetic, Arithmetic]


def weights(nodes: Sequence[int], moments: Iterable[Fraction]) -> list[Fraction]:
    """Return w with Σ w_i (−i)^m = moments[m] for m = 0, 1, …, one moment for each node i."""
    moments, found = list(moments), []
    for i in nodes:
        polynomial = [Fraction(1)]  # 1 at −i and 0 at the other nodes
        for j in nodes:
            if j != i:
                lower, higher = [*polynomial, Fraction(0)], [Fraction(0), *polynomial]
                polynomial = [(j * a + b) / (j - i) for a, b in zip(lower, higher, strict=True)]
        found.append(sum((c * m for c, m in zip(polynomial, moments, strict=True)), Fraction(0)))
    return found


@dataclass(frozen=True)
class Multistep(FixedStep):
    """A multistep method with coefficients α₁, …, α_k and K = `forces` forces; see the module."""

    alpha: tuple[int, ...] = field(kw_only=True)
    forces: int = field(kw_only=True)
    one_step = False

    @property
    def beta(self) -> list[Fraction]:
        """Return β₁, …, β_K."""
        a = (1, *self.alpha)
        degrees = range(2, self.forces + 2)
        moments = [Fraction(sum(c * (-i) ** d for i, c in enumerate(a)), d * (d - 1)) for d in degrees]
        return weights(range(1, self.forces + 1), moments)

    @property
    def velocity(self) -> list[Fraction]:
        """Return c of h z'_n = z_n − z_{n−1} + h² Σ c_j z''_{n−j}, j = 0, …, K."""
        nodes = range(self.forces + 1)
        return weights(nodes, [Fraction((-1) ** m, (m + 1) * (m + 2)) for m in nodes])

    @property
    def quadrature(self) -> list[Fraction]:
        """Return d of ∫₀^{nh} g = h (Σ_{i=1}^n g_i + G_n − G_0), G_n = Σ d_j g_{n−j}, j = 0, …, K − 1."""
        nodes = range(self.forces + 1)
        adams = weights(nodes, [Fraction((-1) ** m, m + 1) for m in nodes])  # over the last step
        return [-sum(adams[j + 1 :], Fraction(0)) for j in range(self.forces)]

    def refuses(self, scene: Any) -> str | None:
        fits = scene.separable and scene.clock is None and not scene.nonlinear_damping
        if (why := unfit(self, scene, fits, "forces that depend on q alone and damping Γ = γ s")) is not None:
            return why
        if scene.gamma * scene.t_end > LONGEST:
            return f"{self.name} takes γ t up to {LONGEST:g}; scene {scene.name!r} goes on for longer"
        return None

    @property
    def starter(self) -> Tableau:
        """Return the Nyström method that steps to the points before the start; its order is at least this one."""
        return RKN8 if self.order <= RKN8.order else RKN12

    def counts(self, scene: Scene, n: int, carry: Sequence[str] | None = None) -> int:
        """Return n, plus one for the momentum, plus the evaluations for the points before the start."""
        return self.forces * self.starter.used + n + 1

    def advance(
        self, scene: Any, x: OwnState, h: Arithmetic, n: Count, xp: Namespace, repeat: Repeat = repeat
    ) -> OwnState:
        begin, step, end = self.parts(scene, x, h, xp, repeat, looped(repeat, self.forces, scene, x))
        return end(repeat(n, step, begin(x)))

    def parts(
        self, scene: Any, x: OwnState, h: Arithmetic, xp: Namespace, repeat: Repeat, loop: Repeat | None
    ) -> tuple[Callable[..., Carried], Callable[..., Carried], Callable[..., State]]:
        """Return the functions from a state to the variables of a step, over a step, and back to a state."""
        K, gamma, over_m = self.forces, scene.gamma, scene.inverse_mass
        beta, velocity = ([number(c, xp) for c in row] for row in (self.beta, self.velocity))
        alpha = list(accumulate((1, *self.alpha)))[1:-1]  # of the increments z_n − z_{n−1}
        ends = [number(c, xp) * xp.exp(-gamma * h * j) for j, c in enumerate(self.quadrature)]
        loss, gain = -xp.expm1(-gamma * h / 2), xp.expm1(gamma * h / 2)
        fading = -xp.expm1(-gamma * h)
        one, nothing = xp.exp(0 * h), 0 * h
        d, acts = len(x.q), x.s is not None
        rates, increments = (past_of(K, tuple(a + nothing for a in x.q), xp, loop) for _ in range(2))
        back = self.starter
        factors = factors_of(back, scene, None, -h, xp)
        stage = factors_by_stage(back, factors, -h, xp, loop)

        def force(q: Vector) -> tuple[Vector, Arithmetic]:
            """Return e^{−γt/2} z'' and ψ = ½ q·∇V − V."""
            own = pull(scene, q, None, acts)
            return tuple(own[:d]), own[d] if acts else nothing

        def before(carried: Any) -> Any:
            """Step backwards; the oldest point comes last."""
            y, own, z, shrunk, steps, slopes, psis = carried
            y, _, _ = nystrom_step(back, scene, y, -h, xp, back.used, loop, own, factors, stage)
            shrunk = shrunk + gain * shrunk
            older, (own, psi) = scaled(1 / shrunk, y.q), force(y.q)
            steps = increments.append(steps, tuple(a - b for a, b in zip(z, older, strict=True)))
            slopes = rates.append(slopes, scaled(1 / shrunk, own))
            return y, own, older, shrunk, steps, slopes, (*psis[1:], psi)

        def begin(x: OwnState) -> Carried:
            q, p = (tuple(a + nothing for a in v) for v in (x.q, x.p))
            start = undamped(scene, State(q, p))
            own, psi = force(q)
            known = start, own, q, one, increments.none, rates.none, (psi + nothing,) * (K + 1)
            *_, steps, slopes, psis = repeat(K, before, known)
            psis = (psi, *psis[1:])
            base = x.s - dot(x.q, x.p) / 2 - h * combine(ends, psis) if acts else nothing
            newest = increments.newest(steps), own, rates.newest(slopes)
            return q, *newest, psis, 0 * psi, one, base + nothing

        def step(carried: Carried) -> Carried:
            z, steps, rate, slopes, psis, total, shrunk, base = carried
            moved = zip(rate, rates.sum(slopes, beta[1:]), increments.sum(steps, alpha), strict=True)
            increment = tuple(h * h * (beta[0] * a + b) - c for a, b, c in moved)
            steps, slopes = increments.push(steps, increment), rates.push(slopes, rate)
            z = tuple(a + b for a, b in zip(z, increment, strict=True))
            # a reciprocal that was updated separately would make the product differ from 1 and shift the frequency
            shrunk = shrunk - loss * shrunk
            own, psi = force(scaled(shrunk, z))
            total = total - fading * total + psi
            return z, steps, scaled(1 / shrunk, own), slopes, (psi, *psis[:-1]), total, shrunk, base

        def end(carried: Carried, slope: bool = False) -> State:
            """Return the state, or its slope."""
            z, steps, rate, slopes, psis, total, shrunk, base = carried
            q, latest = scaled(shrunk, z), increments.sum(steps, (1.0,))
            pulls = zip(latest, rate, rates.sum(slopes, velocity[1:]), strict=True)
            v = tuple(a / h + h * (velocity[0] * b + c) for a, b, c in pulls)
            v = tuple(shrunk * a - gamma / 2 * b for a, b in zip(v, q, strict=True))
            masses = tuple(1 / w for w in over_m) if isinstance(over_m, tuple) else 1 / over_m
            p = scaled(masses, v)
            s = shrunk * shrunk * base + dot(q, p) / 2 + h * (total + combine(ends, psis)) if acts else None
            if not slope:
                return State(q, p, s)
            change = (shrunk * a - gamma * (b + gamma / 4 * c) for a, b, c in zip(rate, v, q, strict=True))
            pulled = scaled(masses, tuple(change))
            force = tuple(a + gamma * b for a, b in zip(pulled, p, strict=True))
            V = -dot(q, force) / 2 - psis[0]
            return State(v, pulled, dot(p, v) / 2 - V - gamma * s if acts else None)

        return begin, step, end

    def source(self, request: Request) -> Source | None:
        found = EqualSteps.of(self, request)
        if found is None:
            return None
        try:
            return OwnHistory(self, found)
        except CannotRecord:
            return None


class OwnHistory(Parts):
    """Equal steps of a multistep method, which save states from their history; parts of steps by its starter."""

    def __init__(self, method: Multistep, steps: EqualSteps) -> None:
        r = steps.request
        super().__init__(runge_kutta(method.name, method.starter, method.about), r, LONGER * steps.longest)
        self.run, self.method, self.t, self.piece = steps.run, method, steps.t, steps.piece
        self.h = steps.longest
        scene, carry, x = r.scene, r.carry, r.scene.initial(r.carry)
        d, q, K = len(r.start), x.q, method.forces
        like: Any = (q, (q,) * K, q, (q,) * K, (0.0,) * (K + 1), 0.0, 0.0, 0.0)
        size = 2 * d + len(leaves(like))

        def program(first: bool) -> Program:
            def interval(numbers: Any, h: Any, n: Any, y: Any, xp: Any, repeat: Repeat) -> list[Any]:
                x = scene.unpack(y[:d], carry)
                begin, step, end = method.parts(scene.with_numbers(numbers), x, h, xp, repeat, None)
                if first:
                    return [*scene.pack(x), *scene.pack(x), *leaves(begin(x))]
                carried = repeat(n, step, rebuild(like, y[2 * d :]))
                return [*scene.pack(end(carried)), *scene.pack(end(carried, slope=True)), *leaves(carried)]

            return record(interval, len(scene.numbers()), size, scene.motion, DIVERGENCE)

        identity = r.scene.identity
        self.loops = [
            _loops.get(
                key(identity, method, carry, first), partial(lambda first: Loop(program(first), 0.0), first)
            )
            for first in (True, False)
        ]
        self.size, self.numbers = size, np.array(scene.numbers())

    def steps(self, y0: np.ndarray) -> tuple[Nodes, Counts] | None:
        first, others = self.loops
        n = np.rint(np.diff(self.t) / self.h).astype(np.int64)
        h, python = np.full(len(n), self.h), self.request.engine == "python"
        d, scene = len(y0), self.request.scene
        row = np.concatenate([y0, np.zeros(self.size - d)])
        row = first.after(row, self.numbers, h[:1], n[:1], python=python)[0]
        rows = others.after(row, self.numbers, h, n, python=python)
        y, start = np.vstack([y0, rows[:, :d]]), scene.rhs(scene.unpack(y0.tolist(), self.request.carry))
        if self.run.first_divergence(y0, y) is not None:
            return None
        steps = int(n.sum())
        evaluations = self.method.counts(scene, steps) + 1
        nodes = Nodes(self.t, y, self.piece, np.vstack([scene.pack(start), rows[:, d : 2 * d]]))
        return nodes, Counts(steps, evaluations, 0, 0, self.kind)


_loops: Cache[Loop] = Cache(64)


class Shifted:
    """Vectors of earlier points, the newest first; a new one shifts the others."""

    def __init__(self, count: int, like: Vector) -> None:
        self.none = (like,) * count

    def append(self, past: tuple[Vector, ...], oldest: Vector) -> tuple[Vector, ...]:
        return *past[1:], oldest

    def newest(self, past: tuple[Vector, ...]) -> tuple[Vector, ...]:
        return past

    def push(self, past: tuple[Vector, ...], newest: Vector) -> tuple[Vector, ...]:
        return newest, *past[:-1]

    def sum(self, past: tuple[Vector, ...], weights: Sequence[Arithmetic | int]) -> list[Arithmetic]:
        return [combine(weights, [vector[i] for vector in past]) for i in range(len(past[0]))]


class Ring:
    """Vectors of earlier points in fixed rows: the newest replaces the oldest; past : the place of the newest."""

    def __init__(self, count: int, rows: Rows, xp: Any) -> None:
        self.count, self.none, self.rows, self.xp = count, count, rows, xp

    def append(self, past: Count, oldest: Vector) -> Count:
        self.rows[past - 1] = oldest
        return past - 1

    def newest(self, past: Count) -> Count:
        return self.count - 1 + 0 * past

    def push(self, past: Count, newest: Vector) -> Count:
        following = past + 1
        past = self.xp.where(following < self.count, following, following - self.count)
        self.rows[past] = newest
        return past

    def sum(self, past: Count, weights: Sequence[Arithmetic | int]) -> Sequence[Arithmetic]:
        by_age = [float(c) for c in (*weights, *[0] * self.count)[: self.count]]
        places = self.xp.asarray(
            [by_age[(self.count - 1 - k) % self.count] for k in range(2 * self.count - 1)]
        )
        return self.rows.combine(places, self.count - 1 - past, self.count)


def past_of(count: int, like: Vector, xp: Any, loop: Repeat | None) -> Any:
    """Return storage for vectors of earlier points: rows if the loop has them."""
    if loop is None or loop.rows is None:
        return Shifted(count, like)
    return Ring(count, loop.rows(count, like), xp)


def single_step(*_: object) -> NoReturn:
    raise NotImplementedError("a multistep method has no map of a single step")


def combine(coefficients: Sequence[Arithmetic | int], values: Sequence[Arithmetic]) -> Arithmetic:
    """Return Σ c v without zero coefficients; the last values may lack one."""
    pairs = zip(coefficients, values, strict=False)
    return sum(c * v for c, v in pairs if not (isinstance(c, int) and c == 0))


_kinds: dict[str, Any] = {"kind": "gradient", "step": single_step}
_source = "Quinlan, Tremaine, Astron. J. 100, 1694 (1990), doi:10.1086/115629"
for _order, _half in ((8, (1, -2, 2, -1, 0)), (12, (1, -2, 2, -1, 0, 0, 0))):
    _alpha, _name = (*_half, *_half[-2::-1])[1:], f"quinlan-tremaine{_order}"
    METHODS.add(Multistep(_name, _order, alpha=_alpha, forces=_order - 1, about=_source, **_kinds))
