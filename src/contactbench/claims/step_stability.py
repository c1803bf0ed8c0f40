"""The claim of stability of the integrators (abstract of the paper), by eigenvalues of a step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.claims.ledger import Evidence, at_most, claim
from contactbench.claims.orders import ABC, PRINTED
from contactbench.measure.stability import SLACK, spectral_radius, true_radius
from contactbench.methods import METHODS


def radius(name: str, gamma: float, h: Any) -> Any:
    """Return the largest |eigenvalue| of one step on the oscillator with ω = 1."""
    return spectral_radius(METHODS[name], gamma, 1.0, h)


def border(name: str, gamma: float) -> float:
    """Return the smallest ωh > 1 at which an eigenvalue of the step leaves the unit circle."""
    return scipy.optimize.brentq(lambda h: radius(name, gamma, h) - 1 - SLACK, 1.0, 4.5, xtol=1e-12)


FAR = np.geomspace(0.05, 200.0, 4001)  #: step sizes ωh at which "stable at every step size" is looked at


def largest_radius(name: str, gamma: float) -> float:
    """Return the largest spectral radius over these step sizes, refined where it is largest."""
    coarse = radius(name, gamma, FAR)
    h = FAR[int(np.argmax(coarse))]
    return float(max(np.max(coarse), np.max(radius(name, gamma, np.linspace(0.97 * h, 1.03 * h, 2001)))))


def unconditional_from(name: str) -> float:
    """Return the γ/ω from which no step size has an eigenvalue outside the unit circle, by bisection."""
    low, high = 0.3, 0.7
    while high - low > 1e-9:
        middle = (low + high) / 2
        low, high = (middle, high) if largest_radius(name, middle) > 1 + SLACK else (low, middle)
    return (low + high) / 2


def threshold() -> float:
    """Return the same for the printed order by formula: x² ≤ 2(1 + e^{gx}) for every x = ωh, g = γ/ω.

    Where the two sides touch, x = g e^{gx}; with y = gx, e^y (y − 2) = 2, so y = 2 + W(2/e²) and
    g = √(y e^{−y}) = 0.49134, at ωh = g e^y = 4.514.
    """
    y = 2 + float(scipy.special.lambertw(2 / math.e**2).real)
    return math.sqrt(y * math.exp(-y))


@claim("C36")
def conditional_stability(gammas: Sequence[float] = (0.0, 0.1, 1.0), weak: float = 0.1) -> Evidence:
    """gammas : for the palindrome.  weak : for the printed order, between 0 and 0.4."""
    on_circle = (
        "bounded orbits need no eigenvalue beyond the unit circle; 10⁻⁷ is the square root of round-off"
    )
    bounded = 1 + SLACK, on_circle
    short = np.linspace(0.05, 1.95, 39)
    calm = max(float(np.max(radius(name, gamma, short))) for name in (PRINTED, ABC) for gamma in gammas)
    listed = ", ".join(f"{gamma:g}" for gamma in gammas)
    edge = border(PRINTED, weak)
    at_two = max(abs(border(ABC, gamma) - 2) for gamma in gammas)
    by_formula = abs(edge**2 - 2 * (1 + math.exp(weak * edge)))
    start = abs(unconditional_from(PRINTED) - threshold())
    slow = math.log(radius(PRINTED, 1.0, 20.0)) / math.log(true_radius(1.0, 1.0, 20.0))
    near = 1e-5, "the slack 10⁻⁷ of the eigenvalue, magnified where two of them meet on the circle"
    sampled = 1e-5, "the slack 10⁻⁷ of the eigenvalue, over its slope in γ, and the sampling of h"
    vanishing = 1e-2, "about 2 ωh e^{−γh}, which tends to 0"
    all_steps = "largest spectral radius of a step, ωh from 0.05 to 200"
    printed = f"|(ωh)² − 2(1 + e^{{γh}})| at the border of contact-printed, γ = {weak:g}"
    every_step = f"|γ/ω − {threshold():.5f}| from which contact-printed is stable at every step size"
    statement = [
        at_most(f"{all_steps}, {name}, γ = {weak:g}", largest_radius(name, weak), *bounded)
        for name in (PRINTED, ABC)
    ]
    corrected = [
        at_most(f"the same for ωh ≤ 1.95, both, γ = {listed}", calm, *bounded),
        at_most(f"max |border − 2| for contact-abc, γ = {listed}", at_two, *near),
        at_most(printed, by_formula, *near),
        at_most(every_step, start, *sampled),
        at_most("decay rate of its slow mode over the true one, γ/ω = 1, ωh = 20", slow, *vanishing),
    ]
    return Evidence(statement, corrected)
