"""The subflows of scenes with time in them: the damping advances the time, the kick uses the one it finds.

Autonomous in (q, p, t, s): A is T, B is V(q, t) at a fixed t, and C is γ(t) s with the clock t' = 1, so that G = ∫γ
over the step is exact however A, B and C alternate.  Where A and C are merged, φ = ∫e^{−∫γ} is the time a momentum
is worth.  V(q, t) and the clock depend on neither p nor s: Nyström tables keep their order.
"""

from __future__ import annotations

from typing import Any

from contactbench.scene import Driven, DrivenState


def damp(scene: Driven, x: DrivenState, h: Any, xp: Any) -> DrivenState:
    """C: p *= e^{−G}, s *= e^{−G}, t += h."""
    decay = xp.exp(-damping_over(scene, x, h, xp))
    s = None if x.s is None else decay * x.s
    return DrivenState(x.q, tuple(decay * p for p in x.p), x.t + h, s)


def damping_over(scene: Driven, x: DrivenState, h: Any, xp: Any) -> Any:
    """Return G = ∫γ from x.t to x.t + h."""
    return scene.gamma * h if scene.rate is None else scene.spent(x.t, h, xp)[0]


def log_factor(scene: Driven, x: DrivenState, h: Any, xp: Any) -> Any:
    """Return −G."""
    return -damping_over(scene, x, h, xp)


def damping(scene: Driven, x: DrivenState, h: Any, xp: Any) -> tuple[Any, ...]:
    """Return the constants of the flow AC, φ/m, φ and `flows.damping`, from x.t to x.t + h."""
    total, phi = scene.spent(x.t, h, xp)
    return phi * scene.inverse_mass, phi, 1.0, -xp.expm1(-total)
