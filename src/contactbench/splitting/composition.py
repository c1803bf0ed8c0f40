"""Compositions of subflows as data, and the loop that runs them all.

A composition is the list of its stages, in the order in which they act, with exact coefficients.
Most are two-part splittings: kicks b and merged drifts a in turn, b1 a1 b2 a2 … b1.  Such a list is also a composition
of a first-order method χ and its adjoint, χ(α1 h) χ*(α2 h) χ(α3 h) … with b1 = α1, a1 = α1 + α2, b2 = α2 + α3, …
(McLachlan 1995, doi:10.1137/0916010), which is how it is read where a scene comes in more than two parts.  Neighbouring
stages of one flow are merged, within a step and from one to the next, so that Strang costs one gradient per step.

A composition may be processed: n steps are π χⁿ π*, π* the stages π in reverse order.  The kernel χ, paid for at every
step, need only be conjugate to a method of the order, which leaves it far fewer conditions (Blanes, Casas, Ros,
SIAM J. Sci. Comput. 21, 711 (1999), doi:10.1137/S1064827598332497).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import accumulate, chain, cycle, groupby
from typing import Any

from contactbench.numbers.control import Repeat, repeat
from contactbench.numbers.control import turns as unrolled
from contactbench.numbers.protocol import Arithmetic, Count, Namespace, has_arrays, has_digits
from contactbench.scene import BodyState, Flow, RigidBody, Scene
from contactbench.scene.base import OwnState
from contactbench.scene.flow import Constants, damped_time
from contactbench.scene.rigid_body import rotation, spin, top_rate, turn_rate

Stage = tuple[str, Fraction]
#: a state, and its stage or its clock
Clocked = tuple[BodyState, Any]
HALF, ONE = Fraction(1, 2), Fraction(1)


@dataclass(frozen=True)
class Composition:
    """Define a step as a composition of flows.

    Parameters
    ----------
    name
        The name of the method.
    order
        Its order for γ > 0.
    stages
        Pairs of a flow's name and its part of the step; they act left to right.
    source
        The paper, table and DOI that the coefficients are from.
    nystrom
        Whether the order rests on [B, [B, [B, A]]] = 0, which holds for kicks and (merged) drifts only; other scenes
        are refused.
    processor
        Stages that act once before the first step and, in reverse order, once after the last (Nyström
        compositions).  Palindromic stages between them make the whole run palindromic.
    postprocessor
        Other stages that act once after the last step.
    mission
        Whether the benchmark is about the method, as `Method.mission`.
    """

    name: str
    order: int
    stages: tuple[Stage, ...]
    source: str
    nystrom: bool = False
    processor: tuple[Stage, ...] = ()
    postprocessor: tuple[Stage, ...] = ()
    mission: bool = False

    @property
    def palindromic(self) -> bool:
        return self.stages == self.stages[::-1]

    @property
    def two_part(self) -> bool:
        return {name for name, _ in self.stages} == {"kick", "drift_damp"}


def palindrome(first: str, second: str, half: Sequence[str | float]) -> tuple[Stage, ...]:
    """Return a palindromic list from its first half; the middle pair completes both sums to one."""
    left = [Fraction(str(c)) for c in half]
    sums = sum(left[::2], Fraction(0)), sum(left[1::2], Fraction(0))
    beside, centre = HALF - sums[len(left) % 2], ONE - 2 * sums[(len(left) + 1) % 2]
    left.append(beside)
    return tuple(((first, second)[i % 2], c) for i, c in enumerate((*left, centre, *reversed(left))))


def balance(first: str, second: str, coefficients: Sequence[str | float]) -> tuple[Stage, ...]:
    """Return a two-part list, completed by two coefficients so that each part adds up to zero."""
    stages = [((first, second)[i % 2], Fraction(str(c))) for i, c in enumerate(coefficients)]
    for _ in range(2):
        name = (first, second)[len(stages) % 2]
        stages.append((name, -sum((c for other, c in stages if other == name), Fraction(0))))
    return tuple(stages)


def strang_composition(gammas: Iterable[Fraction | int]) -> tuple[Stage, ...]:
    """Return Strang steps of sizes γ1, γ2, … one after another, neighbouring kicks merged."""
    steps = ((("kick", c / 2), ("drift_damp", c), ("kick", c / 2)) for c in map(Fraction, gammas))
    return merge(chain.from_iterable(steps))


def merge(stages: Iterable[Stage]) -> tuple[Stage, ...]:
    neighbours = groupby(stages, lambda stage: stage[0])
    return tuple((name, sum((c for _, c in same), Fraction(0))) for name, same in neighbours)


def number(coefficient: Fraction, xp: Namespace) -> Arithmetic:
    if has_digits(xp):
        return xp.mpf(coefficient.numerator) / coefficient.denominator
    return float(coefficient)


# -- a composition on a scene ----------------------------------------------------------------------
def refusal(composition: Composition, scene: Scene) -> str | None:
    if not scene.flows:
        return f"{composition.name} needs parts with exact flows; scene {scene.name!r} has none{scene.lacks}"
    if composition.nystrom and "drift_damp" not in scene.flows:
        return f"{composition.name} needs kicks and a merged drift and damping; scene {scene.name!r} has none"
    return scene.own_equations


def stages_on(composition: Composition, scene: Scene) -> tuple[Stage, ...]:
    if {name for name, _ in composition.stages} <= scene.flows.keys():
        return composition.stages
    if composition.two_part:
        alphas = accumulate((c for _, c in composition.stages[:-1]), lambda alpha, c: c - alpha)
        orders = cycle((scene.parts, scene.parts[::-1]))  # of χ and χ* in turn
        return merge((name, alpha) for alpha, parts in zip(alphas, orders, strict=False) for name in parts)
    names = scene.paper_flows
    own = ((names[name], coefficient) for name, coefficient in composition.stages if name in names)
    return merge(stage for stage in own if stage[0] in scene.flows)


@dataclass(frozen=True)
class Plan:
    """One step written out for a scene: stages that open a run, that close a step, and that join two steps."""

    opening: tuple[Stage, ...]
    inner: tuple[Stage, ...]
    closing: tuple[Stage, ...]
    joint: tuple[Stage, ...]

    def costs(self, flows: Mapping[str, Flow], kinds: Collection[str]) -> tuple[int, int, int]:
        """Return the evaluations of the begin of a run, of a further step, and of the way to a saved state."""
        opening, inner, closing, joint = (
            sum(flows[name].costs.get(kind, 0) for name, _ in stages for kind in kinds)
            for stages in (self.opening, self.inner, self.closing, self.joint)
        )
        return opening - joint, inner + joint, closing


def plan(composition: Composition, scene: Scene) -> Plan:
    """Return the composition on a scene, with the merged joint where first and last flow are the same."""
    before, after = composition.processor, composition.postprocessor
    return arrange(stages_on(composition, scene), before, after, by_the_clock(composition, scene))


def arrange(
    stages: tuple[Stage, ...],
    before: tuple[Stage, ...] = (),
    after: tuple[Stage, ...] = (),
    clocked: bool = False,
) -> Plan:
    """Return the plan of stages and a processor; clocked : every step ends with the joint."""
    first, last = stages[0], stages[-1]
    if len(stages) == 1 or first[0] != last[0]:
        return Plan(before, stages, after or before[::-1], ())
    inner, joint = stages[1:-1], merge((last, first))
    if after:
        return Plan((*before, first), inner, (last, *after), joint)
    if not (before or clocked):
        return Plan((first,), inner, (last,), joint)
    # the last joint runs one first stage too far, which is taken back at the end
    back = (first[0], -first[1])
    return Plan(merge((*before, first)), (*inner, *joint), merge((back, *before[::-1])), ())


def advance(
    composition: Composition,
    scene: Scene,
    x: OwnState,
    h: Arithmetic,
    n: Count,
    xp: Namespace,
    repeat: Repeat = repeat,
) -> OwnState:
    """Advance the state x by n ≥ 1 steps of size h, merged at the joints."""
    if by_the_clock(composition, scene):
        assert isinstance(scene, RigidBody)
        return advance_by_the_clock(composition, scene, x, h, n, xp, repeat)
    steps = plan(composition, scene)
    opening, inner, closing, joint = steps.opening, steps.inner, steps.closing, steps.joint
    run = runner((*opening, *inner, *closing, *joint), scene, h, xp, repeat)
    if not joint:
        return run(closing, repeat.steps(n, lambda x: run(inner, x), run(opening, x), h))
    x = repeat.steps(n - 1, lambda x: run((*inner, *joint), x), run(opening, x), h)
    return run((*inner, *closing), x)


def runner(
    stages: Iterable[Stage], scene: Scene, h: Arithmetic, xp: Namespace, repeat: Repeat
) -> Callable[[Sequence[Stage], OwnState], OwnState]:
    """Return ``run(some, x)``, which applies some of the stages; their constants are computed once."""
    flows, constants, rolled = scene.flows, stage_constants(stages, scene, h, xp), repeat.over_stages

    def run(stages: Sequence[Stage], x: OwnState) -> OwnState:
        if rolled and len(stages) % 2 and len(stages) > 1:  # a processor: one stage ahead of the pairs
            return run(stages[1:], run(stages[:1], x))
        flows_in_turn = [name for name, _ in stages]
        period = shortest_period(flows_in_turn) if rolled and stages else len(stages)
        columns = [constants(stages[i::period]) for i in range(period)]

        def round_of(k: Count, x: OwnState) -> OwnState:
            for name, column in zip(flows_in_turn, columns, strict=False):
                x = flows[name].apply(scene, x, column(k), xp)
            return x

        if period == len(stages):
            return round_of(0, x)
        another = lambda carried: (round_of(carried[1], carried[0]), carried[1] + 1)  # noqa: E731
        return repeat(len(stages) // period, another, (x, 0))[0]

    return run


def shortest_period(names: list[str]) -> int:
    size = len(names)
    return next(p for p in range(1, size + 1) if size % p == 0 and names == names[:p] * (size // p))


def stage_constants(
    stages: Iterable[Stage], scene: Scene, h: Arithmetic, xp: Namespace
) -> Callable[[Sequence[Stage]], Callable[[Any], Constants]]:
    """Return ``constants(some)(k)``, of the k-th of some stages of one flow, all computed once."""
    flows, distinct = scene.flows, list(dict.fromkeys(stages))
    if not has_arrays(xp):
        scalars = {(f, c): flows[f].constants(scene, number(c, xp) * h, xp) for f, c in distinct}
        return lambda some: [scalars[stage] for stage in some].__getitem__
    coefficients = {name: [c for f, c in distinct if f == name] for name, _ in distinct}
    vectors = {f: flows[f].constants(scene, scale(cs, h, xp), xp) for f, cs in coefficients.items()}

    def constants(some: Sequence[Stage]) -> Callable[[Any], Constants]:
        name = some[0][0]
        rows = [coefficients[name].index(c) for _, c in some]
        if len(rows) == 1:
            return lambda k: entry(vectors[name], rows[0])
        column = entry(vectors[name], xp.asarray(rows))
        return lambda k: entry(column, k)

    return constants


def entry(constants: Constants, i: object) -> Constants:
    """Return entry i of constants, which are a vector, None, or a tuple of such; i may be an array."""
    if isinstance(constants, tuple):
        return tuple(entry(c, i) for c in constants)
    return None if constants is None else constants[i]


def by_the_clock(composition: Composition, scene: Scene) -> bool:
    """Return whether a step on the scene is undamped in a rescaled time, see `advance_by_the_clock`."""
    odd = len(composition.stages) % 2 == 1  # its turns end as they begin
    return composition.two_part and odd and "free_damp" in scene.flows


def advance_by_the_clock(
    composition: Composition,
    scene: RigidBody,
    x: BodyState,
    h: Arithmetic,
    n: Count,
    xp: Namespace,
    repeat: Repeat,
) -> BodyState:
    """Advance the free body and isotropic damping together, without splitting the two.

    Damping only rescales the free body's clock: m = e^{γt} M and R move as if undamped in the time τ, dτ = e^{−γt} dt,
    and a step from t takes the time e^{−γt} φ(h).  What remains at the end is one factor on M and s, and one spin for
    all steps, which commutes with the other flows.  The last step includes the opening of a next one, which is then
    undone: code outside the loop of a compiled program costs more than a rotation.
    """
    stages, gamma, decay = stages_on(composition, scene), scene.gamma, xp.exp(-scene.gamma * h)
    tau = damped_time(gamma, h, xp)
    smallest, middle, largest = scene.by_inertia
    first, *turns = (c for name, c in stages if name == "turn")
    opening = scale([first], tau * turn_rate(scene), xp)[0]
    turned = scale(turns, tau * turn_rate(scene), xp)
    topped = scale((c for name, c in stages if name == "top"), tau * top_rate(scene), xp)

    def both(x: BodyState, about_largest: Arithmetic, about_smallest: Arithmetic) -> BodyState:
        return rotation(rotation(x, largest, about_largest, xp), smallest, about_smallest, xp)

    def first_rounds(x: BodyState, clock: Arithmetic) -> BodyState:
        """Advance by all rounds of a step but the last, written out or as a loop."""

        def another(carried: Clocked) -> Clocked:
            x, k = carried
            return both(x, clock * topped[k], clock * turned[k]), k + 1

        return (repeat if repeat.over_stages else unrolled)(len(turns) - 1, another, (x, 0))[0]

    joint = turned[-1] + decay * opening  # the next step starts on a slower clock

    def step(carried: Clocked) -> Clocked:
        x, clock = carried
        return both(first_rounds(x, clock), clock * topped[-1], clock * joint), clock * decay

    one = xp.exp(0 * h)  # as a number of the engine's kind
    x, clock = repeat(n, step, (rotation(x, smallest, opening, xp), one))
    x = rotation(x, smallest, -clock * opening, xp)
    x = spin(x, damped_time(gamma, h * n, xp) * scene.inverse_inertia[middle], xp)
    return scene.decayed(x, xp.exp(-gamma * h * n))


def scale(coefficients: Iterable[Fraction], factor: Arithmetic, xp: Namespace) -> Any:
    values = [number(c, xp) for c in coefficients]
    if has_arrays(xp):
        return xp.multiply.outer(xp.asarray(values), factor)
    return [c * factor for c in values]
