"""The claim about the limit γ → 0 of the experiment (§6 of the paper)."""

from __future__ import annotations

from typing import Any

import numpy as np

from contactbench.claims.ledger import Correction, Evidence, at_most, claim
from contactbench.claims.orders import PAPER_STEP, PARTICLE, PRINTED
from contactbench.methods import solve
from contactbench.scenes import SCENES


def nearest_return(points_: np.ndarray) -> float:
    """Distance from the start to the curve after it has left, relative to the size of the start.

    points_ : states along the curve, (k, d), close enough to be joined by straight lines.
    """
    start = points_[0]
    left = int(np.argmax(np.linalg.norm(points_ - start, axis=1) > np.linalg.norm(start)))
    a, b = points_[left:-1], points_[left + 1 :]
    along_ = np.clip(((start - a) * (b - a)).sum(axis=1) / ((b - a) ** 2).sum(axis=1), 0, 1)
    return float(np.linalg.norm(a + along_[:, None] * (b - a) - start, axis=1).min() / np.linalg.norm(start))


@claim(
    "C35",
    "§6.3, Conservative limit, and Figure 8",
    "At γ = 0 there is no artificial dissipation: the energy stays bounded and the orbits of the 2-DOF "
    "particle are closed.",
    kind=Correction.repairs,
    correction="The energy stays bounded over long times. The orbit of the 2-DOF particle does not close, except from "
    "special initial data such as q₁ = p₁ = 0, on which it is the 1-DOF oscillator.",
    scene="particle and oscillator, γ = 0",
    method=PRINTED,
    figures=("paper_8",),
)
def conservative_limit(**changes: Any) -> Evidence:
    """changes : of the particle: ``q``, ``p``."""
    span, h = 20_000.0, 0.1
    free = SCENES[PARTICLE].with_(gamma=0.0, t_end=span, **changes)
    run = solve(free, PRINTED, step=h, save_at=np.arange(1, 40_001) * (span / 40_000), carry=())
    off = np.abs(free.energy(run.states()) / free.energy(free.initial(())) - 1)
    early, late = off[:20_000].max(), off[20_000:].max()

    def returned(name, **changes):
        scene = SCENES[name].with_(gamma=0.0, **changes)
        t = np.arange(0, 10001) * PAPER_STEP
        return nearest_return(solve(scene, PRINTED, step=PAPER_STEP, save_at=t, carry=(), engine="python").y)

    bounded = [
        at_most(
            "max |H0/H0(0) − 1| over T = 20000 at h = 0.1",
            off.max(),
            h * h,
            "h²: the oscillation of a second-order symplectic method, with a constant of one",
        ),
        at_most(
            "the same over the second half of the run, over the first",
            late / early,
            1.1,
            "a linear trend would double it",
        ),
    ]
    closes = 1e-3, "ten times h² = 10⁻⁴ of the step used"
    statement = [
        *bounded,
        at_most("nearest return to the start over T = 100, particle", returned(PARTICLE, **changes), *closes),
    ]
    corrected = [
        *bounded,
        at_most("nearest return to the start over T = 100, oscillator", returned("oscillator"), *closes),
        at_most(
            "the same, particle from q₁ = p₁ = 0", returned(PARTICLE, q=(0.0, 0.5), p=(0.0, 0.3)), *closes
        ),
    ]
    return Evidence(statement, corrected)
