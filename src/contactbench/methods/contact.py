"""The contact splitting integrators: one registered method per composition."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from contactbench.methods.base import METHODS
from contactbench.methods.fixed_step import FixedStep, Piece
from contactbench.methods.loops import SAME
from contactbench.numbers.control import Repeat, choose, repeat, when
from contactbench.numbers.dual import leaves, rebuild
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

#: `Plan.costs` by method, kind of scene, and whether R is carried
_costs: dict[tuple[ContactMethod, str, bool], tuple[int, int, int]] = {}


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

    def costs(self, scene: Scene, carry: Sequence[str] | None = None) -> tuple[int, int, int]:
        key = self, scene.kind, "R" in (scene.optional if carry is None else carry)
        if key not in _costs:
            kind = self.kind_on(scene)
            kinds = (kind, *(["attitude"] if kind == "rotation" and key[-1] else []))
            parts = self.parts(scene)
            _costs[key] = plan(self.composition, parts).costs(parts.flows, kinds)
        return _costs[key]

    def counts(self, scene: Scene, n: int, carry: Sequence[str] | None = None) -> int:
        opening, each, closing = self.costs(scene, carry)
        return opening + n * each + closing

    def keeping(self, scene: Scene) -> ContactMethod:
        # where the motion is at a break, the state of the kernel is not
        timed = scene.clock is None or (scene.keeps_dates and not scene.layout)
        if not (self.composition.processor and timed):
            return self
        return Keeping(**{each.name: getattr(self, each.name) for each in fields(ContactMethod)}, method=self)

    def kind_on(self, scene: Scene) -> str:
        return "gradient" if "kick" in scene.flows else "rotation"


@dataclass(frozen=True)
class Keeping(ContactMethod):
    """A processed composition whose runs keep the state of the kernel at saved times, and pay for the closing alone."""

    method: ContactMethod = field(kw_only=True)
    iterates = True  # evaluations are counted as it runs

    def parts(self, scene: Scene, xp: Namespace | None = None) -> Any:
        return self.method.parts(scene, xp)

    def cost_of_saving(self, scene: Scene, carry: Sequence[str]) -> int:
        return self.costs(scene, carry)[2]

    def beside(self, scene: Scene, carry: Sequence[str]) -> int:
        """Return how many numbers are kept: evaluations, the last step, and the state of the kernel."""
        return 2 + len(scene.labels(tuple(carry)))

    def advance_beside(
        self,
        scene: Scene,
        x: Any,
        h: Arithmetic,
        n: Count,
        xp: Namespace,
        repeat: Repeat,
        beside: Sequence[Arithmetic],
    ) -> tuple[OwnState, Sequence[Arithmetic]]:
        """Return the state after n steps and the numbers beside it."""
        parts = self.parts(scene, xp)
        steps = plan(self.composition, parts)
        opening, inner, closing, joint = steps.opening, steps.inner, steps.closing, steps.joint
        run = runner((*opening, *inner, *closing, *joint), parts, h, xp, repeat)
        spent, last, *kept = beside
        goes_on, begins = abs(last - h) <= SAME * h, abs(last - h) > SAME * h
        z = rebuild(x, kept)
        if joint:
            z = when(goes_on, lambda z: run(joint, z), z, xp)
        z = when(begins, lambda z, x: run(opening, x), z, xp, x)
        z = repeat.steps(n - 1, lambda z: run((*inner, *joint), z), z, h)
        z = run(inner, z)
        first, each, back = self.costs(scene, x._fields)
        spent = spent + choose(begins, first, 0.0, xp) + n * each + back
        # the next interval counts its times from its own begin
        kernel = z if scene.clock is None else z._replace(t=z.t - n * h)
        return run(closing, z), (spent, h, *leaves(kernel))


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
