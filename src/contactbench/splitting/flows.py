"""The exact subflows every contact integrator is composed of.

Each is the time-h flow of one part of the Hamiltonian, and an exact (conformal) contact map.  A
flow is split in two so that its transcendental coefficients leave the time loop:
``constants(scene, h, xp)`` once per step size, ``apply(scene, x, constants, xp)`` once per step.
`xp` is the number namespace: `math`, `numpy`, `jax.numpy` or an mpmath context.

For H_A = T, H_B = V, H_C = Γ(s) see the paper, eqs. A-flow, B-flow, C-flow.  The merged flow of
H_A + H_C (`drift_damp`) follows from p(t) = e^{−γt} p by integrating q' and s' along it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from contactbench.scene import BodyState, Mechanical, RigidBody, Scene, State, dot, quaternion_product


def no_damping(scene: Any, x: Any, h: Any, xp: Any) -> Any:
    """The log of the conformal factor of a flow whose Hamiltonian does not contain s."""
    return 0.0


class Flow(NamedTuple):
    """One exact subflow φ_h.

    costs : what one application adds to the counts, by kind ("gradient", "rotation").
    log_factor : ``(scene, x, h, xp) -> log c`` with φ_h*η = c η at x.
    Flows for h1 and h2 compose to the flow for h1 + h2, so that neighbours may be merged.
    """

    constants: Callable[[Any, Any, Any], Any]
    apply: Callable[[Any, Any, Any, Any], Any]
    costs: dict[str, int]
    log_factor: Callable[[Any, Any, Any, Any], Any] = no_damping


def damped_time(gamma: Any, h: Any, xp: Any) -> Any:
    """φ(h) = (1 − e^{−γh})/γ, the time a damped momentum is worth; exactly h when γ = 0."""
    undamped = gamma == 0
    if not hasattr(xp, "where"):  # math, mpmath: plain numbers
        return h if undamped else -xp.expm1(-gamma * h) / gamma
    return xp.where(undamped, h, -xp.expm1(-gamma * h) / xp.where(undamped, 1.0, gamma))


def settled(x: Any, xp: Any) -> Any:
    """x, computed once: XLA would redo divisions and sines for every later component that reads them,
    which grows exponentially along a chain of flows."""
    settle = getattr(xp, "settle", None)
    return x if settle is None else settle(x)


#: above this γh the decay is applied as a factor, below it as a small loss
STRONG = 1.5


def damping(gamma: Any, h: Any, xp: Any) -> tuple[Any, Any]:
    """e^{−γh} as a pair (keep, lose): damped(p) = keep·p − lose·p.

    With keep = 1 and lose = 1 − e^{−γh} the rounding of the coefficient matters only through the
    small loss, so that 10⁶ steps do not drift by 10⁶ roundings of the factor; and the loss joins the
    kick in one fused multiply-add.  Where the loss is nearly everything, (e^{−γh}, 0) instead.
    """
    strong = gamma * h > STRONG
    factor, loss = xp.exp(-gamma * h), -xp.expm1(-gamma * h)
    if not hasattr(xp, "where"):
        return (factor, 0.0) if strong else (1.0, loss)
    return xp.where(strong, factor, 1.0), xp.where(strong, 0.0, loss)


# -- mechanical scenes ---------------------------------------------------------------------------
def _plain(scene: Mechanical, h: Any, xp: Any) -> Any:
    return h


def kick(scene: Mechanical, x: State, h: Any, xp: Any) -> State:
    """B: p −= h ∇V(q), s −= h V(q)."""
    p = tuple(p - h * g for p, g in zip(x.p, scene.dV(x.q), strict=True))
    return State(x.q, p, None if x.s is None else x.s - h * scene.V(x.q))


def drift(scene: Mechanical, x: State, h: Any, xp: Any) -> State:
    """A: q += h p/m, s += h T(p).  (T is homogeneous of degree two: p·T_p − T = T.)"""
    over_m = h * scene.inverse_mass
    q = tuple(q + over_m * p for q, p in zip(x.q, x.p, strict=True))
    return State(q, x.p, None if x.s is None else x.s + h * scene.kinetic(x.p))


def _damp_constants(scene: Mechanical, h: Any, xp: Any) -> Any:
    half_kappa = scene.kappa * damped_time(scene.gamma, h, xp) / 2 if scene.nonlinear_damping else None
    return *damping(scene.gamma, h, xp), half_kappa


def damp(scene: Mechanical, x: State, constants: Any, xp: Any) -> State:
    """C: p *= e^{−γh}, s *= e^{−γh}; with κ: divided by D² and D, D = 1 + ½ κ s φ(h).

    The Bernoulli equation s' = −γ s − ½ κ s² has s(h) = e^{−γh} s/D, and ∫Γ'(s) = γh + 2 log D.
    D ≤ 0 is blow-up in finite time: the state leaves through infinity, not by a wrong number.
    """
    keep, lose, half_kappa = constants
    p, s = tuple(keep * p - lose * p for p in x.p), None if x.s is None else keep * x.s - lose * x.s
    if half_kappa is None:
        return State(x.q, p, s)
    blowup = 1 + half_kappa * x.s
    if not hasattr(xp, "where"):
        factor = 1 / blowup if blowup > 0 else xp.inf
    else:
        factor = xp.where(blowup > 0, 1 / blowup, xp.inf)
    return settled(State(x.q, tuple(factor * factor * p for p in p), factor * s), xp)


def damp_log_factor(scene: Mechanical, x: State, h: Any, xp: Any) -> Any:
    """−∫Γ'(s) along the flow C: −γh − 2 log D."""
    linear = -scene.gamma * h
    if not scene.nonlinear_damping:
        return linear
    return linear - 2 * xp.log1p(scene.kappa * x.s * damped_time(scene.gamma, h, xp) / 2)


