"""The derivative of any numerical map by central differences of the solver itself.

The only thing asked of an engine is that it runs from another initial state.  Where a solver chooses its
steps from the state, this is the derivative of the map its user gets, choice of steps included.

Initial data are moved along the scene's tangents (the attitude of a body along the rotation group) by
increments falling by `RATIO`, and every two neighbouring central differences D give one estimate without
their error of second order, R = (r² D(δ/r) − D(δ))/(r² − 1).  Truncation makes the first of them differ,
round-off over δ the last; and a choice of steps that jumps between the two sides makes a single one differ.
Where neighbours agree best is therefore the value, and twice their disagreement the error bar.  Where even the
last two disagree by a tenth of themselves, and by more than the roundings of the state, the map bends within
the smallest increment and no value is given.

Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, §II.9 (extrapolation); for the balance of
truncation and round-off, Ridders, Adv. Eng. Software 4, 75 (1982), doi:10.1016/S0141-1195(82)80057-0.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from contactbench.scene import Scene, norm
from contactbench.solution import Differential

RATIO = 4.0
#: increments, in parts of the size of the field that is moved
INCREMENTS = tuple(1e-3 / RATIO**k for k in range(6))
#: disagreement of the last two estimates, relative to their size, beyond which nothing is resolved
UNRESOLVED = 0.1
#: roundings of the state over the smallest increment, up to which their disagreement is round-off: a derivative
#: may be as small as that, for example along an s that has decayed
ROUNDINGS = 8
#: no derivative where its runs would cost more right-hand sides than this, in compiled code and in Python; a
#: step of an implicit method that does not say counts as so many
BUDGET, CALLBACK_BUDGET, IMPLICIT = 1_000_000, 200_000, 20


def scale(x: object, v: object) -> float:
    for field, part in zip(x, v, strict=True):  # type: ignore[call-overload]
        moved = part if isinstance(part, tuple) else (part or 0.0,)
        if np.any(moved):
            if isinstance(part, tuple) and isinstance(part[0], np.ndarray):
                return float(np.linalg.norm(np.concatenate(field))) or 1.0  # type: ignore[arg-type]
            return norm(field if isinstance(field, tuple) else (field,)) or 1.0
    return 1.0


def differences(run: Any, y0: np.ndarray, out: Any) -> Differential:
    """dΦ at y0 by differences of `run.integrate`, run a `Prepared` and out its `Outcome` there."""
    scene: Scene = run.request.scene
    x = scene.unpack(tuple(y0.tolist()), run.request.carry)
    tangents = scene.tangents(x)
    runs = 2 * len(tangents) * len(INCREMENTS)
    counts, budget = out.counts, CALLBACK_BUDGET if "python" in run.request.engine else BUDGET
    steps = (counts.steps or 0) + (counts.rejected or 0)
    cost = runs * (IMPLICIT * steps if counts.rhs_equivalents is None else counts.rhs_equivalents)
    none = np.empty((0, *out.y.shape, len(tangents)))
    if cost > budget:
        why = f"not taken: {runs} runs would cost {cost:.1e} right-hand sides, more than {budget:.0e}"
        return Differential(why, out.y, none)

    def end(v: object, amount: float) -> np.ndarray:
        return run.integrate(np.array(scene.pack(scene.displaced(x, v, amount)), dtype=float)).y

    def quotient(v: object, amount: float) -> np.ndarray:
        return (end(v, amount) - end(v, -amount)) / (2 * amount)

    scales = [scale(x, v) for v in tangents]
    moved = list(zip(tangents, scales, strict=True))
    plain = np.array([[quotient(v, d * size) for v, size in moved] for d in INCREMENTS])
    better = (RATIO**2 * plain[1:] - plain[:-1]) / (RATIO**2 - 1)
    gap, size = (np.abs(values).max(axis=(1, 2)) for values in (better[-1] - better[-2], better[-1]))  # (m,)
    round_off = ROUNDINGS * np.finfo(float).eps * np.abs(out.y).max() / (INCREMENTS[-1] * np.array(scales))
    if not np.all(gap < np.maximum(UNRESOLVED * size, round_off)):
        return Differential("not taken: differences of the solver do not converge", out.y, none)
    return Differential(f"central differences of the solver, {runs} runs", out.y, np.moveaxis(better, 1, -1))
