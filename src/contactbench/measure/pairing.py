"""Pairs of singular values of the tangent map of (q, p).

Where Γ = γs, s does not act back on (q, p), and Φ*η = e^{−γt} η says of their tangent map A that
AᵀJA = e^{−γt} J.  With σ a singular value of A, e^{−γt}/σ is one too: σ_i σ_{2n+1−i} = e^{−γt} at every finite
time, and in the limit λ_i + λ_{2n+1−i} = −γ for the Lyapunov exponents (Dressler, Phys. Rev. A 38, 2103 (1988),
doi:10.1103/PhysRevA.38.2103).  A γ(t) that depends on the time alone puts e^{−∫γ} in the place of e^{−γt}.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contactbench.measure.deviation import Deviation, conformal
from contactbench.scene import Mechanical
from contactbench.solution import SAFETY, Differential, Solution


class Pairs(NamedTuple):
    """σ_i σ_{2n+1−i} at every saved time, (k, n), σ_1 being the largest.

    terms : σ_1 ‖(σ_1, …, σ_n)‖, (k,): the smaller of a pair has the round-off of σ_1.  uncertainty : (k,); None
    where the derivative is computed to round-off.
    """

    values: np.ndarray
    terms: np.ndarray
    uncertainty: np.ndarray | None


def pairs(differential: Differential, n: int) -> Pairs | None:
    """The pairs for n degrees of freedom, None where the derivative was not taken or is not finite.

    Of several estimates of the derivative the one is used that agrees best with the next.
    """
    tangent = differential.estimates[:, :, : 2 * n, : 2 * n]
    if not differential.taken or not np.isfinite(tangent).all():
        return None
    sigma = np.linalg.svd(tangent, compute_uv=False)
    values = sigma[..., :n] * sigma[..., : n - 1 : -1]
    terms = sigma[..., 0] * np.linalg.norm(sigma[..., :n], axis=-1)
    if len(values) == 1:
        return Pairs(values[0], terms[0], None)
    gaps = np.linalg.norm(np.diff(values, axis=0), axis=-1)
    best = int(np.argmin(gaps.max(axis=1)))
    return Pairs(values[best], terms[best], SAFETY * gaps[best])


def pairing_deviation(
    solution: Solution, differential: Differential, rate: float | np.ndarray
) -> Deviation | float:
    """That of the pairs from e^{−γt}; rate : γ, or its mean up to each saved time, (k,)."""
    scene = solution.scene
    assert isinstance(scene, Mechanical)
    found = pairs(differential, len(scene.q))
    if found is None:
        return math.nan
    values, terms, error = found
    return conformal(values, np.ones(len(scene.q)), solution.t, rate, terms, error)
