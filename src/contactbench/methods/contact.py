"""The contact splitting integrators: one registered method per composition."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from contactbench.methods.base import METHODS
from contactbench.methods.fixed_step import FixedStep, Piece
from contactbench.numbers.control import Repeat, repeat
from contactbench.numbers.protocol import Arithmetic, Count, Namespace
from contactbench.scene import AnyState, Scene
from contactbench.scene.base import OwnState
from contactbench.splitting.composition import (
    Composition,
    Stage,
    advance,
    by_the_clock,
    plan,
    refusal,
    runner,
)
from contactbench.splitting.modified import modified_hamiltonian
from contactbench.splitting.tables import COMPOSITIONS

#: evaluations of a first and of a further step, by method, kind of scene, and whether R is carried
_costs: dict[tuple[ContactMethod, str, bool], tuple[int, int]] = {}


@dataclass(frozen=True)
class ContactMethod(FixedStep):
    """A composition of exact contact flows, hence an exact conformal contact map at every step size."""

    composition: Composition = COMPOSITIONS[0]

    def refuses(self, scene: Scene) -> str | None:
        return refusal(self.composition, scene)

    def advance(
        self, scene: Scene, x: AnyState, h: Arithmetic, n: Count, xp: Namespace, repeat: Repeat = repeat
    ) -> AnyState:
        own = self.on(scene)
        after: AnyState = advance(own.composition, own.parts(scene, xp), x, h, n, xp, repeat)
        return after

    def parts(self, scene: Scene, xp: Namespace | None = None) -> Any:
        """Return the object whose flows are composed; without numbers only its flows are needed."""
        return scene

    def pieces(self, scene: Scene, whole: bool) -> tuple[Piece | None, ...]:
        own, parts = self.on(scene), self.parts(scene)
        if by_the_clock(own.composition, parts):  # the clock is no part of the state
            return super().pieces(scene, whole)
        steps = plan(own.composition, parts)
        made = steps.opening, steps.inner, steps.joint, steps.closing
        if whole and steps.joint:  # some stages in two of the pieces
            made = steps.opening, (), (*steps.inner, *steps.joint), (*steps.inner, *steps.closing)

        def piece(stages: tuple[Stage, ...]) -> Piece:
            return lambda scene, x, h, xp, repeat: runner(stages, own.parts(scene, xp), h, xp, repeat)(
                stages, x
            )

        return tuple(piece(stages) if stages else None for stages in made)

    def composed(self, scene: Scene) -> bool:
        return scene.is_contact

    def modified_hamiltonian(self, scene: Scene, x: OwnState, h: float) -> Arithmetic | None:
        own = self.composition
        symmetric = own.two_part and own.palindromic and not own.processor
        if not (symmetric and scene.separable and scene.has_hamiltonian_law):
            return None
        value: Arithmetic = modified_hamiltonian(scene, own, x, h)
        return value

    def counts(self, scene: Scene, n: int, carry: Sequence[str] | None = None) -> int:
        key = self, scene.kind, "R" in (scene.optional if carry is None else carry)
        if key not in _costs:
            kind = self.kind_on(scene)
            kinds = (kind, *(["attitude"] if kind == "rotation" and key[-1] else []))
            parts = self.parts(scene)
            steps = plan(self.composition, parts)
            once, twice = (steps.count(parts.flows, kinds, k) for k in (1, 2))
            _costs[key] = once, twice - once
        first, each = _costs[key]
        return first + (n - 1) * each

    def kind_on(self, scene: Scene) -> str:
        return "gradient" if "kick" in scene.flows else "rotation"


def contact_method(composition: Composition) -> ContactMethod:
    return ContactMethod(
        name=composition.name,
        order=composition.order,
        step=lambda scene, x, h, xp: advance(composition, scene, x, h, 1, xp),
        kind="gradient",
        family="contact",
        about=composition.source,
        contact=True,
        symmetric=composition.palindromic,
        mission=composition.mission,
        composition=composition,
    )


for _composition in COMPOSITIONS:
    METHODS.add(contact_method(_composition))
