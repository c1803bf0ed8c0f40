"""The subflows of scenes with time in them: the drift advances the time, kick and damping use the one they find.

Autonomous in (q, p, t, s): A is T with the clock t' = 1, B is V(q, t) at a fixed t, and C is γ(t) s at a fixed t.
Where A and C are merged γ runs along, G = ∫γ and φ = ∫e^{−∫γ} being the scene's.  V(q, t) and the clock depend on
neither p nor s, so that Nyström tables keep their order.
"""

from __future__ import annotations

from typing import Any

from contactbench.scene import Driven, DrivenState


def kick(scene: Driven, x: DrivenState, h: Any, xp: Any) -> DrivenState:
    """B: p −= h ∇V(q, t), s −= h V(q, t)."""
    p = tuple(p - h * g for p, g in zip(x.p, scene.gradient_at(x), strict=True))
    return DrivenState(x.q, p, x.t, None if x.s is None else x.s - h * scene.potential_at(x))


def drift(scene: Driven, x: DrivenState, h: Any, xp: Any) -> DrivenState:
    """A: q += h p/m, s += h T(p), t += h."""
    over_m = h * scene.inverse_mass
    q = tuple(q + over_m * p for q, p in zip(x.q, x.p, strict=True))
    return DrivenState(q, x.p, x.t + h, None if x.s is None else x.s + h * scene.kinetic(x.p))


def damp(scene: Driven, x: DrivenState, h: Any, xp: Any) -> DrivenState:
    """C at a fixed t: p *= e^{−γ(t)h}, s *= e^{−γ(t)h}."""
    decay = xp.exp(-h * scene.damping_at(x))
    return DrivenState(x.q, tuple(decay * p for p in x.p), x.t, None if x.s is None else decay * x.s)


def damp_log_factor(scene: Driven, x: DrivenState, h: Any, xp: Any) -> Any:
    """−γ(t) h."""
    return -h * scene.damping_at(x)


def drift_damp(scene: Driven, x: DrivenState, constants: Any, xp: Any) -> DrivenState:
    """AC: q += φ p/m, s → e^{−G} (s + φ T(p)), p → e^{−G} p, t += h.

    constants : h, and where γ is constant φ, keep and lose of `flows.drift_damp`.
    """
    h, *constant = constants
    if constant:
        phi, keep, lose = constant
    else:
        total, phi = scene.spent(x.t, h, xp)
        keep, lose = 1.0, -xp.expm1(-total)
    over_m = phi * scene.inverse_mass
    q = tuple(q + over_m * p for q, p in zip(x.q, x.p, strict=True))
    s = None if x.s is None else x.s + phi * scene.kinetic(x.p)
    p = tuple(keep * p - lose * p for p in x.p)
    return DrivenState(q, p, x.t + h, None if s is None else keep * s - lose * s)


def drift_damp_log_factor(scene: Driven, x: DrivenState, h: Any, xp: Any) -> Any:
    """−G."""
    return -(scene.gamma * h if scene.rate is None else scene.spent(x.t, h, xp)[0])
