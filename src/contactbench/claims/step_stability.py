"""The claim of stability of the integrators (abstract of the paper), by eigenvalues of a step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.claims.ledger import Correction, Evidence, at_most, claim
from contactbench.claims.orders import ABC, PRINTED
from contactbench.measure.stability import SLACK, spectral_radius, true_radius
from contactbench.methods import METHODS


def radius(name: str, gamma: float, h: Any) -> Any:
    """Largest |eigenvalue| of one step on the oscillator with ω = 1."""
    return spectral_radius(METHODS[name], gamma, 1.0, h)


def border(name: str, gamma: float) -> float:
    """The smallest ωh > 1 at which an eigenvalue of the step leaves the unit circle."""
    return scipy.optimize.brentq(lambda h: radius(name, gamma, h) - 1 - SLACK, 1.0, 4.5, xtol=1e-12)


FAR = np.geomspace(0.05, 200.0, 4001)  #: step sizes ωh at which "stable at every step size" is looked at


def largest_radius(name: str, gamma: float) -> float:
    """Largest spectral radius over these step sizes, refined where it is largest."""
    coarse = radius(name, gamma, FAR)
    h = FAR[int(np.argmax(coarse))]
    return float(max(np.max(coarse), np.max(radius(name, gamma, np.linspace(0.97 * h, 1.03 * h, 2001)))))


def unconditional_from(name: str) -> float:
    """The γ/ω from which no step size has an eigenvalue outside the unit circle, by bisection."""
    low, high = 0.3, 0.7
    while high - low > 1e-9:
        middle = (low + high) / 2
        low, high = (middle, high) if largest_radius(name, middle) > 1 + SLACK else (low, middle)
    return (low + high) / 2


def threshold() -> float:
    """The same for the printed order by formula: x² ≤ 2(1 + e^{gx}) for every x = ωh, g = γ/ω.

    Where the two sides touch, x = g e^{gx}; with y = gx, e^y (y − 2) = 2, so y = 2 + W(2/e²) and
    g = √(y e^{−y}) = 0.49134, at ωh = g e^y = 4.514.
    """
    y = 2 + float(scipy.special.lambertw(2 / math.e**2).real)
    return math.sqrt(y * math.exp(-y))


def slow_rate_ratio(name: str, gamma: float, h: float) -> float:
    """Decay rate of the slowest mode under steps of h over the true one; oscillator, ω = 1."""
    return math.log(radius(name, gamma, h)) / math.log(true_radius(gamma, 1.0, h))


@claim(
    "C36",
    "Abstract",
    "“Numerically stable integration.”",
    kind=Correction.repairs,
    correction="Conditionally stable. On the oscillator the palindrome B½ A½ C A½ B½ needs ωh < 2 whatever the "
    "damping. The printed order needs (ωh)² < 2 (1 + e^{γh}): ωh < 2 at γ = 0, a little more with weak damping, "
    "and from γ/ω = 0.4913 on every step size is stable. Stable is not accurate there: as the step grows, the "
    "rate of its slow mode tends to 0. See the stability table for the merged flow AC and for the other methods.",
    scene="oscillator, ω = 1, γ = 0, 0.1, 1",
    method="contact-printed, contact-abc",
)
def conditional_stability(gammas: Sequence[float] = (0.0, 0.1, 1.0), weak: float = 0.1) -> Evidence:
    """gammas : for the palindrome.  weak : for the printed order, between 0 and 0.4."""
    why = "bounded orbits need no eigenvalue beyond the unit circle; 10⁻⁷ is the square root of round-off"
    short = np.linspace(0.05, 1.95, 39)
    calm = max(float(np.max(radius(name, gamma, short))) for name in (PRINTED, ABC) for gamma in gammas)
    shown = ", ".join(f"{gamma:g}" for gamma in gammas)
    edge = border(PRINTED, weak)
    near = "the slack 10⁻⁷ of the eigenvalue, magnified where two of them meet on the circle"
    statement = [
        at_most(
            f"largest spectral radius of a step, ωh from 0.05 to 200, {name}, γ = {weak:g}",
            largest_radius(name, weak),
            1 + SLACK,
            why,
        )
        for name in (PRINTED, ABC)
    ]
    corrected = [
        at_most(f"the same for ωh ≤ 1.95, both, γ = {shown}", calm, 1 + SLACK, why),
        at_most(
            f"max |border − 2| for contact-abc, γ = {shown}",
            max(abs(border(ABC, gamma) - 2) for gamma in gammas),
            1e-5,
            near,
        ),
        at_most(
            f"|(ωh)² − 2(1 + e^{{γh}})| at the border of contact-printed, γ = {weak:g}",
            abs(edge**2 - 2 * (1 + math.exp(weak * edge))),
            1e-5,
            near,
        ),
        at_most(
            f"|γ/ω − {threshold():.5f}| from which contact-printed is stable at every step size",
            abs(unconditional_from(PRINTED) - threshold()),
            1e-5,
            "the slack 10⁻⁷ of the eigenvalue, over its slope in γ, and the sampling of h",
        ),
        at_most(
            "decay rate of its slow mode over the true one, γ/ω = 1, ωh = 20",
            slow_rate_ratio(PRINTED, 1.0, 20.0),
            1e-2,
            "about 2 ωh e^{−γh}, which tends to 0",
        ),
    ]
    return Evidence(statement, corrected)
