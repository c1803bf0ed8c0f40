"""Linear multistep methods in z = e^{γt/2} q, z'' = γ²z/4 − e^{γt/2} ∇V(q)/m: one gradient a step.

    z_{n+1} + α₁ z_n + … + α_k z_{n+1−k} = h² (β₁ z''_n + … + β_K z''_{n+1−K}),

the β exact on polynomials of the highest degree; with symmetric α the energy of z has no drift.  Quinlan, Tremaine,
Astron. J. 100, 1694 (1990), doi:10.1086/115629.  Every interval starts afresh: its K points before are found going
back, by extrapolated Strang steps (Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, §II.9); the
action is s e^{γt} = s₀ + ½ [e^{γt} q·p] + ∫ e^{γt} (½ q·∇V − V).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import accumulate
from math import prod
from typing import Any, NoReturn

from contactbench.methods.base import METHODS, unfit
from contactbench.methods.fixed_step import FixedStep
from contactbench.numbers.control import Repeat, repeat
from contactbench.numbers.protocol import Arithmetic, Count, Namespace
from contactbench.scene import Scene, State, Vector, dot, scaled
from contactbench.scene.base import OwnState
from contactbench.splitting import composition
from contactbench.splitting.composition import number
from contactbench.splitting.tables import STRANG

#: γt beyond which e^{γt/2} is no longer a double
LONGEST = 1400.0
#: what a step carries: z, increments, z'' and ψ of the points before, the fading sum of ψ, e^{−γt/2} and e^{γt/2}
Carried = tuple[Vector, tuple[Vector, ...], tuple[Vector, ...], Vector, Arithmetic, Arithmetic, Arithmetic]


def weights(nodes: Sequence[int], moments: Iterable[Fraction]) -> list[Fraction]:
    """Return w with Σ w_i (−i)^m = moments[m] for m = 0, 1, …, as many as there are nodes i."""
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
    """z_{n+1} from α₁, …, α_k and so many forces; see above."""

    alpha: tuple[int, ...] = field(kw_only=True)
    forces: int = field(kw_only=True)
    one_step = False
    largest = 32

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

    def counts(self, scene: Scene, n: int, carry: Sequence[str] | None = None) -> int:
        """Return n, one for the momentum, and those of the points before the start."""
        each = sum(divisions + 1 for divisions in range(1, self.order // 2 + 1)) + 1
        return self.forces * each + n + 1

    def advance(
        self, scene: Any, x: OwnState, h: Arithmetic, n: Count, xp: Namespace, repeat: Repeat = repeat
    ) -> OwnState:
        K, gamma, over_m = self.forces, scene.gamma, scene.inverse_mass
        beta, velocity = ([number(c, xp) for c in row] for row in (self.beta, self.velocity))
        alpha = list(accumulate((1, *self.alpha)))[1:-1]  # of the increments z_n − z_{n−1}
        ends = [number(c, xp) * xp.exp(-gamma * h * j) for j, c in enumerate(self.quadrature)]
        loss, gain = -xp.expm1(-gamma * h / 2), xp.expm1(gamma * h / 2)
        fading = -xp.expm1(-gamma * h)
        one, nothing = xp.exp(0 * h), 0 * h

        def force(z: Vector, shrunk: Arithmetic, grown: Arithmetic) -> tuple[Vector, Arithmetic]:
            """Return z'' and ψ = ½ q·∇V − V."""
            q = scaled(shrunk, z)
            gradient = scene.dV(q)
            pull = scaled(over_m, gradient)
            rate = tuple(gamma * gamma / 4 * a - grown * b for a, b in zip(z, pull, strict=True))
            return rate, nothing if x.s is None else dot(q, gradient) / 2 - scene.V(q)

        def before(carried: Any) -> Any:
            """Go back by one step; the oldest point comes last."""
            at, z, shrunk, grown, increments, rates, psis = carried
            at = self.back(scene, at, h, xp, repeat)
            shrunk, grown = shrunk + gain * shrunk, grown - loss * grown
            older = scaled(grown, at.q)
            rate, psi = force(older, shrunk, grown)
            newest = tuple(a - b for a, b in zip(z, older, strict=True)), rate, psi
            histories = (
                (*past[1:], new) for past, new in zip((increments, rates, psis), newest, strict=True)
            )
            return at, older, shrunk, grown, *histories

        def step(carried: Carried) -> Carried:
            z, increments, rates, psis, total, shrunk, grown = carried
            increment = tuple(
                h * h * combine(beta, [rate[i] for rate in rates])
                - combine(alpha, [w[i] for w in increments])
                for i in range(len(z))
            )
            z = tuple(a + b for a, b in zip(z, increment, strict=True))
            shrunk, grown = shrunk - loss * shrunk, grown + gain * grown
            rate, psi = force(z, shrunk, grown)
            rates, psis, total = (rate, *rates[:-1]), (psi, *psis[:-1]), total - fading * total + psi
            return z, (increment, *increments[:-1]), rates, psis, total, shrunk, grown

        q, p = (tuple(a + nothing for a in v) for v in (x.q, x.p))
        rate, psi = force(q, one, one)
        rates, psis = (rate,) * (K + 1), (psi + nothing,) * (K + 1)
        *_, increments, rates, psis = repeat(K, before, (State(q, p), q, one, one, (q,) * K, rates, psis))
        first = combine(ends, psis)
        start = q, increments, rates, psis, 0 * psi, one, one
        z, increments, rates, psis, total, shrunk, _ = repeat(n, step, start)
        q = scaled(shrunk, z)
        v = tuple(
            increments[0][i] / h + h * combine(velocity, [rate[i] for rate in rates]) for i in range(len(q))
        )
        v = tuple(shrunk * a - gamma / 2 * b for a, b in zip(v, q, strict=True))
        masses = tuple(1 / w for w in over_m) if isinstance(over_m, tuple) else 1 / over_m
        p = scaled(masses, v)
        if x.s is None:
            return State(q, p)
        s = shrunk * shrunk * (x.s - dot(x.q, x.p) / 2 - h * first)
        return State(q, p, s + dot(q, p) / 2 + h * (total + combine(ends, psis)))

    def back(self, scene: Scene, x: State, h: Arithmetic, xp: Namespace, repeat: Repeat) -> State:
        """Return x one step before, extrapolated from Strang's method to the order of this one."""
        divisions = range(1, self.order // 2 + 1)
        shares = [prod(Fraction(m * m, m * m - k * k) for k in divisions if k != m) for m in divisions]
        found = [composition.advance(STRANG, scene, x, -h / m, m, xp, repeat) for m in divisions]
        by_share = [number(Fraction(c), xp) for c in shares]
        return State(
            *(
                tuple(
                    a + combine(by_share, [getattr(y, name)[i] - a for y in found])
                    for i, a in enumerate(getattr(x, name))
                )
                for name in ("q", "p")
            )
        )


def single_step(*_: object) -> NoReturn:
    raise NotImplementedError("a multistep method has no map of a single step")


def combine(coefficients: Sequence[Arithmetic | int], values: Sequence[Arithmetic]) -> Arithmetic:
    """Return Σ c v; whole coefficients may be 0, and the last values may have none."""
    pairs = zip(coefficients, values, strict=False)
    return sum(c * v for c, v in pairs if not (isinstance(c, int) and c == 0))


_kinds: dict[str, Any] = {"kind": "gradient", "step": single_step}
_source = "Quinlan, Tremaine, Astron. J. 100, 1694 (1990), doi:10.1086/115629"
for _order, _half in ((8, (1, -2, 2, -1, 0)), (12, (1, -2, 2, -1, 0, 0, 0))):
    _alpha, _name = (*_half, *_half[-2::-1])[1:], f"quinlan-tremaine{_order}"
    METHODS.add(Multistep(_name, _order, alpha=_alpha, forces=_order - 1, about=_source, **_kinds))