def _drift_damp_constants(scene: Mechanical, h: Any, xp: Any) -> Any:
    phi = damped_time(scene.gamma, h, xp)
    return phi * scene.inverse_mass, phi, *damping(scene.gamma, h, xp)


def linear_log_factor(scene: Any, x: Any, h: Any, xp: Any) -> Any:
    """−γh, of a flow whose Hamiltonian contains γs."""
    return -scene.gamma * h


def drift_damp(scene: Mechanical, x: State, constants: Any, xp: Any) -> State:
    """AC, the flow of T + γs: q += φ p/m, s → e^{−γh} (s + φ T(p)), p → e^{−γh} p."""
    phi_over_m, phi, keep, lose = constants
    q = tuple(q + phi_over_m * p for q, p in zip(x.q, x.p, strict=True))
    s = None if x.s is None else x.s + phi * scene.kinetic(x.p)
    return State(q, tuple(keep * p - lose * p for p in x.p), None if s is None else keep * s - lose * s)


MECHANICAL = {
    "kick": Flow(_plain, kick, {"gradient": 1}),
    "drift": Flow(_plain, drift, {}),
    "damp": Flow(_damp_constants, damp, {}, damp_log_factor),
    "drift_damp": Flow(_drift_damp_constants, drift_damp, {}, linear_log_factor),
}


# -- rigid body ------------------------------------------------------------------------------------
def rotation(x: BodyState, axis: int, a: Any, xp: Any) -> BodyState:
    """Exact time-1 flow of ½ a M_i²: M and R turn about principal axis i at the constant rate a M_i.

    R → R Rot(e_i, θ) and M → Rot(e_i, −θ) M, so J = R M does not change.
    """
    j, k = (axis + 1) % 3, (axis + 2) % 3
    M, R, s = x
    angle = a * M[axis]
    half = angle / 2
    cos, sin = xp.cos(half), xp.sin(half)
    cos2, sin2 = 1 - 2 * sin * sin, 2 * sin * cos
    turned = [M[axis]] * 3
    turned[j], turned[k] = cos2 * M[j] + sin2 * M[k], cos2 * M[k] - sin2 * M[j]
    if R is not None:
        w, v = R[0], R[1:]
        quaternion = [cos * w - sin * v[axis], w, w, w]
        quaternion[1 + axis] = cos * v[axis] + sin * w
        quaternion[1 + j] = cos * v[j] + sin * v[k]
        quaternion[1 + k] = cos * v[k] - sin * v[j]
        R = tuple(quaternion)
    return settled(BodyState(tuple(turned), R, None if s is None else s + angle * M[axis] / 2), xp)


