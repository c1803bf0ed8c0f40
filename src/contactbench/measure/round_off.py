"""What round-off may do to a law that a method keeps: a bound from numbers that stand in the tables, and the
judgement that follows from it.

A law is kept when its deviation is round-off: 10⁻¹², or what rounding every evaluation comes to; the round-off
of a law of the derivative grows with the numerical map, how far stands in the table (`map_growth`), and where it
does not, with the motion (`condition_number`).

Where that bound is above 10⁻⁶ it says nothing in favour of a method, because any would pass: a deviation below it
is undecided, neither kept nor broken.  So is one that differences of the solver do not resolve, and one that is
clamped at every saved time.  A run that does not follow the motion is not judged.
"""

from __future__ import annotations

from typing import Any

import numpy as np

EPSILON = float(np.finfo(float).eps)
#: a larger bound decides nothing: a method that breaks a law by so little as that would pass for one that keeps it
DECIDABLE = 1e-6
#: a structural error is round-off up to here
STRUCTURE = 1e-12
#: up to so many error bars a deviation by differences is no more than an upper bound
UNSURE = 2.0
#: laws of the state alone: the sensitivity of the motion does not magnify their round-off
OF_THE_STATE = ("momentum_law", "attitude_drift")
#: what a row has of each structural law beside its value, with its meaning
JUDGEMENT = {
    "claimed": "whether the method promises on this scene to keep it at every setting",
    "kept": "whether the run keeps it to round-off; blank where that is undecided, or the run is not judged because "
    "its solution is off by more than a tenth",
    "undecided": "whether the run cannot tell; blank where it is not judged",
    "bound": "up to what its deviation is round-off; blank where it is not judged",
}
#: a run whose solution error is larger does not follow the motion
WRECKED = 0.1


def round_off_bound(growth: Any, evaluations: Any) -> Any:
    """ε · evaluations · max(growth, 1): every evaluation rounds once, and what it rounds then grows.

    growth : max ‖DΦ(t)‖₂ of the numerical map, or the condition number of the motion.  Both may be columns.
    """
    return EPSILON * evaluations * np.maximum(growth, 1.0)


def structural_bound(growth: Any, evaluations: Any) -> Any:
    """Up to what the deviation from a structural law is round-off; the arguments may be columns."""
    return np.maximum(STRUCTURE, round_off_bound(growth, evaluations))


def decide(value: Any, bound: Any) -> tuple[Any, Any]:
    """Whether a deviation shows that the law is kept, and whether it shows nothing; both may be columns."""
    within = value <= bound
    kept = within & ((bound <= DECIDABLE) | (value <= STRUCTURE))
    return kept, within & np.logical_not(kept)


def judge(value: Any, bound: Any, uncertainty: Any, all_clamped: Any, error: Any) -> tuple[Any, Any, Any]:
    """Whether a law is judged in a run, whether it is kept, and whether that is undecided; all may be columns.

    all_clamped : whether it was clamped at every saved time.  error : of the solution, nan where it is not known.
    """
    judged = np.logical_not(np.asarray(error, dtype=float) > WRECKED)
    kept, ill = decide(value, bound)
    faded = kept & all_clamped
    kept = kept & np.logical_not(faded)
    unsure = (uncertainty > 0) & (value <= UNSURE * uncertainty)
    undecided = ill | faded | (unsure & np.logical_not(kept))
    return judged, kept & judged, undecided & judged
