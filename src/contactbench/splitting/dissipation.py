"""The flow of s' = −Γ(s) by quadrature.

With r = Γ' about half-way and the time τ in which linear damping of that rate would do the same, s = s₀ − Γ(s₀) φ_r(τ),
φ_r(τ) = (1 − e^{−rτ})/r, the separated equation ∫ ds/Γ = −h becomes

    ∫₀^{τ(h)} k(τ) dτ = h,   k(τ) = e^{−rτ} Γ(s₀)/Γ(s(τ)),

whose integrand is positive, 1 where Γ is linear, and regular at the zeros of Γ.  Gauss's rule and Newton's method
from τ = h; the slope of the integral is k.  On doubles the rule has `NODES` nodes in each half of the step: enough
for round-off where Γ'h is below one (measured in the tests).
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from contactbench.numbers.control import choose, scan
from contactbench.numbers.protocol import abilities

NODES, ITERATIONS = 16, 6
#: parts of a step, each with a rate r of its own
PANELS = 2


@cache
def rule() -> tuple[list[float], list[float]]:
    """Return points and weights of Gauss's rule on [0, 1]; computed when first used."""
    x, w = np.polynomial.legendre.leggauss(NODES)
    return ((1 + x) / 2).tolist(), (w / 2).tolist()


def phi(r: Any, tau: Any, xp: Any) -> Any:
    """Return φ_r(τ) = (1 − e^{−rτ})/r, τ for r = 0."""
    still = r == 0
    safe = choose(still, 1.0, r, xp)
    return choose(still, tau, -xp.expm1(-safe * tau) / safe, xp)


def decay(scene: Any, s: Any, h: Any, xp: Any) -> Any:
    """Return s(h) from s at 0; not finite where s reaches infinity before."""
    if scene.damping_flow is not None:
        return scene.damping_flow(s, h, xp)
    for _ in range(PANELS):
        s = by_quadrature(scene, s, h / PANELS, xp)
    return s


def by_quadrature(scene: Any, s: Any, h: Any, xp: Any) -> Any:
    """Return s(h) by quadrature in one panel."""
    start = scene.dissipation(s)
    r = scene.dissipation_rate(s - start * phi(scene.dissipation_rate(s), h / 2, xp))
    resting = start == 0

    def at(tau: Any) -> Any:
        return s - start * phi(r, tau, xp)

    def pace(tau: Any) -> Any:
        """Return k."""
        there = scene.dissipation(at(tau))
        gone = there == 0
        ratio = choose(resting, 1.0, start, xp) / choose(gone, 1.0, there, xp)
        return choose(resting, 1.0, choose(gone, 1.0, xp.exp(-r * tau) * ratio, xp), xp)

    def elapsed(tau: Any) -> Any:
        """Return the integral of k up to tau."""
        if abilities(xp).digits:
            return xp.quad(pace, [0, tau])
        return tau * sum(w * pace(tau * x) for x, w in zip(*rule(), strict=True))

    def nearer(tau: Any) -> Any:
        return tau - (elapsed(tau) - h) / pace(tau)

    if not abilities(xp).branch:
        return at(scan(lambda tau: (nearer(tau), tau), h, ITERATIONS, lambda _: 0.0, xp)[0])
    before, tau = 0 * h, h
    for _ in range(ITERATIONS if not abilities(xp).digits else 2 * ITERATIONS):
        before, tau = tau, nearer(tau)
        if tau == before:
            break
    return at(tau)


def survival(scene: Any, s: Any, after: Any, h: Any, xp: Any) -> Any:
    """Return ∂s(h)/∂s = Γ(s(h))/Γ(s), the factor on p and on η; e^{−Γ'h} at the zeros of Γ."""
    start = scene.dissipation(s)
    resting = start == 0
    ratio = scene.dissipation(after) / choose(resting, 1.0, start, xp)
    return choose(resting, xp.exp(-scene.dissipation_rate(s) * h), ratio, xp)
