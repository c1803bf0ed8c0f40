"""Steps that follow the motion: compositions of the two flows of the logarithmic Hamiltonian, for V < 0.

With P = e^{γt} p and E = −K, K = e^{−γt} P²/2m + e^{γt} V, at the start,

    Λ = log(e^{−γt} P²/2m + E) − log(−e^{γt} V(q))

is zero along the motion, and the time is one of its variables: dt = dτ/A, A = e^{−γt} P²/2m + E.  Steps of equal τ are
short where V is deep.  Both parts have exact flows.  A drift keeps A: t ↦ t + h/A, q ↦ q + P ∫e^{−γt} dt/m, E ↦ E +
(e^{−γt₀} − e^{−γt₁}) P²/2m; a kick is P ↦ P + h ∇log(−V), E ↦ E + γh.  s e^{γt} follows from the contact form
ds − P dq − E dt.  The code stores p, E e^{−γt} and h e^{−γt}, without the factor e^{γt}.  For γ = 0 see Mikkola,
Tanikawa, Celest. Mech. Dyn. Astron. 74, 287 (1999), doi:10.1023/A:1008368322547; Preto, Tremaine, Astron. J. 118, 2532
(1999), doi:10.1086/301102.  A is not quadratic in the momenta: general tables keep their order, Nyström tables do not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

from contactbench.blame import their_code
from contactbench.errors import BadInput
from contactbench.methods.base import CALLBACKS, METHODS, Method
from contactbench.methods.by_tolerance import ToleranceRun, when
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.prepared import NO_NUMBER, Prepared, Request
from contactbench.methods.runge_kutta import table
from contactbench.methods.step_choice import ChosenStep
from contactbench.numbers.control import Repeat, choose, repeat, repeat_while
from contactbench.numbers.protocol import Arithmetic, Condition, abilities, has_digits
from contactbench.scene import Mechanical, Scene, State, dot
from contactbench.scene.flow import damped_time
from contactbench.splitting.composition import Composition
from contactbench.splitting.tables import O8

#: numbers after the packed state, besides the state at the end of the last whole step: E e^{−γt} there, the time left,
#: each with the rounding error of its sum, h e^{−γt}; trials, rejected trials, time not covered
BESIDE = 8
#: a saved time is met to this many roundings of an interval
ROUNDINGS = 4
#: larger than any time and depth
HUGE = 1e300


class Trial(NamedTuple):
    """A state inside a step, the changes of E e^{−γt} and of t, h e^{−γt}, and the least value of A and −V so far."""

    x: State
    depth: Arithmetic
    t: Arithmetic
    width: Arithmetic
    least: Arithmetic


class Base(NamedTuple):
    """The end of the last whole step, see `BESIDE`."""

    x: State
    depth: Arithmetic
    lost: Arithmetic
    left: Arithmetic
    late: Arithmetic
    width: Arithmetic


#: variables of the loop: base; the part of a step to try, and bounds of the part that meets the saved time; the state
#: reached; 1 to go on, 0 at the saved time, −1 if it cannot be reached; trials, trials without a whole step
Carried = tuple[Base, Arithmetic, Arithmetic, Arithmetic, State, Arithmetic, Arithmetic, Arithmetic]


def add(sum_: Arithmetic, lost: Arithmetic, change: Arithmetic) -> tuple[Arithmetic, Arithmetic]:
    """Return sum + lost + change and its rounding error (Knuth's two-sum)."""
    change = change + lost
    new = sum_ + change
    back = new - sum_
    return new, (sum_ - (new - back)) + (change - back)


@dataclass(frozen=True)
class Logarithmic(Method):
    """A general composition of the flows of Λ that begins with a drift; it has a gradient per kick."""

    name: str
    order: int
    composition: Composition
    about: str
    engines: tuple[str, ...] = ("llvm", "python")
    family: str = "contact"
    symmetric: bool = True
    kind: str = "gradient"
    adaptive = False
    one_step = False
    follows = True
    tolerance = FixedStep.tolerance
    #: the step of the first pilot: three to a revolution
    longest = 2.0
    failure = "a stage met V ≥ 0: V < 0 is needed all along the motion, and maybe a smaller step"

    def refuses(self, scene: Any) -> str | None:
        V = math.nan
        if scene.kind != "mechanical" or scene.nonlinear_damping:
            needs = f"{self.name} needs forces that depend on q alone and damping Γ = γ s"
            return f"{needs}, which scene {scene.name!r} does not have"
        with their_code(f"scene {scene.name!r}"), suppress(*NO_NUMBER):
            V = scene.potential_at(scene.initial(()))
        if not V < 0:
            return f"{self.name} needs V < 0 along the motion; scene {scene.name!r} starts at V = {V:.6g}"
        own: str | None = scene.own_equations
        return own

    def prepare(self, request: Request) -> Prepared:
        if request.steps is not None:
            raise BadInput(f"step = {len(request.steps)} steps: {self.name} takes one, of τ")
        if request.step is not None:
            return self.run_of(request)
        return ChosenStep(self.name, request, self, None)

    def run_of(self, request: Request, loop: object = None) -> ToleranceRun:
        return ToleranceRun(self.name, request, self)

    def per_step(self, scene: Scene, carry: Sequence[str] | None = None) -> int:
        return len(self.composition.stages) // 2

    def counts(self, scene: Scene, n: int, carry: Sequence[str] | None = None) -> int:
        """Return the evaluations of n whole steps, without the trials for saved times."""
        return self.evaluations(n, 0)

    def kind_on(self, scene: Scene) -> str:
        return self.kind

    def step_cost(self, scene: Scene, engine: str) -> float | None:
        return self.per_step(scene) if engine in CALLBACKS else None

    # -- used by `ToleranceRun` ----------------------------------------------------------------------
    def settings(self, request: Request, step: float | None) -> list[float]:
        assert step is not None
        return [step]

    def beside(self, size: int) -> int:
        return size + BESIDE

    def evaluations(self, tried: int, entered: int) -> int:
        return tried * (len(self.composition.stages) // 2) + 1

    def advance(self, scene: Any, x: State, h: Arithmetic, n: int, xp: Any) -> State:
        """Return the state a time n h later, by steps h of τ."""
        nothing = [0 * h] * self.beside(len(Scene.pack(x)))
        return self.march(scene, x, nothing, n * h, HUGE, [h], xp)[0]

    def march(
        self,
        scene: Mechanical,
        x: State,
        beside: Sequence[Arithmetic],
        span: Arithmetic,
        most: Arithmetic,
        settings: Sequence[Arithmetic],
        xp: Any,
        repeat: Repeat = repeat,
    ) -> tuple[State, list[Any]]:
        """Return the state after a span and the numbers of `BESIDE`; most : trials of the whole run at most."""
        size = len(beside) - BESIDE
        carry = () if x.s is None else ("s",)
        depth, lost, left, late, width, tried, rejected, lag = beside[size:]
        rolled, stages = repeat if repeat.over_stages else None, self.composition.stages
        shares = [table([c for _, c in stages[i::2]], xp, rolled) for i in (0, 1)]
        rounding = 10.0**-xp.dps if has_digits(xp) else 2.0**-52

        def enter(_: object, x: State) -> tuple[State, Arithmetic, Arithmetic]:
            return x, *self.start(scene, x, settings[0], xp)

        base = scene.unpack(list(beside[:size]), carry)
        base, depth, width = when(width == 0, enter, (base, depth, width), xp, x)
        left, late = add(left, late, span)
        within = ROUNDINGS * rounding * (span + left)

        def going(carried: Carried) -> Condition:
            *_, more, tried, _ = carried
            return (more > 0) & (tried < most)

        def turn(carried: Carried) -> Carried:
            base, part, low, high, _, _, tried, rejected = carried
            try:
                trial, speed = self.step(scene, base, part, shares, xp, repeat)
            except NO_NUMBER:
                if not abilities(xp).branch:
                    raise
                trial, speed = Trial(base.x, depth, part, width, -part), part
            ahead = (base.left - trial.t) + base.late
            fine = (trial.least > 0) & (trial.t > 0) & (trial.t < HUGE)
            met = fine & ((abs(ahead) <= within) | (high - low <= rounding))
            whole = fine & (part >= 1) & (ahead > within)

            def accept(_: object, base: Base, trial: Trial) -> tuple[Base, Arithmetic]:
                sums = *add(base.depth, base.lost, trial.depth), *add(base.left, base.late, -trial.t)
                return Base(trial.x, *sums, trial.width), rejected

            other = choose(met, rejected, rejected + 1, xp)
            base, rejected = when(whole, accept, (base, other), xp, base, trial)
            ends = zip(Scene.pack(trial.x), Scene.pack(base.x), strict=True)
            reached = [choose(met, a, b, xp) for a, b in ends]
            early = ahead > 0
            low, high = choose(early, part, low, xp), choose(early, high, part, xp)
            better = part + ahead / speed
            inside = (better > low) & (better < high)
            part = choose(inside, better, (low + high) / 2, xp)
            part, low, high = (choose(whole, a, b, xp) for a, b in ((1.0, part), (0.0, low), (1.0, high)))
            more = choose(fine, choose(met, 0.0, 1.0, xp), -1.0, xp)
            return base, part, low, high, scene.unpack(reached, carry), more, tried + 1, rejected

        one = 1.0 + 0 * span
        start = Base(base, depth, lost, left, late, width)
        more = choose(lag > 0, -one, one, xp)
        before = start, one, 0 * one, one, base, more, tried, rejected
        end, _, _, _, x, more, tried, rejected = repeat_while(going, turn, before, xp)
        lag = choose(lag > 0, lag + span, choose(more == 0, 0 * one, end.left, xp), xp)
        return x, [*Scene.pack(end.x), *end[1:], tried, rejected, lag]

    def start(self, scene: Mechanical, x: State, step: Arithmetic, xp: Any) -> tuple[Arithmetic, Arithmetic]:
        """Return E at the start, of an unbound motion −V, and the step of τ, in units of the action V²/√(2E ∇V·∇V/m).

        For Kepler's motion the unit is √(mka) at every point, and 2π/step steps make a revolution.
        """
        V, gradient = scene.V(x.q), scene.dV(x.q)
        depth = -(scene.kinetic(x.p) + V)
        square = abs(2 * choose(depth > 0, depth, V, xp) * dot(gradient, scene.velocity(gradient)))
        return depth, step * V * V / xp.sqrt(choose(square > 0, square, 1.0, xp))

    def step(
        self, scene: Mechanical, base: Base, part: Arithmetic, shares: Sequence[Any], xp: Any, repeat: Repeat
    ) -> tuple[Trial, Arithmetic]:
        """Return the trial after a part of a step, and the derivative of its time by the part."""
        gamma, (drifts, kicks) = scene.gamma, shares

        def drift(z: Trial, share: Arithmetic) -> Trial:
            kinetic, depth = scene.kinetic(z.x.p), base.depth + z.depth
            A = kinetic + depth
            h = share * part * z.width
            t = h / A
            path = damped_time(gamma, t, xp)
            loss = gamma * path
            q = tuple(a + path * b for a, b in zip(z.x.q, scene.velocity(z.x.p), strict=True))
            p, s = tuple(a - loss * a for a in z.x.p), z.x.s
            if s is not None:
                s = s + kinetic * path + h * (1 - xp.log(A) - gamma * z.t)
                s = s - loss * s
            change = z.depth + loss * (kinetic - loss * kinetic - depth)
            return Trial(State(q, p, s), change, z.t + t, z.width - loss * z.width, least(A, z.least))

        def kick(z: Trial, share: Arithmetic) -> Trial:
            V, gradient = scene.V(z.x.q), scene.dV(z.x.q)
            h = share * part * z.width
            p = tuple(a + h / V * b for a, b in zip(z.x.p, gradient, strict=True))
            s = None if z.x.s is None else z.x.s + h * (xp.log(-V) + gamma * z.t)
            return Trial(State(z.x.q, p, s), z.depth + gamma * h, z.t, z.width, least(-V, z.least))

        def least(a: Arithmetic, b: Arithmetic) -> Arithmetic:
            return choose(a > b, b, a, xp)

        def both(carried: tuple[Trial, int]) -> tuple[Trial, int]:
            z, k = carried
            return kick(drift(z, drifts[k]), kicks[k]), k + 1

        nothing = 0 * part
        z = Trial(base.x, nothing, nothing, base.width + nothing, HUGE + nothing)
        z = drift(repeat(self.per_step(scene), both, (z, 0))[0], drifts[-1])
        return z, z.width / (scene.kinetic(z.x.p) + base.depth + z.depth)


_about = f"flows of the logarithmic Hamiltonian with damping, V < 0; coefficients: {O8.source}"
METHODS.add(Logarithmic("contact-log8", O8.order, O8, _about))
