"""The exact subflows every contact integrator is composed of.

Each is the time-h flow of one part of the Hamiltonian, and an exact (conformal) contact map.  A flow is split in two so
that its transcendental coefficients leave the time loop: ``constants(scene, h, xp)`` once per step size,
``apply(scene, x, constants, xp)`` once per step; `xp` is the namespace of the numbers.

For H_A = T, H_B = V, H_C = Γ(s) see the paper, eqs. A-flow, B-flow, C-flow.  H_A + H_C has a flow of its own
(`drift_damp`) for every Γ(s) = γs + ½κs², so that mechanical scenes come in two parts.  On these Nyström tables keep
their order: {V, {V, {V, T + Γ}}} = 0, since V lowers the degree in (p, s) by one and T + Γ is of degree two
(docs/mathematics.md).  A cubic term in Γ would break it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from operator import add
from typing import Any, NamedTuple

import numpy as np

from contactbench.numbers.control import choose, scan, settle
from contactbench.numbers.protocol import abilities
from contactbench.scene import (
    BodyState,
    Driven,
    DrivenState,
    HeavyTop,
    Mechanical,
    RigidBody,
    Scene,
    State,
    dot,
    quaternion_product,
    scaled,
    times,
)
from contactbench.scene.many import like
from contactbench.splitting.free_body import free


def plain(scene: Any, h: Any, xp: Any) -> Any:
    return h


def no_damping(scene: Any, x: Any, h: Any, xp: Any) -> Any:
    return 0.0


def linear_log_factor(scene: Any, x: Any, h: Any, xp: Any) -> Any:
    return -scene.gamma * h


class Flow(NamedTuple):
    """One exact subflow φ_h.

    costs : what one application adds to the counts, by kind ("gradient", "rotation"; "attitude": the rotations
        that R takes beside the others, where it is carried).
    log_factor : ``(scene, x, h, xp) -> log c`` with φ_h*η = c η at x.
    Flows for h1 and h2 compose to the flow for h1 + h2, so that neighbours may be merged.
    """

    constants: Callable[[Any, Any, Any], Any]
    apply: Callable[[Any, Any, Any, Any], Any]
    costs: dict[str, int]
    log_factor: Callable[[Any, Any, Any, Any], Any] = no_damping


def damped_time(gamma: Any, h: Any, xp: Any) -> Any:
    """Return φ(h) = (1 − e^{−γh})/γ, the time a damped momentum is worth; exactly h when γ = 0."""
    undamped, z = gamma == 0, gamma * h
    small = h * (1 - z / 2 * (1 - z / 3))  # its derivatives by γ are those at 0
    return choose(undamped, small, -xp.expm1(-z) / choose(undamped, 1.0, gamma, xp), xp)


#: above this γh the decay is applied as a factor, below it as a small loss
STRONG = 1.5


def damping(gamma: Any, h: Any, xp: Any) -> tuple[Any, Any]:
    """Return e^{−γh} as a pair (keep, lose): damped(p) = keep·p − lose·p.

    With keep = 1 and lose = 1 − e^{−γh} the rounding of the coefficient matters only through the
    small loss, so that 10⁶ steps do not drift by 10⁶ roundings of the factor; and the loss joins the
    kick in one fused multiply-add.  Where the loss is nearly everything, (e^{−γh}, 0) instead.
    """
    strong = gamma * h > STRONG
    factor, loss = xp.exp(-gamma * h), -xp.expm1(-gamma * h)
    return choose(strong, factor, 1.0, xp), choose(strong, 0.0, loss, xp)


# -- mechanical scenes ---------------------------------------------------------------------------
def kick(scene: Mechanical, x: State, h: Any, xp: Any) -> State:
    """B: p −= h ∇V(q), s −= h V(q)."""
    p = tuple(p - h * g for p, g in zip(x.p, scene.gradient_at(x), strict=True))
    return x._replace(p=p, s=None if x.s is None else x.s - h * scene.potential_at(x))


def drift(scene: Mechanical, x: State, h: Any, xp: Any) -> State:
    """A: q += h p/m, s += h T(p).  (T is homogeneous of degree two: p·T_p − T = T.)"""
    q = tuple(map(add, x.q, scaled(times(scene.inverse_mass, h), x.p)))
    return x._replace(q=q, s=None if x.s is None else x.s + h * scene.kinetic(x.p))


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
    over_D = _over_D(x, half_kappa, xp)
    return settle(State(x.q, tuple(over_D * over_D * p for p in p), over_D * s), xp)


def _over_D(x: State, half_kappa: Any, xp: Any) -> Any:
    D = 1 + half_kappa * x.s
    return choose(D > 0, 1 / choose(D > 0, D, 1.0, xp), xp.inf, xp)


def damp_log_factor(scene: Mechanical, x: State, h: Any, xp: Any) -> Any:
    if not scene.nonlinear_damping:
        return -scene.gamma * h
    return -scene.gamma * h - 2 * xp.log1p(scene.kappa * x.s * damped_time(scene.gamma, h, xp) / 2)


def _drift_damp_constants(scene: Mechanical, h: Any, xp: Any) -> Any:
    phi = damped_time(scene.gamma, h, xp)
    half_kappa = (scene.kappa * phi / 2,) if scene.nonlinear_damping else ()
    return times(scene.inverse_mass, phi), phi, *damping(scene.gamma, h, xp), *half_kappa


def drift_damp(scene: Mechanical, x: Any, constants: Any, xp: Any) -> Any:
    """AC, the flow of T + γs: q += φ p/m, s → e^{−γh} (s + φ T(p)), p → e^{−γh} p.

    With ½κs² added, and k = ½κφ, a = 1 + ks, b² = kφT(p):

        p → e^{−γh} p/y,   s → e^{−γh} (as + φT(p))/y,   q += (φ/m) p·atan2(b, a)/b,   y = a² + b².

    (In the time φ, s = w'/(kw) up to a constant turns the Riccati equation s' = T − ½κs² into Pinney's
    w'' = const/w³; y = w².)  κ < 0 makes b imaginary.  The conformal factor is that of p, e^{−γh}/y.
    """
    if not scene.nonlinear_damping:
        phi_over_m, phi, keep, lose = constants
        q = tuple(map(add, x.q, scaled(phi_over_m, x.p)))
        s = None if x.s is None else x.s + phi * scene.kinetic(x.p)
        s = None if s is None else keep * s - lose * s
        return x._replace(q=q, p=tuple(keep * p - lose * p for p in x.p), s=s)
    phi_over_m, phi, keep, lose, _ = constants
    a, over_y, path = _pinney(scene, x, constants, xp)
    q = tuple(map(add, x.q, scaled(times(phi_over_m, path), x.p)))
    s = a * x.s + phi * scene.kinetic(x.p)
    p = tuple((keep * p - lose * p) * over_y for p in x.p)
    return settle(State(q, p, (keep * s - lose * s) * over_y), xp)


def _pinney(scene: Mechanical, x: State, constants: Any, xp: Any) -> tuple[Any, Any, Any]:
    """Return a, 1/y and atan2(b, a)/b of `drift_damp`; 1/y is infinite from the time of blow-up on.

    For κ < 0 with b² = −kφT: y = a² − b², factored because both factors are positive until s reaches
    infinity, and log((a + b)/(a − b))/2b.  For κ > 0 only p = 0 blows up, any other goes round.
    """
    _, phi, _, _, half_kappa = constants
    a, z = 1 + half_kappa * x.s, half_kappa * phi * scene.kinetic(x.p)
    if scene.kappa_sign is None:
        return _pinney_of_any_sign(a, z, xp)
    square = scene.kappa_sign * z
    straight = square == 0
    b = xp.sqrt(choose(straight, 1.0, square, xp))  # 1: no derivative of √0 is taken
    if scene.kappa_sign > 0:
        y = choose(straight, choose(a > 0, a * a, 0.0, xp), a * a + square, xp)
    else:
        edge = choose(straight, 0.0, b, xp)
        y = choose(a > edge, (a - edge) * (a + edge), 0.0, xp)
    alive = y > 0
    y, run, rise = choose(alive, y, 1.0, xp), choose(alive, a, 2.0, xp), choose(alive, b, 1.0, xp)
    if scene.kappa_sign > 0:
        bent = xp.atan2(rise, run) / rise
    else:
        bent = xp.log1p(2 * rise / choose(straight, 1.0, run - rise, xp)) / (2 * rise)
    path = choose(straight, 1 / choose(straight, run, 1.0, xp), bent, xp)
    return a, choose(alive, 1 / y, xp.inf, xp), path


#: z/a² up to which atan2(√z, a)/√z is a sum of so many powers: to round-off
SMALL, POWERS = 1e-2, 9


def _pinney_of_any_sign(a: Any, z: Any, xp: Any) -> tuple[Any, Any, Any]:
    """Return the same where the sign of κ is not known, z = kφT; smooth at κ = 0, which the others are not."""
    size, square = abs(z), a * a
    near = (size <= SMALL * square) & (a > 0)
    b = xp.sqrt(choose(near | (z == 0), 1.0, size, xp))
    turns, ahead = (z > 0) & ~near, (a > b) & (z < 0) & ~near
    y = choose(near | turns, square + z, choose(ahead, (a - b) * (a + b), 0.0, xp), xp)
    alive = y > 0
    run = choose(near, a, 1.0, xp)
    part, series = choose(near, z, 0.0, xp) / (run * run), 0.0
    for k in reversed(range(POWERS)):
        series = 1 / (2 * k + 1) - part * series
    bent = xp.log1p(2 * b / choose(ahead, a - b, 1.0, xp)) / (2 * b)
    path = choose(near, series / run, choose(turns, xp.atan2(b, a) / b, bent, xp), xp)
    return a, choose(alive, 1 / choose(alive, y, 1.0, xp), xp.inf, xp), path


def drift_damp_log_factor(scene: Mechanical, x: State, h: Any, xp: Any) -> Any:
    linear = linear_log_factor(scene, x, h, xp)
    if not scene.nonlinear_damping:
        return linear
    _, over_y, _ = _pinney(scene, x, _drift_damp_constants(scene, h, xp), xp)
    return linear + xp.log(over_y)


MECHANICAL = {
    "kick": Flow(plain, kick, {"gradient": 1}),
    "drift": Flow(plain, drift, {}),
    "damp": Flow(_damp_constants, damp, {}, damp_log_factor),
    "drift_damp": Flow(_drift_damp_constants, drift_damp, {}, drift_damp_log_factor),
}


# -- scenes with time in them ----------------------------------------------------------------------
# A is T, B is V(q, t) at a fixed t, and C is γ(t) s with the clock t' = 1, so that G = ∫γ over the step is exact
# however they alternate.  Where A and C are merged, φ = ∫e^{−∫γ} is the time a momentum is worth.  V(q, t) and the
# clock depend on neither p nor s: Nyström tables keep their order.
def driven_log_factor(scene: Driven, x: DrivenState, h: Any, xp: Any) -> Any:
    return -(scene.gamma * h if scene.rate is None else scene.spent(x.t, h, xp)[0])


def driven_damp(scene: Driven, x: DrivenState, h: Any, xp: Any) -> DrivenState:
    """C: p *= e^{−G}, s *= e^{−G}, t += h."""
    decay = xp.exp(driven_log_factor(scene, x, h, xp))
    s = None if x.s is None else decay * x.s
    return DrivenState(x.q, tuple(decay * p for p in x.p), x.t + h, s)


def _driven_constants(scene: Driven, h: Any, xp: Any) -> Any:
    """Return h, and the constants of `drift_damp` where γ is constant."""
    return (h,) if scene.rate_changes else (h, *_drift_damp_constants(scene, h, xp))


def driven_drift_damp(scene: Driven, x: DrivenState, constants: Any, xp: Any) -> DrivenState:
    """AC over (t, t + h), with φ and ∫γ of that time."""
    h, *constant = constants
    if not constant:
        total, phi = scene.spent(x.t, h, xp)
        constant = times(scene.inverse_mass, phi), phi, 1.0, -xp.expm1(-total)
    return drift_damp(scene, x, constant, xp)._replace(t=x.t + h)


DRIVEN = MECHANICAL | {
    "damp": Flow(plain, driven_damp, {}, driven_log_factor),
    "drift_damp": Flow(_driven_constants, driven_drift_damp, {}, driven_log_factor),
}


# -- a damping of one's own ------------------------------------------------------------------------
# With r = Γ' about half-way and the time τ in which linear damping of that rate would do the same,
# s = s₀ − Γ(s₀) φ_r(τ), φ_r(τ) = (1 − e^{−rτ})/r, the separated equation ∫ ds/Γ = −h of s' = −Γ(s) becomes
#
#     ∫₀^{τ(h)} k(τ) dτ = h,   k(τ) = e^{−rτ} Γ(s₀)/Γ(s(τ)),
#
# whose integrand is positive, 1 where Γ is linear, and regular at the zeros of Γ.  Gauss's rule and Newton's method
# from τ = h; the slope of the integral is k.  On doubles the rule has `NODES` nodes in each half of the step: enough
# for round-off where Γ'h is below one (measured in the tests).
NODES, ITERATIONS, PANELS = 16, 6, 2


@cache
def rule() -> tuple[list[float], list[float]]:
    x, w = np.polynomial.legendre.leggauss(NODES)
    return ((1 + x) / 2).tolist(), (w / 2).tolist()


def decay(scene: Any, s: Any, h: Any, xp: Any) -> Any:
    """Return s(h) from s at 0; not finite where s reaches infinity before."""
    if scene.damping_flow is not None:
        return scene.damping_flow(s, h, xp)
    for _ in range(PANELS):
        s = by_quadrature(scene, s, h / PANELS, xp)
    return s


def by_quadrature(scene: Any, s: Any, h: Any, xp: Any) -> Any:
    start = scene.dissipation(s)
    r = scene.dissipation_rate(s - start * damped_time(scene.dissipation_rate(s), h / 2, xp))
    resting = start == 0

    def at(tau: Any) -> Any:
        return s - start * damped_time(r, tau, xp)

    def pace(tau: Any) -> Any:
        there = scene.dissipation(at(tau))
        gone = there == 0
        ratio = choose(resting, 1.0, start, xp) / choose(gone, 1.0, there, xp)
        return choose(resting, 1.0, choose(gone, 1.0, xp.exp(-r * tau) * ratio, xp), xp)

    def elapsed(tau: Any) -> Any:
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
    """Return ∂s(h)/∂s = Γ(s(h))/Γ(s), the factor on p and on η; e^{−Γ'h} at the zeros of Γ.

    There Γ' is taken where s is on average, whose derivative is that of ∫Γ'(s).
    """
    start = scene.dissipation(s)
    resting = start == 0
    ratio = scene.dissipation(after) / choose(resting, 1.0, start, xp)
    z = scene.dissipation_rate(s) * h
    still = z == 0
    moved = choose(still, 1, z + xp.expm1(-z), xp) / choose(still, 2, z, xp) / choose(still, 1, z, xp)
    return choose(resting, xp.exp(-scene.dissipation_rate(s - start * h * moved) * h), ratio, xp)


def damp_generally(scene: Any, x: State, h: Any, xp: Any) -> State:
    """C for any Γ(s): s follows s' = −Γ(s), and p the derivative of s(h), both solving p' = −Γ'(s) p."""
    s = decay(scene, x.s, h, xp)
    factor = survival(scene, x.s, s, h, xp)
    return settle(State(x.q, tuple(factor * p for p in x.p), s), xp)


def general_log_factor(scene: Any, x: State, h: Any, xp: Any) -> Any:
    return xp.log(survival(scene, x.s, decay(scene, x.s, h, xp), h, xp))


def many_drift(scene: Any, x: State, h: Any, xp: Any) -> State:
    """A on many sites, whose masses may differ."""
    return drift(scene._replaced(inverse_mass=like(scene.inverse_mass, x.p[0])), x, h, xp)


def many_drift_damp(scene: Any, x: State, constants: Any, xp: Any) -> State:
    """AC on many sites, whose masses may differ."""
    phi, keep, lose = constants
    return drift_damp(scene, x, (phi * like(scene.inverse_mass, x.p[0]), phi, keep, lose), xp)


def _time_and_damping(scene: Any, h: Any, xp: Any) -> Any:
    return damped_time(scene.gamma, h, xp), *damping(scene.gamma, h, xp)


MANY = MECHANICAL | {
    "drift": Flow(plain, many_drift, {}),
    "drift_damp": Flow(_time_and_damping, many_drift_damp, {}, drift_damp_log_factor),
}

#: no merged flow is known, hence three parts
GENERAL = {name: MECHANICAL[name] for name in ("kick", "drift")}
GENERAL["damp"] = Flow(plain, damp_generally, {}, general_log_factor)


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
    return settle(BodyState(tuple(turned), R, None if s is None else s + angle * M[axis] / 2), xp)


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
    if abilities(xp).branch:
        size = xp.sqrt(square)
        scale, cos = a / 2 if still else xp.sin(a * size / 2) / size, xp.cos(a * size / 2)
    else:
        size = xp.sqrt(xp.where(still, 1.0, square))  # 1: no derivative of √0 is taken
        scale = xp.where(still, a / 2, xp.sin(a * size / 2) / size)
        cos = xp.where(still, 1.0, xp.cos(a * size / 2))
    R = quaternion_product(x.R, (cos, *(scale * m for m in x.M)))
    return settle(BodyState(x.M, R, s), xp)


def turn_rate(scene: RigidBody) -> Any:
    """Return 1/I_min − 1/I_mid, the part of the energy that `turn` is the flow of, as ½ a M_min²."""
    smallest, middle, _ = scene.by_inertia
    return scene.inverse_inertia[smallest] - scene.inverse_inertia[middle]


def top_rate(scene: RigidBody) -> Any:
    """Return 1/I_max − 1/I_mid, by which the symmetric top of `top` differs from a sphere."""
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


def free_damp(scene: RigidBody, x: BodyState, constants: Any, xp: Any) -> BodyState:
    """Advance the free body and isotropic damping together: free for the time φ(h), then damped.

    C rescales time: e^{γt} M and R move as if undamped in the time φ(t), and s' = ½M·Ω − γs gives
    s(h) = e^{−γh} (s + φ H0).  The whole flow of the scene, for any h.
    """
    tau, *decay = constants
    return body_damp(scene, free(scene, x, tau, xp), decay, xp)


def top_kick(scene: HeavyTop, x: BodyState, h: Any, xp: Any) -> BodyState:
    """B: M += h w u × χ, s −= h w u·χ; R does not change."""
    M = tuple(m + h * c for m, c in zip(x.M, scene.torque(x), strict=True))
    return BodyState(M, x.R, None if x.s is None else x.s - h * scene.potential_at(x))


#: what `free` costs in rotations: it has so many times the two square roots, divisions and transcendental
#: functions of a rotation, with loops of fixed length (counted anew in the tests).  The momentum takes few of
#: them, the attitude the others, where it is carried.
MOMENTUM_COST, FREE_COST = 23, 177
FREE_COSTS = {"rotation": MOMENTUM_COST, "attitude": FREE_COST - MOMENTUM_COST}

BODY = {
    "turn": Flow(plain, turn, {"rotation": 1}),
    "top": Flow(plain, top, {"rotation": 1}),
    "free": Flow(plain, free, FREE_COSTS),
    "damp": Flow(_body_damp_constants, body_damp, {}, linear_log_factor),
}
ISOTROPIC = BODY | {"free_damp": Flow(_time_and_damping, free_damp, FREE_COSTS, linear_log_factor)}
HEAVY_TOP = BODY | {"kick": Flow(plain, top_kick, {"gradient": 1})}

FLOWS = {"mechanical": MECHANICAL, "driven": DRIVEN, "general damping": GENERAL, "many": MANY}
FLOWS |= {"isotropic body": ISOTROPIC, "body": BODY, "heavy top": HEAVY_TOP}


def flows_of(scene: Scene) -> dict[str, Flow]:
    """Return a scene's subflows by name; compositions of higher order leave out a body's `free`, which is costly."""
    return FLOWS[scene.kind]
