"""Contact methods with an exact linear part: compositions of a `Split` about an equilibrium."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, cast

from contactbench.methods.base import METHODS, unfit
from contactbench.methods.contact import ContactMethod
from contactbench.methods.dense import Source
from contactbench.methods.prepared import Prepared, Request
from contactbench.numbers.protocol import Namespace
from contactbench.scene import Mechanical, Scene
from contactbench.splitting.composition import Composition, advance
from contactbench.splitting.linear import Expansion, Split, expand, is_quadratic
from contactbench.splitting.tables import LINEAR


@dataclass(frozen=True)
class ContactLinear(ContactMethod):
    """A composition of the exact flow of T + U + γs and kicks of the rest of the potential, U of an `Expansion`.

    Whatever the expansion, every step is an exact contact map of the order of the composition.
    """

    expansion: Expansion | None = None
    expands = True
    stiff: bool = False
    #: its matrices are dense, and products written out grow as the square
    largest: int = 32

    def refuses(self, scene: Scene) -> str | None:
        fits = scene.separable and not (scene.nonlinear_damping or scene.keeps_dates)
        if fits and scene.has_users_functions and {"potential", "gradient"} & {*scene.functions_of_floats}:
            fits = False
        return unfit(self, scene, fits, "H = T(p) + V(q) + γ s and a potential that can be differentiated")

    def solves(self, scene: Scene) -> bool:
        return self.refuses(scene) is None and is_quadratic(cast(Mechanical, scene))

    def on(self, scene: Scene, about: Sequence[float] | None = None) -> ContactLinear:
        """Return the method with the expansion of a scene; without a processor if no mode needs it."""
        if self.expansion is not None:
            return self
        own = cast(Mechanical, scene)
        expansion = expand(own, about)
        return with_expansion(self, expansion, expansion.has_creep(float(cast(Any, own.gamma))))

    def parts(self, scene: Scene, xp: Namespace | None = None) -> Any:
        if xp is None:
            return Split
        assert self.expansion is not None
        return Split(scene, self.expansion, xp)

    def counts(self, scene: Scene, n: int, carry: Sequence[str] | None = None) -> int:
        if self.expansion is None:
            return self.on(scene).counts(scene, n, carry)
        return super().counts(scene, n, carry)

    def prepare(self, request: Request) -> Prepared:
        if self.expansion is None:
            return self.on(request.scene, request.about).prepare(request)
        return super().prepare(request)

    def source(self, request: Request) -> Source | None:
        if self.expansion is None:
            return self.on(request.scene, request.about).source(request)
        return super().source(request)


@lru_cache(1024)
def with_expansion(method: ContactLinear, expansion: Expansion, processed: bool) -> ContactLinear:
    own = method.composition
    if not processed:
        own = replace(own, processor=(), postprocessor=())
    return replace(method, expansion=expansion, composition=own)


def linear_method(composition: Composition) -> ContactLinear:
    return ContactLinear(
        name=composition.name,
        order=composition.order,
        step=lambda scene, x, h, xp: advance(
            composition, cast(Any, Split(scene, expand(scene), xp)), x, h, 1, xp
        ),
        kind="gradient",
        family="contact",
        about=composition.source,
        contact=True,
        symmetric=composition.palindromic,
        stiff=bool(composition.processor),
        composition=composition,
    )


for _composition in LINEAR:
    METHODS.add(linear_method(_composition))
