"""The quantities that long runs are averaged for, as they are named in their table."""

from __future__ import annotations

from contactbench.results.tables import LONG_TIME as LONG_TIME

#: H0 once in a period, where the force vanishes; Lyapunov's exponent per unit of time
ENERGY, EXPONENT = "mean H0 at phase 0", "largest exponent"
#: the dimension of Kaplan and Yorke, of the section once in a period; 0 for the true flow
DIMENSION, SUM = "dimension", "sum of exponents plus γ"
