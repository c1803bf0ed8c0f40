"""Compositions of subflows as data, and the one loop that runs them all.

A composition is the list of its stages, in the order in which they act, with exact coefficients.
`advance` runs n equal steps; where a step ends with the flow the next one starts with, the two are
merged into one (first same as last), so that for example Strang costs one gradient per step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from contactbench.flows import Flow, flows_of
from contactbench.scene import Mechanical, Scene

Stage = tuple[str, Fraction]
HALF, ONE = Fraction(1, 2), Fraction(1)


@dataclass(frozen=True)
class Composition:
    """A composition: `stages` act left to right; `order` is its classical order for γ > 0."""

    name: str
    order: int
    stages: tuple[Stage, ...]
    source: str

    @property
    def palindromic(self) -> bool:
        """Whether the stages read the same backwards, which makes the method time-symmetric."""
        return self.stages == self.stages[::-1]


PRINTED = Composition(
    "contact-printed", 1,
    (("kick", HALF), ("damp", ONE), ("drift", ONE), ("kick", HALF)),
    "the paper, eq. Strang-Integrator, read right to left: B½, C, A, B½",
)  # fmt: skip

ABC = Composition(
    "contact-abc", 2,
    (("kick", HALF), ("drift", HALF), ("damp", ONE), ("drift", HALF), ("kick", HALF)),
    "the palindromic three-part splitting; Bravetti, Seri, Vermeeren, Zadra, Celest. Mech. Dyn. Astron. "
    "132, 7 (2020), doi:10.1007/s10569-019-9946-9",
)  # fmt: skip

STRANG = Composition(
    "contact-strang", 2,
    (("kick", HALF), ("drift_damp", ONE), ("kick", HALF)),
    "Strang, SIAM J. Numer. Anal. 5, 506 (1968), doi:10.1137/0705041, on V and T + γs",
)  # fmt: skip

COMPOSITIONS = (PRINTED, ABC, STRANG)


def number(coefficient: Fraction, xp: Any) -> Any:
    """A coefficient as a number of the namespace: exact in mpmath, else a Python float."""
    if hasattr(xp, "mpf"):
        return xp.mpf(coefficient.numerator) / coefficient.denominator
    return float(coefficient)


def missing_flow(composition: Composition, scene: Scene) -> str | None:
    """Why the scene cannot be run with this composition, or None."""
    flows = flows_of(scene)
    for name, _ in composition.stages:
        if name not in flows and (name != "kick" or isinstance(scene, Mechanical)):
            return f"{composition.name} needs the subflow {name!r}, which scene {scene.name!r} does not have"
    return None


@dataclass(frozen=True)
class Plan:
    """One step written out for a scene: what opens a run, what closes a step, what joins two."""

    opening: tuple[Stage, ...]
    inner: tuple[Stage, ...]
    closing: tuple[Stage, ...]
    joint: tuple[Stage, ...]

    def count(self, flows: dict[str, Flow], kind: str, n: int) -> int:
        """How many operations of a kind n steps take."""

        def cost(stages: tuple[Stage, ...]) -> int:
            return sum(flows[name].costs.get(kind, 0) for name, _ in stages)

        return cost(self.opening) + n * cost(self.inner) + (n - 1) * cost(self.joint) + cost(self.closing)


def plan(composition: Composition, scene: Scene) -> Plan:
    """The composition on a scene, with the merged joint where first and last flow are the same."""
    flows = flows_of(scene)
    stages = tuple(stage for stage in composition.stages if stage[0] in flows)
    first, last = stages[0], stages[-1]
    if len(stages) > 1 and first[0] == last[0] and flows[first[0]].group:
        joint = ((first[0], first[1] + last[1]),)
        return Plan((first,), stages[1:-1], (last,), joint)
    return Plan((), stages, (), ())


Repeat = Callable[[Any, Callable[[Any], Any], Any], Any]


def repeat(n: int, body: Callable[[Any], Any], x: Any) -> Any:
    """n-fold application as a plain loop (the JAX engine passes its own)."""
    for _ in range(n):
        x = body(x)
    return x


def advance(
    composition: Composition, scene: Any, x: Any, h: Any, n: Any, xp: Any, repeat: Repeat = repeat
) -> Any:
    """n ≥ 1 steps of size h from state x.

    Merging at the joints leaves the map unchanged up to round-off.
    """
    flows = flows_of(scene)
    steps = plan(composition, scene)

    def prepared(stages: tuple[Stage, ...]) -> list[tuple[Flow, Any]]:
        return [(flows[f], flows[f].constants(scene, number(c, xp) * h, xp)) for f, c in stages]

    def run(stages: list[tuple[Flow, Any]], x: Any) -> Any:
        for flow, constants in stages:
            x = flow.apply(scene, x, constants, xp)
        return x

    opening, inner, closing, joint = map(prepared, (steps.opening, steps.inner, steps.closing, steps.joint))
    x = run(opening, x)
    if joint:
        x = repeat(n - 1, lambda x: run(joint, run(inner, x)), x)
        return run(closing, run(inner, x))
    return repeat(n, lambda x: run(inner, x), x)
