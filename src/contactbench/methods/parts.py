"""Steps of any length by a one-step method, which fill gaps between the ends of another method's steps."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from contactbench.methods.dates import dates, from_origin
from contactbench.methods.dense import Source
from contactbench.methods.loops import LOOPS, StepLoop
from contactbench.methods.prepared import Request
from contactbench.methods.prescribed import steps_in

if TYPE_CHECKING:
    from contactbench.methods.fixed_step import FixedStep


class Parts(Source):
    """Parts of steps by a one-step method, from any state, in steps of a size at most."""

    def __init__(self, filler: FixedStep, request: Request, longest: float) -> None:
        self.filler, self.request, self.longest = filler, request, longest
        self.cost = filler.counts(request.scene, 1, request.carry)
        self.kind = filler.kind_on(request.scene)

    @cached_property
    def loop(self) -> StepLoop[Any]:
        loop: StepLoop[Any] = LOOPS[self.request.engine](self.filler, self.request)
        return loop

    def step(
        self, y0: np.ndarray, y: np.ndarray, begin: float, end: float, finer: bool = False
    ) -> tuple[np.ndarray, int]:
        scene, ends = self.request.scene, np.array([end])
        n = steps_in(ends - begin, ends, self.longest / (1 + finer))
        since = dates(scene, np.array([begin]), ends) if scene.keeps_dates else None
        ready = self.loop.ready((ends - begin) / n, n, since)
        after, made = self.loop.take(from_origin(scene, y, y0), ready)
        return after[0], self.filler.counts(scene, int(n[0]), self.request.carry) if made is None else made