def spin(x: BodyState, a: Any, xp: Any) -> BodyState:
    """Exact time-1 flow of ½ a ‖M‖²: M stays, R turns about it, R → R exp(a M̂) = exp(a Ĵ) R.

    It commutes with every rotation: ‖M‖² is a Casimir function, and they leave J as it is.
    """
    if x.R is None and x.s is None:
        return x
    square = dot(x.M, x.M)
    s = None if x.s is None else x.s + a * square / 2
    if x.R is None:
        return BodyState(x.M, None, s)
    still = square == 0
    if hasattr(xp, "where"):
        size = xp.sqrt(xp.where(still, 1.0, square))  # 1: no derivative of √0 is taken
        scale = xp.where(still, a / 2, xp.sin(a * size / 2) / size)
        cos = xp.where(still, 1.0, xp.cos(a * size / 2))
    else:
        size = xp.sqrt(square)
        scale, cos = a / 2 if still else xp.sin(a * size / 2) / size, xp.cos(a * size / 2)
    R = quaternion_product(x.R, (cos, *(scale * m for m in x.M)))
    return settled(BodyState(x.M, R, s), xp)


def turn_rate(scene: RigidBody) -> Any:
    """1/I_min − 1/I_mid, the part of the energy that `turn` is the flow of, as ½ a M_min²."""
    smallest, middle, _ = scene.by_inertia
    return scene.inverse_inertia[smallest] - scene.inverse_inertia[middle]


def top_rate(scene: RigidBody) -> Any:
    """1/I_max − 1/I_mid, by which the symmetric top of `top` differs from a sphere."""
    _, middle, largest = scene.by_inertia
    return scene.inverse_inertia[largest] - scene.inverse_inertia[middle]


def turn(scene: RigidBody, x: BodyState, tau: Any, xp: Any) -> BodyState:
    """Flow of ½ (1/I_min − 1/I_mid) M_min²: what an asymmetric body is more than a symmetric top.

    Free body = `turn` + `top`: Touma, Wisdom, Astron. J. 107, 1189 (1994); for what the choice of axes does
    to the error, Fassò, J. Comput. Phys. 189, 527 (2003).  Differences to the intermediate moment are the
    smallest rates that two rotations can have.
    """
    return rotation(x, scene.by_inertia[0], tau * turn_rate(scene), xp)


def top(scene: RigidBody, x: BodyState, tau: Any, xp: Any) -> BodyState:
    """Flow of the symmetric top with moments I_mid, I_mid, I_max: a rotation and a `spin`."""
    x = rotation(x, scene.by_inertia[2], tau * top_rate(scene), xp)
    return spin(x, tau * scene.inverse_inertia[scene.by_inertia[1]], xp)


def _body_damp_constants(scene: RigidBody, h: Any, xp: Any) -> Any:
    if scene.isotropic:
        return damping(scene.gamma, h, xp)
    return tuple(xp.exp(-rate * h) for rate in scene.rates)


def body_damp(scene: RigidBody, x: BodyState, decay: Any, xp: Any) -> BodyState:
    """C: M → e^{−hD} M (isotropic: M and s *= e^{−γh}); R does not change."""
    if scene.isotropic:
        keep, lose = decay
        s = None if x.s is None else keep * x.s - lose * x.s
        return BodyState(tuple(keep * m - lose * m for m in x.M), x.R, s)
    factor = iter(decay)
    return BodyState(scene.damp_matrix_function(x.M, lambda rate: next(factor)), x.R, None)


BODY = {
    "turn": Flow(_plain, turn, {"rotation": 1}),
    "top": Flow(_plain, top, {"rotation": 1}),
    "damp": Flow(_body_damp_constants, body_damp, {}, linear_log_factor),
}


def flows_of(scene: Scene) -> dict[str, Flow]:
    """The subflows a scene has, by name; a body has no potential, hence no kick."""
    if not isinstance(scene, Mechanical):
        return BODY
    if scene.nonlinear_damping:  # their joint flow (a Pinney equation) is not implemented here
        return {name: flow for name, flow in MECHANICAL.items() if name != "drift_damp"}
    return MECHANICAL
