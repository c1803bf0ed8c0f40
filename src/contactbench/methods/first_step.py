"""What is tried before a run is prepared: the slope at the start, and one step of a user's step map."""

from __future__ import annotations

import math
from typing import Any

from contactbench.boundary import is_ours, their_code
from contactbench.errors import BadInput, is_number, shown
from contactbench.methods.step_map import StepMap, identity
from contactbench.scene import Scene
from contactbench.scene.base import TRIED
from contactbench.scene.cache import Cache

_tried: Cache[bool] = Cache(1024)


def try_step(method: StepMap, scene: Scene, carry: tuple[str, ...], step: float | None) -> None:
    """Raise `BadInput` unless a user's step map takes a state of the scene to a state of the same fields.

    Once for what the method and the scene compute; what this package brings has tests of its own.
    """
    if is_ours(type(method)) and is_ours(method.step):
        return
    with their_code(f"method {method.name!r}"):
        known = identity(method, scene, carry)
    _tried.get(known, lambda: _try_step(method, scene, carry, step))


def _try_step(method: StepMap, scene: Scene, carry: tuple[str, ...], step: float | None) -> bool:
    x, h, what = scene.initial(carry), TRIED * scene.t_end, f"method {method.name!r}"
    with their_code(what):
        try:
            after = method.advance(scene, x, min(h, step or h), 1, math)
        except ArithmeticError:  # Python's way to say inf; the run will end as diverged
            return False
    if type(after) is not type(x):
        raise BadInput(f"{what}: its step map returns {shown(after)}: must be a {type(x).__name__}")
    for name, old, new in zip(x._fields, x, after, strict=True):
        if not _alike(old, new):
            wanted = (
                f"{len(old)} numbers, a tuple"
                if isinstance(old, tuple)
                else "None"
                if old is None
                else "a number"
            )
            raise BadInput(f"{what}: its step map returns {name} = {shown(new)}: must be {wanted}")
    return True


def _alike(old: Any, new: Any) -> bool:
    """Whether a field after a step is what it was before: so many real numbers, one, or None."""
    if old is None or new is None:
        return old is new
    if isinstance(old, tuple):
        return isinstance(new, tuple) and len(new) == len(old) and all(map(_alike, old, new))
    return is_number(new)
