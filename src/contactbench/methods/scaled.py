"""Runs whose absolute tolerance follows the scale of the motion."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from contactbench.methods.loops import Loop
from contactbench.methods.prepared import Prepared, Request
from contactbench.numbers.protocol import Arithmetic, CannotRecord
from contactbench.scene import Cache, key
from contactbench.solution import DIVERGENCE, Solution
from contactbench.trace.program import record


@dataclass
class RunByTolerance(Prepared):
    """A run of an `Adaptive` method; a default atol follows the scale of the motion."""

    method_: Any

    def __call__(self, **data: object) -> Solution:
        r = self.request
        if not data or r.scales is None:
            return super().__call__(**data)
        y0 = self.packed(data)
        if self.scaled is None or self.scaled(y0).tobytes() != self.own_scales:
            given = r.to_scale(self.method_.takes_atol, **r.scene.checked(data))
            if not np.array_equal(given.scales, r.scales):
                return self.remade(given)(**data)
        return self.at_once(y0) if self.at_once else self.solved(y0, self.integrate)

    def remade(self, request: Request) -> Prepared:
        """Return a run of the same kind for another request."""
        made: Prepared = self.method_.prepare(request)
        return made

    @cached_property
    def scaled(self) -> Callable[[np.ndarray], np.ndarray] | None:
        """Return the compiled function from a packed state to its scales; None where there is none."""
        return compiled_scales(self.request)

    @cached_property
    def own_scales(self) -> bytes:
        """Return the scales of the scene's own start, as compiled code computes them."""
        assert self.scaled is not None
        return self.scaled(self.start).tobytes()


_loops: Cache[Loop] = Cache(256)


def compiled_scales(request: Request) -> Callable[[np.ndarray], np.ndarray] | None:
    """Return the function from a packed state to `Scene.scales`, compiled; None if its scales cannot be compiled."""
    scene, carry, d = request.scene, request.carry, len(request.start)
    if scene.mixed or scene.clock is not None:
        return None

    def scales(numbers: Any, end: Any, _: Any, y: Any, xp: Any, *rest: object) -> list[Arithmetic]:
        twin = scene.with_numbers(numbers)
        return twin.scales_in(twin.unpack(y, carry), end, xp)

    def make() -> Loop:
        return Loop(record(scales, len(scene.numbers()), d, scene.motion, DIVERGENCE), 0.0)

    with suppress(CannotRecord):
        loop = _loops.get(key(scene.identity, carry, scene.scale), make)
        rows = loop.rows(np.array(scene.numbers()), request.save_at[-1:], np.ones(1))
        found: Callable[[np.ndarray], np.ndarray] = loop.on(d, rows, (d, 2 * d))
        return found
    return None
