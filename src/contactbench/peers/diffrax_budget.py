"""A budget of steps as an argument of diffrax's programs; imported when diffrax is.

diffrax's own `max_steps` is part of a program, of which there were one for every budget.
"""

from __future__ import annotations

from typing import Any

import diffrax

from contactbench.xla import jnp


class Budgeted(diffrax.AbstractStepSizeController[Any, Any]):
    """A step size controller that gives up as diffrax does after `max_steps` attempts.

    end : final time; the attempt that reaches it may be the last one allowed.
    """

    controller: diffrax.AbstractStepSizeController[Any, Any]
    max_steps: Any
    end: Any

    def wrap(self, direction: Any) -> Budgeted:
        return Budgeted(self.controller.wrap(direction), self.max_steps, self.end)

    def init(self, *arguments: Any) -> Any:
        first, state = self.controller.init(*arguments)
        return first, (state, jnp.array(0.0))

    def adapt_step_size(
        self, t0: Any, t1: Any, y0: Any, y1: Any, args: Any, error: Any, order: Any, state: Any
    ) -> Any:
        state, attempts = state
        keep, start, until, jump, state, result = self.controller.adapt_step_size(
            t0, t1, y0, y1, args, error, order, state
        )
        attempts = attempts + 1
        spent = (attempts >= self.max_steps) & (start < self.end)
        over = diffrax.RESULTS.where(spent, diffrax.RESULTS.max_steps_reached, diffrax.RESULTS.successful)
        result = diffrax.RESULTS.where(result == diffrax.RESULTS.successful, over, result)
        return keep, start, until, jump, (state, attempts), result
