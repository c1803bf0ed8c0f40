"""What round-off may do to a law that a method keeps: a bound from numbers that stand in the tables."""

from __future__ import annotations

from typing import Any

import numpy as np

EPSILON = float(np.finfo(float).eps)
#: a larger bound decides nothing: a method that breaks a law by so little as that would pass for one that keeps it
DECIDABLE = 1e-6


def round_off_bound(growth: Any, evaluations: Any) -> Any:
    """ε · evaluations · max(growth, 1): every evaluation rounds once, and what it rounds then grows.

    growth : max ‖DΦ(t)‖₂ of the numerical map (column `map_growth`); the condition number of the true
    motion stands for it only where the run follows that motion.  Both arguments may be columns.
    """
    return EPSILON * evaluations * np.maximum(growth, 1.0)
