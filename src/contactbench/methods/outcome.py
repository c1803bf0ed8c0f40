"""What integrating gives, before it is a solution."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from contactbench.solution import Counts, Status


@dataclass(slots=True)
class Outcome:
    """What integrating gave: packed states (NaN where not reached), counts, and how it ended.

    checked : the states are known to be finite and the last one to be at the end.
    steps : the step chosen in this run, and the longest taken, where the run chose one.
    """

    y: np.ndarray
    counts: Counts
    status: Status
    message: str
    end_time: float
    checked: bool = False
    steps: tuple[float, float] | None = None


def audited(out: Outcome, end: float) -> Outcome:
    """The outcome, an `ok` taken back from a run that ended elsewhere or without a number."""
    if out.checked or out.status is not Status.ok:
        return out
    if out.end_time != end:
        message = f"ended at t = {out.end_time:.6g}, not at t = {end:.6g}"
        return replace(out, y=np.full_like(out.y, math.nan), status=Status.failed, message=message)
    if not np.isfinite(out.y[-1]).all():
        return replace(out, status=Status.diverged, message="not finite at the end")
    return out
